"""Reward vectors (E, N, 4) in the order formation, flight, obstacle, action (paper, Sec. IV-A).

Three readings of the paper's objectives, each a frozen dataclass whose coefficients stand in ``conf/reward/``:
``ReleaseReward`` (the authors' code with its bugs mended), ``PaperReward`` (the shapes r_l, r_r, r_i as printed) and
``ShapedReward`` (smooth everywhere but for the hits: what learns fastest on few cores). Scalarising is the learner's.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from envs import memory, rotation
from envs.dynamics import hover_throttle
from envs.spec import FAR, DroneSpec, Events, Scenarios, ScenarioSpec, State


class StepView(NamedTuple):
    """What a reward may look at: one step's end, its events and the task."""

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

    def failures(self) -> Tensor:
        """1 for every drone that hit anything or crashed in this step, else 0, (E, N)."""
        met = self.events.drone < self.scenario.hit_radius
        return ((self.hits() > 0) | met | self.crashed).to(self.slots)

    def failed(self) -> Tensor:
        """1 where any drone of the team hit anything or crashed in this step, else 0, (E, 1)."""
        return self.failures().amax(-1, keepdim=True)


class Reward(Protocol):
    """A reward vector as a function of one step."""

    def __call__(self, view: StepView) -> Tensor:
        """(E, N, 4)."""
        ...


def _stack(formation: Tensor, flight: Tensor, obstacle: Tensor, action: Tensor) -> Tensor:
    """The vector in the order of OBJECTIVES: (E, N) each, or (E, 1) for one number per team."""
    return memory.stack((formation, flight, obstacle, action))


@dataclass(frozen=True)
class ShapedReward:
    """Smooth terms sorted into the four objectives; a failure costs each of them the same, whatever their weights."""

    target: str
    size: float
    tether: float
    shape: float
    shape_sharpness: float
    spread: float
    spread_reach: float
    speed: float
    height: float
    heading: float
    lag: float
    lag_reach: float
    centring: float
    corridor: float
    corridor_reach: float
    column: float
    column_reach: float
    ball: float
    ball_reach: float
    command_change: float
    throttle_change: float
    yaw_rate: float
    tilt_rate: float
    failure: float

    def __call__(self, view: StepView) -> Tensor:
        state, events = view.state, view.events
        formation = (
            self.size / (1 + events.formation_error)
            - self.tether * events.formation_error
            + self.shape / (1 + (self.shape_sharpness * events.shape_error) ** 2)
        )
        crowd = _inside(events.drone.amin(-1), self.spread_reach, 0.4)
        formation = (formation - self.spread * crowd)[:, None]
        outside = _inside(-state.position[..., 0].abs(), -self.corridor_reach, 0.5)
        flight = (
            self.speed * (1.5 - (1 + view.velocity_error().square()).sqrt() / 2)
            + self.height * (1 - (view.height_error().square() + 0.01).sqrt())
            + self.heading * rotation.heading_axis(state.attitude)[..., 0]
            - self.lag * view.lag().clamp(0, self.lag_reach)
            - self.centring * state.position[..., 0].mean(-1, keepdim=True).square()
            - self.corridor * outside
        )
        obstacle = -self.column * _inside(view.column_distance, self.column_reach, 0.5).sum(-1) - self.ball * _inside(
            view.ball_distance, self.ball_reach, 0.6
        ).sum(-1)
        action = -(
            self.command_change * events.command_change.square()
            + self.throttle_change * events.throttle_change.square()
            + self.yaw_rate * view.yaw_rate().square()
            + self.tilt_rate * state.rates[..., :2].square().sum(-1)
        )
        failed = self.failure * view.failures()
        return _stack(formation - failed, flight - failed, obstacle - failed, action - failed)


def _inside(distance: Tensor, reach: float, scale: float) -> Tensor:
    """Quadratic depth inside ``reach`` m, 1 at ``scale`` m deep."""
    return ((reach - distance).clamp_min(0) / scale).square()


@dataclass(frozen=True)
class PaperReward:
    """The paper's shapes: r_l(e) = 1 - |e|, r_r(e) = 1/(1 + e), r_i(e) = 1[e > threshold] (Sec. IV-A).

    The paper leaves the alphas, the thresholds, the reference position and the obstacle term open. Here the reference
    is the slot carried along at v*, e_throt is measured from hover, and the obstacle term is the share of
    ``obstacle_reach`` that the closest obstacle leaves free.
    """

    target: str
    shape: float
    size: float
    distance: float
    distance_threshold: float
    heading: float
    velocity: float
    position: float
    height: float
    obstacle: float
    obstacle_reach: float
    network: float
    throttle_change: float
    throttle: float
    yaw: float
    failure: float

    def __call__(self, view: StepView) -> Tensor:
        smallest, largest = view.sizes()
        failed = self.failure * view.failed()
        formation = (
            self.shape / (1 + view.events.shape_error)
            + self.size / (1 + (largest - view.target_size()).square())
            - self.distance * (smallest < self.distance_threshold)
        )[:, None] - failed
        away = rotation.norm(view.state.position - view.schedule())
        flight = (
            self.heading * (1 - view.heading_error())
            + self.velocity * (1 - view.velocity_error())
            + self.position / (1 + away)
            + self.height * (1 - view.height_error().abs())
            - failed
        )
        closest = torch.minimum(view.events.column, view.events.ball).clamp_max(self.obstacle_reach)
        obstacle = self.obstacle * (closest / self.obstacle_reach - 1) - failed
        excess = view.state.throttle.sum(-1) - 4 * hover_throttle(view.drone)
        action = (
            self.network * (1 - view.events.command_change)
            + self.throttle_change * (1 - view.events.throttle_change)
            + self.throttle * (1 - excess.abs())
            + self.yaw * (1 - view.yaw_rate().abs())
            - failed
        )
        return _stack(formation, flight, obstacle, action)


