"""Rows of scripted flights: what is latched, when an episode ends, and what satisfies."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from envs import flight, metrics, scenarios
from envs.spec import Events
from envs.vocabulary import OBJECTIVES
from formctl.settings import compose

EVALUATION = compose(["scenario=free"]).eval


def events(env, episodes, **changes):
    far = torch.full((episodes, env.drones), 100.0, dtype=env.dtype)
    nothing = Events(far, far, far, torch.full((episodes,), 0.1).double(), far[:, 0] * 0, far * 0, far * 0 + 0.002)
    return nothing._replace(**changes)


def scripted(env, speed, happen=lambda k, e: e, episodes=1, evaluation=EVALUATION):
    """Fly straight at ``speed`` m/s for 22 s; ``happen`` alters the events of step k."""
    drawn = scenarios.sample(env.world.scenario, episodes, 0, dtype=env.dtype)
    state = env.reset(drawn)
    log = metrics.start(env, state, evaluation)
    move = torch.tensor([0.0, speed, 0.0], dtype=env.dtype)
    state = state._replace(velocity=move.expand_as(state.velocity))
    for k in range(round(evaluation.seconds / env.dt)):
        state = state._replace(position=state.position + env.dt * move, step=state.step + 1)
        log = metrics.update(log, env, state, happen(k, events(env, episodes)), evaluation)
    return metrics.rows(log, evaluation)


def test_a_clean_flight_satisfies_and_is_timed(make_env):
    row = scripted(make_env("scenario=free"), 2.0)
    assert row["cfr"][0]
    assert row["sr"][0]
    assert row["failure"][0] == ""
    assert row["time_to_goal"][0] == pytest.approx((34 + 0.866) / 2, abs=0.021)
    assert row["time_y32_4"][0] == pytest.approx((32.4 + 0.866) / 2, abs=0.021)
    assert row["time_y40"][0] == pytest.approx((40 + 0.866) / 2, abs=0.021)
    assert row["fm"][0] == pytest.approx(0.1)
    assert row["mean_speed"][0] == pytest.approx(2.0)
    assert np.isnan(row["first_contact_time"][0])
    assert np.isnan(row["min_ball"][0]) or row["min_ball"][0] == 100


def test_one_sample_of_two_steps(make_env):
    """Least distances, errors at the end, changes from end to end; none in the sample of the start."""
    env = make_env("scenario=free")
    state = env.reset(scenarios.sample(env.world.scenario, 1, 0, dtype=env.dtype))
    far = events(env, 1)
    near = events(env, 1, column=far.column * 0.01, formation_error=far.formation_error * 3)
    after = state._replace(throttle=state.throttle + 0.1, command=state.command + 0.2)
    for pair in ((near, far), (far, near)):
        sample = metrics.merged(pair, state._replace(step=state.step + 2), after)
        assert torch.equal(sample.column, near.column) and torch.equal(sample.ball, far.ball)
        assert sample.formation_error is pair[1].formation_error
        torch.testing.assert_close(sample.throttle_change, torch.full_like(far.ball, 0.2))
        torch.testing.assert_close(sample.command_change, torch.full_like(far.ball, 0.4))
    assert not metrics.merged((near, far), state, after).command_change.any()
    assert metrics.merged((near,), state, after) is near


def test_rows_do_not_depend_on_the_control_rate(make_env):
    """The same commands, given as often and twice as often: the same flight but for the integrator's step."""
    rows, evaluation = [], replace(EVALUATION, seconds=1.6, goal_lines=(0.5,))
    for period in (0.02, 0.01):
        env = make_env("scenario=free", "scenario.field=[0.0,1.0]", f"drone.control_period={period}")
        drawn = scenarios.sample(env.world.scenario, 1, 0, dtype=env.dtype)

        def act(state, _, env=env):
            swing = torch.sin(6 * env.time(state) + 1.5)
            return torch.stack((-swing, 0 * swing, 0 * swing, 0.2 + 0.1 * swing), -1)[:, None].expand(-1, 3, -1)

        rows.append(flight.fly(env, act, drawn, evaluation))
    coarse, fine = rows
    for name in ("throttle_change", "command_change", "mean_speed", "speed_error", "height_error"):
        assert fine[name][0] == pytest.approx(coarse[name][0], rel=0.1), name
    assert fine["throttle_change"][0] > 0.005
    assert fine["time_y0_5"][0] == pytest.approx(coarse["time_y0_5"][0], abs=0.1)


def test_too_slow_is_late(make_env):
    row = scripted(make_env("scenario=free"), 1.5)
    assert not row["cfr"][0]
    assert row["ok_obstacle"][0] and not row["ok_flight"][0]
    assert row["failure"][0] == "late"
    assert np.isnan(row["time_to_goal"][0])


