"""What a drone sees (Swarm-RL, Sec. III; the paper, Sec. VI: balls are added).

| group | shape | content |
|---|---|---|
| self | (E, N, 1, 19) | p - goal, v, rotation matrix row by row, body rates, height |
| drones | (E, N, 1, 6 K) | p_j - p, v_j - v of K neighbours side by side |
| static | (E, N, 1, 9) | signed distances to the columns at 3 x 3 points around the drone, x outer |
| dynamic | (E, N, 1, 6 B) | p_b - p, v_b - v of B balls side by side, zeros where none is seen |

World frame, raw metres and m/s. Where there are more than K neighbours, or any number of balls, those with the least
distance plus range rate are seen: near ones, and above all those that come nearer.

``conditioned``, an invertible change of variables, scales the numbers and shows the distances as the one in the middle
and the differences from it: the direction of a column lies in centimetres.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.swarm_rl.course import displacement
from envs import messages, obstacles, rotation, shapes
from envs.observation import conditioned_distances
from envs.spec import FAR, Observation, ObservationLayout, Scenarios, ScenarioSpec, State

GRID = 0.1
"""m, spacing of the points whose distances are observed."""

NEAREST = 0.01
"""m, least distance in the ranking."""

SCALES = {"self": (0.5,) * 6 + (1.0,) * 9 + (0.1,) * 3 + (1.0,), "drones": 0.5, "dynamic": 0.3}
"""Conditioned: 1/m, s/m and s/rad of the numbers of each group."""

NOTHING = 100.0
"""m, distance to the axis of a column where there is none."""


@dataclass(frozen=True)
class SwarmRlObservation:
    """How much of it is seen (``conf/observation/swarm_rl.yaml``)."""

    name: str
    neighbours: int  # K
    balls: int  # B
    reach: float  # m, clip of relative positions of neighbours
    speed: float  # m/s, clip of relative velocities of neighbours
    carrot: float  # m, the goal shown is at most this far ahead
    beyond: float  # m, from the goal line to the rearmost slot of the destination
    conditioned: bool = False  # scaled inputs, distances as differences; policies of before do not say

    def layout(self, scenario: ScenarioSpec) -> ObservationLayout:
        """Widths of the observation groups."""
        drones = len(shapes.slots(scenario))
        return ObservationLayout(self.name, drones, 19, 6 * self.neighbours, 9, 6 * self.balls)

    def observe(
        self, state: State, scenarios: Scenarios, time: Tensor, scenario: ScenarioSpec, slots: Tensor
    ) -> Observation:
        """Observation groups of every drone; ``time`` is (E,) in s and ``slots`` (N, 3) in m."""
        groups = {
            "self": own(state, displacement(state.position, slots, scenario, self.carrot, self.beyond)),
            "drones": self._neighbours(state, messages.neighbours(state, scenarios, time, scenario.messages)),
            "static": signed_distances(state.position, scenarios.columns, scenario.column_radius),
            "dynamic": self._balls(state, time, scenario),
        }
        if self.conditioned:
            scaled = {name: x * x.new_tensor(SCALES[name]) for name, x in groups.items() if name in SCALES}
            middle = groups["static"][..., 4:5]
            groups |= scaled | {"static": conditioned_distances(middle, groups["static"] - middle)}
        return {name: x.unsqueeze(2).contiguous() for name, x in groups.items()}

    def _neighbours(self, state: State, known: messages.Neighbours) -> Tensor:
        """(E, N, 6 K); all of them in their order where there are K, zeros for those that are missing."""
        count = state.position.shape[1]
        offset = known.position - state.position[:, :, None]
        velocity = known.velocity - state.velocity[:, :, None]
        clipped = (offset.clamp(-self.reach, self.reach), velocity.clamp(-self.speed, self.speed))
        tokens = torch.cat(clipped, -1)
        if count - 1 > self.neighbours:
            tokens = _first(tokens, urgency(offset, velocity), self.neighbours)
        return _side_by_side(tokens, self.neighbours)

    def _balls(self, state: State, time: Tensor, scenario: ScenarioSpec) -> Tensor:
        """(E, N, 6 B) of the balls in the air and within sensing range."""
        position, velocity, flying = obstacles.balls_at(state, time)
        offset = position[:, None] - state.position[:, :, None]
        relative = velocity[:, None] - state.velocity[:, :, None]
        seen = flying[:, None] & (rotation.norm(offset) <= scenario.sensing_range)
        tokens = torch.where(seen[..., None], torch.cat((offset, relative), -1), 0.0)
        rank = torch.where(seen, urgency(offset, relative), FAR)
        return _side_by_side(_first(tokens, rank, min(self.balls, tokens.shape[2])), self.balls)


def own(state: State, offset: Tensor) -> Tensor:
    """(E, N, 19) of drones that are ``offset`` (E, N, 3) m from their goals."""
    axes = (rotation.heading_axis(state.attitude), rotation.left_axis(state.attitude), rotation.up_axis(state.attitude))
    matrix = torch.stack(axes, -1).flatten(-2)  # the axes are its columns
    return torch.cat((offset, state.velocity, matrix, state.rates, state.position[..., 2:]), -1)


def urgency(offset: Tensor, velocity: Tensor) -> Tensor:
    """Distance plus range rate (...,) of what is at ``offset`` (..., 3) m and moves at ``velocity`` relative to one."""
    distance = rotation.norm(offset).clamp_min(NEAREST)
    return distance + (offset * velocity).sum(-1) / distance


def signed_distances(position: Tensor, columns: Tensor, radius: float) -> Tensor:
    """Least horizontal distance minus ``radius`` (E, N, 9) in m from points around drones (E, N, 3) to axes (E, C, 2).

    A column that stands at ``FAR`` is absent.
    """
    steps = torch.tensor([-GRID, 0.0, GRID], dtype=position.dtype, device=position.device)
    around = position[:, :, None, :2] + torch.cartesian_prod(steps, steps)
    squared = (around[:, :, :, None] - columns[:, None, None]).square().sum(-1)
    return obstacles.least(squared).sqrt().clamp_max(NOTHING) - radius


def _first(tokens: Tensor, rank: Tensor, count: int) -> Tensor:
    """The ``count`` tokens (E, N, T, d) of lowest ``rank`` (E, N, T), in its order."""
    chosen = rank.topk(count, dim=-1, largest=False).indices
    return tokens.gather(2, chosen[..., None].expand(*chosen.shape, tokens.shape[-1]))


def _side_by_side(tokens: Tensor, places: int) -> Tensor:
    """Tokens (E, N, T, d) in one row (E, N, places * d), zeros behind them."""
    return torch.nn.functional.pad(tokens, (0, 0, 0, places - tokens.shape[2])).flatten(2)
