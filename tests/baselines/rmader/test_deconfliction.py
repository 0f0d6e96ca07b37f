"""Tentative and committed plans under link delay: what the delay check guarantees and where its guarantee ends."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.planner.messages import Bus
from baselines.rmader.bspline import Plan
from baselines.rmader.deconfliction import News, Pilot, Store
from baselines.rmader.goals import Goals
from baselines.rmader.planner import Planner

PLACES = np.array([[0.0, 0.0, 1.5], [0.0, 3.0, 1.5]])


class Swap(Goals):
    """Two drones that want each other's place."""

    def destination(self, drone):
        return PLACES[1 - drone]


def meet(spec, task, delay, stagger, seconds=3.0):
    """Fly two drones head-on; the least distance along any axis, in m, that ever lay between their committed plans."""
    clock = replace(spec.clock, link_delay=delay, stagger=stagger, first_lead=0.2)
    spec = replace(spec, clock=clock, goal=replace(spec.goal, mode="destination", near=0.0))
    goals = Swap(task, PLACES[0], spec.goal, spec.limits)
    bus = Bus(2, delay, 0.0, np.random.default_rng(0))
    pilots = [
        Pilot(Planner(i, task, goals, spec, np.random.default_rng(i)), Plan.resting(PLACES[i], 0.0), bus, clock)
        for i in range(2)
    ]
    least, commits = np.inf, 0
    for tick in range(round(seconds / clock.tick)):
        now = tick * clock.tick
        before = [pilot.plan for pilot in pilots]
        for pilot in pilots:
            pilot.tick(now)
        if any(pilot.plan is not plan for pilot, plan in zip(pilots, before, strict=True)):
            commits += 1
            times = np.arange(now, max(pilot.plan.end for pilot in pilots) + 1e-3, 1e-3)
            one, two = (pilot.plan.at(times).position for pilot in pilots)
            least = min(least, np.abs(one - two).max(-1).min())
    return least, commits, pilots


@pytest.mark.parametrize("stagger", [0.0, 0.06])
@pytest.mark.parametrize("delay", [0.0, 0.05, 0.075])
def test_no_conflict_is_committed_while_messages_are_faster_than_the_delay_check(delay, stagger, fair, make_task):
    task = make_task([], offsets=np.zeros((2, 3)))
    assert delay <= fair.clock.delay_check
    least, commits, pilots = meet(fair, task, delay, stagger)
    assert least >= fair.size.drone
    assert commits > 1  # they do fly
    if stagger == 0.06:
        assert all(np.abs(pilot.plan.goal - PLACES[1 - i]).max() < 1.0 for i, pilot in enumerate(pilots))


def test_slower_messages_break_the_guarantee(fair, make_task):
    """Both think at once, neither hears of the other in time: both commit, and the plans run into each other."""
    task = make_task([], offsets=np.zeros((2, 3)))
    least, _, _ = meet(fair, task, delay=0.3, stagger=0.0, seconds=0.5)
    assert least < fair.size.drone


def test_the_store_keeps_tentative_plans_beside_the_committed_one():
    first, second, third = (Plan.resting(np.full(3, float(i)), 0.0) for i in range(3))
    store = Store()
    store.add(1, News(first, committed=True))
    store.add(1, News(second, committed=False))
    store.add(2, News(third, committed=False))
    assert store.plans() == [first, second, third]
    store.add(1, News(third, committed=True))
    assert store.plans() == [third, third]


def test_a_proposal_in_conflict_is_discarded_and_the_plan_stays(fair, make_task):
    task = make_task([], offsets=np.zeros((2, 3)))
    clock = replace(fair.clock, first_lead=0.2)
    goals = Swap(task, PLACES[0], replace(fair.goal, mode="destination"), fair.limits)
    bus = Bus(2, 0.0, 0.0, np.random.default_rng(0))
    pilot = Pilot(Planner(0, task, goals, fair, np.random.default_rng(0)), Plan.resting(PLACES[0], 0.0), bus, clock)
    for tick in range(30):
        now = tick * clock.tick
        if now == pytest.approx(0.1):  # after the proposal has been published
            bus.send(now, 1, News(Plan.resting(np.array([0.0, 0.5, 1.5]), 0.0), committed=False))
        pilot.tick(now)
    assert pilot.plan.end == 0.0
    assert [failure.reason for failure in pilot.failures] == ["delay check: conflict with what arrived"]


def test_two_flights_are_the_same(fair, make_task):
    task = make_task([], offsets=np.zeros((2, 3)))
    one, two = (meet(fair, task, 0.05, 0.02, seconds=1.0)[2] for _ in range(2))
    for pilot, twin in zip(one, two, strict=True):
        np.testing.assert_array_equal(pilot.plan.pieces, twin.plan.pieces)
