"""Halts and torn formations, told from flights that were made to have them."""

import numpy as np
import pytest

from analysis.recordings import Halt, Recording, Scene, Tear, Throw, Trace, modes

PERIOD, SPEED = 0.02, 2.0
SLOTS = np.array([[1.0, 0.0, 0.0], [-0.5, 0.866, 0.0], [-0.5, -0.866, 0.0]])


def scene(columns=()) -> Scene:
    places = np.array(columns, dtype=float).reshape(-1, 2)
    return Scene(
        "mixed", 4, "0" * 64, places, SLOTS, np.array([0, SPEED, 0]), 16.0, 12.0, (0.2, 2.8), 0.15, 0.15, 0.15, PERIOD
    )


def flight(position, throws=(), ball=None) -> Trace:
    samples, drones = position.shape[:2]
    ball = np.full((samples, 0, 3), np.nan) if ball is None else ball
    sides = np.stack([np.linalg.norm(position[:, i] - position[:, i - 1], axis=-1) for i in range(3)], -1)
    error = sides - np.sqrt(3.0)
    formation = np.sqrt(3 * (error**2).sum(-1) + error.sum(-1) ** 2)  # for three drones
    return Trace(
        method="planner",
        facts={},
        row={},
        position=position,
        attitude=np.tile([1.0, 0, 0, 0], (samples, drones, 1)),
        velocity=np.gradient(position, PERIOD, axis=0),
        throttle=np.zeros((samples, drones, 4)),
        ball=ball,
        command=np.zeros((samples - 1, drones, 4)),
        reward=np.zeros((samples - 1, drones, 4)),
        gap=np.full((samples - 1, drones, 3), np.inf),
        formation_error=formation[1:],
        throws=throws,
        events=(),
    )


def straight(seconds=10.0) -> np.ndarray:
    """The formation at v*, (T, 3, 3)."""
    times = np.arange(round(seconds / PERIOD) + 1) * PERIOD
    return np.array([0.0, 0.0, 1.5]) + SLOTS + times[:, None, None] * np.array([0.0, SPEED, 0.0])


def stopped(step=100, drone=1) -> np.ndarray:
    """The same, but one drone stands still from ``step`` on, 4 m down the course."""
    position = straight()
    position[step:, drone] = position[step, drone]
    return position


def told(trace, columns=()) -> list:
    return modes(Recording(scene(columns), (trace,), {}), trace)


def test_a_flight_in_formation_has_no_failures() -> None:
    assert told(flight(straight())) == []


def test_a_drone_that_stands_before_a_column_halts_and_tears_the_formation() -> None:
    halt, tear = told(flight(stopped()), columns=[(-0.4, 6.0), (0.5, 12.0)])
    assert isinstance(halt, Halt) and isinstance(tear, Tear)
    assert (halt.drone, halt.before) == (1, "column") and halt.time == pytest.approx(2.0, abs=0.05)
    assert halt.gap == pytest.approx(np.hypot(0.1, 6.0 - 4.866), abs=1e-6)
    assert tear.drone == 1 and tear.behind > 3 and tear.aside < 0.1 and tear.time > halt.time


def test_a_ball_in_the_air_is_what_a_drone_stops_for() -> None:
    position = stopped()
    ball = np.full((len(position), 1, 3), np.nan)
    ball[80:130] = position[100, 1] + [1.2, 0, 0]
    throw = Throw(0, 80 * PERIOD, 130 * PERIOD, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    halt = told(flight(position, (throw,), ball), columns=[(-0.4, 6.0)])[0]
    assert (halt.before, halt.gap) == ("ball", pytest.approx(1.2))
    landed = Throw(0, 20 * PERIOD, 40 * PERIOD, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert told(flight(position, (landed,), ball))[0].before == "nothing"


def test_a_drone_that_swerves_is_aside_and_halts_nowhere() -> None:
    position = straight()
    position[100:200, 2, 0] -= 1.0
    (tear,) = told(flight(position))
    assert isinstance(tear, Tear) and tear.drone == 2 and tear.seconds == pytest.approx(2.0, abs=0.05)
    assert tear.aside == pytest.approx(1.0) and abs(tear.behind) < 1e-9


def test_short_stops_and_what_comes_after_the_goal_count_nothing() -> None:
    position = straight()
    position[100:140] = position[100]  # 0.8 s
    assert told(flight(position)) == []
    ended = straight(14.0)
    ended[500:] = ended[500]  # all of them past the line
    ended[600:, 0, 0] += 3.0
    assert told(flight(ended)) == []
