"""What each drone sees: groups of tokens with boolean masks (paper, Sec. III-B; docs/method.md, Observation).

| group | shape | raw content | conditioned content |
|---|---|---|---|
| self | (E, N, 1, 25) | position | x, 0.2 (y - scheduled y), z - commanded height |
| | | quaternion, heading axis, up axis, v* - v | unchanged |
| | | velocity, body rates | times 0.5, times 0.1 |
| | | identifier (i, i, i) | own slot in the formation |
| drones | (E, N, N-1, 7) | (p_i - p_j)/2, distance/2, v_i - v_j | p_i - p_j less what it is between their slots |
| | (8 with ``message_age``) | s since the other told it | unchanged |
| static | (E, N, 1, 9) | distances of a 3 x 3 grid to the nearest column | centre distance, scaled differences |
| dynamic | (E, N, M, 10) | distance, p_b - p_i, | time to the closest pass, offset then, squashed |
| | | v_b - v_i, v_b | times 0.3 |

Conditioning is an invertible change of variables (given the time): distances of metres that differ by centimetres hide
the direction of a column, which centre distance and scaled differences show. A ball metres away hides on which side it
will pass; the offset at its closest pass shows that, and where it is now follows from it, the time and the velocity.
Differences from the release: body rates are in the body frame (what a gyroscope measures), and the conditioned
identifier is the drone's slot in the formation, which serves any number of drones. Velocities and positions are in the
world frame. What is seen of other drones is what they told (``envs.messages``).
"""

from dataclasses import dataclass
from typing import Protocol, cast

import torch
from torch import Tensor

from envs import memory, messages, obstacles, rotation, shapes
from envs.dynamics import GRAVITY
from envs.spec import FAR, Observation, ObservationLayout, ObservationSpec, Scenarios, ScenarioSpec, State

GRID = 0.1
"""m, spacing of the 3 x 3 points that distances to columns are measured from (release: ``swarm_rl``)."""

LANDED = 0.2
"""m, a ball below is not observed (release)."""


class Sensor(Protocol):
    """What drones see: the groups above, or those of a method that brings its own."""

    def layout(self, scenario: ScenarioSpec) -> ObservationLayout:
        """Widths of the observation groups."""
        ...

    def observe(
        self, state: State, scenarios: Scenarios, time: Tensor, scenario: ScenarioSpec, slots: Tensor
    ) -> Observation:
        """Observation groups of every drone; ``time`` is (E,) in s and ``slots`` (N, 3) in m."""
        ...


def sensor(spec: ObservationSpec | Sensor) -> Sensor:
    """The sensor of observation settings: the groups above, unless the settings are a sensor themselves."""
    return Groups(spec) if isinstance(spec, ObservationSpec) else cast(Sensor, spec)


@dataclass(frozen=True)
class Groups:
    """The groups of this module's table."""

    spec: ObservationSpec

    def layout(self, scenario: ScenarioSpec) -> ObservationLayout:
        """Widths of the observation groups."""
        own = 25 + 4 * self.spec.rotor_throttles + 4 * self.spec.previous_command
        return ObservationLayout(self.spec.name, len(shapes.slots(scenario)), own, 7 + self.spec.message_age, 9, 10)

    def observe(
        self, state: State, scenarios: Scenarios, time: Tensor, scenario: ScenarioSpec, slots: Tensor
    ) -> Observation:
        """Observation groups of every drone; ``time`` is (E,) in s and ``slots`` (N, 3) in m."""
        static, static_mask = _static(state, scenarios, self.spec)
        dynamic, dynamic_mask = _dynamic(state, time, self.spec, scenario)
        groups = {
            "self": _self(state, time, self.spec, scenario, slots)[:, :, None],
            "drones": _drones(state, messages.neighbours(state, scenarios, time, scenario.messages), self.spec, slots),
            "static": static[:, :, None],
            "dynamic": dynamic,
            "static_mask": static_mask,
            "dynamic_mask": dynamic_mask,
        }
        return {name: x.contiguous() for name, x in groups.items()}


