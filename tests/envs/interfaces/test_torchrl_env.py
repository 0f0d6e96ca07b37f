"""The TorchRL wrapper: TorchRL's own conformance check, and the same numbers as the world it wraps."""

import pytest
import torch
from torchrl.envs import RewardSum, TransformedEnv
from torchrl.envs.utils import check_env_specs

from envs.interfaces.torchrl_env import TorchRLFormationEnv
from envs.mujoco_env import MujocoFormationEnv

WEIGHTS = (0.1, 0.2, 0.3, 0.4)


@pytest.mark.parametrize(
    ("overrides", "weights"),
    [
        (("scenario=mixed",), WEIGHTS),
        (("scenario=free", "observation=release"), None),
        (("scenario=static", "scenario.formation=square"), WEIGHTS),
    ],
    ids=["mixed", "free", "square"],
)
@pytest.mark.parametrize("flat", [True, False])
def test_specs(make_env, overrides, weights, flat):
    env = TorchRLFormationEnv(make_env(*overrides, dtype=torch.float32), 3, weights=weights, flat=flat)
    check_env_specs(env)
    assert (("agents", "reward") in env.reward_keys) == (weights is not None)
    assert env.batch_locked
    assert env.group_map["agents"] == [f"drone_{i}" for i in range(env.env.drones)]


def test_specs_on_mujoco(make_env):
    world = make_env("scenario=mixed").world
    check_env_specs(TorchRLFormationEnv(MujocoFormationEnv(world, torch.float32), 2))


def test_steps_are_the_world_s(make_env):
    inner = make_env("scenario=mixed", "scenario.throw_time=[0.0,0.1]")
    env = TorchRLFormationEnv(inner, 4, seed=5, weights=WEIGHTS, flat=False)
    out = env.reset()
    scenarios = env.stream.scenarios
    state = inner.reset(scenarios)
    for _ in range(10):
        out = env.step(env.rand_action(out))
        state, vector, events = inner.step(state, out["agents", "action"], scenarios)
        torch.testing.assert_close(out["next", "agents", "reward_vector"], vector)
        expected = (vector * torch.tensor(WEIGHTS, dtype=torch.float64)).sum(-1, keepdim=True)
        torch.testing.assert_close(out["next", "agents", "reward"], expected)
        assert torch.equal(out["next", "terminated"][:, 0], inner.terminated(state, events))
        for name, group in inner.observe(state, scenarios).items():
            assert torch.equal(out["next", "agents", "observation", name], group)
        out = out["next"]


def test_a_seed_fixes_the_episodes(make_env):
    env = TorchRLFormationEnv(make_env("scenario=mixed"), 3, seed=1, flat=False)
    first = env.reset()["agents", "observation", "static"]
    second = env.reset()["agents", "observation", "static"]
    assert not torch.equal(first, second)
    env.set_seed(1)
    assert torch.equal(env.reset()["agents", "observation", "static"], first)


def test_a_partial_reset_leaves_the_others_alone(make_env):
    env = TorchRLFormationEnv(make_env("scenario=mixed"), 3, flat=False, block=4)
    out = env.step(env.rand_action(env.reset()))["next"]
    before = out["agents", "observation", "self"].clone()
    columns = env.stream.scenarios.columns.clone()
    out["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(out)["agents", "observation", "self"]
    assert torch.equal(after[[0, 2]], before[[0, 2]])
    assert not torch.equal(after[1], before[1])
    assert env.stream.state.step.tolist() == [1, 0, 1]
    assert torch.equal(env.stream.scenarios.columns[[0, 2]], columns[[0, 2]])
    assert not torch.equal(env.stream.scenarios.columns[1], columns[1])


def test_ended_episodes_start_again_in_a_rollout(make_env):
    """With falling drones, TorchRL's own loop resets what ended, and its transforms find the rewards."""
    env = TorchRLFormationEnv(make_env("scenario=free", "scenario.start=[0,0,0.25]"), 3, weights=WEIGHTS)
    summed = TransformedEnv(
        env, RewardSum(in_keys=[("agents", "reward")], out_keys=[("agents", "sum")], reset_keys=["_reset"])
    )
    fall = torch.tensor([0.0, 0.0, 0.0, -1.0], dtype=torch.float64).expand(3, 3, 4)
    data = summed.rollout(40, policy=lambda td: td.set(("agents", "action"), fall), break_when_any_done=False)
    assert data["next", "terminated"].sum(1).min() >= 2
    assert not data["next", "truncated"].any()
    ended = data["next", "done"][0, :, 0]
    total = data["next", "agents", "sum"][0, :, 0, 0]
    reward = data["next", "agents", "reward"][0, :, 0, 0]
    first = int(ended.nonzero()[0])
    torch.testing.assert_close(total[first], reward[: first + 1].sum())
    torch.testing.assert_close(total[first + 1], reward[first + 1])


def test_the_time_limit_truncates(make_env):
    env = TorchRLFormationEnv(make_env("scenario=free", "scenario.duration=0.1"), 2)
    hover = env.env.reset(env.stream.scenarios).command
    data = env.rollout(10, policy=lambda td: td.set(("agents", "action"), hover))
    assert data["next", "truncated"][:, :, 0].tolist() == [[False] * 4 + [True]] * 2
    assert not data["next", "terminated"].any()
