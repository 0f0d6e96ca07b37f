"""SR over a joint grid of thresholds, on rows whose answer is plain."""

import numpy as np
import pandas as pd
import pytest

from analysis.stats import sensitivity

IN_USE = {"formation_threshold": 0.5, "action_threshold": 0.01, "speed_threshold": 0.5, "height_threshold": 0.1}


@pytest.fixture
def rows():
    """Four episodes: all well; too loose a formation; late; a rough one."""
    return pd.DataFrame(
        {
            "cfr": [True, True, False, True],
            "fm": [0.1, 0.4, 0.1, 0.1],
            "throttle_change": [0.004, 0.004, 0.004, 0.02],
            "ok_flight": [True, True, False, True],
            "ok_obstacle": [True, True, True, True],
        }
    )


@pytest.mark.parametrize(
    ("formation", "action", "expected"),
    [
        (0.5, 0.03, [True, True, False, True]),
        (0.278, 0.03, [True, False, False, True]),
        (0.5, 0.01, [True, True, False, False]),
        (0.278, 0.01, [True, False, False, False]),
        (0.05, 0.01, [False, False, False, False]),
    ],
)
def test_both_thresholds_move_together(rows, formation, action, expected):
    thresholds = {"formation_threshold": formation, "action_threshold": action}
    assert list(sensitivity.satisfied(rows, thresholds)) == expected


def test_the_grid_lies_where_the_data_do_with_what_is_in_use_and_the_papers_fm(rows):
    values = sensitivity.grid({0: rows}, IN_USE)
    flown = rows[rows["cfr"]]
    assert {0.278, 0.5} <= set(values["formation_threshold"]) and 0.01 in values["action_threshold"]
    rest = set(values["formation_threshold"]) - {0.278, 0.5}
    assert rest == {float(f"{q:.3g}") for q in np.quantile(flown["fm"], sensitivity.QUANTILES)}
    assert max(values["action_threshold"]) <= flown["throttle_change"].max()


def test_the_winner_may_change(rows):
    loose, rough = rows.assign(fm=0.4, throttle_change=0.004), rows.assign(fm=0.1, throttle_change=0.02)
    table = sensitivity.winners(sensitivity.sweep({3: loose, 5: rough}, IN_USE))
    used = table[table["in_use"]]
    assert len(used) == 1 and (used["trial"].iloc[0], used["sr"].iloc[0]) == (3, 0.75)
    tight = table[(table["formation_threshold"] == 0.278) & (table["action_threshold"] > 0.02)]
    assert tight.empty or set(tight["trial"]) == {5}
