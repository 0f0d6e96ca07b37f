"""A plane between the hulls of two sets of points, or none.

The linear programme of R-MADER (n.a + d >= 1 for an obstacle's vertices a, n.q + d <= -1 for the spline's vertices q,
infeasible exactly if the hulls meet) as non-negative least squares: the residual of the least distance between the
convex cones over both sets is the plane, and as the points are drawn close together before, it is the plane half-way
between the hulls.
"""

from math import sqrt

import numpy as np
from numba import njit

from baselines.planner.interface import Array
from baselines.rmader.nnls import dot, nnls

SHRINK = 20.0
"""The points are scaled into a ball of this radius' reciprocal: the larger, the nearer the plane to half-way."""

BUDGET = 200
"""Exchanges of the solver; 20 are usual."""

TOUCH = 1e-6
"""m; hulls nearer than this meet."""


@njit(cache=True)
def apart(obstacle: Array, points: Array) -> bool:
    """Whether the boxes around the two sets (V, 3) and (P, 3) are apart: then so are the hulls."""
    for axis in range(3):
        low, high = points[0, axis], points[0, axis]
        for i in range(1, points.shape[0]):
            low, high = min(low, points[i, axis]), max(high, points[i, axis])
        above, below = True, True
        for i in range(obstacle.shape[0]):
            above = above and obstacle[i, axis] > high + TOUCH
            below = below and obstacle[i, axis] < low - TOUCH
        if above or below:
            return True
    return False


@njit(cache=True)
def separate(obstacle: Array, points: Array, plane: Array) -> bool:
    """Whether the hulls of (V, 3) and (P, 3) are apart; ``plane`` (4,) becomes n and d.

    n.a + d >= 1 on ``obstacle``, n.q + d <= -1 on ``points``. What the solver finds is tested: a plane that is returned
    separates, whatever the rounding.
    """
    count, own = obstacle.shape[0], points.shape[0]
    columns, target, residual = np.zeros((count + own, 5)), np.zeros(5), np.zeros(5)
    reach = 0.0
    for axis in range(3):
        centre = 0.0
        for i in range(own):
            centre += points[i, axis] / own
        for i in range(count):
            columns[i, axis] = obstacle[i, axis] - centre
            reach = max(reach, abs(columns[i, axis]))
        for i in range(own):
            columns[count + i, axis] = centre - points[i, axis]
            reach = max(reach, abs(columns[count + i, axis]))
    if reach < TOUCH:
        return False
    for i in range(count + own):
        for axis in range(3):
            columns[i, axis] /= SHRINK * reach
        columns[i, 3 if i < count else 4] = 1.0
    target[3], target[4] = 1.0, 1.0
    nnls(columns, target, np.empty(count + own), residual, BUDGET)
    return half_way(obstacle, points, residual[:3], plane)


@njit(cache=True)
def half_way(obstacle: Array, points: Array, inward: Array, plane: Array) -> bool:
    """The plane across ``inward`` (3,) half-way between the sets, scaled to margins of 1 and -1; False if they meet."""
    length = sqrt(dot(inward, inward))
    if length < 1e-13:
        return False
    near, far = np.inf, -np.inf
    for i in range(obstacle.shape[0]):
        near = min(near, -dot(inward, obstacle[i]) / length)
    for i in range(points.shape[0]):
        far = max(far, -dot(inward, points[i]) / length)
    gap = near - far
    if gap <= TOUCH:
        return False
    for axis in range(3):
        plane[axis] = -2 * inward[axis] / (length * gap)
    plane[3] = -(near + far) / gap
    return True
