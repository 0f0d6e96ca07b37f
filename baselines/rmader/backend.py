"""The convex back end: the smoothest spline between the planes that the search has found (MADER, Sec. V-D).

minimise sum over intervals of |third derivative in normalised time|^2 + w |q6 - goal|^2 over the two free control
points, subject to the planes, velocity, acceleration, jerk, altitude and the sphere about the start. Least distance
programming (Lawson and Hanson, chapter 23) turns the six-dimensional programme into non-negative least squares with
seven rows; the sphere is approached by tangent planes at the vertices that violate it.
"""

from dataclasses import dataclass

import numpy as np

from baselines.planner.interface import Array
from baselines.rmader import minvo
from baselines.rmader.bspline import BASIS, CONTROLS, INTERVALS, acceleration_controls, velocity_controls
from baselines.rmader.hulls import Scene
from baselines.rmader.nnls import nnls
from baselines.rmader.separator import separate

SLACK = 1e-7
"""m, m/s, m/s^2 or m/s^3 that every constraint is tightened by, so that rounding violates none."""

ROUNDS = 6
"""Solutions with tangent planes to the sphere added in between."""

FREE = np.zeros((CONTROLS, 2))
FREE[3, 0] = FREE[4:, 1] = 1.0


def _stacked(matrices: Array, width: int) -> Array:
    """(I, R, CONTROLS) from matrices (I, R, width) on each interval's own control points."""
    full = np.zeros((INTERVALS, matrices.shape[1], CONTROLS))
    for i in range(INTERVALS):
        full[i, :, i : i + width] = matrices[i]
    return full


POSITIONS = _stacked(minvo.POSITION, 4)
"""(4, 4, 7): vertices of the position on interval i from all control points."""

JERKS = 6 * _stacked(BASIS[:, 3:], 4)[:, 0]
"""(4, 7): third derivative in normalised time."""


@dataclass(frozen=True)
class Bounds:
    """What a plan has to keep."""

    speed: float  # m/s, per axis
    acceleration: float  # m/s^2, per axis
    jerk: float  # m/s^3, per axis
    low: Array  # (3,) m
    high: Array  # (3,) m
    reach: float  # m, about the first control point


def planes(scene: Scene, controls: Array) -> list[tuple[int, Array]] | None:
    """(interval, plane (4,)) between ``controls`` (7, 3) and every hull of the scene; None if one cannot be found."""
    found = []
    for i in range(INTERVALS):
        own = np.ascontiguousarray(POSITIONS[i] @ controls)
        for solid in range(scene.solids):
            plane = np.zeros(4)
            if not separate(scene.hull(i, solid), own, plane):
                return None
            found.append((i, plane))
    return found


def smooth(
    controls: Array,
    interval: float,
    goal: Array,
    found: list[tuple[int, Array]],
    bounds: Bounds,
    weight: float,
    exchanges: int,
) -> Array | None:
    """Optimal control points (7, 3) that keep the first three of ``controls``, or None if there are none.

    ``found`` are (interval, plane) with n.q + d <= 1 for the vertices of that interval: up to the obstacle's side.
    """
    fixed = controls.copy()
    fixed[3:] = 0.0
    root, centre = _objective(fixed, goal, weight)
    rows, room = _constraints(fixed, interval, found, bounds)
    for _ in range(ROUNDS):
        free = _least_distance(root, centre, rows, room, exchanges)
        if free is None:
            return None
        answer = fixed + FREE @ free
        more = _tangents(fixed, answer, bounds.reach)
        if more is None:
            return answer
        rows, room = np.concatenate((rows, more[0])), np.concatenate((room, more[1]))
    return None


def _objective(fixed: Array, goal: Array, weight: float) -> tuple[Array, Array]:
    """The cost as |root (x - centre)|^2 per axis: root (2, 2) upper triangular, centre (2, 3) in m."""
    stack = np.concatenate((JERKS @ FREE, np.sqrt(weight) * FREE[-1:]))
    wanted = np.concatenate((-JERKS @ fixed, np.sqrt(weight) * goal[None]))
    root = np.linalg.qr(stack, mode="r")
    return root, np.linalg.lstsq(stack, wanted)[0]


