"""What Foxglove draws of a recording: entities of ``foxglove.SceneUpdate`` for obstacles, drones, trails and arcs."""

from collections.abc import Iterable, Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from analysis.recordings.channels import NANO, nanoseconds
from analysis.recordings.record import Array, Scene, Throw

COLOURS = ((0.0, 0.447, 0.698), (0.835, 0.369, 0.0), (0.0, 0.620, 0.451), (0.8, 0.475, 0.655), (0.902, 0.624, 0.0))
"""Of the methods (Okabe and Ito); the report's figures use the same."""
HIT = (0.84, 0.10, 0.11)
BALL = (0.70, 0.09, 0.17)
COLUMN = (0.45, 0.47, 0.51)
COLUMN_HEIGHT = 3.0
"""m, drawn (paper, Sec. III-A); the world's columns are infinite."""
GRAVITY = 9.81


def colour(rgb: Sequence[float], opacity: float = 1.0) -> Color:
    return Color(r=rgb[0], g=rgb[1], b=rgb[2], a=opacity)


def pose(position: Iterable[float], attitude: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> Pose:
    """A pose from a position in m and a quaternion ``wxyz``; messages carry it as named parts."""
    x, y, z = map(float, position)
    qw, qx, qy, qz = map(float, attitude)
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def timestamp(seconds: float) -> Timestamp:
    whole, nanos = divmod(nanoseconds(seconds), NANO)
    return Timestamp(seconds=whole, nanos=nanos)


def obstacles(scene: Scene) -> SceneEntity:
    """Columns and the goal line."""
    entity = SceneEntity(timestamp=timestamp(0), frame_id="world", id="obstacles")
    size = Vector3(x=2 * scene.column_radius, y=2 * scene.column_radius, z=COLUMN_HEIGHT)
    for x, y in scene.columns:
        standing = pose((x, y, COLUMN_HEIGHT / 2))
        entity.cylinders.append(
            CylinderPrimitive(pose=standing, size=size, bottom_scale=1, top_scale=1, color=colour(COLUMN))
        )
    across = np.array([[-3.0, scene.goal, 0.0], [3.0, scene.goal, 0.0]])
    entity.lines.append(line(across, (0.1, 0.1, 0.1), 0.04))
    return entity


def drone(frame: str, label: str, rgb: Sequence[float], time: float, hit: bool) -> SceneEntity:
    """A drone in its own frame: four rotors, a nose towards body x and a label; red once it was hit."""
    paint = colour(HIT if hit else rgb)
    entity = SceneEntity(timestamp=timestamp(time), frame_id=frame, id=frame, frame_locked=True)
    for x, y in ((0.09, 0.09), (-0.09, 0.09), (-0.09, -0.09), (0.09, -0.09)):
        rotor = Vector3(x=0.13, y=0.13, z=0.02)
        entity.cylinders.append(
            CylinderPrimitive(pose=pose((x, y, 0.02)), size=rotor, bottom_scale=1, top_scale=1, color=paint)
        )
    entity.lines.append(line(np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]), (0.1, 0.1, 0.1), 0.02))
    entity.texts.append(
        TextPrimitive(
            pose=pose((0, 0, 0.3)), billboard=True, font_size=12, scale_invariant=True, color=paint, text=label
        )
    )
    return entity


def trail(name: str, path: Array, rgb: Sequence[float], time: float) -> SceneEntity:
    """The way (K, 3) that a drone has come lately."""
    entity = SceneEntity(timestamp=timestamp(time), frame_id="world", id=name)
    entity.lines.append(line(path, rgb, 0.025, 0.6))
    return entity


def ball(name: str, place: Array, radius: float, time: float) -> SceneEntity:
    """A thrown ball at ``place`` (3,)."""
    entity = SceneEntity(timestamp=timestamp(time), frame_id="world", id=name)
    size = Vector3(x=2 * radius, y=2 * radius, z=2 * radius)
    entity.spheres.append(SpherePrimitive(pose=pose(place), size=size, color=colour(BALL)))
    return entity


def arc(name: str, throw: Throw) -> SceneEntity:
    """The parabola of a throw, from the hand to the ground."""
    entity = SceneEntity(timestamp=timestamp(throw.time), frame_id="world", id=name)
    entity.lines.append(line(parabola(throw), BALL, 0.012, 0.5))
    return entity


def plan(name: str, points: Array, rgb: Sequence[float], time: float) -> SceneEntity:
    """A planner's intended way (K, 3)."""
    entity = SceneEntity(timestamp=timestamp(time), frame_id="world", id=name)
    entity.lines.append(line(points, rgb, 0.015, 0.9))
    return entity


def parabola(throw: Throw, points: int = 32) -> Array:
    """Points (points, 3) in m along a throw."""
    aloft = np.linspace(0.0, throw.landing - throw.time, points)[:, None]
    return np.array(throw.origin) + np.array(throw.velocity) * aloft - [0, 0, GRAVITY / 2] * aloft**2


def line(points: Array, rgb: Sequence[float], thickness: float, opacity: float = 1.0) -> LinePrimitive:
    """A connected line through ``points`` (K, 3)."""
    strip = LinePrimitive(type=LinePrimitive.LINE_STRIP, thickness=thickness, color=colour(rgb, opacity))
    strip.pose.CopyFrom(pose((0, 0, 0)))
    strip.points.extend(Point3(x=x, y=y, z=z) for x, y, z in points.tolist())
    return strip
