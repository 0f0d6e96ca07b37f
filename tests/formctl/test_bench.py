"""``formctl bench`` and the words about what a run will cost."""

import pytest

from formctl import budget
from formctl.stages import bench
from formctl.store.files import StoreError
from tests.benchmarks.marks import Mark, learnt


def test_bench_measures_world_learner_and_evaluation(call, tmp_path, tiny, only, monkeypatch):
    monkeypatch.setattr(bench, "SIZE", 4)
    answer = call("bench", *tiny, f"runs={tmp_path}", "--seconds", "0.1", "--episodes", "2")
    assert answer.code == 0, answer.err
    assert "environment steps/s" in answer.out and "1,000 episodes take about" in answer.out
    speeds = only("bench").record["result"]["speeds"]
    assert [speed["what"].split()[0] for speed in speeds] == ["world", "learner", "evaluation"]
    assert all(speed["steps_per_second"] > 0 and speed["mode"] == "eager" for speed in speeds)
    assert speeds[0]["environments"] == 4 and speeds[1]["environments"] == 8


def test_a_disk_too_small_is_said_before_anything_is_spent(tmp_path):
    assert "free in" in budget.room(10, tmp_path / "not" / "there")
    with pytest.raises(StoreError, match="are needed: make room or type runs=FOLDER"):
        budget.room(10**18, tmp_path)


def test_amounts_are_readable():
    amounts = (12, 999, 1_200, 45_000_000, 2e9)
    assert [budget.readable(amount) for amount in amounts] == ["12 B", "999 B", "1 kB", "45 MB", "2 GB"]


def test_marks_are_found_in_judgements():
    rows = [
        {"steps": 1, "minutes": 0.1, "train/cfr": 1.0},
        {"steps": 2, "minutes": 0.2, "judge/cfr": 0.95, "judge/fm": 0.5},
        {"steps": 3, "minutes": 0.3, "judge/cfr": 0.9, "judge/fm": 0.2},
        {"steps": 4, "minutes": 0.4, "judge/cfr": 0.95, "judge/fm": 0.1},
    ]
    found = learnt("shac", 0, "x", rows, Mark(0.89, 0.278))
    assert (found.steps, found.minutes, found.last_steps, found.best_cfr, found.fm_at_best) == (3, 0.3, 4, 0.95, 0.1)
    none = learnt("shac", 0, "x", rows[:2], Mark(0.89, 0.278))
    assert (none.steps, none.minutes, none.best_cfr) == (None, None, 0.95)
    assert learnt("shac", 0, "x", [], Mark(0.89, 0.278)).best_cfr is None
