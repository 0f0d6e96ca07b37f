"""How a recorded flight went wrong, in numbers: the ways to fail that the paper tells of its planners (Sec. VI-A3).

A drone that *halts* stands still for a second or more between the start and the goal line: before a ball that is in the
air nearby, before a column that is ahead, or before nothing of the kind. A formation is *torn* while its error stays
above a metre; who tears it is the drone farthest from its slot, aside (swerving) or along the course (left behind).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.record import Array, Recording, Scene, Trace

STANDING = 0.1
"""m/s, below this a drone stands."""
MOVING = 1.0
"""m/s, a drone that has been faster than this has begun its flight."""
LASTING = 1.0
"""s that a halt or a torn formation lasts at least."""
TORN = 1.0
"""m, formation error above which a formation counts as torn (the threshold of the formation objective)."""
BALL = 3.0
"""m, a ball in the air that came this near within a second before or after a drone stopped is what it stopped for."""
AHEAD = (3.0, 0.75)
"""m along the course and aside: a column in this place is what a drone stopped before."""


@dataclass(frozen=True)
class Halt:
    """A drone that stands where it should not."""

    drone: int
    time: float  # s, when it stopped
    seconds: float  # until it moved on, or the end of the judged flight
    before: str  # ball | column | nothing
    gap: float  # m, to the ball when it was nearest, or to the column's axis; inf before nothing

    def __str__(self) -> str:
        what = f"a {self.before} {self.gap:.2f} m away" if self.before != "nothing" else "nothing"
        return f"drone {self.drone} halts before {what} at {self.time:.1f} s for {self.seconds:.1f} s"


@dataclass(frozen=True)
class Tear:
    """A formation that is not one any more."""

    time: float  # s, when its error rose above TORN
    seconds: float  # until it fell below, or the end of the judged flight
    worst: float  # m, its largest error
    drone: int  # farthest from its slot when the error was largest
    aside: float  # m, across the course
    behind: float  # m, along the course; negative ahead

    def __str__(self) -> str:
        way = f"drone {self.drone} is {self.aside:.2f} m aside and {self.behind:.2f} m behind"
        return f"formation torn at {self.time:.1f} s for {self.seconds:.1f} s, error up to {self.worst:.2f} m: {way}"


def modes(recording: Recording, trace: Trace) -> list[Halt | Tear]:
    """Every halt and every tear of one method, in the order of time.

    A flight is judged until all drones have passed the goal line, or until the time limit.
    """
    scene, times = recording.scene, recording.times(trace)
    passed = np.logical_or.accumulate(trace.position[..., 1] >= scene.goal, axis=0)
    end = min(int(np.argmax(np.append(passed.all(1), True))), round(scene.time_limit / scene.period))
    found: list[Halt | Tear] = [*_halts(scene, trace, times, passed, end), *_tears(scene, trace, times, end)]
    return sorted(found, key=lambda mode: mode.time)


def _halts(scene: Scene, trace: Trace, times: Array, passed: NDArray[np.bool_], end: int) -> Iterator[Halt]:
    speed = np.linalg.norm(trace.velocity, axis=-1)
    begun = np.logical_or.accumulate(speed > MOVING, axis=0)
    standing = (speed < STANDING) & begun & ~passed
    for drone in range(standing.shape[1]):
        for first, last in _stretches(standing[:end, drone], scene.period):
            before, gap = _reason(scene, trace, drone, first)
            yield Halt(drone, float(times[first]), (last - first) * scene.period, before, gap)


def _reason(scene: Scene, trace: Trace, drone: int, step: int) -> tuple[str, float]:
    """What a drone that stops at ``step`` stops before, and how far away that is."""
    around = slice(max(step - round(1 / scene.period), 0), step + round(1 / scene.period))
    near = [np.inf]
    times = np.arange(len(trace.position))[around] * scene.period
    for throw in trace.throws:
        aloft = (times >= throw.time) & (times < throw.landing)
        away = np.linalg.norm(trace.ball[around, throw.ball] - trace.position[around, drone], axis=-1)
        near += away[aloft].tolist()
    if min(near) < BALL:
        return "ball", float(min(near))
    course = scene.velocity[:2] / np.linalg.norm(scene.velocity[:2])
    way = scene.columns - trace.position[step, drone, :2]
    ahead, aside = way @ course, np.abs(way @ np.array([course[1], -course[0]]))
    met = (ahead > 0) & (ahead < AHEAD[0]) & (aside < AHEAD[1])
    return ("column", float(np.linalg.norm(way[met], axis=-1).min())) if met.any() else ("nothing", float("inf"))


def _tears(scene: Scene, trace: Trace, times: Array, end: int) -> Iterator[Tear]:
    course = scene.velocity / np.linalg.norm(scene.velocity)
    for first, last in _stretches(trace.formation_error[:end] > TORN, scene.period):
        worst = first + int(np.argmax(trace.formation_error[first:last]))
        off = trace.position[worst + 1] - scene.slots  # an error is that of the step's end
        off = off - np.median(off, axis=0)  # one drone astray does not move the others' places
        drone = int(np.argmax(np.linalg.norm(off, axis=-1)))
        along = float(off[drone] @ course)
        aside = float(np.linalg.norm(off[drone] - along * course))
        seconds, error = (last - first) * scene.period, float(trace.formation_error[worst])
        yield Tear(float(times[first + 1]), seconds, error, drone, aside, -along)


def _stretches(true: NDArray[np.bool_], period: float) -> Iterator[tuple[int, int]]:
    """(first, past the last) step of every unbroken stretch of at least LASTING seconds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], true, [False])).astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if (last - first) * period >= LASTING - 1e-9:
            yield int(first), int(last)
