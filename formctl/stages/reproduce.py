"""The paper's whole pipeline as one resumable chain of stages: what ``formctl reproduce`` does.

search -> best weights -> curriculum training -> evaluation on a stored bank -> columns sweep -> report. A stage is left
out when the store has a finished run of the same fingerprint: all settings that its result depends on, and the
fingerprints of the stages before it. The same command again goes on where it stopped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from formctl import budget, store
from formctl.console import duration, say, table, warn
from formctl.engines import workers
from formctl.evaluation import methods, scenes, suite
from formctl.evaluation.methods import Method
from formctl.evaluation.scenes import EvaluationScene
from formctl.evaluation.selection import RecordingSelection
from formctl.search import results
from formctl.settings import Config, build, compose
from formctl.stages import evaluate, rates_table, report, search, train
from formctl.store import LiveRun, Run, provenance
from formctl.store.compare import fingerprint

SANITY = ("straight_line", "hover")
"""Agents that avoid nothing: the floor under every figure."""

SWEPT = ("straight_line",)
"""Sanity agents of the sweep; one that never leaves the start has the same row everywhere."""

COLUMNS = (5, 10, 15, 20)
"""Columns sweep (paper, Sec. VI-A2)."""


@dataclass
class Graph:
    """What the stages share, and what they did: stage name -> fingerprint, run and whether it was there already."""

    config: Config
    words: list[str]
    name: str
    live: LiveRun
    done: dict[str, dict[str, Any]] = field(default_factory=dict)

    def stage(self, name: str, fingerprint: str, kind: str, make: Callable[[Run | None], Run]) -> Run:
        """The finished run of a stage, from the store or made now; ``make`` gets an unfinished one to go on with."""

        same = [run for run in store.scan(self.config.runs, kind=kind) if run.record.get("fingerprint") == fingerprint]
        finished = next((run for run in same if run.status == "done"), None)
        say(f"stage {name}: {f'there already ({finished.id})' if finished else 'running'}")
        run = finished or make(next(iter(same), None))
        self.note(name, fingerprint, run, finished is not None)
        return run

    def note(self, name: str, fingerprint: str, run: Run, there: bool) -> None:
        """Put a finished stage on the record; ``there``: the store had it."""
        self.done[name] = {"fingerprint": fingerprint, "run": run.id, "found": there}
        runs = dict.fromkeys(entry["run"] for entry in self.done.values())
        self.live.update(result={"stages": self.done}, parents=list(runs))


def reproduce(overrides: Sequence[str] = (), *, plan: bool = False) -> None:
    """Run every stage, or fly every cell of ``survey=``, that the store lacks, then the report.

    With ``plan`` only what is there and what would be run is said.
    """
    words = list(overrides)
    config = compose(words)
    given = any(word.startswith("name=") for word in words)
    name = config.name if given else config.survey.name if config.survey else config.profile
    if plan:
        announce_suite(config, words) if config.survey else announce(config, name)
        return
    try:
        fly_suite(config, words, name) if config.survey else execute(config, words, name)
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt(f"{str(stop).split(';')[0]}; the same command again goes on from there") from stop


def execute(config: Config, words: list[str], name: str) -> None:
    """Run every stage that is not done yet, then the report."""
    run = open_run(config, name)
    if run.status != "done":
        announce(config, name)
    with run.work() as live:
        graph = Graph(config, [word for word in words if not word.startswith("name=")], name, live)
        evaluations = evaluate_policy(graph, train_policy(graph, search_weights(graph)))
        folder, written = report.build(config.runs, config.profile, parents=tuple(run.id for run in evaluations))
        live.update(result={"stages": graph.done, "report": str(folder)})
    report.show(written, folder)


def fly_suite(config: Config, words: list[str], name: str) -> None:
    """Fly every cell of the survey that the store lacks, then the report."""
    build.use_threads(config)
    planned = announce_suite(config, words)
    run = open_run(config, name)
    with run.work() as live:
        for number, cell in enumerate(planned.missing, start=1):
            say(f"cell {number} of {len(planned.missing)}: {cell.part}, {cell.method.name}")
            selection = RecordingSelection.parse(cell.record) if cell.record else None
            evaluate.evaluate_method(cell.config, cell.method, [cell.scene], workers.cores(), selection)
        folder, written = report.build(config.runs, config.profile)
        live.update(result={"cells": len(planned.cells), "flown": len(planned.missing), "report": str(folder)})
    report.show(written, folder)


def announce_suite(config: Config, words: list[str]) -> suite.SuitePlan:
    """Say which cells of the survey are there and which are missing."""
    planned = suite.plan(config, words)
    columns = ("part", "method", "scenes x episodes", "there")
    assert config.survey is not None
    table(columns, planned.rows(), title=f"survey {config.survey.name} (profile {config.profile})")
    for line in planned.left_out:
        warn(line)
    episodes = sum(len(cell.scene.bank) for cell in planned.missing)
    say(f"{len(planned.missing)} of {len(planned.cells)} cells have to be flown: {episodes:,} episodes")
    return planned


def open_run(config: Config, name: str) -> Run:
    """The newest reproduction of that name if its settings are these, or a new one."""
    digest = fingerprint(config.tree)
    run = store.latest(config.runs, "reproduce", name)
    if run is not None and run.record.get("fingerprint") == digest:
        return run
    return provenance.new_run(config, "reproduce", name, fingerprint=digest)


def announce(config: Config, name: str) -> None:
    """Say what the whole is about to spend when nothing is done yet."""
    trials, steps = config.search.trials, config.search.steps
    minutes = budget.training_minutes(config, trials * steps + config.train.steps)
    about = f", its trainings about {duration(60 * minutes)} as earlier ones here went" if minutes else ""
    flights = len(SANITY) + 1, config.eval.episodes, len(SWEPT) + 1, len(COLUMNS)
    say(f"reproduce {name} (profile {config.profile}), stages that are done already left out:")
    say(f"  search of {trials} x {steps:,} steps, training of {config.train.steps:,} steps")
    say("  evaluation of {} methods x {} episodes, sweep of {} methods x {} scenes".format(*flights))
    say(f"  together {budget.room(3 * (trials + 1) * budget.CHECKPOINT, config.runs)}{about}")
    for line in train.described(config, "the winner of the search"):
        say(f"  {line}")


def search_weights(graph: Graph) -> Run:
    """Stage 1: the weight search, brought to its total."""
    config = graph.config
    say("stage search")
    run = search.execute(config, graph.name)
    settings = {key: config.tree[key] for key in (*search.SHARED, "search", "seed")}
    graph.note("search", fingerprint(settings), run, False)
    results.show_best(graph.name, search.view_of(run, None).rows())
    return run


def train_policy(graph: Graph, study: Run) -> Run:
    """Stage 2: the curriculum with the study's best weights."""
    config, origin = train.compose_training([*graph.words, f"name={graph.name}", f"weights=@{graph.name}/best"])
    groups = ("scenario", "drone", "observation", "reward", "weights", "encoder", "algo", "curriculum", "seed", "sim")
    settings = {key: config.tree[key] for key in groups} | {"steps": config.train.steps, "study": study.id}
    digest = fingerprint(settings)

    def make(stopped: Run | None) -> Run:
        if stopped is None:
            return train.execute(config, origin=origin, fingerprint=digest)
        train.fit(stopped, config)
        return stopped

    return graph.stage("train", digest, "train", make)


