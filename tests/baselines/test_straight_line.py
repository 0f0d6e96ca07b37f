"""The agents that avoid nothing fly as they say, and their floors are those of the release's scenes.

``straight_line`` does not react, so its path is flown once and held against the obstacles of thousands of scenarios.
"""

from itertools import pairwise

import pytest
import torch
from scipy.stats import binomtest

from envs import obstacles
from envs.flight import fly
from envs.mujoco_env import MujocoFormationEnv
from envs.scenarios import sample
from envs.spec import State
from formctl.settings import compose

EPISODES = 2000


def path(env, agent, seconds):
    """States of one flight without obstacles, one episode."""
    scenarios = sample(env.world.scenario, 1, 0, env.dtype)
    states = [env.reset(scenarios)]
    for _ in range(round(seconds / env.dt)):
        states.append(env.advance(states[-1], agent.act(states[-1], scenarios), scenarios)[1])
    return states


@pytest.fixture(scope="module")
def flight():
    """The straight line through the paper's scene, until every drone is past the last column."""
    from baselines import registry
    from envs.formation import FormationEnv, WorldSpec

    config = compose(["scenario=free", "baseline=straight_line"])
    env = FormationEnv(WorldSpec(config.scenario, config.drone, config.observation, config.reward), torch.float64)
    return path(env, registry.make("straight_line", env, config.baseline), 18.0)


@pytest.mark.parametrize("drone", ["crazyflie_release", "crazyflie"])
def test_hover_stays(make_env, make_agent, drone):
    env = make_env("scenario=free", f"drone={drone}")
    states = path(env, make_agent("hover", env), 1.0)
    assert (states[-1].position - states[0].position).abs().max() < 1e-4
    assert states[-1].velocity.abs().max() < 1e-4


def test_straight_line_keeps_speed_height_and_formation(make_env, make_agent):
    """From the jittered start of the real flights, so that the formation has to be made first."""
    env = make_env("scenario=real")
    states = path(env, make_agent("straight_line", env), 4.0)
    wanted = torch.tensor(env.world.scenario.velocity, dtype=torch.float64)
    cruise = states[125:]
    assert max((state.velocity - wanted).norm(dim=-1).max() for state in cruise) < 0.05
    assert max((state.position[..., 2] - env.world.scenario.height).abs().max() for state in cruise) < 0.02
    gaps = torch.cdist(cruise[-1].position, cruise[-1].position) - torch.cdist(env.slots, env.slots)
    assert gaps.abs().max() < 0.01


def test_rows_of_a_straight_flight(make_env, make_agent):
    """On a short, crowded course: every episode arrives in formation, free of collisions if no column is in the way."""
    env = make_env("scenario=static", "scenario.field=[2.0,8.0]", "scenario.columns=6")
    scenarios = sample(env.world.scenario, 40, 0, torch.float64)
    agent = make_agent("straight_line", env)
    rows = fly(env, agent.act, scenarios, compose(["eval.seconds=5"]).eval)
    assert rows["reached"].all()
    assert rows["fm"].max() < 0.01
    clear = column_free(path(env, agent, 5.0), env.world.scenario.hit_radius, scenarios)
    assert rows["cfr"].tolist() == clear.tolist()
    assert 5 < clear.sum() < 35


def test_mujoco_gives_the_same_verdict(make_env, make_agent):
    """Drones that hit a column are stopped there instead of passing through, and stay finite while they push on."""
    env = make_env("scenario=static", "scenario.field=[2.0,6.0]", "scenario.columns=8")
    scenarios = sample(env.world.scenario, 20, 0, torch.float64)
    evaluation = compose(["eval.seconds=5"]).eval
    rows, others = (
        fly(world, make_agent("straight_line", world).act, scenarios, evaluation)
        for world in (env, MujocoFormationEnv(env.world, torch.float64))
    )
    assert rows["hit_column"].tolist() == others["hit_column"].tolist()
    assert rows["cfr"].tolist() == others["cfr"].tolist()
    assert rows["reached"].all()
    assert not others["reached"].all()
    assert others["reached"][rows["cfr"]].all()
    assert torch.from_numpy(others["speed_error"]).isfinite().all()


def test_straight_line_reaches_the_goal_in_time(flight):
    scenario, evaluation = compose(["scenario=free"]).scenario, compose(["scenario=free"]).eval
    assert flight[-1].position[..., 1].min() > scenario.goal
    assert flight[-1].step.item() * 0.02 < evaluation.time_limit


def column_free(states, radius, scenarios):
    """Whether the flown path misses every column of each scenario (E,); it is straight, so few pieces do."""
    clear = torch.ones(len(scenarios.id), dtype=torch.bool)
    pieces = [*states[:-1:25], states[-1]]
    for before, after in pairwise(pieces):
        gaps = obstacles.column_clearance(before.position, after.position, scenarios)
        clear &= (gaps >= radius).flatten(1).all(1)
    return clear


@pytest.mark.parametrize(("columns", "floor"), [(5, 0.51), (10, 0.26), (20, 0.066)])
def test_column_floor(flight, columns, floor):
    scenario = compose(["scenario=static", f"scenario.columns={columns}"]).scenario
    clear = column_free(flight, scenario.hit_radius, sample(scenario, EPISODES, 7, torch.float64))
    interval = binomtest(int(clear.sum()), EPISODES).proportion_ci(0.99, "wilson")
    assert interval.low <= floor <= interval.high


@pytest.mark.parametrize(("aim", "low", "high"), [("box", 0.032, 0.032), ("drone", 0.995, 1.0)])
def test_ball_floor(flight, aim, low, high):
    """Share of balls that come within 0.15 m of a formation that ignores them, in pieces of 0.04 s."""
    scenario = compose(["scenario=dynamic", f"scenario.ball_aim={aim}"]).scenario
    scenarios = sample(scenario, EPISODES, 7, torch.float64)
    nearest = torch.full_like(scenarios.throw_time, torch.inf)
    balls = {
        "ball_origin": nearest.new_zeros(*nearest.shape, 3),
        "ball_velocity": nearest.new_zeros(*nearest.shape, 3),
        "ball_time": nearest,
        "ball_landing": nearest,
    }
    for k in range(150, 750, 2):  # the last ball is thrown at 12 s and lands before 15 s
        before, after = (repeat(flight[step])._replace(**balls) for step in (k, k + 2))
        now = torch.full((EPISODES,), 0.02 * k, dtype=torch.float64)
        before = obstacles.launch(before, now, scenarios, scenario)
        balls = {name: getattr(before, name) for name in balls}
        nearest = torch.minimum(nearest, obstacles.ball_clearance(before, after, now, now + 0.04).amin(1))
    hits = int((nearest < scenario.hit_radius).sum())
    interval = binomtest(hits, nearest.numel()).proportion_ci(0.99, "wilson")
    assert interval.low <= high
    assert interval.high >= low


def repeat(state: State) -> State:
    """One episode's state for every scenario."""
    return State(*(field.expand(EPISODES, *field.shape[1:]) for field in state))
