"""A recording read back from MCAP: the same numbers that were written."""

import json
import struct
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from mcap.exceptions import McapError
from mcap.reader import make_reader
from zstandard import ZstdError

from analysis.recordings.channels import FORMAT, array, topic
from analysis.recordings.record import (
    CAUSES,
    Array,
    Event,
    Plan,
    Recording,
    RecordingError,
    Scene,
    Throw,
    Trace,
)
from envs.vocabulary import OBJECTIVES

Messages = dict[str, list[bytes]]


def read(path: Path) -> Recording:
    """Read what ``mcap_writer.write`` wrote. RecordingError, one line: missing, cut off, damaged, or not ours."""
    metadata, messages = _contents(path)
    if metadata.get("formctl", {}).get("format") != FORMAT:
        raise RecordingError(f"{path} is an MCAP file, but no recording of formctl ({FORMAT})")
    try:
        head = metadata["formctl"]
        scene = _scene(json.loads(head["scene"]))
        count = int(head["methods"])
        traces = tuple(_trace(number, metadata[f"method{number + 1}"], messages) for number in range(count))
        return Recording(scene, traces, json.loads(head["provenance"]))
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{path} is damaged: {' '.join(str(error).split())}") from error


def _contents(path: Path) -> tuple[dict[str, dict[str, str]], Messages]:
    """Metadata by name and messages by topic, in their order."""
    messages: Messages = defaultdict(list)
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            if reader.get_summary() is None:
                raise RecordingError(f"{path} has no summary at its end")
            metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
            for _, channel, message in reader.iter_messages(log_time_order=False):  # they lie in the order of time
                messages[channel.topic].append(message.data)
    except FileNotFoundError:
        raise RecordingError(f"there is no recording {path}") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    except (McapError, ZstdError, ValueError, struct.error, EOFError, KeyError, IndexError) as error:
        raise RecordingError(f"{path} was cut off or is damaged: record it again with 'formctl replay'") from error
    return metadata, messages


def _scene(fields: dict[str, Any]) -> Scene:
    columns = np.array(fields.pop("columns"), dtype=np.float64).reshape(-1, 2)
    slots, velocity = (np.array(fields.pop(name), dtype=np.float64) for name in ("slots", "velocity"))
    low, high = fields.pop("altitude")
    return Scene(columns=columns, slots=slots, velocity=velocity, altitude=(low, high), **fields)


def _trace(number: int, about: dict[str, str], messages: Messages) -> Trace:
    def channel(name: str) -> list[dict[str, Any]]:
        return [json.loads(data) for data in messages.get(topic(number, name), [])]

    drones, balls = int(about["drones"]), int(about["balls"])
    position, attitude = _poses(messages[topic(number, "poses")], drones)
    states, steps = channel("state"), channel("clearance")
    samples = len(states)

    def stacked(entries: list[dict[str, Any]], key: str, *shape: int, nothing: float = np.nan) -> Array:
        return array([entry[key] for entry in entries], (len(entries), *shape), nothing)

    return Trace(
        method=about["name"],
        facts=json.loads(about["facts"]),
        row=json.loads(about["row"]),
        position=position,
        attitude=attitude,
        velocity=stacked(states, "velocity", drones, 3),
        throttle=stacked(states, "throttle", drones, 4),
        ball=stacked(states, "ball", balls, 3) if balls else np.zeros((samples, 0, 3)),
        command=stacked(channel("action"), "command", drones, 4),
        reward=np.stack([stacked(channel("reward"), name, drones) for name in OBJECTIVES], -1),
        gap=np.stack([stacked(steps, name, drones, nothing=np.inf) for name in CAUSES], -1),
        formation_error=stacked(steps, "formation_error"),
        throws=[_throw(entry) for entry in channel("throw")],
        events=[Event(**entry) for entry in channel("event")],
        plans=[_plan(entry) for entry in channel("plan")],
    )


def _poses(entries: list[bytes], drones: int) -> tuple[Array, Array]:
    """Positions (T, N, 3) and attitudes (T, N, 4) ``wxyz``."""
    position, attitude = np.empty((len(entries), drones, 3)), np.empty((len(entries), drones, 4))
    for sample, data in enumerate(entries):
        message = PosesInFrame.FromString(data)
        for drone, pose in enumerate(message.poses):
            at, turned = pose.position, pose.orientation
            position[sample, drone] = at.x, at.y, at.z
            attitude[sample, drone] = turned.w, turned.x, turned.y, turned.z
    return position, attitude


def _throw(entry: dict[str, Any]) -> Throw:
    origin, velocity = tuple(entry.pop("origin")), tuple(entry.pop("velocity"))
    return Throw(origin=origin, velocity=velocity, **entry)


def _plan(entry: dict[str, Any]) -> Plan:
    return Plan(entry["time"], entry["drone"], np.array(entry["points"], dtype=np.float64).reshape(-1, 4))
