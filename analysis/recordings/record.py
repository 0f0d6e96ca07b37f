"""An episode as numbers: what happened, whoever flew it, and in whatever file it is kept.

World frame, z up, flight along +y; SI units; quaternions ``wxyz``. All real numbers are float64: positions and
attitudes exactly, everything else that was sampled to a millionth of its unit. Several methods that flew one scenario
are traces of one recording.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CAUSES = ("column", "ball", "drone")
"""Order of the last axis of ``Trace.gap``."""


class RecordingError(ValueError):
    """A recording that cannot be read or does not hold together; one line."""


@dataclass(frozen=True)
class Scene:
    """Where an episode takes place: the same for everybody who flies it."""

    scenario: str  # name
    episode: int  # id in its bank
    bank: str  # sha256 of the bank
    columns: Array  # (C, 2) m, axes
    slots: Array  # (N, 3) m, the commanded formation about its reference
    velocity: Array  # (3,) m/s, commanded
    goal: float  # m, course (y) that every drone has to pass
    time_limit: float  # s, to do so
    altitude: tuple[float, float]  # m, ground and ceiling crash limits
    column_radius: float  # m, drawn
    ball_radius: float  # m, drawn
    hit_radius: float  # m, centre distance (axis distance to a column) that is a collision
    period: float  # s between samples


@dataclass(frozen=True)
class Throw:
    """A ball's flight: p(t) = origin + velocity (t - time) - g (t - time)^2 / 2 up, from ``time`` to ``landing``."""

    ball: int
    time: float  # s
    landing: float  # s
    origin: tuple[float, float, float]  # m
    velocity: tuple[float, float, float]  # m/s


@dataclass(frozen=True)
class Event:
    """Something worth a mark on the timeline."""

    time: float  # s
    kind: str  # throw | contact | goal | late
    text: str  # in words
    drone: int = -1  # that it happened to; -1 for none
    cause: str = ""  # of a contact: column | ball | drone | ground | ceiling


@dataclass(frozen=True)
class Plan:
    """The motion that a planner intended for a drone at some moment."""

    time: float  # s, when it was being followed
    drone: int
    points: Array  # (K, 4) time s, x, y, z m


@dataclass(frozen=True, eq=False)
class Trace:
    """What one method did: T = S + 1 samples from the start, S steps between them, N drones, M balls."""

    method: str  # unique in a recording
    facts: Mapping[str, Any]  # who flew, as run.json says it
    row: Mapping[str, Any]  # the episode's row, JSON types
    position: Array  # (T, N, 3) m
    attitude: Array  # (T, N, 4) body to world, wxyz
    velocity: Array  # (T, N, 3) m/s
    throttle: Array  # (T, N, 4) rotor speed as a share of its maximum
    ball: Array  # (T, M, 3) m, NaN before the throw
    command: Array  # (S, N, 4) roll, pitch, yaw rate and thrust in [-1, 1]
    reward: Array  # (S, N, 4) in the order of OBJECTIVES
    gap: Array  # (S, N, 3) m, least distances along the step in the order of CAUSES, inf for nothing there
    formation_error: Array  # (S,) m, the integrand of FM
    throws: Sequence[Throw]
    events: Sequence[Event]
    plans: Sequence[Plan] = ()

    def __post_init__(self) -> None:
        samples, drones = self.position.shape[:2]
        steps = samples - 1
        wanted = {
            "position": (samples, drones, 3),
            "attitude": (samples, drones, 4),
            "velocity": (samples, drones, 3),
            "throttle": (samples, drones, 4),
            "ball": (samples, self.ball.shape[1], 3),
            "command": (steps, drones, 4),
            "reward": (steps, drones, 4),
            "gap": (steps, drones, 3),
            "formation_error": (steps,),
        }
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise RecordingError(f"{name} of '{self.method}' is {getattr(self, name).shape}, {shape} was expected")

    def every(self, count: int) -> "Trace":
        """The trace with ``count`` steps as one: rewards add up, distances are least ones, FM is their mean."""
        steps = (len(self.position) - 1) // count
        samples = slice(0, steps * count + 1, count)

        def joined(values: Array) -> Array:
            return values[: steps * count].reshape(steps, count, *values.shape[1:])

        return dataclasses.replace(
            self,
            **{name: getattr(self, name)[samples] for name in ("position", "attitude", "velocity", "throttle", "ball")},
            command=joined(self.command)[:, 0],
            reward=joined(self.reward).sum(1),
            gap=joined(self.gap).min(1),
            formation_error=joined(self.formation_error).mean(1),
        )

    def hit(self, scene: Scene) -> NDArray[np.bool_]:
        """Whether each drone has touched anything or crashed so far (T, N)."""
        height = self.position[..., 2]
        touched = (height < scene.altitude[0]) | (height > scene.altitude[1])
        touched[1:] |= (self.gap < scene.hit_radius).any(-1)
        return np.logical_or.accumulate(touched, axis=0)


@dataclass(frozen=True, eq=False)
class Recording:
    """One scenario and everybody who flew it, the method of most interest first."""

    scene: Scene
    traces: tuple[Trace, ...]
    provenance: Mapping[str, Any]  # JSON types: commit, versions, call

    def __post_init__(self) -> None:
        names = [trace.method for trace in self.traces]
        if not names or len(set(names)) < len(names):
            raise RecordingError(f"a recording needs methods of different names, not {names}")

    def times(self, trace: Trace) -> Array:
        """Sample times (T,) in s."""
        return np.arange(len(trace.position), dtype=np.float64) * self.scene.period

    def sampled(self, period: float) -> "Recording":
        """The recording with samples ``period`` s apart; RecordingError where that is no multiple of its own period."""
        count = round(period / self.scene.period)
        if not np.isclose(count * self.scene.period, period):
            raise RecordingError(f"samples {self.scene.period:g} s apart cannot be thinned to {period:g} s")
        scene = dataclasses.replace(self.scene, period=period)
        return dataclasses.replace(self, scene=scene, traces=tuple(trace.every(count) for trace in self.traces))

    def takes_place_in(self, scene: Any) -> bool:
        """Whether this is an episode of ``scene``, number for number."""
        return same(self.scene, scene)


def same(one: Any, other: Any) -> bool:
    """Whether two records are equal, number for number; NaN equals NaN."""
    if dataclasses.is_dataclass(one):
        fields = dataclasses.fields(one)
        return type(one) is type(other) and all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields)
    if isinstance(one, np.ndarray):
        return one.shape == np.shape(other) and np.array_equal(one, other, equal_nan=True)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def merge(recordings: Sequence[Recording]) -> Recording:
    """Recordings of one scenario as one. Methods of equal names are numbered. RecordingError for other scenes."""
    first = recordings[0]
    traces: list[Trace] = []
    for recording in recordings:
        if not same(recording.scene, first.scene):
            raise RecordingError("these recordings are of different scenes and cannot be laid over each other")
        for trace in recording.traces:
            taken = {other.method for other in traces}
            count = 2
            name = trace.method
            while name in taken:
                name, count = f"{trace.method} ({count})", count + 1
            traces.append(dataclasses.replace(trace, method=name))
    return Recording(first.scene, tuple(traces), first.provenance)
