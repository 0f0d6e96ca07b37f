"""Model cards: what a policy is for, what it was measured to do and not to do, and how to use it, as Markdown."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from algos import checkpoint
from analysis.data.text import counted
from analysis.stats import wilson
from formctl import store
from formctl.store.compare import fingerprint
from formctl.store.files import StoreError, write_text

SCENE = ["scenario", "columns", "balls", "ball_aim", "sim", "drone", "deploy"]
"""Columns that tell the rows of a card's table apart."""

FEW = 100
"""Episodes below which a cell is left out of the table."""


def shipped_card(policy: Path) -> Path:
    """Where the card of a shipped policy is: beside it."""
    return policy.with_suffix(".md")


def render(policy: Path, name: str, root: Path) -> str:
    """The card of a policy file, with the rates that the store ``root`` has of it. Raises CheckpointError."""
    content = checkpoint.load(policy, kind="policy")
    meta = content["meta"]
    method: dict[str, Any] = {"algo": "", "curriculum": "", "experiment": "", "weights": [], "seed": 0, "run": ""}
    method |= meta.get("method", {})
    lines = [f"# Policy `{name}`", "", *_task(content), *_data(content, meta, method)]
    lines += [*_rates(evaluations(method, root), root), *_limits(content), *_use(name, content)]
    return "\n".join(lines) + "\n"


def evaluations(method: dict[str, Any], root: Path) -> pd.DataFrame:
    """Rows of the evaluations in ``root`` that flew the policy; of an episode flown again, the latest."""
    found = []
    for run in reversed(store.scan(root, kind="eval")):
        flown = run.record.get("method") or {}
        same = flown.get("run") == method["run"] and flown.get("seed") == method["seed"] if method["run"] else False
        same = same or (not flown.get("run") and flown.get("name") == method.get("name"))
        if same and run.status == "done" and (run.path / "episodes.parquet").is_file():
            found.append(pd.read_parquet(run.path / "episodes.parquet").assign(settings=_world(run)))
    if not found:
        return pd.DataFrame()
    rows = pd.concat(found, ignore_index=True)
    rows = rows.assign(deploy=rows["deploy"].fillna("") if "deploy" in rows else "")
    newest = rows["metric_version"].astype(str).max()
    rows = rows[rows["metric_version"].astype(str) == newest]
    return rows.drop_duplicates([*SCENE, "settings", "scenario_id"], keep="last")


def _world(run: store.Run) -> str:
    """A short name for the world of an evaluation, so that flights in another (mass, latency) stand apart."""
    config = run.config
    counts = ("columns", "balls", "ball_aim", "name")
    scenario = {key: value for key, value in (config.get("scenario") or {}).items() if key not in counts}
    return fingerprint({"scenario": scenario, "drone": config.get("drone"), "deploy": config.get("deploy")})


def _task(content: dict[str, Any]) -> Iterator[str]:
    layout = content["layout"]
    command = "four rotor thrusts" if content.get("command") == "rotor" else "body rates and collective thrust (CTBR)"
    yield "## Task"
    yield ""
    yield (
        f"{layout['drones']} quadrotors (`{content['drone']}`) keep a formation at 2 m/s along +y among columns and "
        f"thrown balls; every drone decides alone, with the same network. It sees `observation={layout['name']}` "
        f"with at most {content['balls']} balls, and commands {command}."
    )
    yield ""


def _data(content: dict[str, Any], meta: dict[str, Any], method: dict[str, Any]) -> Iterator[str]:
    size = sum(int(x.numel()) for x in content["weights"].values())
    steps, minutes = meta.get("steps"), meta.get("minutes")
    yield "## Training"
    yield ""
    yield "| what | value |"
    yield "|---|---|"
    for key in ("algo", "encoder", "curriculum", "experiment"):
        if method.get(key):
            yield f"| {key} | `{method[key]}` |"
    if method["weights"]:
        yield f"| weights: formation, flight, obstacle, action | {', '.join(f'{w:g}' for w in method['weights'])} |"
    if steps is not None:
        spent = f" in {minutes:g} min" if minutes else ""
        yield f"| environment steps | {steps:,}{spent} (profile {meta.get('profile') or 'unknown'}) |"
    yield f"| seed, run | {method['seed']}, `{method['run'] or 'unknown'}` |"
    yield f"| parameters | {size:,} |"
    yield f"| digest of its content (sha256) | `{checkpoint.digest(content)}` |"
    yield ""
    yield "All data are simulated episodes, drawn with other seeds than those it is evaluated on."
    yield ""


