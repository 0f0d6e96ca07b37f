"""MINCO: continuity, the banded solver against a dense one, closed forms, gradients."""

import numpy as np
import pytest

from baselines.swarm_formation import minco

PIECES = 5


@pytest.fixture
def curve():
    """Random end states, waypoints and durations."""
    generator = np.random.default_rng(1)
    head, tail = generator.normal(size=(2, 3, 3))
    return head, tail, generator.normal(size=(PIECES - 1, 3)), generator.uniform(0.4, 1.5, PIECES)


def dense(rows):
    size = len(rows)
    matrix = np.zeros((size, size))
    for row in range(size):
        for k in range(13):
            if 0 <= row + k - 6 < size:
                matrix[row, row + k - 6] = rows[row, k]
    return matrix


def jerk_energy(head, tail, waypoints, durations):
    coefficients = minco.connect(head, tail, waypoints, durations)
    return minco.energy(coefficients, durations, np.zeros_like(coefficients), np.zeros_like(durations))


def test_ends_waypoints_and_joints_up_to_the_fourth_derivative(curve):
    head, tail, waypoints, durations = curve
    coefficients = minco.connect(*curve)
    value = np.array(
        [
            [
                [[minco.derivative(coefficients, i, a, order, t) for a in range(3)] for order in range(6)]
                for t in (0.0, d)
            ]
            for i, d in enumerate(durations)
        ]
    )  # (P, 2, 6, 3): at the start and the end of each piece
    scale = np.abs(value).max((0, 1, 3))[:, None]
    assert np.abs(value[0, 0, :3] - head).max() < 1e-12
    assert np.abs(value[-1, 1, :3] - tail).max() < 1e-10
    assert np.abs(value[:-1, 1, 0] - waypoints).max() < 1e-12
    jumps = np.abs(value[1:, 0] - value[:-1, 1]) / scale
    assert jumps[:, :5].max() < 1e-12
    assert jumps[:, 5].max() > 1e-3  # only the fifth derivative jumps


def test_banded_solutions_are_the_dense_ones(curve):
    rows = minco.system(curve[-1])
    matrix, factors = dense(rows), rows.copy()
    minco.factor(factors)
    right = np.random.default_rng(2).normal(size=(6 * PIECES, 3))
    straight, transposed = right.copy(), right.copy()
    minco.solve(factors, straight)
    minco.solve_transposed(factors, transposed)
    assert np.allclose(straight, np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-9)
    assert np.allclose(transposed, np.linalg.solve(matrix.T, right), rtol=1e-9, atol=1e-9)


def test_rest_to_rest_closed_form_and_a_split_that_changes_nothing():
    """720 L^2 / T^5, peak 1.875 L / T at half time."""
    length, time = 3.0, 2.0
    head, tail = np.zeros((2, 3, 3))
    tail[0, 1] = length
    whole = jerk_energy(head, tail, np.zeros((0, 3)), np.array([time]))
    halves = jerk_energy(head, tail, np.array([[0, length / 2, 0]]), np.array([time / 2, time / 2]))
    assert whole == pytest.approx(720 * length**2 / time**5) == halves
    path = minco.Polynomial(5.0, np.array([time]), minco.connect(head, tail, np.zeros((0, 3)), np.array([time])))
    assert path.at(np.array([5.0 + time / 2])).velocity[0, 1] == pytest.approx(1.875 * length / time)


def test_gradients_in_waypoints_and_times(curve):
    head, tail, waypoints, durations = curve
    rows = minco.system(durations)
    minco.factor(rows)
    coefficients = minco.connect(*curve)
    by_coefficients, by_durations = np.zeros_like(coefficients), np.zeros(PIECES)
    minco.energy(coefficients, durations, by_coefficients, by_durations)
    minco.propagate(rows, coefficients, durations, by_coefficients, by_durations)
    step = 1e-5
    for i in range(PIECES):
        nudge = step * np.eye(PIECES)[i]
        ends = [jerk_energy(head, tail, waypoints, durations + sign * nudge) for sign in (1, -1)]
        assert by_durations[i] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-6)
    for i in range(PIECES - 1):
        for axis in range(3):
            nudge = np.zeros_like(waypoints)
            nudge[i, axis] = step
            ends = [jerk_energy(head, tail, waypoints + sign * nudge, durations) for sign in (1, -1)]
            assert by_coefficients[6 * i + 5, axis] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-6)


def test_free_times_map_to_positive_durations_and_back():
    free = np.linspace(-8, 8, 33)
    durations = np.array([minco.stretch(x) for x in free])
    assert (durations > 0).all() and (np.diff(durations) > 0).all() and minco.stretch(0.0) == 1
    assert np.allclose(minco.unstretch(durations), free, atol=1e-12)
    slopes = [(minco.stretch(x + 1e-6) - minco.stretch(x - 1e-6)) / 2e-6 for x in free]
    assert np.allclose([minco.stretch_slope(x) for x in free], slopes, rtol=1e-6)


def test_a_trajectory_stands_still_before_and_after_itself(curve):
    path = minco.Polynomial(1.0, curve[-1], minco.connect(*curve))
    motion = path.at(np.array([0.0, 1.0, path.end, path.end + 3]))
    assert np.allclose(motion.position[0], curve[0][0]) and np.allclose(motion.position[3], curve[1][0])
    assert not motion.velocity[[0, 3]].any() and np.allclose(motion.velocity[[1, 2]], [curve[0][1], curve[1][1]])
    knots = 1.0 + np.cumsum(curve[-1])[:-1]
    assert np.allclose(path.at(knots).position, curve[2])
    still = minco.still(2.0, np.array([1.0, 2.0, 3.0]), 1.0)
    assert still.end == 4 and np.array_equal(still.at(np.array([3.5])).position, [[1.0, 2.0, 3.0]])
