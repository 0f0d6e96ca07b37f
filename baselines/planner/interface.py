"""The seam between a trajectory planner and the world it flies in: numpy, one episode, all drones of one fleet.

A planner sees :class:`View` at every control period and answers with one :class:`Trajectory` per drone. Everything else
(tracking it, fitting parabolas to seen balls, simulated clock and messages, recording failures) is the adapter's.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Links(NamedTuple):
    """Delays and losses that were drawn for an episode: every message sent within a period shares its fate."""

    period: float  # s
    delays: Array  # (N, N, K) s, from sender to receiver in each period, then again from the first; inf: lost


@dataclass(frozen=True)
class Task:
    """What does not change during an episode (world frame, SI units)."""

    offsets: Array  # (N, 3) m, slots of the formation about its reference
    velocity: Array  # (3,) m/s, v*
    height: float  # m, commanded altitude
    goal: float  # m, course (y) that every drone has to pass
    columns: Array  # (C, 2) m, axes of the vertical columns
    column_radius: float  # m, as far as collisions go: the hit radius, drones being points
    ball_radius: float  # m, likewise
    drone_radius: float  # m, likewise: two drones closer than this collide
    altitude: tuple[float, float]  # m, ground and ceiling crash limits
    corridor: float  # m, the flight corridor is |x| <= this
    period: float  # s, control period
    links: Links | None = (
        None  # what the scenario does to messages between drones; None: the planner's own settings hold
    )

    @property
    def drones(self) -> int:
        return len(self.offsets)


class Parabola(NamedTuple):
    """A ball in flight: p(t) = origin + velocity (t - time) - g (t - time)^2 / 2 up, until ``landing``."""

    ball: int  # the same number for the same ball during an episode
    time: float  # s
    origin: Array  # (3,) m at ``time``
    velocity: Array  # (3,) m/s at ``time``
    landing: float  # s, when it reaches the ground


class View(NamedTuple):
    """What the fleet knows at one control period."""

    time: float  # s since the start of the episode
    position: Array  # (N, 3) m
    velocity: Array  # (N, 3) m/s
    balls: tuple[Parabola, ...]  # airborne, seen twice, within sensing range of any drone


class State(NamedTuple):
    """A point of a trajectory, or T of them: shapes (..., 3)."""

    position: Array  # m
    velocity: Array  # m/s
    acceleration: Array  # m/s^2
    jerk: Array  # m/s^3


class Trajectory(Protocol):
    """One drone's motion in time; before ``start`` and after ``end`` it stands still at its ends."""

    start: float  # s
    end: float  # s

    def at(self, time: Array) -> State:
        """The motion at ``time`` (T,) in s since the start of the episode: each part (T, 3)."""
        ...


class Failure(NamedTuple):
    """A planner that could not do its work: recorded with the episode, never raised."""

    time: float  # s
    drone: int  # -1 for all of them
    reason: str  # a few words, the same for the same kind of failure


class Fleet(Protocol):
    """The planners of all drones in one episode, with their states, clocks and messages.

    Deterministic: budgets are counts of nodes or iterations, latency is simulated, random numbers are seeded.
    """

    failures: list[Failure]
    replans: int  # plans that the drones have searched for so far, found or not

    def step(self, view: View) -> list[Trajectory]:
        """Called once per control period; the trajectory that each of the N drones is to follow now."""
        ...
