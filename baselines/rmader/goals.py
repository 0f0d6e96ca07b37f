"""Where each drone wants to go: the paper gives R-MADER the vertices of the formation as goals."""

import numpy as np

from baselines.planner.interface import Array, Task
from baselines.rmader.spec import GoalSpec, LimitSpec
from baselines.rmader.timing import least_time

ROUNDS = 12
"""Fixed-point rounds for the time at which a drone meets its moving slot."""


class Goals:
    """The formation's slots, beyond the goal line or on their way there at v*."""

    def __init__(self, task: Task, start: Array, spec: GoalSpec, limits: LimitSpec) -> None:
        """``start`` (3,) in m is the formation's reference at the start of the episode."""
        self._task, self._spec, self._limits = task, spec, limits
        self._speed = float(np.linalg.norm(task.velocity))
        along = task.velocity / self._speed
        rear = (task.offsets @ along).min()
        self._start = np.array([start[0], start[1], task.height])
        self._length = (task.goal + spec.beyond - rear - self._start[1]) / along[1]
        self._along = along

    def destination(self, drone: int) -> Array:
        """The slot (3,) in m beyond the goal line at which ``drone`` stops."""
        place: Array = self._start + self._along * self._length + self._task.offsets[drone]
        return place

    def slot(self, drone: int, time: float) -> Array:
        """The slot (3,) in m at ``time`` (s) of the formation that flies v* from the start to the destination."""
        travelled = min(self._speed * time, self._length)
        place: Array = self._start + self._along * travelled + self._task.offsets[drone]
        return place

    def aim(self, drone: int, time: float, position: Array, velocity: Array) -> tuple[Array, float]:
        """Goal (3,) in m of a plan that starts in this state at ``time`` in s, and the plan's duration in s.

        A moving goal is where the slot will be when the plan ends.
        """
        if self._spec.mode == "destination":
            goal = self._within(position, self.destination(drone))
            return goal, self._duration(drone, position, velocity, goal)
        duration = self._spec.horizon
        for _ in range(ROUNDS):
            goal = self._within(position, self.slot(drone, time + duration))
            duration = max(self._duration(drone, position, velocity, goal), self._spec.horizon)
        return goal, duration

    def _within(self, position: Array, goal: Array) -> Array:
        """``goal``, or where the way there leaves the sphere that a plan has to stay within."""
        away = goal - position
        distance = float(np.linalg.norm(away))
        return position + away * min(1.0, self._spec.reach / max(distance, 1e-9))

    def _duration(self, drone: int, position: Array, velocity: Array, goal: Array) -> float:
        near = float(np.linalg.norm(position - self.destination(drone))) < self._spec.near
        factor = self._spec.near_factor if near else self._spec.factor
        times = least_time(goal - position, velocity, self._limits.speed, self._limits.acceleration)
        return factor * float(times.max())
