"""Anybody's rows held against each other: by hand, against statsmodels, and against the report's own paired table."""

import numpy as np
import pandas as pd
import pytest
from statsmodels.stats.contingency_tables import mcnemar

from analysis.stats import comparison
from analysis.stats.comparison import ComparisonError, Side


def rows(flags, **columns):
    return pd.DataFrame({"scenario_id": range(len(flags)), "cfr": np.array(flags, dtype=bool), **columns})


A = [1, 1, 1, 1, 1, 1, 1, 0, 0, 1]
B = [1, 1, 0, 0, 1, 1, 0, 0, 1, 0]


def test_counts_by_hand():
    found = comparison.compare(Side("a", rows(A)), Side("b", rows(B).sample(frac=1, random_state=0)))
    assert (found.shared, found.only_first, found.only_second, found.left_out) == (10, 4, 1, 0)
    assert (found.first.k, found.second.k) == (8, 5)
    assert found.difference.value == pytest.approx(-0.3)
    assert found.difference.low < -0.3 < found.difference.high
    assert found.p == pytest.approx(mcnemar([[4, 4], [1, 1]], exact=True).pvalue)
    assert found.fm is None


@pytest.mark.parametrize(("margin", "worse"), [(0.0, True), (0.29, True), (0.3, False), (0.5, False)])
def test_worse_is_beyond_the_margin(margin, worse):
    assert comparison.compare(Side("a", rows(A)), Side("b", rows(B))).worse(margin) is worse
    assert not comparison.compare(Side("b", rows(B)), Side("a", rows(A))).worse(margin)


def test_fm_counts_where_both_succeeded():
    fm = np.arange(10.0)
    found = comparison.compare(Side("a", rows(A, fm=fm)), Side("b", rows(B, fm=fm + 0.5)))
    assert found.fm.value == pytest.approx(0.5) and found.fm.n == 4


def test_episodes_that_only_one_flew_are_left_out():
    found = comparison.compare(Side("a", rows(A)), Side("b", rows(B[:6])))
    assert (found.shared, found.left_out, found.first.n) == (6, 4, 6)


def test_scenes_are_not_mixed_up():
    two = pd.concat([rows(A, columns=5), rows(B, columns=10)])
    other = pd.concat([rows(B, columns=10), rows(A, columns=5)])
    found = comparison.compare(Side("a", two), Side("b", other))
    assert (found.shared, found.only_first, found.only_second) == (20, 0, 0)


def test_seeds_meet_in_their_order_and_one_meets_all():
    three = pd.concat([rows(B, seed=seed) for seed in (3, 4, 5)])
    found = comparison.compare(Side("a", rows(A, seed=0)), Side("b", three))
    assert (found.shared, found.first.n, found.second.n, found.second.seeds) == (30, 10, 30, 3)
    assert found.difference.value == pytest.approx(-0.3)


def test_banks_are_told_apart_unless_asked():
    sides = Side("a", rows(A, bank="x")), Side("b", rows(B, bank="y"))
    with pytest.raises(ComparisonError, match="share no episode: their banks differ; --across-banks"):
        comparison.compare(*sides)
    assert comparison.compare(*sides, across_banks=True).shared == 10


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_files_come_back_as_they_were(tmp_path, suffix):
    path = tmp_path / f"mine{suffix}"
    written = rows(A)
    written.to_csv(path, index=False) if suffix == ".csv" else written.to_parquet(path)
    side = comparison.read(path)
    assert side.name == "mine" and side.rows["cfr"].tolist() == written["cfr"].tolist()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("a,b\n1,2\n", "has no column 'scenario_id'"),
        ("scenario_id,other\n1,2\n", "has no column 'cfr'"),
        ("scenario_id,cfr\n1,0.5\n", "column 'cfr' holds 0.5"),
        ("scenario_id,cfr\n", "holds no episodes"),
        ("scenario_id,cfr,method\n1,1,x\n1,0,y\n", "holds x, y: choose one with"),
    ],
)
def test_files_that_cannot_be_compared_say_why(tmp_path, table, message):
    (tmp_path / "rows.csv").write_text(table)
    with pytest.raises(ComparisonError, match=message) as caught:
        comparison.read(tmp_path / "rows.csv")
    assert "\n" not in str(caught.value)


def test_a_repeated_episode_is_refused():
    with pytest.raises(ComparisonError, match="episode 3 stands there"):
        comparison.compare(Side("a", rows(A)), Side("b", pd.concat([rows(B), rows(B)[3:4]])))


def test_the_report_s_paired_table_says_the_same(tmp_path):
    """On the cells of a whole store: differences, intervals and p values, several seeds included."""
    from analysis.data import evidence, lookup, rows
    from analysis.tables import ablations
    from tests.analysis.synthetic import full_store

    found = evidence.gather(rows.load(full_store(tmp_path).root))
    table = ablations.paired_table(found)
    where = lookup.main_place(found)
    best = lookup.best(found, where)
    ours = found.cells[best.key, where].assign(seed=lambda frame: frame["train_seed"])
    for row in table.rows:
        (key,) = [m.key for m in found.shown if found.names[m.key] == row[0].text]
        theirs = found.cells[key, where].assign(seed=lambda frame: frame["train_seed"])
        one = comparison.compare(Side("theirs", theirs), Side("ours", ours), across_banks=True)
        assert one.difference.value == row[1].value
        assert f"[{one.difference.low:+.3f}, {one.difference.high:+.3f}]".replace("-", "−") in row[1].details
        assert one.p <= row[2].value
        if one.fm is not None:
            assert one.fm.value == pytest.approx(row[3].value)
