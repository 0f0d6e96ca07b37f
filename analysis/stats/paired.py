"""Two methods on the episodes that both flew: exact tests, paired differences, and what an interval leaves open."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2_contingency
from statsmodels.stats.contingency_tables import mcnemar as exact_test
from statsmodels.stats.multitest import multipletests

from analysis.stats.intervals import CONFIDENCE, RESAMPLES, SEED, Mean, Rate, percentiles, wilson

ALPHA = 1 - CONFIDENCE
"""p value, Holm-adjusted over a family of comparisons, below which one of two methods is ahead."""

_BLOCK = 4_000_000  # resampled values held in memory at a time


class McNemar(NamedTuple):
    """Two methods on the same n episodes: how often only one of them succeeded, and the exact two-sided p value."""

    n: int
    only_a: int
    only_b: int
    p: float


class Difference(NamedTuple):
    """By how much one figure exceeds another, with its interval."""

    value: float
    low: float
    high: float


class PairedTest(NamedTuple):
    """Two methods on the ``n`` episodes that both flew: the p value, and whether the first is ahead (None: open)."""

    n: int
    p: float
    ahead: bool | None

    def __str__(self) -> str:
        return f"{self.n} shared episodes, p {'< 0.001' if self.p < 0.001 else f'= {self.p:.3f}'}"


def mcnemar(a: ArrayLike, b: ArrayLike) -> McNemar:
    """Exact McNemar test of two methods' flags on the same episodes. a, b (n,) bool in the same order."""
    first, second = np.asarray(a, dtype=bool), np.asarray(b, dtype=bool)
    if first.shape != second.shape:
        raise ValueError(f"paired flags need the same episodes, got {first.size} and {second.size}")
    only_a, only_b = int((first & ~second).sum()), int((~first & second).sum())
    both = int((first & second).sum())
    table = [[both, only_a], [only_b, first.size - both - only_a - only_b]]
    return McNemar(first.size, only_a, only_b, float(exact_test(table, exact=True).pvalue))


def paired_difference(
    differences: ArrayLike, confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = SEED
) -> Mean | None:
    """Mean difference of two methods on shared episodes, with its interval; None when no pair counts.

    differences (seeds, episodes): first minus second method, NaN where a pair does not count (FM where not both
    finished). Seeds and episodes are crossed, so both are drawn with replacement, whole rows and whole columns; several
    rows are stretched as in ``two_level_bootstrap``. ``n`` and ``seeds`` count the episodes and seeds with a pair.
    """
    matrix = np.atleast_2d(np.asarray(differences, dtype=float))
    counted = np.isfinite(matrix)
    some = np.ix_(counted.any(axis=1), counted.any(axis=0))
    matrix, counted = matrix[some], counted[some]
    if matrix.size == 0:
        return None
    seeds, episodes = matrix.shape
    rng = np.random.default_rng(seed)
    rows = rng.multinomial(seeds, [1 / seeds] * seeds, size=resamples).astype(float)
    totals, counts = np.empty(resamples), np.empty(resamples)
    values = np.where(counted, matrix, 0.0)
    block = max(1, _BLOCK // episodes)
    for start in range(0, resamples, block):
        part = slice(start, min(start + block, resamples))
        columns = rng.multinomial(episodes, [1 / episodes] * episodes, size=part.stop - start)
        totals[part] = ((rows[part] @ values) * columns).sum(axis=1)
        counts[part] = ((rows[part] @ counted) * columns).sum(axis=1)
    mean = float(values.sum() / counted.sum())
    of_seeds = (rows @ values.sum(axis=1)) / (rows @ counted.sum(axis=1)) - mean
    drawn = counts > 0
    low, high = percentiles(totals[drawn] / counts[drawn], of_seeds[drawn], seeds, confidence)
    return Mean(mean, episodes, seeds, low, high)


def paired_rate_difference(differences: ArrayLike) -> Mean | None:
    """``paired_difference`` of flags (values -1, 0, 1), within [-1, 1].

    Where every pair says the same, the bootstrap has nothing to draw from; the interval is then that of 0 in n pairs
    that say otherwise.
    """
    mean = paired_difference(differences)
    if mean is None:
        return None
    unseen = 0.0 if mean.low < mean.high else wilson(0, mean.n)[1]
    return mean._replace(low=max(-1.0, mean.low - unseen), high=min(1.0, mean.high + unseen))


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Holm-adjusted p values of a family of tests, in the order given."""
    values = np.asarray(p_values, dtype=float)
    return values if values.size == 0 else np.asarray(multipletests(values, method="holm")[1])


def difference(first: Rate | Mean, last: Rate | Mean) -> Difference:
    """First minus last of two independent figures.

    The interval combines those of the figures by their squares (Newcombe 1998, method 10; Zou and Donner 2008).
    """
    value = first.value - last.value
    below = math.hypot(first.value - first.low, last.high - last.value)
    above = math.hypot(first.high - first.value, last.value - last.low)
    return Difference(value, value - below, value + above)


def heterogeneity(successes: ArrayLike, counts: ArrayLike) -> float:
    """p value of the chi-squared test that several rates (k of n each) are one; 1 where nothing or all succeeded."""
    hits, totals = np.asarray(successes, dtype=int), np.asarray(counts, dtype=int)
    if len(hits) < 2 or hits.sum() in (0, totals.sum()):
        return 1.0
    return float(chi2_contingency([hits, totals - hits], correction=False).pvalue)


def paired(first: pd.DataFrame, second: pd.DataFrame, columns: Iterable[str]) -> pd.DataFrame:
    """Episodes of one draw that both methods flew, one row each: the ``columns`` of the first end in _a, others in _b.

    n-th seed against n-th, seeds beyond left out; a single seed against all of the other's. ``pair`` numbers them.
    """
    keys = ["draw", "scenario_id"]
    seeds = [sorted(rows["train_seed"].unique()) for rows in (first, second)]
    count = max(map(len, seeds)) if min(map(len, seeds)) == 1 else min(map(len, seeds))
    parts = []
    for n in range(count):
        a, b = (
            rows.loc[rows["train_seed"] == own[n % len(own)], [*keys, "train_seed", *columns]].astype({"draw": str})
            for rows, own in zip((first, second), seeds, strict=True)
        )
        parts.append(a.merge(b, on=keys, suffixes=("_a", "_b")).assign(pair=n))
    stacked: pd.DataFrame = pd.concat(parts, ignore_index=True)
    return stacked


def compare(first: pd.DataFrame, others: Sequence[pd.DataFrame], flag: str = "cfr") -> list[PairedTest]:
    """The first method's flag against every other's: exact McNemar, Holm-adjusted over the others.

    With several seeds the weakest test counts, so that a small p speaks for every seed; 1 where seeds disagree.
    """
    pairs = [paired(first, other, [flag]).groupby("pair") for other in others]
    tests = [[mcnemar(own[f"{flag}_a"], own[f"{flag}_b"]) for _, own in pair] for pair in pairs]
    signs = [{(test.only_a > test.only_b) - (test.only_a < test.only_b) for test in own} for own in tests]
    p_values = [max(test.p for test in own) if len(s) == 1 else 1.0 for own, s in zip(tests, signs, strict=True)]
    return [
        PairedTest(min((test.n for test in own), default=0), float(p), max(s) > 0 if p < ALPHA else None)
        for own, s, p in zip(tests, signs, holm(p_values), strict=True)
    ]
