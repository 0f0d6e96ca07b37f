"""The formation similarity: known values, invariances, and its gradient."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.swarm_formation.similarity import difference, laplacian, normalise

TRIANGLE = np.array([[1.0, 0, 0], [-0.5, 3**0.5 / 2, 0], [-0.5, -(3**0.5) / 2, 0]])
ANGLES = np.arange(6) * np.pi / 3
HEXAGON = np.concatenate((np.zeros((1, 3)), 2 * np.stack((np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES), -1)))


def away(points, wanted):
    return difference(points, laplacian(wanted), np.empty_like(points))


def test_known_laplacians():
    assert np.allclose(laplacian(TRIANGLE), 1.5 * np.eye(3) - 0.5)
    found = laplacian(HEXAGON)
    assert found[0, 1] == pytest.approx(-4 / np.sqrt(24 * 52))
    assert [found[1, k] for k in (2, 3, 4)] == pytest.approx([-4 / 52, -12 / 52, -16 / 52])


def test_known_differences():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert away(line, TRIANGLE) == pytest.approx(0.315089, abs=1e-6)
    centre, ring = 4 / np.sqrt(24 * 52), np.array([4, 4, 12, 12, 16]) / 52
    swapped = HEXAGON[[1, 0, 2, 3, 4, 5, 6]]  # a relabelled formation is another one
    assert away(swapped, HEXAGON) == pytest.approx(4 * ((centre - ring) ** 2).sum())
    assert away(TRIANGLE * [1, -1, 1], TRIANGLE) < 1e-30


@pytest.mark.parametrize("scale", [0.3, 5.0])
def test_motion_and_scale_change_nothing(scale):
    turned = scale * Rotation.random(random_state=1).apply(HEXAGON) + [3.0, -2.0, 1.0]
    assert np.abs(laplacian(turned) - laplacian(HEXAGON)).max() < 1e-14


@pytest.mark.parametrize("wanted", [TRIANGLE, HEXAGON], ids=["triangle", "hexagon"])
def test_the_gradient_is_exact_and_moves_neither_place_nor_size_nor_attitude(wanted):
    points = wanted + np.random.default_rng(3).normal(scale=0.3, size=wanted.shape)
    gradient = np.empty_like(points)
    difference(points, laplacian(wanted), gradient)
    step = 1e-5
    for index in np.ndindex(points.shape):
        nudge = np.zeros_like(points)
        nudge[index] = step
        slope = (away(points + nudge, wanted) - away(points - nudge, wanted)) / (2 * step)
        assert gradient[index] == pytest.approx(slope, abs=1e-8)
    assert np.abs(gradient.sum(0)).max() < 1e-12
    assert abs((points * gradient).sum()) < 1e-12
    assert np.abs(np.cross(points, gradient).sum(0)).max() < 1e-12


def test_the_unit_gradient_forgets_how_far_it_is():
    lengths = []
    for moved in (0.05, 0.25, 0.5):
        gradient = np.empty_like(TRIANGLE)
        difference(TRIANGLE + np.array([[moved, 0, 0], [0, 0, 0], [0, 0, 0]]), laplacian(TRIANGLE), gradient)
        lengths.append(np.linalg.norm(gradient[0]))
        normalise(gradient)
        assert np.allclose(np.linalg.norm(gradient, axis=-1), 1)
    assert lengths == sorted(lengths) and lengths[-1] < 0.5
    nothing = np.full((3, 3), 1e-9)
    normalise(nothing)
    assert not nothing.any()
