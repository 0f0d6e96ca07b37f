"""``formctl reproduce``: the paper's whole pipeline as one resumable chain of stages.

search -> best weights -> curriculum training -> evaluation on a stored bank -> columns sweep -> report. A stage is left
out when the store has a finished run of the same fingerprint: all settings that its result depends on, and the
fingerprints of the stages before it. The same command again goes on where it stopped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.commands.options import Overrides, ShowConfig, configs

if TYPE_CHECKING:
    from formctl.flying.evaluation import Scene
    from formctl.flying.methods import Method
    from formctl.flying.survey import Plan
    from formctl.settings import Config
    from formctl.store import LiveRun, Run

SANITY = ("straight_line", "hover")
"""Agents that avoid nothing: the floor under every figure."""

SWEPT = ("straight_line",)
"""Sanity agents of the sweep; one that never leaves the start has the same row everywhere."""

COLUMNS = (5, 10, 15, 20)
"""Columns sweep (paper, Sec. VI-A2)."""


@dataclass
class Graph:
    """What the stages share, and what they did: stage name -> fingerprint, run and whether it was there already."""

    config: "Config"
    words: list[str]
    name: str
    live: "LiveRun"
    done: dict[str, dict[str, Any]] = field(default_factory=dict)

    def stage(self, name: str, fingerprint: str, kind: str, make: "Callable[[Run | None], Run]") -> "Run":
        """The finished run of a stage, from the store or made now; ``make`` gets an unfinished one to go on with."""
        from formctl import store
        from formctl.console import say

        same = [run for run in store.scan(self.config.runs, kind=kind) if run.record.get("fingerprint") == fingerprint]
        finished = next((run for run in same if run.status == "done"), None)
        say(f"stage {name}: {f'there already ({finished.id})' if finished else 'running'}")
        run = finished or make(next(iter(same), None))
        self.note(name, fingerprint, run, finished is not None)
        return run

    def note(self, name: str, fingerprint: str, run: "Run", found: bool) -> None:
        """Put a finished stage on the record."""
        self.done[name] = {"fingerprint": fingerprint, "run": run.id, "found": found}
        runs = dict.fromkeys(entry["run"] for entry in self.done.values())
        self.live.update(result={"stages": self.done}, parents=list(runs))


def command(
    overrides: Overrides = None,
    plan: Annotated[bool, typer.Option("--plan", help="Say what is there and what would be run, and stop.")] = False,
    cfg: ShowConfig = False,
) -> None:
    """The whole pipeline as one resumable graph of stages: profile=smoke, laptop or paper.

    With survey=paper: every flight of the report that the store lacks, by the policies it has and by all baselines.
    """
    words = list(overrides or [])
    (config,) = configs(words, show=cfg)
    given = any(word.startswith("name=") for word in words)
    name = config.name if given else config.survey.name if config.survey else config.profile
    if plan:
        announce_survey(config, words) if config.survey else announce(config, name)
        return
    try:
        execute_survey(config, words, name) if config.survey else execute(config, words, name)
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt(f"{str(stop).split(';')[0]}; the same command again goes on from there") from stop


def execute(config: "Config", words: list[str], name: str) -> None:
    """Run every stage that is not done yet, then the report."""
    from formctl.commands import report

    run = open_run(config, name)
    if run.status != "done":
        announce(config, name)
    with run.work() as live:
        graph = Graph(config, [word for word in words if not word.startswith("name=")], name, live)
        trained = train(graph, search(graph))
        flown = evaluate(graph, trained)
        folder, written = report.build(config.runs, config.profile, parents=tuple(run.id for run in flown))
        live.update(result={"stages": graph.done, "report": str(folder)})
    report.show(written, folder)


def execute_survey(config: "Config", words: list[str], name: str) -> None:
    """Fly every cell of the survey that the store lacks, then the report."""
    from formctl.commands import eval as command
    from formctl.commands import report
    from formctl.console import say
    from formctl.engines import workers
    from formctl.flying.keeping import Choice
    from formctl.settings import build

    build.use_threads(config)
    planned = announce_survey(config, words)
    run = open_run(config, name)
    with run.work() as live:
        for number, cell in enumerate(planned.missing, start=1):
            say(f"cell {number} of {len(planned.missing)}: {cell.part}, {cell.method.name}")
            choice = Choice.parse(cell.record) if cell.record else None
            command.fly_method(cell.config, cell.method, [cell.scene], workers.cores(), choice, {})
        folder, written = report.build(config.runs, config.profile)
        live.update(result={"cells": len(planned.cells), "flown": len(planned.missing), "report": str(folder)})
    report.show(written, folder)


def announce_survey(config: "Config", words: list[str]) -> "Plan":
    """Say which cells of the survey are there and which are missing."""
    from formctl import console
    from formctl.flying import survey

    planned = survey.plan(config, words)
    columns = ("part", "method", "scenes x episodes", "there")
    assert config.survey is not None
    console.table(columns, planned.rows(), title=f"survey {config.survey.name} (profile {config.profile})")
    for line in planned.left_out:
        console.warn(line)
    missing = planned.missing
    episodes = sum(len(cell.scene.bank) for cell in missing)
    console.say(f"{len(missing)} of {len(planned.cells)} cells have to be flown: {episodes:,} episodes")
    return planned


def open_run(config: "Config", name: str) -> "Run":
    """The newest reproduction of that name if its settings are these, or a new one."""
    from formctl import store
    from formctl.settings.compare import fingerprint
    from formctl.store import provenance

    digest = fingerprint(config.tree)
    run = store.latest(config.runs, "reproduce", name)
    if run is not None and run.record.get("fingerprint") == digest:
        return run
    return provenance.new_run(config, "reproduce", name, fingerprint=digest)


def announce(config: "Config", name: str) -> None:
    """Say what the whole is about to spend when nothing is done yet."""
    from formctl import spending
    from formctl.console import say
    from formctl.settings import build

    build.use_threads(config)
    trials, steps = config.search.trials, config.search.steps
    total = trials * steps + config.train.steps
    calibration = spending.calibrate(build.training(config))
    flown = trials * config.search.episodes + (len(SANITY) + 1 + (len(SWEPT) + 1) * len(COLUMNS)) * config.eval.episodes
    seconds = spending.training_seconds(calibration, total) + spending.flying_seconds(config, flown)
    needed = 3 * (trials + 1) * calibration.bytes
    cost = spending.sentence(seconds, needed, config.runs, compiled=config.train.compile)
    flights = len(SANITY) + 1, config.eval.episodes, len(SWEPT) + 1, len(COLUMNS)
    say(f"reproduce {name} (profile {config.profile}), stages that are done already left out:")
    say(f"  search of {trials} x {steps:,} steps, training of {config.train.steps:,} steps")
    say("  evaluation of {} methods x {} episodes, sweep of {} methods x {} scenes".format(*flights))
    say(f"  together {cost}")


def search(graph: Graph) -> "Run":
    """Stage 1: the weight search, brought to its total."""
    from formctl.console import say
    from formctl.search import beginning, choosing, overview
    from formctl.settings.compare import fingerprint

    config = graph.config
    say("stage search")
    run, study = beginning.execute(config, graph.name)
    settings = {key: config.tree[key] for key in (*beginning.SHARED, "search", "seed")}
    graph.note("search", fingerprint(settings), run, False)
    choosing.show_best(graph.name, overview.top(study.ledger, 1)[0])
    return run


def train(graph: Graph, study: "Run") -> "Run":
    """Stage 2: the curriculum with the study's best weights."""
    from formctl.commands import train as command
    from formctl.settings import compose
    from formctl.settings.compare import fingerprint

    words = [*graph.words, f"name={graph.name}", f"weights=@{graph.name}/best"]
    config = compose(words, command.resolver(words))
    groups = ("scenario", "drone", "observation", "reward", "weights", "encoder", "algo", "curriculum", "seed", "sim")
    settings = {key: config.tree[key] for key in groups} | {"steps": config.train.steps, "study": study.id}
    digest = fingerprint(settings)

    def make(left: "Run | None") -> "Run":
        if left is None:
            return command.execute(config, fingerprint=digest)
        command.fit_run(left, config)
        return left

    return graph.stage("train", digest, "train", make)


