"""The environment as a function: pure, compilable, differentiable, and honest about what ends an episode."""

from functools import partial

import pytest
import torch

from envs import formation, scenarios
from envs.formation import FormationEnv
from tests.envs.conftest import make_world
from tests.envs.test_dynamics import command


def rollout(env, drawn, steps, seed=0):
    generator = torch.Generator().manual_seed(seed)
    state = env.reset(drawn)
    rewards = []
    for _ in range(steps):
        noise = 0.1 * torch.randn(len(drawn.id), env.drones, 4, generator=generator, dtype=env.dtype)
        state, reward, _ = env.step(state, command(env, len(drawn.id)) + noise, drawn)
        rewards.append(reward)
    return state, torch.stack(rewards)


def test_step_is_pure(make_env):
    env = make_env("scenario=mixed")
    drawn = scenarios.sample(env.world.scenario, 4, 0, dtype=env.dtype)
    start = env.reset(drawn)
    kept = [field.clone() for field in start]
    first, _ = rollout(env, drawn, 20)
    second, _ = rollout(env, drawn, 20)
    for left, right in zip(first, second, strict=True):
        torch.testing.assert_close(left, right, rtol=0, atol=0)
    for left, right in zip(start, kept, strict=True):
        torch.testing.assert_close(left, right, rtol=0, atol=0)


def test_padding_the_scene_changes_no_number(make_env):
    env = make_env("scenario=mixed")
    drawn = scenarios.sample(env.world.scenario, 4, 0, dtype=env.dtype)
    state, rewards = rollout(env, drawn, 200)
    padded_state, padded_rewards = rollout(env, scenarios.pad(drawn, 20, 5), 200)
    torch.testing.assert_close(state.position, padded_state.position, rtol=0, atol=0)
    torch.testing.assert_close(rewards, padded_rewards)


@pytest.mark.parametrize("shape", ["square", "hexagon", "[[0,0,0],[0.5,0.5,0.2]]"])
def test_any_number_of_drones_flies(make_env, shape):
    env = make_env("scenario=mixed", f"scenario.formation={shape}")
    state, rewards = rollout(env, scenarios.sample(env.world.scenario, 2, 0, dtype=env.dtype), 30)
    assert state.position.shape[1] == env.drones
    assert rewards.isfinite().all()


@pytest.mark.parametrize("compiled", [False, True])
def test_gradient_of_the_smooth_step_matches_finite_differences(make_env, compiled):
    env = make_env("scenario=mixed", f"scenario.columns={2 if compiled else 20}")
    stepped = env.compiled(partial(torch.compile, dynamic=False)) if compiled else env
    drawn = scenarios.sample(env.world.scenario, 2, 0, dtype=env.dtype)
    state, _ = rollout(env, drawn, 5)
    action = (command(env, 2) + 0.05).requires_grad_()

    def value(commands, env=env):
        after, reward, _ = env.step(state, commands, drawn)
        if not compiled:  # a second step, from a state with a gradient, would be compiled once more
            after, more, _ = env.step(after, commands, drawn)
            reward = reward + more
        return reward.sum() + after.velocity.square().sum()

    (gradient,) = torch.autograd.grad(value(action, stepped), action)
    direction = torch.randn(action.shape, generator=torch.Generator().manual_seed(1), dtype=env.dtype)
    step = 1e-6
    with torch.no_grad():
        difference = (value(action + step * direction) - value(action - step * direction)) / (2 * step)
    assert (gradient * direction).sum().item() == pytest.approx(difference.item(), rel=1e-5)


def test_compiled_world_gives_the_eager_numbers():
    env = FormationEnv(make_world("scenario=mixed"), dtype=torch.float32)
    compiled = env.compiled(partial(torch.compile, dynamic=False))
    drawn = scenarios.sample(env.world.scenario, 16, 0)
    state = env.reset(drawn)
    for _ in range(3):
        action = command(env, 16) + 0.05
        after, reward, events = env.step(state, action, drawn)
        fast, fast_reward, fast_events = compiled.step(state, action, drawn)
        for left, right in zip((*after, reward, *events), (*fast, fast_reward, *fast_events), strict=True):
            torch.testing.assert_close(left, right, rtol=1e-4, atol=1e-4)
        for name, group in env.observe(after, drawn).items():
            torch.testing.assert_close(group, compiled.observe(after, drawn)[name], rtol=1e-4, atol=1e-4)
        state = after


def test_what_ends_an_episode(make_env):
    env = make_env("scenario=free")
    drawn = scenarios.sample(env.world.scenario, 3, 0, dtype=env.dtype)
    state = env.reset(drawn)
    state, _, events = env.step(state, command(env, 3), drawn)
    assert not env.terminated(state, events).any()
    low = state._replace(position=state.position - torch.tensor([0, 0, 1.35], dtype=env.dtype))
    assert env.terminated(low, events).all()
    touched = events._replace(ball=torch.tensor([[0.1, 9, 9], [9, 9, 9], [9, 9, 9]], dtype=env.dtype))
    assert env.terminated(state, touched).tolist() == [True, False, False]
    assert not env.terminated(state, touched, hits=False).any()
    late = state._replace(step=torch.tensor([899, 900, 901]))
    assert env.truncated(late).tolist() == [False, True, True]


def test_where_chooses_whole_episodes(make_env):
    env = make_env("scenario=mixed")
    drawn = scenarios.sample(env.world.scenario, 3, 0, dtype=env.dtype)
    fresh = env.reset(drawn)
    state, _ = rollout(env, drawn, 3)
    mixed = formation.where(torch.tensor([True, False, True]), fresh, state)
    assert mixed.step.tolist() == [0, 3, 0]
    torch.testing.assert_close(mixed.position[1], state.position[1])
    torch.testing.assert_close(mixed.position[2], fresh.position[2])
