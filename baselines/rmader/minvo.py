"""The MINVO basis: the least simplex that encloses a polynomial piece (Tordesillas and How, arXiv 2010.10726).

Tighter hulls than those of B-spline or Bernstein control points leave more room between drones and obstacles.
"""

import numpy as np
from numba import njit

from baselines.planner.interface import Array
from baselines.rmader import bspline

ROOTS = (0.5154412908, 0.8867743193)
"""Double roots of the first two cubic MINVO polynomials: where the volume is least."""


def cubic(roots: tuple[float, float] = ROOTS) -> Array:
    """(4, 4) coefficients of 1, u, u^2, u^3 of the four cubic basis polynomials, which are >= 0 and sum to 1."""
    r0, r1 = roots
    first = np.polynomial.Polynomial.fromroots([1, r0, r0]) * -1
    second = np.polynomial.Polynomial.fromroots([0, r1, r1])
    mirror = np.polynomial.Polynomial([1, -1])
    pairs = [first + first(mirror), second + second(mirror)]
    weights = np.linalg.solve([[pair(u) for pair in pairs] for u in (0.0, 0.5)], [1.0, 1.0])
    ordered = (weights[0] * first, weights[1] * second, weights[1] * second(mirror), weights[0] * first(mirror))
    return np.stack([polynomial.coef for polynomial in ordered])


def quadratic() -> Array:
    """(3, 3) coefficients of 1, u, u^2 of the three quadratic basis polynomials."""
    root = 0.5 + np.sqrt(3) / 6
    first = 1.5 * np.polynomial.Polynomial.fromroots([root, root])
    mirror = np.polynomial.Polynomial([1, -1])
    return np.stack((first.coef, [0.0, 3.0, -3.0], first(mirror).coef))


CUBIC = np.linalg.inv(cubic().T)
"""(4, 4): vertices of the enclosing simplex = CUBIC @ coefficients of 1, u, u^2, u^3."""

POSITION = CUBIC @ bspline.BASIS
"""(4, 4, 4): vertices on interval i = POSITION[i] @ its four control points."""

VELOCITY = np.linalg.inv(quadratic().T) @ bspline.basis(bspline.DEGREE - 1)
"""(4, 3, 3): vertices of the velocity on interval i = VELOCITY[i] @ its three velocity control points."""


def vertices(plan: bspline.Plan, start: float, end: float) -> Array:
    """Vertices (V, 3) in m of simplices that enclose ``plan`` between ``start`` and ``end``, ends at rest included."""
    part = slice(int(np.searchsorted(plan.times[1:], start, "right")), int(np.searchsorted(plan.times[:-1], end)))
    found = []
    if start < plan.start:
        found.append(plan.pieces[0, :1])
    if part.start < part.stop:
        began, ended = plan.times[:-1][part], plan.times[1:][part]
        low, high = np.maximum(start, began) - began, np.minimum(end, ended) - began
        found.append((CUBIC @ rescaled(plan.pieces[part], low, high)).reshape(-1, 3))
    if end > plan.end or not found:
        found.append(plan.goal[None])
    return np.concatenate(found)


@njit(cache=True)
def rescaled(pieces: Array, low: Array, high: Array) -> Array:
    """Coefficients (K, 4, 3) in u from 0 to 1 of ``pieces`` (K, 4, 3) between s = ``low`` and ``high`` (K,)."""
    answer = np.empty_like(pieces)
    for k in range(len(pieces)):
        s, span = low[k], high[k] - low[k]
        for axis in range(3):
            c0, c1, c2, c3 = pieces[k, 0, axis], pieces[k, 1, axis], pieces[k, 2, axis], pieces[k, 3, axis]
            answer[k, 0, axis] = c0 + s * (c1 + s * (c2 + s * c3))
            answer[k, 1, axis] = span * (c1 + s * (2 * c2 + 3 * s * c3))
            answer[k, 2, axis] = span**2 * (c2 + 3 * s * c3)
            answer[k, 3, axis] = span**3 * c3
    return answer
