"""Satisfaction rates of the same weight vectors at growing budgets."""

import pandas as pd
from matplotlib.figure import Figure

from analysis.figures import style


def draw_pilot(trials: pd.DataFrame, agreement: pd.DataFrame) -> Figure:
    """SR against steps, one line per weight vector, and rank correlations with the longest budget; both columns wide.

    trials: budget, trial, sr. agreement: as ``tests.benchmarks.agreement.agreement`` gives it.
    """
    vectors = sorted(trials["trial"].unique())
    looks = style.line_styles([f"vector {trial}" for trial in vectors])
    with style.styled():
        figure = style.new(style.DOUBLE, 2.4)
        rates, ranks = figure.subplots(1, 2)
        for trial in vectors:
            line = trials[trials["trial"] == trial].sort_values("budget")
            look = looks[f"vector {trial}"]
            rates.plot(
                line["budget"] * 1e-6, line["sr"], color=look.color, marker=look.marker, ls=look.line, ms=3, label=trial
            )
        rates.set(xlabel="Environment steps per trial (M)", ylabel="SR", xscale="log", ylim=(-0.03, 1.03))
        budgets = sorted(trials["budget"].unique() * 1e-6)
        rates.set_xticks(budgets, [f"{budget:g}" for budget in budgets])
        rates.set_xticks([], minor=True)
        for key, label, marker in (("spearman", "Spearman", "o"), ("kendall", "Kendall", "s")):
            ranks.plot(agreement["minutes"], agreement[key], marker=marker, ms=3, label=label)
        ranks.set(xlabel="Minutes per trial (median)", ylabel="Rank correlation\nwith the longest", ylim=(-1.05, 1.05))
        ranks.axhline(0, color=style.FAINT, lw=0.8)
        ranks.legend()
        handles, names = rates.get_legend_handles_labels()
        figure.legend(handles, names, title="weight vector", loc="outside upper center", ncols=len(names))
        return style.settle(figure)
