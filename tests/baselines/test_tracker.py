"""The tracker against the motor map, closed forms and trajectories."""

import math

import pytest
import torch

from baselines import tracker
from baselines.tracker import Reference, TrackerSpec
from envs import control, dynamics, rotation
from envs.scenarios import sample

SPEC = TrackerSpec(6.0, 4.0, (10.0, 10.0, 5.0), 0.785, 0.1)


def fly(env, reference_at, seconds):
    """States after each command when every drone follows ``reference_at(time, start)``."""
    state = env.reset(sample(env.world.scenario, 1, 3, torch.float64))
    scenarios = sample(env.world.scenario, 1, 3, torch.float64)
    start, states = state.position, []
    for _ in range(round(seconds / env.dt)):
        action = tracker.track(state, reference_at(env.time(state), start), env.world.drone, SPEC)
        _, state = env.advance(state, action, scenarios)
        states.append(state)
    return states


@pytest.mark.parametrize("bias", [0.0, 0.05])
@pytest.mark.parametrize("share", [0.3, 0.569, 0.8])
def test_command_inverts_the_motor_map(make_env, bias, share):
    drone = make_env("scenario=free", f"drone.thrust_bias={bias}").world.drone
    wanted = torch.tensor([[[1.0, -2.0, 0.5]]], dtype=torch.float64)
    action = tracker.command(wanted, torch.tensor([[share * 4 * drone.max_thrust]], dtype=torch.float64), drone)
    rates, thrust = control.ctbr(action, drone)
    torch.testing.assert_close(rates, wanted)
    throttle = torch.zeros(1, 1, 4, dtype=torch.float64)
    throttle = dynamics.respond(throttle, control.mix(torch.zeros_like(rates), thrust), drone, dt=10.0)
    assert throttle.square().mean().item() == pytest.approx(share, rel=1e-9)


def test_command_respects_the_clip_of_real_flight(make_env):
    drone = make_env("scenario=free", "drone.rate_clip=0.785", "drone.thrust_range=[0.4,0.9]").world.drone
    fast = torch.full((1, 1, 3), 9.0, dtype=torch.float64)
    high = tracker.command(fast, torch.tensor([[9.0]], dtype=torch.float64), drone)
    low = tracker.command(-fast, torch.tensor([[0.0]], dtype=torch.float64), drone)
    assert high[0, 0].tolist() == pytest.approx([0.785 / math.pi] * 3 + [0.8])
    assert low[0, 0].tolist() == pytest.approx([-0.785 / math.pi] * 3 + [-0.2])


def test_attitude_error_is_the_rotation_in_the_body_frame():
    turned = rotation.from_roll_pitch_yaw(torch.tensor([[[0.4, -0.3, 0.7]]], dtype=torch.float64))
    step = torch.tensor([[[0.02, -0.01, 0.03]]], dtype=torch.float64)
    wanted = rotation.multiply(turned, rotation.exponential(step))
    axes, target = (
        torch.stack((rotation.heading_axis(q), rotation.left_axis(q), rotation.up_axis(q)), -2)
        for q in (turned, wanted)
    )
    torch.testing.assert_close(tracker.attitude_error(axes, target), step, atol=1e-5, rtol=0)


def test_wanted_attitude_is_a_rotation_with_the_heading():
    force = torch.tensor([[[2.0, -3.0, 9.0]]], dtype=torch.float64)
    axes = tracker.attitude(force, torch.tensor([[0.5]], dtype=torch.float64))
    torch.testing.assert_close(axes @ axes.mT, torch.eye(3, dtype=torch.float64).expand(1, 1, 3, 3))
    assert torch.linalg.det(axes).item() == pytest.approx(1)
    torch.testing.assert_close(axes[..., 2, :], force / force.norm())
    assert axes[0, 0, 1, :2].dot(torch.tensor([math.cos(0.5), math.sin(0.5)], dtype=torch.float64)).item() == (
        pytest.approx(0, abs=1e-12)
    )


def test_too_much_is_cut_back_sideways_first(make_env):
    env = make_env("scenario=free")
    drone = env.world.drone
    state = env.reset(sample(env.world.scenario, 1, 0, torch.float64))
    far = Reference.moving(state.position + torch.tensor([100.0, 0.0, 0.0]), torch.zeros_like(state.position))
    force = tracker.specific_force(state, far, drone, SPEC)
    torch.testing.assert_close(force[..., 2], torch.full_like(force[..., 2], dynamics.GRAVITY))
    assert force.norm(dim=-1).max() <= tracker.max_specific_force(drone) * (1 - SPEC.thrust_reserve) + 1e-9
    assert torch.atan2(force[..., 0], force[..., 2]).max() <= SPEC.max_tilt + 1e-9


@pytest.mark.parametrize("drone", ["crazyflie_release", "crazyflie"])
def test_recovers_from_a_jittered_start(make_env, drone):
    env = make_env("scenario=real", f"drone={drone}", "scenario.position_jitter=0.3")
    states = fly(env, lambda time, start: Reference.moving(start + 0.2, torch.zeros_like(start)), 3.0)
    start = sample(env.world.scenario, 1, 3, torch.float64).position
    assert (states[-1].position - start - 0.2).abs().max() < 0.01
    assert rotation.heading_axis(states[-1].attitude)[..., 0].min() > 0.999


@pytest.mark.parametrize("drone", ["crazyflie_release", "crazyflie"])
def test_follows_a_circle_closely(make_env, drone):
    """Radius 1 m at 2 m/s with full feed-forward: 4 m/s^2 sideways, tracked within centimetres."""
    env, turn = make_env("scenario=free", f"drone={drone}"), 2.0

    def circle(time, start):
        phase = turn * time[:, None]
        radial = torch.stack((phase.cos(), phase.sin(), 0 * phase), -1).expand_as(start)
        along = torch.stack((-phase.sin(), phase.cos(), 0 * phase), -1).expand_as(start)
        centre = start - torch.tensor([1.0, 0.0, 0.0])
        return Reference(centre + radial, turn * along, -(turn**2) * radial, -(turn**3) * along, phase.expand(1, 3) * 0)

    states = fly(env, circle, 4.0)
    start = sample(env.world.scenario, 1, 3, torch.float64).position
    errors = [(state.position - circle(env.time(state), start).position).norm(dim=-1).max() for state in states[100:]]
    assert max(errors) < 0.08
