"""The cost of a trajectory and its exact gradient in waypoints and times (Quan et al., ICRA 2022, Sec. IV).

J = integral of |jerk|^2 + time + sum over samples of omega T_i / K (obstacle + swarm + formation + limits) + spacing.
Samples stand K to a piece at s = j T_i / K, with omega = 1/2 at a piece's ends. A sample's time is absolute, so the
others' motion makes it depend on the durations of all earlier pieces: that partial is ``by_time`` below.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from baselines.planner.interface import Array
from baselines.swarm_formation import minco
from baselines.swarm_formation.scene import Scene, distance
from baselines.swarm_formation.similarity import difference, normalise
from baselines.swarm_formation.spec import CostSpec


class Peers(NamedTuple):
    """The trajectories of K other drones that have been received, padded to the longest."""

    drone: Array  # (K,) int64
    start: Array  # (K,) s
    pieces: Array  # (K,) int64
    durations: Array  # (K, P) s
    coefficients: Array  # (K, 6 P, 3)


class Problem(NamedTuple):
    """All that the cost of one drone's trajectory depends on besides its waypoints and times."""

    drone: int
    start: float  # s, when the trajectory begins
    head: Array  # (3, 3) position, velocity, acceleration
    tail: Array  # (3, 3) likewise
    wanted: Array  # (N, N) normalised Laplacian of the formation
    weights: CostSpec
    scene: Scene
    peers: Peers


@njit(cache=True)
def objective(free: Array, problem: Problem, gradient: Array) -> float:
    """J for ``free`` (4 P - 3,): waypoints (P - 1, 3), then P unconstrained times; ``gradient`` becomes dJ / d free."""
    pieces = (len(free) + 3) // 4
    waypoints = free[: 3 * pieces - 3].reshape(pieces - 1, 3)
    durations, by_durations = np.empty(pieces), np.full(pieces, problem.weights.time)
    for i in range(pieces):
        durations[i] = minco.stretch(free[3 * pieces - 3 + i])
    factors = minco.system(durations)
    minco.factor(factors)
    coefficients = minco.right_side(problem.head, problem.tail, waypoints)
    minco.solve(factors, coefficients)
    by_coefficients = np.zeros((6 * pieces, 3))
    total = minco.energy(coefficients, durations, by_coefficients, by_durations)
    total += sampled(coefficients, durations, problem, by_coefficients, by_durations)
    total += spacing(coefficients, durations, problem.weights, by_coefficients, by_durations)
    minco.propagate(factors, coefficients, durations, by_coefficients, by_durations)
    for i in range(pieces):
        total += problem.weights.time * durations[i]
        place = 3 * pieces - 3 + i
        gradient[place] = by_durations[i] * minco.stretch_slope(free[place])
        if i < pieces - 1:
            for axis in range(3):
                gradient[3 * i + axis] = by_coefficients[6 * i + 5, axis]
    return total


@njit(cache=True)
def sampled(
    coefficients: Array, durations: Array, problem: Problem, by_coefficients: Array, by_durations: Array
) -> float:
    """The terms that are integrated over samples; their explicit partials are added to (6 P, 3) and (P,)."""
    count, pieces = problem.weights.samples, len(durations)
    last = 2 * (pieces * count + 1) // 3
    state, partial = np.empty((4, 3)), np.empty((3, 3))  # rows: position, velocity, acceleration (, jerk)
    total, begin = 0.0, problem.start
    for i in range(pieces):
        for j in range(count + 1):
            s = j * durations[i] / count
            for order in range(4):
                for axis in range(3):
                    state[order, axis] = minco.derivative(coefficients, i, axis, order, s)
                    if order < 3:
                        partial[order, axis] = 0.0
            value = limits(state, problem.weights, partial)
            by_time = 0.0
            if 1 <= i * count + j < last:
                value += obstacle(state, problem, partial)
                others = neighbours(state, problem, begin + s, partial)
                value += others[0]
                by_time = others[1]
            share = (0.5 if j == 0 or j == count else 1.0) / count
            total += share * durations[i] * value
            by_durations[i] += share * (value + by_time * durations[i] * j / count)
            for earlier in range(i):
                by_durations[earlier] += share * durations[i] * by_time
            scale = share * durations[i]
            _collect(state, partial, (i, s, scale, scale * j / count), by_coefficients, by_durations)
        begin += durations[i]
    return total


@njit(cache=True)
def _collect(
    state: Array, partial: Array, place: tuple[int, float, float, float], by_coefficients: Array, by_durations: Array
) -> None:
    """Adds ``scale`` times a sample's partials in position, velocity and acceleration.

    ``place`` is (piece, s, scale, scale ds / dT).
    """
    piece, s, scale, by_s = place
    for order in range(3):
        for axis in range(3):
            push = partial[order, axis]
            if push != 0.0:
                by_durations[piece] += by_s * push * state[order + 1, axis]
                for k in range(order, 6):
                    by_coefficients[6 * piece + k, axis] += scale * push * minco.falling(k, order) * s ** (k - order)


