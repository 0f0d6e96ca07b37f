"""One training in a run folder: metrics, checkpoints, the best policy so far, and a clean stop."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol

from algos import checkpoint, compilation
from algos.learner import TrainingDiverged
from algos.replicas import ALONE, Replicas
from algos.trainer import Progress, Trainer, TrainSettings
from formctl import trackers
from formctl.console import say
from formctl.errors import RunFailed
from formctl.interrupts import handled
from formctl.settings.schema import LoggerSpec, TrainSpec
from formctl.store import LiveRun
from formctl.store.files import StoreError, disk_errors

if TYPE_CHECKING:
    from algos.policy import Policy

Listen = Callable[[Progress, "Policy"], None]
"""Hears each update, with the policy as it is then."""


class Judge(Protocol):
    """A small evaluation that tells which policy of a training is kept."""

    def __call__(self, policy: "Policy") -> dict[str, float]:
        """Figures of ``policy``; ``score`` decides, higher is better."""
        ...


@dataclass
class Fit:
    """The state of one training that a checkpoint holds beside the trainer's own."""

    live: LiveRun
    trainer: Trainer
    spec: TrainSpec
    judge: Judge | None
    meta: dict[str, Any]  # plain facts about the training, stored in the policy file
    steps: int = 0
    judged: int = 0  # steps of the last judgement
    best: dict[str, Any] = field(default_factory=dict)

    def resume(self, start: "Policy | None") -> None:
        """Go on from ``checkpoints/latest.pt`` where there is one, else from the policy ``start``, or from chance.

        A policy to start from is judged first: what is kept in the end is no worse in the judge's eyes.
        """
        path = self.live.checkpoint()
        if not path.exists():
            self.live.rewind(0)
            if start is not None:
                self.trainer.begin_from(start)
                self.consider()
            return
        content = checkpoint.load(path)
        states = [content["trainer"], *content.get("replicas", [])]  # one process's have no others
        self.trainer.load_states(states)
        if len(states) != (now := self.trainer.replicas.size):
            note = f"{now} processes went on after {len(states)} at {content['steps']:,} steps: episodes began anew"
            say(note)
            self.live.update(notes=[*self.live.record.get("notes", []), note])
        self.steps, self.judged, self.best = content["steps"], content["judged"], content["best"]
        self.live.rewind(self.steps)

    def save(self) -> None:
        """Write ``latest.pt``; the file that was there stays whole until the new one is."""
        self._write(self.live.checkpoint())
        self.live.keep_time()

    def consider(self) -> dict[str, float]:
        """Judge the policy of now; the best so far becomes ``best.pt`` and ``policy.pt``. Returns what to log."""
        self.judged = self.steps
        if self.judge is None:
            return {}
        figures = self.judge(self.trainer.policy)
        if not self.best or figures["score"] > self.best["score"]:
            self.best = {**figures, "steps": self.steps}
            self._write(self.live.checkpoint("best"))
            self.keep_policy()
        return {f"judge/{key}": value for key, value in figures.items()}

    def keep_policy(self) -> None:
        """Write ``policy.pt``: what is flown."""
        with written():
            self.trainer.policy.save(
                self.live.path / "policy.pt", self.meta | {"steps": self.steps, "minutes": round(self.live.minutes, 1)}
            )

    def _write(self, path: Path) -> None:
        own = {"steps": self.steps, "judged": self.judged, "best": self.best}
        with disk_errors(path):
            path.parent.mkdir(exist_ok=True)
        first, *others = self.trainer.states()
        with written():
            checkpoint.save(path, {"trainer": first, **({"replicas": others} if others else {}), **own})


