"""``formctl eval``: the same episodes for everybody, the same bytes every time."""

from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd
import pytest

from envs.bank import Bank
from formctl import store
from formctl.evaluation import evaluate, flight, methods, scenes
from formctl.settings import build, compose

COLUMNS = """method seed run profile scenario columns balls ball_aim drones sim drone deploy bank scenario_id
metric_version cfr cfr_strict cfr_any_path reached time_to_goal time_y30 time_y32_4 time_y34 time_y40 hit_column
hit_ball hit_drone crashed hit_ground hit_ceiling hit_strict first_contact_time contact_drone left_corridor failure
fm fm_to_contact shape_error throttle_change throttle_change_last command_change ok_formation ok_flight ok_obstacle
ok_action sr min_column min_ball min_drone speed_error height_error heading_error mean_speed planner_failures
planner_reason message_period message_delay message_loss"""
"""Columns that readers of ``episodes.parquet`` rely on."""


@pytest.fixture
def fly(formctl_stocked, tmp_path):
    """Evaluate with the stocked store's policy in reach; returns the answer and the rows of ``--out``."""

    def run(*words):
        out = tmp_path / "rows.parquet"
        answer = formctl_stocked("eval", "--out", str(out), *words)
        return answer, pd.read_parquet(out) if out.exists() else None

    return run


def test_rows_of_a_policy_and_a_baseline(fly, stocked):
    answer, rows = fly("--policy", "ours", "--baseline", "straight_line", "name=both")
    assert answer.code == 0, answer.err
    assert set(rows.columns) == set(COLUMNS.split()) and len(rows) == 6
    trained = store.resolve("train/ours", stocked)
    assert list(rows["method"]) == ["ours"] * 3 + ["straight_line"] * 3
    assert list(rows["run"]) == [trained.id] * 3 + [""] * 3
    assert rows["bank"].nunique() == 1 and list(rows["scenario_id"]) == [0, 1, 2] * 2
    assert set(rows["profile"]) == {"smoke"} and set(rows["columns"]) == {10} and set(rows["drones"]) == {3}
    assert "straight_line" in answer.out and "95 % interval" in answer.out and "(0 of 3)" in answer.out
    baseline, policy = store.scan(stocked, kind="eval", name="both")
    assert policy.record["method"] == trained.record["method"] and policy.record["parents"] == [trained.id]
    assert policy.record["bank"]["sha256"] == rows["bank"][0] and policy.record["bank"]["episodes"] == 3
    assert baseline.record["method"]["kind"] == "baseline" and baseline.config["baseline"]["acceleration"] == 4.0
    assert pd.read_parquet(policy.path / "episodes.parquet").equals(rows[:3])


def test_a_second_flight_gives_the_same_bytes(fly, tmp_path):
    call = ("--policy", "ours", "--baseline", "hover", "name=twice")
    fly(*call)
    first = (tmp_path / "rows.parquet").read_bytes()
    fly(*call)
    assert (tmp_path / "rows.parquet").read_bytes() == first


def test_grid_flies_every_scene_once(fly, stocked):
    answer, rows = fly("--baseline", "straight_line", "--grid", "columns=0,5", "balls=0,1", "name=grid")
    assert answer.code == 0, answer.err
    scenes = rows.groupby(["columns", "balls"])
    assert sorted(scenes.groups) == [(0, 0), (0, 1), (5, 0), (5, 1)]
    assert set(scenes.size()) == {3} and rows["bank"].nunique() == 4
    assert rows.loc[rows["columns"] == 0, "min_column"].isna().all()
    run = store.latest(stocked, "eval", "grid")
    assert [bank["sha256"] for bank in run.record["banks"]] == list(rows["bank"].unique())


def test_an_axis_or_a_method_given_twice_counts_once(fly):
    words = (
        "--grid",
        "columns=0,0",
        "--grid",
        "columns=5",
        "--baseline",
        "straight_line",
        "--baseline",
        "straight_line",
    )
    answer, rows = fly(*words)
    assert answer.code == 0, answer.err
    assert list(rows.groupby("columns").size().items()) == [(0, 3), (5, 3)]


