"""The C structs of an export as NumPy records: the same bytes, so that arrays of them are handed over as they are."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from algos.export.contract import Inputs
from envs.formation import FormationEnv
from envs.spec import FAR


@dataclass(frozen=True)
class Bounds:
    """How many of each one drone can be told about at most."""

    neighbours: int = 5
    balls: int = 5
    columns: int = 32


SETPOINT = np.dtype([("body_rates_rad_s", "<f4", 3), ("thrust_share", "<f4"), ("command", "<f4", 4)])
"""``struct policy_setpoint``."""


def inputs_dtype(bounds: Bounds) -> np.dtype[Any]:
    """``struct policy_inputs`` for these bounds. Every member is four bytes wide, so that nothing is padded."""
    neighbour = [("position_m", "<f4", 3), ("velocity_m_s", "<f4", 3), ("slot_m", "<f4", 3)]
    return np.dtype(
        [
            ("time_s", "<f4"),
            ("position_m", "<f4", 3),
            ("attitude_wxyz", "<f4", 4),
            ("velocity_m_s", "<f4", 3),
            ("body_rates_rad_s", "<f4", 3),
            ("slot_m", "<f4", 3),
            ("previous_command", "<f4", 4),
            ("neighbours", "<u4"),
            ("balls", "<u4"),
            ("columns", "<u4"),
            ("neighbour", neighbour, bounds.neighbours),
            ("ball", [("position_m", "<f4", 3), ("velocity_m_s", "<f4", 3)], bounds.balls),
            ("column", [("axis_m", "<f4", 2)], bounds.columns),
        ]
    )


def pack(inputs: Inputs, env: FormationEnv, bounds: Bounds) -> NDArray[Any]:
    """Measurements (E, N, ...) as records (E * N,), episode by episode, one a drone.

    Balls that do not fly and absent columns are left out. Raises ValueError for more than ``bounds`` has room for.
    """
    values = {name: value.numpy() for name, value in inputs.items()}
    episodes, drones = values["position"].shape[:2]
    packed = np.zeros((episodes, drones), inputs_dtype(bounds))
    names = {"position": "position_m", "attitude": "attitude_wxyz", "velocity": "velocity_m_s"}
    for name, member in (names | {"rates": "body_rates_rad_s", "previous_command": "previous_command"}).items():
        if name in values:
            packed[member] = values[name]
    packed["time_s"] = values["time"][:, None]
    slots = env.slots.numpy()
    packed["slot_m"] = slots
    _check("neighbours", drones - 1, bounds.neighbours)
    packed["neighbours"] = drones - 1
    for drone in range(drones):
        others = [other for other in range(drones) if other != drone]
        seen = packed["neighbour"][:, drone, : drones - 1]
        seen["position_m"], seen["velocity_m_s"] = values["position"][:, others], values["velocity"][:, others]
        seen["slot_m"] = slots[others]
    flying = values["ball_flying"].astype(bool)
    balls = {"position_m": values["ball_position"], "velocity_m_s": values["ball_velocity"]}
    packed["balls"] = _fill(packed["ball"], flying, balls, bounds.balls, "balls")[:, None]
    present = values["columns"][..., 0] < FAR / 2
    columns = {"axis_m": values["columns"]}
    packed["columns"] = _fill(packed["column"], present, columns, bounds.columns, "columns")[:, None]
    return packed.reshape(-1)


def _fill(
    entries: NDArray[Any], present: NDArray[np.bool_], values: dict[str, NDArray[Any]], room: int, what: str
) -> NDArray[np.intp]:
    """Put what is present (E, K) at the front of ``entries`` (E, N, room), for every drone; returns how many (E,)."""
    counts = present.sum(1)
    _check(what, int(counts.max(initial=0)), room)
    episode, which = np.nonzero(present)
    place = (np.cumsum(present, 1) - 1)[episode, which]
    for member, given in values.items():
        for drone in range(entries.shape[1]):
            entries[member][episode, drone, place] = given[episode, which]
    return counts


def _check(what: str, count: int, room: int) -> None:
    if count > room:
        raise ValueError(
            f"the exported policy has room for {room} {what}, not {count}: export it with --{what} {count}"
        )
