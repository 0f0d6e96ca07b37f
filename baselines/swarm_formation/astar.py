"""The front end's search: A* on the voxels, and its path cut down to a few straight segments.

26 neighbours, the cost of a step is its length, the heuristic is the length of a free diagonal path times 1.0001 (ties
go to cells nearer the goal). The budget is a number of expanded cells, never a time.
"""

from heapq import heappop, heappush
from itertools import pairwise

import numpy as np
from numba import njit

from baselines.planner.interface import Array
from baselines.swarm_formation.scene import Scene, distance

ROOM = 4.0
"""m of search window around both ends, in the plane."""
SIGHT_STEP = 0.01
"""m between samples of a line of sight."""
TIE = 1.0001


class Window:
    """The part of the map that one search looks at, as blocked cells (X, Y, Z)."""

    def __init__(self, scene: Scene, start: Array, end: Array, clearance: float) -> None:
        low = np.minimum(start, end)[:2] - ROOM - scene.origin
        high = np.maximum(start, end)[:2] + ROOM - scene.origin
        shape = scene.field.shape
        first = np.clip((low / scene.cell).astype(int), 0, np.array(shape) - 1)
        last = np.clip((high / scene.cell).astype(int) + 1, first + 1, shape)
        self.cell = scene.cell
        self.origin = np.array([*(scene.origin + first * scene.cell), scene.floor])
        height = np.arange(scene.cell / 2, scene.ceiling - scene.floor, scene.cell)
        flat = scene.field[first[0] : last[0], first[1] : last[1]] < clearance
        edge = (height < clearance) | (scene.ceiling - scene.floor - height < clearance)
        self.blocked = flat[:, :, None] | edge
        stamp(self.blocked, (scene.curve - self.origin) / scene.cell, (scene.tube + clearance) / scene.cell)

    def index(self, point: Array) -> tuple[int, int, int] | None:
        """The cell of ``point`` (3,), or None outside the window."""
        cell = np.floor((point - self.origin) / self.cell).astype(int)
        if (cell < 0).any() or (cell >= self.blocked.shape).any():
            return None
        return (int(cell[0]), int(cell[1]), int(cell[2]))

    def push(self, point: Array, direction: Array) -> Array | None:
        """``point`` (3,) moved by whole cells along ``direction`` until it is free; None when the window ends first."""
        length = float(np.linalg.norm(direction))
        step = direction / max(length, 1e-9) * self.cell
        while (cell := self.index(point)) is not None:
            if not self.blocked[cell]:
                return point
            if length < 1e-9:
                return None
            point = point + step
        return None


@njit(cache=True)
def stamp(blocked: Array, points: Array, radius: float) -> None:
    """Block the cells whose centre is within ``radius`` of any of ``points`` (B, 3), both in cells."""
    for p in range(len(points)):
        x, y, z = points[p, 0] - 0.5, points[p, 1] - 0.5, points[p, 2] - 0.5
        for i in range(max(int(np.ceil(x - radius)), 0), min(int(np.floor(x + radius)) + 1, blocked.shape[0])):
            for j in range(max(int(np.ceil(y - radius)), 0), min(int(np.floor(y + radius)) + 1, blocked.shape[1])):
                for k in range(max(int(np.ceil(z - radius)), 0), min(int(np.floor(z + radius)) + 1, blocked.shape[2])):
                    if (i - x) ** 2 + (j - y) ** 2 + (k - z) ** 2 < radius**2:
                        blocked[i, j, k] = True


@njit(cache=True)
def heuristic(i: int, j: int, k: int) -> float:
    """Length of a free path over (i, j, k) cells, in cells."""
    a, b, c = abs(i), abs(j), abs(k)
    least, most = min(a, b, c), max(a, b, c)
    middle = a + b + c - least - most
    return TIE * ((np.sqrt(3.0) - np.sqrt(2.0)) * least + (np.sqrt(2.0) - 1.0) * middle + most)


