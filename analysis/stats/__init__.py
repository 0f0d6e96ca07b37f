"""Statistics of episodes: intervals, paired comparisons, and what a study's trials tell."""

from analysis.stats.intervals import CONFIDENCE, Mean, Rate, fm_of, mean, rate, rate_of, two_level_bootstrap, wilson
from analysis.stats.paired import (
    McNemar,
    PairedTest,
    compare,
    heterogeneity,
    holm,
    mcnemar,
    paired,
    paired_difference,
    paired_rate_difference,
)
from analysis.stats.power import episodes_to_separate, separable

__all__ = [
    "CONFIDENCE",
    "McNemar",
    "Mean",
    "PairedTest",
    "Rate",
    "compare",
    "episodes_to_separate",
    "fm_of",
    "heterogeneity",
    "holm",
    "mcnemar",
    "mean",
    "paired",
    "paired_difference",
    "paired_rate_difference",
    "rate",
    "rate_of",
    "separable",
    "two_level_bootstrap",
    "wilson",
]