def evaluate_policy(graph: Graph, trained: Run) -> list[Run]:
    """The policy and the sanity agents on the stored bank, then the sweep over columns."""
    policy = methods.policy(str(trained.path), graph.config.runs)
    agents = {name: methods.baseline(name) for name in SANITY}
    words = [*graph.words, f"name={graph.name}"]
    config, drawn = scenes.load(compose(words), bank(graph))
    runs = [fly(graph, f"eval {method.name}", config, method, drawn) for method in (policy, *agents.values())]
    static = compose([*(word for word in words if not word.startswith("scenario")), "scenario=static"])
    swept = scenes.draw(static, {"columns": COLUMNS})
    for method in (policy, *(agents[name] for name in SWEPT)):
        runs.append(fly(graph, f"sweep {method.name}", static, method, swept))
    rates_table.show(runs)
    return runs


def bank(graph: Graph) -> Path:
    """The bank of the reproduction, stored in its folder; drawn again it would be the same."""
    path = graph.live.path / "bank.npz"
    if not path.exists():
        scenes.save_bank(path, graph.config.scenario, graph.config.eval.episodes, graph.config.eval.seed)
    return path


def fly(graph: Graph, stage: str, config: Config, method: Method, drawn: Sequence[EvaluationScene]) -> Run:
    """One method through the scenes, unless the store has those very rows."""
    digest = fingerprint(evaluate.dependencies(config, method, drawn))

    def make(stopped: Run | None) -> Run:
        (run,) = evaluate.run_all([evaluate.plan(config, [method], drawn)], fingerprint=digest)
        return run

    return graph.stage(stage, digest, "eval", make)
