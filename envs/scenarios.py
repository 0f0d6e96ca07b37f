"""Drawing episodes: columns, throws, start poses, craft, wind and messages as numbers, all before the episode starts.

Episode k of a seed is the same whatever the number of episodes drawn with it: every quantity has a stream of its own.
It is the same on every processor, too: numbers are drawn in float64 and kept to float32's precision.
"""

import numpy as np
import torch
from torch import Tensor

from envs import air, memory, messages, rotation, shapes
from envs.spec import FAR, Scenarios, ScenarioSpec, VehicleSpec

FIXED4 = ((0.5, 5.0), (0.25, 5.5), (0.0, 6.0), (-1.0, 4.5))
"""Columns (x, y) in m of the paper's behaviour picture (release: layout ``fixed``)."""


def grid_shape(spec: ScenarioSpec) -> tuple[int, int]:
    """Rows along the course and cells across it that columns may stand on."""
    rows = round((spec.field[1] - spec.field[0]) / spec.column_cell)
    return rows, round(2 * spec.column_half_width / spec.column_cell)


def capacity(spec: ScenarioSpec) -> int:
    """The largest number of columns the layout can hold."""
    rows, across = grid_shape(spec)
    return len(FIXED4) if spec.column_layout == "fixed4" else rows * across


def sample(
    spec: ScenarioSpec,
    count: int,
    seed: int,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> Scenarios:
    """``count`` episodes of ``spec``: a pure function of (spec, seed, index). ValueError if the columns do not fit."""
    if spec.columns > capacity(spec):
        raise ValueError(
            f"scenario.columns={spec.columns} but the {spec.column_layout} layout has {capacity(spec)} places:"
            f" use at most scenario.columns={capacity(spec)}"
        )
    streams = np.random.SeedSequence(seed).spawn(10)
    pose, place, when, aim, throw, craft, wind, *link = (
        np.random.Generator(np.random.PCG64(stream)) for stream in streams
    )
    slots = shapes.slots(spec, torch.float64)
    drones = len(slots)
    jitter = torch.from_numpy(pose.uniform(-1, 1, (count, drones, 6)))
    position = torch.tensor(spec.start, dtype=torch.float64) + slots + spec.position_jitter * jitter[..., :3]
    attitude = rotation.from_roll_pitch_yaw(spec.attitude_jitter * jitter[..., 3:])
    low, high = spec.throw_time
    numbers = (
        position,
        attitude,
        _columns(spec, count, place),
        torch.from_numpy(when.uniform(low, high, (count, spec.balls))),
        _throws(spec, throw, count),
        _vehicle(spec.vehicle, count, drones, craft),
        air.draw(spec.air, spec, count, wind),
        messages.draw(spec.messages, spec, count, drones, (link[0], link[1], link[2])),
    )
    # square roots and sines differ in their last bits from processor to processor; rounded, banks have one hash
    position, attitude, columns, throw_time, *others = (memory.ordered(x.float().to(device, dtype)) for x in numbers)
    aims = memory.ordered(_aims(spec, aim, count, drones).to(device))
    return Scenarios(torch.arange(count, device=device), position, attitude, columns, throw_time, aims, *others)


def pad(scenarios: Scenarios, columns: int, balls: int) -> Scenarios:
    """The same episodes with room for ``columns`` and ``balls``: absent ones stand far away and are never thrown.

    Scenes of different sizes then share one shape, and one compiled step.
    """
    episodes, drawn_columns = scenarios.columns.shape[:2]
    drawn_balls = scenarios.throw_time.shape[1]
    if columns < drawn_columns or balls < drawn_balls:
        raise ValueError(f"cannot pad {drawn_columns} columns and {drawn_balls} balls to {columns} and {balls}")
    more_columns, more_balls = columns - drawn_columns, balls - drawn_balls
    throws = scenarios.throws
    return scenarios._replace(
        columns=_extend(scenarios.columns, (episodes, more_columns, 2), FAR),
        throw_time=_extend(scenarios.throw_time, (episodes, more_balls), float("inf")),
        aim=_extend(scenarios.aim, (episodes, more_balls), 0),
        throws=_extend(throws, (episodes, more_balls, *throws.shape[2:]), 1.0),
    )


def select(scenarios: Scenarios, index: Tensor | slice) -> Scenarios:
    """The episodes at ``index`` (a slice, or int64 or boolean tensor over episodes)."""
    return Scenarios(*(memory.ordered(field[index]) for field in scenarios))


def cast(scenarios: Scenarios, dtype: torch.dtype, device: torch.device | str = "cpu") -> Scenarios:
    """The same episodes with real numbers as ``dtype``, on ``device``."""
    return Scenarios(*(x.to(device, dtype if x.is_floating_point() else None) for x in scenarios))


def _extend(field: Tensor, shape: tuple[int, ...], value: float) -> Tensor:
    return memory.ordered(torch.cat((field, field.new_full(shape, value)), 1))


def _columns(spec: ScenarioSpec, count: int, generator: np.random.Generator) -> Tensor:
    """Axes (count, C, 2) in m. Zigzag: distinct cells by a true permutation, even rows shifted by half a cell."""
    if spec.column_layout == "fixed4":
        return torch.tensor(FIXED4[: spec.columns], dtype=torch.float64).expand(count, -1, -1)
    rows, across = grid_shape(spec)
    order = torch.from_numpy(generator.random((count, rows * across)))
    cell = order.topk(spec.columns, dim=1).indices
    row, lane = cell // across, cell % across
    lateral = spec.column_cell * (lane + 0.5 * (row % 2 == 0)) - spec.column_half_width
    return torch.stack((-lateral, spec.column_cell * row + spec.field[0]), -1)


def _vehicle(spec: VehicleSpec, count: int, drones: int, generator: np.random.Generator) -> Tensor:
    """Factors (count, N, 3) on mass, thrust and motor lag; (count, N, 0) where all of them are 1."""
    ranges = torch.tensor((spec.mass, spec.thrust, spec.motor_lag), dtype=torch.float64)
    if (ranges == 1).all():
        return torch.zeros(count, drones, 0, dtype=torch.float64)
    numbers = torch.from_numpy(generator.random((count, drones, 3)))
    return ranges[:, 0] + (ranges[:, 1] - ranges[:, 0]) * numbers


def _aims(spec: ScenarioSpec, generator: np.random.Generator, count: int, drones: int) -> Tensor:
    """Drone each ball is aimed at, or -1 for a point in the formation's bounding box (count, M)."""
    numbers = torch.from_numpy(generator.random((count, spec.balls, 2)))
    drone = (numbers[..., 0] * drones).long()
    box = torch.full_like(drone, -1)
    if spec.ball_aim == "drone":
        return drone
    return box if spec.ball_aim == "box" else torch.where(numbers[..., 1] < 0.5, drone, box)


def _throws(spec: ScenarioSpec, generator: np.random.Generator, count: int) -> Tensor:
    """Throw candidates (count, M, R, 7): the release's pattern 1, one independent draw per ball and candidate."""
    numbers = torch.from_numpy(generator.random((count, spec.balls, spec.throw_candidates, 7)))
    direction = 2 * numbers[..., :2] - 1
    direction = direction / rotation.norm(direction, keepdim=True)
    ranges = torch.tensor((spec.ball_speed, spec.time_to_hit, spec.release_height), dtype=torch.float64)
    drawn = ranges[:, 0] + (ranges[:, 1] - ranges[:, 0]) * numbers[..., 2:5]
    return torch.cat((direction, drawn, numbers[..., 5:]), -1)
