"""Drones as they are sold: curves and motor lag against what was identified, and both physics against each other."""

import math
from dataclasses import replace

import pytest
import torch

from envs import dynamics
from envs.mujoco_env import MujocoFormationEnv
from envs.scenarios import sample
from tests.envs.test_dynamics import command, start
from tests.envs.test_mujoco_env import commands, largest_difference

torch.set_num_threads(1)

RPM = 2 * math.pi / 60
IDENTIFIED = {  # crazyflow 0.4.0: N and N m of n in rpm, N; rpm/s of (c - n) and (c^2 - n^2), up and down; kg m^2
    "cf2x_L250": (
        (-5.382196214637237e-7, 2.4582929831265485e-10),
        (1.410454111996297e-9, 1.4592584373980652e-12),
        0.12,
        (7.355623702172756, 0.0, 0.0, 0.00024443862952110715),
        34.52e-9,
    ),
    "cf2x_P250": (
        (-3.6200226530383495e-7, 1.6060924304100328e-10),
        (-2.2665265829562245e-9, 1.1149485566919186e-12),
        0.12,
        (5.172596691828673, 8.14774234381285e-5, 0.0, 0.0002095253491455741),
        26.97e-9,
    ),
    "cf2x_T350": (
        (-7.167227176573658e-7, 2.9401303690194613e-10),
        (5.815894847811497e-10, 1.331813874166509e-12),
        0.18,
        (11.374753209400291, 0.0, 0.0, 0.00037867688499079635),
        38.93e-9,
    ),
    "cf21B_500": (
        (-3.133427287299859e-7, 4.407354891648379e-10),
        (1.65886356219615e-9, 2.4693477924534137e-12),
        0.2,
        (13.996001897562685, 0.00011093207920685363, 5.933168530682111, 0.00031951312393561264),
        38.93e-9,
    ),
}
FAMILY = tuple(IDENTIFIED)


def full_speed(name):
    """rpm at which the identified thrust curve reaches the largest thrust."""
    (first, second), _, most, _, _ = IDENTIFIED[name]
    return (-first + math.sqrt(first**2 + 4 * second * most)) / (2 * second)


@pytest.mark.parametrize("name", FAMILY)
def test_rotors_push_and_drag_as_identified(make_env, name):
    drone, top = make_env(f"drone={name}").world.drone, full_speed(name)
    (f1, f2), (t1, t2), most, _, inertia = IDENTIFIED[name]
    assert drone.max_thrust == most
    assert drone.rotor_momentum == pytest.approx(inertia * top * RPM, rel=1e-4)
    upright = torch.tensor([[[1.0, 0, 0, 0]]], dtype=torch.float64)
    for share in (0.3, 0.7, 1.0):
        speed = share * top
        force, torque = dynamics.rotor_wrench(torch.full((1, 1, 4), share, dtype=torch.float64), upright, drone)
        assert force[0, 0, 2].item() == pytest.approx(4 * (f1 * speed + f2 * speed**2), rel=2e-5)
        assert torque.abs().max() < 1e-12
        one = torch.tensor([[[share, 0.0, 0.0, 0.0]]], dtype=torch.float64)
        torque = dynamics.rotor_wrench(one, upright, drone).torque[0, 0]
        assert torque[2].item() == pytest.approx(t1 * speed + t2 * speed**2, rel=1e-4)
        arm = drone.rotor_positions[0][0]
        assert torque[0].item() == pytest.approx(arm * (f1 * speed + f2 * speed**2), rel=2e-5)


@pytest.mark.parametrize("name", FAMILY)
@pytest.mark.parametrize(("first", "share"), [(0.5, 0.9), (0.9, 0.3)])
def test_motors_lag_as_identified_whatever_the_step(make_env, name, first, share):
    """Against small Euler steps of the identified equation in rpm."""
    drone, top = make_env(f"drone={name}").world.drone, full_speed(name)
    (f1, f2), _, most, (up, up2, down, down2), _ = IDENTIFIED[name]
    wanted = (-f1 + math.sqrt(f1**2 + 4 * f2 * most * share)) / (2 * f2)
    speed = first * top
    for _ in range(4_000):
        linear, square = (up, up2) if wanted > speed else (down, down2)
        speed += 1e-5 * (linear * (wanted - speed) + square * (wanted**2 - speed**2))
    throttle = torch.full((1, 1, 4), first, dtype=torch.float64)
    motor = torch.full((1, 1, 4), share, dtype=torch.float64)
    at_once = dynamics.respond(throttle, motor, drone, 0.04)
    assert (at_once[0, 0, 0].item() - first) == pytest.approx(speed / top - first, rel=1e-4)
    for _ in range(20):
        throttle = dynamics.respond(throttle, motor, drone, 0.002)
    torch.testing.assert_close(throttle, at_once)
    twice = dynamics.respond(torch.full_like(motor, first), motor, drone, 0.08, torch.full((1, 1, 1), 2.0).double())
    torch.testing.assert_close(twice, at_once)


