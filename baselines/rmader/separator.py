"""A plane between the hulls of two sets of points, or none.

The linear programme of R-MADER (n.a + d >= 1 for an obstacle's vertices a, n.q + d <= -1 for the spline's vertices q,
infeasible exactly if the hulls meet) as non-negative least squares: the residual of the least distance between the
convex cones over both sets is the plane, and as the points are drawn close together before, it is the plane half-way
between the hulls.
"""

import numpy as np
from numba import njit

from baselines.planner.interface import Array
from baselines.rmader.nnls import dot, nnls

SHRINK = 20.0
"""The points are scaled into a ball of this radius' reciprocal: the larger, the nearer the plane to half-way."""

BUDGET = 200
"""Exchanges of the solver; 20 are usual."""


@njit(cache=True)
def apart(obstacle: Array, points: Array) -> bool:
    """Whether the boxes around the two sets (V, 3) and (P, 3) are apart: then so are the hulls."""
    for axis in range(3):
        low, high = points[0, axis], points[0, axis]
        for i in range(1, points.shape[0]):
            low, high = min(low, points[i, axis]), max(high, points[i, axis])
        least, most = obstacle[0, axis], obstacle[0, axis]
        for i in range(1, obstacle.shape[0]):
            least, most = min(least, obstacle[i, axis]), max(most, obstacle[i, axis])
        if low > most or high < least:
            return True
    return False


@njit(cache=True)
def separate(obstacle: Array, points: Array) -> tuple[bool, Array]:
    """(found, plane): ``plane`` (4,) is n and d with n.a + d >= 1 on ``obstacle`` (V, 3), <= -1 on ``points`` (P, 3).

    What the solver finds is tested: a plane that is returned separates, whatever the rounding.
    """
    count, own = obstacle.shape[0], points.shape[0]
    centre = np.zeros(3)
    for i in range(own):
        centre += points[i] / own
    reach = 1e-9
    for i in range(own):
        reach = max(reach, np.sqrt(np.sum((points[i] - centre) ** 2)))
    for i in range(count):
        reach = max(reach, np.sqrt(np.sum((obstacle[i] - centre) ** 2)))
    scale = SHRINK * reach
    columns = np.zeros((count + own, 5))
    for i in range(count):
        columns[i, :3] = (obstacle[i] - centre) / scale
        columns[i, 3] = 1.0
    for i in range(own):
        columns[count + i, :3] = (centre - points[i]) / scale
        columns[count + i, 4] = 1.0
    _, residual, _ = nnls(columns, np.array([0.0, 0.0, 0.0, 1.0, 1.0]), BUDGET)
    return _plane(obstacle, points, residual[:3])


@njit(cache=True)
def _plane(obstacle: Array, points: Array, residual: Array) -> tuple[bool, Array]:
    """The plane across -``residual`` (3,), half-way between the two sets, scaled to the margins of 1 and -1."""
    plane = np.zeros(4)
    length = np.sqrt(dot(residual, residual))
    if length < 1e-13:
        return False, plane
    normal = -residual / length
    near, far = np.inf, -np.inf
    for i in range(obstacle.shape[0]):
        near = min(near, dot(normal, obstacle[i]))
    for i in range(points.shape[0]):
        far = max(far, dot(normal, points[i]))
    gap = near - far
    if gap <= 1e-6:  # m
        return False, plane
    plane[:3] = 2 * normal / gap
    plane[3] = -(near + far) / gap
    return True, plane
