"""The map: signed distances against the geometry, gradients, tubes of balls."""

import numpy as np
import pytest

from baselines.swarm_formation.scene import distance, first_hit, occupied, with_balls


def signed(scene, point):
    return distance(scene, *point, np.empty(3))


def test_distance_to_a_column_is_within_a_voxel(scene):
    """Its radius of 0.15 m and one inflated voxel of 0.1 m, which is square."""
    for angle in np.linspace(0, 2 * np.pi, 17):
        for away in (0.5, 0.8, 1.0):
            point = np.array([0.3 + away * np.cos(angle), 3.0 + away * np.sin(angle), 1.5])
            other = np.hypot(point[0] - 1.0, point[1] - 5.0)
            assert signed(scene, point) == pytest.approx(min(away, other) - 0.25, abs=0.11)
    assert signed(scene, (0.3, 3.0, 1.5)) < -0.1


def test_the_map_ends_at_the_sides_of_the_corridor(scene):
    """At 2.5 m less one inflated voxel."""
    for side in (-1, 1):
        assert signed(scene, (side * 2.2, 9.0, 1.5)) == pytest.approx(0.2, abs=0.06)
        assert signed(scene, (side * 2.6, 9.0, 1.5)) == pytest.approx(-0.2, abs=0.06)


def test_ground_ceiling_and_tubes(scene, ball):
    assert signed(scene, (-1.5, 9.0, 0.5)) == pytest.approx(0.2)
    assert signed(scene, (-1.5, 9.0, 2.5)) == pytest.approx(0.2)
    later = with_balls(scene, (ball,), 0.2)
    place = ball.origin + ball.velocity * 0.4 - np.array([0, 0, 9.81 / 2]) * 0.4**2
    assert signed(later, place) == pytest.approx(-0.25, abs=0.03)
    assert signed(later, place + np.array([0.6 * 0.8944, 0.6 * 0.4472, 0])) == pytest.approx(
        0.35, abs=0.03
    )  # at right angles
    assert signed(later, ball.origin) > 0.1, "what has been flown is free again"
    assert len(with_balls(scene, (ball,), ball.landing).curve) == 0


def test_gradients_are_those_of_the_interpolated_distance(scene, ball):
    later = with_balls(scene, (ball,), 0.0)
    generator = np.random.default_rng(0)
    for point in generator.uniform([-1, 1, 0.5], [2, 7, 2.5], size=(200, 3)):
        slope = np.empty(3)
        distance(later, *point, slope)
        steps = 1e-7 * np.eye(3)
        wanted = [(signed(later, point + s) - signed(later, point - s)) / 2e-7 for s in steps]
        assert slope == pytest.approx(wanted, abs=1e-5)


def test_what_holds_a_point(scene, ball):
    later = with_balls(scene, (ball,), 0.0)
    points = np.array([[-1.5, 9.0, 1.5], [0.3, 3.0, 1.0], ball.origin, [-1.5, 9.0, 0.1], [-1.5, 9.0, 2.9]])
    assert [occupied(later, *point) for point in points] == [0, 1, 2, 3, 3]
    assert first_hit(later, points) == 1 and first_hit(later, points[:1]) == 1
