"""The reward of Swarm-RL (Huang et al. 2023, Sec. III-B; Batra et al. 2021), with the paper's velocity term.

Costs as published: distance to the goal, thrust, attitude, spin, floor and nearness of drones at every step, and a lump
for every contact that begins. They are sorted into the objectives: flight holds goal, velocity, attitude and floor,
obstacle all that concerns collisions (which the learner anneals), action thrust and spin; formation is empty, because
Swarm-RL has no such term. Objectives are summed with equal weights. ``obstacle_near``, 0 as published, makes nearness
of columns and balls cost too.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.swarm_rl.course import displacement
from envs import memory, obstacles, rotation
from envs.spec import FAR
from envs.step_view import StepView


@dataclass(frozen=True)
class SwarmRlReward:
    """Its coefficients (``conf/reward/swarm_rl.yaml``)."""

    target: str
    interval: float  # s, that the costs of a step are multiplied by
    goal: float
    velocity: float
    thrust: float
    floor: float
    attitude: float
    spin: float
    drone_hit: float
    column_hit: float
    ball_hit: float
    near: float
    near_distance: float
    obstacle_near: float
    obstacle_distance: float
    drone_contact: float
    column_contact: float
    ball_contact: float
    carrot: float
    beyond: float
    limit: float

    def __call__(self, view: StepView) -> Tensor:
        state = view.state
        floor = (state.position[..., 2] < view.scenario.altitude[0]).to(view.slots)
        away = _away(displacement(state.position, view.slots, view.scenario, self.carrot, self.beyond))
        tilt = torch.where(floor > 0, 1.0, -rotation.up_axis(state.attitude)[..., 2])
        flight = self.goal * away + self.velocity * view.velocity_error() + self.floor * floor + self.attitude * tilt
        action = self.thrust * rotation.norm(state.command) + self.spin * rotation.norm(state.rates)
        column, ball, drone = _gaps(view)
        near = self.near * self._nearness(view) + self.obstacle_near * (self._close(column) + self._close(ball))
        obstacle = self._contacts(view, column, ball, drone) + view.drone.control_period * near
        return memory.stack(
            (
                torch.zeros_like(flight),
                -(self.interval * flight).clamp(-self.limit, self.limit),
                -obstacle.clamp(-self.limit, self.limit),
                -self.interval * action,
            )
        )

    def _contacts(self, view: StepView, column: Tensor, ball: Tensor, drone: Tensor) -> Tensor:
        """What the contacts (E, N) cost that began in this step, from the distances (E, N) at its start."""
        events = view.events
        return (
            self.column_hit * _began(column, events.column, self.column_contact)
            + self.ball_hit * _began(ball, events.ball, self.ball_contact)
            + self.drone_hit * _began(drone, events.drone, self.drone_contact)
        )

    def _nearness(self, view: StepView) -> Tensor:
        """Sum over the other drones (E, N): 1 at the same place, 0 from ``near_distance`` on."""
        gaps = _pairs(view.state.position)
        return (1 - gaps / self.near_distance).clamp_min(0).sum(-1)

    def _close(self, gap: Tensor) -> Tensor:
        """1 at an obstacle's centre, 0 from ``obstacle_distance`` on, of drones ``gap`` (E, N) m from it."""
        return (1 - gap / self.obstacle_distance).clamp_min(0)


def _away(offset: Tensor) -> Tensor:
    """Distance (E, N) in m along the line plus aside of it, of drones ``offset`` (E, N, 3) from their goals.

    In the length of the offset, a goal that stays ahead would all but hide what a drone has strayed aside.
    """
    return offset[..., 1].abs() + rotation.norm(offset[..., ::2])


def _began(before: Tensor, least: Tensor, radius: float) -> Tensor:
    """1 where a step came within ``radius`` m of what it had not been within at its start, else 0."""
    return ((before > radius) & (least <= radius)).to(before)


def _gaps(view: StepView) -> tuple[Tensor, Tensor, Tensor]:
    """Distances (E, N) in m at the start of the step to the nearest column axis, flying ball and drone."""
    before = view.before
    axes = view.scenarios.columns[:, None]
    column = obstacles.least(rotation.norm(before.position[:, :, None, :2] - axes))
    position, _, flying = obstacles.balls_at(before, before.step * view.drone.control_period)
    ball = rotation.norm(position[:, None] - before.position[:, :, None])
    ball = obstacles.least(torch.where(flying[:, None], ball, FAR))
    return column, ball, _pairs(before.position).amin(-1)


def _pairs(position: Tensor) -> Tensor:
    """Distances (E, N, N) in m between drones, FAR from one to itself."""
    gaps = rotation.norm(position[:, :, None] - position[:, None])
    return gaps + FAR * torch.eye(position.shape[1], dtype=gaps.dtype, device=gaps.device)
