"""What a drone must not touch, as a signed distance with its gradient.

Columns go through a voxel map as in the published planner: cells whose centre lies in a column, or outside the flight
corridor, where the map ends, are occupied; occupied cells are inflated, and the distance to the faces between free and
occupied cells is kept per cell and interpolated.
Columns stand upright, so the map is flat: position in the plane is all it needs, the ground and the ceiling, inflated
by as much, bound the height. A ball's predicted parabola is a still tube: the paper inserts "the estimated parabolic
curve as a static obstacle", so nothing of its timing is kept.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.ndimage import binary_dilation, distance_transform_edt

from baselines.planner.interface import Array, Parabola, Task

GRAVITY = 9.81
CURVE_STEP = 0.05
"""m, largest spacing of the points that stand for a parabola."""
MARGIN = 4.0
"""m of map around everything that has a place in the task."""


class Scene(NamedTuple):
    """A map that compiled code reads: world frame, SI units."""

    field: Array  # (X, Y) m, signed distance at cell centres to the inflated columns
    origin: Array  # (2,) m, corner of the first cell
    cell: float  # m
    floor: float  # m
    ceiling: float  # m
    curve: Array  # (B, 3) m, points of the predicted parabolas
    tube: float  # m, radius of the inflated tube around them


def survey(task: Task, start: Array, goal: Array, cell: float, inflation: int) -> Scene:
    """The map of ``task`` with room around ``start`` and ``goal`` (N, 3); no balls yet."""
    places = np.concatenate((start[:, :2], goal[:, :2], task.columns))
    low = places.min(0) - MARGIN
    size = np.ceil((places.max(0) + MARGIN - low) / cell).astype(int)
    x, y = (low[axis] + (np.arange(size[axis]) + 0.5) * cell for axis in range(2))
    occupied = np.repeat(np.abs(x)[:, None] > task.corridor, size[1], axis=1)
    for column in task.columns:
        occupied |= (x[:, None] - column[0]) ** 2 + (y - column[1]) ** 2 <= task.column_radius**2
    if inflation:
        occupied = binary_dilation(occupied, np.ones((3, 3), bool), iterations=inflation)
    return Scene(
        field=_signed(occupied) * cell,
        origin=low,
        cell=cell,
        floor=task.altitude[0] + inflation * cell,
        ceiling=task.altitude[1] - inflation * cell,
        curve=np.zeros((0, 3)),
        tube=task.ball_radius + inflation * cell,
    )


def _signed(occupied: Array) -> Array:
    """Distance in cells to the nearest face between free and occupied ones: positive where free."""
    if not occupied.any():
        return np.full(occupied.shape, 1e3)
    return np.where(occupied, 0.5 - distance_transform_edt(occupied), distance_transform_edt(~occupied) - 0.5)


def with_balls(scene: Scene, balls: tuple[Parabola, ...], now: float) -> Scene:
    """``scene`` with the rest of every ball's flight, from ``now`` to the ground."""
    curves = [_points(ball, now) for ball in balls if ball.landing > now]
    return scene._replace(curve=np.concatenate(curves) if curves else np.zeros((0, 3)))


def _points(ball: Parabola, now: float) -> Array:
    """Points (B, 3) along a parabola from ``now`` to its landing, at most CURVE_STEP apart."""
    first, last = now - ball.time, ball.landing - ball.time
    fastest = max(np.linalg.norm(ball.velocity - [0, 0, GRAVITY * t]) for t in (first, last))
    times = np.linspace(first, last, int(np.ceil((last - first) * fastest / CURVE_STEP)) + 1)[:, None]
    return ball.origin + ball.velocity * times - np.array([0, 0, GRAVITY / 2]) * times**2


@njit(cache=True)
def distance(scene: Scene, x: float, y: float, z: float, slope: Array) -> float:
    """Signed distance in m from a point to the nearest obstacle; ``slope`` (3,) becomes its gradient."""
    u = (x - scene.origin[0]) / scene.cell - 0.5
    v = (y - scene.origin[1]) / scene.cell - 0.5
    i = min(max(int(np.floor(u)), 0), scene.field.shape[0] - 2)
    j = min(max(int(np.floor(v)), 0), scene.field.shape[1] - 2)
    a, b = min(max(u - i, 0.0), 1.0), min(max(v - j, 0.0), 1.0)
    f00, f01 = scene.field[i, j], scene.field[i, j + 1]
    f10, f11 = scene.field[i + 1, j], scene.field[i + 1, j + 1]
    least = (1 - a) * ((1 - b) * f00 + b * f01) + a * ((1 - b) * f10 + b * f11)
    slope[0] = ((1 - b) * (f10 - f00) + b * (f11 - f01)) / scene.cell if a == u - i else 0.0
    slope[1] = ((1 - a) * (f01 - f00) + a * (f11 - f10)) / scene.cell if b == v - j else 0.0
    slope[2] = 0.0
    if z - scene.floor < least:
        least = z - scene.floor
        slope[0], slope[1], slope[2] = 0.0, 0.0, 1.0
    if scene.ceiling - z < least:
        least = scene.ceiling - z
        slope[0], slope[1], slope[2] = 0.0, 0.0, -1.0
    return _to_curve(scene, x, y, z, least, slope)


@njit(cache=True)
def _to_curve(scene: Scene, x: float, y: float, z: float, least: float, slope: Array) -> float:
    """The smaller of ``least`` and the distance to the tubes; ``slope`` follows."""
    nearest, square = -1, (max(least, -scene.tube) + scene.tube) ** 2
    for k in range(len(scene.curve)):
        away = (x - scene.curve[k, 0]) ** 2 + (y - scene.curve[k, 1]) ** 2 + (z - scene.curve[k, 2]) ** 2
        if away < square:
            nearest, square = k, away
    if nearest < 0:
        return least
    length = max(np.sqrt(square), 1e-9)
    slope[0] = (x - scene.curve[nearest, 0]) / length
    slope[1] = (y - scene.curve[nearest, 1]) / length
    slope[2] = (z - scene.curve[nearest, 2]) / length
    return length - scene.tube


@njit(cache=True)
def occupied(scene: Scene, x: float, y: float, z: float) -> int:
    """What holds a point: 0 nothing, 1 an inflated column's cell, 2 a ball's tube, 3 the ground or the ceiling."""
    if z < scene.floor or z > scene.ceiling:
        return 3
    i = int(np.floor((x - scene.origin[0]) / scene.cell))
    j = int(np.floor((y - scene.origin[1]) / scene.cell))
    if 0 <= i < scene.field.shape[0] and 0 <= j < scene.field.shape[1] and scene.field[i, j] < 0:
        return 1
    for k in range(len(scene.curve)):
        if (x - scene.curve[k, 0]) ** 2 + (y - scene.curve[k, 1]) ** 2 + (z - scene.curve[k, 2]) ** 2 < scene.tube**2:
            return 2
    return 0


@njit(cache=True)
def first_hit(scene: Scene, path: Array) -> int:
    """Index of the first of the points ``path`` (T, 3) that is occupied, or T."""
    for k in range(len(path)):
        if occupied(scene, path[k, 0], path[k, 1], path[k, 2]) > 0:
            return k
    return len(path)
