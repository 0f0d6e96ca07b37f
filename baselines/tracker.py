"""From a trajectory to CTBR commands: a geometric position, velocity and attitude tracker, and the motor map inverted.

Planners think in positions, velocities and accelerations; the drone listens to the commands a policy sends. Between the
two stands the cascade of Lee, Leok and McClamroch (CDC 2010) with body rates as its last output, because the rate loop
is the drone's own: accelerations from position and velocity errors, an attitude whose body z points along the wanted
specific force, rates proportional to the attitude error, and thrust projected on the actual body z.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from envs import rotation
from envs.dynamics import GRAVITY
from envs.spec import DroneSpec, State


@dataclass(frozen=True)
class TrackerSpec:
    """Gains and limits of the tracker (``conf/baseline/tracker/``)."""

    position_gain: float  # 1/s^2
    velocity_gain: float  # 1/s
    attitude_gain: tuple[float, float, float]  # 1/s, body x, y, z
    max_tilt: float  # rad, of the wanted body z
    thrust_reserve: float  # share of the usable thrust kept for attitude control


class Reference(NamedTuple):
    """Where every drone should be and how it should move: world frame, shapes (E, N, ...)."""

    position: Tensor  # (E, N, 3) m
    velocity: Tensor  # (E, N, 3) m/s
    acceleration: Tensor  # (E, N, 3) m/s^2
    jerk: Tensor  # (E, N, 3) m/s^3
    yaw: Tensor  # (E, N) rad, of body x against world x; the task asks for 0

    @classmethod
    def moving(cls, position: Tensor, velocity: Tensor) -> "Reference":
        """A place that moves at a steady velocity, with heading world +x."""
        still = torch.zeros_like(position)
        return cls(position, velocity, still, still, still[..., 0])


def track(state: State, reference: Reference, drone: DroneSpec, spec: TrackerSpec) -> Tensor:
    """Command (E, N, 4) in [-1, 1] (roll, pitch, yaw rate, thrust) that steers each drone towards its reference."""
    force = specific_force(state, reference, drone, spec)
    axes = torch.stack(
        (rotation.heading_axis(state.attitude), rotation.left_axis(state.attitude), rotation.up_axis(state.attitude)),
        -2,
    )
    magnitude = rotation.norm(force)
    gain = force.new_tensor(spec.attitude_gain)
    rates = gain * attitude_error(axes, attitude(force, reference.yaw))
    rates = rates + feed_forward(axes, magnitude, reference.jerk)
    thrust = drone.mass * (force * axes[..., 2, :]).sum(-1)
    return command(rates, thrust, drone)


def specific_force(state: State, reference: Reference, drone: DroneSpec, spec: TrackerSpec) -> Tensor:
    """Thrust per mass (E, N, 3) in m/s^2, world frame, that the tracker wants; damping is compensated.

    What the rotors cannot do is cut back sideways first: the vertical part keeps the drone in the air.
    """
    wanted = (
        spec.position_gain * (reference.position - state.position)
        + spec.velocity_gain * (reference.velocity - state.velocity)
        + reference.acceleration
        + drone.linear_damping * state.velocity
    )
    strongest = max_specific_force(drone) * (1 - spec.thrust_reserve)
    up = (wanted[..., 2:] + GRAVITY).clamp(0.3 * GRAVITY, strongest)
    sideways = wanted[..., :2]
    room = torch.minimum((strongest**2 - up.square()).clamp_min(0).sqrt(), math.tan(spec.max_tilt) * up)
    return torch.cat((sideways * (room / rotation.norm(sideways, keepdim=True)).clamp_max(1), up), -1)


def max_specific_force(drone: DroneSpec) -> float:
    """Largest thrust per mass in m/s^2 that a command can ask for: the clamp on thrust, then the motor map's bias."""
    return min(drone.thrust_range[1] + drone.thrust_bias, 1.0) * 4 * drone.max_thrust / drone.mass


def attitude(force: Tensor, yaw: Tensor) -> Tensor:
    """Body axes as rows (E, N, 3, 3): z along ``force`` (E, N, 3), x as near to heading ``yaw`` (E, N) as can be."""
    up = force / rotation.norm(force, keepdim=True)
    heading = torch.stack((yaw.cos(), yaw.sin(), torch.zeros_like(yaw)), -1)
    left = torch.linalg.cross(up, heading)
    left = left / rotation.norm(left, keepdim=True)
    return torch.stack((torch.linalg.cross(left, up), left, up), -2)


def attitude_error(axes: Tensor, wanted: Tensor) -> Tensor:
    """Rotation (E, N, 3) in the body frame that leads from ``axes`` to ``wanted``, of length sin(angle).

    Half the sum of the cross products of the axes is Lee's error, vee(R^T R_d - R_d^T R) / 2.
    """
    world = torch.linalg.cross(axes, wanted).sum(-2) / 2
    return torch.matmul(axes, world[..., None]).squeeze(-1)


def feed_forward(axes: Tensor, magnitude: Tensor, jerk: Tensor) -> Tensor:
    """Body rates (E, N, 3) in rad/s that turn a specific force of ``magnitude`` (E, N) with ``jerk`` (E, N, 3)."""
    along = torch.matmul(axes, jerk[..., None]).squeeze(-1) / magnitude[..., None]
    return torch.stack((-along[..., 1], along[..., 0], torch.zeros_like(magnitude)), -1)


def command(rates: Tensor, thrust: Tensor, drone: DroneSpec) -> Tensor:
    """Command (E, N, 4) for body rates (E, N, 3) in rad/s and collective thrust (E, N) in N.

    Inverts :func:`envs.control.ctbr` and the motor map: a rotor at share c of full scale pushes with c + thrust_bias.
    """
    reach = min(drone.rate_clip / drone.rate_limit, 1.0)
    share = thrust / (4 * drone.max_thrust) - drone.thrust_bias
    collective = 2 * share.clamp(*drone.thrust_range) - 1
    return torch.cat(((rates / drone.rate_limit).clamp(-reach, reach), collective[..., None]), -1)
