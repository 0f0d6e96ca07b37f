"""Laplacian distances: closed forms and invariances."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from envs import rotation, shapes
from tests.envs.conftest import make_world

TRIANGLE = shapes.slots(make_world("scenario=free").scenario, torch.float64)
numbers = st.floats(-2, 2, allow_nan=False)


def fm(position, target=TRIANGLE):
    return shapes.laplacian_distances(position, shapes.laplacian(target))[0].item()


def test_triangle_is_the_releases():
    expected = [[1, 0, 0], [-0.5, math.sqrt(0.75), 0], [-0.5, -math.sqrt(0.75), 0]]
    torch.testing.assert_close(TRIANGLE, torch.tensor(expected, dtype=torch.float64))


@pytest.mark.parametrize("error", [0.05, -0.2, 0.5])
def test_uniform_side_error_costs_sqrt_18_times_the_error(error):
    side = math.sqrt(3)
    assert fm(TRIANGLE * (side + error) / side) == pytest.approx(math.sqrt(18) * abs(error), rel=1e-9)


@pytest.mark.parametrize(
    ("drone", "offset", "expected"),
    [(0, (0.2, 0, 0), 0.556), (0, (0, 0.2, 0), 0.245), (0, (0, 0, 0.2), 0.036), (1, (0, -1.0, 0), 2.158)],
)
def test_one_displaced_drone_costs_what_the_fact_sheets_say(drone, offset, expected):
    moved = TRIANGLE.clone()
    moved[drone] += torch.tensor(offset, dtype=torch.float64)
    assert fm(moved) == pytest.approx(expected, abs=2e-3)


@settings(max_examples=30, deadline=None)
@given(st.tuples(numbers, numbers, numbers), st.tuples(numbers, numbers, numbers), st.permutations(range(4)))
def test_fm_ignores_rotation_translation_and_relabelling(angles, shift, order):
    generator = torch.Generator().manual_seed(3)
    target = torch.randn(4, 3, dtype=torch.float64, generator=generator)
    flown = target + 0.3 * torch.randn(4, 3, dtype=torch.float64, generator=generator)
    quaternion = rotation.from_roll_pitch_yaw(torch.tensor(angles, dtype=torch.float64))
    axes = torch.stack([f(quaternion) for f in (rotation.heading_axis, rotation.left_axis, rotation.up_axis)])
    moved = (flown @ axes + torch.tensor(shift, dtype=torch.float64))[list(order)]
    assert fm(moved, target[list(order)]) == pytest.approx(fm(flown, target), rel=1e-9)


def test_normalised_distance_ignores_size():
    graph = shapes.laplacian(TRIANGLE)
    assert shapes.laplacian_distances(3.7 * TRIANGLE, graph)[1].item() == pytest.approx(0, abs=2e-6)


def test_unnormalised_distance_of_four_drones_uses_the_true_degree_matrix():
    square = shapes.slots(make_world("scenario=free", "scenario.formation=square").scenario, torch.float64)
    moved = square.clone()
    moved[0, 0] += 0.3

    def matrix(points):
        gaps = torch.cdist(points, points)
        return torch.diag(gaps.sum(-1)) - gaps

    assert fm(moved, square) == pytest.approx(torch.linalg.norm(matrix(moved) - matrix(square)).item(), rel=1e-9)


def test_unknown_shape_names_the_choices():
    with pytest.raises(ValueError, match="triangle, square, pentagon, hexagon, real"):
        shapes.slots(make_world("scenario=free", "scenario.formation=heptagon").scenario)
