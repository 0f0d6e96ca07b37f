"""The disturbances of a deployment: each against a closed form, and nothing at all where there is none."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from baselines.sanity import StraightLine
from envs import obstacles, rotation
from envs.deployment import DeploySpec, Link, clip, environment
from envs.formation import FormationEnv
from envs.mujoco_env import MujocoFormationEnv
from envs.scenarios import sample, select
from formctl.settings import compose

torch.set_num_threads(1)


class Script:
    """An agent that says what it is told to say, and remembers what it saw."""

    name, capabilities = "script", StraightLine.capabilities

    def __init__(self, commands):
        self.commands, self.seen = commands, []

    def reset(self, scenarios, state):
        self.seen.clear()

    def act(self, state, scenarios):
        self.seen.append(state)
        return self.commands[min(len(self.seen), len(self.commands)) - 1].expand(len(state.step), 3, 4)


def deploy(**changed) -> DeploySpec:
    spec = compose(["deploy=ideal"]).deploy
    return replace(spec, rate_clip=10.0, thrust_clip=(0.0, 1.0), **changed)


def world(make_env, *words):
    return make_env("scenario=real_mixed", *words).world


def flown(kind, made, spec, commands, episodes=3, steps=None):
    """The states of a flight and the agent that flew it."""
    env = environment(kind, made, spec, dtype=torch.float64)
    scenarios = sample(made.scenario, episodes, 0, torch.float64)
    agent = Script(commands)
    link = Link(agent, env, spec)
    state = env.reset(scenarios)
    link.reset(scenarios, state)
    states = [state]
    for _ in range(steps or len(commands)):
        state, _, _ = env.step(state, link.act(state, scenarios), scenarios)
        states.append(state)
    return states, agent


def commands(steps, seed=0):
    numbers = torch.rand(steps, 1, 1, 4, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return 0.4 * (numbers - 0.5)


@pytest.mark.parametrize("kind", [FormationEnv, MujocoFormationEnv])
def test_nothing_goes_wrong_under_ideal(make_env, kind):
    made, told = world(make_env), commands(10)
    states, agent = flown(kind, made, deploy(), told)
    env = kind(made, torch.float64)
    scenarios = sample(made.scenario, 3, 0, torch.float64)
    plain = env.reset(scenarios)
    for command in told:
        plain, _, _ = env.step(plain, command.expand(3, 3, 4), scenarios)
    assert (states[-1].position - plain.position).abs().max() < 1e-9
    assert (states[-1].throttle - plain.throttle).abs().max() < 1e-9
    assert torch.equal(agent.seen[5].position, states[5].position)
    assert torch.equal(agent.seen[5].velocity, states[5].velocity)


@pytest.mark.parametrize("kind", [FormationEnv, MujocoFormationEnv])
@pytest.mark.parametrize(("mass", "thrust"), [(1.25, 1.0), (1.0, 0.8)])
def test_a_heavier_or_weaker_craft_sinks_as_newton_says(make_env, kind, mass, thrust):
    """From hover with undisturbed rotors: acceleration g (thrust / mass - 1), damping aside."""
    made = world(make_env, "drone.linear_damping=0", "scenario.attitude_jitter=0", "scenario.position_jitter=0")
    hover = torch.tensor([[[[0, 0, 0, 2 * (made.drone.mass * 9.81 / (4 * made.drone.max_thrust) - 0.05) - 1]]]])
    spec = deploy(mass=(mass, mass), thrust=(thrust, thrust))
    states, _ = flown(kind, made, spec, hover.double(), steps=10)
    fall = 9.81 * (thrust / mass - 1) * 0.2
    assert states[-1].velocity[..., 2].numpy() == pytest.approx(fall, rel=1e-6)


def test_slow_motors_answer_with_their_own_constant(make_env):
    made = world(make_env)
    full = torch.tensor([[[[0.0, 0.0, 0.0, 1.0]]]], dtype=torch.float64)
    states, _ = flown(FormationEnv, made, deploy(motor_lag=(2.0, 2.0)), full, steps=1)
    start, target = states[0].throttle, math.sqrt(0.95)  # 0.9 of full scale and the bias
    left = math.exp(-0.02 / (2 * made.drone.motor_time_constant))
    # The rate loop moves the rotors apart by a little: their mean follows the law.
    assert states[1].throttle.mean().item() == pytest.approx(target + (start.mean().item() - target) * left, rel=1e-2)


def test_latency_is_whole_periods_and_a_part(make_env):
    """Commands 28 ms late: in force from 8 ms into the period after the next one."""
    made, told = world(make_env), commands(6)
    late, _ = flown(FormationEnv, made, deploy(latency=0.028), told)
    plain = FormationEnv(made, torch.float64)
    scenarios = sample(made.scenario, 3, 0, torch.float64)
    hover = plain.reset(scenarios).command[:1, :1]
    in_force = [hover, *(state.command[:1, :1] for state in late[1:])]
    assert torch.equal(in_force[1], hover)  # nothing has arrived in the first period
    for step in range(2, 7):
        assert torch.equal(in_force[step], told[step - 2])
    env = environment(FormationEnv, made, deploy(latency=0.028), dtype=torch.float64)
    before, after = torch.zeros(1), torch.ones(1)
    state = late[0]._replace(command=before)
    assert [float(env._command(state, after, since)) for since in (0.0, 0.006, 0.008, 0.018)] == [0, 0, 1, 1]


def test_a_world_with_a_latency_is_the_deployment_with_that_latency(make_env):
    told = commands(6)
    late, _ = flown(FormationEnv, world(make_env), deploy(latency=0.02), told)
    slow = make_env("scenario=real_mixed", "drone.latency=0.02")
    scenarios = sample(slow.world.scenario, 3, 0, torch.float64)
    state = slow.reset(scenarios)
    for step, expected in enumerate(late[1:]):
        state, _, _ = slow.step(state, told[step].expand(3, 3, 4), scenarios)
        assert torch.allclose(state.position, expected.position, atol=1e-12)
    with pytest.raises(ValueError, match=r"leave drone\.latency at 0"):
        environment(FormationEnv, slow.world, deploy(latency=0.02))


def test_a_lost_packet_leaves_the_last_command_in_force(make_env):
    made, told = world(make_env), commands(40)
    states, _ = flown(FormationEnv, made, deploy(packet_loss=0.5), told, episodes=4)
    kept = torch.stack([(a.command == b.command).all(-1) for a, b in pairwise(states)])
    assert kept.float().mean().item() == pytest.approx(0.5, abs=0.08)  # 480 packets, four deviations
    fresh = [torch.where(kept[step][..., None], states[step].command, told[step].expand(4, 3, 4)) for step in range(40)]
    assert all(torch.equal(states[step + 1].command, fresh[step]) for step in range(40))


def test_differences_of_noisy_poses(make_env):
    made, told = world(make_env), commands(80)
    spec = deploy(position_noise=0.002, attitude_noise=0.004, difference_periods=2)
    states, agent = flown(FormationEnv, made, spec, told, episodes=6)
    seen, true = agent.seen[10:], states[10:-1]
    error = torch.stack([a.position - b.position for a, b in zip(seen, true, strict=True)])
    assert error.std().item() == pytest.approx(0.002, rel=0.1)
    span = 0.04
    for step in (12, 40):
        expected = (agent.seen[step].position - agent.seen[step - 2].position) / span
        assert torch.allclose(agent.seen[step].velocity, expected)
    turned = rotation.multiply(agent.seen[20].attitude, rotation.exponential(agent.seen[22].rates * span))
    aligned = (turned * agent.seen[22].attitude).sum(-1).abs()
    assert aligned.numpy() == pytest.approx(1.0, abs=1e-9)
    assert not agent.seen[0].velocity.any() and not agent.seen[0].rates.any()


def test_a_ball_is_the_parabola_through_two_frames(make_env):
    made = world(make_env, "scenario.throw_time=[0.05,0.05]")
    hover = torch.tensor([[[[0.0, 0.0, 0.0, 0.04]]]], dtype=torch.float64)
    states, agent = flown(FormationEnv, made, deploy(difference_periods=1), hover, steps=12)
    env = FormationEnv(made, torch.float64)
    for step in (6, 11):
        _, velocity, flying = obstacles.balls_at(states[step], env.time(states[step]))
        seen = agent.seen[step]
        assert flying.all() and torch.allclose(seen.ball_velocity, velocity, atol=1e-9)
        assert torch.allclose(seen.ball_landing, states[step].ball_landing, atol=1e-9)
    first = next(step for step in range(12) if states[step].ball_time.isfinite().all())
    assert agent.seen[first].ball_time.isinf().all()  # one frame gives no velocity


def test_an_episode_is_the_same_whatever_flies_with_it(make_env):
    made = world(make_env)
    spec = replace(compose(["deploy=mocap"]).deploy)
    env = environment(FormationEnv, made, spec, dtype=torch.float64)
    scenarios = sample(made.scenario, 5, 0, torch.float64)

    def fly(chosen):
        link = Link(Script(commands(1)), env, spec)
        state = env.reset(chosen)
        link.reset(chosen, state)
        for _ in range(8):
            state, _, _ = env.step(state, link.act(state, chosen), chosen)
        return state

    alone, together = fly(select(scenarios, slice(3, 4))), fly(scenarios)
    assert torch.allclose(alone.position[0], together.position[3], atol=1e-12)
    assert not torch.allclose(together.position[3] - together.position[3, :1], together.position[2] - 0, atol=1e-3)


def test_nobody_is_portable_over_radio(make_env):
    made, spec = world(make_env), compose(["deploy=mocap"]).deploy
    script = Script(commands(1))
    link = Link(script, environment(FormationEnv, made, spec), spec)
    assert script.capabilities.portable and link.capabilities == replace(script.capabilities, portable=False)


def test_the_clip_and_who_cannot_be_deployed(make_env):
    made = make_env("observation=release").world
    spec = compose(["deploy=ideal"]).deploy
    clipped = clip(torch.tensor([[[1.0, -1.0, 0.1, -1.0]]]), spec, made.drone)
    assert clipped[0, 0].numpy() == pytest.approx([0.25, -0.25, 0.1, -0.2], abs=1e-6)
    with pytest.raises(ValueError, match="rotor throttles, which nobody measures"):
        Link(Script(commands(1)), FormationEnv(made), spec)


def test_logarithm_undoes_the_exponential():
    turns = torch.tensor(np.random.default_rng(0).uniform(-1.7, 1.7, (50, 3)))
    back = rotation.logarithm(-rotation.exponential(turns))
    assert torch.allclose(back, turns, atol=1e-9)
