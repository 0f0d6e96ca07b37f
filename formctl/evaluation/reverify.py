"""Rows of a published store flown again: a sample of them, from the policies and settings that lie beside them.

A method whose decisions rounding tips, and any method over radio (``Capabilities.portable``), can be held to its rows
on the processor that flew them only; on another one its flights are shown and decide nothing.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from envs.scenarios import select
from formctl import store
from formctl.evaluation import stored
from formctl.evaluation.flight import EpisodeWorker
from formctl.evaluation.rows import read_rows
from formctl.settings import build
from formctl.store import provenance
from formctl.store.files import StoreError

SECONDS = 60.0
"""No flight is begun later than that: with the last one, all of it stays under two minutes."""
SEED = 0
TOGETHER = 8
"""Rows of one scene that a batched method flies side by side."""


@dataclass(frozen=True)
class Reverification:
    """Rows of one evaluation, flown again."""

    run: store.Run
    method: str
    rows: int
    equal: int  # to the last bit
    difference: float  # the largest of the numbers, m or s
    wrong: str = ""  # what differs by more than arithmetic, or why nothing could be flown
    apart: str = ""  # the same, where it proves nothing: another processor, and a method that is not portable

    @property
    def verdict(self) -> str:
        """In words."""
        return self.wrong or (f"another processor, another course: {self.apart}" if self.apart else "confirmed")


def sample(root: Path, seconds: float = SECONDS, seed: int = SEED) -> Iterator[Reverification]:
    """Evaluations of a store in a random order, every method before any a second time, until ``seconds`` are over."""
    begun = time.monotonic()
    for run, generator in _shuffled(root, seed):
        if time.monotonic() - begun > seconds:
            return
        yield check(run, root, generator)


def check(run: store.Run, root: Path, generator: np.random.Generator) -> Reverification:
    """Fly some neighbouring rows of an evaluation again."""
    method = str(run.record["method"]["name"])
    try:
        rows = read_rows(run.path / "episodes.parquet")
        first = int(generator.integers(len(rows)))
        number, again, portable = fly_neighbours(stored.find(f"{run.path}:{first}", root))
    except ValueError as error:
        return Reverification(run, method, 0, 0, 0.0, str(error))
    outcome = _compared(run, method, rows.iloc[number : number + len(again)].reset_index(drop=True), again)
    return outcome if portable or _same_processor(run) else replace(outcome, wrong="", apart=outcome.wrong)


def fly_neighbours(episode: stored.StoredEpisode) -> tuple[int, pd.DataFrame, bool]:
    """The episode and its neighbours in the same scene: number of the first row, rows, whether they are portable.

    A planner flies the one episode alone.
    """
    build.use_threads(episode.config)
    bank = episode.scene.bank
    worker = EpisodeWorker.of(episode.method, episode.scene.world, episode.config)
    count = min(TOGETHER, len(bank)) if worker.batched else 1
    place = min(episode.episode, len(bank) - count)
    rows = pd.DataFrame(worker.fly(select(bank.scenarios, slice(place, place + count))))
    return episode.number - (episode.episode - place), rows, worker.portable


def _same_processor(run: store.Run) -> bool:
    return bool(run.record["provenance"]["host"]["processor"] == provenance.processor())


def _shuffled(root: Path, seed: int) -> Iterator[tuple[store.Run, np.random.Generator]]:
    """Finished evaluations, the methods taking turns."""
    generator = np.random.default_rng(seed)
    turns: dict[str, list[store.Run]] = {}
    for run in sorted(store.scan(root, kind="eval", status="done"), key=lambda run: run.id):
        facts = run.record["method"]
        turns.setdefault(f"{facts['name']} {facts['run']}", []).append(run)
    for runs in turns.values():
        generator.shuffle(runs)
    while turns := {name: runs for name, runs in turns.items() if runs}:
        for runs in turns.values():
            yield runs.pop(), generator


def _compared(run: store.Run, method: str, before: pd.DataFrame, again: pd.DataFrame) -> Reverification:
    """How far the rows are apart, over every column that both have."""
    shared = [name for name in again.columns if name in before.columns]
    same = np.ones(len(again), bool)
    largest, wrong = 0.0, ""
    for name in shared:
        ours, theirs = again[name].to_numpy(), before[name].to_numpy()
        if np.issubdtype(ours.dtype, np.floating):
            gap = _gap(ours, theirs)
            same &= gap == 0
            largest = max(largest, float(gap.max()))
            wrong = wrong or (f"{name} differs by {gap.max():.3g}" if gap.max() > stored.CLOSE else "")
        else:
            differs = ours != theirs
            same &= ~differs
            wrong = wrong or (f"{name} differs in {int(differs.sum())} rows" if differs.any() else "")
    return Reverification(run, method, len(again), int(same.sum()), largest, wrong)


def _gap(ours: Any, theirs: Any) -> np.ndarray:
    """Absolute differences; equal infinities and two missing values are 0 apart."""
    ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
    equal = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
    with np.errstate(invalid="ignore"):
        gap = np.abs(ours - theirs)
    return np.where(equal, 0.0, np.where(np.isfinite(gap), gap, np.inf))


def refuse(outcomes: list[Reverification]) -> None:
    """Raise StoreError where nothing could be flown at all."""
    if not any(outcome.rows for outcome in outcomes):
        reason = outcomes[0].wrong if outcomes else "it has no finished evaluation"
        raise StoreError(f"no row could be flown again: {reason}")