@pytest.mark.parametrize(("distance", "cfr", "strict"), [(0.14, False, False), (0.18, True, False), (0.22, True, True)])
def test_contact_radii(make_env, distance, cfr, strict):
    env = make_env("scenario=free")

    def happen(k, e):
        return e._replace(ball=torch.tensor([[9.0, distance, 9.0]], dtype=env.dtype)) if k == 100 else e

    row = scripted(env, 2.0, happen)
    assert (row["cfr"][0], row["cfr_strict"][0]) == (cfr, strict)
    assert row["min_ball"][0] == pytest.approx(distance)
    if not cfr:
        assert row["failure"][0] == "ball"
        assert row["contact_drone"][0] == 1
        assert row["first_contact_time"][0] == pytest.approx(101 * 0.02)
        assert row["reached"][0]


def test_contacts_after_the_goal_do_not_count_but_are_kept(make_env):
    env = make_env("scenario=free")

    def happen(k, e):
        return e._replace(column=torch.full((1, 3), 0.1, dtype=env.dtype)) if k == 1000 else e

    row = scripted(env, 2.0, happen)
    assert row["cfr"][0]
    assert row["first_contact_time"][0] == pytest.approx(1001 * 0.02)


def test_fm_is_a_mean_until_the_goal_and_until_the_contact(make_env):
    env = make_env("scenario=free")

    def happen(k, e):
        error = 0.2 if k < 100 else 0.4 if k < 872 else 50.0  # the goal is passed in step 872
        e = e._replace(formation_error=torch.full((1,), error).double())
        return e._replace(drone=torch.full((1, 3), 0.1, dtype=env.dtype)) if k == 99 else e

    row = scripted(env, 2.0, happen)
    assert row["fm"][0] == pytest.approx((100 * 0.2 + 772 * 0.4) / 872, rel=1e-6)
    assert row["fm_to_contact"][0] == pytest.approx(0.2)
    assert row["hit_drone"][0]


def satisfied(row):
    return tuple(bool(row[f"ok_{name}"][0]) for name in OBJECTIVES)


def test_objectives_fail_one_by_one(make_env):
    """Each by a flight that succeeds all the same."""
    env = make_env("scenario=free")

    def flown(speed=2.0, **changes):
        values = {name: torch.tensor(value, dtype=env.dtype) for name, value in changes.items()}

        def happen(_, e):
            return e._replace(**{name: value.expand_as(getattr(e, name)) for name, value in values.items()})

        row = scripted(env, speed, happen)
        assert row["cfr"][0]
        assert row["sr"][0] == all(satisfied(row))
        return satisfied(row)

    assert flown() == (True, True, True, True)
    assert flown(formation_error=[0.3]) == (False, True, True, True)
    assert flown(speed=2.0 + EVALUATION.speed_threshold + 0.05) == (True, False, True, True)
    assert flown(ball=0.2) == (True, True, False, True)
    assert flown(throttle_change=0.05) == (True, True, True, False)


def test_a_wrong_height_does_not_satisfy(make_env):
    env = make_env("scenario=free", f"scenario.height={1.5 + EVALUATION.height_threshold + 0.05}")
    row = scripted(env, 2.0)
    assert row["cfr"][0]
    assert satisfied(row) == (True, False, True, True)


@pytest.mark.parametrize(("step", "left"), [(100, True), (1000, False)])
def test_a_flight_that_leaves_the_corridor_before_the_goal_does_not_succeed(make_env, step, left):
    """One drone, for one step, 1 cm too far aside; after the goal it may."""
    env = make_env("scenario=free")
    drawn = scenarios.sample(env.world.scenario, 1, 0, dtype=env.dtype)
    state = env.reset(drawn)
    log = metrics.start(env, state, EVALUATION)
    for k in range(round(EVALUATION.seconds / env.dt)):
        position = state.position + env.dt * torch.tensor([0.0, 2.0, 0.0], dtype=env.dtype)
        state = state._replace(position=position, step=state.step + 1)
        seen = position.clone()
        if k == step:
            seen[0, 2, 0] = -EVALUATION.corridor - 0.01
        log = metrics.update(log, env, state._replace(position=seen), events(env, 1), EVALUATION)
    row = metrics.rows(log, EVALUATION)
    assert row["left_corridor"][0] == left
    assert row["failure"][0] == ("corridor" if left else "")
    assert (row["cfr"][0], row["cfr_strict"][0]) == (not left, not left)
    assert row["cfr_any_path"][0] and row["ok_obstacle"][0]
    assert not left or not row["ok_flight"][0]


def test_the_first_failure_is_the_one_that_is_named(make_env):
    touch = torch.full((1, 3), 0.1).double()

    def happen(k, e):
        return e._replace(column=touch) if k == 10 else e

    aside = make_env("scenario=free", f"scenario.start=[{EVALUATION.corridor},0.0,1.5]")
    row = scripted(aside, 2.0, happen)
    assert row["failure"][0] == "corridor" and row["hit_column"][0]
    assert scripted(make_env("scenario=free"), 2.0, happen)["failure"][0] == "column"


def test_goal_lines_are_settings(make_env):
    row = scripted(make_env("scenario=free"), 2.0, evaluation=replace(EVALUATION, goal_lines=(10.0,)))
    assert row["time_y10"][0] == pytest.approx(10.866 / 2, abs=0.021)
    assert "time_y34" not in row