@pytest.mark.parametrize("name", FAMILY)
def test_each_hovers_and_follows_its_rates(make_env, name):
    env = make_env("scenario=free", f"drone={name}")
    state, drawn = start(env)
    for _ in range(50):
        state, _, _ = env.step(state, command(env), drawn)
    torch.testing.assert_close(state.position, drawn.position, atol=1e-9, rtol=0)
    for axis, number in (("roll", 0), ("yaw", 2)):
        turning, rates = state, []
        for _ in range(40):
            turning, _, _ = env.step(turning, command(env, **{axis: 0.25}), drawn)
            rates.append(turning.rates[0, 0, number].item())
        wanted = 0.25 * env.world.drone.rate_limit
        assert rates[-1] == pytest.approx(wanted, rel=0.15)
        assert max(rates) < 2.5 * wanted


def test_spin_of_body_and_rotors_is_kept(make_env):
    """Without drag torque a rotor that speeds up turns the body the other way: angular momentum about z stays."""
    drone = replace(make_env("drone=cf21B_500").world.drone, max_torque=0.0, downwash_axial=-1.0)
    env = make_env("scenario=free", "drone=cf21B_500")
    env.world = replace(env.world, drone=drone)
    state, drawn = start(env)
    spin = torch.tensor(drone.rotor_directions, dtype=env.dtype) * drone.rotor_momentum

    def momentum(body):
        return drone.inertia[2] * body.rates[..., 2] + (spin * body.throttle).sum(-1)

    at_first = momentum(state)
    for _ in range(5):
        state, _, _ = env.step(state, command(env, yaw=0.5), drawn)
    assert state.rates[..., 2].abs().min() > 0.05
    torch.testing.assert_close(momentum(state), at_first, atol=1e-12, rtol=0)


def test_a_turning_body_feels_its_rotors_as_gyroscopes(make_env):
    drone = make_env("drone=cf21B_500").world.drone
    env = make_env("scenario=free", "drone=cf21B_500")
    state, _ = start(env)
    turning = state._replace(
        rates=state.rates + torch.tensor([1.0, 2.0, 0.0], dtype=env.dtype),
        throttle=torch.tensor([0.5, 1.0, 0.5, 1.0], dtype=env.dtype).expand_as(state.throttle),
    )
    momentum = torch.tensor([0.0, 0.0, drone.rotor_momentum * 1.0], dtype=env.dtype)  # +1 rotors 2, 4 less -1 rotors
    expected = -torch.linalg.cross(turning.rates, momentum.expand_as(turning.rates))
    torch.testing.assert_close(dynamics.rotor_reaction(turning.throttle, turning, drone, 0.002), expected)


@pytest.mark.parametrize("name", ["cf2x_P250", "cf21B_500"])
def test_mujoco_flies_them_alike(make_env, name):
    """A second of random commands in wind, with drawn craft: every number of state and events agrees to 1e-6."""
    settings = ("scenario=real_mixed", "scenario.air.wind=[1,3]", "scenario.air.ground_effect=true")
    settings += ("scenario.vehicle.mass=[0.9,1.1]", "scenario.vehicle.motor_lag=[0.8,1.5]", f"drone={name}")
    torch_env = make_env(*settings)
    mujoco_env = MujocoFormationEnv(torch_env.world, torch.float64, contacts=False)
    scenarios = sample(torch_env.world.scenario, 4, 0, torch.float64)
    here = there = torch_env.reset(scenarios)
    for action in commands(4, 3)[:50]:
        here, _, events = torch_env.step(here, action, scenarios)
        there, _, other_events = mujoco_env.step(there, action, scenarios)
    assert largest_difference(here, there) < 1e-6
    assert largest_difference(events, other_events) < 1e-6
    assert (here.position - scenarios.position).abs().max() > 0.1


def test_drawn_craft_answer_as_newton_says(make_env):
    """From hover, upright: acceleration g (thrust / mass - 1), each drone its own."""
    still = ("drone.linear_damping=0", "scenario.attitude_jitter=0", "drone.downwash_axial=-1")
    spread = ("scenario.vehicle.mass=[0.8,1.2]", "scenario.vehicle.thrust=[0.9,1.1]")
    env = make_env("scenario=real", "drone=crazyflie", *still, *spread)
    drawn = sample(env.world.scenario, 3, 0, torch.float64)
    state = env.reset(drawn)
    for _ in range(5):
        state, _, _ = env.step(state, command(env, 3), drawn)
    mass, thrust, _ = drawn.vehicle.unbind(-1)
    assert mass.std() > 0.05
    torch.testing.assert_close(state.velocity[..., 2], 9.81 * (thrust / mass - 1) * 0.1, rtol=1e-6, atol=1e-9)


def test_the_ground_carries_as_cheeseman_and_bennett_say(make_env):
    drone = replace(make_env("drone=cf21B_500").world.drone, rotor_radius=0.1)
    height = torch.tensor([0.025, 0.05, 0.1, 0.2, 1.0])
    expected = [4 / 3, 4 / 3, 16 / 15, 64 / 63, 1 / (1 - 0.025**2)]
    assert dynamics.ground_cushion(height, drone).tolist() == pytest.approx(expected, rel=1e-5)
