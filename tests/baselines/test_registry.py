"""Every registered baseline keeps the protocol; what cannot be made says why in one line."""

import pytest
import torch

from baselines import registry
from baselines.protocol import Agent, Capabilities
from envs.scenarios import sample, select

NAMES = registry.names()


def test_sanity_agents_are_registered():
    assert {"hover", "straight_line"} <= set(NAMES)


@pytest.fixture(params=["float32", "float64"])
def mixed(request, make_env):
    """The paper's scene in either precision, with balls in the air early on, and four of its episodes."""
    dtype = getattr(torch, request.param)
    env = make_env("scenario=mixed", "scenario.throw_time=[0.0,0.1]", dtype=dtype)
    return env, sample(env.world.scenario, 4, 0, dtype)


def trace(env, agent, scenarios, steps=12):
    """Commands of the first steps."""
    state = env.reset(scenarios)
    agent.reset(scenarios, state)
    commands = []
    for _ in range(steps):
        commands.append(agent.act(state, scenarios))
        state, _, _ = env.step(state, commands[-1], scenarios)
    return torch.stack(commands)


@pytest.mark.parametrize("name", NAMES)
def test_agent_has_a_name_and_capabilities(name, mixed, make_agent):
    agent = make_agent(name, mixed[0])
    assert isinstance(agent, Agent)
    assert agent.name == name
    assert isinstance(agent.capabilities, Capabilities)
    assert agent.capabilities.command in ("ctbr", "rotor")


@pytest.mark.parametrize("name", NAMES)
def test_commands_are_bounded_finite_and_of_the_world_s_kind(name, mixed, make_agent):
    env, scenarios = mixed
    if not make_agent(name, env).capabilities.batched:
        scenarios = select(scenarios, slice(0, 1))
    commands = trace(env, make_agent(name, env), scenarios)
    assert commands.shape[1:] == (len(scenarios.id), env.drones, 4)
    assert commands.dtype == env.dtype
    assert commands.isfinite().all()
    assert commands.abs().max() <= 1


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_starts_over(name, mixed, make_agent):
    env, scenarios = mixed
    one = select(scenarios, slice(0, 1))
    agent = make_agent(name, env)
    first = trace(env, agent, one)
    assert torch.equal(trace(env, agent, one), first)
    assert torch.equal(trace(env, make_agent(name, env), one), first)


@pytest.mark.parametrize("name", NAMES)
def test_act_changes_neither_state_nor_scenarios(name, mixed, make_agent):
    env, scenarios = mixed
    one = select(scenarios, slice(0, 1))
    state, agent = env.reset(one), make_agent(name, env)
    before = [field.clone() for field in (*state, *one)]
    agent.reset(one, state)
    agent.act(state, one)
    assert all(torch.equal(left, right) for left, right in zip(before, (*state, *one), strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_batched_agents_fly_each_episode_as_if_alone(name, mixed, make_agent):
    env, scenarios = mixed
    agent = make_agent(name, env)
    if not agent.capabilities.batched:
        pytest.skip("flies one episode at a time")
    together = trace(env, agent, scenarios)
    for episode in (0, 3):
        alone = trace(env, agent, select(scenarios, slice(episode, episode + 1)))
        torch.testing.assert_close(alone[:, 0], together[:, episode], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_flies_the_number_of_drones_it_says(name, make_env, make_agent):
    env = make_env("scenario=free", "scenario.formation=pentagon")
    most = make_agent(name, make_env("scenario=free")).capabilities.max_drones
    if most is not None and most < 5:
        with pytest.raises(ValueError, match=f"flies at most {most} drones"):
            make_agent(name, env)
        return
    commands = trace(env, make_agent(name, env), sample(env.world.scenario, 1, 0, torch.float64), steps=2)
    assert commands.shape == (2, 1, 5, 4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": "baselines.sanity.Nobody"}, "target 'baselines.sanity.Nobody' cannot be imported"),
        ({"target": "nowhere"}, "target 'nowhere' cannot be imported"),
        ({"target": "baselines.sanity.HoverSpec"}, "is no agent: see baselines.protocol.Agent"),
        ({"speed": 3}, "baseline.speed: Unexpected keyword argument"),
        ({"acceleration": "fast"}, "baseline.acceleration: Input should be a valid number"),
        ({"acceleration": 0.0}, "never reaches v\\*"),
    ],
)
def test_what_cannot_be_made_says_why(changes, message, make_env):
    gains = {
        "position_gain": 6.0,
        "velocity_gain": 4.0,
        "attitude_gain": [10.0, 10.0, 5.0],
        "max_tilt": 0.785,
        "thrust_reserve": 0.1,
    }
    settings = {"target": "baselines.sanity.StraightLine", "acceleration": 4.0, "tracker": gains} | changes
    with pytest.raises(ValueError, match=message) as caught:
        registry.make("test", make_env("scenario=free"), settings)
    assert "\n" not in str(caught.value)
