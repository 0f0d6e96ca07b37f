"""A baseline that is trained: its training, its policy under both names, and where it cannot fly."""

import pandas as pd
import pytest

from formctl import store

SMALL = ("algo.envs=8", "algo.rollout=16", "algo.minibatches=4", "algo.pool=8", "algo.pool_updates=2")


def test_what_is_trained_is_flown_as_policy_and_as_baseline(formctl, tmp_path):
    words = (
        "experiment=swarm_rl",
        "algo=swarm_rl",
        "reward=swarm_rl",
        "encoder=swarm_rl_small",
        *SMALL,
        "train.steps=256",
        "train.judge_episodes=2",
    )
    answer = formctl("train", *words, "eval.seconds=0.2", "name=rl")
    assert answer.code == 0, answer.err
    run = store.resolve("train/rl", tmp_path)
    metrics = run.metrics()[-1]
    assert metrics["steps"] == 256 and metrics["learn/annealing"] == 1.0 and metrics["learn/snapshots"] == 0
    out = tmp_path / "rows.parquet"
    flown = ("--policy", "rl", "--baseline", "swarm_rl", f"baseline.policy={run.path / 'policy.pt'}")
    answer = formctl("eval", *flown, "eval.seconds=0.4", "--out", str(out))
    assert answer.code == 0, answer.err
    assert "swarm_rl was trained for 256 steps in" in answer.out and "1,000,000,000 that were published" in answer.out
    rows = pd.read_parquet(out)
    assert list(rows["method"].unique()) == ["rl", "swarm_rl"]
    assert set(rows["drone"]) == {"crazyflie"}, "one craft, whatever it is told"
    measured = [name for name in rows.columns if name not in ("method", "seed", "run", "profile")]
    policy, baseline = (part[measured].reset_index(drop=True) for _, part in rows.groupby("method", sort=False))
    assert policy.equals(baseline) and policy["mean_speed"].gt(0).all()


@pytest.mark.parametrize(
    ("command", "words", "message"),
    [
        ("eval", ("scenario.formation=[[0,0,0],[1,0,0]]",), "'swarm_rl' flies at least 3 drones, the formation has 2"),
        ("eval", ("baseline.policy=none",), "there is no policy"),
        ("eval", ("drone=crazyflie_rotor", "drone.control_period=0.02"), "use drone.control_period=0.01"),
        ("deploy", (), "swarm_rl commands rotor thrusts every 10 ms, which no radio carries"),
    ],
)
def test_what_it_cannot_do(formctl, command, words, message):
    answer = formctl(command, "--baseline", "swarm_rl", *words)
    assert answer.code == 2 and message in answer.line


@pytest.mark.parametrize("method", [("--policy", "mixed"), ("--baseline", "hover")])
def test_who_commands_rates_does_not_fly_rotors(formctl, method):
    answer = formctl("eval", *method, "drone=crazyflie_rotor")
    assert answer.code == 2 and "commands ctbr" in answer.line
