"""Clamped uniform cubic B-splines that end at rest, and plans made of cubic pieces.

A spline has ``INTERVALS`` intervals of equal length and CONTROLS = 7 control points. The first three carry the start's
position, velocity and acceleration, the last three are one point: of seven only two are free (MADER, Sec. IV).
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, PPoly

from baselines.planner.interface import Array, State

INTERVALS = 4
DEGREE = 3
CONTROLS = INTERVALS + DEGREE


def knots(degree: int = DEGREE) -> Array:
    """Clamped knots in units of one interval, for the spline or (lower ``degree``) one of its derivatives."""
    return np.concatenate((np.zeros(degree), np.arange(INTERVALS + 1.0), np.full(degree, float(INTERVALS))))


def basis(degree: int = DEGREE) -> Array:
    """(I, d + 1, d + 1): powers of u in [0, 1] on interval i are basis[i] @ its control points."""
    controls = INTERVALS + degree
    splines = [PPoly.from_spline(BSpline(knots(degree), one, degree)).c[::-1] for one in np.eye(controls)]
    pieces = np.stack(splines, -1)[:, degree : degree + INTERVALS]  # (d + 1, I, d + I)
    return np.stack([pieces[:, i, i : i + degree + 1] for i in range(INTERVALS)])


BASIS = basis()
"""(4, 4, 4) from the control points of an interval to the coefficients of 1, u, u^2, u^3."""


def first_controls(position: Array, velocity: Array, acceleration: Array, interval: float) -> Array:
    """q0, q1, q2 (3, 3) in m that start a spline with ``interval`` s per interval at the given state."""
    first = position + interval * velocity / 3
    return np.stack((position, first, first + 2 * interval / 3 * velocity + interval**2 / 3 * acceleration))


def velocity_controls(controls: Array, interval: float) -> Array:
    """Velocity control points (6, 3) in m/s."""
    span = knots()[DEGREE + 1 : -1] - knots()[1:CONTROLS]
    return DEGREE * np.diff(controls, axis=0) / (span * interval)[:, None]


def acceleration_controls(controls: Array, interval: float) -> Array:
    """Acceleration control points (5, 3) in m/s^2: the accelerations at the knots."""
    span = knots()[DEGREE + 1 : -2] - knots()[2:CONTROLS]
    return (DEGREE - 1) * np.diff(velocity_controls(controls, interval), axis=0) / (span * interval)[:, None]


@dataclass(frozen=True)
class Plan:
    """Cubic pieces one after the other, at rest at the end: what a drone flies and what it tells the others.

    It is a :class:`baselines.planner.interface.Trajectory`.
    """

    times: Array  # (K + 1,) s since the start of the episode
    pieces: Array  # (K, 4, 3) coefficients of 1, s, s^2, s^3, s in seconds since the piece's start

    @classmethod
    def resting(cls, position: Array, time: float) -> "Plan":
        """Standing still at ``position`` (3,) from ``time`` on."""
        pieces = np.zeros((1, 4, 3))
        pieces[0, 0] = position
        return cls(np.array([time, time]), pieces)

    @classmethod
    def spline(cls, controls: Array, interval: float, start: float) -> "Plan":
        """The spline with ``controls`` (7, 3) that starts at ``start``."""
        windows = np.stack([controls[i : i + 4] for i in range(INTERVALS)])
        powers = (BASIS @ windows) / interval ** np.arange(4.0)[:, None]
        return cls(start + interval * np.arange(INTERVALS + 1), powers)

    @property
    def start(self) -> float:
        return float(self.times[0])

    @property
    def end(self) -> float:
        return float(self.times[-1])

    @property
    def goal(self) -> Array:
        """Where it comes to rest, (3,) m."""
        return np.power(self.times[-1] - self.times[-2], np.arange(4.0)) @ self.pieces[-1]

    def at(self, time: Array) -> State:
        """Position, velocity, acceleration and jerk (T, 3) at ``time`` (T,); at rest before start and after end."""
        now = np.clip(time, self.start, self.end)
        index = np.clip(np.searchsorted(self.times, now, side="right") - 1, 0, len(self.pieces) - 1)
        s = (now - self.times[index])[:, None]
        c0, c1, c2, c3 = self.pieces[index].swapaxes(0, 1)
        moving = ((time >= self.start) & (time < self.end))[:, None]
        return State(
            position=c0 + s * (c1 + s * (c2 + s * c3)),
            velocity=np.where(moving, c1 + s * (2 * c2 + 3 * s * c3), 0.0),
            acceleration=np.where(moving, 2 * c2 + 6 * s * c3, 0.0),
            jerk=np.where(moving, 6 * c3, 0.0),
        )

    def spliced(self, other: "Plan", now: float) -> "Plan":
        """This plan until ``other`` starts, then ``other``; pieces that ended before ``now`` are dropped."""
        keep = (self.times[:-1] < other.start) & (self.times[1:] > now)
        times, pieces = self.times[:-1][keep], self.pieces[keep]
        if self.end < other.start:  # it rests in between
            rest = np.zeros((1, 4, 3))
            rest[0, 0] = self.goal
            times, pieces = np.append(times, max(self.end, now)), np.concatenate((pieces, rest))
        return Plan(np.concatenate((times, other.times)), np.concatenate((pieces, other.pieces)))