def test_side_by_side_is_the_same_flight(fly):
    grid = fly("--baseline", "straight_line", "--grid", "columns=0,5", "--grid", "balls=1")[1]
    alone = fly("--baseline", "straight_line", "scenario.columns=5", "scenario.balls=1")[1]
    together = grid[grid["columns"] == 5].reset_index(drop=True)
    exact = ["bank", "scenario_id", "failure", "cfr", "contact_drone"]
    assert together[exact].equals(alone[exact])
    pd.testing.assert_frame_equal(together, alone, rtol=1e-4, atol=1e-5)


def test_what_is_compiled_flies_whole_batches_of_the_same_episodes(monkeypatch):
    compiled, batches = [], []

    def compiler(enabled):
        def compile(function):
            def call(*args):
                batches.extend([len(args[0].position)] if function.__name__ == "observe" else [])
                return function(*args)

            compiled.append((enabled, function.__name__))
            return call

        return compile

    monkeypatch.setattr(flight, "Compiler", compiler)
    words = ["profile=smoke", "eval.episodes=3", "eval.batch=2", "eval.seconds=0.2"]
    method = methods.policy("mixed", Path("runs"))
    flown = {}
    for choice in (False, True):
        config = method.settings_of(compose([*words, f"eval.compile={choice}"]))
        scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 3, seed=1))
        flown[choice] = evaluate.evaluate(method, [scene], config)
    assert compiled == [(True, name) for name in ("observe", "advance", "judge", "update")]
    assert batches == [2] * 20
    pd.testing.assert_frame_equal(flown[True], flown[False], rtol=1e-4, atol=1e-5)


def test_a_deployment_is_never_compiled(monkeypatch):
    asked = []
    monkeypatch.setattr(flight, "Compiler", lambda enabled: asked.append(enabled) or (lambda function: function))
    config = compose(["deploy=mocap", "scenario=real_mixed", "eval.compile=true", "eval.seconds=0.04"])
    scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 3, seed=1))
    assert len(evaluate.evaluate(methods.policy("sim_to_real", Path("runs")), [scene], config)) == 3
    assert asked == []


def test_a_stored_bank_is_flown_as_it_is(fly, tmp_path):
    bank = Bank.create(compose(["scenario=static", "scenario.columns=7"]).scenario, 2, seed=7)
    bank.save(tmp_path / "bank.npz")
    answer, rows = fly("--baseline", "hover", "--bank", str(tmp_path / "bank.npz"))
    assert answer.code == 0, answer.err
    assert set(rows["bank"]) == {bank.sha256} and set(rows["columns"]) == {7} and set(rows["scenario"]) == {"static"}
    same, _ = fly("--baseline", "hover", "--bank", str(tmp_path / "bank.npz"), "scenario=static", "scenario.columns=7")
    assert same.code == 0, same.err
    other, _ = fly("--baseline", "hover", "--bank", str(tmp_path / "bank.npz"), "scenario.columns=8")
    assert other.code == 2 and "leave out scenario overrides" in other.line
    for words in (("--grid", "columns=5"), ("--episodes", "4")):
        both, _ = fly("--baseline", "hover", "--bank", str(tmp_path / "bank.npz"), *words)
        assert both.code == 2 and "--bank is a fixed set of episodes" in both.line


def test_a_damaged_bank_is_refused(fly, tmp_path):
    (tmp_path / "bank.npz").write_bytes(b"PK\x03\x04 not a bank")
    answer, _ = fly("--baseline", "hover", "--bank", str(tmp_path / "bank.npz"))
    assert answer.code == 2 and "bank.npz" in answer.line


def test_a_policy_file_knows_where_it_comes_from(fly, stocked, tmp_path):
    trained = store.resolve("train/ours", stocked)
    copy = tmp_path / "copied.pt"
    copy.write_bytes((trained.path / "policy.pt").read_bytes())
    answer, rows = fly("--policy", str(copy))
    assert answer.code == 0, answer.err
    assert set(rows["method"]) == {"ours"} and set(rows["run"]) == {trained.id}


