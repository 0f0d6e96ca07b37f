"""How short a search trial may be: the order of the same weight vectors at several budgets against the longest."""

from typing import Any

import pandas as pd
from scipy import stats

COLUMNS = ("budget", "minutes", "vectors", "spearman", "kendall", "p", "winner", "winner_sr_longest", "best_sr_longest")
"""Of ``agreement``: budget in steps; median minutes of a trial; rank correlations of SR with those of the longest
budget and the p-value of Kendall's; the trial that wins here and its SR at the longest budget, beside the best."""


def agreement(trials: pd.DataFrame) -> pd.DataFrame:
    """How well each budget ranks weight vectors, shortest first, one row of ``COLUMNS`` each.

    trials: budget, trial, sr, minutes; the same trial numbers (and so weight vectors) at every budget. Vectors that
    did not finish at some budget are left out. Correlations are NaN where all SR of a budget are equal.
    Raises ValueError for fewer than two budgets or three common vectors.
    """
    rates = trials.pivot(index="trial", columns="budget", values="sr").dropna()
    if rates.shape[1] < 2 or len(rates) < 3:
        raise ValueError(f"{len(rates)} weight vectors at {rates.shape[1]} budgets say nothing about ranks")
    longest = rates[rates.columns.max()]
    minutes = trials.groupby("budget")["minutes"].median()
    return pd.DataFrame([_row(rates[budget], longest, minutes[budget]) for budget in sorted(rates.columns)])


def _row(rates: pd.Series, longest: pd.Series, minutes: float) -> dict[str, Any]:
    constant = rates.nunique() < 2 or longest.nunique() < 2
    tau = None if constant else stats.kendalltau(rates, longest)
    winner = int(rates.to_numpy().argmax())
    values = (
        rates.name,
        minutes,
        len(rates),
        float("nan") if constant else float(stats.spearmanr(rates, longest).statistic),
        float("nan") if tau is None else float(tau.statistic),
        float("nan") if tau is None else float(tau.pvalue),
        rates.index[winner],
        longest.iloc[winner],
        longest.max(),
    )
    return dict(zip(COLUMNS, values, strict=True))
