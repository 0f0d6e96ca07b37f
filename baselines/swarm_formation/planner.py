"""One planning attempt: front end, back end, acceptance. No state of its own and no clock."""

from typing import NamedTuple

import numpy as np

from baselines.planner.interface import Array
from baselines.swarm_formation import astar
from baselines.swarm_formation.costs import Peers, Problem
from baselines.swarm_formation.minco import Polynomial
from baselines.swarm_formation.optimiser import Guess, optimise
from baselines.swarm_formation.reference import Course, Target
from baselines.swarm_formation.scene import Scene, first_hit, occupied
from baselines.swarm_formation.spec import SwarmFormationSpec

CHECKED = 2 / 3
"""Share of a trajectory that has to be free of obstacles; the rest is replaced before it is flown."""
CHECK_STEP = 0.01
"""s between the samples of that check."""
HOLDERS = ("", "column", "ball", "altitude")
"""What :func:`scene.occupied` counts."""


class Request(NamedTuple):
    """What a drone knows when it plans."""

    drone: int
    start: float  # s, when the new trajectory begins
    head: Array  # (3, 3) position, velocity, acceleration then
    previous: tuple[Polynomial, Target] | None  # to begin the search from; None asks for a path from A*
    peers: dict[int, Polynomial]  # last received
    formation: bool  # whether the shape counts in this plan


class Plan(NamedTuple):
    """The outcome of an attempt: a trajectory, or why there is none."""

    trajectory: Polynomial | None
    target: Target
    reason: str


class Planner:
    """The planning of one drone: settings, and the course it follows."""

    def __init__(self, spec: SwarmFormationSpec, wanted: Array, course: Course) -> None:
        self.spec, self.wanted, self.course = spec, wanted, course

    def plan(self, request: Request, scene: Scene) -> Plan:
        """One attempt."""
        target = self.course.target(request.head[0])
        if request.previous is None:
            path = astar.route(scene, request.head[0], target.position, self.spec.map.clearance, self.spec.map.budget)
            if path is None:
                return Plan(None, target, "no path")
            guess = self._along(astar.shorten(scene, path, self.spec.map.clearance))
            target = target._replace(position=path[-1])
        else:
            guess = self._onward(request, target)
        recovery = not request.formation
        cost = self.spec.cost
        trajectory = optimise(
            self._problem(request, target, scene),
            guess,
            cost.recovery_iterations if recovery else cost.iterations,
            cost.tolerance,
        )
        holder = hit(trajectory, scene, trajectory.start)[1]
        return Plan(None if holder else trajectory, target, f"plan through a {HOLDERS[holder]}" if holder else "")

    def _problem(self, request: Request, target: Target, scene: Scene) -> Problem:
        complete = request.formation and len(request.peers) == len(self.wanted) - 1
        weights = self.spec.cost if complete else self.spec.cost._replace(formation=0.0)
        tail = np.stack((target.position, target.velocity, np.zeros(3)))
        peers = packed(request.peers)
        return Problem(request.drone, request.start, request.head, tail, self.wanted, weights, scene, peers)

    def _along(self, corners: Array) -> Guess:
        """Straight along a path's corners (P + 1, 3) at full speed."""
        return Guess(corners[1:-1], np.linalg.norm(np.diff(corners, axis=0), axis=-1) / self.spec.cost.speed)

    def _onward(self, request: Request, target: Target) -> Guess:
        """Along the rest of the previous trajectory and then along the reference, cut into equal times."""
        assert request.previous is not None
        trajectory, before = request.previous
        left = max(trajectory.end - request.start, 0.0)
        total = left + max(target.time - before.time, 0.0)
        straight = float(np.linalg.norm(target.position - request.head[0]))
        pieces = max(2, int(np.ceil(straight / self.spec.machine.piece)))
        times = total * np.arange(1, pieces) / pieces
        own = trajectory.at(request.start + times).position
        after = self.course.reference.at(before.time + times - left).position
        return Guess(np.where((times < left)[:, None], own, after), np.full(pieces, total / pieces))


def hit(trajectory: Polynomial, scene: Scene, now: float) -> tuple[float, int]:
    """When and on what (see ``HOLDERS``) a trajectory first hits, looking from ``now`` over its first two thirds.

    Later than that, over all the rest. Time in s since the start of the episode; (inf, 0) for no hit.
    """
    checked = trajectory.start + CHECKED * (trajectory.end - trajectory.start)
    times = np.arange(now, checked if now < checked else trajectory.end, CHECK_STEP)
    path = trajectory.at(times).position
    index = first_hit(scene, path)
    if index == len(path):
        return np.inf, 0
    return float(times[index]), int(occupied(scene, *path[index]))


def packed(peers: dict[int, Polynomial]) -> Peers:
    """Received trajectories as arrays that compiled code reads."""
    longest = max((len(peer.durations) for peer in peers.values()), default=1)
    result = Peers(
        drone=np.array(sorted(peers), dtype=np.int64),
        start=np.zeros(len(peers)),
        pieces=np.zeros(len(peers), dtype=np.int64),
        durations=np.zeros((len(peers), longest)),
        coefficients=np.zeros((len(peers), 6 * longest, 3)),
    )
    for k, drone in enumerate(sorted(peers)):
        peer, pieces = peers[drone], len(peers[drone].durations)
        result.start[k], result.pieces[k] = peer.start, pieces
        result.durations[k, :pieces], result.coefficients[k, : 6 * pieces] = peer.durations, peer.coefficients
    return result


def peaks(trajectory: Polynomial, step: float = 1e-3) -> tuple[float, float]:
    """Highest speed in m/s and acceleration in m/s^2 over samples ``step`` s apart."""
    motion = trajectory.at(np.arange(trajectory.start, trajectory.end, step))
    return (
        float(np.linalg.norm(motion.velocity, axis=-1).max()),
        float(np.linalg.norm(motion.acceleration, axis=-1).max()),
    )
