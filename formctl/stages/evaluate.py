"""Policies and baselines on the same stored scenarios, one row per episode: what ``formctl eval`` does."""

import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.data.text import counted
from envs.vocabulary import METRIC_VERSION
from formctl import budget, store
from formctl.console import progress, say
from formctl.deployment import bodies
from formctl.engines import workers
from formctl.errors import ConfigError
from formctl.evaluation import evaluate as flights
from formctl.evaluation import methods, scenes
from formctl.evaluation.journal import EpisodeJournal
from formctl.evaluation.methods import Method
from formctl.evaluation.rows import rates, read_rows, write_rows
from formctl.evaluation.scenes import AXES, EvaluationScene
from formctl.evaluation.selection import RecordingSelection, TopRecordings
from formctl.settings import Config, build, compose, expand_sweep
from formctl.stages import rates_table
from formctl.store import Run, provenance
from formctl.store.compare import fingerprint

STOPPED = ("interrupted", "failed")
"""States of a run that its call goes on with."""

ROW = 500
"""Bytes of a row on disk, rounded up generously."""

SIMS = ("torch", "mujoco")
"""Physics that ``--sim`` can name."""


@dataclass(frozen=True)
class PlannedEvaluation:
    """Methods and scenes under one composition of the settings, checked against each other."""

    config: Config
    methods: tuple[Method, ...]
    scenes: tuple[EvaluationScene, ...]


def evaluate(
    overrides: Sequence[str] = (),
    *,
    policies: Sequence[str] = (),
    baselines: Sequence[str] = (),
    bank: Path | None = None,
    episodes: int | None = None,
    grid: Sequence[str] = (),
    body: str | None = None,
    sim: str | None = None,
    jobs: int | None = None,
    record: str | None = None,
    out: Path | None = None,
    multirun: bool = False,
) -> list[Run]:
    """Fly every method through every scene; one run of kind *eval* per method, composition and physics.

    Everything is checked before anything is flown. ``grid`` has axes (``columns=5,10``), ``sim`` physics and ``body``
    what computes policies (``torch,c``), separated by commas, ``record`` a selection of episodes (``worst=5``); ``out``
    takes all rows as well. Raises ConfigError.
    """
    axes, words = split_grid(grid, overrides)
    names, own, words = split_baselines(baselines, words)
    words += [] if episodes is None else [f"eval.episodes={episodes}"]
    refuse_contradictions(bool(policies or names), bank, bool(axes or episodes))
    selection = None if record is None else RecordingSelection.parse(record)
    computed_by = bodies.parse(body)
    planned = []
    for config in compose_on(physics_of(sim), words, multirun):
        chosen = chosen_methods(config, policies, names, own, words)
        config, drawn = (config, scenes.draw(config, axes)) if bank is None else scenes.load(config, bank, words)
        if selection is not None:
            selection.check(sum(len(scene.bank) for scene in drawn))
        planned.append(plan(config, bodies.embodied(chosen, computed_by, config), drawn))
    runs = run_all(planned, jobs, selection)
    rates_table.show(runs)
    bodies.show_pairs(runs)
    for run in runs:
        say(f"rows: {run.path / 'episodes.parquet'}")
        if selection is not None:
            recorded = ", ".join(run.record["recordings"]) or "none"
            say(f"recorded: {recorded} in {run.path}; formctl replay FILE shows one")
    if out is not None:
        tables = [read_rows(run.path / "episodes.parquet") for run in runs]
        write_rows(out, pd.concat(tables, ignore_index=True))
    return runs


def plan(config: Config, chosen: Sequence[Method], drawn: Sequence[EvaluationScene]) -> PlannedEvaluation:
    """The evaluation. Raises ValueError where a method cannot fly one of the scenes."""
    flights.check(config, chosen, drawn)
    return PlannedEvaluation(config, tuple(chosen), tuple(drawn))


def run_all(
    planned: Sequence[PlannedEvaluation],
    jobs: int | None = None,
    selection: RecordingSelection | None = None,
    **fields: Any,
) -> list[Run]:
    """Fly what is planned; one run per method. ``jobs`` None means one process per core.

    ``fields`` are recorded with the runs. What was finished by the same call before it was interrupted is not flown
    again, and an interrupted run goes on.
    """
    fields = {"invocation": invocation_of(planned)} | fields
    processes = jobs or workers.cores()
    runs = []
    for evaluation in planned:
        announce(evaluation)
        build.use_threads(evaluation.config)
        for method in evaluation.methods:
            runs.append(evaluate_method(evaluation.config, method, evaluation.scenes, processes, selection, fields))
    return runs


def announce(evaluation: PlannedEvaluation) -> None:
    """Say what is about to be flown. Raises StoreError when the disk is too small for it."""
    config, count = evaluation.config, sum(len(scene.bank) for scene in evaluation.scenes)
    room = budget.room(ROW * len(evaluation.methods) * count, config.runs)
    names = ", ".join(method.name for method in evaluation.methods)
    say(f"about to fly {names}: {counted(count, 'episode')} each (sim {config.sim}): {room}")


