"""Hulls, search and back end: what they find keeps every bound, and what they cannot find is refused."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.planner.interface import Parabola, View
from baselines.rmader import backend, hulls
from baselines.rmader.bspline import Plan, first_controls
from baselines.rmader.fleet import RmaderFleet
from baselines.rmader.goals import Goals
from baselines.rmader.planner import NoPlan, Planner

FREE = backend.Bounds(1e3, 1e3, 1e4, np.full(3, -np.inf), np.full(3, np.inf), 1e3)
START = np.array([0.0, 0.0, 1.5])


def planner(task, spec, drone=0):
    goals = Goals(task, START, spec.goal, spec.limits)
    return Planner(drone, task, goals, spec, np.random.default_rng(0))


def fly(task, spec, seconds, balls=()):
    """Drones that follow their plans exactly: the fleet, and every plan that was ever committed with its drone."""
    view = View(0.0, START + task.offsets, np.zeros((task.drones, 3)), ())
    fleet = RmaderFleet(task, view, spec, np.random.default_rng(0))
    seen = {}
    for step in range(round(seconds / task.period)):
        now = step * task.period
        plans = fleet.step(view._replace(time=now, balls=tuple(b for b in balls if b.time <= now < b.landing)))
        seen.update({id(plan): (drone, plan) for drone, plan in enumerate(plans)})
    return fleet, list(seen.values())


def test_back_end_without_limits_reaches_the_goal_exactly():
    controls = np.concatenate((first_controls(START, np.array([0.0, 1.0, 0]), np.zeros(3), 0.5), np.zeros((4, 3))))
    goal = np.array([1.0, 4.0, 1.2])
    answer = backend.smooth(controls, 0.5, goal, [], FREE, 1e9, 100)
    np.testing.assert_allclose(answer[3:][[1, 2, 3]], [goal] * 3, atol=1e-6)
    lazy = backend.smooth(controls, 0.5, goal, [], FREE, 10.0, 100)
    assert np.linalg.norm(lazy[6] - goal) > 1e-2


def test_back_end_is_the_optimum_of_its_programme():
    """Against scipy's general solver, with limits and a plane that bind."""
    from scipy.optimize import minimize

    controls = np.concatenate((first_controls(START, np.array([0.0, 1.0, 0]), np.zeros(3), 0.5), np.zeros((4, 3))))
    bounds = backend.Bounds(2.0, 4.0, 30.0, np.array([-1, -9, 1.4]), np.array([9.0, 9, 9]), 2.5)
    goal, plane = np.array([1.0, 4.0, 1.2]), (2, np.array([1.0, 0, 0, 0.7]))
    answer = backend.smooth(controls, 0.5, goal, [plane], bounds, 10.0, 300)

    def cost(free):
        whole = np.concatenate((controls[:3], free.reshape(2, 3), np.tile(free[3:], (2, 1))))
        return (np.square(backend.JERKS @ whole)).sum() + 10 * np.square(whole[6] - goal).sum()

    fixed = np.concatenate((controls[:3], np.zeros((4, 3))))
    rows, room = backend._constraints(fixed, 0.5, [plane], bounds)

    def sphere(free):
        whole = fixed + backend.FREE @ free.reshape(2, 3)
        return bounds.reach**2 - np.square(backend.POSITIONS @ whole - whole[0]).sum(-1).ravel()

    limits = [
        {"type": "ineq", "fun": lambda x: room - rows.reshape(-1, 6) @ x, "jac": lambda x: -rows.reshape(-1, 6)},
        {"type": "ineq", "fun": sphere},
    ]
    best = minimize(cost, answer[3:5].ravel(), constraints=limits, method="SLSQP", options={"ftol": 1e-12})
    assert cost(answer[3:5].ravel()) == pytest.approx(best.fun, rel=1e-4)
    assert sphere(answer[3:5].ravel()).min() > -1e-9
    slack = room - (rows * answer[3:5]).sum((1, 2))
    assert -1e-9 < slack.min() < 1e-5  # something binds


def test_every_committed_plan_keeps_its_bounds_at_one_millisecond(fair, make_task):
    task = make_task([(0.9, 4.0), (-0.4, 5.5), (0.4, 8.0)])
    ball = Parabola(0, 1.6, np.array([1.0, 8.0, 1.5]), np.array([0.0, -4.0, 4.0]), 2.8)
    fleet, plans = fly(task, fair, 4.0, (ball,))
    assert len(plans) > 20 and fleet.pilots[0].plan.goal[1] > 5
    limits, size = fair.limits, fair.size
    half = task.column_radius + size.drone / 2 + size.tracking + size.prediction
    for _, plan in plans:
        times = np.arange(plan.start, plan.end, 1e-3)
        state = plan.at(times)
        assert np.abs(state.velocity).max(initial=0) <= limits.speed
        assert np.abs(state.acceleration).max(initial=0) <= limits.acceleration + 1e-6
        assert np.abs(state.jerk).max(initial=0) <= limits.jerk + 1e-6
        low, high = task.altitude
        assert (state.position[:, 2] >= low + limits.margin).all()
        assert (state.position[:, 2] <= high - limits.margin).all()
        assert (np.abs(state.position[:, 0]) <= task.corridor - limits.margin).all()
        away = np.abs(state.position[:, None, :2] - task.columns).max(-1)
        assert away.min(initial=np.inf) >= half - 1e-6
        moved = np.diff(state.position, axis=0)
        assert np.linalg.norm(moved, axis=-1).max(initial=0) < 1e-3 * np.sqrt(3) * limits.speed


