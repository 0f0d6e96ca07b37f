"""Intervals on rates and means of episodes.

Episodes are the unit within a seed, training seeds the unit of replication: with several seeds every interval comes
from a two-level bootstrap (seeds, then episodes), widened because seeds are few (``_stretch``); with one seed it speaks
about that one policy only.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import t as student
from statsmodels.stats.proportion import proportion_confint

CONFIDENCE = 0.95
RESAMPLES = 2000
SEED = 20241018  # of the bootstrap draws: the same rows give the same interval, digit for digit
_BLOCK = 4_000_000  # resampled values held in memory at a time
_NORMAL_FROM = 500  # values from which their resampled sum is drawn as a normal number: the same to three digits


class Rate(NamedTuple):
    """A share of episodes: k of n, over so many training seeds, with its interval."""

    k: int
    n: int
    seeds: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share k / n."""
        return self.k / self.n


class Mean(NamedTuple):
    """A mean over n episodes and so many training seeds, with its interval."""

    value: float
    n: int
    seeds: int
    low: float
    high: float


def wilson(k: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Wilson score interval of k successes in n trials. Raises ValueError unless 0 <= k <= n and n > 0."""
    if n <= 0 or not 0 <= k <= n:
        raise ValueError(f"a rate needs 0 <= k <= n and n > 0, got k={k}, n={n}")
    low, high = proportion_confint(k, n, 1 - confidence, method="wilson")
    return max(0.0, float(low)) if k else 0.0, min(1.0, float(high)) if k < n else 1.0


def rate(flags: ArrayLike, seeds: ArrayLike | None = None) -> Rate:
    """Share of True among episodes, with its interval.

    flags (n,) bool, seeds (n,) training seed of each episode. One seed: Wilson. Several: two-level bootstrap, widened
    to Wilson's where the bootstrap is narrower (seeds that all agree, or never fail, do not make the episodes certain)
    and kept within [0, 1].
    """
    values = np.asarray(flags, dtype=bool)
    groups = _by_seed(values, seeds)
    k, n = int(values.sum()), len(values)
    low, high = wilson(k, n)
    if len(groups) > 1:
        between = two_level_bootstrap([group.astype(float) for group in groups])
        low, high = max(0.0, min(low, between[0])), min(1.0, max(high, between[1]))
    return Rate(k, n, len(groups), low, high)


def mean(values: ArrayLike, seeds: ArrayLike | None = None) -> Mean | None:
    """Mean over episodes with its bootstrap interval (two-level with several seeds); None when there is no episode.

    values (n,) finite numbers, seeds (n,); where none is negative (distances, speeds), neither is the interval.
    Raises ValueError on NaN or infinity: a metric without a value is a bug.
    """
    array = np.asarray(values, dtype=float)
    if array.size == 0:
        return None
    if not np.isfinite(array).all():
        raise ValueError(f"{np.count_nonzero(~np.isfinite(array))} of {array.size} values are not finite")
    groups = _by_seed(array, seeds)
    low, high = two_level_bootstrap(groups)
    low = max(0.0, low) if array.min() >= 0 else low
    return Mean(float(array.mean()), array.size, len(groups), low, high)


def rate_of(rows: pd.DataFrame, flag: str = "cfr") -> Rate:
    """Share of a cell's episodes whose flag is set."""
    return rate(rows[flag].to_numpy(bool), rows["train_seed"].to_numpy())


def fm_of(rows: pd.DataFrame) -> Mean | None:
    """FM (m) over the successful episodes of a cell; None without any (paper, Sec. VI-A1)."""
    successes = rows[rows["cfr"].to_numpy(bool)]
    return mean(successes["fm"].to_numpy(float), successes["train_seed"].to_numpy())


def two_level_bootstrap(
    groups: Sequence[NDArray[np.float64]], confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = SEED
) -> tuple[float, float]:
    """Percentile interval of the mean of all values: groups (seeds) are drawn with replacement, then values within.

    groups: one (n_g,) array per seed. One group is the ordinary bootstrap; of several, what the choice of seeds alone
    changes is stretched by ``_stretch``, for the bootstrap over few seeds is too narrow.
    """
    sizes, sums = np.array([len(group) for group in groups]), np.array([group.sum() for group in groups])
    rng = np.random.default_rng(seed)
    chosen = rng.integers(0, len(groups), size=(resamples, len(groups)))
    totals, counts = np.zeros(resamples), sizes[chosen].sum(axis=1)
    for index, group in enumerate(groups):
        picked = np.nonzero(chosen == index)[0]  # the resample that each use of this group belongs to
        np.add.at(totals, picked, _resampled_sums(group, len(picked), rng))
    of_seeds = sums[chosen].sum(axis=1) / counts - sums.sum() / sizes.sum()
    return percentiles(totals / counts, of_seeds, len(groups), confidence)


def _by_seed(values: NDArray, seeds: ArrayLike | None) -> list[NDArray]:
    if seeds is None:
        return [values]
    labels = np.asarray(seeds)
    return [values[labels == label] for label in np.unique(labels)]


def percentiles(
    means: NDArray[np.float64], of_seeds: NDArray[np.float64], seeds: int, confidence: float
) -> tuple[float, float]:
    """Interval of resampled means (resamples,), of which ``of_seeds`` is what the choice of seeds alone changed."""
    stretched = means + (_stretch(seeds, confidence) - 1) * of_seeds
    low, high = np.quantile(stretched, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)


def _stretch(seeds: int, confidence: float) -> float:
    """By how much resampled means of k seeds scatter too little; 1 for one seed, whose interval speaks of no other.

    sqrt(k / (k - 1)) gives them the variance of a sample mean (rescaled bootstrap: Rao and Wu, 1988, J. Am. Stat.
    Assoc. 83:231); Student's t over the normal quantile allows for a variance guessed from k seeds. Hesterberg (2015,
    The American Statistician 69:371) moves the tail probability by both; three seeds have no resample so far out.
    """
    if seeds == 1:
        return 1.0
    tail = (1 + confidence) / 2
    return math.sqrt(seeds / (seeds - 1)) * float(student.ppf(tail, seeds - 1)) / NormalDist().inv_cdf(tail)


def _resampled_sums(values: NDArray[np.float64], count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """``count`` sums of len(values) draws with replacement; flags are drawn as binomials, which is the same law."""
    size = len(values)
    if np.isin(values, (0.0, 1.0)).all():
        return rng.binomial(size, values.mean(), size=count).astype(float)
    if size >= _NORMAL_FROM:
        return rng.normal(size * values.mean(), math.sqrt(size) * values.std(), size=count)
    sums = np.empty(count)
    block = max(1, _BLOCK // size)
    for start in range(0, count, block):
        stop = min(start + block, count)
        sums[start:stop] = values[rng.integers(0, size, size=(stop - start, size))].sum(axis=1)
    return sums
