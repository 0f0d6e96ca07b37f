"""Swarm-RL's reward, against the numbers of its authors' code worked out by hand."""

from dataclasses import fields, replace

import pytest
import torch

from algos.ippo import annealed
from envs.scenarios import sample
from envs.spec import RotorDroneSpec


@pytest.fixture
def published(make_env):
    """The published vehicle's thrust to weight, its costs, and no velocity term."""
    env = make_env("experiment=swarm_rl", "scenario=free")
    drone = env.world.drone
    drone = replace(drone, max_thrust=1.9 * drone.mass * 9.81 / 4)
    reward = replace(env.world.reward, velocity=0.0, drone_contact=0.0919)
    env.world = replace(env.world, drone=drone, reward=reward)
    return env


def judged(env, before, after):
    scenarios = sample(env.world.scenario, 1, 0, env.dtype)
    state = env.reset(scenarios)
    return env.judge(state._replace(**before), state._replace(step=state.step + 1, **(before | after)), scenarios)[0][0]


def at_goal(env):
    scenario = env.world.scenario
    ahead = scenario.goal + 2.0 - float(env.slots[:, 1].min()) - scenario.start[1]
    home = torch.tensor([*scenario.start[:2], scenario.height], dtype=env.dtype)
    return (home + env.slots + torch.tensor([0.0, ahead, 0.0], dtype=env.dtype))[None]


def test_hovering_at_the_goal(published):
    reward = judged(published, {"position": at_goal(published)}, {})
    assert reward.sum(-1).tolist() == pytest.approx([0.00497] * 3, abs=5e-6)
    assert 1500 * reward.sum(-1)[0].item() == pytest.approx(7.46, abs=5e-3)


def test_straying_costs_as_much_on_the_way_as_at_the_goal(published):
    """The goal on the way is 2 m ahead all the time; 0.3 m above or beside the line cost their 0.3 m in full."""
    costs = []
    for back in (0.0, 10.0):
        place = at_goal(published) - torch.tensor([0.0, back, 0.0], dtype=published.dtype)
        aside = place + torch.tensor([0.0, 0.0, 0.3], dtype=published.dtype)
        flight = [judged(published, {"position": where}, {})[:, 1] for where in (place, aside)]
        costs.append((flight[0] - flight[1]).tolist())
    assert costs == [pytest.approx([0.005 * 0.3] * 3, abs=1e-6)] * 2


def test_two_drones_that_meet(published):
    """At 0.0919 m each loses 0.02 for being near in every step, and 5 once, in the step in which they met."""
    place = at_goal(published)
    far = place.clone()
    near = place.clone()
    near[0, 1] = near[0, 0] + torch.tensor([0.0919, 0.0, 0.0], dtype=near.dtype)
    obstacle = judged(published, {"position": far}, {"position": near})[:, 2]
    assert obstacle.tolist() == pytest.approx([-5.02, -5.02, 0.0], abs=1e-5)
    obstacle = judged(published, {"position": near}, {})[:, 2]
    assert obstacle.tolist() == pytest.approx([-0.02, -0.02, 0.0], abs=1e-5)


def test_a_column_costs_once_per_contact(make_env):
    env = make_env("experiment=swarm_rl", "reward.obstacle_near=0", "scenario=static", "scenario.columns=1")
    scenarios = sample(env.world.scenario, 1, 0, env.dtype)
    column = torch.tensor([0.0, 10.0], dtype=env.dtype)
    scenarios = scenarios._replace(columns=column.expand(1, 1, 2))
    state = env.reset(scenarios)
    costs = []
    for x in (-0.25, -0.21, -0.19, 0.1, 0.21):
        place = state.position.clone()
        place[0, 0] = torch.tensor([x, 10.0, 1.5], dtype=env.dtype)
        after = state._replace(position=place, step=state.step + 1)
        costs.append(env.judge(state, after, scenarios)[0][0, 0, 2].item())
        state = after
    assert costs[1:] == [0.0, -5.0, 0.0, 0.0]


def test_a_near_column_costs_in_every_step(make_env):
    """4 per second at its axis and nothing from 0.6 m on, from where a drone begins the step of 10 ms."""
    env = make_env("experiment=swarm_rl", "scenario=static", "scenario.columns=1")
    scenarios = sample(env.world.scenario, 1, 0, env.dtype)
    scenarios = scenarios._replace(columns=torch.tensor([0.0, 10.0], dtype=env.dtype).expand(1, 1, 2))
    state = env.reset(scenarios)
    for x, cost in ((0.7, 0.0), (0.45, 0.01), (0.3, 0.02)):
        place = state.position.clone()
        place[0, 0] = torch.tensor([x, 10.0, 1.5], dtype=env.dtype)
        here = state._replace(position=place)
        reward = env.judge(here, here._replace(step=state.step + 1), scenarios)[0]
        assert reward[0, :, 2].tolist() == pytest.approx([-cost, 0.0, 0.0], abs=1e-6)


def test_what_every_step_costs(published):
    """Distance, spin, attitude and thrust, all times 0.005; upside down costs as much as lying on the floor."""
    place = at_goal(published)
    over = torch.tensor([0.0, 1.0, 0.0, 0.0], dtype=place.dtype).expand(1, 3, 4)
    spin = torch.tensor([0.0, 3.0, 4.0], dtype=place.dtype).expand(1, 3, 3)
    full = torch.ones((1, 3, 4), dtype=place.dtype)
    off = place + torch.tensor([0.6, 0.0, 0.8], dtype=place.dtype)
    reward = judged(published, {"position": off, "attitude": over, "rates": spin, "command": full}, {})
    assert reward[0].tolist() == pytest.approx([0.0, -0.005 * (1 + 1), 0.0, -0.005 * (0.05 * 2 + 0.1 * 5)])
    low = place.clone()
    low[..., 2] = 0.1
    reward = judged(published, {"position": low}, {})
    assert reward[0, 1].item() == pytest.approx(-0.005 * (1.4 + 1 + 1))


def test_v_star_is_tracked(make_env):
    env = make_env("experiment=swarm_rl", "scenario=free")
    flying = torch.tensor([0.0, 2.0, 0.0], dtype=env.dtype).expand(1, 3, 3)
    gain = judged(env, {"velocity": flying}, {})[:, 1] - judged(env, {}, {})[:, 1]
    assert gain.tolist() == pytest.approx([0.005 * env.world.reward.velocity * 2.0] * 3)


def test_collision_costs_grow_over_the_first_three_tenths():
    assert 5 * annealed(1.5e8 / 1e9, 0.3) == pytest.approx(2.5)
    assert [annealed(progress, 0.3) for progress in (0.0, 0.3, 0.9)] == [0.0, 1.0, 1.0]
    assert annealed(0.0, 0.0) == 1.0


def test_the_rotor_file_is_the_craft_told_rotor_thrusts(make_env):
    """A baseline that is flown in the usual world meets the drone that it was trained with."""
    usual, trained = (make_env(f"drone={name}").world.drone for name in ("crazyflie", "crazyflie_rotor"))
    told = RotorDroneSpec.of(usual, 0.01)
    different = [f.name for f in fields(told) if getattr(told, f.name) != getattr(trained, f.name)]
    assert different == ["name"] and isinstance(trained, RotorDroneSpec)
