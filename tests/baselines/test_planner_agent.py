"""The adapter between a trajectory planner and the world, with a fleet that is simple enough to know the answer."""

import numpy as np
import pytest
import torch

from baselines.planner import agent as adapter
from envs.flight import fly
from envs.scenarios import sample, select
from formctl.settings import compose
from tests.baselines import example


def flown(env, pilot, seconds, scenarios=None):
    """States of one episode."""
    scenarios = sample(env.world.scenario, 1, 0, env.dtype) if scenarios is None else scenarios
    state = env.reset(scenarios)
    pilot.reset(scenarios, state)
    states = [state]
    for _ in range(round(seconds / env.dt)):
        states.append(env.advance(states[-1], pilot.act(states[-1], scenarios), scenarios)[1])
    return states


@pytest.mark.parametrize("mode", ["waypoints", "feed_forward"])
def test_all_drones_cross_the_goal_line_in_formation(make_env, mode):
    env = make_env("scenario=free", "scenario.field=[2.0,10.0]", dtype=torch.float32)  # a shorter course, for speed
    scenarios = sample(env.world.scenario, 1, 0, env.dtype)
    pilot = example.make(env, mode)
    pilot.reset(scenarios, env.reset(scenarios))
    rows = fly(env, pilot.act, scenarios, compose(["eval.seconds=7"]).eval)
    assert rows["reached"].all() and rows["cfr"].all()
    assert rows["fm"][0] < 0.02 and rows["height_error"][0] < 0.02
    assert rows["time_to_goal"][0] < (10 + 0.9) / 2 + example.RAMP / 2 + 0.1
    assert not pilot.failures


@pytest.mark.parametrize(("mode", "allowed"), [("waypoints", 0.1), ("feed_forward", 0.01)])
def test_cruising_drones_are_where_their_trajectories_are(make_env, mode, allowed):
    """Held waypoints lag by v (K_v / K_p + T_h / 2), 1.43 m at 2 m/s, were they not sampled that much ahead."""
    env = make_env("scenario=free")
    pilot = example.make(env, mode)
    assert pilot.lead == pytest.approx(4 / 6 + 0.05)
    last = flown(env, pilot, 5.0)[-1]
    wanted = pilot._fleet.paths[0].at(np.array([5.0])).position[0]
    error = last.position[0, 0].numpy() - wanted
    assert np.abs(error).max() < allowed


def test_waypoints_are_held_for_their_period(make_env):
    env = make_env("scenario=free")
    pilot = example.make(env)
    held = []
    scenarios = sample(env.world.scenario, 1, 0, env.dtype)
    state = env.reset(scenarios)
    pilot.reset(scenarios, state)
    for _ in range(12):
        state = env.advance(state, pilot.act(state, scenarios), scenarios)[1]
        held.append(float(pilot._samples[0].position[1]))
    assert held[:5] == [held[0]] * 5 and held[5:10] == [held[5]] * 5 and held[0] < held[5] < held[10]


@pytest.mark.parametrize(
    ("trouble", "reason", "drones"),
    [
        ("raise", "ArithmeticError: the solver gave up", {-1}),
        ("few", "ValueError: the fleet did not return one trajectory per drone", {-1}),
        ("nan", "ValueError: a trajectory is not finite", {0, 1, 2}),
    ],
)
def test_a_failure_is_recorded_and_the_last_trajectory_is_flown_on(make_env, trouble, reason, drones):
    env = make_env("scenario=free")
    pilot = example.make(env, trouble=trouble)
    well, ill = (flown(env, each, 1.4) for each in (example.make(env), pilot))
    assert all(torch.equal(left.position, right.position) for left, right in zip(well, ill, strict=True))
    assert {failure.reason for failure in pilot.failures} == {reason}
    assert {failure.drone for failure in pilot.failures} == drones
    assert pilot.failures[0].time == pytest.approx(1.0)


def test_failures_of_the_fleet_itself_are_kept_and_a_reset_forgets_them(make_env):
    env = make_env("scenario=free")
    pilot = example.make(env, trouble="report")
    flown(env, pilot, 1.1)
    assert [failure.reason for failure in pilot.failures] == ["no path"] * 5
    flown(env, pilot, 0.5)
    assert not pilot.failures


def test_a_fleet_that_cannot_be_made_hovers(make_env, monkeypatch):
    env = make_env("scenario=free")
    pilot = example.make(env)
    monkeypatch.setattr(pilot, "fleet", lambda *_: 1 / 0)
    states = flown(env, pilot, 1.0)
    assert (states[-1].position - states[0].position).abs().max() < 1e-3
    assert {failure.reason for failure in pilot.failures} == {"ZeroDivisionError: division by zero"}


def test_a_trajectory_that_goes_bad_later_is_stood_still_on(make_env, monkeypatch):
    """Its end is unknown: the drone stops where it is and stays."""
    env = make_env("scenario=free")
    pilot = example.make(env, "feed_forward")
    monkeypatch.setattr(
        example.Ramp, "at", lambda self, time: AT(self, time) if time[0] < 2 else example.State(*[time[:, None]] * 4)
    )
    states = flown(env, pilot, 4.0)
    assert states[-1].velocity.abs().max() < 0.05
    assert pilot.failures[0].time > 1.99 and states[-1].position[..., 1].max() < 5


AT = example.Ramp.at


def test_one_episode_at_a_time(make_env):
    env = make_env("scenario=free")
    scenarios = sample(env.world.scenario, 2, 0, env.dtype)
    with pytest.raises(ValueError, match="flies one episode at a time, not 2"):
        example.make(env).reset(scenarios, env.reset(scenarios))
    one = select(scenarios, slice(1, 2))
    example.make(env).reset(one, env.reset(one))


@pytest.mark.parametrize("key", ["waypoint_period", "frame_spacing"])
@pytest.mark.parametrize("seconds", [0.0, 0.03])
def test_periods_fit_the_world_s(make_env, key, seconds):
    from dataclasses import replace

    settings = example.spec()
    settings = replace(settings, adapter=replace(settings.adapter, **{key: seconds}))
    with pytest.raises(ValueError, match=rf"baseline\.adapter\.{key}={seconds:g} s is no multiple") as caught:
        example.Straight("example", make_env("scenario=free"), settings)
    assert "\n" not in str(caught.value)


def test_standing_has_the_shapes_of_a_trajectory():
    sample_ = adapter.Standing(np.array([1.0, 2.0, 3.0])).at(np.array([0.0, 5.0]))
    assert all(part.shape == (2, 3) for part in sample_)
    assert sample_.position[1].tolist() == [1.0, 2.0, 3.0] and not sample_.velocity.any()
