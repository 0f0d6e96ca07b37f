"""One trial of the weight search: train with its weights, fly the study's bank, say how it went.

``run_trial`` takes plain data and returns plain data, so that any engine can run it anywhere the folder can be reached.
A trial is a run of its own inside the search's folder; run again after a crash, it goes on from its checkpoint.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from formctl import store
from formctl.engines.engine import Emit
from formctl.search.trials import Weights
from formctl.store import lock, provenance

if TYPE_CHECKING:
    from algos.policy import Policy
    from algos.trainer import Progress
    from formctl.settings import Config


@dataclass(frozen=True)
class TrialRequest:
    """What one trial needs to know."""

    search: str  # folder of the search run
    parent: str  # its id
    trial: int
    settings: dict[str, Any]  # composed tree of the trial's own training
    argv: list[str]

    @property
    def folder(self) -> Path:
        return Path(self.search) / "trials" / f"{self.trial:04d}"


def request(config: "Config", search: store.Run, trial: int, weights: Weights) -> TrialRequest:
    """Everything that trial ``trial`` of the search needs to know."""
    tree = settings(config, search.path.parent.name, trial, weights)
    return TrialRequest(str(search.path), search.path.name, trial, tree, provenance.argv())


def settings(config: "Config", study: str, trial: int, weights: Weights) -> dict[str, Any]:
    """The trial's own settings: the search's scenario and budget, these weights, one period from fresh weights."""
    tree = dict(config.tree)
    period = {"name": config.search.scenario.name, "share": 1, "scenario": {}, "start": "previous"}
    tree["name"] = f"{study}-{trial}"
    tree["scenario"] = tree["search"]["scenario"]
    tree["weights"] = {"name": f"trial={trial}"} | dict(
        zip(("formation", "flight", "obstacle", "action"), weights, strict=True)
    )
    tree["curriculum"] = {"name": "none", "periods": [period]}
    tree["train"] = tree["train"] | {"steps": config.search.steps}
    return tree


def run_trial(asked: TrialRequest, emit: Emit) -> dict[str, Any]:
    """Train, evaluate and return what the study keeps of the trial. ``emit`` hears steps and training figures."""
    from envs.bank import Bank
    from formctl import training
    from formctl.evaluation import methods
    from formctl.evaluation.evaluate import evaluate
    from formctl.evaluation.rows import rates, write_rows
    from formctl.evaluation.scenes import EvaluationScene
    from formctl.settings import build, restore

    config = restore(asked.settings)
    build.use_threads(config)
    run = _open(asked, config)

    value = curve(asked, config)

    reached = {"steps": 0, "total": config.train.steps, "value": None}

    def listen(progress: "Progress", policy: "Policy") -> None:
        reached.update(steps=progress.steps, total=progress.total)
        emit(reached | {"value": value(progress, policy)})

    with run.work() as live:
        facts = methods.facts(config, run.id)
        fit = training.train(
            live,
            build.training(config),
            config.train,
            meta={"method": facts, "profile": config.profile},
            logger=config.logger,
            listen=listen,
            compiling=lambda name, ready, pieces: emit(reached),  # a sign of life
        )
        bank = Bank.load(Path(asked.search) / "bank.npz")
        flown = methods.policy(str(live.path / "policy.pt"), config.runs)
        alive = {"steps": fit.steps, "total": fit.steps, "value": None}
        scene = EvaluationScene(build.world(config), bank)
        rows = evaluate(flown, [scene], config, lambda done: emit(alive))
        write_rows(live.path / "episodes.parquet", rows)
        outcome = rates(rows) | {
            "seed": config.seed,
            "budget": config.train.steps,
            "steps": fit.steps,
            "minutes": round(live.minutes, 4),
            "host": socket.gethostname(),
            "run": str(live.path.relative_to(asked.search)),
            "policy": str((live.path / "policy.pt").relative_to(asked.search)),
        }
        live.update(result=outcome)
    return outcome


def curve(asked: TrialRequest, config: "Config") -> "Callable[[Progress, Policy], float | None]":
    """What a learning curve shows: CFR of the training itself, with exploration noise; where trials may be pruned, SR
    on a small bank, counted at every tenth of the budget."""
    if config.search.pruner == "none":
        return lambda progress, policy: progress.metrics.get("train/cfr")

    from envs.bank import Bank
    from formctl.evaluation import methods
    from formctl.evaluation.evaluate import evaluate
    from formctl.evaluation.scenes import EvaluationScene
    from formctl.settings import build

    bank = Bank.create(config.scenario, config.search.pruner_episodes, build.held_out_seed(config.seed, "prune"))
    scene = EvaluationScene(build.world(config), bank)
    tenth = 0

    def rate(progress: "Progress", policy: "Policy") -> float | None:
        nonlocal tenth
        reached = 10 * progress.steps // progress.total
        if reached <= tenth:
            return None
        tenth = reached
        flown = methods.in_memory(f"trial {asked.trial}", config.seed, policy)
        return float(evaluate(flown, [scene], config)["sr"].mean())

    return rate


def _open(asked: TrialRequest, config: "Config") -> store.Run:
    """The trial's run, made now or left by an earlier sitting.

    Where somebody who lost the trial still holds the folder, the work is done anew in one beside it.
    """
    folder, number = asked.folder, 1
    while (folder / "run.json").exists():
        if not lock.is_held(folder / "run.lock"):
            return store.Run.open(folder)
        number += 1
        folder = asked.folder.with_name(f"{asked.trial:04d}-{number}")
    return provenance.new_run(
        config,
        "train",
        call=asked.argv,
        parents=[asked.parent],
        folder=folder,
        scenario=config.scenario.name,
        budget={"steps": config.train.steps, "episodes": config.search.episodes},
    )