def evaluate(graph: Graph, trained: "Run") -> "list[Run]":
    """The policy and the sanity agents on the stored bank, then the sweep over columns."""
    from formctl.commands import eval as command
    from formctl.flying import methods
    from formctl.settings import compose

    policy = methods.policy(str(trained.path), graph.config.runs)
    agents = {name: methods.baseline(name) for name in SANITY}
    words = [*graph.words, f"name={graph.name}"]
    config, scenes = command.stored(compose(words), bank(graph), [])
    runs = [fly(graph, f"eval {method.name}", config, method, scenes) for method in (policy, *agents.values())]
    static = compose([*(word for word in words if not word.startswith("scenario")), "scenario=static"])
    swept = command.drawn(static, {"columns": list(COLUMNS)})
    for method in (policy, *(agents[name] for name in SWEPT)):
        runs.append(fly(graph, f"sweep {method.name}", static, method, swept))
    command.show(runs)
    return runs


def bank(graph: Graph) -> Path:
    """The bank of the reproduction, stored in its folder; drawn again it would be the same."""
    from formctl.flying import evaluation

    path = graph.live.path / "bank.npz"
    if not path.exists():
        evaluation.save_bank(path, graph.config.scenario, graph.config.eval.episodes, graph.config.eval.seed)
    return path


def fly(graph: Graph, stage: str, config: "Config", method: "Method", scenes: "Sequence[Scene]") -> "Run":
    """One method through the scenes, unless the store has those very rows."""
    from formctl.commands import eval as command
    from formctl.flying import evaluation
    from formctl.settings.compare import fingerprint

    digest = fingerprint(command.settings(config, method, scenes))

    def make(left: "Run | None") -> "Run":
        (run,) = command.execute(config, evaluation.check(config, [method], scenes), scenes, fingerprint=digest)
        return run

    return graph.stage(stage, digest, "eval", make)
