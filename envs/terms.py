"""The terms that objectives are made of: a reward (``conf/reward/``) lists which of them each objective sums.

Every term is a function of one step, ``term(view, **parameters)``, in the sense that more is better: (E, N), or (E, 1)
for one number per team. Three families: smooth ones, which learners that differentiate the reward need; those of the
paper as printed (Sec. V-A), with its shapes r_l(e) = 1 - |e|, r_r(e) = 1/(1 + e) and r_i(e) = 1[e > threshold]; and
those of the authors' release, with its bugs mended (``_compute_reward_and_done``). ``TERMS`` names them all.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from envs import rotation
from envs.dynamics import hover_throttle
from envs.spec import FAR
from envs.step_view import StepView

Term = Callable[..., Tensor]
"""(view, **parameters) to (E, N) or (E, 1)."""


def r_l(error: Tensor) -> Tensor:
    """The paper's linear shape, 1 - |e|."""
    return 1 - error.abs()


def r_r(error: Tensor) -> Tensor:
    """The paper's rational shape, 1/(1 + e), of an error that is not negative."""
    return 1 / (1 + error)


def depth(distance: Tensor, reach: float, scale: float) -> Tensor:
    """Quadratic depth inside ``reach`` m: 0 outside, 1 at ``scale`` m deep."""
    return ((reach - distance).clamp_min(0) / scale).square()


# Of every family


def failure(view: StepView) -> Tensor:
    """-1 for a drone that hits or crashes; in every objective, so that no weights can hide it."""
    return -view.failures()


def team_failure(view: StepView) -> Tensor:
    """-1 for the team when any drone hits or crashes (release: beta)."""
    return -view.failed()


def finish(view: StepView) -> Tensor:
    """1 at a training episode's last step, which only survivors see (release: tau)."""
    return view.last[:, None].to(view.slots)


# Smooth: formation


def size(view: StepView) -> Tensor:
    """1/(1 + e_u), the unnormalised Laplacian distance e_u in m."""
    return r_r(view.events.formation_error)[:, None]


def tether(view: StepView) -> Tensor:
    """-e_u in m: pulls as hard from afar."""
    return -view.events.formation_error[:, None]


def shape(view: StepView, sharpness: float) -> Tensor:
    """1/(1 + (sharpness e)^2), the normalised Laplacian distance e."""
    return r_r((sharpness * view.events.shape_error).square())[:, None]


def spread(view: StepView, reach: float) -> Tensor:
    """Minus the quadratic depth of the closest pair inside ``reach`` m, 1 at 0.4 m deep."""
    return -depth(view.events.drone.amin(-1), reach, 0.4)[:, None]


# Smooth: flight


def speed(view: StepView) -> Tensor:
    """1.5 - sqrt(1 + |v - v*|^2)/2, v in m/s: 1 at v*, linear far from it."""
    return 1.5 - (1 + view.velocity_error().square()).sqrt() / 2


def height(view: StepView) -> Tensor:
    """1 - sqrt((z - z*)^2 + 0.01), z in m."""
    return 1 - (view.height_error().square() + 0.01).sqrt()


def heading(view: StepView) -> Tensor:
    """Cosine between heading and world +x."""
    return rotation.heading_axis(view.state.attitude)[..., 0]


def lag(view: StepView, reach: float) -> Tensor:
    """Minus the m that a drone is behind its slot carried along at v*; no more than ``reach`` m count."""
    return -view.lag().clamp(0, reach)


def centring(view: StepView) -> Tensor:
    """Minus the squared lateral offset of the team, m^2."""
    return -view.state.position[..., 0].mean(-1, keepdim=True).square()


def corridor(view: StepView, reach: float) -> Tensor:
    """Minus the quadratic depth of a drone beyond ``reach`` m to either side of the course, 1 at 0.5 m."""
    return -depth(-view.state.position[..., 0].abs(), -reach, 0.5)


# Smooth: obstacle


def column(view: StepView, reach: float) -> Tensor:
    """Minus the quadratic depth inside ``reach`` m of a column's axis, 1 at 0.5 m deep, summed over columns."""
    return -depth(view.column_distance, reach, 0.5).sum(-1)


