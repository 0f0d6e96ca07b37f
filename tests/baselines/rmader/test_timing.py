"""The least time of a double integrator and the longest interval."""

import numpy as np
import pytest

from baselines.rmader.bspline import first_controls, velocity_controls
from baselines.rmader.timing import least_time, longest_interval


@pytest.mark.parametrize(
    ("distance", "speed", "seconds"),
    [
        (4.0, 0.0, 2.5),  # L / v + v / a
        (0.5, 0.0, 0.5**0.5),  # 2 sqrt(L / a)
        (0.5, 2.0, 0.5),  # it only has to brake: v / a
        (0.0, 2.0, 0.5 + 2 * (0.5 / 4) ** 0.5),  # past the goal, then back from rest
        (-4.0, 0.0, 2.5),
        (4.0, 2.0, 2.25),  # at full speed: D / v + v / (2 a)
    ],
)
def test_closed_forms(distance, speed, seconds):
    assert least_time(np.array(distance), np.array(speed), 2.0, 4.0) == pytest.approx(seconds)


def test_left_is_right_mirrored():
    random = np.random.default_rng(0)
    distance, speed = random.uniform(-6, 6, 50), random.uniform(-2, 2, 50)
    np.testing.assert_allclose(least_time(distance, speed, 2, 4), least_time(-distance, -speed, 2, 4))


def test_longest_interval_brings_the_velocity_control_to_the_limit():
    speed, push = np.array([1.0, -1.5, 0.0]), np.array([2.0, -2.0, 0.0])
    interval = longest_interval(speed, push, 2.0)
    controls = np.concatenate((first_controls(np.zeros(3), speed, push, interval), np.zeros((4, 3))))
    assert np.abs(velocity_controls(controls, interval)[1]).max() == pytest.approx(2.0)
    assert longest_interval(np.array([2.1, 0, 0]), np.zeros(3), 2.0) == 0.0
