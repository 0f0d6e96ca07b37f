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


class Conditions(NamedTuple):
    """What a flight differs in from the model in still air, for one command; None where it does not."""

    vehicle: Tensor | None = None  # (E, N, 3) factors on mass, rotor thrust and motor lag
    wind: Tensor | None = None  # (E, N, 3) m/s, of the air at each drone
    ground_effect: bool = False


MODEL = Conditions()
"""The craft as ``conf/drone`` says, in still air."""


def respond(throttle: Tensor, motor: Tensor, drone: DroneSpec, dt: float, lag: Tensor | None = None) -> Tensor:
    """Rotor speeds (E, N, 4) after ``dt`` seconds of lag towards a motor command in shares of full PWM.

    The rotor's target is the speed whose thrust is the biased command (release: ``rotor_group.py``; the firmware maps
    PWM to thrust likewise). Rotors follow ``drone.spin_up`` and ``drone.spin_down``, integrated exactly, so that the
    lag does not change with ``dt`` (the release hides 0.01 s in it). ``lag`` (E, N, 1) is a factor on the motors' time
    constant.
    """
    target = speed_for((motor + drone.thrust_bias).clamp(1e-8, 1.0), drone.thrust_curve)
    time = dt / drone.motor_time_constant
    if drone.spin_up == drone.spin_down == (1.0, 0.0):  # first order
        left = math.exp(-time) if lag is None else torch.exp(-time / lag)
        return throttle + (1 - left) * (target - throttle)
    gap, rising = target - throttle, target > throttle
    first, second = (torch.where(rising, up, down) for up, down in zip(drone.spin_up, drone.spin_down, strict=True))
    rate = first + 2 * second * target  # of small gaps; the gap g itself obeys dg/dt = -rate g + second g^2
    fade = torch.expm1(-rate * (time if lag is None else time / lag))
    return target - rate * gap * (1 + fade) / (rate + second * gap * fade)


def speed_for(share: Tensor, curve: tuple[float, float]) -> Tensor:
    """Rotor speed, as a share of its maximum, at which ``curve`` (see ``DroneSpec.thrust_curve``) gives ``share``."""
    first, second = curve
    return ((first * first + 4 * second * share).sqrt() - first) / (2 * second)


def hover_share(drone: DroneSpec) -> float:
    """Thrust of a rotor, as a share of its maximum, that carries a quarter of the drone's weight."""
    return drone.mass * GRAVITY / (4 * drone.max_thrust)


def hover_throttle(drone: DroneSpec) -> float:
    """Rotor speed, as a share of its maximum, whose thrust carries the drone's weight."""
    return float(speed_for(torch.tensor(hover_share(drone), dtype=torch.float64), drone.thrust_curve))


def hover_command(drone: DroneSpec) -> float:
    """Thrust command in [-1, 1] that hovers, the motor map's bias included (0.038 for the release's Crazyflie)."""
    return 2 * (hover_share(drone) - drone.thrust_bias) - 1


def hover_action(drone: DroneSpec) -> tuple[float, float, float, float]:
    """The action in [-1, 1] that hovers: level with the hover command, or four equal rotor thrusts."""
    hover = hover_command(drone)
    return (hover, hover, hover, hover) if drone.command == "rotor" else (0.0, 0.0, 0.0, hover)


def rotor_wrench(throttle: Tensor, attitude: Tensor, drone: DroneSpec) -> Wrench:
    """Thrust along body z and torques of four rotors (E, N, 4) turning at ``throttle``."""
    square = throttle.square()
    thrust = drone.max_thrust * (drone.thrust_curve[0] * throttle + drone.thrust_curve[1] * square)
    drag = drone.max_torque * (drone.torque_curve[0] * throttle + drone.torque_curve[1] * square)
    x = square.new_tensor([p[0] for p in drone.rotor_positions])
    y = square.new_tensor([p[1] for p in drone.rotor_positions])
    spin = square.new_tensor(drone.rotor_directions)
    torque = memory.stack(((thrust * y).sum(-1), -(thrust * x).sum(-1), -(drag * spin).sum(-1)))
    return Wrench(thrust.sum(-1, keepdim=True) * rotation.up_axis(attitude), torque)


def rotor_reaction(before: Tensor, state: State, drone: DroneSpec, dt: float) -> Tensor:
    """Torque (E, N, 3) in N m, body, of rotors that were turning at ``before`` (E, N, 4) ``dt`` s ago.

    They push against the body while they change speed, and as gyroscopes while the body turns.
    """
    spin = before.new_tensor(drone.rotor_directions) * drone.rotor_momentum
    momentum = (spin * state.throttle).sum(-1)
    change = (spin * (state.throttle - before)).sum(-1) / dt
    return memory.stack((-state.rates[..., 1] * momentum, state.rates[..., 0] * momentum, -change))


def ground_cushion(height: Tensor, drone: DroneSpec) -> Tensor:
    """Factor on rotor thrust at ``height`` in m above the ground (Cheeseman and Bennett, 1955).

    1 / (1 - (R / 4 z)^2), which holds from half a rotor radius up.
    """
    return 1 / (1 - (drone.rotor_radius / (4 * height.clamp_min(drone.rotor_radius / 2))).square())


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


def external_wrench(
    state: State, drone: DroneSpec, conditions: Conditions = MODEL, before: Tensor | None = None, dt: float = 0.0
) -> Wrench:
    """Rotors, damping and downwash on each drone, for the throttles in ``state``, as the model's mass feels them.

    ``before`` (E, N, 4) are the throttles ``dt`` s ago, where the drone's rotors have a momentum. A heavier craft
    answers every newton less, and every newton metre, since its inertia grows alike.
    """
    force, torque = rotor_wrench(state.throttle, state.attitude, drone)
    mass, thrust, _ = (None,) * 3 if conditions.vehicle is None else conditions.vehicle.split(1, -1)
    if conditions.ground_effect and drone.rotor_radius:
        cushion = ground_cushion(state.position[..., 2:], drone)
        thrust = cushion if thrust is None else thrust * cushion
    if thrust is not None:
        force, torque = force * thrust, torque * thrust
    if drone.downwash_axial >= 0:
        force = force + downwash(state.position, force, drone)
    if drone.rotor_momentum and before is not None:
        torque = torque + rotor_reaction(before, state, drone, dt)
    through = state.velocity if conditions.wind is None else state.velocity - conditions.wind
    force = force - drone.linear_damping * drone.mass * through
    if drone.axial_damping:
        up = rotation.up_axis(state.attitude)
        force = force - drone.axial_damping * drone.mass * (up * through).sum(-1, keepdim=True) * up
    inertia = torque.new_tensor(drone.inertia)
    torque = torque - drone.angular_damping * inertia * state.rates
    return Wrench(force, torque) if mass is None else Wrench(force / mass, torque / mass)


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
