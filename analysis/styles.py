"""How a policy dodges, in numbers: speed and shape along its recorded flights (the paper tells them in words).

What follows for the paper's claim about it, the seventh.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis import behaviour, commands, flown, stats, verdicts
from analysis.verdicts import Part, missing

if TYPE_CHECKING:
    from analysis.evidence import Evidence
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
USUALLY = 0.5
"""Share of the throws from which on a way of dodging is the usual one."""


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


def judge(evidence: "Evidence") -> list[Part]:
    """Claim 7: rows hold means only; speed and shape are read from recorded flights."""
    ours, _ = flown.ours(evidence)
    if ours is None:
        command = commands.train_and_fly(evidence, "attention", "three_period")
        return [missing("recorded flights of the full method", command)]
    among = behaviour.flights(evidence, ours, "fixed4")[-1:]  # the columns always stand the same: one shows them all
    passages = [found for flight in among if (found := passage(flight)) is not None]
    throws = [dodge for flight in behaviour.flights(evidence, ours, "dynamic") for dodge in dodges(flight)]
    near = commands.fly(evidence, ours, ["scenario=fixed4", behaviour.RECORD, "--episodes 1"])
    under = commands.fly(evidence, ours, ["scenario=dynamic scenario.balls=1", "--record first=20 --episodes 20"])
    parts = [_shifted(found) for found in passages] or [missing("a recorded flight among columns", near)]
    return [*parts, _slowed(throws, under) if throws else missing("recorded flights under balls", under)]


def _shifted(seen: Passage) -> Part:
    words = f"one flight: centroid {seen.shift:.2f} m aside, FM at most {seen.error:.2f} m"
    return Part(words, seen.as_told, seeds=1)


def _slowed(throws: list[Dodge], more: str) -> Part:
    told = stats.rate([dodge.as_told for dodge in throws])
    before, least, after = (f"{speed:.2f}" for speed in np.mean([dodge[:3] for dodge in throws], 0))
    words = (
        f"all slow down and resume at {told.k} of {told.n} throws [{told.low:.2f}, {told.high:.2f}]; on average "
        f"{before} m/s before, {least} at least, {after} after"
    )
    return Part(words, verdicts.reaches(told.low, told.high, USUALLY), more, seeds=1)
