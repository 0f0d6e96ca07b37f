"""The state machine and the fleet, flown by drones that are exactly where their trajectories are."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.planner.interface import Parabola, View
from baselines.swarm_formation.drone import Phase
from baselines.swarm_formation.fleet import SwarmFormationFleet
from baselines.swarm_formation.planner import hit, packed, peaks
from baselines.swarm_formation.reference import Course, straight
from baselines.swarm_formation.scene import first_hit
from baselines.swarm_formation.similarity import difference, laplacian
from tests.baselines.swarm_formation.conftest import OFFSETS, START


def test_free_flight_arrives_in_formation(fly, task):
    fleet, places = fly(task, 9.0)
    assert not fleet.failures and all(drone.phase is Phase.EXECUTE for drone in fleet.drones)
    assert (places[-1, :, 1] > task.goal).all()
    shape = [difference(points, laplacian(OFFSETS), np.empty((3, 3))) for points in places]
    assert np.mean(shape) < 1e-3
    starts = [[plan.start for plan in drone.accepted] for drone in fleet.drones]
    assert starts[0][0] < starts[1][0] < starts[2][0], "one after the other"
    assert all(1.0 < gap < 1.3 for own in starts for gap in np.diff(own))


def test_columns_are_passed_and_plans_are_what_they_claim(fly, task, spec):
    columns = np.array([[1.0, 5.0], [-0.6, 7.0], [-0.2, 8.0]])
    fleet, places = fly(replace(task, columns=columns), 9.0)
    assert (places[-1, :, 1] > task.goal).all()
    assert np.linalg.norm(places[:, :, None, :2] - columns, axis=-1).min() > task.column_radius
    recorded = {(failure.drone, failure.time) for failure in fleet.violations()}
    for number, drone in enumerate(fleet.drones):
        for plan in drone.accepted:
            times = np.arange(plan.start, plan.end, 1e-3)
            motion = plan.at(times)
            speed = np.linalg.norm(np.diff(motion.position, axis=0), axis=-1).max() / 1e-3
            force = np.linalg.norm(np.diff(motion.velocity, axis=0), axis=-1).max() / 1e-3
            assert peaks(plan) == pytest.approx((speed, force), rel=0.05, abs=0.05)
            within = peaks(plan)[0] <= spec.cost.speed and peaks(plan)[1] <= spec.cost.acceleration
            assert within != ((number, plan.start) in recorded)
            checked = motion.position[times < plan.start + (plan.end - plan.start) * 2 / 3 - 0.01]
            gaps = np.linalg.norm(checked[:, None, :2] - columns, axis=-1)
            assert gaps.min() > task.column_radius


def test_two_flights_are_the_same(fly, task):
    column = replace(task, columns=np.array([[0.9, 5.0]]))
    assert np.array_equal(fly(column, 4.0)[1], fly(column, 4.0)[1])


def blocking(time, place):
    """A ball that seems to hang about ``place`` (3,) for half a second."""
    return Parabola(0, time, place + np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.3, 1.5]), time + 0.5)


def test_a_tube_across_a_drone_ends_in_an_emergency_stop_and_a_lost_goal(fly, task):
    """The paper's failure: the drone ceases to move before a ball, the others fly on."""
    place = fly(task, 3.0)[1][-1, 0]
    fleet, places = fly(task, 9.0, (blocking(3.0, place),))
    mine = [failure.reason for failure in fleet.failures if failure.drone == 0]
    assert "plan through a ball" in mine and "emergency stop before a ball" in mine and mine[-1] == "goal given up"
    assert fleet.drones[0].phase is Phase.LOST
    assert np.ptp(places[200:, 0], axis=0).max() < 1e-9 and places[-1, 0, 1] < task.goal
    assert (places[-1, 1:, 1] > task.goal).all()


def test_more_attempts_leave_the_stop_once_the_ball_is_down(fly, task, spec):
    place = fly(task, 3.0)[1][-1, 0]
    patient = replace(spec, machine=replace(spec.machine, attempts=1000))
    fleet, places = fly(task, 11.0, (blocking(3.0, place),), patient)
    assert any(failure.reason.startswith("emergency stop") for failure in fleet.failures)
    assert fleet.drones[0].phase is Phase.EXECUTE and (places[-1, :, 1] > task.goal).all()


def test_nobody_begins_before_those_of_lower_number_are_heard(fly, task, spec):
    fleet, places = fly(task, 1.5, spec=replace(spec, link=replace(spec.link, loss=1.0)))
    assert [drone.phase for drone in fleet.drones] == [Phase.EXECUTE, Phase.TURN, Phase.TURN]
    assert places[-1, 0, 1] > 0.3 and np.array_equal(places[-1, 1:], START[1:])


def test_a_plan_is_used_after_its_latency_and_begins_after_its_lead(task, spec):
    view = View(0.0, START, np.zeros((3, 3)), ())
    slow = replace(spec, machine=replace(spec.machine, latency=0.06))
    fleet = SwarmFormationFleet(slow, task, view, np.random.default_rng(0))
    for step in range(4):
        path = fleet.step(view._replace(time=step * task.period))[0]
        assert (fleet.drones[0].plan is not None) == (step == 3)
    assert fleet.drones[0].plan.start == pytest.approx(0.1)
    assert np.allclose(path.at(np.array([0.05, 0.1])).position, START[0])


def test_meeting_trajectories_are_planned_again(fly, task, spec):
    fleet, _ = fly(task, 1.5)
    drone, other = fleet.drones[0], fleet.drones[1].plan
    near = other._replace(coefficients=drone.plan.coefficients, durations=drone.plan.durations, start=drone.plan.start)
    drone.bus.send(1.5, 1, near)
    drone._hear(1.5)
    assert drone.phase is Phase.REPLAN
    drone.phase = Phase.EXECUTE
    drone.bus.send(1.5, 1, near)
    drone._hear(1.8)
    assert drone.phase is Phase.EXECUTE, "too old"


def test_the_reference_and_its_local_targets():
    """Rest to rest at 0.482 of the speed limit; targets lie a horizon ahead of the place nearest to the drone."""
    start, goal = np.zeros(3), np.array([0.0, 36.0, 0.0])
    reference = straight(start, goal, 3.0)
    assert reference.end == pytest.approx(2.0736 * 36 / 3)
    course = Course(reference, 7.5, 3.0, 6.0)
    targets = [course.target(np.array([0.3, y, 0.0])) for y in (0.0, 5.0, 20.0, 33.0)]
    for target, y in zip(targets, (0.0, 5.0, 20.0), strict=False):
        assert 7.5 <= np.linalg.norm(target.position - [0.3, y, 0.0]) < 8.0
        assert not target.final and target.velocity[1] > 0
    assert targets[3].final and not targets[3].velocity.any() and np.allclose(targets[3].position, goal)


def test_a_check_covers_two_thirds_and_then_the_rest(fly, task):
    fleet, _ = fly(task, 0.1)
    plan = fleet.drones[0].plan
    scene = fleet._scene
    late = plan.at(np.array([plan.start + 0.8 * (plan.end - plan.start)])).position
    ball = scene._replace(curve=np.ascontiguousarray(late))
    assert first_hit(ball, late) == 0
    assert hit(plan, ball, plan.start) == (np.inf, 0)
    when, holder = hit(plan, ball, plan.start + 0.7 * (plan.end - plan.start))
    assert holder == 2 and plan.start < when < plan.end
    assert len(packed({}).drone) == 0
