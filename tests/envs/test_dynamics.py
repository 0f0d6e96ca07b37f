"""Rigid body, rotors and rate loop against closed forms, conservation laws and the release's measured response."""

import math

import pytest
import torch

from envs import dynamics, rotation, scenarios


def start(env, episodes=1):
    drawn = scenarios.sample(env.world.scenario, episodes, 0, dtype=env.dtype)
    return env.reset(drawn), drawn


def command(env, episodes=1, **parts):
    """Hover with some components replaced: roll, pitch, yaw, thrust."""
    action = torch.zeros(episodes, env.drones, 4, dtype=env.dtype)
    action[..., 3] = dynamics.hover_command(env.world.drone)
    for name, value in parts.items():
        action[..., ("roll", "pitch", "yaw", "thrust").index(name)] = value
    return action


def test_hover_thrust_is_the_releases_and_holds_altitude(make_env):
    env = make_env("scenario=free")
    assert (dynamics.hover_command(env.world.drone) + 1) / 2 == pytest.approx(0.519, abs=5e-4)
    state, drawn = start(env)
    for _ in range(150):
        state, _, _ = env.step(state, command(env), drawn)
    torch.testing.assert_close(state.position, drawn.position, atol=1e-9, rtol=0)


@pytest.mark.parametrize(("axis", "first", "settled", "bound"), [("roll", 69.6, 6, 0.035), ("yaw", None, 7, 0.06)])
def test_rate_step_response_is_the_releases(make_env, axis, first, settled, bound):
    env = make_env("scenario=free")
    state, drawn = start(env)
    rates = []
    for _ in range(15):
        state, _, _ = env.step(state, command(env, **{axis: 60 / 180}), drawn)
        rates.append(math.degrees(state.rates[0, 0, ("roll", "pitch", "yaw").index(axis)].item()))
    if first is not None:
        assert rates[0] == pytest.approx(first, rel=0.01)
    else:
        assert max(rates) / 60 == pytest.approx(1.34, abs=0.01)
    assert all(abs(rate / 60 - 1) < bound for rate in rates[settled:])


def test_rate_loop_at_500_hz_overshoots_less_than_the_one_at_50_hz(make_env):
    peaks = []
    for drone in ("crazyflie_release", "crazyflie"):
        env = make_env("scenario=free", f"drone={drone}")
        state, drawn = start(env)
        trail = []
        for _ in range(10):
            state, _, _ = env.step(state, command(env, roll=1 / 3), drawn)
            trail.append(state.rates[0, 0, 0].item())
        peaks.append(max(trail))
    assert peaks[1] < peaks[0]


def test_motor_lag_does_not_depend_on_the_step(make_env):
    drone = make_env("scenario=free").world.drone
    throttle, motor = torch.zeros(1, 1, 4), torch.full((1, 1, 4), 0.5)
    fine = throttle
    for _ in range(10):
        fine = dynamics.respond(fine, motor, drone, 0.002)
    torch.testing.assert_close(fine, dynamics.respond(throttle, motor, drone, 0.02))
    share = dynamics.respond(throttle, motor, drone, 0.02) / math.sqrt(0.5 + drone.thrust_bias)
    assert share[0, 0, 0].item() == pytest.approx(0.5413, abs=5e-4)


def test_free_fall_and_torque_free_spin_conserve_what_they_should(make_env):
    env = make_env("scenario=free", "drone.linear_damping=0", "drone.angular_damping=0", "drone.downwash_axial=-1")
    state, _ = start(env)
    state = state._replace(rates=torch.randn(1, 3, 3, dtype=env.dtype, generator=torch.Generator().manual_seed(0)))
    nothing = dynamics.Wrench(torch.zeros_like(state.position), torch.zeros_like(state.position))
    inertia = torch.tensor(env.world.drone.inertia, dtype=env.dtype)

    def angular_momentum(body):
        spin = inertia * body.rates
        axes = (rotation.heading_axis, rotation.left_axis, rotation.up_axis)
        return sum(spin[..., k, None] * axis(body.attitude) for k, axis in enumerate(axes))

    fallen = state
    for _ in range(1000):
        fallen = dynamics.integrate(fallen, nothing, env.world.drone, 1e-4)
    torch.testing.assert_close(angular_momentum(fallen), angular_momentum(state), rtol=1e-3, atol=0)
    drop = state.position[..., 2] - fallen.position[..., 2]
    torch.testing.assert_close(drop, torch.full_like(drop, 0.5 * dynamics.GRAVITY * 0.01), rtol=2e-3, atol=0)


def test_downwash_presses_the_lower_drone_by_the_releases_share(make_env):
    drone = make_env("scenario=free").world.drone
    thrust = torch.tensor([[[0.0, 0.0, 1.0]] * 2], dtype=torch.float64)

    def force(height, aside):
        place = torch.tensor([[[0.0, 0.0, 0.0], [aside, 0.0, height]]], dtype=torch.float64)
        return dynamics.downwash(place, thrust, drone)[0, :, 2]

    assert force(0.5, 0.0)[0].item() == pytest.approx(-0.756, abs=1e-3)
    assert force(1.0, 0.3)[0].item() == pytest.approx(-0.494, abs=1e-3)
    assert force(0.5, 0.0)[1].item() == pytest.approx(0.0, abs=1e-12)
    assert force(0.0, 1.7).abs().max().item() == pytest.approx(0.0, abs=1e-12)


def test_rate_memory_is_cleared_by_reset(make_env):
    env = make_env("scenario=free")
    state, drawn = start(env)
    for _ in range(20):
        state, _, _ = env.step(state, command(env, roll=1.0, yaw=-1.0), drawn)
    assert state.rate_integral.abs().max() > 0
    fresh = env.reset(drawn)
    assert fresh.rate_integral.abs().max() == 0
    assert fresh.last_rates.abs().max() == 0
