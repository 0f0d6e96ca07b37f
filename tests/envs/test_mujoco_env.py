"""The task on MuJoCo against the torch world, and what MuJoCo adds: contacts."""

import math
from itertools import pairwise

import pytest
import torch

from envs.mujoco_env import MujocoFormationEnv, rollout_rate, substeps
from envs.scenarios import sample, select
from envs.spec import Events, State

STEPS = 100


def commands(episodes, drones, seed=0):
    """Random commands around hover: hard on the rate loop, and slow to fall."""
    numbers = torch.rand(STEPS, episodes, drones, 4, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return 0.8 * (numbers - 0.5)


def largest_difference(left, right):
    """Over the fields of two named tuples; infinities in the same places are equal."""
    gaps = (torch.where(a == b, 0.0, a - b).abs().max() for a, b in zip(left, right, strict=True) if a.numel())
    return float(max(gaps))


@pytest.mark.parametrize(
    ("drone", "other_drone", "step"),
    [
        ("crazyflie_release", "crazyflie_release", None),
        ("crazyflie", "crazyflie", None),
        ("crazyflie", "crazyflie_release", 0.002),
    ],
    ids=["20ms", "2ms", "2ms-by-option"],
)
def test_follows_the_torch_world(make_env, drone, other_drone, step):
    """Two seconds of random commands, balls in the air: every number of state and events agrees to 1e-6."""
    settings = ("scenario=dynamic", "scenario.throw_time=[0.1,0.4]", "scenario.attitude_jitter=0.3")
    torch_env = make_env(*settings, f"drone={drone}")
    world = make_env(*settings, f"drone={other_drone}").world
    mujoco_env = MujocoFormationEnv(world, torch.float64, physics_step=step, contacts=False)
    scenarios = sample(world.scenario, 8, 0, torch.float64)
    here = there = torch_env.reset(scenarios)
    for action in commands(8, 3)[: STEPS if drone == "crazyflie_release" else 50]:
        here, reward, events = torch_env.step(here, action, scenarios)
        there, other_reward, other_events = mujoco_env.step(there, action, scenarios)
        assert largest_difference(here, there) < 1e-6
        assert largest_difference(events, other_events) < 1e-6
        assert (reward - other_reward).abs().max() < 1e-4
    assert (here.position - scenarios.position).abs().max() > 0.5
    assert not here.ball_time.isinf().any()


def test_a_finer_step_shows_the_integrator(make_env):
    """At 2 ms the paths of the same commands part by centimetres: the check is not the world in disguise."""
    env = make_env("scenario=free")
    scenarios = sample(env.world.scenario, 4, 0, torch.float64)
    coarse, fine = (MujocoFormationEnv(env.world, torch.float64, physics_step=step) for step in (None, 0.002))
    left = right = env.reset(scenarios)
    for action in commands(4, 3)[:40]:
        (_, left), (_, right) = coarse.advance(left, action, scenarios), fine.advance(right, action, scenarios)
    assert 1e-3 < (left.position - right.position).abs().max() < 0.3


def test_steps_are_functions_of_their_inputs(make_env):
    """No memory between steps, in contact or not; the place in the batch and the number of threads change nothing."""
    world = make_env("scenario=mixed", "scenario.throw_time=[0.0,0.2]").world
    env, threaded = MujocoFormationEnv(world, torch.float64), MujocoFormationEnv(world, torch.float64, threads=2)
    scenarios = sample(world.scenario, 6, 0, torch.float64)
    scenarios.columns[:, 0] = scenarios.position[:, 0, :2] + torch.tensor([0.0, 0.16])
    state = env.reset(scenarios)
    action = torch.tensor([-0.3, 0.0, 0.1, 0.1], dtype=torch.float64).expand(6, 3, 4)
    states = []
    for _ in range(20):
        states.append(state)
        state, _, _ = env.step(state, action, scenarios)
    backwards = torch.arange(5, -1, -1)
    for before, after in pairwise(states):
        assert largest_difference(threaded.step(before, action, scenarios)[0], after) == 0
        turned = State(*(field[backwards] for field in before))
        again, _, _ = env.step(turned, action, select(scenarios, backwards))
        assert largest_difference(State(*(field[backwards] for field in again)), after) == 0


def test_a_column_stops_a_drone_and_the_touch_is_a_hit(make_env):
    """A drone tilted towards a column: the torch world lets it pass, MuJoCo does not, and both count the hit."""
    torch_env = make_env("scenario=free", "scenario.columns=1", "drone.linear_damping=0.0")
    world = torch_env.world
    scenarios = sample(world.scenario, 1, 0, torch.float64)
    scenarios.columns[0, 0] = scenarios.position[0, 0, :2] + torch.tensor([0.0, 0.5])
    ends, least = [], []
    for env in (torch_env, MujocoFormationEnv(world, torch.float64, physics_step=0.005)):
        state, closest = env.reset(scenarios), math.inf
        for step in range(60):
            roll = -0.3 if step < 10 else 0.0
            action = torch.tensor([roll, 0.0, 0.0, 0.1], dtype=torch.float64).expand(1, 3, 4)
            state, _, events = env.step(state, action, scenarios)
            closest = min(closest, events.column[0, 0].item())
        ends.append((state.position[0, 0, 1] - scenarios.columns[0, 0, 1]).item())
        least.append(closest)
    assert ends[0] > 0.1
    assert ends[1] < -0.1
    assert least[0] < 0.01
    assert 0.1 < least[1] < world.scenario.hit_radius


def test_a_ball_pushes_the_drone_it_is_thrown_at(make_env):
    world = make_env("scenario=dynamic", "scenario.balls=1", "scenario.throw_time=[0.0,0.1]").world
    scenarios = sample(world.scenario, 1, 0, torch.float64)
    pushed = []
    for contacts in (False, True):
        env = MujocoFormationEnv(world, torch.float64, physics_step=0.005, contacts=contacts)
        state, nearest = env.reset(scenarios), math.inf
        hover = state.command
        for _ in range(90):
            state, _, events = env.step(state, hover, scenarios)
            nearest = min(nearest, events.ball.min().item())
        assert nearest < world.scenario.hit_radius
        pushed.append((state.position - scenarios.position).norm(dim=-1)[0, scenarios.aim[0, 0]].item())
    assert pushed[0] < 0.01
    assert pushed[1] > 0.1


def test_any_formation_and_any_number_of_obstacles(make_env):
    env = MujocoFormationEnv(make_env("scenario=free", "scenario.formation=hexagon").world)
    for episodes in (1, 3):
        scenarios = sample(env.world.scenario, episodes, 0)
        state, reward, events = env.step(env.reset(scenarios), torch.zeros(episodes, 6, 4), scenarios)
        assert state.position.dtype == torch.float32
        assert reward.shape == (episodes, 6, 4)
        assert isinstance(events, Events)


@pytest.mark.parametrize(("step", "count"), [(None, 1), (0.02, 1), (0.002, 10), (0.001, 20)])
def test_physics_steps_per_command(make_env, step, count):
    assert substeps(make_env("scenario=free").world, step) == count


@pytest.mark.parametrize("step", [0.003, 0.03, 0.0, -0.02])
def test_a_step_that_does_not_fit_is_refused(make_env, step):
    with pytest.raises(ValueError, match="does not divide the control period of"):
        substeps(make_env("scenario=free").world, step)


def test_an_action_that_is_no_number_is_refused(make_env):
    env = MujocoFormationEnv(make_env("scenario=free").world, torch.float64)
    scenarios = sample(env.world.scenario, 3, 0, torch.float64)
    action = torch.zeros(3, 3, 4, dtype=torch.float64)
    action[2, 1, 0] = torch.nan
    with pytest.raises(ValueError, match="action of episode 2 of the batch is not finite"):
        env.step(env.reset(scenarios), action, scenarios)


@pytest.mark.parametrize("threads", [0, 2])
def test_yardstick(make_env, threads):
    rate = rollout_rate(make_env("scenario=mixed").world, environments=8, threads=threads, commands=2)
    assert math.isfinite(rate)
    assert rate > 0
