"""From a normalised CTBR command to motor commands: limits, the Crazyflie's rate PID and its mixer.

CTBR is collective thrust and body rates (paper, Sec. III-C). A command holds roll, pitch, yaw rate and thrust in
[-1, 1], the order of the release.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from envs import memory
from envs.spec import DroneSpec

PWM = 2.0**16
"""Full scale of the firmware's motor command."""


class PidState(NamedTuple):
    """Memory of the rate loop; zero at the start of every episode (the release leaks it into the next one)."""

    integral: Tensor  # (E, N, 3) deg
    last_rates: Tensor  # (E, N, 3) deg/s


def ctbr(command: Tensor, drone: DroneSpec) -> tuple[Tensor, Tensor]:
    """Body rates (E, N, 3) in rad/s and collective thrust (E, N) as a share of full scale.

    Rates are ``rate_limit`` times the command, clamped to ``rate_clip``; thrust maps [-1, 1] to [0, 1] and is clamped
    to ``thrust_range`` (release: ``PIDRateController`` transform; the clamps narrow for sim-to-real, Sec. VI-D1).
    """
    rates = (drone.rate_limit * command[..., :3]).clamp(-drone.rate_clip, drone.rate_clip)
    return rates, ((command[..., 3] + 1) / 2).clamp(*drone.thrust_range)


def rate_pid(target: Tensor, rates: Tensor, memory: PidState, drone: DroneSpec, dt: float) -> tuple[Tensor, PidState]:
    """PWM outputs (E, N, 3) of the rate PID for body rates in rad/s: the firmware's, derivative on the measurement."""
    gain_p, gain_i, gain_d, limit = (
        rates.new_tensor(gains)
        for gains in (drone.rate_gain_p, drone.rate_gain_i, drone.rate_gain_d, drone.rate_integral_limit)
    )
    measured = torch.rad2deg(rates)
    error = torch.rad2deg(target) - measured
    integral = (memory.integral + error * dt).clamp(-limit, limit)
    output = gain_p * error + gain_i * integral - gain_d * (measured - memory.last_rates) / dt
    return output.clamp(-(2.0**15 - 1), 2.0**15 - 1), PidState(integral, measured)


def mix(output: Tensor, thrust: Tensor) -> Tensor:
    """Motor commands (E, N, 4) in shares of full PWM; roll and pitch are halved, yaw is not (firmware layout)."""
    roll, pitch, yaw = (output * output.new_tensor([0.5, 0.5, 1.0]) / PWM).unbind(-1)
    return memory.stack(
        (
            thrust + roll - pitch + yaw,
            thrust + roll + pitch - yaw,
            thrust - roll + pitch + yaw,
            thrust - roll - pitch - yaw,
        )
    )
