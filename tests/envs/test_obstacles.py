"""Balls and columns: parabolas, throws and swept distances."""

import pytest
import torch

from envs import obstacles, scenarios
from envs.spec import FAR
from tests.envs.test_dynamics import command


def hovering(env, episodes, seed=0):
    drawn = scenarios.sample(env.world.scenario, episodes, seed, dtype=env.dtype)
    return env.reset(drawn), drawn


def fly_until(env, state, drawn, seconds, velocity=(0.0, 0.0, 0.0)):
    """Carry the formation along at a constant velocity, without physics, throwing balls as they fall due."""
    moved = torch.tensor(velocity, dtype=env.dtype)
    closest = torch.full((len(drawn.id), env.drones), FAR, dtype=env.dtype)
    state = state._replace(velocity=moved.expand_as(state.velocity))
    for _ in range(round(seconds / env.dt)):
        before = obstacles.launch(state, env.time(state), drawn, env.world.scenario)
        state = before._replace(position=before.position + env.dt * moved, step=before.step + 1)
        gap = obstacles.ball_clearance(before, state, env.time(before), env.time(state))
        closest = torch.minimum(closest, gap.amin(-1))
    return state, closest


def test_every_ball_aimed_at_a_drone_meets_a_team_that_does_not_avoid(make_env):
    env = make_env("scenario=dynamic", "scenario.balls=1")
    state, drawn = hovering(env, 300)
    _, closest = fly_until(env, state, drawn, 14, velocity=(0, 2, 0))
    aimed = closest.gather(1, drawn.aim)
    assert (aimed < 0.03).all()


def test_balls_aimed_at_the_box_rarely_meet_anyone(make_env):
    env = make_env("scenario=dynamic", "scenario.balls=1", "scenario.ball_aim=box")
    state, drawn = hovering(env, 800)
    _, closest = fly_until(env, state, drawn, 14, velocity=(0, 2, 0))
    share = (closest.amin(-1) < 0.15).double().mean().item()
    assert share == pytest.approx(0.032, abs=2.6 * (0.032 * 0.968 / 800) ** 0.5)


def test_balls_fly_on_a_parabola_and_land(make_env):
    env = make_env("scenario=dynamic")
    state, drawn = hovering(env, 50)
    state, _ = fly_until(env, state, drawn, 13)
    assert state.ball_time.isfinite().all()
    times = state.ball_time[:, 0] + 0.4
    position, velocity, flying = obstacles.balls_at(state, times)
    assert flying[:, 0].all()
    expected = state.ball_origin[:, 0] + 0.4 * state.ball_velocity[:, 0]
    expected[:, 2] -= 0.5 * 9.81 * 0.16
    torch.testing.assert_close(position[:, 0], expected)
    torch.testing.assert_close(velocity[:, 0, 2], state.ball_velocity[:, 0, 2] - 9.81 * 0.4)
    resting, _, flying = obstacles.balls_at(state, torch.full_like(times, 30.0))
    assert not flying.any()
    torch.testing.assert_close(resting[..., 2], torch.full_like(resting[..., 2], 0.15))


def test_no_throw_appears_next_to_a_drone(make_env):
    env = make_env("scenario=dynamic", "scenario.balls=1")
    state, drawn = hovering(env, 400)
    near = False
    for _ in range(round(13 / env.dt)):
        before = obstacles.launch(state, env.time(state), drawn, env.world.scenario)
        fresh = before.ball_time.isfinite() & state.ball_time.isinf()
        gap = (before.ball_origin[:, :, None] - before.position[:, None]).norm(dim=-1).amin(-1)
        near |= bool((fresh & (gap < 1.0)).any())
        state = before._replace(step=before.step + 1)
    assert not near


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ((1.0, -1.0), (1.0, 1.0), 1.0),  # passes in between
        ((1.0, 1.0), (2.0, 1.0), 2**0.5),  # closest at the start
        ((0.3, 0.4), (0.3, 0.4), 0.5),  # does not move
        ((-1.0, 0.0), (1.0, 0.0), 0.0),  # through the middle
    ],
)
def test_swept_distance(before, after, expected):
    value = obstacles.swept(torch.tensor(before).double(), torch.tensor(after).double())
    assert value.item() == pytest.approx(expected, abs=2e-6)


def test_a_fast_ball_cannot_slip_through_between_two_steps(make_env):
    env = make_env("scenario=dynamic", "scenario.balls=1")
    state, drawn = hovering(env, 1)
    state = state._replace(
        ball_origin=state.position[:, :1] + torch.tensor([0.5, 0.0, 0.0], dtype=env.dtype),
        ball_velocity=torch.tensor([[[-50.0, 0.0, 0.0]]], dtype=env.dtype),
        ball_time=torch.zeros(1, 1, dtype=env.dtype),
        ball_landing=torch.ones(1, 1, dtype=env.dtype),
    )
    _, _, events = env.step(state, command(env), drawn)
    assert events.ball[0, 0] < 0.01


def test_absent_obstacles_are_far_and_masked(make_env):
    env = make_env("scenario=free")
    drawn = scenarios.pad(scenarios.sample(env.world.scenario, 2, 0, dtype=env.dtype), 10, 3)
    state = env.reset(drawn)
    observation = env.observe(state, drawn)
    assert not observation["static_mask"].any()
    assert not observation["dynamic_mask"].any()
    assert observation["static"].abs().max() == 0
    _, _, events = env.step(state, command(env, 2), drawn)
    assert events.column.min() > 900
    assert events.ball.min() >= FAR
