"""MINCO: the minimum-jerk piecewise quintic through waypoints, and how its coefficients answer to waypoints and times.

Wang et al., "Geometrically constrained trajectory optimization for multicopters", T-RO 2022, class s = 3. Piece i of P
is p(t) = sum_k c[6 i + k] t^k, 0 <= t <= T_i. The coefficients (6 P, 3) solve M(T) c = b(q): three rows for the state
at the start; per joint jerk and snap continuity, the waypoint, then position, velocity and acceleration continuity;
three rows for the state at the end. M has bandwidth 6 on both sides and needs no pivoting; M[r, c] is kept at
[r, c - r + 6].
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from baselines.planner.interface import Array, State

BAND = 6
"""Sub- and superdiagonals of M."""
ROUNDING = 1e-9
"""s, by which a time may miss a trajectory's end and still be at it."""


@njit(cache=True)
def falling(k: int, order: int) -> float:
    """k (k - 1) ... (k - order + 1): the factor of t^(k - order) in the ``order``-th derivative of t^k."""
    product = 1.0
    for m in range(order):
        product *= k - m
    return product


@njit(cache=True)
def system(durations: Array) -> Array:
    """M(T) in band storage (6 P, 13)."""
    pieces = len(durations)
    rows = np.zeros((6 * pieces, 2 * BAND + 1))
    for order in range(3):
        rows[order, BAND] = falling(order, order)
    for i in range(pieces):
        joint = i < pieces - 1
        for m in range(6 if joint else 3):
            order = m
            if joint:
                order = m + 3 if m < 2 else max(m - 3, 0)  # jerk, snap, waypoint, position, velocity, acceleration
            r = 6 * i + 3 + m
            for k in range(order, 6):
                rows[r, 6 * i + k - r + BAND] = falling(k, order) * durations[i] ** (k - order)
            if joint and m != 2:
                rows[r, 6 * i + 6 + order - r + BAND] = -falling(order, order)
    return rows


@njit(cache=True)
def factor(rows: Array) -> None:
    """LU factors of a banded matrix in its own storage, without pivoting (Golub and Van Loan, algorithm 4.3.1)."""
    size = len(rows)
    for k in range(size):
        last = min(size, k + BAND + 1)
        for r in range(k + 1, last):
            share = rows[r, k - r + BAND] / rows[k, BAND]
            rows[r, k - r + BAND] = share
            if share != 0.0:
                for c in range(k + 1, last):
                    rows[r, c - r + BAND] -= share * rows[k, c - k + BAND]


@njit(cache=True)
def solve(factors: Array, x: Array) -> None:
    """M x = b in place: ``x`` (n, 3) comes as b."""
    size = len(factors)
    for axis in range(3):
        for r in range(size):
            for c in range(max(0, r - BAND), r):
                x[r, axis] -= factors[r, c - r + BAND] * x[c, axis]
        for r in range(size - 1, -1, -1):
            for c in range(r + 1, min(size, r + BAND + 1)):
                x[r, axis] -= factors[r, c - r + BAND] * x[c, axis]
            x[r, axis] /= factors[r, BAND]


@njit(cache=True)
def solve_transposed(factors: Array, x: Array) -> None:
    """M^T x = b in place: ``x`` (n, 3) comes as b."""
    size = len(factors)
    for axis in range(3):
        for c in range(size):
            x[c, axis] /= factors[c, BAND]
            for r in range(c + 1, min(size, c + BAND + 1)):
                x[r, axis] -= factors[c, r - c + BAND] * x[c, axis]
        for c in range(size - 1, -1, -1):
            for r in range(max(0, c - BAND), c):
                x[r, axis] -= factors[c, r - c + BAND] * x[c, axis]


@njit(cache=True)
def right_side(head: Array, tail: Array, waypoints: Array) -> Array:
    """b(q) (6 P, 3): ``head`` and ``tail`` (3, 3) are position, velocity, acceleration; ``waypoints`` (P - 1, 3)."""
    size = 6 * (len(waypoints) + 1)
    right = np.zeros((size, 3))
    for axis in range(3):
        for order in range(3):
            right[order, axis] = head[order, axis]
            right[size - 3 + order, axis] = tail[order, axis]
        for i in range(len(waypoints)):
            right[6 * i + 5, axis] = waypoints[i, axis]
    return right