def _constraints(fixed: Array, interval: float, found: list[tuple[int, Array]], bounds: Bounds) -> tuple[Array, Array]:
    """All linear constraints as rows (R, 2, 3) and room (R,): sum(rows * x) <= room."""
    alike = (  # the same along all axes: (map from all control points, least, most)
        (POSITIONS.reshape(-1, CONTROLS), bounds.low, bounds.high),
        (VELOCITIES / interval, -bounds.speed * np.ones(3), bounds.speed * np.ones(3)),
        (ACCELERATIONS / interval**2, -bounds.acceleration * np.ones(3), bounds.acceleration * np.ones(3)),
        (JERKS / interval**3, -bounds.jerk * np.ones(3), bounds.jerk * np.ones(3)),
    )
    rows, room = [], []
    for matrix, low, high in alike:
        part = (matrix @ FREE)[:, None, :, None] * np.eye(3)[:, None]  # (R, 3, 2, 3)
        base = matrix @ fixed
        for sign, limit in ((1.0, high), (-1.0, -low)):
            kept = np.isfinite(limit) & np.ones(base.shape, bool)
            rows.append(sign * part[kept])
            room.append((limit - sign * base)[kept])
    if found:
        which = POSITIONS[[i for i, _ in found]]  # (F, 4, 7)
        normals, offsets = np.stack([plane[:3] for _, plane in found]), np.array([plane[3] for _, plane in found])
        rows.append(((which @ FREE)[..., None] * normals[:, None, None]).reshape(-1, 2, 3))
        room.append((1 - offsets[:, None] - ((which @ fixed) * normals[:, None]).sum(-1)).ravel())
    return np.concatenate(rows), np.concatenate(room)


def _tangents(fixed: Array, answer: Array, reach: float) -> tuple[Array, Array] | None:
    """Half-spaces at the vertices outside of the sphere, as rows and room; None if there are none."""
    away = POSITIONS @ answer - answer[0]
    distance = np.linalg.norm(away, axis=-1)
    outside = distance > reach
    if not outside.any():
        return None
    normals = away[outside] / distance[outside][:, None]
    maps = POSITIONS[outside]
    rows = (maps @ FREE)[..., None] * normals[:, None]
    return rows, reach - SLACK - (normals * (maps @ fixed - answer[0])).sum(-1)


def _least_distance(root: Array, centre: Array, rows: Array, room: Array, exchanges: int) -> Array | None:
    """The x (2, 3) nearest to ``centre`` in the metric of ``root`` with sum(rows * x) <= room; None if none exists."""
    length = np.sqrt((rows**2).sum((1, 2)))
    if (room[length < 1e-12] < -SLACK).any():  # what is fixed already breaks a limit
        return None
    kept = length >= 1e-12
    rows, room = rows[kept] / length[kept][:, None, None], (room[kept] - SLACK) / length[kept]
    inverse = np.linalg.inv(root)
    metric = np.einsum("rki,kl->rli", rows, inverse).reshape(-1, 6)  # x = centre + inverse @ y, row . x = metric . y
    slack = room - (rows * centre).sum((1, 2))
    columns = np.ascontiguousarray(np.concatenate((-metric, -slack[:, None]), 1))
    residual, target = np.zeros(7), np.eye(7)[6]
    done = nnls(columns, target, np.empty(len(columns)), residual, exchanges)
    if not done or np.linalg.norm(residual) < 1e-7 or residual[6] < 1e-12:
        return None
    y = -residual[:6] / residual[6]
    if (metric @ y > slack + SLACK / 2).any():
        return None
    return centre + inverse @ y.reshape(2, 3)


def _derivatives() -> tuple[Array, Array]:
    """Vertices of the velocity (12, 7) and accelerations at the knots (5, 7) from control points, interval 1 s."""
    velocity = np.stack([velocity_controls(one[:, None] * np.ones(3), 1.0)[:, 0] for one in np.eye(CONTROLS)], -1)
    acceleration = np.stack(
        [acceleration_controls(one[:, None] * np.ones(3), 1.0)[:, 0] for one in np.eye(CONTROLS)], -1
    )
    inside = [minvo.VELOCITY[i] @ velocity[i : i + 3] for i in range(INTERVALS)]
    return np.concatenate(inside), acceleration


VELOCITIES, ACCELERATIONS = _derivatives()
