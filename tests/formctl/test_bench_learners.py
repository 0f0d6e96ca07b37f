"""``formctl bench train`` and ``formctl bench learn``: speeds taken apart, work counted, marks found."""

import csv

import pytest

from formctl import store
from formctl.timing.marks import Mark, learnt
from formctl.timing.stopwatch import PARTS, Stopwatch


def test_a_stopwatch_charges_the_innermost_part():
    now = [0.0]
    watch = Stopwatch(lambda: now[0])

    def step():
        now[0] += 2

    def update():
        now[0] += 1
        watch.wrap("world", step)()
        now[0] += 4

    watch.wrap("loss", update)()
    now[0] += 8
    watch.tick()
    assert watch.spent == {"other": 8, "loss": 5, "world": 2}


def test_bench_train_takes_learners_apart_and_flies_the_stock_one(call, tmp_path, only):
    small = ["profile=smoke", "algo.envs=4", "algo.rollout=4", "algo.pool=8", "logger=none", f"runs={tmp_path}"]
    words = ["--learner", "mappo_fast", "--learner", "shac", "--seconds", "0.1", "--no-compiled"]
    answer = call("bench", "train", *words, *small)
    assert answer.code == 0, answer.err
    assert "matrix peak" in answer.out and "of peak" in answer.out
    run = only("bench")
    rows = list(csv.DictReader((run.path / "speeds.csv").open()))
    assert [(row["learner"], row["mode"]) for row in rows] == [
        ("mappo_fast", "eager"),
        ("shac", "eager"),
        ("torchrl", "eager"),
    ]
    for row in rows:
        assert sum(float(row[part]) for part in PARTS) == pytest.approx(1)
        assert all(float(row[part]) > 0 for part in PARTS) and float(row["steps_per_second"]) > 0
        assert 0 < float(row["update_gflops"]) < float(row["peak_gflops"])
    assert (run.path / "speeds.png").read_bytes().startswith(b"\x89PNG")


def test_the_work_of_an_update_is_counted_by_hand():
    """Forward: products of the encoder for every token and the head, twice its multiplications; backward: twice that,
    but for the first layers, whose inputs want no gradient."""
    from formctl.settings import build, compose
    from formctl.timing import speed

    config = compose(["profile=smoke", "algo.envs=8", "algo.rollout=4", "algo.pool=8", "scenario.balls=2"])
    counted = speed.flops(build.training(config))
    width, encoder = 32, 0
    layout = speed.Trainer(build.training(config)).learner.policy.layout
    for tokens, dim in ((1, layout.self_dim), (2, layout.drones_dim), (2, layout.dynamic_dim), (1, layout.static_dim)):
        encoder += tokens * (dim * width + width * width)
    encoder += 6 * (4 * width * width + 2 * width * width)  # self-attention and its feed-forward
    encoder += 2 * width * width + 5 * 2 * width * width  # cross-attention: one query, five tokens
    encoder += 2 * 2 * width * width  # the pair's feed-forward
    forward = 3 * 2 * (2 * encoder + 4 * 2 * width + 2 * width)  # three drones, actor and critic
    assert counted["loss"] == pytest.approx(forward)
    assert 1.8 * forward < counted["backward"] < 2 * forward
    assert counted["world"] == 0 < counted["inference"]


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


def test_bench_learn_reads_a_training(stocked, call, tmp_path, only):
    ours = store.resolve("ours", stocked)
    answer = call("bench", "learn", "--run", str(ours.path), "--cfr", "0", "--fm", "1e10", f"runs={tmp_path}")
    assert answer.code == 0, answer.err
    run = only("bench")
    (row,) = csv.DictReader((run.path / "marks.csv").open())
    assert row["learner"] == "mappo three_period" and int(row["steps"]) == 160 and float(row["minutes"]) > 0
    (judged,) = csv.DictReader((run.path / "curves.csv").open())
    assert judged["steps"] == "160" and run.record["parents"] == [row["run"]] == [ours.id]
    assert (run.path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_bench_learn_trains_what_is_not_there(call, tmp_path, tiny):
    answer = call("bench", "learn", "--learner", "mappo_fast", "--seed", "3", *tiny, f"runs={tmp_path}")
    assert answer.code == 0, answer.err
    (run,) = store.scan(tmp_path, kind="train")
    assert (run.name, run.record["seed"], run.status) == ("learn_mappo_fast", 3, "done")
    assert "not reached" in answer.out


def test_bench_pilot_flies_the_same_vectors_at_every_budget(call, tmp_path, tiny, only):
    words = ("--trials", "3", "--budget", "64", "--budget", "32", *tiny, f"runs={tmp_path}")
    answer = call("bench", "pilot", *words)
    assert answer.code == 0, answer.err
    run = only("bench")
    rows = list(csv.DictReader((run.path / "trials.csv").open()))
    assert {row["budget"] for row in rows} == {"32", "64"} and len(rows) == 6
    vectors = {(row["trial"], row["w_formation"], row["w_flight"], row["w_obstacle"], row["w_action"]) for row in rows}
    assert len(vectors) == 3
    assert [row["budget"] for row in run.record["result"]["ranks"]] == [32, 64]
    assert len(run.record["parents"]) == 2 and (run.path / "pilot.png").read_bytes().startswith(b"\x89PNG")
    assert call("bench", "pilot", "--budget", "64", *tiny, f"runs={tmp_path}").code == 2
