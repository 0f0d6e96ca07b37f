"""Choosing: the highest SR, and what decides among trials that are not told from it."""

import pytest
from scipy.stats import binomtest

from analysis.stats import holm
from formctl.search import winner
from formctl.store.files import StoreError


def trial(number, satisfied, fm=0.3, change=0.01, **more):
    """A trial that satisfied the first so many of 200 episodes, or those whose bits are given."""
    bits = (1 << satisfied) - 1 if isinstance(satisfied, int) else int(satisfied, 2)
    k = bits.bit_count()
    row = {"trial": number, "state": "done", "sr": k / 200, "sr_k": k, "sr_n": 200, "fm": fm, "throttle_change": change}
    return row | {"episodes": f"{bits:050x}"} | more


def test_a_clear_lead_decides():
    assert winner.choose([trial(0, 100, fm=0.1), trial(1, 190, fm=0.4), trial(2, 120, fm=0.1)])["trial"] == 1


def test_fm_decides_among_those_that_are_not_told_from_the_best():
    trials = [trial(0, 190, fm=0.4), trial(1, 187, fm=0.2), trial(2, 120, fm=0.05)]
    assert [row["trial"] for row in winner.not_told_apart(trials)] == [0, 1]
    assert winner.choose(trials)["trial"] == 1


def test_throttle_change_and_then_the_index_decide_among_equal_fm():
    assert winner.choose([trial(0, 190, change=0.02), trial(1, 189, change=0.01)])["trial"] == 1
    assert winner.choose([trial(3, 190), trial(1, 190)])["trial"] == 1
    assert winner.choose([trial(0, 190, fm=None), trial(1, 189)])["trial"] == 1


def test_the_same_episodes_tell_what_rates_alone_do_not():
    """Nine fewer of 200 are within noise, unless they are nine of the very same episodes."""
    best = trial(0, 150, fm=0.4)
    apart = trial(1, 141, fm=0.1)
    assert winner.mcnemar(best["episodes"], apart["episodes"]) == pytest.approx(binomtest(0, 9).pvalue)
    assert winner.choose([best, apart])["trial"] == 0
    other = trial(2, "1" * 141 + "0" * 59, fm=0.1)  # satisfied in other episodes
    only_best, only_other = 59, 50
    p = binomtest(only_other, only_best + only_other).pvalue
    assert winner.mcnemar(best["episodes"], other["episodes"]) == pytest.approx(p)
    assert winner.choose([best, other])["trial"] == 2


def test_many_comparisons_are_adjusted_as_in_the_report():
    trials = [trial(0, 150), *(trial(k, 150 - lost) for k, lost in enumerate((5, 6, 7, 8, 9, 10, 12, 20), start=1))]
    p = [winner.mcnemar(trials[0]["episodes"], row["episodes"]) for row in trials[1:]]
    kept = {row["trial"] for row, adjusted in zip(trials[1:], holm(p), strict=True) if adjusted > 0.05}
    assert {row["trial"] for row in winner.not_told_apart(trials)} == {0} | kept and 0 < len(kept) < 8


def test_trials_whose_episodes_nobody_kept_are_told_apart_by_the_interval():
    trials = [trial(k, count, episodes=None) for k, count in enumerate((180, 176, 160))]
    assert [row["trial"] for row in winner.not_told_apart(trials)] == [0, 1]


def test_unfinished_trials_are_not_chosen():
    assert winner.choose([trial(0, 10), trial(1, 100, state="running", sr=None)])["trial"] == 0
    with pytest.raises(StoreError, match="no trial of the study is done yet"):
        winner.choose([trial(0, 10, state="failed")])


def test_a_trial_is_named_by_its_index():
    trials = [trial(0, 10), trial(1, 100)]
    assert winner.select(trials, "trial=0")["trial"] == 0 and winner.select(trials, "best")["trial"] == 1
    with pytest.raises(StoreError, match="has no trial 17"):
        winner.select(trials, "trial=17")
    with pytest.raises(StoreError, match="neither best nor"):
        winner.select(trials, "third")
