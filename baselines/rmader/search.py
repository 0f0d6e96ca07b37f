"""The octopus search: a control polygon that keeps away from every hull (MADER, Sec. V-C).

Of the seven control points the fourth and fifth are free. Each grows from the one before it by one of a grid of
velocity control points that the limits allow, so a path has two levels; nodes are taken in the order of the length of
their polygons. The last level has to be able to stop: the last three control points are one.
"""

import heapq
from math import floor, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from baselines.planner.interface import Array
from baselines.rmader.minvo import POSITION
from baselines.rmader.separator import apart, separate

FOUND, PARTIAL, NONE = 0, 1, 2

STILL = 1e-5
"""m/s; velocities below lead nowhere and are left out."""


class Rules(NamedTuple):
    """What a search keeps, and how it goes about it; compiled code reads it."""

    step: float  # s, per interval
    goal: Array  # (3,) m
    reach: float  # m, of all points about the first one
    bounds: Array  # (2, 3) m, least and most
    limits: Array  # (2,) speed in m/s and acceleration in m/s^2, per axis
    grid: Array  # (S, 3) the samples in [0, 1], in the order they are tried
    shrink: float  # share of the allowed velocities that is sampled
    voxel: float  # share of the spread of first steps that one expanded voxel covers, beyond the shortest
    bias: float  # weight of the distance to the goal in the priority
    arrival: float  # m, from the goal, where the search stops
    budget: int  # nodes taken from the queue at most


@njit(cache=True)
def clear(q: Array, interval: int, to_vertices: Array, vertices: Array, starts: NDArray[np.int64]) -> bool:
    """Whether the spline with control points ``q`` (7, 3) is apart from every hull in ``interval``."""
    own = np.zeros((4, 3))
    plane = np.empty(4)
    for u in range(4):
        for k in range(4):
            for axis in range(3):
                own[u, axis] += to_vertices[interval, u, k] * q[interval + k, axis]
    for o in range(starts.shape[1] - 1):
        hull = vertices[starts[interval, o] : starts[interval, o + 1]]
        if not apart(hull, own) and not separate(hull, own, plane):
            return False
    return True


@njit(cache=True)
def fan(before: Array, step: float, limits: Array, last: bool, shrink: float, low: Array, high: Array) -> bool:
    """Range of the next velocity control point (m/s) per axis, from the one ``before`` it; False if it is empty.

    ``limits`` is (speed, acceleration); ``step`` the interval in s; ``last``: it has to be able to stop after it.
    """
    for axis in range(3):
        change = limits[1] * step
        least, most = max(-limits[0], before[axis] - change), min(limits[0], before[axis] + change)
        if last:
            least, most = max(least, -change), min(most, change)
        if least > most:
            return False
        middle, half = (least + most) / 2, (most - least) / 2
        low[axis], high[axis] = middle - shrink * half, middle + shrink * half
    return True


@njit(cache=True)
def gap(a: Array, b: Array) -> float:
    """Distance of two points (3,)."""
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit(cache=True)
def tail(q: Array, first: int, to_vertices: Array, vertices: Array, starts: NDArray[np.int64]) -> bool:
    """Close the polygon after its fifth point, and whether the intervals from ``first`` on are clear."""
    for axis in range(3):
        q[5, axis] = q[4, axis]
        q[6, axis] = q[4, axis]
    for interval in range(first, 4):  # noqa: SIM110
        if not clear(q, interval, to_vertices, vertices, starts):
            return False
    return True


@njit(cache=True)
def met(cells: Array, count: int, point: Array, voxel: float) -> bool:
    """Whether one of the first ``count`` expanded points (S, 3) lies in the same voxel as ``point`` (3,)."""
    for i in range(count):
        same = True
        for axis in range(3):
            same = same and floor(cells[i, axis] / voxel) == floor(point[axis] / voxel)
        if same:
            return True
    return False


