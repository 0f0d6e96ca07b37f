"""``formctl eval``: policies and baselines on the same stored scenarios, one row per episode."""

import secrets
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.commands.options import Baselines, Multirun, Overrides, Policies, ShowConfig, configs

if TYPE_CHECKING:
    import pandas as pd

    from formctl.flying.evaluation import Scene
    from formctl.flying.keeping import Choice
    from formctl.flying.methods import Method
    from formctl.settings import Config
    from formctl.store import Run

STOPPED = ("interrupted", "failed")
"""States of a run that its call goes on with."""

ROW = 500
"""Bytes of a row on disk, rounded up generously."""

AXES = ("columns", "balls")
"""Scenario counts that ``--grid`` can vary."""

SIMS = ("torch", "mujoco")
"""Physics that ``--sim`` can name."""


def command(
    overrides: Overrides = None,
    policy: Policies = None,
    baseline: Baselines = None,
    bank: Annotated[Path | None, typer.Option(help="Fly exactly the scenarios of this bank.")] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes per scene, without a bank.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write all rows to this Parquet file as well.")] = None,
    grid: Annotated[
        list[str] | None, typer.Option(help="Scenes to fly, e.g. --grid columns=5,10,15,20 balls=0; may be repeated.")
    ] = None,
    sim: Annotated[str | None, typer.Option(help="Physics to fly on: torch, mujoco, or torch,mujoco for both.")] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Processes that share the episodes [default: all cores]."),
    ] = None,
    record: Annotated[
        str | None, typer.Option(metavar="WHICH", help="Record episodes: worst=5, failed=5, first=3 or ids=4,17.")
    ] = None,
    multirun: Multirun = False,
    cfg: ShowConfig = False,
) -> None:
    """Fly policies and baselines on the same stored scenarios and write one row per episode."""
    import pandas as pd

    from formctl.console import say
    from formctl.flying import evaluation, methods
    from formctl.flying.keeping import Choice

    axes, words = split_grid(grid or [], overrides or [])
    names, own, words = split_baselines(baseline or [], words)
    words += [] if episodes is None else [f"eval.episodes={episodes}"]
    refuse_contradictions(bool(policy or names), bank, bool(axes or episodes))
    choice = None if record is None else Choice.parse(record)
    planned = []
    for config in on_each(sims(sim), words, multirun, cfg):  # everything is checked before anything is flown
        flown = [methods.policy(text, config.runs) for text in dict.fromkeys(policy or [])]
        flown += [methods.baseline(name, own) for name in dict.fromkeys(names)]
        methods.check_observation(config, flown, words)
        config, scenes = (config, drawn(config, axes)) if bank is None else stored(config, bank, words)
        if choice is not None:
            choice.check(sum(len(scene.bank) for scene in scenes))
        planned.append((config, evaluation.check(config, flown, scenes), scenes))
    invocation = invocation_of(planned)
    runs = [
        run
        for config, flown, scenes in planned
        for run in execute(config, flown, scenes, jobs, choice, invocation=invocation)
    ]
    show(runs)
    for run in runs:
        say(f"rows: {run.path / 'episodes.parquet'}")
        if choice is not None:
            kept = ", ".join(run.record["recordings"]) or "none"
            say(f"recorded: {kept} in {run.path}; formctl replay FILE shows one")
    if out is not None:
        tables = [evaluation.read_rows(run.path / "episodes.parquet") for run in runs]
        evaluation.write_rows(out, pd.concat(tables, ignore_index=True))


def sims(text: str | None) -> list[str]:
    """The physics of ``--sim``; none where it was not given. Raises ConfigError for one that does not exist."""
    from formctl.errors import ConfigError

    found = [part.strip() for part in text.split(",")] if text else []
    unknown = [part for part in found if part not in SIMS]
    if unknown:
        raise ConfigError(f"--sim {text} cannot be used: there is no physics {unknown[0]!r}, only {' and '.join(SIMS)}")
    return list(dict.fromkeys(found))


def on_each(physics: Sequence[str], words: list[str], multirun: bool, show: bool) -> "Iterator[Config]":
    """The composed settings on every physics, or on that of ``sim=`` where there is none to choose."""
    for chosen in [[f"sim={one}"] for one in physics] or [[]]:
        yield from configs([*words, *chosen], multirun, show)


def refuse_contradictions(anything: bool, bank: Path | None, drawn: bool) -> None:
    """Raise ConfigError for a call without a method, and for a bank whose episodes should also be drawn."""
    from formctl.errors import ConfigError

    if not anything:
        raise ConfigError("nothing to fly: give --policy RUN|FILE|NAME or --baseline NAME")
    if bank is not None and drawn:
        raise ConfigError("--bank is a fixed set of episodes: leave out --grid and --episodes")


