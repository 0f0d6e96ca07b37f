"""How a policy dodges, in numbers: speed and shape along its recorded flights (the paper tells them in words)."""

from typing import NamedTuple

import numpy as np

from analysis.recordings import Recording

BEFORE, AFTER = 1.0, 2.0
"""s before a throw, and after the ball has landed, over which speeds are averaged."""
SLOWER = 0.1
"""m/s that a drone has to lose to have slowed down."""
RESUMED = 0.9
"""Share of the speed before that counts as having resumed."""


class Dodge(NamedTuple):
    """Mean speed of the team along the course, m/s, and whether all drones slowed down, around one throw."""

    before: float
    least: float
    after: float
    together: bool

    @property
    def resumed(self) -> bool:
        """All drones slow down together, then resume."""
        return self.together and self.after >= RESUMED * self.before


class Passage(NamedTuple):
    """Among the columns: how far the centroid moves aside, and FM at its worst; m."""

    shift: float
    error: float


def dodges(recording: Recording) -> list[Dodge]:
    """Every throw of a recorded flight that ends long enough before the flight does, while no other ball flies."""
    trace, period = recording.traces[0], recording.scene.period
    speed = trace.velocity[..., 1]  # (T, N)
    found = []
    for throw in trace.throws:
        start, landed = round(throw.time / period), round(throw.landing / period)
        last = landed + round(AFTER / period)
        first = start - round(BEFORE / period)
        begun, over = throw.time - BEFORE, throw.landing + AFTER
        others = [other for other in trace.throws if other is not throw]
        if first < 0 or last > len(speed) or any(o.time < over and o.landing > begun for o in others):
            continue
        own = speed[first:start].mean(0)
        together = bool((speed[start:landed].min(0) <= own - SLOWER).all())
        least = float(speed[start:landed].mean(1).min())
        found.append(Dodge(float(own.mean()), least, float(speed[landed:last].mean()), together))
    return found


def passage(recording: Recording) -> Passage | None:
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