@dataclass(frozen=True)
class ReleaseReward:
    """The authors' code, term by term (release: ``_compute_reward_and_done``; method facts, Sec. 5).

    Mended: the previous command advances (it is frozen there), the rate loop is reset (it leaks there), and the
    unbounded positive ball term is capped at ``ball_far_cap`` (0 drops it). Commands are compared after tanh.
    """

    target: str
    size: float
    shape: float
    near: float
    near_distance: float
    touch: float
    clean: float
    failure: float
    height: float
    velocity: float
    heading: float
    position: float
    busy_air: float
    all_landed: float
    ball: float
    ball_soft: float
    ball_hard_distance: float
    ball_soft_distance: float
    ball_far_cap: float
    column: float
    column_reach: float
    column_nearest: bool
    hit: float
    throttle: float
    throttle_offset: float
    network: float
    yaw: float
    throttle_change: float

    def __call__(self, view: StepView) -> Tensor:
        falling = (view.ball_velocity[..., 2] < 1e-6) & (view.ball_position[..., 2] < 0.5)
        active = view.ball_thrown & view.ball_flying & ~falling
        calm = torch.where(active.any(-1), self.busy_air, 1.0)[:, None]  # c of the release, (E, 1)
        over = (view.ball_thrown | view.scenarios.throw_time.isinf()).all(-1) & view.ball_thrown.any(-1)
        landed = (over & ~active.any(-1)).to(view.slots)[:, None]
        ending = self.clean * view.last[:, None] - self.failure * view.failed()
        return _stack(
            self._formation(view, calm, landed) + ending,
            self._flight(view, calm) + ending,
            self._obstacle(view, active) + ending,
            self._action(view) + ending,
        )

    def _formation(self, view: StepView, calm: Tensor, landed: Tensor) -> Tensor:
        drones = len(view.slots)
        smallest, largest = view.sizes()
        error = view.events.shape_error
        shape = 0.5 * (1 / (1 + (10 * (error - 0.04) / drones) ** 2) - 0.04 * drones)
        size = 1 / (1 + (largest - view.target_size()).square()) + 1 / (1 + view.events.formation_error)
        near = self.near * (smallest < self.near_distance) + self.touch * (smallest < view.scenario.hit_radius)
        return (
            self.size * size[:, None] * (calm + self.all_landed * landed)
            + self.shape * shape[:, None] * calm
            - near[:, None]
        )

    def _flight(self, view: StepView, calm: Tensor) -> Tensor:
        commanded = rotation.norm(view.slots.new_tensor(view.scenario.velocity)).clamp_min(1.0)
        end = view.reference(0.9 * view.scenario.duration)
        arrival = view.last[:, None] / (1 + rotation.norm(view.state.position - end))
        return calm * (
            calm * self.height * (1 - view.height_error().abs()).clamp_min(0)
            + calm * self.velocity * (commanded - view.velocity_error()).clamp_min(0)
            + self.heading * (1 - view.heading_error()).clamp_min(0)
            + self.position * arrival
        )

    def _obstacle(self, view: StepView, active: Tensor) -> Tensor:
        gap = view.ball_distance
        hard = (gap < self.ball_hard_distance).to(gap)
        soft = gap.clamp(self.ball_hard_distance, self.ball_soft_distance) - self.ball_soft_distance
        far = (gap - self.ball_soft_distance).clamp(0, self.ball_far_cap)
        near = active[:, None] * (self.ball_soft * soft - 10 * hard + far)
        worst = near.amin(-1) if near.shape[-1] else torch.zeros_like(view.events.ball)
        depth = view.column_distance.clamp(view.scenario.hit_radius, self.column_reach) - self.column_reach
        present = (view.column_distance < FAR / 2).to(depth)
        shaping = depth.sum(-1) / present.sum(-1).clamp_min(1)
        if self.column_nearest:
            shaping = -(-depth).amax(-1) if depth.shape[-1] else shaping
        return self.ball * worst + self.column * shaping - self.hit * view.hits()

    def _action(self, view: StepView) -> Tensor:
        events = view.events
        return (
            self.throttle * (self.throttle_offset - view.state.throttle.sum(-1)).clamp_min(0)
            + self.network * (2.5 - events.command_change).clamp_min(0)
            + self.yaw * (1.5 - view.yaw_rate().abs()).clamp_min(0)
            + self.throttle_change * (0.5 - events.throttle_change).clamp_min(0)
        )
