import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, bootstrap
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from analysis import stats


@given(st.integers(1, 3000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_is_statsmodels_wilson(counts: tuple[int, int]) -> None:
    k, n = counts
    assert stats.wilson(k, n) == pytest.approx(proportion_confint(k, n, method="wilson"), abs=1e-12)


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    [(89, 100, 0.814, 0.937), (83, 100, 0.745, 0.891), (3, 10, 0.11, 0.60), (8, 10, 0.49, 0.94)],
)
def test_wilson_of_the_papers_rates(k: int, n: int, low: float, high: float) -> None:
    assert stats.wilson(k, n) == pytest.approx((low, high), abs=0.006)


@pytest.mark.parametrize(("k", "n"), [(0, 0), (-1, 5), (6, 5)])
def test_wilson_refuses_what_is_no_rate(k: int, n: int) -> None:
    with pytest.raises(ValueError, match="0 <= k <= n"):
        stats.wilson(k, n)


def test_rate_of_one_seed_is_wilson() -> None:
    flags = np.arange(200) % 4 == 0
    rate = stats.rate(flags, np.zeros(200, int))
    assert (rate.k, rate.n, rate.seeds) == (50, 200, 1)
    assert (rate.low, rate.high) == stats.wilson(50, 200)


def test_rate_of_seeds_that_differ_is_wider_than_wilson() -> None:
    flags = np.concatenate([np.arange(300) < 290, np.arange(300) < 100, np.arange(300) < 200])
    rate = stats.rate(flags, np.repeat([0, 1, 2], 300))
    low, high = stats.wilson(rate.k, rate.n)
    assert rate.seeds == 3
    assert rate.low < low - 0.1
    assert rate.high > high + 0.1


def test_rate_of_seeds_that_agree_is_never_narrower_than_wilson() -> None:
    rate = stats.rate(np.ones(60, bool), np.repeat([0, 1, 2], 20))
    assert (rate.low, rate.high) == stats.wilson(60, 60)


@pytest.mark.parametrize("count", [40, 400, 1000])
def test_mean_interval_agrees_with_scipys_bootstrap(count: int) -> None:
    values = np.random.default_rng(3).gamma(4.0, 0.1, count)
    ours = stats.mean(values)
    theirs = bootstrap((values,), np.mean, method="percentile", n_resamples=5000, rng=np.random.default_rng(1))
    assert ours is not None
    assert ours.value == pytest.approx(values.mean())
    width = theirs.confidence_interval.high - theirs.confidence_interval.low
    assert (ours.low, ours.high) == pytest.approx(tuple(theirs.confidence_interval), abs=0.1 * width)


def test_two_level_interval_has_the_width_of_the_seeds() -> None:
    """Seeds N(0, 1), episodes almost without noise: that of a bootstrap over the seeds' means, with Student's tails."""
    rng = np.random.default_rng(5)
    means = rng.normal(size=8)
    groups = [mean + 1e-6 * rng.normal(size=200) for mean in means]
    low, high = stats.two_level_bootstrap(groups)
    seeds_only = bootstrap((means,), np.mean, method="percentile", n_resamples=9999, rng=np.random.default_rng(1))
    wider = math.sqrt(8 / 7) * 2.364624 / 1.959964  # t with 7 degrees of freedom over z
    expected = [means.mean() + wider * (end - means.mean()) for end in seeds_only.confidence_interval]
    assert (low, high) == pytest.approx(expected, abs=0.08)


def test_intervals_of_three_seeds_hold_the_rate_as_often_as_they_say() -> None:
    """CFR of seeds as far apart as those of the reference, 1,000 episodes each."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        chances = np.clip(rng.normal(0.984, 0.006, 3), 0, 1)
        low, high = stats.two_level_bootstrap([rng.binomial(1, chance, 1000) for chance in chances], resamples=500)
        held += low <= 0.984 <= high
    assert held / 200 >= 0.93


def test_intervals_of_three_seeds_hold_the_mean_as_often_as_they_say() -> None:
    """FM of seeds as far apart as those of the reference, 1,000 episodes each."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        groups = [rng.normal(level, 0.03, 1000) for level in rng.normal(0.08, 0.018, 3)]
        low, high = stats.two_level_bootstrap(groups, resamples=500)
        held += low <= 0.08 <= high
    assert 0.93 <= held / 200 <= 0.99


def test_intervals_of_few_seeds_stay_where_their_values_can_be() -> None:
    seeds = np.repeat([0, 1, 2], 100)
    rate = stats.rate(np.concatenate([np.arange(100) < hits for hits in (99, 90, 10)]), seeds)
    lengths = stats.mean(np.repeat([0.01, 0.02, 0.9], 100), seeds)
    assert lengths is not None
    assert (rate.low, rate.high, lengths.low) == (0.0, 1.0, 0.0)
    signed = stats.mean(np.repeat([-0.01, 0.02, 0.9], 100), seeds)
    apart = stats.paired_rate_difference(np.repeat([[1.0], [1.0], [-1.0]], 50, axis=1))
    assert signed is not None and signed.low < -0.01
    assert apart is not None and (apart.low, apart.high) == (-1.0, 1.0)


def test_mean_of_nothing_is_none_and_of_nan_an_error() -> None:
    assert stats.mean([]) is None
    with pytest.raises(ValueError, match="1 of 2 values are not finite"):
        stats.mean([1.0, math.nan])


def test_intervals_are_the_same_every_time() -> None:
    values = np.random.default_rng(0).normal(size=300)
    seeds = np.repeat([0, 1, 2], 100)
    assert stats.mean(values, seeds) == stats.mean(values, seeds)


def test_mcnemar_is_the_exact_binomial_test_of_the_discordant_pairs() -> None:
    a = np.array([True] * 30 + [True] * 9 + [False] * 2 + [False] * 10)
    b = np.array([True] * 30 + [False] * 9 + [True] * 2 + [False] * 10)
    test = stats.mcnemar(a, b)
    assert (test.n, test.only_a, test.only_b) == (51, 9, 2)
    assert test.p == pytest.approx(binomtest(2, 11, 0.5).pvalue)
    assert stats.mcnemar(a, a).p == 1.0
    with pytest.raises(ValueError, match="same episodes"):
        stats.mcnemar(a, b[:-1])


def test_paired_difference_counts_only_pairs_and_covers_the_truth() -> None:
    rng = np.random.default_rng(2)
    differences = rng.normal(-0.5, 0.2, size=(1, 300))
    differences[0, ::3] = np.nan
    found = stats.paired_difference(differences)
    assert found is not None
    assert (found.n, found.seeds) == (200, 1)
    assert found.value == pytest.approx(np.nanmean(differences))
    assert found.low < -0.5 < found.high < 0
    assert found.high - found.low == pytest.approx(2 * 1.96 * 0.2 / math.sqrt(200), rel=0.15)
    assert stats.paired_difference(np.full((2, 5), np.nan)) is None


def test_paired_difference_knows_that_seeds_share_episodes() -> None:
    """Ten seeds that all repeat one episode effect say no more than one seed does."""
    effect = np.random.default_rng(4).normal(size=(1, 100))
    one, ten = stats.paired_difference(effect), stats.paired_difference(np.repeat(effect, 10, axis=0))
    assert one is not None and ten is not None
    assert ten.high - ten.low == pytest.approx(one.high - one.low, rel=0.15)


def test_paired_difference_of_seeds_has_students_tails() -> None:
    """Seeds that differ, episodes that do not; a seed without a pair is no seed."""
    means = np.random.default_rng(5).normal(size=8)
    differences = np.repeat([*means, math.nan], 50).reshape(9, 50)
    found = stats.paired_difference(differences, resamples=20_000)
    assert found is not None and found.seeds == 8
    nested = stats.two_level_bootstrap(list(differences[:8]), resamples=20_000)
    assert (found.low, found.high) == pytest.approx(nested, abs=0.05)


def test_pairs_that_all_say_the_same_leave_room_for_what_was_not_seen() -> None:
    alike, opposite = (stats.paired_rate_difference(np.full((1, 40), value)) for value in (0.0, 1.0))
    assert alike is not None and opposite is not None
    assert (alike.low, alike.high) == (-stats.wilson(0, 40)[1], stats.wilson(0, 40)[1])
    assert (opposite.low, opposite.high) == (1 - stats.wilson(0, 40)[1], 1.0)
    mixed = np.array([[1.0, 0.0, -1.0, 0.0, 1.0]])
    assert stats.paired_rate_difference(mixed) == stats.paired_difference(mixed)


def test_holm() -> None:
    assert stats.holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert stats.holm([0.2, 0.001]) == pytest.approx(multipletests([0.2, 0.001], method="holm")[1])
    assert stats.holm([]).size == 0


def test_episodes_to_separate_the_papers_two_learned_methods() -> None:
    """0.89 against 0.83 needs about five times the paper's 100 episodes (arcsine formula worked out by hand)."""
    effect = 2 * math.asin(math.sqrt(0.89)) - 2 * math.asin(math.sqrt(0.83))
    by_hand = 2 * ((1.959964 + 0.841621) / effect) ** 2
    assert stats.episodes_to_separate(0.89, 0.83) == math.ceil(by_hand)
    assert 450 < by_hand < 600
    with pytest.raises(ValueError, match="equal rates"):
        stats.episodes_to_separate(0.5, 0.5)
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        stats.episodes_to_separate(1.5, 0.5)
