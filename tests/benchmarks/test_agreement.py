"""Rank agreement of short trials with long ones, on rates whose ranks are known."""

import math

import pandas as pd
import pytest

from tests.benchmarks import agreement
from tests.benchmarks.pilot_figure import draw_pilot


def trials(**rates: list[float]) -> pd.DataFrame:
    """SR of vectors 0, 1, ... at budgets named ``b<steps>``."""
    rows = [
        {"budget": int(name[1:]), "trial": trial, "sr": sr, "minutes": int(name[1:]) / 100}
        for name, column in rates.items()
        for trial, sr in enumerate(column)
    ]
    return pd.DataFrame(rows)


def test_ranks_against_the_longest_budget():
    table = trials(b100=[0.0, 0.0, 0.0, 0.0], b200=[0.4, 0.3, 0.2, 0.1], b400=[0.1, 0.5, 0.6, 0.9])
    flat, reverse, same = agreement.agreement(table).itertuples()
    assert math.isnan(flat.spearman) and math.isnan(flat.kendall) and flat.minutes == 1
    assert (reverse.spearman, reverse.kendall) == pytest.approx((-1, -1))
    assert (reverse.winner, reverse.winner_sr_longest, reverse.best_sr_longest) == (0, 0.1, 0.9)
    assert (same.spearman, same.winner, same.vectors) == (pytest.approx(1), 3, 4)


def test_a_vector_that_failed_somewhere_is_left_out():
    table = trials(b1=[0.1, 0.2, 0.3, 0.4], b2=[0.1, 0.2, 0.3, math.nan])
    assert set(agreement.agreement(table)["vectors"]) == {3}


@pytest.mark.parametrize("rates", [{"b1": [0.1, 0.2, 0.3]}, {"b1": [0.1, 0.2], "b2": [0.1, 0.2]}])
def test_too_little_to_rank(rates):
    with pytest.raises(ValueError, match="say nothing about ranks"):
        agreement.agreement(trials(**rates))


def test_the_figure_has_a_line_per_vector_and_both_correlations():
    table = trials(b100=[0.0, 0.2, 0.4], b200=[0.1, 0.2, 0.3])
    rates, ranks = draw_pilot(table, agreement.agreement(table)).axes
    assert len(rates.lines) == 3
    assert [line.get_label() for line in ranks.lines][:2] == ["Spearman", "Kendall"]
