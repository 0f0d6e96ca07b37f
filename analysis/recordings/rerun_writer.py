"""A recording as ``.rrd``, for the Rerun viewer (``rerun FILE``); needs rerun-sdk.

| entity | archetype | content |
|---|---|---|
| ``world/columns``, ``world/goal`` | Cylinders3D, LineStrips3D | the scene, static |
| ``world/METHOD/droneI`` | Transform3D, TransformAxes3D, Points3D | pose in the world frame, z up |
| ``world/METHOD/trails`` | LineStrips3D | whole paths, static |
| ``world/METHOD/ballJ`` | Points3D | ball, while it is in the air |
| ``plots/METHOD/reward/OBJECTIVE``, ``formation_error``, ``clearance/CAUSE`` | Scalars | means over the team; m |
| ``METHOD/events`` | TextLog | throws, contacts, goal |

The timeline ``time`` is simulated seconds since the start of the episode.
"""

import re
from pathlib import Path

import numpy as np
import rerun as rr

from analysis.recordings import shapes
from analysis.recordings.record import CAUSES, Array, Recording, Trace
from envs.vocabulary import OBJECTIVES


def write(recording: Recording, path: Path) -> Path:
    """Write a recording to ``path``. OSError where that cannot be done."""
    stream = rr.RecordingStream("formctl", recording_id=f"{recording.scene.bank[:12]}-{recording.scene.episode}")
    stream.save(str(path))
    _scene(stream, recording)
    for number, trace in enumerate(recording.traces):
        _trace(stream, recording, trace, _part(trace.method), tuple(int(255 * x) for x in _colour(number)))
    stream.flush()
    stream.disconnect()
    return path


def _scene(stream: rr.RecordingStream, recording: Recording) -> None:
    """What stands still."""
    scene = recording.scene
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if len(scene.columns):
        centres = np.column_stack([scene.columns, np.full(len(scene.columns), shapes.COLUMN_HEIGHT / 2)])
        columns = rr.Cylinders3D(
            lengths=[shapes.COLUMN_HEIGHT] * len(centres), radii=[scene.column_radius] * len(centres), centers=centres
        )
        stream.log("world/columns", columns, static=True)
    goal = [[[-2.5, scene.goal, 0.0], [2.5, scene.goal, 0.0]]]
    stream.log("world/goal", rr.LineStrips3D(goal, labels=["goal"]), static=True)


def _trace(stream: rr.RecordingStream, recording: Recording, trace: Trace, name: str, colour: tuple[int, ...]) -> None:
    """One method's flight."""
    times = [rr.TimeColumn("time", duration=recording.times(trace))]
    drones = trace.position.shape[1]
    paths = [trace.position[::5, drone] for drone in range(drones)]
    stream.log(f"world/{name}/trails", rr.LineStrips3D(paths, colors=[colour] * drones, radii=0.01), static=True)
    for drone in range(drones):
        place = f"world/{name}/drone{drone}"
        label = [trace.method] if drone == 0 else None
        stream.log(place, rr.Points3D([[0.0, 0.0, 0.0]], radii=0.06, colors=[colour], labels=label), static=True)
        stream.log(place, rr.TransformAxes3D(0.3), static=True)
        xyzw = np.roll(trace.attitude[:, drone], -1, axis=-1)
        poses = rr.Transform3D.columns(translation=trace.position[:, drone], quaternion=xyzw)
        stream.send_columns(place, indexes=times, columns=poses)
    for ball in range(trace.ball.shape[1]):
        _ball(stream, recording, trace, f"world/{name}/ball{ball}", ball)
    _plots(stream, recording, trace, name)
    for event in trace.events:
        stream.set_time("time", duration=event.time)
        level = rr.TextLogLevel.ERROR if event.kind in ("contact", "late") else rr.TextLogLevel.INFO
        stream.log(f"{name}/events", rr.TextLog(event.text, level=level))


def _ball(stream: rr.RecordingStream, recording: Recording, trace: Trace, place: str, ball: int) -> None:
    """A ball from its throw to its landing."""
    for throw in trace.throws:
        if throw.ball != ball:
            continue
        times = recording.times(trace)
        flying = (times >= throw.time) & (times <= throw.landing) & np.isfinite(trace.ball[:, ball, 0])
        if flying.any():
            index = [rr.TimeColumn("time", duration=times[flying])]
            stream.send_columns(place, indexes=index, columns=rr.Points3D.columns(positions=trace.ball[flying, ball]))
            stream.log(place, rr.Points3D.from_fields(radii=recording.scene.ball_radius), static=True)
            stream.set_time("time", duration=throw.landing + recording.scene.period)
            stream.log(place, rr.Clear(recursive=False))


def _plots(stream: rr.RecordingStream, recording: Recording, trace: Trace, name: str) -> None:
    """Numbers of every step, at its end."""
    index = [rr.TimeColumn("time", duration=recording.times(trace)[1:])]

    def plot(entity: str, values: Array) -> None:
        finite = np.where(np.isfinite(values), values, np.nan)
        stream.send_columns(f"plots/{name}/{entity}", indexes=index, columns=rr.Scalars.columns(scalars=finite))

    plot("formation_error", trace.formation_error)
    for number, objective in enumerate(OBJECTIVES):
        plot(f"reward/{objective}", trace.reward[..., number].mean(-1))
    for number, cause in enumerate(CAUSES):
        plot(f"clearance/{cause}", trace.gap[..., number].min(-1))


def _colour(number: int) -> tuple[float, ...]:
    return shapes.COLOURS[number % len(shapes.COLOURS)]


def _part(method: str) -> str:
    """A method's name as a part of an entity path."""
    return re.sub(r"[^\w-]+", "_", method)