def split_baselines(names: Sequence[str], words: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Baselines (``--baseline NAME`` or ``baseline=NAME``), their own settings (``baseline.KEY=``), and the rest."""
    typed = [text.removeprefix("baseline=") for text in words if text.startswith("baseline=")]
    own = [text for text in words if text.startswith("baseline.")]
    return [*names, *typed], own, [text for text in words if not text.startswith(("baseline=", "baseline."))]


def split_grid(grid: Sequence[str], overrides: Sequence[str]) -> tuple[dict[str, list[int]], list[str]]:
    """Axes of the grid, from ``--grid`` and the axis words after it, and the overrides that remain.

    An axis may be given more than once; a value counts once. Raises ConfigError for an axis that is none and for values
    that are not whole numbers.
    """
    from formctl.errors import ConfigError

    own = [text for text in overrides if grid and text.partition("=")[0] in AXES]
    axes: dict[str, list[int]] = {}
    for text in [*grid, *own]:
        key, _, values = text.partition("=")
        if key not in AXES or not all(value.isdecimal() for value in values.split(",")):
            raise ConfigError(f"--grid {text} cannot be used: write columns=5,10,15,20 or balls=1,2,3")
        axes[key] = list(dict.fromkeys([*axes.get(key, []), *map(int, values.split(","))]))
    return axes, [text for text in overrides if text not in own]


def drawn(config: "Config", axes: dict[str, list[int]]) -> "list[Scene]":
    """Every combination of the axes, each with its own bank drawn from ``eval.seed``."""
    from envs.bank import Bank
    from formctl.flying.evaluation import Scene
    from formctl.settings import build, restore

    scenes = []
    for values in product(*axes.values()):
        counts = dict(zip(axes, values, strict=True))
        varied = restore(config.tree | {"scenario": config.tree["scenario"] | counts})
        scenes.append(Scene(build.world(varied), Bank.create(varied.scenario, config.eval.episodes, config.eval.seed)))
    return scenes


def stored(config: "Config", path: Path, overrides: Sequence[str]) -> "tuple[Config, list[Scene]]":
    """The scene of a stored bank, and the settings with its scenario.

    Raises ConfigError when the overrides ask for another scenario.
    """
    from envs.bank import Bank
    from formctl.errors import ConfigError
    from formctl.flying.evaluation import Scene
    from formctl.settings import build, restore
    from formctl.settings.compare import differences

    bank = Bank.load(path)
    changed = differences(bank.spec, config.tree["scenario"])
    if changed and any(text.startswith("scenario") for text in overrides):
        key, (was, now) = next(iter(changed.items()))
        raise ConfigError(f"{path} was drawn with scenario.{key}={was}, not {now}: leave out scenario overrides")
    config = restore(config.tree | {"scenario": bank.spec})
    return config, [Scene(build.world(config), bank)]


def execute(
    config: "Config",
    flown: "Sequence[Method]",
    scenes: "Sequence[Scene]",
    jobs: int | None = None,
    choice: "Choice | None" = None,
    **fields: Any,
) -> "list[Run]":
    """Fly every method through every scene; one run per method.

    ``jobs`` None means one per core; ``choice``: the episodes to record; ``fields`` are recorded with runs. What was
    finished under the same ``invocation`` is not flown again, and an interrupted run goes on.
    """
    from analysis.words import counted
    from formctl import spending
    from formctl.console import say
    from formctl.engines import workers
    from formctl.settings import build

    build.use_threads(config)
    jobs = jobs or workers.cores()
    count = sum(len(scene.bank) for scene in scenes)
    seconds = sum(spending.flying_seconds(config, count, method, jobs) for method in flown)
    cost = spending.sentence(seconds, ROW * len(flown) * count, config.runs, compiled=False)
    names, each = ", ".join(method.name for method in flown), counted(count, "episode")
    say(f"about to fly {names}: {each} each (sim {config.sim}): {cost}")
    return [fly_method(config, method, scenes, jobs, choice, fields) for method in flown]


def fly_method(
    config: "Config",
    method: "Method",
    scenes: "Sequence[Scene]",
    jobs: int,
    choice: "Choice | None",
    fields: dict[str, Any],
) -> "Run":
    """One method through every scene, in a run of its own, or in the one where the same call was interrupted."""
    from analysis.words import counted
    from formctl import console
    from formctl.flying import evaluation, flights
    from formctl.flying.keeping import Keeper

    config = method.settings_of(config)
    run = open_run(config, method, scenes, fields)
    if run.status == "done":
        console.say(f"{method.name}: flown before the interruption, in {run.id}")
        return run
    journal = run.path / "flown.jsonl"
    kept, count = len(flights.Journal(journal).read()), sum(len(scene.bank) for scene in scenes)
    if kept:
        flown = f"{counted(kept, 'episode')} {'was' if kept == 1 else 'were'} flown"
        console.say(f"{method.name}: {flown} before the interruption of {run.id}")
    with run.work() as live, console.progress(f"eval {method.name}", count, "episodes", start=kept) as bar:
        keeper = None if choice is None else Keeper(choice, live.path / "mcap")
        rows = evaluation.fly(method, scenes, config, bar.update, keeper, jobs=jobs, journal=journal)
        evaluation.write_rows(live.path / "episodes.parquet", rows)
        if keeper is not None:
            live.update(recordings=[f"mcap/{path.name}" for path in keeper.write()])
        live.update(result=evaluation.rates(rows))
        flights.Journal(journal).remove()
    return run


def open_run(config: "Config", method: "Method", scenes: "Sequence[Scene]", fields: dict[str, Any]) -> "Run":
    """The run that stopped in these very flights, or finished them in this call, by the same program; or a new one."""
    from formctl import store
    from formctl.store import provenance

    flights = flights_of(config, method, scenes)
    for run in store.scan(config.runs, kind="eval", name=config.name, profile=config.profile):
        this_call = "invocation" in fields and run.record.get("invocation") == fields["invocation"]
        if run.record.get("flights") == flights and (run.status in STOPPED or (run.status == "done" and this_call)):
            return run
    banks = [describe(scene) for scene in scenes]
    return provenance.new_run(
        config,
        "eval",
        tree=config.tree | {"baseline": method.settings},
        parents=method.parents,
        method=method.facts,
        scenario=config.scenario.name,
        bank=banks[0] if len(banks) == 1 else None,
        banks=banks,
        flights=flights,
        **fields,
    )


def invocation_of(planned: "Sequence[tuple[Config, Sequence[Method], Sequence[Scene]]]") -> str:
    """What the runs of one call have in common: that of the same call that was interrupted, or something new."""
    from formctl import store

    for config, flown, scenes in planned:
        asked = {flights_of(method.settings_of(config), method, scenes) for method in flown}
        for run in store.scan(config.runs, kind="eval", name=config.name, profile=config.profile):
            if run.status in STOPPED and run.record.get("flights") in asked and "invocation" in run.record:
                return str(run.record["invocation"])
    return secrets.token_hex(4)


def flights_of(config: "Config", method: "Method", scenes: "Sequence[Scene]") -> str:
    """Digest of what the rows of an evaluation depend on, the program included."""
    from formctl.settings.compare import fingerprint
    from formctl.store import provenance

    return fingerprint({"settings": settings(config, method, scenes), "sources": provenance.sources()})


def settings(config: "Config", method: "Method", scenes: "Sequence[Scene]") -> dict[str, Any]:
    """Everything that the rows of an evaluation depend on, but for the program itself."""
    from envs.vocabulary import METRIC_VERSION

    chosen: dict[str, Any] = {key: config.tree[key] for key in ("eval", "drone", "observation", "sim", "deploy")}
    chosen |= {"banks": [scene.bank.sha256 for scene in scenes], "metric_version": METRIC_VERSION}
    return chosen | {"method": method.facts, "baseline": method.settings or {}}


def describe(scene: "Scene") -> dict[str, Any]:
    """A scene as a run's record names it."""
    from formctl.flying.evaluation import facts

    scenario = scene.world.scenario
    return facts(scene.bank) | {"columns": scenario.columns, "balls": scenario.balls}


def show(runs: "Sequence[Run]") -> None:
    """The methods' rates, scene by scene, and why episodes failed, each reason with RUN:EPISODE of one of them."""
    from analysis.stats import wilson
    from analysis.words import counted
    from formctl import console
    from formctl.flying import evaluation

    lines, failed = [], []
    several = len({run.config["sim"] for run in runs}) > 1
    for run in runs:
        rows = evaluation.read_rows(run.path / "episodes.parquet")
        for (name, _, balls, aim, sim, *_), part in rows.groupby(
            ["method", "columns", "balls", "ball_aim", "sim", "message_period", "message_delay", "message_loss"],
            sort=False,
        ):
            hits, count = int(part["cfr"].sum()), len(part)
            low, high = wilson(hits, count)
            fm = evaluation.mean_fm(part)
            scene = ", ".join(counted(int(part[axis].iloc[0]), axis[:-1]) for axis in AXES)
            scene += f" aimed at {aim}" if balls else ""
            scene += f", {sim}" if several else ""
            scene += talk(part)
            rate, interval = f"{hits / count:.3f} ({hits} of {count})", f"{low:.3f} to {high:.3f}"
            lines.append((name, scene, rate, interval, "none succeeded" if fm is None else f"{fm:.3f}"))
            failed += [(name, scene, why, n, f"{run.id}:{row}") for why, n, row in evaluation.reasons(part)]
    console.table(("method", "scene", "CFR", "95 % interval", "FM of successes"), lines)
    if failed:
        console.table(("method", "scene", "failed by", "episodes", "one of them, for replay"), failed)
    for sentence in dict.fromkeys(filter(None, (budget(run.record["method"]) for run in runs))):
        console.say(sentence)


def talk(rows: "pd.DataFrame") -> str:
    """What messages between drones suffered in a scene's rows; nothing where there were none."""
    period, delay, loss = (float(rows[f"message_{name}"].iloc[0]) for name in ("period", "delay", "loss"))
    return f", messages {1000 * delay:g} ms late, {loss:.0%} lost" if period else ""


def budget(method: dict[str, Any]) -> str:
    """What a learned baseline's training had of the published one; nothing about other methods."""
    if "published_steps" not in method:
        return ""
    minutes = f" in {method['minutes']:g} min" if "minutes" in method else ""
    share = method["steps"] / method["published_steps"]
    return (
        f"{method['name']} was trained for {method['steps']:,} steps{minutes}, {share:.2%} of the "
        f"{method['published_steps']:,} that were published"
    )
