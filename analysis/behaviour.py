"""Behaviour pictures: every method's recorded flight in the same episode of the paper's two scenes (paper, Fig. 4).

They are drawn from the recordings that ``formctl eval --record`` leaves beside the rows.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from analysis import baselines, commands
from analysis.evidence import Evidence, Stamp
from analysis.methods import Method
from analysis.records import Run

if TYPE_CHECKING:
    from analysis.plates import Drawn
    from analysis.recordings import Recording

SCENES = {
    "fixed4": "Behaviour among columns",
    "dynamic": "Behaviour under thrown balls",
}
"""The paper's two scenes: four columns that always stand the same, and two balls."""

RECORD = "--record first=1"


class Flight(NamedTuple):
    """A method's recorded episode, and the evaluation that it was recorded in."""

    method: Method
    run: Run
    recording: "Recording"


def pictures(evidence: Evidence) -> "list[Drawn]":
    """A figure for each scene, or what to type for it."""
    return [_picture(evidence, scenario, title) for scenario, title in SCENES.items()]


def unrecorded(evidence: Evidence) -> tuple[str, ...]:
    """Commands for the compared methods that a drawn picture does not show; one of a planner's two sets does."""
    pairs = [(published.key, fair.key) for published, fair in baselines.pairs(evidence.expected)]
    missing = []
    for scenario in SCENES:
        flown = {flight.method.key: flight for flight in recorded(evidence, scenario)}
        if not flown:
            return ()
        drawn = max(map(_bank_size, flown.values()))
        shown = flown.keys() | {key for pair in pairs if flown.keys() & set(pair) for key in pair}
        missing += [_command(evidence, m, scenario, drawn) for m in evidence.compared if m.key not in shown]
    return tuple(missing)


def _picture(evidence: Evidence, scenario: str, title: str) -> "Drawn":
    from analysis.plates import Gap

    found = list(recorded(evidence, scenario))
    if not found:
        known = [_command(evidence, method, scenario) for method in _methods(evidence)]
        return Gap(f"behaviour_{scenario}", title, tuple(known or [commands.everything(evidence)]))
    from analysis import figures
    from analysis.recordings import merge

    recording = merge([flight.recording for flight in found])
    names = [evidence.names[flight.method.key] for flight in found]
    stamp = str(_stamp(evidence, found))
    figure = figures.draw_behaviour(recording, stamp, names)
    scene = recording.scene
    caption = (
        f"Episode {scene.episode} of bank {scene.bank[:8]}, from above and in perspective; trails darken with time, a "
        "formation every 2 s."
    )
    if any(trace.throws for trace in recording.traces):
        caption += " Balls are thrown at the drones of each method and so fly differently."
    data = figures.behaviour_data(recording, names)
    return figures.Plate(f"behaviour_{scenario}", title, caption, figure, data, stamp, double=True)


def _methods(evidence: Evidence) -> list[Method]:
    return list(evidence.expected)


def _command(evidence: Evidence, method: Method, scenario: str, drawn: int = 1) -> str:
    """What records the first of ``drawn`` episodes: as many as the others' bank has, for it to be theirs."""
    return commands.fly(evidence, method, [f"scenario={scenario}", RECORD, f"--episodes {drawn}"])


def _bank_size(flight: Flight) -> int:
    """Episodes of the bank that a flight's episode is one of; one where no record tells."""
    raw = flight.run.raw
    banks = raw.get("banks") or [raw.get("bank") or {}]
    return next((int(b["episodes"]) for b in banks if b.get("sha256") == flight.recording.scene.bank), 1)


def recorded(evidence: Evidence, scenario: str) -> Iterator[Flight]:
    """The methods' recordings of one and the same episode, in the order of tables: the one that most methods flew.

    Who commands more often was sampled more often: all are thinned to the samples of the first.
    """
    known = {method.key for method in _methods(evidence)}
    episodes: dict[tuple[str, int], dict[str, Flight]] = {}
    for run in evidence.runs:  # oldest first: the latest flight of a method stays
        key = evidence.flown[run.id]
        if run.raw.get("scenario") == scenario and key in known:
            for recording in _recordings(run):
                flown = episodes.setdefault((recording.scene.bank, recording.scene.episode), {})
                flown[key] = Flight(evidence.methods[key], run, recording)
    together = max(episodes.values(), key=len, default={})
    flights = [together[method.key] for method in _methods(evidence) if method.key in together]
    for flight in flights:
        scene = flights[0].recording.scene
        if flight.recording.scene.period <= scene.period:
            flight = flight._replace(recording=flight.recording.sampled(scene.period))
        if flight.recording.takes_place_in(scene):
            yield flight


def _stamp(evidence: Evidence, flights: list[Flight]) -> Stamp:
    learnt = [facts for flight in flights if (facts := flight.run.method) is not None and facts.learnt]
    return Stamp(
        profile=evidence.profile,
        steps=tuple(sorted({facts.steps for facts in learnt if facts.steps is not None})),
        seeds=tuple(sorted({facts.seed for facts in learnt})),
        episodes=(1,),
        commits=tuple(dict.fromkeys(flight.run.commit for flight in flights)),
        unit="method",
    )


def flights(evidence: Evidence, method: Method, scenario: str) -> "list[Recording]":
    """Every recorded flight of a method in a scenario, one of each episode: the latest."""
    runs = [run for run in evidence.runs if run.raw.get("scenario") == scenario]  # oldest first
    own = [recording for run in runs if evidence.flown[run.id] == method.key for recording in _recordings(run)]
    return list({(recording.scene.bank, recording.scene.episode): recording for recording in own}.values())


def _recordings(run: Run) -> "Iterator[Recording]":
    """The run's recordings that can be read."""
    files = [run.folder / name for name in sorted(run.raw.get("recordings") or ())]
    return (recording for file in files if (recording := _read(file)) is not None)


@lru_cache(maxsize=256)
def _read(file: Path) -> "Recording | None":
    """A recording, read once for all that is drawn from it; None for a damaged one, which replaying explains."""
    from analysis.recordings import RecordingError, mcap_reader

    try:
        return mcap_reader.read(file)
    except RecordingError:
        return None
