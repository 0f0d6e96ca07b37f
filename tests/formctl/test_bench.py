"""``formctl bench`` and the words about what a run will cost."""

import csv

import pytest

from formctl import budget, store
from formctl.store.files import StoreError


def test_bench_measures_world_and_yardstick(call, tmp_path, only):
    answer = call(
        "bench", "env", "--environments", "4", "--seconds", "0.1", "--no-compiled", "logger=none", f"runs={tmp_path}"
    )
    assert answer.code == 0, answer.err
    assert "env steps/s, 3 drones each" in answer.out
    run = only("bench")
    rows = list(csv.DictReader((run.path / "timings.csv").open()))
    assert [(row["world"], row["mode"]) for row in rows] == [("torch", "eager"), ("mujoco.rollout", "native")]
    assert all(float(row["steps_per_second"]) > 0 and row["environments"] == "4" for row in rows)
    assert len(run.record["result"]["timings"]) == 2


def test_a_disk_too_small_is_said_before_anything_is_spent(tmp_path):
    assert "free in" in budget.room(10, tmp_path / "not" / "there")
    with pytest.raises(StoreError, match="are needed: make room or type runs=FOLDER"):
        budget.room(10**18, tmp_path)


def test_amounts_are_readable():
    amounts = (12, 999, 1_200, 45_000_000, 2e9)
    assert [budget.readable(amount) for amount in amounts] == ["12 B", "999 B", "1 kB", "45 MB", "2 GB"]


def test_flights_of_a_policy_are_timed_on_both_physics(call, tiny, stocked):
    words = ("--policy", "ours", "--episodes", "4", "--mujoco", "2", "name=timed")
    answer = call("bench", "eval", *tiny, f"runs={stocked}", *words)
    assert answer.code == 0, answer.err
    result = store.latest(stocked, "bench", "timed").record["result"]
    assert result["episodes"] == {"torch": 4, "mujoco": 2} and min(result["seconds"].values()) > 0
    each = {sim: result["seconds"][sim] / result["episodes"][sim] for sim in ("torch", "mujoco")}
    assert result["ratio"] == pytest.approx({"torch": 1, "mujoco": each["mujoco"] / each["torch"]})
    assert "seconds for 1,000" in answer.out and "compiled" not in answer.out
