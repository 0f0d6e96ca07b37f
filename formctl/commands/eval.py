"""``formctl eval``: policies and baselines on the same stored scenarios, one row per episode."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.options import Overrides, ShowConfig, configs

if TYPE_CHECKING:
    import pandas as pd

    from envs.bank import Bank
    from formctl.config import Config
    from formctl.methods import Method
    from formctl.store import Run

AXES = ("columns", "balls")
"""Scenario counts that ``--grid`` can vary."""


@dataclass(frozen=True)
class Cell:
    """One scene of an evaluation: its settings and its episodes."""

    config: "Config"
    bank: "Bank"


def command(
    overrides: Overrides = None,
    policy: Annotated[
        list[str] | None, typer.Option(metavar="RUN|FILE|NAME", help="A trained policy; may be repeated.")
    ] = None,
    baseline: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A baseline of conf/baseline; may be repeated.")
    ] = None,
    bank: Annotated[Path | None, typer.Option(help="Fly exactly the scenarios of this bank.")] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes per scene, without a bank.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write all rows to this Parquet file as well.")] = None,
    grid: Annotated[
        list[str] | None, typer.Option(help="Scenes to fly, e.g. --grid columns=5,10,15,20 balls=0; may be repeated.")
    ] = None,
    cfg: ShowConfig = False,
) -> None:
    """Fly policies and baselines on the same stored scenarios and write one row per episode."""
    from formctl import methods

    axes, words = split_grid(grid or [], overrides or [])
    if episodes is not None:
        words.append(f"eval.episodes={episodes}")
    (config,) = configs(words, show=cfg)
    flown = [methods.policy(text, config.runs) for text in policy or []]
    flown += [methods.baseline(name, words) for name in baseline or []]
    if not flown:
        from formctl.errors import ConfigError

        raise ConfigError("nothing to fly: give --policy RUN|FILE|NAME or --baseline NAME")
    if bank is not None and (axes or episodes):
        from formctl.errors import ConfigError

        raise ConfigError("--bank is a fixed set of episodes: leave out --grid and --episodes")
    scenes = [stored_cell(config, bank, words)] if bank is not None else cells(config, axes)
    runs = execute(config, flown, scenes)
    if out is not None:
        import pandas as pd

        from formctl import evaluation

        evaluation.write_rows(out, pd.concat([evaluation.read_rows(run.path / "episodes.parquet") for run in runs]))


def split_grid(grid: Sequence[str], overrides: Sequence[str]) -> tuple[dict[str, list[int]], list[str]]:
    """Axes of the grid, from ``--grid`` and the axis words after it, and the overrides that remain.

    Raises ConfigError for an axis that is none and for values that are not whole numbers.
    """
    from formctl.errors import ConfigError

    own = [text for text in overrides if grid and text.partition("=")[0] in AXES]
    axes: dict[str, list[int]] = {}
    for text in [*grid, *own]:
        key, _, values = text.partition("=")
        if key not in AXES or not all(value.isdigit() for value in values.split(",")):
            raise ConfigError(f"--grid {text} cannot be used: write columns=5,10,15,20 or balls=1,2,3")
        axes[key] = [int(value) for value in values.split(",")]
    return axes, [text for text in overrides if text not in own]


def cells(config: "Config", axes: dict[str, list[int]]) -> list[Cell]:
    """Every combination of the axes, each with its own bank drawn from the configured seed."""
    from formctl import evaluation
    from formctl.build import held_out_seed

    seed = held_out_seed(config.seed, "eval")
    scenes = []
    for values in product(*axes.values()):
        scenario = replace(config.scenario, **dict(zip(axes, values, strict=True)))
        scene = replace(config, scenario=scenario)
        scenes.append(Cell(scene, evaluation.make_bank(scenario, config.eval.episodes, seed)))
    return scenes


def stored_cell(config: "Config", path: Path, overrides: Sequence[str]) -> Cell:
    """The scene of a stored bank. Raises ConfigError when the overrides ask for another one."""
    from envs.bank import Bank
    from formctl.compare import differences
    from formctl.errors import ConfigError

    bank = Bank.load(path)
    if any(text.startswith("scenario") for text in overrides):
        changed = differences(vars(bank.spec), vars(config.scenario))
        if changed:
            key, (was, now) = next(iter(changed.items()))
            raise ConfigError(f"{path} was drawn with scenario.{key}={was}, not {now}: leave out the scenario overrides")
    return Cell(replace(config, scenario=bank.spec), bank)


def execute(config: "Config", flown: "Sequence[Method]", scenes: Sequence[Cell], **fields: Any) -> "list[Run]":
    """Fly every method through every scene; one run per method. Prints a table and returns the runs."""
    from formctl import build
    from formctl.console import progress, say

    build.use_threads(config)
    for method in flown:
        for scene in scenes:
            method.make(build.environment(build.world(scene.config), config.sim))  # refused before anything is flown
    count = sum(len(scene.bank.scenarios.id) for scene in scenes)
    say(f"about to fly {len(flown)} methods x {count:,} episodes (sim {config.sim})")
    runs = []
    with progress("eval", len(flown) * count, "episodes") as bar:
        for number, method in enumerate(flown):
            runs.append(fly_method(config, method, scenes, lambda done, at=number: bar.update(at * count + done), fields))
    show(runs)
    return runs


def fly_method(config: "Config", method: "Method", scenes: Sequence[Cell], listen: Any, fields: dict[str, Any]) -> "Run":
    """One method through every scene, in a run of its own."""
    import pandas as pd

    from formctl import build, evaluation, provenance, store

    banks = [
        {
            "columns": scene.config.scenario.columns,
            "balls": scene.config.scenario.balls,
            "sha256": scene.bank.sha256,
            "seed": scene.bank.seed,
            "episodes": len(scene.bank.scenarios.id),
        }
        for scene in scenes
    ]
    tree = config.tree | ({"scenario": vars(scenes[0].config.scenario)} if len(scenes) == 1 else {})
    run = store.create(
        config.runs,
        "eval",
        config.name,
        config=tree,
        provenance=provenance.collect(),
        argv=provenance.argv(),
        profile=config.profile,
        seed=config.seed,
        parents=method.parents,
        method=method.facts,
        scenario=scenes[0].config.scenario.name,
        bank=banks[0] if len(banks) == 1 else None,
        banks=banks,
        **fields,
    )
    provenance.save_diff(run.path)
    tables: list[pd.DataFrame] = []
    before = 0
    with run.work() as live:
        for scene in scenes:
            world = build.world(scene.config)
            tables.append(
                evaluation.fly(method, scene.bank, world, scene.config, lambda done, at=before: listen(at + done))
            )
            before += len(scene.bank.scenarios.id)
        rows = pd.concat(tables, ignore_index=True)
        evaluation.write_rows(live.path / "episodes.parquet", rows)
        live.update(result=evaluation.rates(rows))
    return run


def show(runs: "Sequence[Run]") -> None:
    """The methods' rates, scene by scene."""
    import pandas as pd

    from formctl import console, evaluation

    rows = pd.concat([evaluation.read_rows(run.path / "episodes.parquet") for run in runs], ignore_index=True)
    lines = []
    for (name, columns, balls), part in rows.groupby(["method", "columns", "balls"], sort=False):
        hits, count = int(part["cfr"].sum()), len(part)
        low, high = evaluation.wilson(hits, count)
        fm = evaluation.mean_fm(part)
        scene = f"{columns} columns, {balls} balls"
        rate = f"{hits / count:.3f} ({hits} of {count})"
        lines.append((name, scene, rate, f"{low:.3f} to {high:.3f}", "none succeeded" if fm is None else f"{fm:.3f}"))
    console.table(("method", "scene", "CFR", "95 % interval", "FM of successes"), lines)
    for run in runs:
        console.say(f"rows: {run.path / 'episodes.parquet'}")