@njit(cache=True)
def energy(coefficients: Array, durations: Array, by_coefficients: Array, by_durations: Array) -> float:
    """Integral of the squared jerk; its explicit partials are added to (6 P, 3) and (P,)."""
    total = 0.0
    for i in range(len(durations)):
        t = durations[i]
        for axis in range(3):
            a, b = coefficients[6 * i + 3, axis], coefficients[6 * i + 4, axis]
            c = coefficients[6 * i + 5, axis]
            total += 36 * a * a * t + 144 * a * b * t**2 + (192 * b * b + 240 * a * c) * t**3
            total += 720 * b * c * t**4 + 720 * c * c * t**5
            by_coefficients[6 * i + 3, axis] += 72 * a * t + 144 * b * t**2 + 240 * c * t**3
            by_coefficients[6 * i + 4, axis] += 144 * a * t**2 + 384 * b * t**3 + 720 * c * t**4
            by_coefficients[6 * i + 5, axis] += 240 * a * t**3 + 720 * b * t**4 + 1440 * c * t**5
            by_durations[i] += (6 * a + 24 * b * t + 60 * c * t**2) ** 2
    return total


@njit(cache=True)
def derivative(coefficients: Array, piece: int, axis: int, order: int, time: float) -> float:
    """One axis of the ``order``-th derivative of a piece, ``time`` s after its start."""
    value = 0.0
    for k in range(5, order - 1, -1):
        value = value * time + falling(k, order) * coefficients[6 * piece + k, axis]
    return value


@njit(cache=True)
def propagate(
    factors: Array, coefficients: Array, durations: Array, by_coefficients: Array, by_durations: Array
) -> None:
    """From the partials in coefficients and times to the totals in waypoints and times, all in place.

    The adjoint M^T Lambda = dK/dc takes the place of ``by_coefficients``; its row 6 i + 5 is the gradient in
    waypoint i. A time moves the equations at its piece's end.
    """
    solve_transposed(factors, by_coefficients)
    pieces = len(durations)
    for i in range(pieces):
        joint = i < pieces - 1
        for m in range(6 if joint else 3):
            order = m + 1
            if joint:
                order = m + 4 if m < 2 else max(m - 2, 1)
            for axis in range(3):
                moved = derivative(coefficients, i, axis, order, durations[i])
                by_durations[i] -= by_coefficients[6 * i + 3 + m, axis] * moved


@njit(cache=True)
def connect(head: Array, tail: Array, waypoints: Array, durations: Array) -> Array:
    """Coefficients (6 P, 3) of the minimum-jerk curve from ``head`` through ``waypoints`` to ``tail``."""
    factors = system(durations)
    factor(factors)
    coefficients = right_side(head, tail, waypoints)
    solve(factors, coefficients)
    return coefficients


@njit(cache=True)
def stretch(free: float) -> float:
    """A duration in s from an unconstrained time: T(0) = 1, smooth, always positive."""
    return 0.5 * free * free + free + 1 if free > 0 else 1 / (0.5 * free * free - free + 1)


@njit(cache=True)
def stretch_slope(free: float) -> float:
    """dT / d free."""
    return free + 1 if free > 0 else (1 - free) / (0.5 * free * free - free + 1) ** 2


def unstretch(durations: Array) -> Array:
    """The inverse of :func:`stretch`, for durations (P,)."""
    above = np.sqrt(np.maximum(2 * durations - 1, 0)) - 1
    return np.where(durations > 1, above, 1 - np.sqrt(np.maximum(2 / durations - 1, 0)))


class Polynomial(NamedTuple):
    """A trajectory of P quintic pieces that starts at ``start`` s; still at its ends (see the planner interface)."""

    start: float  # s
    durations: Array  # (P,) s
    coefficients: Array  # (6 P, 3)

    @property
    def end(self) -> float:
        """When it ends, in s."""
        return self.start + float(self.durations.sum())

    def at(self, time: Array) -> State:
        """The motion at ``time`` (T,) in s since the start of the episode: each part (T, 3)."""
        motion = np.empty((len(time), 4, 3))
        sample(self.start, self.durations, self.coefficients, np.asarray(time, dtype=float), motion)
        return State(motion[:, 0], motion[:, 1], motion[:, 2], motion[:, 3])


@njit(cache=True)
def sample(start: float, durations: Array, coefficients: Array, times: Array, motion: Array) -> None:
    """``motion`` (T, 4, 3) becomes position, velocity, acceleration, jerk at ``times`` (T,), still beyond the ends."""
    total = durations.sum()
    for t in range(len(times)):
        s = min(max(times[t] - start, 0.0), total)
        moving = -ROUNDING <= times[t] - start <= total + ROUNDING
        piece = 0
        while piece < len(durations) - 1 and s >= durations[piece]:
            s -= durations[piece]
            piece += 1
        for order in range(4):
            for axis in range(3):
                value = 0.0
                if order == 0 or moving:
                    value = derivative(coefficients, piece, axis, order, s)
                motion[t, order, axis] = value


def still(start: float, position: Array, duration: float) -> Polynomial:
    """Two constant pieces at ``position`` (3,) from ``start`` on, ``duration`` s each: an emergency stop."""
    coefficients = np.zeros((12, 3))
    coefficients[[0, 6]] = position
    return Polynomial(start, np.full(2, duration), coefficients)