def test_a_policy_that_ships_is_flown_by_its_name(fly):
    answer, rows = fly("--policy", "mixed")
    assert answer.code == 0, answer.err
    assert len(rows) and set(rows["method"]) == {"dense"}


def test_mujoco_flies_the_same_episodes(fly):
    answer, rows = fly("--baseline", "straight_line", "sim=mujoco", "eval.episodes=2")
    assert answer.code == 0, answer.err
    torch_rows = fly("--baseline", "straight_line", "eval.episodes=2")[1]
    assert set(rows["sim"]) == {"mujoco"} and list(rows["bank"]) == list(torch_rows["bank"])
    assert rows["mean_speed"].to_numpy() == pytest.approx(torch_rows["mean_speed"].to_numpy(), abs=1e-3)


def test_both_physics_in_one_call(fly):
    answer, rows = fly("--baseline", "hover", "--sim", "mujoco,torch", "eval.episodes=1")
    assert answer.code == 0, answer.err
    assert list(rows["sim"]) == ["mujoco", "torch"] and rows["bank"].nunique() == 1
    assert ", mujoco" in answer.out


def test_settings_of_a_baseline_reach_it(fly):
    slow = fly("--baseline", "straight_line", "baseline.acceleration=1")[1]
    fast = fly("baseline=straight_line")[1]
    assert (slow["mean_speed"] < fast["mean_speed"]).all()


def test_a_policy_sees_what_it_was_trained_to_see(fly, stocked, tmp_path):
    from algos.policy import Policy

    older = Policy.load(store.resolve("train/ours", stocked).path / "policy.pt")
    older.observation = replace(older.observation, slot_relative=False)
    older.save(tmp_path / "older.pt")
    assert fly("--policy", str(tmp_path / "older.pt"), "name=older")[0].code == 0
    assert store.latest(stocked, "eval", "older").config["observation"] == asdict(older.observation)
    answer, _ = fly("--policy", str(tmp_path / "older.pt"), "observation.slot_relative=true")
    assert answer.code == 2 and answer.line.endswith("use observation=paper observation.slot_relative=False")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "nothing to fly"),
        (("--baseline", "rmadr"), "there is no baseline 'rmadr'; the choices are hover, rmader"),
        (("--policy", "nobody"), "no run with a policy.pt 'nobody'"),
        (("--policy", "nobody"), "shipped with formctl: mixed"),
        (("--policy", "ours", "observation=release"), "observation=paper"),
        (("--baseline", "hover", "--sim", "isaac"), "--sim isaac cannot be used"),
        (("--baseline", "hover", "--grid", "rows=3"), "--grid rows=3 cannot be used"),
        (("--baseline", "hover", "--grid", "columns=3,x"), "--grid columns=3,x cannot be used"),
        (("--baseline", "hover", "--grid", "columns=100000"), "100000"),
    ],
)
def test_wrong_calls(fly, stocked, words, message):
    before = len(store.scan(stocked))
    answer, rows = fly(*words)
    assert answer.code == 2 and message in answer.line
    assert rows is None and len(store.scan(stocked)) == before


def test_a_damaged_policy_is_refused(fly, tmp_path):
    path = tmp_path / "policy.pt"
    path.write_bytes(b"neither zip nor pickle")
    answer, _ = fly("--policy", str(path))
    assert answer.code == 2 and "is damaged or not a formctl policy file" in answer.line


def test_one_of_a_thing_is_told_in_the_singular(fly):
    answer, _ = fly(
        "--baseline", "hover", "--episodes", "1", "scenario=mixed", "scenario.columns=1", "scenario.balls=1"
    )
    assert answer.code == 0, answer.err
    assert "about to fly hover: 1 episode each" in answer.out and "1 column, 1 ball aimed at" in answer.out
