"""``formctl deploy``: flights over simulated motion capture and radio, and their set-points."""

import pandas as pd
import pytest

from envs.bank import Bank
from formctl import store
from formctl.deployment import dry_run
from formctl.evaluation import evaluate, methods, scenes
from formctl.evaluation.disturbances import disturbed
from formctl.settings import build, compose


def flights(stocked, name):
    """The rows of every run of that name, and the runs, oldest first."""
    runs = list(reversed(store.scan(stocked, kind="eval", name=name)))
    return [pd.read_parquet(run.path / "episodes.parquet") for run in runs], runs


def test_the_real_scenes_on_both_physics(formctl_stocked, stocked):
    call = ("deploy", "--baseline", "straight_line", "--flights", "2", "eval.seconds=0.1", "eval.time_limit=0.1")
    answer = formctl_stocked(*call, "name=flown_both")
    assert answer.code == 0, answer.err
    tables, runs = flights(stocked, "flown_both")
    flown = [(rows["scenario"][0], rows["sim"][0]) for rows in tables]
    scenes = ("real_static", "real_dynamic", "real_mixed")
    assert sorted(flown) == sorted((scene, sim) for scene in scenes for sim in ("torch", "mujoco"))
    assert {rows["deploy"][0] for rows in tables} == {"mocap"}
    assert {rows["drone"][0] for rows in tables} == {"crazyflie"}
    assert runs[0].config["deploy"]["latency"] == 0.02
    assert "CFR of ten" in answer.out and "0.0 (0 of 2)" in answer.out
    again = formctl_stocked(*call, "name=flown_again", "--sim", "torch", "scenario=real_static")
    assert again.code == 0, again.err
    (second,), _ = flights(stocked, "flown_again")
    pd.testing.assert_frame_equal(second, tables[flown.index(("real_static", "torch"))])


def test_every_value_is_flown_and_named(formctl_stocked, stocked):
    words = ("--baseline", "hover", "--flights", "2", "--vary", "latency=0,0.03", "--vary", "mass=1.1")
    answer = formctl_stocked("deploy", *words, "name=varied", "eval.seconds=0.1", "eval.time_limit=0.1")
    assert answer.code == 0, answer.err
    tables, runs = flights(stocked, "varied")
    assert sorted(rows["deploy"][0] for rows in tables) == [
        "mocap latency=0", "mocap latency=0.03", "mocap mass=1.1",
    ]  # fmt: skip
    assert {rows["scenario"][0] for rows in tables} == {"real_mixed"} and {rows["sim"][0] for rows in tables} == {
        "torch"
    }
    assert [1.1, 1.1] in [run.config["deploy"]["mass"] for run in runs]


def test_planners_for_real_flights_have_a_tracker_that_bears_the_clip():
    """From tilted starts drones that fly straight swing into each other with the usual gains, not with theirs."""
    words = ["deploy=mocap", "scenario=real_static", "scenario.columns=0", "eval.seconds=6"]
    config = compose(words)
    scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 20, seed=1000))
    met = []
    for planner in ("rmader_fair", "rmader_real"):
        tracker = methods.baseline(planner).settings["tracker"]
        straight = methods.baseline("straight_line", [f"baseline.tracker.{key}={tracker[key]}" for key in tracker])
        met.append(int((evaluate.evaluate(straight, [scene], config)["failure"] == "drone").sum()))
    assert met[0] > 0 == met[1]


def test_an_episode_becomes_set_points(formctl_stocked, stocked, tmp_path):
    words = ("--policy", "ours", "--flights", "2", "--sim", "torch", "scenario=real_mixed", "name=setpointsd")
    assert formctl_stocked("deploy", *words).code == 0
    out = tmp_path / "points.csv"
    answer = formctl_stocked("deploy", "--dry-run", "setpointsd:1", "--out", str(out))
    assert answer.code == 0, answer.err
    points = pd.read_csv(out)
    assert list(points["drone"][:3]) == [0, 1, 2] and not points.iloc[:3, 2:].any(axis=None)  # unlocking
    assert len(points) == 3 + 3 * 20  # 0.4 s at 50 Hz
    assert points.iloc[:, 2:5].abs().max(axis=None) <= 45.001 and points["thrust"][3:].between(29490, 60000).all()
    assert "body rates" in answer.out and "NOT OK" not in answer.out


