"""Dodging in numbers, on flights whose speeds are written down here."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from analysis.stats import dodging


def flight(speed: np.ndarray, aside: float = 0.0, error: float = 0.1) -> Any:
    """A made-up recording at 10 Hz: three drones with these speeds (T, 3), one ball in the air from 3 to 4 s."""
    time = 0.1 * np.arange(len(speed))
    position = np.zeros((len(speed), 3, 3))
    position[..., 1] = np.cumsum(speed, 0) * 0.1
    position[..., 0] = aside * np.exp(-((position[..., 1] - 5.0) ** 2))
    trace = SimpleNamespace(
        position=position,
        velocity=np.stack((0 * speed, speed, 0 * speed), -1),
        throws=(SimpleNamespace(time=3.0, landing=4.0),),
        formation_error=np.full(len(time) - 1, error),
    )
    scene = SimpleNamespace(period=0.1, columns=np.array([[0.5, 4.5], [0.0, 5.5]]))
    return SimpleNamespace(traces=(trace,), scene=scene)


def cruise(drones: int, low: float, after: float = 2.0) -> np.ndarray:
    """2 m/s; the first ``drones`` at ``low`` while the ball is in the air, all at ``after`` behind it."""
    speed = np.full((80, 3), 2.0)
    speed[30:40, :drones] = low
    speed[40:] = after
    return speed


@pytest.mark.parametrize(
    ("speed", "told"),
    [
        (cruise(3, 1.2), True),
        (cruise(2, 1.2), False),  # the third does not slow down
        (cruise(3, 1.95), False),  # hardly slower
        (cruise(3, 1.2, after=1.5), False),  # does not resume
    ],
)
def test_all_slow_down_together_and_resume(speed: np.ndarray, told: bool) -> None:
    (dodge,) = dodging.dodges(flight(speed))
    assert dodge.before == pytest.approx(2.0)
    assert dodge.least == pytest.approx(speed[30:40].mean(1).min())
    assert dodge.resumed is told


def test_a_flight_that_ends_with_the_ball_says_nothing() -> None:
    assert dodging.dodges(flight(cruise(3, 1.2)[:45])) == []


def test_a_throw_says_nothing_while_another_ball_flies() -> None:
    two = flight(cruise(3, 1.2))
    two.traces[0].throws = (*two.traces[0].throws, SimpleNamespace(time=5.5, landing=6.5))
    assert dodging.dodges(two) == []


@pytest.mark.parametrize(("aside", "error"), [(0.3, 0.2), (0.05, 0.2), (0.3, 0.8)])
def test_among_columns_the_centroid_shifts(aside: float, error: float) -> None:
    found = dodging.passage(flight(np.full((80, 3), 2.0), aside, error))
    assert found is not None
    assert found.shift == pytest.approx(aside, rel=0.02)
    assert found.error == pytest.approx(error)
