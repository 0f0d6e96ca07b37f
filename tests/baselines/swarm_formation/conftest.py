"""A scene with columns and a ball, and a fleet in it."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.planner.interface import Parabola, Task, View
from baselines.swarm_formation.fleet import SwarmFormationFleet
from baselines.swarm_formation.scene import survey
from formctl.settings import compose

OFFSETS = np.array([[1.0, 0, 0], [-0.5, 3**0.5 / 2, 0], [-0.5, -(3**0.5) / 2, 0]])
START = OFFSETS + np.array([0, 0, 1.5])


@pytest.fixture
def task():
    """The paper's task without obstacles, as far as 12 m."""
    return Task(
        offsets=OFFSETS,
        velocity=np.array([0.0, 2.0, 0.0]),
        height=1.5,
        goal=12.0,
        columns=np.zeros((0, 2)),
        column_radius=0.15,
        ball_radius=0.15,
        drone_radius=0.15,
        altitude=(0.2, 2.8),
        corridor=2.5,
        period=0.02,
    )


@pytest.fixture
def scene(task):
    """Two columns near the way of the formation."""
    return survey(
        replace(task, columns=np.array([[0.3, 3.0], [1.0, 5.0]])), START, START + np.array([0, 16.0, 0]), 0.1, 1
    )


@pytest.fixture
def ball():
    """A ball across the way of the formation."""
    return Parabola(0, 0.0, np.array([0.0, 4.0, 2.0]), np.array([1.0, -2.0, 1.0]), 0.7)


@pytest.fixture
def spec():
    """Swarm-Formation's fair settings."""
    from baselines.registry import _spec
    from baselines.swarm_formation.agent import SwarmFormation

    settings = compose(["baseline=swarm_formation_fair"]).baseline
    assert settings is not None
    return _spec("swarm_formation", SwarmFormation, settings)


@pytest.fixture
def fly(spec):
    """Runs a fleet whose drones are exactly where its trajectories are."""

    def run(task, seconds, balls=(), spec=spec, start=START):
        def see(time, places, speeds):
            return View(time, places, speeds, tuple(b for b in balls if b.time <= time < b.landing))

        view = see(0.0, start.copy(), np.zeros_like(start))
        fleet = SwarmFormationFleet(spec, task, view, np.random.default_rng(0))
        places = [view.position]
        for step in range(round(seconds / task.period)):
            paths = fleet.step(view)
            later = (step + 1) * task.period
            motion = [path.at(np.array([later])) for path in paths]
            view = see(later, *(np.stack([getattr(m, part)[0] for m in motion]) for part in ("position", "velocity")))
            places.append(view.position)
        return fleet, np.array(places)

    return run