@njit(cache=True)
def grow(node: int, q: Array, place: Array, count: int, rules: Rules) -> int:
    """Append the children of ``node`` to ``place`` (., 3) from row ``count`` on; return how many rows there are then.

    ``node`` 0 is the third control point; any other is a candidate for the fourth.
    """
    step, bounds = rules.step, rules.bounds
    low, high, before = np.empty(3), np.empty(3), np.empty(3)
    for axis in range(3):
        before[axis] = (place[node, axis] - q[2, axis]) / step if node > 0 else 1.5 * (q[2, axis] - q[1, axis]) / step
    if not fan(before, step, rules.limits, node > 0, rules.shrink, low, high):
        return count
    for s in range(rules.grid.shape[0]):
        inside = False
        for axis in range(3):
            speed = low[axis] + rules.grid[s, axis] * (high[axis] - low[axis])
            place[count, axis] = place[node, axis] + step * speed
            inside = inside or abs(speed) > STILL
        for axis in range(3):
            inside = inside and bounds[0, axis] <= place[count, axis] <= bounds[1, axis]
        if inside and gap(place[count], q[0]) <= rules.reach:
            count += 1
    return count


@njit(cache=True)
def _octopus(q: Array, rules: Rules, to_vertices: Array, vertices: Array, starts: NDArray[np.int64]) -> tuple[int, int]:
    """See :func:`octopus`; ``q`` (7, 3) is completed in place; returns what was found and the nodes taken."""
    size = rules.grid.shape[0]
    place = np.empty((2 + size + size * size, 3))
    parent, length = np.zeros(len(place), np.int64), np.zeros(len(place))
    cells, expanded, voxel = np.empty((size, 3)), 0, 0.0
    place[0] = q[2]
    count, taken = 1, 0
    best, best_gap, partial, partial_gap = -1, np.inf, -1, np.inf
    queue = [(0.0, 0)]
    while len(queue) > 0 and taken < rules.budget:
        node = heapq.heappop(queue)[1]
        taken += 1
        here = gap(place[node], rules.goal)
        if parent[node] > 0:  # complete
            if here < best_gap:
                q[3], q[4] = place[parent[node]], place[node]
                if tail(q, 1, to_vertices, vertices, starts):
                    best, best_gap = node, here
                    if here < rules.arrival:
                        break
            continue
        if node > 0:
            q[3] = place[node]
            if met(cells, expanded, q[3], voxel) or not clear(q, 0, to_vertices, vertices, starts):
                continue
            cells[expanded] = place[node]
            expanded += 1
            if here < partial_gap:
                partial, partial_gap = node, here
        before, count = count, grow(node, q, place, count, rules)
        shortest, longest = np.inf, 0.0
        for child in range(before, count):
            move = gap(place[child], place[node])
            shortest, longest = min(shortest, move), max(longest, move)
            parent[child], length[child] = node, length[node] + move
            heapq.heappush(queue, (length[child] + rules.bias * gap(place[child], rules.goal), child))
        if node == 0:
            voxel = shortest + rules.voxel * (longest - shortest)
    if best >= 0:
        q[3], q[4] = place[parent[best]], place[best]
        tail(q, 4, to_vertices, vertices, starts)
        return FOUND, taken
    return _padded(q, place[max(partial, 0)], partial >= 0, rules, to_vertices, vertices, starts), taken


@njit(cache=True)
def _padded(
    q: Array, end: Array, known: bool, rules: Rules, to_vertices: Array, vertices: Array, starts: NDArray[np.int64]
) -> int:
    """Complete ``q`` with the first point ``end`` (3,), if one is ``known`` and the drone can stop there."""
    q[3], q[4] = end, end
    for axis in range(3):
        known = known and abs(q[3, axis] - q[2, axis]) <= rules.limits[1] * rules.step * rules.step
    return PARTIAL if known and tail(q, 1, to_vertices, vertices, starts) else NONE


def touching(controls: Array, vertices: Array, starts: NDArray[np.int64]) -> bool:
    """Whether the spline with ``controls`` (7, 3) meets any hull of a scene in its interval."""
    return not all(clear(controls, i, POSITION, vertices, starts) for i in range(len(starts)))


def octopus(controls: Array, rules: Rules, vertices: Array, starts: NDArray[np.int64]) -> tuple[Array | None, int]:
    """Control points (7, 3) of the clear polygon that ends nearest to the goal, or None, and the nodes it took.

    ``controls`` (3, 3) are the fixed first ones; hulls as in :class:`baselines.rmader.hulls.Scene`.
    A complete polygon is tested only if it ends nearer to the goal than the best one so far, which changes nothing.
    Where none is complete, the nearest first point is tried as the end, if the drone can stop there.
    """
    q = np.zeros((7, 3))
    q[:3] = controls
    status, taken = _octopus(q, rules, POSITION, vertices, starts)
    return (None if status == NONE else q), taken
