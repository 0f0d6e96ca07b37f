"""How far a formation is from the wanted one: the normalised Laplacian with squared distances, and its exact gradient.

Quan et al., "Distributed swarm trajectory optimization for formation flight in dense environments", ICRA 2022:
A_ij = |p_i - p_j|^2, D = diag(sum_j A_ij), L = I - D^(-1/2) A D^(-1/2) and f = |L - L*|_F^2. Translation, rotation,
reflection and scale leave f unchanged, so it keeps the shape but not the size.
"""

import numpy as np
from numba import njit

from baselines.planner.interface import Array


@njit(cache=True)
def laplacian(points: Array) -> Array:
    """Normalised Laplacian (N, N) of ``points`` (N, 3), all of them connected."""
    count = len(points)
    weights = squared_distances(points)
    root = np.empty(count)
    for i in range(count):
        root[i] = 1 / np.sqrt(max(weights[i].sum(), 1e-12))
    result = np.empty((count, count))
    for i in range(count):
        for j in range(count):
            result[i, j] = (1.0 if i == j else 0.0) - root[i] * weights[i, j] * root[j]
    return result


@njit(cache=True)
def squared_distances(points: Array) -> Array:
    """|p_i - p_j|^2 (N, N) of ``points`` (N, 3)."""
    count = len(points)
    result = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1, count):
            for axis in range(3):
                result[i, j] += (points[i, axis] - points[j, axis]) ** 2
            result[j, i] = result[i, j]
    return result


@njit(cache=True)
def difference(points: Array, wanted: Array, gradient: Array) -> float:
    """f for ``points`` (N, 3) against the Laplacian ``wanted`` (N, N); ``gradient`` (N, 3) becomes df/dp.

    With E = L - L*, r_i = D_i^(-1/2) and s_i = 2 D_i^(-3/2) sum_k A_ik E_ik r_k, an edge (i, j) counts
    s_i + s_j - 4 r_i r_j E_ij.
    """
    count = len(points)
    weights = squared_distances(points)
    error = laplacian(points) - wanted
    root, share = np.empty(count), np.empty(count)
    for i in range(count):
        root[i] = 1 / np.sqrt(max(weights[i].sum(), 1e-12))
    for i in range(count):
        share[i] = 0.0
        for k in range(count):
            share[i] += 2 * root[i] ** 3 * weights[i, k] * error[i, k] * root[k]
    for i in range(count):
        for axis in range(3):
            gradient[i, axis] = 0.0
        for j in range(count):
            if i != j:
                edge = share[i] + share[j] - 4 * root[i] * root[j] * error[i, j]
                for axis in range(3):
                    gradient[i, axis] += 2 * edge * (points[i, axis] - points[j, axis])
    return (error * error).sum()


@njit(cache=True)
def normalise(gradient: Array) -> None:
    """Every drone's gradient (N, 3) to unit length, or to zero below 1e-7: what the published repository follows.

    It is three to fifty times too long, does not vanish at the optimum and contradicts the cost it belongs to.
    """
    for i in range(len(gradient)):
        length = np.sqrt((gradient[i] * gradient[i]).sum())
        for axis in range(3):
            gradient[i, axis] = gradient[i, axis] / length if length >= 1e-7 else 0.0
