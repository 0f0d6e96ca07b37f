"""Columns and thrown balls: where they are, how a ball is launched, and distances along a step."""

import torch
from torch import Tensor

from envs import memory, rotation
from envs.dynamics import GRAVITY
from envs.spec import FAR, Scenarios, ScenarioSpec, State


def launch(state: State, time: Tensor, scenarios: Scenarios, spec: ScenarioSpec) -> State:
    """Throw every ball whose time has come (release: throw pattern 1; docs/method.md, Obstacles).

    The ball passes, ``time_to_hit`` after the throw, the place that the aim point reaches at the team's mean
    horizontal velocity, at the aim point's height. Of the candidates drawn for it the first that appears at least
    ``spawn_clearance`` from every drone flies, or the last if none does. ``time`` is (E,) in s.
    """
    direction, drawn, box = scenarios.throws.split((2, 3, 2), -1)
    speed, to_hit, share = drawn.unbind(-1)  # (E, M, R)
    aim = _aim_point(state, scenarios.aim, box)  # (E, M, R, 3)
    lead = state.velocity[..., :2].mean(1)[:, None, None] * to_hit[..., None]
    horizontal = direction * speed[..., None]
    start = aim[..., :2] + lead - horizontal * to_hit[..., None]
    height = share * aim[..., 2]
    climb = (aim[..., 2] - height) / to_hit + 0.5 * GRAVITY * to_hit
    origin = memory.cat((start, height[..., None]))
    velocity = memory.cat((horizontal, climb[..., None]))

    gap = rotation.norm(origin[:, :, :, None] - state.position[:, None, None]).amin(-1)
    origin, velocity = _first(gap >= spec.spawn_clearance, origin, velocity)

    now = time[:, None].to(scenarios.throw_time)
    thrown = (now >= scenarios.throw_time) & state.ball_time.isinf()
    fall = (velocity[..., 2].square() + 2 * GRAVITY * (origin[..., 2] - spec.ball_radius).clamp_min(0)).sqrt()
    landing = now + (velocity[..., 2] + fall) / GRAVITY
    return state._replace(
        ball_origin=torch.where(thrown[..., None], memory.ordered(origin), state.ball_origin),
        ball_velocity=torch.where(thrown[..., None], memory.ordered(velocity), state.ball_velocity),
        ball_time=torch.where(thrown, now, state.ball_time),
        ball_landing=torch.where(thrown, landing, state.ball_landing),
    )


def _first(wanted: Tensor, *candidates: Tensor) -> list[Tensor]:
    """Of each (E, M, R, ...) the first candidate that is ``wanted`` (E, M, R), the last if none is: (E, M, ...).

    A chain of choices instead of an index: it compiles to vector instructions.
    """
    chosen = [options[:, :, -1] for options in candidates]
    for r in reversed(range(wanted.shape[-1] - 1)):
        here = wanted[:, :, r, None]
        chosen = [torch.where(here, options[:, :, r], later) for options, later in zip(candidates, chosen, strict=True)]
    return chosen


def _aim_point(state: State, aim: Tensor, box: Tensor) -> Tensor:
    """Point (E, M, R, 3) each candidate is thrown at: a drone, or a point in the formation's bounding box."""
    drones = state.position.shape[1]
    chosen = aim[..., None] == torch.arange(drones, device=aim.device)
    drone = torch.where(chosen[..., None], state.position[:, None], 0.0).sum(2)[:, :, None]
    low = state.position[..., :2].amin(1)[:, None, None]
    high = state.position[..., :2].amax(1)[:, None, None]
    height = state.position[..., 2].mean(1)[:, None, None].expand(box.shape[:3])[..., None]
    inside = memory.cat((low + (high - low) * box, height))
    return torch.where((aim < 0)[..., None, None], inside, drone)


def balls_at(state: State, time: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Positions (E, M, 3) in m, velocities (E, M, 3) in m/s and flying flags (E, M) at ``time`` (E,) in s.

    An analytic parabola from the launch until the ball touches the ground, where it stays. A ball not yet thrown
    rests at its origin and is not flying. (The release integrates with 20 ms Euler steps, 8 to 16 cm too low.)
    """
    now = time[:, None]
    flying = (now >= state.ball_time) & (now < state.ball_landing)
    aloft = (torch.minimum(now, state.ball_landing) - state.ball_time).clamp_min(0)[..., None]
    fall = aloft.new_tensor([0.0, 0.0, GRAVITY])
    position = state.ball_origin + state.ball_velocity * aloft - 0.5 * fall * aloft.square()
    velocity = torch.where(flying[..., None], state.ball_velocity - fall * aloft, 0.0)
    return position, velocity, flying


def sighted(
    state: State, time: Tensor, position: Tensor, velocity: Tensor, flying: Tensor, spec: ScenarioSpec
) -> State:
    """The state with its balls as somebody sees them at ``time`` (E,) in s: a ball seen now is one launched now.

    ``position`` (E, M, 3) in m and ``velocity`` (E, M, 3) in m/s of the balls that are ``flying`` (E, M); the others
    count as not thrown.
    """
    never = torch.full_like(position[..., 2], float("inf"))
    fall = (velocity[..., 2].square() + 2 * GRAVITY * (position[..., 2] - spec.ball_radius).clamp_min(0)).sqrt()
    now = time[:, None].expand_as(never)
    return state._replace(
        ball_origin=position,
        ball_velocity=velocity,
        ball_time=torch.where(flying, now, never),
        ball_landing=torch.where(flying, now + (velocity[..., 2] + fall) / GRAVITY, never),
    )


def swept(before: Tensor, after: Tensor) -> Tensor:
    """Least length of a vector (..., k) that moves in a straight line from ``before`` to ``after``."""
    move = after - before
    share = -(before * move).sum(-1) / (move.square().sum(-1) + rotation.EPSILON)
    return rotation.norm(before + share.clamp(0, 1)[..., None] * move)


def column_clearance(before: Tensor, after: Tensor, scenarios: Scenarios) -> Tensor:
    """Least horizontal distance (E, N, C) from each drone to each column axis along a step; (E, N, 3) in."""
    axes = scenarios.columns[:, None]
    return swept(before[..., None, :2] - axes, after[..., None, :2] - axes)


def ball_clearance(before: State, after: State, start: Tensor, end: Tensor) -> Tensor:
    """Least centre distance (E, N, M) from each drone to each ball in the air along a step from ``start`` to ``end``.

    ``before`` carries the throws of this step; times are (E,) in s.
    """
    first, _, flying = balls_at(before, start)
    last, _, _ = balls_at(before, end)
    gap = swept(first[:, None] - before.position[:, :, None], last[:, None] - after.position[:, :, None])
    return torch.where(flying[:, None], gap, FAR)


def drone_clearance(before: Tensor, after: Tensor) -> Tensor:
    """Least centre distance (E, N) from each drone to another one along a step; positions (E, N, 3) in."""
    gap = swept(before[:, :, None] - before[:, None], after[:, :, None] - after[:, None])
    itself = torch.eye(before.shape[1], dtype=before.dtype, device=before.device)
    return (gap + FAR * itself).amin(-1)


def least(clearance: Tensor) -> Tensor:
    """Smallest over the last axis, a large number where that axis is empty."""
    return clearance.amin(-1) if clearance.shape[-1] else clearance.new_full(clearance.shape[:-1], FAR**2)
