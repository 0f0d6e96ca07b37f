"""What every method has to keep to be flown and compared: all baselines, a learned policy, and the example planner."""

from functools import cache

import pytest
import torch

from algos.policy import Policy
from baselines import registry
from baselines.protocol import Agent, Capabilities
from envs.formation import FormationEnv
from envs.scenarios import sample, select
from formctl.evaluation.methods import PolicyAgent
from formctl.settings import choices, compose
from tests.baselines import example

METHODS = [*choices("baseline"), "policy", "planner"]

BALLS = "scenario.throw_time=[0.1,0.14]"
"""Thrown after five commands, so that a dozen of them show what is known before and after."""


@cache
def untrained(layout) -> Policy:
    config = compose(("encoder=attention",))
    torch.manual_seed(0)
    return Policy(config.encoder, layout, config.observation, config.drone.name, config.scenario.balls)


@pytest.fixture
def build(make_agent):
    """A method by name for a world."""

    def make(name, env):
        if name == "policy":
            return PolicyAgent(name, untrained(env.layout), env)
        return example.make(env, name=name) if name == "planner" else make_agent(name, env)

    return make


def trace(env, agent, scenarios, steps=12):
    """Commands (T, E, N, 4) of the first steps."""
    state = env.reset(scenarios)
    agent.reset(scenarios, state)
    commands = []
    for _ in range(steps):
        commands.append(agent.act(state, scenarios))
        state = env.advance(state, commands[-1], scenarios)[1]
    return torch.stack(commands)


def one(scenarios, number):
    return select(scenarios, slice(number, number + 1))


@pytest.fixture
def world_of(make_env):
    """A world as a method flies it."""

    def make(name, *overrides, dtype=torch.float64):
        env = make_env(*overrides, dtype=dtype)
        if name not in choices("baseline"):
            return env
        settings = compose((f"baseline={name}",)).baseline
        return FormationEnv(registry.capabilities(name, settings).fit(env.world), dtype=dtype)

    return make


@pytest.fixture
def mixed(world_of, name):
    """The paper's scene and three of its episodes."""
    env = world_of(name, "scenario=mixed", BALLS, dtype=torch.float32)
    return env, sample(env.world.scenario, 3, 0, env.dtype)


@pytest.mark.parametrize("name", METHODS)
def test_commands_are_bounded_repeatable_and_leave_the_world_alone(name, mixed, build):
    """One agent again, after another episode, and a new agent: the same calls give the same commands."""
    env, scenarios = mixed
    agent = build(name, env)
    assert isinstance(agent, Agent) and isinstance(agent.capabilities, Capabilities) and agent.name == name
    before = [field.clone() for field in scenarios]
    commands = trace(env, agent, one(scenarios, 1))
    assert commands.shape == (12, 1, env.drones, 4) and commands.dtype == env.dtype
    assert commands.isfinite().all() and commands.abs().max() <= 1
    trace(env, agent, one(scenarios, 0), steps=3)
    assert torch.equal(trace(env, agent, one(scenarios, 1)), commands)
    assert torch.equal(trace(env, build(name, env), one(scenarios, 1), steps=4), commands[:4])
    assert all(torch.equal(left, right) for left, right in zip(before, scenarios, strict=True))


@pytest.mark.parametrize("name", METHODS)
def test_double_precision_is_kept(name, world_of, build):
    env = world_of(name, "scenario=mixed", BALLS)
    if name == "policy":
        pytest.skip("a network has the precision that it was trained in")
    commands = trace(env, build(name, env), sample(env.world.scenario, 1, 0, env.dtype), steps=1)
    assert commands.dtype == torch.float64


@pytest.mark.parametrize("name", METHODS)
def test_act_does_not_write_into_the_state(name, mixed, build):
    env, scenarios = mixed
    episode = one(scenarios, 0)
    state, agent = env.reset(episode), build(name, env)
    before = [field.clone() for field in state]
    agent.reset(episode, state)
    agent.act(state, episode)
    assert all(torch.equal(left, right) for left, right in zip(before, state, strict=True))


@pytest.mark.parametrize("name", METHODS)
def test_balls_are_unknown_before_they_are_thrown(name, mixed, build):
    """Other throws at other drones at other times: up to the first throw nobody can know."""
    env, scenarios = mixed
    episode = one(scenarios, 0)
    other = episode._replace(
        throws=episode.throws.flip(-2) * 0.7, aim=(episode.aim + 1) % env.drones, throw_time=episode.throw_time + 3
    )
    first, second = (trace(env, build(name, env), each, steps=6) for each in (episode, other))
    assert torch.equal(first, second)


@pytest.mark.parametrize("name", METHODS)
def test_batched_methods_fly_each_episode_as_if_alone(name, mixed, build):
    env, scenarios = mixed
    agent = build(name, env)
    if not agent.capabilities.batched:
        with pytest.raises(ValueError, match="one episode at a time, not 3"):
            agent.reset(scenarios, env.reset(scenarios))
        return
    together = trace(env, agent, scenarios)
    for number in (0, 2):
        torch.testing.assert_close(
            trace(env, agent, one(scenarios, number))[:, 0], together[:, number], rtol=1e-4, atol=1e-5
        )


@pytest.mark.parametrize(("columns", "balls"), [(0, 0), (20, 0), (0, 5), (20, 5)])
@pytest.mark.parametrize("name", METHODS)
def test_odd_scenarios_are_flown(name, columns, balls, world_of, build):
    counts = (f"scenario.columns={columns}", f"scenario.balls={balls}")
    env = world_of(name, "scenario=mixed", *counts, "scenario.throw_time=[0.0,0.02]", dtype=torch.float32)
    commands = trace(env, build(name, env), sample(env.world.scenario, 1, 5, env.dtype), steps=8)
    assert commands.isfinite().all() and commands.abs().max() <= 1
