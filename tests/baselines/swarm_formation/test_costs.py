"""The cost: every term's gradient against finite differences, times and the others' motion included."""

import numpy as np
import pytest

from baselines.swarm_formation import costs, minco
from baselines.swarm_formation.planner import packed
from baselines.swarm_formation.scene import with_balls
from baselines.swarm_formation.similarity import laplacian
from baselines.swarm_formation.spec import CostSpec
from tests.baselines.swarm_formation.conftest import OFFSETS, START

WEIGHTS = {"obstacle": 5e4, "swarm": 5e4, "formation": 1.5e4, "limits": 1e2, "spacing": 1e4, "time": 80.0}
NONE = dict.fromkeys(WEIGHTS, 0.0)
PIECES = 4


def path(drone, start, generator):
    """A wild trajectory of one drone."""
    head, tail = np.zeros((2, 3, 3))
    head[0], tail[0], head[1, 1], tail[1, 1] = START[drone], START[drone] + [0, 7, 0], 0.5, 1.0
    waypoints = (
        START[drone] + np.outer(np.arange(1, PIECES) / PIECES, [0, 7, 0]) + generator.normal(0, 0.4, (PIECES - 1, 3))
    )
    durations = generator.uniform(0.4, 1.2, PIECES)
    return head, tail, waypoints, durations


def problem(scene, ball, weights, unit=False):
    """Drone 0 among columns, a ball and two drones, one of which ends early and one of which starts late."""
    generator = np.random.default_rng(0)
    peers = {}
    for drone, start in ((1, -0.6), (2, 0.9)):
        head, tail, waypoints, durations = path(drone, start, generator)
        peers[drone] = minco.Polynomial(start, durations, minco.connect(head, tail, waypoints, durations))
    head, tail, waypoints, durations = path(0, 0.5, generator)
    terms = CostSpec(
        **(NONE | weights),
        clearance=0.5,
        swarm_clearance=1.2,
        speed=1.5,
        acceleration=4.0,
        samples=3,
        unit_gradient=unit,
        iterations=20,
        recovery_iterations=60,
        tolerance=0.1,
    )
    free = np.concatenate((waypoints.ravel(), minco.unstretch(durations)))
    return costs.Problem(
        0, 0.5, head, tail, laplacian(OFFSETS), terms, with_balls(scene, (ball,), 0.1), packed(peers)
    ), free


def value(free, given):
    return costs.objective(free, given, np.empty_like(free))


@pytest.mark.parametrize("term", [*WEIGHTS, "all"])
def test_gradients(scene, ball, term):
    chosen = WEIGHTS if term == "all" else {term: WEIGHTS[term]}
    given, free = problem(scene, ball, chosen)
    gradient = np.empty_like(free)
    costs.objective(free, given, gradient)
    assert value(free, given) > value(free, given._replace(weights=given.weights._replace(**NONE))), (
        "the term is active"
    )
    step = 1e-6
    wanted = [(value(free + s, given) - value(free - s, given)) / (2 * step) for s in step * np.eye(len(free))]
    assert np.abs(gradient - wanted).max() < 1e-7 * np.abs(wanted).max()


@pytest.mark.parametrize("term", ["swarm", "formation"])
def test_the_others_motion_counts_in_the_times(scene, ball, term):
    """Without their velocities the time gradient would be wrong: hold them still and it changes."""
    given, free = problem(scene, ball, {term: WEIGHTS[term]})
    moving, frozen = np.empty_like(free), np.empty_like(free)
    costs.objective(free, given, moving)
    still = given.peers.coefficients.copy()
    still.reshape(2, -1, 6, 3)[:, :, 1:] = 0
    costs.objective(free, given._replace(peers=given.peers._replace(coefficients=still)), frozen)
    assert np.abs(moving[-PIECES:] - frozen[-PIECES:]).max() > 1


def test_the_unit_gradient_is_no_gradient(scene, ball):
    """The same cost, another direction: what the published repository follows."""
    exact, free = problem(scene, ball, {"formation": WEIGHTS["formation"]})
    unit, _ = problem(scene, ball, {"formation": WEIGHTS["formation"]}, unit=True)
    true, followed = np.empty_like(free), np.empty_like(free)
    assert costs.objective(free, exact, true) == costs.objective(free, unit, followed)
    assert np.linalg.norm(followed) > 2 * np.linalg.norm(true)


def test_peers_stand_before_their_start_and_go_on_past_their_end():
    generator = np.random.default_rng(4)
    head, tail, waypoints, durations = path(1, 0.0, generator)
    peer = minco.Polynomial(2.0, durations, minco.connect(head, tail, waypoints, durations))
    position, velocity = np.empty(3), np.empty(3)
    for time in (1.0, 2.0, 2.9, peer.end, peer.end + 0.7):
        costs.locate(packed({1: peer}), 0, time, position, velocity)
        motion = peer.at(np.array([min(time, peer.end)]))
        beyond = max(time - peer.end, 0)
        speed = tail[1] if beyond else motion.velocity[0]
        assert np.allclose(position, motion.position[0] + beyond * speed, atol=1e-9)
        assert np.allclose(velocity, speed, atol=1e-9)
