"""R-MADER's settings for this task, and tasks to plan in."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter

from baselines.planner.interface import Task
from baselines.rmader.spec import RmaderSpec
from formctl.settings import compose


@pytest.fixture(scope="session")
def fair() -> RmaderSpec:
    """The ``fair`` parameter set."""
    settings = compose(["baseline=rmader_fair"]).tree["baseline"]
    return TypeAdapter(RmaderSpec).validate_python({key: settings[key] for key in settings if key != "target"})


@pytest.fixture
def make_task() -> Callable[..., Task]:
    """A task with the paper's triangle, or other slots, and columns at given places."""

    def make(columns: list[tuple[float, float]], **changed: object) -> Task:
        slots = np.array([[1.0, 0.0, 0.0], [-0.5, 0.866, 0.0], [-0.5, -0.866, 0.0]])
        base = Task(
            offsets=slots,
            velocity=np.array([0.0, 2.0, 0.0]),
            height=1.5,
            goal=34.0,
            columns=np.array(columns, dtype=float).reshape(-1, 2),
            column_radius=0.15,
            ball_radius=0.15,
            drone_radius=0.15,
            altitude=(0.2, 2.8),
            corridor=2.5,
            period=0.02,
        )
        return replace(base, **changed)

    return make
