"""Trials of like rate: who is chosen, and which episode they are seen in."""

import pandas as pd
import pytest

from formctl.search import diversity
from formctl.store.files import StoreError


def trial(number, k, *weights):
    row = dict(zip(("w_formation", "w_flight", "w_obstacle", "w_action"), weights, strict=True))
    return row | {"trial": number, "state": "done", "sr": k / 100, "sr_k": k, "sr_n": 100, "episodes": None}


ROWS = [
    trial(4, 90, 0.25, 0.25, 0.25, 0.25),
    trial(2, 88, 0.25, 0.25, 0.24, 0.26),
    trial(7, 86, 0.7, 0.1, 0.1, 0.1),
    trial(0, 85, 0.1, 0.1, 0.1, 0.7),
    trial(1, 60, 0.0, 1.0, 0.0, 0.0),
]


def test_like_the_best_are_those_within_its_interval():
    assert [row["trial"] for row in diversity.alike(ROWS)] == [4, 2, 7, 0]  # the interval of 90 of 100 begins at 0.826


@pytest.mark.parametrize(
    ("rows", "message"), [(ROWS[::4], "trial 4 stands alone"), ([trial(3, 0, 1, 0, 0, 0)], "no tri")]
)
def test_nobody_to_compare_is_said(rows, message):
    with pytest.raises(StoreError, match=message):
        diversity.alike(rows)


def test_the_best_is_shown_beside_the_most_different_weights():
    assert [row["trial"] for row in diversity.most_different(diversity.alike(ROWS))] == [4, 7, 0]
    assert [row["trial"] for row in diversity.most_different(ROWS[:2])] == [4, 2]


def test_the_episode_is_the_closest_call_that_all_survive():
    one = pd.DataFrame({"cfr": [True, True, False, True], "min_ball": [0.5, 0.3, 0.1, float("nan")]})
    other = pd.DataFrame({"cfr": [True, True, True, True], "min_ball": [0.5, 0.4, 0.1, 0.2]})
    assert diversity.closest_call([one, other]) == 1
    assert diversity.closest_call([one.assign(cfr=False), other]) == 2


def test_a_study_of_equals_is_drawn(formctl_stocked, stocked, monkeypatch):
    """The stocked trials satisfy nothing: what is drawn of them is what a study of equals would get."""
    assert "no behaviours to compare" in formctl_stocked("search", "--alike").line
    monkeypatch.setattr(diversity, "alike", list)
    answer = formctl_stocked("search", "--alike")
    assert answer.code == 0, answer.err
    (folder,) = (stocked / "search" / "stage1").iterdir()
    assert all((folder / f"alike.{kind}").stat().st_size > 1000 for kind in ("png", "html", "mcap"))
    assert answer.out.count("Trial ") == 2 and "flown by 2 trials of like SR" in answer.out
