"""Where a drone is going: the global reference to its goal, and the local target one planning horizon ahead."""

from typing import NamedTuple

import numpy as np

from baselines.planner.interface import Array, Task
from baselines.swarm_formation.minco import Polynomial, connect

SLOWER = 1.2
"""The published code divides the mean speed by this, at most six times, until the peak is within the limit."""


def goals(task: Task, start: Array, beyond: float) -> Array:
    """Goals (N, 3) in m: the formation about its reference, ``beyond`` m past the goal line, at the task's altitude."""
    course = task.velocity / np.linalg.norm(task.velocity)
    centre = (start - task.offsets).mean(0)
    centre = centre + course * (task.goal + beyond - centre @ course)
    return np.array([centre[0], centre[1], task.height]) + task.offsets


def straight(start: Array, goal: Array, speed: float) -> Polynomial:
    """The global reference: one minimum-jerk piece between two points (3,), from rest to rest, begun at time 0."""
    head, tail = np.zeros((3, 3)), np.zeros((3, 3))
    head[0], tail[0] = start, goal
    length, mean = float(np.linalg.norm(goal - start)), speed
    for _ in range(6):
        if 1.875 * mean <= speed:  # the peak of a rest-to-rest quintic
            break
        mean /= SLOWER
    durations = np.array([max(length / mean, 1e-3)])
    return Polynomial(0.0, durations, connect(head, tail, np.zeros((0, 3)), durations))


class Target(NamedTuple):
    """A local target."""

    time: float  # s on the reference
    position: Array  # (3,) m
    velocity: Array  # (3,) m/s
    final: bool  # whether it is the goal


class Course:
    """A drone's global reference, and how far along it the drone has come."""

    def __init__(self, reference: Polynomial, horizon: float, speed: float, acceleration: float) -> None:
        self.reference, self.horizon = reference, horizon
        self.goal = reference.at(np.array([reference.end])).position[0]
        self._step = horizon / 20 / speed
        self._braking = speed**2 / (2 * acceleration)
        self._progress = 0.0

    def target(self, place: Array) -> Target:
        """The first point of the reference, past the one nearest to ``place`` (3,), that is a horizon away from it."""
        times = np.append(np.arange(self._progress, self.reference.end, self._step), self.reference.end)
        motion = self.reference.at(times)
        away = np.linalg.norm(motion.position - place, axis=-1)
        nearest = int(np.argmin(away))
        self._progress = float(times[nearest])
        beyond = np.flatnonzero(away[nearest:] >= self.horizon)
        index = nearest + int(beyond[0]) if len(beyond) else len(times) - 1
        velocity = motion.velocity[index]
        if np.linalg.norm(self.goal - motion.position[index]) < self._braking:
            velocity = np.zeros(3)
        return Target(float(times[index]), motion.position[index], velocity, index == len(times) - 1)
