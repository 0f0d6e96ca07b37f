import pytest

from analysis import stats
from analysis.data import published as paper


@pytest.mark.parametrize(
    ("method", "cfr", "fm", "successes", "episodes"),
    [
        ("ours", 0.89, 0.278, 89, 100),
        ("swarm_rl", 0.83, 0.959, 83, 100),
        ("rmader", 0.20, 4.052, 5, 25),
        ("swarm_formation", 0.08, 1.353, 2, 25),
    ],
)
def test_table_one(method: str, cfr: float, fm: float, successes: int, episodes: int) -> None:
    cell = paper.published(method, "mixed")
    assert cell is not None
    assert (cell.cfr, cell.fm, cell.successes, cell.episodes) == (cfr, fm, successes, episodes)
    assert "Table I" in cell.source


def test_table_two_and_what_the_paper_does_not_say() -> None:
    best = {cell.scenario: cell for cell in paper.REAL if cell.method == "ours"}
    assert {name: cell.successes for name, cell in best.items()} == {
        "real_static": 7,
        "real_dynamic": 7,
        "real_mixed": 8,
    }
    assert {cell.episodes for cell in paper.REAL} == {10}
    assert paper.published("swarm_rl", "real_mixed") is None
    assert all(cell.fm is None for cell in paper.REAL)


def test_the_papers_first_two_are_not_told_apart_by_its_episodes() -> None:
    ours, swarm_rl = paper.published("ours", "mixed"), paper.published("swarm_rl", "mixed")
    assert ours is not None and swarm_rl is not None
    assert stats.wilson(89, 100)[0] < stats.wilson(83, 100)[1]