def evaluate_method(
    config: Config,
    method: Method,
    drawn: Sequence[EvaluationScene],
    jobs: int,
    selection: RecordingSelection | None = None,
    fields: Mapping[str, Any] | None = None,
) -> Run:
    """One method through every scene, in a run of its own, or in the one where the same call was interrupted."""
    config = method.settings_of(config)
    run = open_run(config, method, drawn, fields or {})
    if run.status == "done":
        say(f"{method.name}: flown before the interruption, in {run.id}")
        return run
    journal = EpisodeJournal(run.path / "flown.jsonl")
    before, count = len(journal.read()), sum(len(scene.bank) for scene in drawn)
    if before:
        episodes = f"{counted(before, 'episode')} {'was' if before == 1 else 'were'} flown"
        say(f"{method.name}: {episodes} before the interruption of {run.id}")
    with run.work() as live, progress(f"eval {method.name}", count, "episodes", start=before) as bar:
        recordings = None if selection is None else TopRecordings(selection, live.path / "mcap")
        rows = flights.evaluate(method, drawn, config, bar.update, recordings, jobs=jobs, journal=journal.path)
        write_rows(live.path / "episodes.parquet", rows)
        if recordings is not None:
            live.update(recordings=[f"mcap/{path.name}" for path in recordings.write()])
        live.update(result=rates(rows))
        journal.remove()
    return run


def open_run(config: Config, method: Method, drawn: Sequence[EvaluationScene], fields: Mapping[str, Any]) -> Run:
    """The run that stopped in these very flights, or finished them in this call, by the same program; or a new one."""
    digest = flights_digest(config, method, drawn)
    for run in store.scan(config.runs, kind="eval", name=config.name, profile=config.profile):
        this_call = "invocation" in fields and run.record.get("invocation") == fields["invocation"]
        if run.record.get("flights") == digest and (run.status in STOPPED or (run.status == "done" and this_call)):
            return run
    banks = [scene.record for scene in drawn]
    return provenance.new_run(
        config,
        "eval",
        tree=config.tree | {"baseline": method.settings},
        parents=method.parents,
        method=method.facts,
        scenario=config.scenario.name,
        bank=banks[0] if len(banks) == 1 else None,
        banks=banks,
        flights=digest,
        **fields,
    )


def invocation_of(planned: Sequence[PlannedEvaluation]) -> str:
    """What the runs of one call have in common: that of the same call that was interrupted, or something new."""
    for one in planned:
        asked = {flights_digest(method.settings_of(one.config), method, one.scenes) for method in one.methods}
        for run in store.scan(one.config.runs, kind="eval", name=one.config.name, profile=one.config.profile):
            if run.status in STOPPED and run.record.get("flights") in asked and "invocation" in run.record:
                return str(run.record["invocation"])
    return secrets.token_hex(4)


def flights_digest(config: Config, method: Method, drawn: Sequence[EvaluationScene]) -> str:
    """Digest of what the rows of an evaluation depend on, the program included."""
    return fingerprint({"settings": dependencies(config, method, drawn), "sources": provenance.sources()})


def dependencies(config: Config, method: Method, drawn: Sequence[EvaluationScene]) -> dict[str, Any]:
    """Everything that the rows of an evaluation depend on, but for the program itself."""
    chosen: dict[str, Any] = {key: config.tree[key] for key in ("eval", "drone", "observation", "sim", "deploy")}
    chosen |= {"banks": [scene.bank.sha256 for scene in drawn], "metric_version": METRIC_VERSION}
    return chosen | {"method": method.facts, "baseline": method.settings or {}}


def chosen_methods(
    config: Config, policies: Sequence[str], names: Sequence[str], own: Sequence[str], words: Sequence[str]
) -> list[Method]:
    """The policies and baselines of a call, each once; ``own`` are settings of the baselines. Raises ValueError."""
    chosen = [methods.policy(text, config.runs) for text in dict.fromkeys(policies)]
    chosen += [methods.baseline(name, own) for name in dict.fromkeys(names)]
    methods.check_observation(config, chosen, words)
    return chosen


def physics_of(text: str | None) -> list[str]:
    """The physics of ``--sim``; none where it was not given. Raises ConfigError for one that does not exist."""
    asked = [part.strip() for part in text.split(",")] if text else []
    if unknown := [part for part in asked if part not in SIMS]:
        raise ConfigError(f"--sim {text} cannot be used: there is no physics {unknown[0]!r}, only {' and '.join(SIMS)}")
    return list(dict.fromkeys(asked))


def compose_on(physics: Sequence[str], words: Sequence[str], multirun: bool = False) -> Iterator[Config]:
    """The composed settings on every physics, or on that of ``sim=`` where there is none to choose."""
    for chosen in [[f"sim={one}"] for one in physics] or [[]]:
        every = [*words, *chosen]
        yield from map(compose, expand_sweep(every) if multirun else [every])


def refuse_contradictions(anything: bool, bank: Path | None = None, drawn: bool = False) -> None:
    """Raise ConfigError for a call without a method, and for a bank whose episodes should also be drawn."""
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
    own = [text for text in overrides if grid and text.partition("=")[0] in AXES]
    axes: dict[str, list[int]] = {}
    for text in [*grid, *own]:
        key, _, values = text.partition("=")
        if key not in AXES or not all(value.isdecimal() for value in values.split(",")):
            raise ConfigError(f"--grid {text} cannot be used: write columns=5,10,15,20 or balls=1,2,3")
        axes[key] = list(dict.fromkeys([*axes.get(key, []), *map(int, values.split(","))]))
    return axes, [text for text in overrides if text not in own]
