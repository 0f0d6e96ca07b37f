"""What a reward may look at: one step of every episode, its events and the task."""

from typing import NamedTuple

import torch
from torch import Tensor

from envs import rotation
from envs.spec import FAR, DroneSpec, Events, Scenarios, ScenarioSpec, State


class StepView(NamedTuple):
    """One step of E episodes: its start and end, what happened, and the quantities that objectives are made of."""

    before: State  # its start, this step's throws made
    state: State  # its end
    events: Events
    column_distance: Tensor  # (E, N, C) m, least along the step, to each axis
    ball_distance: Tensor  # (E, N, M) m, least along the step, to each ball's centre while it flies
    ball_position: Tensor  # (E, M, 3) m
    ball_velocity: Tensor  # (E, M, 3) m/s
    ball_thrown: Tensor  # (E, M)
    ball_flying: Tensor  # (E, M)
    last: Tensor  # (E,) whether this is the training episode's last step
    crashed: Tensor  # (E, N) below the ground limit or above the ceiling
    slots: Tensor  # (N, 3) m
    scenarios: Scenarios
    scenario: ScenarioSpec
    drone: DroneSpec

    def velocity_error(self) -> Tensor:
        """|v* - v| (E, N) in m/s."""
        return rotation.norm(self.state.velocity - self.state.velocity.new_tensor(self.scenario.velocity))

    def height_error(self) -> Tensor:
        """z minus the commanded altitude (E, N) in m."""
        return self.state.position[..., 2] - self.scenario.height

    def heading_error(self) -> Tensor:
        """|h - e_x| (E, N): the required heading is world +x, across the direction of flight."""
        forward = self.state.position.new_tensor([1.0, 0.0, 0.0])
        return rotation.norm(rotation.heading_axis(self.state.attitude) - forward)

    def yaw_rate(self) -> Tensor:
        """Body yaw rate (E, N) in rad/s."""
        return self.state.rates[..., 2]

    def sizes(self) -> tuple[Tensor, Tensor]:
        """Smallest and largest drone pair distance (E,) in m."""
        gaps = rotation.norm(self.state.position[:, :, None] - self.state.position[:, None])
        itself = FAR * torch.eye(gaps.shape[-1], dtype=gaps.dtype, device=gaps.device)
        return (gaps + itself).amin((-1, -2)), gaps.amax((-1, -2))

    def target_size(self) -> Tensor:
        """Largest pair distance of the target formation, a scalar in m."""
        return rotation.norm(self.slots[:, None] - self.slots).amax()

    def lag(self) -> Tensor:
        """How far each drone is behind its slot carried along the course at v*, (E, N) in m; negative ahead of it."""
        return self.schedule()[..., 1] - self.state.position[..., 1]

    def schedule(self) -> Tensor:
        """Where the slots carried along at v* are at the step's end, (E, N, 3) in m."""
        return self.reference(self.state.step * self.drone.control_period)

    def reference(self, time: Tensor | float) -> Tensor:
        """Slots carried along the course at v* for ``time`` s, (..., N, 3) in m."""
        moved = torch.as_tensor(time, dtype=self.slots.dtype, device=self.slots.device)[..., None, None]
        start, velocity = self.slots.new_tensor(self.scenario.start), self.slots.new_tensor(self.scenario.velocity)
        return start + self.slots + velocity * moved

    def hits(self) -> Tensor:
        """Number of columns or balls hit by each drone, at most one of each kind (E, N)."""
        radius = self.scenario.hit_radius
        return (self.events.column < radius).to(self.slots) + (self.events.ball < radius).to(self.slots)

    def active_balls(self) -> Tensor:
        """Whether each ball (E, M) still matters: thrown, and neither landed nor falling below 0.5 m (release)."""
        falling = (self.ball_velocity[..., 2] < 1e-6) & (self.ball_position[..., 2] < 0.5)
        return self.ball_thrown & self.ball_flying & ~falling

    def calm(self, busy_air: float) -> Tensor:
        """The release's gate c (E, 1): 1, or ``busy_air`` while any ball is active."""
        return torch.where(self.active_balls().any(-1), busy_air, 1.0)[:, None]

    def failures(self) -> Tensor:
        """1 for every drone that hit anything or crashed in this step, else 0, (E, N)."""
        met = self.events.drone < self.scenario.hit_radius
        return ((self.hits() > 0) | met | self.crashed).to(self.slots)

    def failed(self) -> Tensor:
        """1 where any drone of the team hit anything or crashed in this step, else 0, (E, 1)."""
        return self.failures().amax(-1, keepdim=True)
