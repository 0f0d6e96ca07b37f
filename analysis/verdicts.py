"""What decides a claim: its parts, figures with intervals held against limits, methods paired on shared episodes.

Whatever the interval or the test leaves open is undecided: it neither confirms a claim nor refutes it.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from analysis import flown, stats
from analysis.stats import Mean, Rate

if TYPE_CHECKING:
    import pandas as pd

SLIGHT = 0.10
"""Of a rate, lost: still slight degradation."""
GOOD = 0.80
"""A rate from here on is good."""
ALPHA = 1 - stats.CONFIDENCE
"""p value, Holm-adjusted over a claim's comparisons of one kind, below which one of two methods is ahead."""

UNDECIDED = "undecided: too few episodes"


class Part(NamedTuple):
    """One checkable piece of a claim: what was seen, whether it holds (None: not known), what would measure it."""

    seen: str
    holds: bool | None
    command: str = ""
    seeds: int = 0  # training seeds behind it, of the policy that has most
    measured: bool = True
    beside: str = ""  # what else was seen, told and not judged

    def lines(self) -> list[str]:
        """What a reader sees of it under "measured"."""
        ends = {True: "", False: " (fails)", None: f" ({UNDECIDED})"}
        return [f"{self.seen}{ends[self.holds]}"] * self.measured + [self.beside] * bool(self.beside)


def missing(what: str, command: str, beside: str = "") -> Part:
    """A part that nobody measured."""
    return Part(what, None, command, measured=False, beside=beside)


class Loss(NamedTuple):
    """By how much one figure exceeds another, with its interval."""

    value: float
    low: float
    high: float


def loss(first: Rate | Mean, last: Rate | Mean) -> Loss:
    """First minus last of two independent figures.

    The interval combines those of the figures by their squares (Newcombe 1998, method 10; Zou and Donner 2008).
    """
    value = first.value - last.value
    below = math.hypot(first.value - first.low, last.high - last.value)
    above = math.hypot(first.high - first.value, last.value - last.low)
    return Loss(value, value - below, value + above)


def reaches(low: float, high: float, limit: float) -> bool | None:
    """Whether a figure with this interval is at least ``limit``; None where the limit lies inside."""
    return None if low < limit <= high else low >= limit


def stays(lost: Loss, limit: float) -> bool | None:
    """Whether a loss is at most ``limit``; None where the limit lies inside its interval."""
    return None if lost.low <= limit < lost.high else lost.high <= limit


def every(*held: bool | None) -> bool | None:
    """True where all hold, False where one fails, None otherwise."""
    return False if False in held else None if None in held else True


class Contest(NamedTuple):
    """Two methods on the ``n`` episodes that both flew: the p value, and whether the first is ahead (None: open)."""

    n: int
    p: float
    ahead: bool | None

    def __str__(self) -> str:
        return f"{self.n} shared episodes, p {'< 0.001' if self.p < 0.001 else f'= {self.p:.3f}'}"


def contests(first: "pd.DataFrame", others: "Sequence[pd.DataFrame]", flag: str = "cfr") -> list[Contest]:
    """The first method's flag against every other's: exact McNemar, Holm-adjusted over the others.

    With several seeds the weakest test counts, so that a small p speaks for every seed; 1 where seeds disagree.
    """
    pairs = [flown.paired(first, other, [flag]).groupby("pair") for other in others]
    tests = [[stats.mcnemar(own[f"{flag}_a"], own[f"{flag}_b"]) for _, own in pair] for pair in pairs]
    signs = [{(test.only_a > test.only_b) - (test.only_a < test.only_b) for test in own} for own in tests]
    p_values = [max(test.p for test in own) if len(s) == 1 else 1.0 for own, s in zip(tests, signs, strict=True)]
    return [
        Contest(min((test.n for test in own), default=0), float(p), max(s) > 0 if p < ALPHA else None)
        for own, s, p in zip(tests, signs, stats.holm(p_values), strict=True)
    ]
