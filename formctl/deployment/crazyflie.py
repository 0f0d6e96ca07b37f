"""Set-points as a Crazyflie takes them over the radio: cflib's manual set-point in rate mode.

``cflib.crazyflie.commander.Commander.send_setpoint(roll, pitch, yawrate, thrust)`` with the parameters
``flightmode.stabModeRoll`` and ``flightmode.stabModePitch`` at 0 (rate): degrees per second and a number from 0 to
65535. Signs (cflib's packing, and the firmware's decoder and rate loop, read together): cflib sends minus pitch, the
firmware compares it with minus the gyroscope's y; so all three rates, as given to cflib, turn the craft about its own
x (forward), y (left) and z (up) by the right-hand rule, the simulation's convention. Firmware from before its legacy
set-point types turns yaw the other way: try it with the propellers off.

Needs neither cflib nor a radio: what is here is arithmetic and checks.
"""

import math
import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs.deployment import DeploySpec
from envs.spec import DroneSpec

THRUST_FULL = 65535
THRUST_CUT = 60000
"""The firmware cuts larger thrust to this (``crtp_commander_rpyt.c``)."""
THRUST_LEAST = 1000
"""The firmware takes smaller thrust for none (same file)."""
WATCHDOG = 0.5
"""s without a set-point after which the firmware levels the craft (``commander.c``)."""
PACKET = struct.Struct("<fffH")
"""Payload of the packet: roll, minus pitch, yaw, thrust."""


class Setpoints(NamedTuple):
    """A stream of set-points: T periods, N drones."""

    time: NDArray[np.float64]  # (T,) s since the start
    roll: NDArray[np.float64]  # (T, N) deg/s about body x
    pitch: NDArray[np.float64]  # (T, N) deg/s about body y
    yaw: NDArray[np.float64]  # (T, N) deg/s about body z
    thrust: NDArray[np.int64]  # (T, N) 0..65535


@dataclass(frozen=True)
class Check:
    """One thing that has to hold before a stream may be sent, or, where it is not hard, one to know."""

    what: str
    found: str
    allowed: str
    ok: bool
    hard: bool = True

    @property
    def verdict(self) -> str:
        return "ok" if self.ok else "NOT OK" if self.hard else "warning"


def setpoints(commands: NDArray[np.floating], drone: DroneSpec, period: float) -> Setpoints:
    """Commands (T, N, 4) in [-1, 1], one every ``period`` s, as set-points.

    Rates and thrust are limited as on board the simulated craft. The simulated motor map adds ``drone.thrust_bias`` to
    every command; a real craft does not, so it is sent along: 65535 is the thrust of four rotors at full speed.
    """
    rates = np.degrees(np.clip(drone.rate_limit * commands[..., :3], -drone.rate_clip, drone.rate_clip))
    share = np.clip((commands[..., 3] + 1) / 2, *drone.thrust_range) + drone.thrust_bias
    thrust = np.rint(THRUST_FULL * np.clip(share, 0, 1)).astype(np.int64)
    roll, pitch, yaw = (rates[..., axis].astype(np.float64) for axis in range(3))
    return Setpoints(period * np.arange(len(commands), dtype=np.float64), roll, pitch, yaw, thrust)


def packet(stream: Setpoints, step: int, drone: int) -> bytes:
    """The 14 bytes that cflib sends for one set-point."""
    at = (step, drone)
    return PACKET.pack(stream.roll[at], -stream.pitch[at], stream.yaw[at], int(stream.thrust[at]))


def unpack(payload: bytes) -> tuple[float, float, float, int]:
    """Roll, pitch, yaw rate in deg/s and thrust of a packet, as they were given to cflib."""
    roll, minus_pitch, yaw, thrust = PACKET.unpack(payload)
    return roll, -minus_pitch, yaw, thrust


def cut(stream: Setpoints) -> NDArray[np.float64]:
    """The share of its thrust that each set-point loses to the firmware's cut (T, N); 0 for one that is obeyed."""
    return np.maximum(1 - THRUST_CUT / np.maximum(stream.thrust, 1), 0)


def largest_share(drone: DroneSpec) -> float:
    """The largest upper end of ``drone.thrust_range``, to three digits, of which the firmware cuts nothing."""
    return math.floor(1000 * (THRUST_CUT / THRUST_FULL - drone.thrust_bias)) / 1000


def checks(stream: Setpoints, deploy: DeploySpec, drone: DroneSpec) -> list[Check]:
    """Rates, ranges and timing of a stream, against the deployment's clip and what the firmware does.

    The firmware's cut is no hard check: the paper's own clip, 0.4 to 0.9, reaches above it.
    """
    largest = max(float(np.abs(values).max()) for values in (stream.roll, stream.pitch, stream.yaw))
    clip = float(np.degrees(min(deploy.rate_clip, drone.rate_clip)))
    low, high = (THRUST_FULL * (share + drone.thrust_bias) for share in deploy.thrust_clip)
    least, most = int(stream.thrust.min()), int(stream.thrust.max())
    gaps = np.diff(stream.time)
    lost = cut(stream)
    obeyed = f"{np.count_nonzero(lost)} of {lost.size} cut ({np.mean(lost > 0):.1%}), by up to {lost.max():.1%}"
    finite = all(np.isfinite(values).all() for values in stream)
    period = drone.control_period
    bounds = f"{max(low, 0):.0f} to {min(high, THRUST_FULL):.0f}"
    return [
        Check("numbers", "all finite" if finite else "not all finite", "finite", finite),
        Check("body rates", f"{largest:.2f} deg/s at most", f"{clip:.2f} deg/s", largest <= clip + 1e-3),
        Check("thrust", f"{least} to {most}", bounds, low - 1 <= least and most <= min(high, THRUST_FULL) + 1),
        Check("thrust heard", f"{least} at least", f"above {THRUST_LEAST}", least > THRUST_LEAST),
        Check("thrust obeyed", obeyed, f"none above {THRUST_CUT}", not lost.any(), hard=False),
        Check("period", _spread(gaps), f"{period * 1e3:g} ms", bool(np.allclose(gaps, period, atol=1e-6))),
        Check("watchdog", f"{_most(gaps):.3f} s without", f"under {WATCHDOG} s", _most(gaps) < WATCHDOG),
        Check("radio", f"{stream.thrust.shape[1] / period:.0f} packets/s", "under 1000", _packets(stream, period)),
    ]


def _spread(gaps: NDArray[np.float64]) -> str:
    return f"{gaps.min() * 1e3:.3f} to {gaps.max() * 1e3:.3f} ms" if gaps.size else "one set-point"


def _most(gaps: NDArray[np.float64]) -> float:
    return float(gaps.max()) if gaps.size else 0.0


def _packets(stream: Setpoints, period: float) -> bool:
    return stream.thrust.shape[1] / period < 1000


def lines(stream: Setpoints) -> list[str]:
    """The stream as CSV, one line per set-point, the unlocking one (all zero) of every drone first."""
    drones = stream.thrust.shape[1]
    written = ["time_s,drone,roll_deg_s,pitch_deg_s,yaw_deg_s,thrust"]
    written += [f"{-WATCHDOG / 10:.3f},{drone},0,0,0,0" for drone in range(drones)]
    for step, time in enumerate(stream.time):
        for drone in range(drones):
            at = (step, drone)
            rates = f"{stream.roll[at]:.4f},{stream.pitch[at]:.4f},{stream.yaw[at]:.4f}"
            written.append(f"{time:.3f},{drone},{rates},{stream.thrust[at]}")
    return written