def train(
    live: LiveRun,
    settings: TrainSettings,
    spec: TrainSpec,
    *,
    meta: dict[str, Any],
    judge: Judge | None = None,
    start: "Policy | None" = None,
    logger: LoggerSpec | None = None,
    listen: Listen = lambda progress, policy: None,
    compiling: compilation.Listen = lambda name, ready, pieces: None,
    replicas: Replicas = ALONE,
) -> Fit:
    """Train in ``live`` from its latest checkpoint, or from the start, to the end of the budget.

    ``listen`` is called after every update, ``compiling`` before every piece that is compiled or loaded.
    ``start`` is the policy that a new training goes on from; chance where there is none. ``replicas`` are the processes
    that train together, of which this is the first.
    Raises KeyboardInterrupt, with the command that goes on, after Ctrl-C and a checkpoint; RunFailed when the training
    diverges; StoreError when the disk is full. The last good checkpoint survives all of them.
    """
    replicas.tell(settings)
    fit = Fit(live, Trainer(settings, compiling=compiling, replicas=replicas), spec, judge, meta)
    fit.resume(start)
    compiler = fit.trainer.compiler
    with (
        compiler_log(live.path / "compiler.log"),
        graceful(lambda: compiler.busy) as stop,
        trackers.opened(live, logger, fit.steps) as track,
    ):
        try:
            _loop(fit, stop, track, listen)
        except TrainingDiverged as error:
            live.update(result={"diverged": error.record, "steps": fit.steps})
            kept = f"the last good checkpoint is {live.checkpoint()}" if live.checkpoint().exists() else "no checkpoint"
            raise RunFailed(f"training diverged after {fit.steps:,} steps: {error}; {kept}") from error
    fit.save()
    if judge is None or not fit.best:
        fit.keep_policy()
    return fit


def _loop(fit: Fit, stop: "Stop", track: Callable[[dict[str, Any]], None], listen: Listen) -> None:
    saved, updates, period = time.monotonic(), 0, None
    for progress in fit.trainer.train():
        period_ended = period is not None and progress.period != period
        fit.steps, period, updates = progress.steps, progress.period, updates + 1
        last = progress.steps >= progress.total
        figures = dict(progress.metrics)
        if fit.judge is not None and (last or fit.steps - fit.judged >= fit.spec.judge_steps):
            figures |= fit.consider()
        if last or period_ended or updates % fit.spec.log_updates == 0 or "judge/score" in figures:
            track({"steps": fit.steps, "period": period, "minutes": round(fit.live.minutes, 4), **figures})
        listen(progress, fit.trainer.policy)
        if stop.requested:
            fit.save()
            raise KeyboardInterrupt(f"interrupted at {fit.steps:,} steps and saved in {fit.live.path}")
        due = time.monotonic() - saved > 60 * fit.spec.checkpoint_minutes
        if due or fit.steps >= fit.trainer.stage.last:  # what comes next may have to be compiled: nothing waits for it
            fit.save()
            saved = time.monotonic()


@contextmanager
def compiler_log(path: Path) -> Iterator[None]:
    """While the block lasts, what a C++ compiler says goes into a file at ``path``, made when there is something."""
    handler = logging.FileHandler(path, delay=True)
    level = compilation.log.level
    compilation.log.addHandler(handler)
    compilation.log.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        compilation.log.setLevel(level)
        compilation.log.removeHandler(handler)
        handler.close()


@contextmanager
def written() -> Iterator[None]:
    """A file that cannot be written is the store's trouble, not the training's."""
    try:
        yield
    except checkpoint.CheckpointError as error:
        raise StoreError(f"{error}; make room") from error


class Stop:
    """Whether the user asked to stop."""

    requested = False


@contextmanager
def graceful(compiling: Callable[[], bool] = lambda: False) -> Iterator[Stop]:
    """A first request to stop waits for the next update, where a checkpoint is whole; the second one stops at once.

    While ``compiling`` is true the first one stops at once too: an update may be minutes away.
    """
    stop = Stop()

    def request(number: int, frame: FrameType | None) -> None:
        if stop.requested:
            raise KeyboardInterrupt("stopped at once; the last checkpoint is kept")
        stop.requested = True
        if compiling():
            raise KeyboardInterrupt("interrupted while compiling; what was trained before is saved")
        say("stopping after this update; once more stops at once")

    with handled(request):
        yield stop