@njit(cache=True)
def search(blocked: Array, start: tuple[int, int, int], end: tuple[int, int, int], budget: int) -> Array:
    """Cells (L, 3) of a shortest path from ``start`` to ``end``; (0, 3) when there is none within ``budget`` cells."""
    nx, ny, nz = blocked.shape
    cost = np.full(nx * ny * nz, np.inf)
    parent = np.full(nx * ny * nz, -1, np.int64)
    done = np.zeros(nx * ny * nz, np.bool_)
    first, goal = (start[0] * ny + start[1]) * nz + start[2], (end[0] * ny + end[1]) * nz + end[2]
    cost[first] = 0.0
    heap = [(heuristic(end[0] - start[0], end[1] - start[1], end[2] - start[2]), first)]
    while len(heap) > 0 and budget > 0:
        cell = heappop(heap)[1]
        if cell == goal:
            return _trace(parent, cell, ny, nz)
        if done[cell]:
            continue
        done[cell] = True
        budget -= 1
        x, y, z = cell // (ny * nz), cell // nz % ny, cell % nz
        for i in range(max(x - 1, 0), min(x + 2, nx)):
            for j in range(max(y - 1, 0), min(y + 2, ny)):
                for k in range(max(z - 1, 0), min(z + 2, nz)):
                    other = (i * ny + j) * nz + k
                    if blocked[i, j, k] or done[other]:
                        continue
                    reached = cost[cell] + np.sqrt(float((i - x) ** 2 + (j - y) ** 2 + (k - z) ** 2))
                    if reached < cost[other]:
                        cost[other] = reached
                        parent[other] = cell
                        heappush(heap, (reached + heuristic(end[0] - i, end[1] - j, end[2] - k), other))
    return np.zeros((0, 3), np.int64)


@njit(cache=True)
def _trace(parent: Array, cell: int, ny: int, nz: int) -> Array:
    """The path (L, 3) that ends in ``cell``."""
    length, at = 0, cell
    while at >= 0:
        length += 1
        at = parent[at]
    path = np.empty((length, 3), np.int64)
    at = cell
    for step in range(length - 1, -1, -1):
        path[step, 0], path[step, 1], path[step, 2] = at // (ny * nz), at // nz % ny, at % nz
        at = parent[at]
    return path


def route(scene: Scene, start: Array, end: Array, clearance: float, budget: int) -> Array | None:
    """Points (L, 3) in m of a path between two free points near ``start`` and ``end`` (3,), or None.

    Ends in a blocked cell are pushed outwards along the line between them. A path that starts more than 0.5 m away is
    looked for again with the inflated cells alone.
    """
    for margin in (clearance, 0.0):
        window = Window(scene, start, end, margin)
        free = window.push(start, start - end)
        aim = window.push(end, end - start)
        if free is None or aim is None or (margin > 0 and np.linalg.norm(free - start) > 0.5):
            continue
        cells = search(window.blocked, window.index(free), window.index(aim), budget)
        if len(cells):
            path = window.origin + (cells + 0.5) * window.cell
            path[0], path[-1] = free, aim
            return np.concatenate((start[None], path)) if free is not start else path
    return None


@njit(cache=True)
def visible(scene: Scene, start: Array, end: Array, clearance: float) -> bool:
    """Whether the straight line between two points (3,) keeps ``clearance`` from every obstacle."""
    slope = np.empty(3)
    x, y, z = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    count = int(np.ceil(np.sqrt(x * x + y * y + z * z) / SIGHT_STEP)) + 1
    for k in range(count + 1):
        s = k / count
        if distance(scene, start[0] + s * x, start[1] + s * y, start[2] + s * z, slope) < clearance:
            return False
    return True


def shorten(scene: Scene, path: Array, clearance: float, shortest: float = 0.3, longest: float = 3.0) -> Array:
    """Corner points (P + 1, 3) of ``path`` (L, 3), at least two segments.

    Greedy lines of sight; corners nearer than ``shortest`` m to the last one dropped; segments longer than ``longest``
    m halved, at most ten times; one segment becomes two.
    """
    corners = [path[0]]
    for before, after in pairwise(path[1:]):
        if not visible(scene, corners[-1], after, clearance) and np.linalg.norm(before - corners[-1]) >= shortest:
            corners.append(before)
    if len(corners) > 1 and np.linalg.norm(path[-1] - corners[-1]) < shortest:
        corners.pop()
    corners.append(path[-1])
    for _ in range(10):
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=-1)
        widest = int(np.argmax(lengths))
        if lengths[widest] <= longest and len(corners) > 2:
            break
        corners.insert(widest + 1, (corners[widest] + corners[widest + 1]) / 2)
    return np.array(corners)