def test_a_flight_without_the_clip_may_not_be_sent(formctl_stocked, tmp_path):
    flown = ("--baseline", "straight_line", "baseline.acceleration=40", "scenario=real_mixed", "eval.episodes=1")
    assert formctl_stocked("eval", *flown, "name=wild").code == 0
    answer = formctl_stocked("deploy", "--dry-run", "wild:0", "--out", str(tmp_path / "points.csv"))
    assert answer.code == 1 and "may not be sent: body rates" in answer.line and "formctl deploy" in answer.line


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "nothing to fly"),
        (("--baseline", "hover", "--sim", "isaac"), "there is no physics 'isaac', only torch and mujoco"),
        (
            ("--baseline", "hover", "--vary", "fog=1"),
            "--vary fog: deploy has no such quantity; it has position_noise",
        ),
        (("--baseline", "hover", "--vary", "latency=x"), "--vary latency=x cannot be used"),
        (("--baseline", "hover", "deploy=null"), "deploy=null leaves nothing to deploy with"),
        (("--baseline", "hover", "--vary", "packet_loss=2"), "deploy.packet_loss"),
        (("--dry-run", "main"), "write RUN:EPISODE, for example main:7"),
        (("--dry-run", "main:0", "--baseline", "hover"), "leave --baseline out"),
        (("--dry-run", "main:0", "--policy", "mixed", "--policy", "swarm_rl"), "give --policy once"),
        (("--dry-run", "nobody:0"), "no eval run with an episodes.parquet 'nobody'"),
    ],
)
def test_wrong_calls(formctl_stocked, words, message):
    answer = formctl_stocked("deploy", *words)
    assert answer.code == 2 and message in answer.line


def test_only_an_episode_becomes_set_points(formctl_stocked):
    answer = formctl_stocked("deploy", "--dry-run", "near.mcap")
    assert answer.code == 2 and answer.line == "cannot read 'near.mcap': write RUN:EPISODE, for example main:7"


def test_an_episode_of_a_shipped_policy(formctl_stocked, stocked, tmp_path):
    flown = ("--policy", "sim_to_real", "--flights", "1", "--sim", "torch", "scenario=real_static", "name=for_real")
    assert formctl_stocked("deploy", *flown).code == 0
    words = ("deploy", "--dry-run", "for_real:0", "--out", str(tmp_path / "points.csv"))
    answer = formctl_stocked(*words)
    assert answer.code == 0 and "NOT OK" not in answer.out, answer.err
    answer = formctl_stocked(*words, "--policy", "mixed")
    assert answer.code == 2 and "--policy mixed comes from training run" in answer.line
    (evaluation,) = store.scan(stocked, kind="eval", name="for_real")
    evaluation.update(method=evaluation.record["method"] | {"run": ""})
    answer = formctl_stocked(*words)
    assert answer.code == 2 and answer.line.endswith("give --policy RUN, FILE or NAME")
    assert formctl_stocked(*words, "--policy", "sim_to_real").code == 0


def test_the_firmware_s_cut_is_a_warning(formctl_stocked, tmp_path, monkeypatch):
    def at_full_thrust(flown):
        commands, row = fly_again(flown)
        commands[:2, 0, 3] = 1
        return commands, row

    fly_again = dry_run.fly_again
    monkeypatch.setattr(dry_run, "fly_again", at_full_thrust)
    words = ("deploy", "--baseline", "straight_line", "--flights", "1", "--sim", "torch", "scenario=real_mixed")
    setpoints = ("deploy", "--out", str(tmp_path / "points.csv"), "--dry-run")
    assert formctl_stocked(*words, "name=full").code == 0
    answer = formctl_stocked(*setpoints, "full:0")
    assert answer.code == 0 and "NOT OK" not in answer.out, answer.err
    assert answer.err == (
        "warning: the firmware cuts 2 of 60 set-points (3.3%) to 60000, by up to 3.6% of their thrust; to have none"
        " cut, fly with formctl deploy ... drone.thrust_range=[0.4,0.865]\n"
    )
    assert formctl_stocked(*words, "drone.thrust_range=[0.4,0.865]", "name=less").code == 0
    answer = formctl_stocked(*setpoints, "less:0")
    assert answer.code == 0 and answer.err == "", answer.err


def test_an_episode_that_does_not_exist(formctl_stocked):
    assert formctl_stocked("eval", "--baseline", "hover", "name=few").code == 0
    answer = formctl_stocked("deploy", "--dry-run", "few:99")
    assert answer.code == 2 and "has no episode 99: its episodes are 0 to 2" in answer.line


def test_pairs_and_switches_are_varied_as_what_they_are():
    config = compose(["deploy=mocap"])
    windy = list(disturbed(config, {"wind": (0.0, 2.0), "ground_effect": (1.0,)}))
    assert [one.deploy.wind for one in windy] == [(0.0, 0.0), (2.0, 2.0), (0.0, 0.0)]
    assert [one.deploy.name for one in windy] == ["mocap wind=0", "mocap wind=2", "mocap ground_effect=1"]
    assert [one.deploy.ground_effect for one in windy] == [False, False, True]
