"""Columns, balls and other drones as the vertices of their hulls in every interval of a spline."""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.planner.interface import Array, Parabola, Task
from baselines.planner.sight import position
from baselines.rmader import minvo
from baselines.rmader.bspline import INTERVALS, Plan
from baselines.rmader.spec import SizeSpec

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


class Solid(Protocol):
    """Something to keep away from, made larger by the drone's own size already."""

    lasting: bool  # whether it also counts after the spline's end, where the drone rests

    def vertices(self, start: float, end: float) -> Array:
        """Points (V, 3) in m whose hull holds it between two times in s."""
        ...


@dataclass(frozen=True)
class Box:
    """A column: it stands still."""

    corners: Array  # (8, 3) m
    lasting: bool = False

    def vertices(self, start: float, end: float) -> Array:
        return self.corners


@dataclass(frozen=True)
class Flying:
    """A ball: boxes along its parabola; it stays where it lands."""

    ball: Parabola
    half: float  # m
    sampling: float  # s
    lasting: bool = False

    def vertices(self, start: float, end: float) -> Array:
        times = np.append(np.arange(start, end, self.sampling), end)
        return boxes(position(self.ball, times), np.full(3, self.half))


@dataclass(frozen=True)
class Other:
    """Another drone on its plan."""

    plan: Plan
    half: float  # m
    all_vertices: bool  # False: only the last vertex of each piece becomes a box, as in R-MADER's code
    lasting: bool = True

    def vertices(self, start: float, end: float) -> Array:
        points = minvo.vertices(self.plan, start, end)
        half = np.full(3, self.half)
        if self.all_vertices:
            return boxes(points, half)
        return np.concatenate((points, boxes(points[3::4], half), boxes(points[-1:], half)))


def boxes(centres: Array, half: Array) -> Array:
    """Corners (8 K, 3) of boxes of half-size ``half`` about ``centres`` (K, 3)."""
    return (centres[:, None] + half * CORNERS).reshape(-1, 3)


def columns(task: Task, size: SizeSpec) -> list[Solid]:
    """The task's columns as boxes from below the ground to above the ceiling."""
    half = task.column_radius + size.drone / 2 + size.tracking + size.prediction
    low, high = task.altitude
    reach = np.array([half, half, (high - low) / 2 + 1])
    return [Box(boxes(np.array([[x, y, (low + high) / 2]]), reach)) for x, y in task.columns]


def ball(parabola: Parabola, task: Task, size: SizeSpec, check: bool = False) -> Solid:
    """A ball in flight, as a plan has to avoid it; with ``check`` as a finished plan is held against it."""
    half = task.ball_radius + size.drone / 2 + (size.check if check else size.tracking + size.prediction)
    return Flying(parabola, half, size.sampling)


def other(plan: Plan, size: SizeSpec, check: bool = False) -> Solid:
    """Another drone, as a plan has to avoid it; with ``check`` as a finished plan is held against it."""
    if check:
        return Other(plan, size.drone + size.check, size.all_vertices)
    return Other(plan, size.drone + size.tracking + size.prediction, size.all_vertices)


class Scene(NamedTuple):
    """Hulls of O solids in each of the 4 intervals of a spline."""

    vertices: Array  # (P, 3) m, all of them
    starts: NDArray[np.int64]  # (4, O + 1): solid o in interval i has the rows from starts[i, o] to starts[i, o + 1]

    def hull(self, interval: int, solid: int) -> Array:
        """Vertices (V, 3) of one solid in one interval."""
        return self.vertices[self.starts[interval, solid] : self.starts[interval, solid + 1]]

    @property
    def solids(self) -> int:
        return self.starts.shape[1] - 1


def scene(solids: list[Solid], start: float, interval: float, centre: Array, reach: float) -> Scene:
    """The solids that come within ``reach`` (m) of ``centre`` (3,) along each axis while the spline lasts."""
    edges = start + interval * np.arange(INTERVALS + 1)
    found = []
    for solid in solids:
        ends = np.append(edges[1:-1], np.inf if solid.lasting else edges[-1])
        hulls = [solid.vertices(low, high) for low, high in zip(edges[:-1], ends, strict=True)]
        points = np.concatenate(hulls)
        gap = centre.clip(points.min(0), points.max(0)) - centre
        if gap @ gap <= reach**2:
            found.append(hulls)
    counts = np.array([[len(hulls[i]) for hulls in found] for i in range(INTERVALS)], np.int64).reshape(INTERVALS, -1)
    ends = np.cumsum(counts).reshape(INTERVALS, -1)
    first = np.concatenate(([0], np.sum(counts, 1).cumsum()[:-1])).astype(np.int64)
    ordered = [hulls[i] for i in range(INTERVALS) for hulls in found]
    vertices = np.concatenate(ordered) if ordered else np.zeros((0, 3))
    return Scene(np.ascontiguousarray(vertices), np.concatenate((first[:, None], ends), 1))
