"""Clamped cubic splines, the MINVO basis, plans and their simplices."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial import ConvexHull

from baselines.rmader import bspline, minvo
from baselines.rmader.bspline import Plan

RANDOM = np.random.default_rng(0)
UNIT = np.linspace(0, 1, 201)


def tied(controls):
    """The last three control points made one."""
    controls[4:] = controls[4]
    return controls


def outside(points, simplex):
    """Largest distance in m of ``points`` beyond a face of the hull of ``simplex``."""
    faces = ConvexHull(simplex).equations
    return float((points @ faces[:, :3].T + faces[:, 3]).max())


def test_spline_is_scipy_s_b_spline_and_begins_and_ends_as_told():
    place, speed, push = RANDOM.normal(size=(3, 3))
    controls = np.concatenate((bspline.first_controls(place, speed, push, 0.4), RANDOM.normal(size=(4, 3))))
    plan = Plan.spline(tied(controls), 0.4, 2.0)
    reference = BSpline(2.0 + 0.4 * bspline.knots(), controls, 3)
    times = np.linspace(2.0, 3.599, 50)
    state = plan.at(times)
    for part, order in zip(state, range(4), strict=True):
        np.testing.assert_allclose(part, reference.derivative(order)(times) if order else reference(times), atol=1e-9)
    first, last = plan.at(np.array([2.0])), plan.at(np.array([3.6 - 1e-12]))
    np.testing.assert_allclose(np.concatenate(first[:3]), (place, speed, push), atol=1e-12)
    np.testing.assert_allclose(np.concatenate(last[:3]), (controls[4], np.zeros(3), np.zeros(3)), atol=1e-9)


def test_derivative_controls_are_scipy_s():
    controls = RANDOM.normal(size=(7, 3))
    reference = BSpline(0.3 * bspline.knots(), controls, 3)
    np.testing.assert_allclose(bspline.velocity_controls(controls, 0.3), reference.derivative(1).c[:6], atol=1e-12)
    np.testing.assert_allclose(bspline.acceleration_controls(controls, 0.3), reference.derivative(2).c[:5], atol=1e-11)


def test_minvo_weights_are_a_partition_of_one_and_of_largest_determinant():
    weights = minvo.cubic()
    values = np.polynomial.polynomial.polyval(UNIT, weights.T)
    assert values.min() > -1e-9
    np.testing.assert_allclose(values.sum(0), 1, atol=1e-12)
    most = abs(np.linalg.det(weights))
    assert most == pytest.approx(21.2405048, abs=1e-6)
    for shift in ((1e-3, 0), (-1e-3, 0), (0, 1e-3), (0, -1e-3)):
        r0, r1 = np.add(minvo.ROOTS, shift)
        assert abs(np.linalg.det(minvo.cubic((r0, r1)))) < most
    flat = minvo.quadratic()
    values = np.polynomial.polynomial.polyval(UNIT, flat.T)
    assert values.min() > -1e-12
    np.testing.assert_allclose(values.sum(0), 1, atol=1e-12)
    assert abs(np.linalg.det(flat)) == pytest.approx(3 * np.sqrt(3) / 2)


def test_minvo_matrices_of_the_spline():
    np.testing.assert_allclose(minvo.POSITION.sum(-1), 1, atol=1e-12)
    np.testing.assert_allclose(minvo.VELOCITY.sum(-1), 1, atol=1e-12)
    assert minvo.POSITION[0, 0, 0] == pytest.approx(1.1023314, abs=1e-6)
    assert minvo.VELOCITY[1, 0, 0] == pytest.approx(0.5386751, abs=1e-7)
    bernstein, spline = 9.0, 1 / 12
    assert abs(np.linalg.det(minvo.cubic())) / bernstein == pytest.approx(2.3601, abs=1e-4)
    assert abs(np.linalg.det(minvo.cubic())) / spline == pytest.approx(254.886, abs=1e-3)


def test_simplices_enclose_position_and_velocity():
    controls = RANDOM.normal(size=(7, 3))  # not tied at the end: those simplices are flat
    plan = Plan.spline(controls, 0.5, 0.0)
    speeds = bspline.velocity_controls(controls, 0.5)
    for i in range(4):
        state = plan.at(0.5 * i + 0.4999 * UNIT)
        assert outside(state.position, minvo.POSITION[i] @ controls[i : i + 4]) < 1e-9
        corners = minvo.VELOCITY[i] @ speeds[i : i + 3]
        assert (state.velocity <= corners.max(0) + 1e-9).all() and (state.velocity >= corners.min(0) - 1e-9).all()


def test_vertices_of_any_part_enclose_it():
    plan = Plan.spline(RANDOM.normal(size=(7, 3)), 0.5, 1.0)
    for start, end in ((0.0, 1.2), (1.1, 1.3), (1.3, 2.7), (2.9, 9.0), (0.0, np.inf)):
        points = minvo.vertices(plan, start, end)
        samples = plan.at(np.linspace(start, min(end, 10.0), 300)).position
        assert outside(samples, points) < 1e-9
    np.testing.assert_allclose(minvo.vertices(plan, 5.0, 6.0), [plan.goal])


def test_splicing_keeps_the_past_and_takes_the_new():
    old = Plan.spline(tied(RANDOM.normal(size=(7, 3))), 0.5, 0.0)
    state = old.at(np.array([0.8]))
    start = bspline.first_controls(state.position[0], state.velocity[0], state.acceleration[0], 0.25)
    new = Plan.spline(tied(np.concatenate((start, RANDOM.normal(size=(4, 3))))), 0.25, 0.8)
    whole = old.spliced(new, now=0.6)
    assert (whole.start, whole.end) == (0.5, 1.8)
    for part, ours, theirs in zip(
        whole.at(np.array([0.6, 0.79])), old.at(np.array([0.6, 0.79])), range(4), strict=True
    ):
        np.testing.assert_allclose(part, ours, err_msg=str(theirs))
    np.testing.assert_allclose(whole.at(np.array([1.0, 3.0])).position, new.at(np.array([1.0, 3.0])).position)
    before, after = (np.concatenate(whole.at(np.array([0.8 + shift]))[:3]) for shift in (-1e-7, 1e-7))
    np.testing.assert_allclose(before, after, atol=1e-5)


def test_splicing_after_the_end_rests_in_between():
    old = Plan.resting(np.array([1.0, 2.0, 3.0]), 0.0)
    controls = np.concatenate((np.tile([1.0, 2.0, 3.0], (3, 1)), np.tile([2.0, 2.0, 3.0], (4, 1))))
    whole = old.spliced(Plan.spline(controls, 0.5, 1.0), now=0.4)
    np.testing.assert_allclose(whole.at(np.array([0.7, 5.0])).position, [[1, 2, 3], [2, 2, 3]])
    assert whole.start == 0.4
