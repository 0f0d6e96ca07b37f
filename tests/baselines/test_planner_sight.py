"""What a fleet is told: two frames make a parabola, and only balls that can be seen are known."""

import numpy as np
import pytest
import torch

from baselines.planner.sight import Sight, fit, glances, position, task
from envs import obstacles
from envs.scenarios import pad, sample


def test_fit_passes_through_both_frames_and_lands_on_the_ground():
    times, frames = (2.0, 2.02), (np.array([1.0, -2.0, 1.4]), np.array([1.05, -1.92, 1.45]))
    ball = fit(3, times, frames)
    path = position(ball, np.array([*times, ball.landing, ball.landing + 1]))
    assert ball.ball == 3 and ball.time == 2.0
    np.testing.assert_allclose(path[:2], frames, atol=1e-12)
    assert path[2, 2] == pytest.approx(0, abs=1e-12) and (path[3] == path[2]).all()
    speed = ball.velocity[2]
    assert ball.landing == pytest.approx(2.0 + (speed + np.sqrt(speed**2 + 2 * 9.81 * 1.4)) / 9.81)


def test_fit_to_a_higher_ground_lands_earlier():
    frames = (np.array([0.0, 0.0, 1.4]), np.array([0.0, 0.0, 1.45]))
    higher = fit(0, (0.0, 0.02), frames, ground=0.15)
    assert position(higher, np.array([higher.landing]))[0, 2] == pytest.approx(0.15)
    with pytest.raises(ValueError, match="the second has to be later"):
        fit(0, (1.0, 1.0), frames)


def drift(env, scenarios, seconds, spacing=0.02):
    """Views and states of drones that stand in the air: what is seen does not depend on how they fly."""
    sight, state = Sight(env.world.scenario, spacing), env.reset(scenarios)
    for _ in range(round(seconds / env.dt)):
        yield sight.look(glances(state, env.dt)[0]), state
        state = obstacles.launch(state, env.time(state), scenarios, env.world.scenario)
        state = state._replace(step=state.step + 1)


@pytest.mark.parametrize(("spacing", "frames"), [(0.02, 2), (0.06, 4)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_ball_is_known_from_its_second_frame_on_until_it_lands(make_env, spacing, frames, dtype):
    env = make_env("scenario=dynamic", "scenario.balls=2", "scenario.throw_time=[0.1,0.3]", dtype=dtype)
    known = {}
    for view, state in drift(env, sample(env.world.scenario, 1, 3, dtype), 2.5, spacing):
        flying = obstacles.balls_at(state, env.time(state))[2][0]
        for ball in range(2):
            aloft = flying[ball].item() and view.time > state.ball_time[0, ball].item() + (frames - 0.5) * env.dt
            found = [seen for seen in view.balls if seen.ball == ball]
            assert len(found) == aloft
            for seen in found:
                assert known.setdefault(ball, seen) is seen
    assert sorted(known) == [0, 1]
    time = torch.tensor([1.0], dtype=dtype)
    for ball, seen in known.items():
        place, _, _ = obstacles.balls_at(state, time)
        np.testing.assert_allclose(position(seen, np.array([1.0]))[0], place[0, ball].numpy(), atol=2e-4)
        assert seen.landing == pytest.approx(state.ball_landing[0, ball].item(), abs=2e-4)


def test_balls_out_of_range_are_not_seen(make_env):
    env = make_env("scenario=dynamic", "scenario.sensing_range=0.5", "scenario.throw_time=[0.1,0.3]")
    for view, state in drift(env, sample(env.world.scenario, 1, 3, torch.float64), 2.5):
        places, _, flying = obstacles.balls_at(state, env.time(state))
        gaps = (places[0, :, None] - state.position[0]).norm(dim=-1).amin(-1)
        assert {ball.ball for ball in view.balls} <= set(torch.nonzero(flying[0] & (gaps < 0.5)).flatten().tolist())


def test_the_task_is_the_scenario_without_its_padding(make_env):
    env = make_env("scenario=mixed", "scenario.columns=4")
    scenarios = pad(sample(env.world.scenario, 1, 0, torch.float64), columns=9, balls=3)
    told = task(env, scenarios)
    assert told.columns.shape == (4, 2) and told.drones == 3
    assert told.goal == 34 and told.height == 1.5 and told.velocity.tolist() == [0, 2, 0] and told.period == 0.02
    view = Sight(env.world.scenario, 0.02).look(glances(env.reset(scenarios), env.dt)[0])
    np.testing.assert_allclose(view.position, told.offsets + np.array([0, 0, 1.5]))
    assert view.time == 0 and not view.velocity.any() and view.balls == ()
