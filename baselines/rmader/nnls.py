"""Non-negative least squares with few rows and many columns, the one solver behind separating planes and the back end.

Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23: at most as many columns as rows are ever active, so
each inner problem is tiny and is solved by an orthogonalisation of its own.
"""

import numpy as np
from numba import njit

from baselines.planner.interface import Array

TOLERANCE = 1e-11
"""Gradient, relative to the columns' and the right side's lengths, below which a column cannot help any more."""

DEPENDENT = 1e-10
"""Share of a column's length outside the span of the others below which it counts as dependent."""


@njit(cache=True)
def dot(a: Array, b: Array) -> float:
    """Inner product of two short vectors: a plain loop, which a call of BLAS would cost several times over."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def least_squares(columns: Array, target: Array, solution: Array) -> bool:
    """Solve min |columns^T z - target| for k columns given as rows (k, m); False if they are dependent.

    Modified Gram-Schmidt, each column orthogonalised twice; the answer goes to ``solution`` (k,).
    """
    count, rows = columns.shape
    basis = columns.copy()
    upper = np.zeros((count, count))
    for j in range(count):
        length = np.sqrt(dot(basis[j], basis[j]))
        for _ in range(2):
            for i in range(j):
                share = dot(basis[i], basis[j])
                upper[i, j] += share
                for row in range(rows):
                    basis[j, row] -= share * basis[i, row]
        upper[j, j] = np.sqrt(dot(basis[j], basis[j]))
        if upper[j, j] <= DEPENDENT * length:
            return False
        basis[j] /= upper[j, j]
    for j in range(count - 1, -1, -1):
        value = dot(basis[j], target)
        for i in range(j + 1, count):
            value -= upper[j, i] * solution[i]
        solution[j] = value / upper[j, j]
    return True


@njit(cache=True)
def nnls(columns: Array, target: Array, budget: int) -> tuple[Array, Array, bool]:
    """Minimise |columns^T x - target| over x >= 0; ``columns`` is (n, m), one column of the problem per row.

    Returns x (n,), the residual target - columns^T x (m,), and False if ``budget`` exchanges were not enough.
    """
    count, rows = columns.shape
    x = np.zeros(count)
    active = np.empty(rows, np.int64)  # at most m columns are ever positive
    size = 0
    barred = np.zeros(count, np.bool_)
    residual = target.copy()
    lengths = np.empty(count)
    scale = np.sqrt(dot(target, target))
    for j in range(count):
        lengths[j] = np.sqrt(dot(columns[j], columns[j]))
    solution = np.empty(rows)
    for _ in range(budget):
        best, gain = -1, TOLERANCE * scale
        for j in range(count):
            if barred[j] or x[j] > 0.0 or lengths[j] == 0.0:
                continue
            slope = dot(columns[j], residual) / lengths[j]
            if slope > gain:
                best, gain = j, slope
        if best < 0 or size == rows:
            return x, residual, True
        active[size] = best
        size += 1
        if not least_squares(columns[active[:size]], target, solution) or solution[size - 1] <= 0.0:
            size -= 1
            barred[best] = True  # rounding only: it lies in the span of the active columns
            continue
        size = _retreat(columns, target, x, active, size, solution)
        residual[:] = target
        for i in range(size):
            for row in range(rows):
                residual[row] -= x[active[i]] * columns[active[i], row]
        barred[:] = False
    return x, residual, False


@njit(cache=True)
def _retreat(columns: Array, target: Array, x: Array, active: Array, size: int, solution: Array) -> int:
    """Step from x towards the unconstrained ``solution``, dropping columns that reach zero, until all are positive."""
    while True:
        step = 1.0
        for i in range(size):
            if solution[i] <= 0.0:
                step = min(step, x[active[i]] / (x[active[i]] - solution[i]))
        kept = 0
        for i in range(size):
            j = active[i]
            value = solution[i] if step == 1.0 else x[j] + step * (solution[i] - x[j])
            if solution[i] <= 0.0 and value <= 1e-14 * (1.0 + abs(solution[i])):
                x[j] = 0.0
            else:
                x[j] = value
                active[kept] = j
                kept += 1
        if kept == size and step == 1.0:
            return size
        size = kept
        if size == 0 or not least_squares(columns[active[:size]], target, solution):
            return size