def _rates(rows: pd.DataFrame, root: Path) -> Iterator[str]:
    yield "## What was measured"
    yield ""
    if rows.empty:
        yield f"Nothing in the store {root}: fly it with the command below and make the card again."
        yield ""
        return
    yield "CFR: share of episodes without contact, in time and inside the corridor, with its 95 % Wilson"
    yield "interval; FM: mean formation error of those; left: share of episodes in which a drone left the corridor."
    yield "One seed: the intervals speak about this policy, not about the method that trained it."
    yield ""
    yield "| scene | world | episodes | CFR | FM in m | left | bank |"
    yield "|---|---|---:|---:|---:|---:|---|"
    cells = list(rows.groupby([*SCENE, "settings"], sort=True, dropna=False))
    usual: dict[tuple[Any, ...], list[int]] = {}
    for key, part in cells:
        usual.setdefault(key[:-1], []).append(len(part))
    for key, part in cells:
        if len(part) < FEW or len(part) < max(usual[key[:-1]]):
            continue
        yield _rate_line(dict(zip(SCENE, key, strict=False)), part)
    yield ""
    yield f"Metric version {rows['metric_version'].iloc[0]}; every column of a row is described in docs/rows.md."
    yield ""


def _rate_line(scene: dict[str, Any], part: pd.DataFrame) -> str:
    k, n = int(part["cfr"].sum()), len(part)
    low, high = wilson(k, n)
    aim = f", {counted(int(scene['balls']), 'ball')} at the {scene['ball_aim']}" if scene["balls"] else ""
    world = ", ".join(filter(None, (scene["sim"], scene["drone"], scene["deploy"] and f"deploy {scene['deploy']}")))
    fm = f"{part.loc[part['cfr'], 'fm'].mean():.3f}" if k else "-"
    left = f"{part['left_corridor'].mean():.3f}" if "left_corridor" in part else "-"
    rate = f"{k / n:.3f} [{low:.3f}, {high:.3f}]"
    columns = f"{scene['columns']} columns" if scene["columns"] else "no columns"
    banks = ", ".join(sorted({str(bank)[:12] for bank in part["bank"]}))
    return f"| {scene['scenario']}: {columns}{aim} | {world} | {n:,} | {rate} | {fm} | {left} | `{banks}` |"


def _limits(content: dict[str, Any]) -> Iterator[str]:
    drones, balls = content["layout"]["drones"], content["balls"]
    yield "## Limits"
    yield ""
    yield f"- It was trained with {drones} drones, one formation, one speed and at most {balls} balls."
    yield "- Columns are infinite, balls fly ballistically and the air is still."
    yield "- It was trained in simulation. A cell that is not in the table above was not measured."
    yield "- Nothing but what it has learnt keeps it from an obstacle: real drones need a geofence and a stop button."
    yield ""


def _use(name: str, content: dict[str, Any]) -> Iterator[str]:
    calls = {f"formctl eval --policy {name} scenario=mixed": "fly it: rows, rates and failures"}
    calls["formctl replay main:0"] = "look at an episode of that"
    if not content.get("agent"):
        calls[f"formctl train start={name}"] = "train on from it"
        calls[f"formctl export {name}"] = "for other runtimes"
    wide = max(map(len, calls))
    yield "## How to use it"
    yield ""
    yield "```sh"
    yield from (f"{call:<{wide}}    # {what}" for call, what in calls.items())
    yield "```"


def write(path: Path, text: str) -> None:
    """Write a card. Raises StoreError where that cannot be done."""
    if path.is_dir():
        raise StoreError(f"{path} is a folder: name a file")
    write_text(path, text)


def file_digest(policy: Path) -> str:
    """Digest of a policy's content, as its card says it."""
    return checkpoint.digest(checkpoint.load(policy, kind="policy"))
