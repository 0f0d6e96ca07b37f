"""A small planner to hold the adapter against: from rest to v* with minimum jerk, then straight on, avoiding nothing.

The first piece is the quintic that meets position, velocity and acceleration at both ends; it covers half the distance
that v* would, so the formation cruises on a line that started ``RAMP / 2`` seconds late.
"""

from dataclasses import dataclass

import numpy as np

from baselines.planner.agent import AdapterSpec, PlannerAgent, PlannerSpec
from baselines.planner.interface import Array, Failure, Fleet, State, Task, Trajectory, View
from baselines.tracker import TrackerSpec
from envs.formation import FormationEnv

RAMP = 2.0
"""s, from rest to v*."""

GAINS = TrackerSpec(6.0, 4.0, (10.0, 10.0, 5.0), 0.785, 0.1)


@dataclass(frozen=True)
class StraightSpec(PlannerSpec):
    """Settings of the example."""

    delay: float  # s at the start before the fleet moves
    trouble: str  # "": none; otherwise what goes wrong from 1 s on, see StraightFleet


@dataclass(frozen=True)
class Ramp:
    """One drone's way: stands until ``start``, reaches ``velocity`` (3,) m/s after RAMP seconds, keeps it."""

    place: Array  # (3,) m
    velocity: Array  # (3,) m/s
    start: float
    end: float = np.inf

    def at(self, time: Array) -> State:
        u = np.clip((time - self.start) / RAMP, 0, 1)[:, None]
        travelled = RAMP * (u**3 - u**4 / 2) + np.maximum(time - self.start - RAMP, 0)[:, None]
        speed = 3 * u**2 - 2 * u**3
        rate = np.where((u > 0) & (u < 1), 6 * u * (1 - u), 0) / RAMP
        jerk = np.where((u > 0) & (u < 1), 6 - 12 * u, 0) / RAMP**2
        return State(
            self.place + self.velocity * travelled, self.velocity * speed, self.velocity * rate, self.velocity * jerk
        )


class StraightFleet:
    """All drones on parallel ramps. ``trouble``: raises, returns too few, or gives positions that are not finite."""

    def __init__(self, task: Task, view: View, spec: StraightSpec) -> None:
        place = np.array([0.0, 0.0, task.height]) + task.offsets
        self.paths: list[Trajectory] = [Ramp(p, task.velocity, view.time + spec.delay) for p in place]
        self.failures: list[Failure] = []
        self.replans = 0
        self._trouble = spec.trouble

    def step(self, view: View) -> list[Trajectory]:
        if not self._trouble or view.time < 1.0:
            return self.paths
        if self._trouble == "raise":
            raise ArithmeticError("the solver gave up")
        if self._trouble == "report":
            self.failures.append(Failure(view.time, 1, "no path"))
            return self.paths
        return self.paths[:1] if self._trouble == "few" else [Ramp(np.full(3, np.nan), np.zeros(3), 0.0)] * 3


class Straight(PlannerAgent):
    """The example as an agent."""

    def __init__(self, name: str, env: FormationEnv, spec: StraightSpec) -> None:
        super().__init__(name, env, spec)
        self.own = spec

    def fleet(self, task: Task, view: View, generator: np.random.Generator) -> Fleet:
        return StraightFleet(task, view, self.own)


def spec(mode: str = "waypoints", trouble: str = "") -> StraightSpec:
    """Settings of the example in a mode of the adapter."""
    adapter = AdapterSpec(mode, waypoint_period=0.1, frame_spacing=0.02, seed=0)
    return StraightSpec(("avoids nothing",), adapter, GAINS, delay=0.0, trouble=trouble)


def make(env: FormationEnv, mode: str = "waypoints", trouble: str = "", name: str = "straight_plan") -> Straight:
    """The example for ``env``."""
    return Straight(name, env, spec(mode, trouble))
