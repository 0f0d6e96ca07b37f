"""How a policy dodges, in numbers: speed and shape along its recorded flights (the paper tells them in words)."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis import behaviour

if TYPE_CHECKING:
    from analysis.evidence import Evidence
    from analysis.methods import Method
    from analysis.recordings import Recording

BEFORE, AFTER = 1.0, 2.0
"""s before a throw, and after the ball has landed, over which speeds are averaged."""
SLOWER = 0.1
"""m/s that a drone has to lose to have slowed down."""
RESUMED = 0.9
"""Share of the speed before that counts as having resumed."""
SHIFTED = 0.1
"""m that the centroid moves aside among columns to have shifted."""
SLIGHTLY = 0.5
"""m, FM at its worst that still is a slight twist."""


class Dodge(NamedTuple):
    """Mean speed of the team along the course, m/s, and whether all drones slowed down, around one throw."""

    before: float
    least: float
    after: float
    together: bool

    @property
    def as_told(self) -> bool:
        """All drones slow down together, then resume."""
        return self.together and self.after >= RESUMED * self.before


class Passage(NamedTuple):
    """Among the columns: how far the centroid moves aside, and FM at its worst; m."""

    shift: float
    error: float

    @property
    def as_told(self) -> bool:
        """The centroid shifts and the shape twists slightly."""
        return self.shift >= SHIFTED and self.error <= SLIGHTLY


def dodges(recording: "Recording") -> list[Dodge]:
    """Every throw of a recorded flight that ends long enough before the flight does."""
    trace, period = recording.traces[0], recording.scene.period
    speed = trace.velocity[..., 1]  # (T, N)
    found = []
    for throw in trace.throws:
        start, landed = round(throw.time / period), round(throw.landing / period)
        last = landed + round(AFTER / period)
        first = start - round(BEFORE / period)
        if first < 0 or last > len(speed):
            continue
        own = speed[first:start].mean(0)
        together = bool((speed[start:landed].min(0) <= own - SLOWER).all())
        least = float(speed[start:landed].mean(1).min())
        found.append(Dodge(float(own.mean()), least, float(speed[landed:last].mean()), together))
    return found


def passage(recording: "Recording") -> Passage | None:
    """From 1 m before the first column to 1 m beyond the last; None without columns or when nobody got there."""
    trace, columns = recording.traces[0], recording.scene.columns
    centroid = trace.position.mean(1)
    if not len(columns):
        return None
    among = (centroid[:, 1] >= columns[:, 1].min() - 1) & (centroid[:, 1] <= columns[:, 1].max() + 1)
    error = np.concatenate([[0.0], trace.formation_error])[: len(among)][among] if among.any() else np.empty(0)
    if not error.size:
        return None
    return Passage(float(np.abs(centroid[among, 0]).max()), float(error.max()))


def recorded(evidence: "Evidence", method: "Method", scenario: str) -> "Recording | None":
    """The method's recording in one of ``behaviour.SCENES``; None where there is none."""
    flights = behaviour.recorded(evidence, scenario)
    return next((flight.recording for flight in flights if flight.method.key == method.key), None)