@njit(cache=True)
def limits(state: Array, weights: CostSpec, partial: Array) -> float:
    """Cubic penalties on speed and acceleration; partials are added to ``partial`` (3, 3)."""
    total = 0.0
    for order in range(1, 3):
        bound = weights.speed if order == 1 else weights.acceleration
        square = state[order, 0] ** 2 + state[order, 1] ** 2 + state[order, 2] ** 2
        over = square - bound * bound
        if over > 0:
            total += weights.limits * over**3
            for axis in range(3):
                partial[order, axis] += 6 * weights.limits * over * over * state[order, axis]
    return total


@njit(cache=True)
def obstacle(state: Array, problem: Problem, partial: Array) -> float:
    """Cubic penalty within the clearance of an obstacle; the partial is added to ``partial[0]``."""
    slope = np.empty(3)
    weights = problem.weights
    short = weights.clearance - distance(problem.scene, state[0, 0], state[0, 1], state[0, 2], slope)
    if short <= 0:
        return 0.0
    for axis in range(3):
        partial[0, axis] -= 3 * weights.obstacle * short * short * slope[axis]
    return weights.obstacle * short**3


@njit(cache=True)
def neighbours(state: Array, problem: Problem, time: float, partial: Array) -> tuple[float, float]:
    """Swarm clearance and formation at an absolute ``time``: the value and its explicit partial in time.

    The partial in the drone's own position is added to ``partial[0]``. The ellipsoid of the clearance is twice as tall
    as wide, for the downwash.
    """
    weights, peers = problem.weights, problem.peers
    count = len(problem.wanted)
    points, speeds = np.zeros((count, 3)), np.zeros((count, 3))
    total, by_time = 0.0, 0.0
    for axis in range(3):
        points[problem.drone, axis] = state[0, axis]
    for k in range(len(peers.drone)):
        other = peers.drone[k]
        locate(peers, k, time, points[other], speeds[other])
        square = 0.0
        for axis in range(3):
            square += (state[0, axis] - points[other, axis]) ** 2 * (0.25 if axis == 2 else 1.0)
        short = (1.5 * weights.swarm_clearance) ** 2 - square
        if short > 0:
            total += weights.swarm * short**3
            for axis in range(3):
                gap = (state[0, axis] - points[other, axis]) * (0.25 if axis == 2 else 1.0)
                partial[0, axis] -= 6 * weights.swarm * short * short * gap
                by_time += 6 * weights.swarm * short * short * gap * speeds[other, axis]
    if weights.formation > 0:
        gradient = np.empty((count, 3))
        total += weights.formation * difference(points, problem.wanted, gradient)
        if weights.unit_gradient:
            normalise(gradient)
        for axis in range(3):
            partial[0, axis] += weights.formation * gradient[problem.drone, axis]
            for other in range(count):
                by_time += weights.formation * gradient[other, axis] * speeds[other, axis]
    return total, by_time


@njit(cache=True)
def locate(peers: Peers, k: int, time: float, position: Array, velocity: Array) -> None:
    """Position and velocity (3,) of peer ``k`` at ``time``: standing before its start, at steady speed past its end."""
    s = time - peers.start[k]
    moving = s >= 0
    s = max(s, 0.0)
    piece = 0
    while piece < peers.pieces[k] - 1 and s > peers.durations[k, piece]:
        s -= peers.durations[k, piece]
        piece += 1
    beyond = max(s - peers.durations[k, piece], 0.0)
    for axis in range(3):
        speed = minco.derivative(peers.coefficients[k], piece, axis, 1, s - beyond) if moving else 0.0
        position[axis] = minco.derivative(peers.coefficients[k], piece, axis, 0, s - beyond) + beyond * speed
        velocity[axis] = speed


@njit(cache=True)
def spacing(
    coefficients: Array, durations: Array, weights: CostSpec, by_coefficients: Array, by_durations: Array
) -> float:
    """Variance of the squared distances between neighbouring samples: keeps samples evenly spaced."""
    samples, pieces = weights.samples, len(durations)
    count = samples * pieces
    points, gaps = np.empty((count + 1, 3)), np.zeros(count)
    for k in range(count + 1):
        i = min(k // samples, pieces - 1)
        for axis in range(3):
            points[k, axis] = minco.derivative(coefficients, i, axis, 0, (k - i * samples) * durations[i] / samples)
            if k > 0:
                gaps[k - 1] += (points[k, axis] - points[k - 1, axis]) ** 2
    mean, square = gaps.mean(), 0.0
    state, partial = np.zeros((4, 3)), np.zeros((3, 3))
    for k in range(count + 1):
        i = min(k // samples, pieces - 1)
        s = (k - i * samples) * durations[i] / samples
        for axis in range(3):
            partial[0, axis] = 0.0
            if k > 0:
                partial[0, axis] += (gaps[k - 1] - mean) * (points[k, axis] - points[k - 1, axis])
            if k < count:
                partial[0, axis] -= (gaps[k] - mean) * (points[k + 1, axis] - points[k, axis])
            partial[0, axis] *= 4 * weights.spacing / count
            state[1, axis] = minco.derivative(coefficients, i, axis, 1, s)
        _collect(state, partial, (i, s, 1.0, (k - i * samples) / samples), by_coefficients, by_durations)
        if k < count:
            square += (gaps[k] - mean) ** 2
    return weights.spacing * square / count
