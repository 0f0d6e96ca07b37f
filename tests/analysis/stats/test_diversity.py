"""Styles of flying among trials of equal satisfaction rate."""

import numpy as np
import pandas as pd
import pytest

from analysis import stats
from analysis.claims import measures
from analysis.data import lookup
from analysis.data.evidence import gather
from analysis.data.rows import load
from analysis.stats import diversity
from tests.analysis.synthetic import Made, episodes, trials


@pytest.fixture
def study(tmp_path):
    """A store with a study of four trials: speeds and heights of its trials are given, SR of the last is low."""

    def make(speeds, heights, last=40):
        made = Made(tmp_path)
        folder = made.run("search", "stage1")
        satisfied = [190, 192, 188, last]
        table = trials(4).assign(
            sr_k=satisfied, sr=np.array(satisfied) / 200, run=[f"trials/{k:04d}" for k in range(4)]
        )
        table.to_parquet(folder / "trials.parquet", index=False)
        for number, (speed, height) in enumerate(zip(speeds, heights, strict=True)):
            rows = episodes(200, 0.9, seed=number).assign(method="trial", seed=0, run="", profile="laptop")
            own = np.random.default_rng(number).normal(0, 0.02, len(rows))
            rows["sr"] = (
                np.random.default_rng(9).permutation(200) < satisfied[number]
            )  # who misses one misses the best's
            rows = rows.assign(mean_speed=speed + own, height_error=height + abs(own), throttle_change=0.01, fm=0.05)
            (folder / f"trials/{number:04d}").mkdir(parents=True)
            rows.to_parquet(folder / f"trials/{number:04d}/episodes.parquet", index=False)
        return gather(load(tmp_path), "laptop")

    return make


def of(evidence):
    """The study's run and its trials with intervals."""
    run, trials = lookup.study(evidence)
    return run, diversity.with_intervals(trials)


def test_styles_are_means_of_the_trials_own_rows(study):
    run, found = of(study((1.8, 2.0, 2.2, 3.0), (0.1,) * 4))
    table = diversity.table(run, found)
    assert list(table["trial"]) == [1, 0, 2, 3] and list(table["equal"]) == [True, True, True, False]
    rows = pd.read_parquet(run.folder / "trials/0002/episodes.parquet")
    own = table[table["trial"] == 2].iloc[0]
    mean = stats.mean(rows["mean_speed"])
    assert (own["mean_speed"], own["mean_speed_low"], own["mean_speed_high"]) == (mean.value, mean.low, mean.high)


def test_intervals_that_touch_are_not_equal_rates(study):
    """On the same episodes 180 of 200 are fewer than 192, though the intervals of the two rates overlap."""
    run, found = of(study((2.0,) * 4, (0.1,) * 4, last=180))
    assert found["sr_high"].iloc[-1] > found["sr_low"].iloc[0]
    assert list(diversity.table(run, found)["equal"]) == [True, True, True, False]


def test_only_trials_of_equal_rate_make_styles(study):
    run, found = of(study((1.8, 2.0, 2.2, 3.0), (0.1, 0.1, 0.1, 5.0)))
    spread = {quantity.column: other for quantity, _, _, other in diversity.spread(diversity.table(run, found))}
    assert spread == {"mean_speed": True, "height_error": False, "fm": False, "throttle_change": False}
    assert diversity.spread(diversity.table(run, found)[:1]) == []


def test_the_claim_names_what_differs(study):
    (seen,) = measures.styles_of_equal_rate(study((2.0, 2.0, 2.0, 3.0), (0.1, 0.6, 0.1, 0.1)))
    assert seen.low == 1 and seen.text.startswith("3 trials of equal SR (0.940 to 0.960): height error 0.1")


def test_trials_of_one_style_do_not_confirm_it(study):
    (seen,) = measures.styles_of_equal_rate(study((2.0, 2.0, 2.0, 3.0), (0.1,) * 4))
    assert seen.low == 0 and seen.text.endswith("all of one style")