def test_plans_keep_clear_of_a_ball(fair, make_task):
    task = make_task([])
    ball = Parabola(0, 0.0, np.array([1.0, 4.4, 1.5]), np.array([0.0, -3.0, 4.9]), 1.3)
    own = planner(task, fair)
    free = own.propose(Plan.resting(START + task.offsets[0], 0.0), 0.1, [], [])
    wary = own.propose(Plan.resting(START + task.offsets[0], 0.0), 0.1, [], [ball])
    assert own.conflicts(free, [], [ball]) and not own.conflicts(wary, [], [ball])
    times = np.arange(0.1, wary.plan.end, 1e-3)
    path = ball.origin + ball.velocity * times[:, None] - np.array([0, 0, 4.905]) * times[:, None] ** 2
    assert np.abs(wary.plan.at(times).position - path).max(-1).min() > task.ball_radius + fair.size.drone / 2


def test_no_plane_no_plan(fair, make_task):
    """Inside of a column's box nothing can be separated: the replan is refused and the committed plan stays."""
    task = make_task([(1.0, 0.1)])
    with pytest.raises(NoPlan, match="search infeasible"):
        planner(task, fair).propose(Plan.resting(START + task.offsets[0], 0.0), 0.1, [], [])
    fleet, plans = fly(task, fair, 1.5)
    assert [drone for drone, _ in plans].count(0) == 1
    assert "search infeasible" in {failure.reason for failure in fleet.failures if failure.drone == 0}


def test_a_wall_stops_the_drone_before_it(fair, make_task):
    task = make_task([(x, 3.0) for x in np.arange(-6, 8, 0.5)])
    fleet, _ = fly(task, fair, 4.0)
    half = task.column_radius + fair.size.drone / 2 + fair.size.tracking + fair.size.prediction
    assert all(pilot.plan.goal[1] < 3.0 - half + 1e-6 for pilot in fleet.pilots)


def test_hulls_hold_what_they_stand_for(fair, make_task):
    task = make_task([(0.0, 3.0), (0.0, 30.0)])
    scene = hulls.scene(hulls.columns(task, fair.size), 0.0, 0.5, START, 5.0)
    assert scene.solids == 1 and scene.hull(3, 0).shape == (8, 3)  # the other one is out of reach
    ball = Parabola(0, 0.0, np.array([0.0, 2.0, 1.0]), np.array([0.0, 1.0, 3.0]), 0.8)
    corners = hulls.ball(ball, task, fair.size).vertices(0.1, 0.45)
    half = task.ball_radius + fair.size.drone / 2 + fair.size.tracking + fair.size.prediction
    np.testing.assert_allclose(corners.min(0), [-half, 2.1 - half, 1 + 0.3 - 4.905 * 0.01 - half])
    plan = Plan.resting(START, 0.0)
    every = hulls.other(plan, fair.size).vertices(0, 1)
    last = hulls.other(plan, replace(fair.size, all_vertices=False)).vertices(0, 1)
    assert len(every) == 8 and {tuple(p) for p in every} <= {tuple(p) for p in last}


def test_goals_lie_beyond_the_line_or_move_with_the_formation(fair, make_task):
    task = make_task([])
    moving = Goals(task, START, fair.goal, fair.limits)
    assert all(moving.destination(drone)[1] >= task.goal + fair.goal.beyond - 1e-9 for drone in range(3))
    np.testing.assert_allclose(moving.slot(1, 3.0), START + [0, 6, 0] + task.offsets[1])
    goal, duration = moving.aim(0, 3.0, moving.slot(0, 3.0), task.velocity)
    np.testing.assert_allclose(goal, moving.slot(0, 3.0 + duration), atol=1e-2)
    fixed = Goals(task, START, replace(fair.goal, mode="destination"), fair.limits)
    goal, _ = fixed.aim(0, 3.0, moving.slot(0, 3.0), task.velocity)
    np.testing.assert_allclose(goal, moving.slot(0, 3.0) + np.array([0, fair.goal.reach, 0]))
