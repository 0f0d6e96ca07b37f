"""Non-negative least squares with few rows and many columns, the one solver behind separating planes and the back end.

Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23: at most as many columns as rows are ever active,
so each inner problem is tiny and is solved by an orthogonalisation of its own. Plain loops throughout: on vectors this
short they are faster than array expressions, and compile in a fraction of the time.
"""

from math import sqrt

import numpy as np
from numba import njit

from baselines.planner.interface import Array

TOLERANCE = 1e-11
"""Gradient, relative to the columns' and the right side's lengths, below which a column cannot help any more."""

DEPENDENT = 1e-10
"""Share of a column's length outside the span of the others below which it counts as dependent."""


@njit(cache=True)
def dot(a: Array, b: Array) -> float:
    """Inner product of two short vectors."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def _solve(columns: Array, active: Array, size: int, target: Array, basis: Array, upper: Array, z: Array) -> bool:
    """Least squares over the first ``size`` columns of ``active`` into ``z``; False if they are dependent.

    Modified Gram-Schmidt, each column orthogonalised twice; ``basis`` and ``upper`` are room to work in.
    """
    for j in range(size):
        column, axis = columns[active[j]], basis[j]
        for row in range(axis.shape[0]):
            axis[row] = column[row]
        for i in range(j):
            upper[i, j] = 0.0
        for _ in range(2):
            for i in range(j):
                share = dot(basis[i], axis)
                upper[i, j] += share
                for row in range(axis.shape[0]):
                    axis[row] -= share * basis[i, row]
        upper[j, j] = sqrt(dot(axis, axis))
        if upper[j, j] <= DEPENDENT * sqrt(dot(column, column)):
            return False
        for row in range(axis.shape[0]):
            axis[row] /= upper[j, j]
    for j in range(size - 1, -1, -1):
        value = dot(basis[j], target)
        for i in range(j + 1, size):
            value -= upper[j, i] * z[i]
        z[j] = value / upper[j, j]
    return True


@njit(cache=True)
def _step(x: Array, active: Array, size: int, z: Array) -> int:
    """Go from x towards ``z`` until the first column reaches zero; return how many stay active."""
    share = 1.0
    for i in range(size):
        if z[i] <= 0.0:
            share = min(share, x[active[i]] / (x[active[i]] - z[i]))
    kept = 0
    for i in range(size):
        j = active[i]
        x[j] += share * (z[i] - x[j])
        if z[i] <= 0.0 and x[j] <= 1e-14 * (1.0 - z[i]):
            x[j] = 0.0
        else:
            active[kept] = j
            kept += 1
    return kept


@njit(cache=True)
def nnls(columns: Array, target: Array, x: Array, residual: Array, budget: int) -> bool:
    """Minimise |target - columns^T x| over x >= 0; ``columns`` is (n, m), one column of the problem per row.

    x (n,) and the residual (m,) are written; False if ``budget`` exchanges of columns were not enough.
    """
    count, rows = columns.shape
    basis, upper, z = np.empty((rows, rows)), np.empty((rows, rows)), np.empty(rows)
    active = np.empty(rows, np.int64)  # at most m columns are ever positive
    barred = np.zeros(count, np.uint8)
    size = 0
    for j in range(count):
        x[j] = 0.0
    for row in range(rows):
        residual[row] = target[row]
    least = TOLERANCE * sqrt(dot(target, target))
    for _ in range(budget):
        best, gain = -1, 0.0
        for j in range(count):
            if barred[j] == 0 and x[j] == 0.0:
                slope = dot(columns[j], residual)
                if slope > gain and slope > least * sqrt(dot(columns[j], columns[j])):
                    best, gain = j, slope
        if best < 0 or size == rows:
            return True
        active[size] = best
        if not _solve(columns, active, size + 1, target, basis, upper, z) or z[size] <= 0.0:
            barred[best] = 1  # rounding only: it lies in the span of the active columns
            continue
        size += 1
        while True:
            kept = _step(x, active, size, z)
            if kept == size:
                break
            size = kept
            if not _solve(columns, active, size, target, basis, upper, z):
                return False
        for row in range(rows):
            residual[row] = target[row]
            for i in range(size):
                residual[row] -= x[active[i]] * columns[active[i], row]
        for j in range(count):
            barred[j] = 0
    return False
