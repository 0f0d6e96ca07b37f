"""The channels of a recording: topics, JSON schemas, and what turns arrays into JSON and back without loss.

Methods are numbered in the topics (``/method1/poses``), so that one Foxglove layout fits every recording; their names
are in the metadata, in the log and beside the drones.
"""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from analysis.recordings.record import Array

FORMAT = "formctl-recording-1"
NANO = 1_000_000_000

_NUMBER = {"type": ["number", "null"]}
_LIST = {"type": "array", "items": _NUMBER}
_TABLE = {"type": "array", "items": _LIST}
_TEXT = {"type": "string"}
_WHOLE = {"type": "integer"}

SCHEMAS: Mapping[str, dict[str, Any]] = {
    "action": {"command": _TABLE},
    "reward": {"formation": _LIST, "flight": _LIST, "obstacle": _LIST, "action": _LIST},
    "state": {"velocity": _TABLE, "throttle": _TABLE, "ball": _TABLE, "speed": _NUMBER},
    "clearance": {"column": _LIST, "ball": _LIST, "drone": _LIST, "nearest": _NUMBER, "formation_error": _NUMBER},
    "throw": {"ball": _WHOLE, "time": _NUMBER, "landing": _NUMBER, "origin": _LIST, "velocity": _LIST},
    "event": {"time": _NUMBER, "kind": _TEXT, "text": _TEXT, "drone": _WHOLE, "cause": _TEXT},
    "plan": {"time": _NUMBER, "drone": _WHOLE, "points": _TABLE},
}
"""The plain JSON channels of every method, ``/methodK/NAME``: one list entry a drone (ball), null for no number."""


def topic(number: int, name: str) -> str:
    """Topic of channel ``name`` of the method at place ``number``, from 0."""
    return f"/method{number + 1}/{name}"


def frame(number: int, drone: int) -> str:
    """Coordinate frame that moves with a drone."""
    return f"method{number + 1}/drone{drone}"


def schema(name: str) -> bytes:
    """JSON Schema of a channel, for plots that offer its fields."""
    return json.dumps({"title": f"formctl.{name}", "type": "object", "properties": SCHEMAS[name]}).encode()


def nanoseconds(seconds: float) -> int:
    """Simulated time since the start of the episode."""
    return round(seconds * NANO)


def encode(content: Mapping[str, Any]) -> bytes:
    """JSON in which every float64 is read back exactly; numbers that are not finite become null."""
    return json.dumps(
        {key: _plain(value) for key, value in content.items()}, allow_nan=False, separators=(",", ":")
    ).encode()


def array(rows: list[Any], shape: tuple[int, ...], nothing: float) -> Array:
    """What ``encode`` made of an array, ``nothing`` in the place of null."""
    flat = np.array(rows, dtype=object).reshape(-1)
    return np.array([nothing if value is None else value for value in flat], dtype=np.float64).reshape(shape)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