def ball(view: StepView, reach: float) -> Tensor:
    """Minus the quadratic depth inside ``reach`` m of a flying ball, 1 at 0.6 m deep, summed over balls."""
    return -depth(view.ball_distance, reach, 0.6).sum(-1)


# Smooth: action


def command_change(view: StepView) -> Tensor:
    """-|a_t - a_(t-1)|^2, the paper's e_net squared."""
    return -view.events.command_change.square()


def throttle_change(view: StepView) -> Tensor:
    """-|theta_t - theta_(t-1)|^2, the paper's e_diff squared."""
    return -view.events.throttle_change.square()


def yaw_rate(view: StepView) -> Tensor:
    """Minus the squared body yaw rate, (rad/s)^2."""
    return -view.yaw_rate().square()


def tilt_rate(view: StepView) -> Tensor:
    """Minus the squared roll and pitch rates, (rad/s)^2."""
    return -view.state.rates[..., :2].square().sum(-1)


# The paper, Sec. V-A: formation


def paper_shape(view: StepView) -> Tensor:
    """r_r of the normalised Laplacian distance."""
    return r_r(view.events.shape_error)[:, None]


def paper_size(view: StepView) -> Tensor:
    """r_r of the squared error of the largest pair distance, m^2."""
    return r_r((view.sizes()[1] - view.target_size()).square())[:, None]


def paper_distance(view: StepView, threshold: float) -> Tensor:
    """-r_i: -1 while the closest pair is nearer than ``threshold`` m."""
    return -(view.sizes()[0] < threshold).to(view.slots)[:, None]


# The paper, Sec. V-A: flight


def paper_heading(view: StepView) -> Tensor:
    """r_l of |h - e_x|."""
    return r_l(view.heading_error())


def paper_velocity(view: StepView) -> Tensor:
    """r_l of |v - v*| in m/s."""
    return r_l(view.velocity_error())


def paper_position(view: StepView) -> Tensor:
    """r_r of the distance in m to the slot carried along at v*; the paper leaves the reference position open."""
    return r_r(rotation.norm(view.state.position - view.schedule()))


def paper_height(view: StepView) -> Tensor:
    """r_l of the altitude error in m."""
    return r_l(view.height_error())


# The paper, Sec. V-A: obstacle and action


def paper_obstacle(view: StepView, reach: float) -> Tensor:
    """The share of ``reach`` m that the closest obstacle leaves free, minus 1; the paper leaves the form open."""
    return torch.minimum(view.events.column, view.events.ball).clamp_max(reach) / reach - 1


def paper_network(view: StepView) -> Tensor:
    """r_l of e_net = |a_t - a_(t-1)|."""
    return r_l(view.events.command_change)


def paper_throttle_change(view: StepView) -> Tensor:
    """r_l of e_diff = |theta_t - theta_(t-1)|."""
    return r_l(view.events.throttle_change)


def paper_throttle(view: StepView) -> Tensor:
    """r_l of e_throt, the throttle sum's excess over hover; the paper leaves what it is measured from open."""
    return r_l(view.state.throttle.sum(-1) - 4 * hover_throttle(view.drone))


def paper_yaw(view: StepView) -> Tensor:
    """r_l of the body yaw rate in rad/s."""
    return r_l(view.yaw_rate())


# The release: formation


def release_size(view: StepView, busy_air: float, all_landed: float) -> Tensor:
    """(1/(1 + (S - S*)^2) + 1/(1 + e_u)) (c + all_landed kappa), S the largest pair distance in m."""
    over = (view.ball_thrown | view.scenarios.throw_time.isinf()).all(-1) & view.ball_thrown.any(-1)
    landed = (over & ~view.active_balls().any(-1)).to(view.slots)[:, None]
    closeness = paper_size(view) + size(view)
    return closeness * (view.calm(busy_air) + all_landed * landed)


def release_shape(view: StepView, busy_air: float) -> Tensor:
    """c (1/(1 + (10 (e - 0.04)/n)^2) - 0.04 n)/2, which peaks at a normalised Laplacian distance e of 0.04."""
    drones = len(view.slots)
    closeness = 1 / (1 + (10 * (view.events.shape_error - 0.04) / drones) ** 2)
    return 0.5 * (closeness - 0.04 * drones)[:, None] * view.calm(busy_air)


