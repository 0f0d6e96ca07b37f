"""The PettingZoo environment: PettingZoo's own checks, and the numbers of the world behind it."""

import numpy as np
import pytest
import torch
from pettingzoo.test import parallel_api_test, parallel_seed_test

from envs.interfaces.pettingzoo_env import PettingZooFormationEnv
from envs.interfaces.stream import flatten
from formctl import environments

WEIGHTS = (0.1, 0.2, 0.3, 0.4)


@pytest.mark.parametrize("flat", [True, False])
def test_pettingzoo_s_api_test_passes(make_env, flat, recwarn):
    env = PettingZooFormationEnv(make_env("scenario=mixed", dtype=torch.float32), WEIGHTS, flat=flat)
    parallel_api_test(env, num_cycles=60)
    assert [str(warning.message) for warning in recwarn] == []


def test_pettingzoo_s_seed_test_passes():
    parallel_seed_test(lambda: environments.make_parallel("mixed"), num_cycles=10)


def test_episodes_end_together_and_the_next_one_is_another(make_env):
    env = PettingZooFormationEnv(make_env("scenario=mixed", "scenario.duration=0.06"), WEIGHTS)
    env.reset(seed=0)
    first = env.stream.scenarios.columns.clone()
    hover = {name: np.float32([0, 0, 0, 0]) for name in env.possible_agents}
    for expected in (False, False, True):
        *_, terminations, truncations, _ = env.step(hover)
        assert list(truncations.values()) == [expected] * 3
        assert list(terminations.values()) == [False] * 3
    assert env.agents == []
    env.reset()
    assert env.agents == env.possible_agents
    assert not torch.equal(env.stream.scenarios.columns, first)


def test_every_drone_gets_its_own_row_of_the_world(make_env):
    world = make_env("scenario=mixed")
    env = PettingZooFormationEnv(world, WEIGHTS, seed=2)
    env.reset()
    scenarios, state = env.stream.scenarios, env.stream.state
    actions = {name: env.action_space(name).sample() for name in env.agents}
    seen, rewards, _, _, infos = env.step(actions)
    told = torch.as_tensor(np.stack(list(actions.values())), dtype=torch.float64)[None]
    state, vector, _ = world.step(state, told, scenarios)
    rows = flatten(world.observe(state, scenarios))[0].float().numpy()
    for index, name in enumerate(env.possible_agents):
        np.testing.assert_array_equal(seen[name], rows[index])
        np.testing.assert_allclose(infos[name]["reward_vector"], vector[0, index], rtol=1e-6)
        assert rewards[name] == pytest.approx(float(vector[0, index] @ torch.tensor(WEIGHTS, dtype=torch.float64)))
    np.testing.assert_array_equal(env.state(), rows.reshape(-1))
    assert env.state() in env.state_space
