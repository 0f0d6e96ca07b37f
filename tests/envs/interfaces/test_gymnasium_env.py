"""The Gymnasium environments: Gymnasium's own checker, its autoreset modes, and the world's own numbers."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import FlattenObservation, RecordEpisodeStatistics

from envs.interfaces.gymnasium_env import GymnasiumFormationEnv, GymnasiumFormationVectorEnv
from envs.interfaces.stream import GROUPS, flatten
from formctl import environments

WEIGHTS = (0.1, 0.2, 0.3, 0.4)
DOWN = np.tile(np.float32([0, 0, 0, -1]), (3, 3, 1))  # three teams fall
LOW = "scenario.start=[0,0,0.25]"


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("overrides", [("scenario=mixed",), ("scenario=free", "scenario.formation=square")])
def test_gymnasium_s_checker_passes(make_env, overrides, flat, recwarn):
    env = GymnasiumFormationEnv(make_env(*overrides, dtype=torch.float32), WEIGHTS, flat=flat)
    check_env(env, skip_render_check=True)
    told = [str(warning.message) for warning in recwarn if "infinity" not in str(warning.message)]
    assert told == []


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_what_comes_out_lies_in_the_spaces(make_env, flat, mode):
    env = GymnasiumFormationVectorEnv(make_env("scenario=mixed"), 3, WEIGHTS, flat=flat, autoreset_mode=mode)
    env.action_space.seed(0)
    seen, _ = env.reset(seed=0)
    assert seen in env.observation_space
    for _ in range(3):
        seen, reward, terminated, truncated, infos = env.step(env.action_space.sample())
        assert seen in env.observation_space
        assert reward.shape == terminated.shape == truncated.shape == infos["_reward_vector"].shape == (3,)
        assert infos["reward_vector"].shape == (3, 3, 4)
        np.testing.assert_allclose(reward, (infos["reward_vector"] @ WEIGHTS).mean(-1), rtol=1e-5)


def test_steps_are_the_world_s(make_env):
    world = make_env("scenario=mixed", "scenario.throw_time=[0.0,0.1]")
    env = GymnasiumFormationVectorEnv(world, 4, WEIGHTS, seed=5)
    env.action_space.seed(0)
    env.reset()
    scenarios = env.stream.scenarios
    state = world.reset(scenarios)
    for _ in range(10):
        action = env.action_space.sample()
        seen, _, terminated, _, infos = env.step(action)
        state, vector, events = world.step(state, torch.as_tensor(action, dtype=torch.float64), scenarios)
        np.testing.assert_allclose(infos["reward_vector"], vector, rtol=1e-6)
        assert terminated.tolist() == world.terminated(state, events).tolist()
        np.testing.assert_array_equal(seen, flatten(world.observe(state, scenarios)).float())


def test_a_vector_has_the_groups_in_their_order(make_env):
    world = make_env("scenario=mixed")
    flat, groups = (GymnasiumFormationVectorEnv(world, 2, WEIGHTS, seed=3, flat=flat) for flat in (True, False))
    vector, seen = flat.reset()[0], groups.reset()[0]
    np.testing.assert_array_equal(vector, np.concatenate([seen[name].reshape(2, 3, -1) for name in GROUPS], -1))
    assert vector.shape[-1] == 25 + 2 * 7 + 9 + 2 * 10 + 1 + 2


def test_the_next_step_after_an_end_starts_anew(make_env):
    env = GymnasiumFormationVectorEnv(make_env("scenario=free", LOW), 3, WEIGHTS)
    start, _ = env.reset()
    ended = np.zeros(3, dtype=bool)
    while not ended.any():
        before, _, ended, _, _ = env.step(DOWN)
    assert (before[ended][..., 2] < 0.2 - 1.5).any()
    seen, reward, terminated, truncated, _ = env.step(DOWN)
    np.testing.assert_array_equal(seen[ended], start[ended])  # free flight always starts alike
    assert not reward[ended].any()
    assert not (terminated | truncated)[ended].any()


def test_the_same_step_starts_anew_and_keeps_what_was_seen_last(make_env):
    mode = AutoresetMode.SAME_STEP
    env = GymnasiumFormationVectorEnv(make_env("scenario=free", LOW), 3, WEIGHTS, autoreset_mode=mode)
    start, _ = env.reset()
    ended = np.zeros(3, dtype=bool)
    while not ended.any():
        seen, _, ended, _, infos = env.step(DOWN)
    np.testing.assert_array_equal(infos["_final_obs"], ended)
    np.testing.assert_array_equal(seen[ended], start[ended])
    assert (np.stack(infos["final_obs"][ended])[..., 2] < 0.2 - 1.5).any()


def test_disabled_autoreset_starts_what_the_mask_names(make_env):
    mode = AutoresetMode.DISABLED
    env = GymnasiumFormationVectorEnv(make_env("scenario=mixed"), 3, WEIGHTS, autoreset_mode=mode)
    env.reset()
    env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([False, True, False])})
    assert env.stream.state.step.tolist() == [1, 0, 1]


def test_a_seed_fixes_the_episodes_and_another_shares_none(make_env):
    env = GymnasiumFormationVectorEnv(make_env("scenario=mixed", "scenario.columns=3"), 3, WEIGHTS, seed=1)
    drawn = {}
    for seed in (1, 1, 2):
        env.reset(seed=seed)
        env.reset()
        drawn.setdefault(seed, []).append(env.stream.scenarios.columns.clone())
    assert torch.equal(*drawn[1])
    env.stream.block = 3
    env.reset(seed=0)
    blocks = [env.stream.scenarios.columns.clone()]
    env.reset()
    blocks.append(env.stream.scenarios.columns.clone())
    env.reset(seed=1)
    assert not any(torch.equal(env.stream.scenarios.columns, block) for block in blocks)


def test_ids_are_registered_and_gymnasium_s_wrappers_take_them():
    for scenario in environments.SCENARIOS:
        assert gymnasium.spec(f"formctl/{scenario.capitalize()}-v0").kwargs == {"scenario": scenario}
    env = gymnasium.make_vec("formctl/Mixed-v0", num_envs=2, overrides=["scenario.columns=5"], flat=False)
    wrapped = RecordEpisodeStatistics(FlattenObservation(env))
    seen, _ = wrapped.reset(seed=0)
    assert seen.shape == (2, 3 * (25 + 14 + 9 + 20 + 1 + 2))
    assert env.unwrapped.stream.scenarios.columns.shape == (2, 5, 2)
    single = gymnasium.make("formctl/Free-v0")
    assert single.reset(seed=0)[0].shape == (3, 25 + 14 + 9 + 1)