def release_touch(view: StepView) -> Tensor:
    """-1 while the closest pair is inside the hit radius."""
    return paper_distance(view, view.scenario.hit_radius)


# The release: flight


def release_height(view: StepView, busy_air: float) -> Tensor:
    """c^2 max(0, 1 - |z - z*|), z in m."""
    return view.calm(busy_air) ** 2 * r_l(view.height_error()).clamp_min(0)


def release_velocity(view: StepView, busy_air: float) -> Tensor:
    """c^2 max(0, max(|v*|, 1) - |v - v*|) in m/s."""
    commanded = rotation.norm(view.slots.new_tensor(view.scenario.velocity)).clamp_min(1.0)
    return view.calm(busy_air) ** 2 * (commanded - view.velocity_error()).clamp_min(0)


def release_heading(view: StepView, busy_air: float) -> Tensor:
    """c max(0, 1 - |h - e_x|)."""
    return view.calm(busy_air) * r_l(view.heading_error()).clamp_min(0)


def release_position(view: StepView, busy_air: float) -> Tensor:
    """c/(1 + m to the end point) at a training episode's last step."""
    end = view.reference(0.9 * view.scenario.duration)
    return view.calm(busy_air) * finish(view) * r_r(rotation.norm(view.state.position - end))


# The release: obstacle


def release_ball(view: StepView, slope: float, hard: float, soft: float, far_cap: float) -> Tensor:
    """The worst active ball's term: -10 inside ``hard`` m, ``slope`` per m from there to ``soft`` m, and the m beyond,
    at most ``far_cap`` of them (the release's are unbounded)."""
    gap = view.ball_distance
    if not gap.shape[-1]:
        return torch.zeros_like(view.events.ball)
    inside = (gap < hard).to(gap)
    near = slope * (gap.clamp(hard, soft) - soft) - 10 * inside + (gap - soft).clamp(0, far_cap)
    return (view.active_balls()[:, None] * near).amin(-1)


def release_column(view: StepView, reach: float) -> Tensor:
    """Minus the m inside ``reach`` of a column's axis, beyond the hit radius; mean over columns, which vanishes."""
    inside = view.column_distance.clamp(view.scenario.hit_radius, reach) - reach
    present = (view.column_distance < FAR / 2).to(inside)
    return inside.sum(-1) / present.sum(-1).clamp_min(1)


def release_nearest_column(view: StepView, reach: float) -> Tensor:
    """The same of the nearest column alone."""
    return view.events.column.clamp(view.scenario.hit_radius, reach) - reach


def release_hit(view: StepView) -> Tensor:
    """-1 per column or ball hit, at most one of each kind."""
    return -view.hits()


# The release: action


def release_throttle(view: StepView, offset: float) -> Tensor:
    """max(0, offset - throttle sum)."""
    return (offset - view.state.throttle.sum(-1)).clamp_min(0)


def release_network(view: StepView) -> Tensor:
    """max(0, 2.5 - |a_t - a_(t-1)|), commands after tanh."""
    return (2.5 - view.events.command_change).clamp_min(0)


def release_yaw(view: StepView) -> Tensor:
    """max(0, 1.5 - |yaw rate|) in rad/s."""
    return (1.5 - view.yaw_rate().abs()).clamp_min(0)


def release_throttle_change(view: StepView) -> Tensor:
    """max(0, 0.5 - |theta_t - theta_(t-1)|)."""
    return (0.5 - view.events.throttle_change).clamp_min(0)


TERMS: dict[str, Term] = {
    term.__name__: term
    for term in (
        *(failure, team_failure, finish),
        *(size, tether, shape, spread, speed, height, heading, lag, centring, corridor),
        *(column, ball, command_change, throttle_change, yaw_rate, tilt_rate),
        *(paper_shape, paper_size, paper_distance, paper_heading, paper_velocity, paper_position, paper_height),
        *(paper_obstacle, paper_network, paper_throttle_change, paper_throttle, paper_yaw),
        *(release_size, release_shape, release_touch, release_height, release_velocity, release_heading),
        *(release_position, release_ball, release_column, release_nearest_column, release_hit),
        *(release_throttle, release_network, release_yaw, release_throttle_change),
    )
}
"""Every term by its name, as rewards name it."""
