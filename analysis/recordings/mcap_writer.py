"""A recording as MCAP, with the schemas that Foxglove knows.

| topic | schema | content |
|---|---|---|
| ``/tf`` | foxglove.FrameTransforms | every drone's frame in ``world`` |
| ``/scene`` | foxglove.SceneUpdate | columns and goal line, once |
| ``/methodK/poses`` | foxglove.PosesInFrame | the drones, in their order: the truth about positions and attitudes |
| ``/methodK/scene`` | foxglove.SceneUpdate | drones, trails, balls, arcs and plans to look at |
| ``/methodK/log`` | foxglove.Log | events in words |
| ``/methodK/NAME`` | JSON | ``analysis.recordings.channels.SCHEMAS`` |

Times are simulated nanoseconds since the start of the episode. Metadata: ``formctl`` (format, scene, provenance) and
``methodK`` (name, facts, row), their values as JSON.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from analysis.recordings import shapes
from analysis.recordings.channels import FORMAT, encode, frame, nanoseconds, schema, topic
from analysis.recordings.record import CAUSES, Event, Plan, Recording, Throw, Trace
from envs.vocabulary import OBJECTIVES

Due = TypeVar("Due", Throw, Event, Plan)

TRAIL = 4.0
"""s of past flight drawn behind every drone."""
REDRAWN = 10
"""Samples between two drawings of the trails."""


def write(recording: Recording, path: Path) -> Path:
    """Write a recording to ``path``; the same recording gives the same bytes. OSError where that cannot be done."""
    with path.open("wb") as file:
        _File(file, recording).write()
    return path


class _File:
    """One recording on its way into a file."""

    def __init__(self, file: Any, recording: Recording) -> None:
        self.recording, self.scene = recording, recording.scene
        self.writer = Writer(file)
        self.hit = [trace.hit(self.scene) for trace in recording.traces]
        self.channels: dict[str, int] = {}
        self.schemas: dict[str, int] = {}

    def write(self) -> None:
        self.writer.start(profile="", library="formctl")
        self._metadata()
        self._send("/scene", 0.0, SceneUpdate(entities=[shapes.obstacles(self.scene)]))
        for sample in range(max(len(trace.position) for trace in self.recording.traces)):
            now = sample * self.scene.period
            moving = [(k, trace) for k, trace in enumerate(self.recording.traces) if sample < len(trace.position)]
            self._frames(sample, now, moving)
            for number, trace in moving:
                self._sample(number, trace, sample, now)
        self.writer.finish()

    def _metadata(self) -> None:
        scene = {key: _json(value) for key, value in asdict(self.scene).items()}
        head = {"format": FORMAT, "scene": json.dumps(scene), "provenance": json.dumps(self.recording.provenance)}
        self.writer.add_metadata("formctl", head | {"methods": str(len(self.recording.traces))})
        for number, trace in enumerate(self.recording.traces):
            facts, row = json.dumps(dict(trace.facts)), json.dumps(dict(trace.row))
            drones, balls = str(trace.position.shape[1]), str(trace.ball.shape[1])
            about = {"name": trace.method, "facts": facts, "row": row, "drones": drones, "balls": balls}
            self.writer.add_metadata(f"method{number + 1}", about)

    def _frames(self, sample: int, now: float, moving: list[tuple[int, Trace]]) -> None:
        message = FrameTransforms()
        stamp = shapes.timestamp(now)
        for number, trace in moving:
            for drone in range(trace.position.shape[1]):
                at = shapes.pose(trace.position[sample, drone], trace.attitude[sample, drone])
                message.transforms.append(
                    FrameTransform(
                        timestamp=stamp,
                        parent_frame_id="world",
                        child_frame_id=frame(number, drone),
                        translation=at.position,
                        rotation=at.orientation,
                    )
                )
        self._send("/tf", now, message)

    def _sample(self, number: int, trace: Trace, sample: int, now: float) -> None:
        """Everything about one method at one moment."""
        both = zip(trace.position[sample], trace.attitude[sample], strict=True)
        poses = PosesInFrame(timestamp=shapes.timestamp(now), frame_id="world", poses=[shapes.pose(*at) for at in both])
        self._send(topic(number, "poses"), now, poses)
        speed = np.linalg.norm(trace.velocity[sample], axis=-1).mean()
        state = {"velocity": trace.velocity[sample], "throttle": trace.throttle[sample], "ball": trace.ball[sample]}
        self._json(number, "state", now, state | {"speed": speed})
        if sample > 0:
            self._step(number, trace, sample - 1, now)
        for throw in self._due(trace.throws, sample):
            self._json(number, "throw", now, asdict(throw))
        for event in self._due(trace.events, sample):
            self._json(number, "event", now, asdict(event))
            level = Log.ERROR if event.kind in ("contact", "late") else Log.INFO
            words = Log(timestamp=shapes.timestamp(now), level=level, message=event.text, name=trace.method)
            self._send(topic(number, "log"), now, words)
        for plan in self._due(trace.plans, sample):
            self._json(number, "plan", now, asdict(plan))
        self._look(number, trace, sample, now)

    def _step(self, number: int, trace: Trace, step: int, now: float) -> None:
        """The step that ended now."""
        self._json(number, "action", now, {"command": trace.command[step]})
        rewards = {name: trace.reward[step, :, place] for place, name in enumerate(OBJECTIVES)}
        self._json(number, "reward", now, rewards)
        gaps = {name: trace.gap[step, :, place] for place, name in enumerate(CAUSES)}
        error = {"nearest": trace.gap[step].min(), "formation_error": trace.formation_error[step]}
        self._json(number, "clearance", now, gaps | error)

    def _look(self, number: int, trace: Trace, sample: int, now: float) -> None:
        """The part of the 3-D scene that changed."""
        update = SceneUpdate()
        rgb = shapes.COLOURS[number % len(shapes.COLOURS)]
        hit = self.hit[number]
        for drone in range(trace.position.shape[1]):
            if sample == 0 or hit[sample, drone] != hit[sample - 1, drone]:
                label = trace.method if drone == 0 else ""
                update.entities.append(shapes.drone(frame(number, drone), label, rgb, now, bool(hit[sample, drone])))
            if sample and sample % REDRAWN == 0:
                first = max(0, sample - round(TRAIL / self.scene.period))
                path = trace.position[first : sample + 1 : 2, drone]
                update.entities.append(shapes.trail(f"trail{drone}", path, rgb, now))
        self._balls(trace, sample, now, update)
        for plan in self._due(trace.plans, sample):
            update.entities.append(shapes.plan(f"plan{plan.drone}", plan.points[:, 1:], rgb, now))
        if update.entities or update.deletions:
            self._send(topic(number, "scene"), now, update)

    def _balls(self, trace: Trace, sample: int, now: float, update: SceneUpdate) -> None:
        """Balls in the air, their arcs from the throw to the landing."""
        for throw in trace.throws:
            thrown, landed = round(throw.time / self.scene.period), math.ceil(throw.landing / self.scene.period)
            if thrown <= sample <= landed:
                place = trace.ball[sample, throw.ball]
                update.entities.append(shapes.ball(f"ball{throw.ball}", place, self.scene.ball_radius, now))
            if sample == thrown:
                update.entities.append(shapes.arc(f"arc{throw.ball}", throw))
            if sample == landed:
                gone = SceneEntityDeletion(timestamp=shapes.timestamp(now), id=f"arc{throw.ball}")
                gone.type = SceneEntityDeletion.MATCHING_ID
                update.deletions.append(gone)

    def _due(self, items: Sequence[Due], sample: int) -> list[Due]:
        """What happened at a sample."""
        return [item for item in items if round(item.time / self.scene.period) == sample]

    def _send(self, name: str, now: float, message: Any) -> None:
        """A message of a ``foxglove`` schema."""
        if name not in self.channels:
            kind = type(message).DESCRIPTOR.full_name
            if kind not in self.schemas:
                self.schemas[kind] = register_schema(self.writer, type(message))
            self.channels[name] = self.writer.register_channel(name, MessageEncoding.Protobuf, self.schemas[kind])
        self._add(name, now, message.SerializeToString(deterministic=True))

    def _json(self, number: int, name: str, now: float, content: dict[str, Any]) -> None:
        """A message of a plain channel."""
        place = topic(number, name)
        if place not in self.channels:
            if name not in self.schemas:
                kind = f"formctl.{name}"
                self.schemas[name] = self.writer.register_schema(kind, SchemaEncoding.JSONSchema, schema(name))
            self.channels[place] = self.writer.register_channel(place, MessageEncoding.JSON, self.schemas[name])
        self._add(place, now, encode(content))

    def _add(self, name: str, now: float, data: bytes) -> None:
        at = nanoseconds(now)
        self.writer.add_message(self.channels[name], log_time=at, data=data, publish_time=at)


def _json(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
