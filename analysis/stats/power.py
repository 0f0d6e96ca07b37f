"""How many episodes tell two rates apart."""

import math
from statistics import NormalDist

from statsmodels.stats.power import NormalIndPower
from statsmodels.stats.proportion import proportion_effectsize

from analysis.stats.intervals import CONFIDENCE


def episodes_to_separate(first: float, second: float, power: float = 0.8, alpha: float = 1 - CONFIDENCE) -> int:
    """Episodes per method so that a two-sided test tells two rates apart with the given power (unpaired, arcsine).

    Raises ValueError when the rates are equal or outside [0, 1].
    """
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
