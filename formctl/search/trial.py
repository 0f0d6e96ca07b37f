"""One trial of the weight search: train with its weights, fly the study's bank, say how it went.

``run_trial`` takes plain data and returns plain data, so that any engine can run it anywhere the folder can be reached.
A trial is a run of its own inside the search's folder; run again after a crash, it goes on from its checkpoint.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from algos.policy import Policy
from algos.trainer import Progress
from envs.bank import Bank
from envs.vocabulary import OBJECTIVES, Weights
from formctl import store, training
from formctl.engines.engine import Emit
from formctl.evaluation import methods
from formctl.evaluation.evaluate import evaluate
from formctl.evaluation.rows import rates, write_rows
from formctl.evaluation.scenes import EvaluationScene
from formctl.settings import Config, build, restore
from formctl.store import lock, provenance


@dataclass(frozen=True)
class TrialRequest:
    """What one trial needs to know."""

    search: str  # folder of the search run
    parent: str  # its id
    trial: int
    label: str  # what it is called in messages
    folder: str  # its own, within the search's
    bank: str  # file of the episodes it is judged on, within the search's folder
    settings: dict[str, Any]  # composed tree of the trial's own training
    argv: list[str]

    @property
    def weights(self) -> str:
        """``formation 0.10, flight 0.20, obstacle 0.30, action 0.40``."""
        return ", ".join(f"{name} {self.settings['weights'][name]:.2f}" for name in OBJECTIVES)


def request(config: Config, search: store.Run, trial: int, weights: Weights) -> TrialRequest:
    """Everything that trial ``trial`` of the search needs to know."""
    tree = settings(config, search.path.parent.name, trial, weights)
    own = {"label": f"trial {trial}", "folder": f"trials/{trial:04d}", "bank": "bank.npz"}
    return TrialRequest(str(search.path), search.path.name, trial, settings=tree, argv=provenance.argv(), **own)


def settings(config: Config, study: str, trial: int, weights: Weights) -> dict[str, Any]:
    """The trial's own settings: the search's scenario and budget, these weights, one period from fresh weights."""
    tree = dict(config.tree)
    period = {"name": config.search.scenario.name, "share": 1, "scenario": {}, "start": "previous"}
    tree["name"] = f"{study}-{trial}"
    tree["scenario"] = tree["search"]["scenario"]
    tree["weights"] = {"name": f"trial={trial}"} | dict(zip(OBJECTIVES, weights, strict=True))
    tree["curriculum"] = {"name": "none", "periods": [period]}
    tree["train"] = tree["train"] | {"steps": config.search.steps, "processes": 1}
    return tree


def run_trial(asked: TrialRequest, emit: Emit) -> dict[str, Any]:
    """Train, evaluate and return what the study keeps of the trial. ``emit`` hears steps and training figures."""
    config = restore(asked.settings)
    build.use_threads(config)
    bank = Bank.load(Path(asked.search) / asked.bank)
    run = _open(asked, config, len(bank))
    curve = _curve(asked, config)

    reached = {"steps": 0, "total": config.train.steps, "value": None}

    def listen(progress: Progress, policy: Policy) -> None:
        reached.update(steps=progress.steps, total=progress.total)
        emit(reached | {"value": curve(progress, policy)})

    with run.work() as live:
        meta = {"method": methods.facts(config, run.id), "profile": config.profile}
        fit = training.train(
            live,
            build.training(config),
            config.train,
            meta=meta,
            logger=config.logger,
            listen=listen,
            compiling=lambda name, ready, pieces: emit(reached),  # a sign of life
        )
        alive = {"steps": fit.steps, "total": fit.steps, "value": None}
        scene = EvaluationScene(build.world(config), bank)
        flown = evaluate(
            methods.policy(str(live.path / "policy.pt"), config.runs), [scene], config, lambda n: emit(alive)
        )
        write_rows(live.path / "episodes.parquet", flown)
        outcome = figures(flown) | {
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


def figures(flown: pd.DataFrame) -> dict[str, Any]:
    """What a study keeps of the episodes of a trial: rates, means, and which of the episodes satisfied."""
    bits = "".join("1" if satisfied else "0" for satisfied in flown["sr"])
    return rates(flown) | {"episodes": f"{int(bits, 2):0{-(-len(bits) // 4)}x}"}


def _curve(asked: TrialRequest, config: Config) -> Callable[[Progress, Policy], float | None]:
    """What a learning curve shows: CFR of the training itself, with exploration noise; where trials may be pruned, SR
    on a small bank, counted at every tenth of the budget."""
    if config.search.pruner == "none":
        return lambda progress, policy: progress.metrics.get("train/cfr")
    bank = Bank.create(config.scenario, config.search.pruner_episodes, build.held_out_seed(config.seed, "prune"))
    scene = EvaluationScene(build.world(config), bank)
    tenth = 0

    def rate(progress: Progress, policy: Policy) -> float | None:
        nonlocal tenth
        reached = 10 * progress.steps // progress.total
        if reached <= tenth:
            return None
        tenth = reached
        method = methods.in_memory(asked.label, config.seed, policy)
        return float(evaluate(method, [scene], config)["sr"].mean())

    return rate


def _open(asked: TrialRequest, config: Config, episodes: int) -> store.Run:
    """The trial's run, made now or left by an earlier worker.

    Where somebody who lost the trial still holds the folder, the work is done anew in one beside it.
    """
    first = Path(asked.search) / asked.folder
    folder, number = first, 1
    while (folder / "run.json").exists():
        if not lock.is_held(folder / "run.lock"):
            return store.Run.open(folder)
        number += 1
        folder = first.with_name(f"{first.name}-{number}")
    return provenance.new_run(
        config,
        "train",
        call=asked.argv,
        parents=[asked.parent],
        folder=folder,
        scenario=config.scenario.name,
        budget={"steps": config.train.steps, "episodes": episodes},
    )
