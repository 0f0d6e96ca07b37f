"""Rotors and rigid body of a batch of quadrotors (method of the authors' release, integrated as MuJoCo does).

Semi-implicit Euler with body-frame angular velocity, explicit gyroscopic term, exact rotation of the attitude, and
position advanced with the new velocity: the same scheme as MuJoCo's Euler integrator without implicit damping.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from envs import memory, rotation
from envs.spec import DroneSpec, State

GRAVITY = 9.81
"""m/s^2, downwards."""


class Wrench(NamedTuple):
    """What acts on each drone besides gravity."""

    force: Tensor  # (E, N, 3) N, world
    torque: Tensor  # (E, N, 3) N m, body


def respond(throttle: Tensor, motor: Tensor, drone: DroneSpec, dt: float) -> Tensor:
    """Rotor speeds (E, N, 4) after ``dt`` seconds of first-order lag towards a motor command in shares of full PWM.

    The rotor's target is the square root of the biased command (release: ``rotor_group.py``); the lag is continuous,
    so that it does not change with ``dt`` (the release hides 0.01 s in it).
    """
    target = (motor + drone.thrust_bias).clamp(1e-8, 1.0).sqrt()
    return throttle + (1 - math.exp(-dt / drone.motor_time_constant)) * (target - throttle)


def hover_throttle(drone: DroneSpec) -> float:
    """Rotor speed, as a share of its maximum, whose thrust carries the drone's weight."""
    return math.sqrt(drone.mass * GRAVITY / (4 * drone.max_thrust))


def hover_command(drone: DroneSpec) -> float:
    """Thrust command in [-1, 1] that hovers, the motor map's bias included (0.038 for the release's Crazyflie)."""
    return 2 * (hover_throttle(drone) ** 2 - drone.thrust_bias) - 1


def hover_action(drone: DroneSpec) -> tuple[float, float, float, float]:
    """The action in [-1, 1] that hovers: level with the hover command, or four equal rotor thrusts."""
    hover = hover_command(drone)
    return (hover, hover, hover, hover) if drone.command == "rotor" else (0.0, 0.0, 0.0, hover)


def rotor_wrench(throttle: Tensor, attitude: Tensor, drone: DroneSpec) -> Wrench:
    """Thrust along body z and torques of four rotors (E, N, 4) turning at ``throttle``."""
    square = throttle.square()
    thrust = square * drone.max_thrust
    x = square.new_tensor([p[0] for p in drone.rotor_positions])
    y = square.new_tensor([p[1] for p in drone.rotor_positions])
    spin = square.new_tensor(drone.rotor_directions)
    torque = memory.stack(((thrust * y).sum(-1), -(thrust * x).sum(-1), -(square * spin).sum(-1) * drone.max_torque))
    return Wrench(thrust.sum(-1, keepdim=True) * rotation.up_axis(attitude), torque)


def downwash(position: Tensor, thrust: Tensor, drone: DroneSpec) -> Tensor:
    """Force (E, N, 3) on each drone in the wakes of the others; zero between drones at one height.

    ``thrust`` (E, N, 3) is the thrust vector of each drone (release: ``multirotor.py : downwash``).
    """
    axis = thrust / rotation.norm(thrust, keepdim=True)
    above = position[:, None, :, :] - position[:, :, None, :]  # (E, i, j, 3): from i up to j
    along = (above * axis[:, None]).sum(-1).clamp_min(1e-2)
    across = (above.square().sum(-1) - along.square()).clamp_min(0)
    wake = (
        torch.exp(-0.5 * drone.downwash_radial**2 * across / along.square()) / (1 + drone.downwash_axial * along) ** 2
    )
    others = 1 - torch.eye(position.shape[1], dtype=wake.dtype, device=wake.device)
    return -((wake * others)[..., None] * thrust[:, None]).sum(2)


def external_wrench(state: State, drone: DroneSpec) -> Wrench:
    """Rotors, damping and downwash on each drone, for the throttles in ``state``."""
    force, torque = rotor_wrench(state.throttle, state.attitude, drone)
    if drone.downwash_axial >= 0:
        force = force + downwash(state.position, force, drone)
    inertia = torque.new_tensor(drone.inertia)
    force = force - drone.linear_damping * drone.mass * state.velocity
    return Wrench(force, torque - drone.angular_damping * inertia * state.rates)


def integrate(state: State, wrench: Wrench, drone: DroneSpec, dt: float) -> State:
    """One semi-implicit Euler step of the rigid bodies under ``wrench`` and gravity."""
    inertia = wrench.torque.new_tensor(drone.inertia)
    gyroscopic = torch.linalg.cross(state.rates, inertia * state.rates)
    rates = state.rates + dt * (wrench.torque - gyroscopic) / inertia
    gravity = wrench.force.new_tensor([0.0, 0.0, -GRAVITY])
    velocity = state.velocity + dt * (wrench.force / drone.mass + gravity)
    attitude = rotation.multiply(state.attitude, rotation.exponential(rates * dt))
    attitude = attitude / rotation.norm(attitude, keepdim=True)
    return state._replace(position=state.position + dt * velocity, attitude=attitude, velocity=velocity, rates=rates)
