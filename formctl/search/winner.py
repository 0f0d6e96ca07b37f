"""Which trial of a study is the best, and which study a training takes its weights from."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import comb, inf
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.stats import wilson
from envs.vocabulary import Weights
from formctl import store
from formctl.search import table
from formctl.search.table import Row
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.settings import Config
    from formctl.store import Run

ALPHA = 0.05
"""Level, over all comparisons with the best, at which a trial is told from it."""

TASK = ("drone", "observation", "reward")
"""Groups that give a weight vector its meaning, beside the search's own scenario."""


def choose(trials: Sequence[Row]) -> Row:
    """The winner: of the trials that are not told from the highest SR the one of the lowest FM, then throttle change.

    Raises StoreError when no trial is done.
    """

    def order(trial: Row) -> tuple[float, float, int]:
        fm, change = (inf if trial.get(key) is None else trial[key] for key in ("fm", "throttle_change"))
        return fm, change, trial["trial"]

    return min(not_told_apart(trials), key=order)


def not_told_apart(trials: Sequence[Row]) -> list[Row]:
    """The finished trial of the highest SR and those whose SR is not significantly lower, highest SR first.

    All flew the same episodes, so the test is McNemar's exact one, Holm-adjusted over all other trials; trials of
    earlier versions, whose single episodes nobody kept, are within the 95 % interval of the best.
    Raises StoreError when no trial is done.
    """
    ranked = by_rate(trials)
    best, others = ranked[0], ranked[1:]
    if any(trial.get("episodes") is None for trial in ranked):
        low, _ = wilson(best["sr_k"], best["sr_n"])
        return [best, *(trial for trial in others if trial["sr"] >= low)]
    tested = sorted((mcnemar(best["episodes"], trial["episodes"]), trial["trial"]) for trial in others)
    told = set()
    for rank, (p, trial) in enumerate(tested):
        if p * (len(tested) - rank) > ALPHA:
            break
        told.add(trial)
    return [best, *(trial for trial in others if trial["trial"] not in told)]


def by_rate(trials: Sequence[Row]) -> list[Row]:
    """The finished trials, highest SR first, then lowest index. Raises StoreError when no trial is done."""
    done = [trial for trial in trials if trial["state"] == "done"]
    if not done:
        raise StoreError("no trial of the study is done yet; `formctl search --status` shows how far it is")
    return sorted(done, key=lambda trial: (-trial["sr"], trial["trial"]))


def mcnemar(first: str, second: str) -> float:
    """Two-sided p value of the exact test that two trials satisfy equally often; bits of the same episodes, in hex."""
    one, other = int(first, 16), int(second, 16)
    only_one, only_other = (one & ~other).bit_count(), (other & ~one).bit_count()
    return _sign_test(min(only_one, only_other), only_one + only_other)


@cache
def _sign_test(fewer: int, count: int) -> float:
    return min(1.0, 2 * sum(comb(count, k) for k in range(fewer + 1)) / 2**count)


def select(trials: Sequence[Row], which: str) -> Row:
    """The row that ``best`` or ``trial=K`` means. Raises StoreError for anything else."""
    if which == "best":
        return choose(trials)
    key, _, number = which.partition("=")
    if key != "trial" or not number.isdigit():
        raise StoreError(f"'{which}' is neither best nor trial=NUMBER")
    found = [trial for trial in trials if trial["trial"] == int(number)]
    if not found:
        raise StoreError(f"the study has no trial {number}; its trials are 0 to {len(trials) - 1}")
    return found[0]


def resolve_weights(reference: str, root: Path) -> Weights:
    """Weights of ``STUDY/best`` or ``STUDY/trial=K``, STUDY being a name, id or path of a search run."""
    run, which = table.split_reference(reference, root)
    return table.weights(select(table.read_rows(run.path), which))


@dataclass(frozen=True)
class SearchWinner:
    """The chosen trial of a study."""

    run: "Run"
    trial: int
    weights: Weights
    sr: float
    fresh: bool  # whether ``sr`` is of episodes that no trial was chosen on

    @property
    def reference(self) -> str:
        """What ``weights=@REFERENCE`` takes."""
        return f"{self.run.path}/trial={self.trial}"

    @property
    def sentence(self) -> str:
        """``trial 17 of stage1, SR 0.91 on fresh episodes``."""
        episodes = "fresh episodes" if self.fresh else "the episodes that it was chosen on"
        return f"trial {self.trial} of {self.run.path.parent.name}, SR {self.sr:.2f} on {episodes}"


def newest_winner(config: "Config") -> SearchWinner | None:
    """The winner of the newest finished search in the store whose task and profile are those of ``config``."""
    for run in store.scan(config.runs, kind="search", status="done", profile=config.profile):
        tree = run.config
        same = all(tree.get(group) == config.tree[group] for group in TASK)
        if same and tree["search"]["scenario"] == config.tree["search"]["scenario"]:
            try:
                trial = choose(table.read_rows(run.path))
            except StoreError:
                continue  # no trial of it can be read
            fresh = trial.get("sr_fresh") is not None
            sr = float(trial["sr_fresh" if fresh else "sr"])
            return SearchWinner(run, trial["trial"], table.weights(trial), sr, fresh)
    return None
