"""Planes between hulls and the solver behind them, against scipy's linear programme and least squares."""

from itertools import product

import numpy as np
import pytest
import scipy.optimize

from baselines.rmader.nnls import nnls
from baselines.rmader.separator import apart, separate

CUBE = np.array(list(product((0.0, 1.0), repeat=3)))


def feasible(obstacle, points):
    """R-MADER's linear programme."""
    rows = np.block([[-obstacle, -np.ones((len(obstacle), 1))], [points, np.ones((len(points), 1))]])
    answer = scipy.optimize.linprog(np.zeros(4), A_ub=rows, b_ub=-np.ones(len(rows)), bounds=(None, None))
    return answer.status == 0


def test_separator_agrees_with_the_linear_programme():
    random, counts = np.random.default_rng(1), {True: 0, False: 0}
    for _ in range(120):
        obstacle = random.normal(size=(random.integers(8, 60), 3))
        points = random.normal(size=(4, 3)) + random.normal(size=3) * random.uniform(0, 3)
        plane = np.zeros(4)
        found = separate(obstacle, points, plane)
        assert found == feasible(obstacle, points)
        counts[found] += 1
        if found:
            assert (obstacle @ plane[:3] + plane[3]).min() >= 1 - 1e-9
            assert (points @ plane[:3] + plane[3]).max() <= -1 + 1e-9
        else:
            assert not apart(obstacle, points)
    assert min(counts.values()) > 20


@pytest.mark.parametrize("gap", [1e-4, 0.3, 2.0, 30.0])
def test_margin_between_cubes_is_their_gap(gap):
    plane = np.zeros(4)
    assert separate(CUBE, CUBE + np.array([1 + gap, 0.4, -0.3]), plane)
    assert 2 / np.linalg.norm(plane[:3]) == pytest.approx(gap, rel=1e-6)


@pytest.mark.parametrize("shift", [[0.999, 0.2, 0.1], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
def test_cubes_that_meet_have_no_plane(shift):
    assert not separate(CUBE, CUBE + shift, np.zeros(4))


@pytest.mark.parametrize("rows", [5, 7])
def test_least_squares_are_scipy_s(rows):
    random = np.random.default_rng(2)
    for _ in range(40):
        matrix, target = random.normal(size=(rows, 150)), random.normal(size=rows)
        matrix[0] = np.abs(matrix[0])
        target[0] = -1.0  # out of reach: a residual is left
        x, residual = np.empty(150), np.empty(rows)
        assert nnls(np.ascontiguousarray(matrix.T), target, x, residual, 300)
        assert x.min() >= 0
        np.testing.assert_allclose(residual, target - matrix @ x, atol=1e-12)
        assert np.linalg.norm(residual) == pytest.approx(scipy.optimize.nnls(matrix, target)[1], abs=1e-10)
