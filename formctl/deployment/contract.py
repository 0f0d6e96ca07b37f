"""``contract.json``: everything that somebody without this program needs to fly an export, with hashes of its files."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from algos.export import contract as fields_of
from algos.export.c import Golden
from algos.export.contract import Field
from formctl.store import provenance
from formctl.store.files import plain, write_json

if TYPE_CHECKING:
    from algos.policy import Policy
    from envs.formation import FormationEnv
    from formctl.evaluation.methods import Method
    from formctl.settings import Config

FORMAT = "formctl-contract-2"

TOLERANCE = 1e-5
"""Largest difference from PyTorch of commands in [-1, 1] and thrust in [0, 1] that an export may have."""


def describe(config: "Config", method: "Method", policy: "Policy", env: "FormationEnv") -> dict[str, Any]:
    """What holds for every form of export: rate, frames, inputs, limits, task, and where the policy comes from."""
    scenario, drone = config.scenario, config.drone
    return {
        "format": FORMAT,
        "rate_hz": 1 / drone.control_period,
        "frames": {
            "world": "x right of the course, y along it, z up; origin on the ground below the formation's start",
            "body": "x forward, y left, z up; rates by the right-hand rule; drones face world x and fly along y",
            "quaternion": "w, x, y, z; rotates body vectors into the world",
        },
        "inputs": [entry(field, env) for field in fields_of.fields(policy)],
        "outputs": [entry(field, env) for field in fields_of.OUTPUTS],
        "limits": {
            "rate_clip_rad_s": min(drone.rate_clip, drone.rate_limit),
            "thrust_range": list(drone.thrust_range),
            "thrust_full_scale_n": 4 * drone.max_thrust,
            "thrust_bias": drone.thrust_bias,
            "thrust_note": "a command c lifts full_scale * (c + bias): the simulated motor map adds the bias",
        },
        "crazyflie": {
            "cflib": "Commander.send_setpoint(roll, pitch, yawrate, thrust), flightmode.stabModeRoll and Pitch at 0",
            "rates": "degrees of rates_setpoint",
            "thrust": "round(65535 * min(1, thrust_setpoint + thrust_bias)); the firmware cuts at 60000",
        },
        "task": {
            "start_m": list(scenario.start),
            "velocity_m_s": list(scenario.velocity),
            "height_m": scenario.height,
            "slots_m": env.slots.tolist(),
            "sensing_range_m": scenario.sensing_range,
            "altitude_m": list(scenario.altitude),
        },
        "observation": {"name": policy.observation.name, "inside": True},
        "policy": method.facts,
        "provenance": provenance.collect(),
    }


def entry(field: Field, env: "FormationEnv") -> dict[str, Any]:
    """An input or output as the contract names it."""
    shape = [env.drones if part == "N" else int(part) if part.isdigit() else part for part in field.shape]
    kind = "bool" if field.unit == "bool" else "float32"
    unit = "" if field.unit == "bool" else field.unit
    return {"name": field.name, "shape": shape, "type": kind, "unit": unit, "frame": field.frame} | {
        "meaning": field.meaning
    }


def golden_vectors(vectors: Golden) -> list[dict[str, Any]]:
    """Recorded inputs of one drone, by the names of the C struct, with PyTorch's commands."""
    return [
        {"inputs": members(record), "command": command.tolist()}
        for record, command in zip(vectors.inputs, vectors.commands, strict=True)
    ]


def members(record: Any) -> dict[str, Any]:
    """A packed record by member, without the entries that are not filled."""
    values = {name: record[name] for name in record.dtype.names}
    counts = {"neighbour": "neighbours", "ball": "balls", "column": "columns"}
    return {
        name: [members(one) for one in value[: int(values[counts[name]])]]
        if name in counts
        else np.asarray(value).tolist()
        for name, value in values.items()
    }


def hashes(folder: Path, names: list[str]) -> dict[str, str]:
    """sha256 of files by name."""
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}


def write(path: Path, contract: dict[str, Any]) -> None:
    """The contract with its own hash: of everything in it but the hash."""
    write_json(path, contract | {"sha256": _digest(contract)})


def read(folder: Path) -> dict[str, Any]:
    """The contract of an export whose files are all as they were written.

    Raises ValueError, in one line, for a file that is missing, cut short or changed, and for no contract.
    """
    path = folder / "contract.json"
    try:
        contract = json.loads(path.read_text())
        own = contract.pop("sha256")
    except FileNotFoundError:
        raise ValueError(f"{folder} holds no export: it has no contract.json") from None
    except (ValueError, KeyError, AttributeError, UnicodeDecodeError):
        raise ValueError(f"{path} is damaged: export the policy again") from None
    if own != _digest(contract):
        raise ValueError(f"{path} was changed after the export: export the policy again")
    if contract.get("format") != FORMAT:
        raise ValueError(f"{path} is of another version of formctl ({contract.get('format')}): export the policy again")
    for name, expected in contract["files"].items():
        file = folder / name
        if not file.is_file():
            raise ValueError(f"{file} is missing: export the policy again")
        if hashlib.sha256(file.read_bytes()).hexdigest() != expected:
            raise ValueError(f"{file} was changed after the export (its hash differs): export the policy again")
    return contract


def _digest(contract: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain(contract), sort_keys=True).encode()).hexdigest()


def parity_lines(flights: list[Any], runtime: str) -> dict[str, Any]:
    """The proof as the contract tells it."""
    return {"tolerance": TOLERANCE, "runtime": runtime, "flights": [asdict(flight) for flight in flights]}
