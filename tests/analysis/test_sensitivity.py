"""Thresholds moved by hand on rows whose answer is plain."""

import pandas as pd
import pytest

from analysis import sensitivity


@pytest.fixture
def rows():
    """Four episodes: all well; too loose a formation; too slow; a ball came near."""
    return pd.DataFrame(
        {
            "fm": [0.4, 1.4, 0.4, 0.4],
            "throttle_change": [0.01, 0.01, 0.01, 0.01],
            "time_to_goal": [14.0, 14.0, float("nan"), 19.0],
            "min_column": [1.0, 1.0, 1.0, 1.0],
            "min_ball": [float("nan"), 0.9, 0.9, 0.2],
            "min_drone": [1.0, 1.0, 1.0, 1.0],
            "ok_formation": [True, False, True, True],
            "ok_flight": [True, True, False, True],
            "ok_obstacle": [True, True, True, True],
            "ok_action": [True, True, True, True],
        }
    )


@pytest.mark.parametrize(
    ("objective", "value", "expected"),
    [
        ("formation", 1.0, [True, False, False, True]),
        ("formation", 1.5, [True, True, False, True]),
        ("formation", 0.3, [False, False, False, False]),
        ("flight", 20.0, [True, False, False, True]),
        ("flight", 18.0, [True, False, False, False]),
        ("obstacle", 0.15, [True, False, False, True]),
        ("obstacle", 0.3, [True, False, False, False]),
        ("action", 0.005, [False, False, False, False]),
    ],
)
def test_one_threshold_moves_and_the_others_stay(rows, objective, value, expected):
    moved = sensitivity.Threshold(objective, "", "", value)
    assert list(sensitivity.satisfied(rows, moved)) == expected


def test_the_winner_may_change(rows):
    loose, tight = rows.assign(fm=0.9, ok_formation=True), rows.iloc[[0, 1]]
    used = sensitivity.thresholds({"formation_threshold": 1.0, "time_limit": 20.0, "action_threshold": 0.02}, 0.15)
    best = sensitivity.winners(sensitivity.sweep({3: loose, 5: tight}, used)).set_index(["objective", "threshold"])
    assert (best.loc[("formation", 1.0), "trial"], best.loc[("formation", 1.0), "sr"]) == (3, 0.75)
    assert (best.loc[("formation", 0.5), "trial"], best.loc[("formation", 0.5), "sr"]) == (5, 0.5)
    assert best["in_use"].sum() == 4
