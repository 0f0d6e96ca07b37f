"""Statistics of episodes: intervals on rates and means, paired comparisons, and how many episodes a claim needs.

Episodes are the unit within a seed, training seeds the unit of replication: with several seeds every interval comes
from a two-level bootstrap (seeds, then episodes), widened because seeds are few (``_stretch``); with one seed it speaks
about that one policy only.
scipy and statsmodels are imported where they are used: together they take seconds, and an empty report has none.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


class McNemar(NamedTuple):
    """Two methods on the same n episodes: how often only one of them succeeded, and the exact two-sided p value."""

    n: int
    only_a: int
    only_b: int
    p: float


def wilson(k: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Wilson score interval of k successes in n trials (closed form; equals statsmodels' ``method="wilson"``).

    Raises ValueError unless 0 <= k <= n and n > 0.
    """
    if n <= 0 or not 0 <= k <= n:
        raise ValueError(f"a rate needs 0 <= k <= n and n > 0, got k={k}, n={n}")
    z2 = NormalDist().inv_cdf(0.5 + confidence / 2) ** 2
    p = k / n
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = math.sqrt(z2 * (p * (1 - p) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return (0.0 if k == 0 else centre - half, 1.0 if k == n else centre + half)


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
    return _percentiles(totals / counts, of_seeds, len(groups), confidence)


def mcnemar(a: ArrayLike, b: ArrayLike) -> McNemar:
    """Exact McNemar test of two methods' flags on the same episodes. a, b (n,) bool in the same order."""
    from statsmodels.stats.contingency_tables import mcnemar as exact_test

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
    low, high = _percentiles(totals[drawn] / counts[drawn], of_seeds[drawn], seeds, confidence)
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
    from statsmodels.stats.multitest import multipletests

    values = np.asarray(p_values, dtype=float)
    return values if values.size == 0 else np.asarray(multipletests(values, method="holm")[1])


def episodes_to_separate(first: float, second: float, power: float = 0.8, alpha: float = 1 - CONFIDENCE) -> int:
    """Episodes per method so that a two-sided test tells two rates apart with the given power (unpaired, arcsine).

    Raises ValueError when the rates are equal or outside [0, 1].
    """
    from statsmodels.stats.power import NormalIndPower
    from statsmodels.stats.proportion import proportion_effectsize

    if not (0 <= first <= 1 and 0 <= second <= 1):
        raise ValueError(f"rates lie in [0, 1], got {first} and {second}")
    if first == second:
        raise ValueError(f"no number of episodes separates two equal rates ({first})")
    effect = abs(float(proportion_effectsize(first, second)))
    return math.ceil(float(NormalIndPower().solve_power(effect_size=effect, alpha=alpha, power=power, ratio=1.0)))


def separable(rate: float, episodes: int, power: float = 0.8, alpha: float = 1 - CONFIDENCE) -> float:
    """The highest lower rate that ``episodes`` per method tell from ``rate`` with the given power; NaN where none is.

    The inverse of ``episodes_to_separate``, in closed form: the arcsine transform makes the spread the same everywhere.
    """
    normal = NormalDist()
    effect = (normal.inv_cdf(1 - alpha / 2) + normal.inv_cdf(power)) * math.sqrt(2 / episodes)
    angle = 2 * math.asin(math.sqrt(rate)) - effect
    return math.sin(angle / 2) ** 2 if angle >= 0 else math.nan


def _by_seed(values: NDArray, seeds: ArrayLike | None) -> list[NDArray]:
    if seeds is None:
        return [values]
    labels = np.asarray(seeds)
    return [values[labels == label] for label in np.unique(labels)]


def _percentiles(
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
    from scipy.stats import t

    tail = (1 + confidence) / 2
    return math.sqrt(seeds / (seeds - 1)) * float(t.ppf(tail, seeds - 1)) / NormalDist().inv_cdf(tail)


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