def _self(state: State, time: Tensor, spec: ObservationSpec, scenario: ScenarioSpec, slots: Tensor) -> Tensor:
    position, velocity = state.position, state.velocity
    wanted = velocity.new_tensor(scenario.velocity)
    if spec.conditioned:
        schedule = scenario.start[1] + scenario.velocity[1] * time[:, None]
        x, y, z = position.unbind(-1)
        position = memory.stack((x, 0.2 * (y - schedule), z - scenario.height))
        velocity = 0.5 * velocity
        identifier = (slots / scenario.formation_size).expand_as(position)
    else:
        number = torch.arange(len(slots), dtype=position.dtype, device=position.device)
        identifier = number[None, :, None].expand_as(position)
    parts = [
        position,
        state.attitude,
        velocity,
        state.rates * (0.1 if spec.conditioned else 1.0),
        rotation.heading_axis(state.attitude),
        rotation.up_axis(state.attitude),
        wanted - state.velocity,
        identifier,
    ]
    if spec.rotor_throttles:
        parts.append(2 * state.throttle - 1)
    if spec.previous_command:
        parts.append(state.command)
    return memory.cat(parts)


def _drones(state: State, known: messages.Neighbours, spec: ObservationSpec, slots: Tensor) -> Tensor:
    """Own minus other, others in ascending order (release); positions halved or, relative to slots, whole."""
    drones = state.position.shape[1]
    others = torch.tensor([[j for j in range(drones) if j != i] for i in range(drones)], device=state.position.device)
    offset = (state.position[:, :, None] - known.position) / 2
    shown = 2 * offset - (slots[:, None] - slots[others]) if spec.slot_relative else offset
    parts = [shown, rotation.norm(offset, keepdim=True), state.velocity[:, :, None] - known.velocity]
    return memory.cat((*parts, known.age[..., None]) if spec.message_age else parts)


def _static(state: State, scenarios: Scenarios, spec: ObservationSpec) -> tuple[Tensor, Tensor]:
    steps = torch.tensor([-GRID, 0.0, GRID], dtype=state.position.dtype, device=state.position.device)
    points = torch.cartesian_prod(steps, steps)  # x outer, y inner, as in the release
    offset = state.position[:, :, None, :2] - scenarios.columns[:, None]  # first: near a column it is exact, 30 m out
    squared = (offset[:, :, None] + points[:, None]).square().sum(-1)
    nearest = obstacles.least(squared) + rotation.EPSILON
    mask = (scenarios.columns[..., 0] < FAR / 2).any(-1)[:, None, None].expand(*state.position.shape[:2], 1)
    distances = nearest.sqrt()
    if spec.conditioned:  # differences of squares: those of roots depend on how a processor rounds them
        middle = distances[..., 4:5]
        distances = conditioned_distances(middle, (nearest - nearest[..., 4:5]) / (distances + middle))
    return torch.where(mask, distances, 0.0), mask


def conditioned_distances(middle: Tensor, differences: Tensor) -> Tensor:
    """What is shown of distances in m from a 3 x 3 grid: the middle one (..., 1), and in the places of the others eight
    times their ``differences`` (..., 9) from it; all of it fades with the distance."""
    level = 1.5 - middle.clamp_max(3.0)
    shown = memory.cat((8 * differences[..., :4], level, 8 * differences[..., 5:]))
    return shown * torch.exp(-0.3 * middle.clamp_max(9.0))


def _dynamic(state: State, time: Tensor, spec: ObservationSpec, scenario: ScenarioSpec) -> tuple[Tensor, Tensor]:
    position, velocity, flying = obstacles.balls_at(state, time)
    offset = position[:, None] - state.position[:, :, None]
    gap = rotation.norm(offset, keepdim=True)
    relative = velocity[:, None] - state.velocity[:, :, None]
    scale = 0.3 if spec.conditioned else 1.0
    place = _passing(offset, relative, spec.lookahead) if spec.lookahead else (scale * gap, scale * offset)
    tokens = memory.cat((*place, scale * relative, (scale * velocity)[:, None].expand_as(relative)))
    seen = (flying & (position[..., 2] >= LANDED))[:, None] & (gap[..., 0] <= scenario.sensing_range)
    return torch.where(seen[..., None], tokens, 0.0), seen


def _passing(offset: Tensor, relative: Tensor, lookahead: float) -> tuple[Tensor, Tensor]:
    """When each ball passes closest over ground, (E, N, M, 1) in s, and its offset (E, N, M, 3) then, squashed.

    The drone is taken to keep its velocity and the ball to fall freely. Offsets m become m / (0.5 m + |m|): near misses
    differ most.
    """
    along = -(offset[..., :2] * relative[..., :2]).sum(-1, keepdim=True)
    time = (along / (relative[..., :2].square().sum(-1, keepdim=True) + 0.5)).clamp(0.0, lookahead)
    drop = offset.new_tensor([0.0, 0.0, GRAVITY / 2]) * time.square()
    miss = offset + relative * time - drop
    return time, miss / (0.5 + rotation.norm(miss, keepdim=True))
