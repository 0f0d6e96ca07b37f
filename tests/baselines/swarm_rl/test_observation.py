"""What Swarm-RL's drones see, against values worked out by hand."""

from dataclasses import replace

import pytest
import torch

from baselines.swarm_rl.course import displacement
from baselines.swarm_rl.observation import SCALES, signed_distances, urgency
from envs import obstacles, rotation
from envs.scenarios import sample
from envs.spec import FAR


@pytest.fixture
def env(make_env):
    return make_env("experiment=swarm_rl", "observation.conditioned=false", "scenario=mixed")


def start(env, **changes):
    scenarios = sample(env.world.scenario, 2, 0, env.dtype)
    return env.reset(scenarios)._replace(**changes), scenarios


def test_forty_numbers_and_six_per_ball(env):
    layout = env.layout
    assert layout.self_dim + layout.drones_dim + layout.static_dim == 40
    assert layout.dynamic_dim == 6 * env.world.observation.balls
    assert replace(env.world.observation, balls=0).layout(env.world.scenario).dynamic_dim == 0
    seen = env.observe(*start(env))
    assert [seen[group].shape for group in ("self", "drones", "static", "dynamic")] == [
        (2, 3, 1, width) for width in (19, 12, 9, 12)
    ]


def test_own_state_is_offset_velocity_matrix_rates_and_height(env):
    generator = torch.Generator().manual_seed(1)
    turn = torch.randn((2, 3, 3), generator=generator, dtype=env.dtype)
    rates = torch.randn((2, 3, 3), generator=generator, dtype=env.dtype)
    state, scenarios = start(env, attitude=rotation.exponential(turn), rates=rates)
    own = env.observe(state, scenarios)["self"][:, :, 0]
    torch.testing.assert_close(own[..., 6:15].unflatten(-1, (3, 3)), torch.linalg.matrix_exp(skew(turn)))
    assert torch.equal(own[..., 15:18], rates) and torch.equal(own[..., 18], state.position[..., 2])
    torch.testing.assert_close(own[0, :, :3], torch.tensor([[0.0, -2.0, 0.0]] * 3, dtype=env.dtype))


def skew(vector):
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))


def test_goals_are_the_slots_at_a_destination_past_the_goal_line(env):
    scenario = env.world.scenario
    rearmost = float(env.slots[:, 1].min())
    shift = torch.tensor([0.0, scenario.goal + 2.0 - rearmost - scenario.start[1], 0.0], dtype=env.dtype)
    home = torch.tensor([*scenario.start[:2], scenario.height], dtype=env.dtype) + env.slots
    there = (home + shift)[None]
    assert float(there[..., 1].min()) == pytest.approx(scenario.goal + 2)
    torch.testing.assert_close(displacement(there, env.slots, scenario, 2.0, 2.0), torch.zeros_like(there))
    near = there + torch.tensor([0.3, -0.5, 0.1], dtype=env.dtype)
    torch.testing.assert_close(displacement(near, env.slots, scenario, 2.0, 2.0), near - there)
    past = there + torch.tensor([0.0, 9.0, 0.0], dtype=env.dtype)
    assert (displacement(past, env.slots, scenario, 2.0, 2.0)[..., 1] == 2.0).all()


def test_signed_distances_match_brute_force():
    columns = torch.tensor([[[0.7, 0.0], [5.0, 5.0], [FAR, FAR]]], dtype=torch.float64)
    position = torch.tensor([[[0.0, 0.0, 1.5], [4.2, 4.9, 1.0]]], dtype=torch.float64)
    found = signed_distances(position, columns, 0.15)
    assert found[0, 0, 4].item() == pytest.approx(0.7 - 0.15)
    for drone in range(2):
        for k in range(9):
            point = position[0, drone, :2] + torch.tensor([0.1 * (k // 3 - 1), 0.1 * (k % 3 - 1)])
            nearest = min(torch.dist(point, column).item() for column in columns[0])
            assert found[0, drone, k].item() == pytest.approx(nearest - 0.15)
    assert (signed_distances(position, columns[:, :0], 0.15) == 100 - 0.15).all()
    assert (signed_distances(position, columns[:, 2:], 0.15) == 100 - 0.15).all()


def test_neighbours_are_clipped_and_the_most_urgent_ones(make_env):
    env = make_env(
        "experiment=swarm_rl", "observation.conditioned=false", "scenario=free", "scenario.formation=pentagon"
    )
    state, scenarios = start(env)
    place = torch.zeros((2, 5, 3), dtype=env.dtype)
    place[:, :, 0] = torch.tensor([0.0, 1.0, 2.0, 3.0, 30.0])
    velocity = torch.zeros_like(place)
    velocity[:, 3, 0] = -9.0  # far but coming fast
    seen = env.observe(state._replace(position=place, velocity=velocity), scenarios)["drones"][0, 0, 0]
    first, second = seen.unflatten(0, (2, 6))
    assert first.tolist() == [3.0, 0, 0, -6.0, 0, 0]
    assert second.tolist() == [1.0, 0, 0, 0, 0, 0]


def test_urgency_is_distance_plus_range_rate():
    offset = torch.tensor([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    velocity = torch.tensor([[-3.0, -4.0, 7.0], [1.0, 0.0, 0.0]])
    torch.testing.assert_close(urgency(offset, velocity), torch.tensor([0.0, 0.01]))


def test_balls_are_seen_in_flight_within_range_and_only_then(env):
    state, scenarios = start(env)
    assert not env.observe(state, scenarios)["dynamic"].any()
    ball = state.position[:, :1] + torch.tensor([0.0, 3.0, 0.0], dtype=env.dtype)
    speed = torch.tensor([0.0, -2.0, 1.0], dtype=env.dtype).expand(2, 1, 3)
    far = ball + torch.tensor([0.0, 30.0, 0.0], dtype=env.dtype)
    places, speeds = torch.cat((far, ball), 1), torch.cat((speed, speed), 1)
    flying = torch.ones((2, 2), dtype=torch.bool)
    state = obstacles.sighted(state, env.time(state), places, speeds, flying, env.world.scenario)
    seen = env.observe(state, scenarios)["dynamic"][0, 0, 0]
    assert seen.tolist() == [0.0, 3.0, 0.0, 0.0, -2.0, 1.0, *[0.0] * 6]


def test_conditioned_numbers_are_the_same_in_other_units(make_env, env):
    """Raw numbers are had back from them: scales are no zeros, and distances follow from the middle one."""
    state, scenarios = start(env)
    raw = env.observe(state, scenarios)
    shown = make_env("experiment=swarm_rl", "scenario=mixed").observe(state, scenarios)
    for group in ("self", "drones", "dynamic"):
        torch.testing.assert_close(shown[group] / torch.tensor(SCALES[group], dtype=env.dtype), raw[group])
    beside = scenarios._replace(columns=state.position[:, :1, :2] + torch.tensor([0.7, 0.4], dtype=env.dtype))
    raw, shown = (made.observe(state, beside)["static"][:, 0, 0] for made in (env, make_env("experiment=swarm_rl")))
    middle = raw[:, 4:5]
    back = shown / torch.exp(-0.3 * middle)
    torch.testing.assert_close(1.5 - back[:, 4:5], middle)
    others = [k for k in range(9) if k != 4]
    torch.testing.assert_close(middle + back[:, others] / 8, raw[:, others])
