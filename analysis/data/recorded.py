"""Recorded flights: the MCAP files that ``formctl eval --record`` leaves beside the rows."""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from analysis.data.evidence import Evidence, Stamp
from analysis.data.methods import Method
from analysis.data.runs import Run
from analysis.recordings import Recording, RecordingError, mcap_reader


class RecordedFlight(NamedTuple):
    """A method's recorded episode, and the evaluation that it was recorded in."""

    method: Method
    run: Run
    recording: Recording


def same_episode(evidence: Evidence, scenario: str) -> Iterator[RecordedFlight]:
    """The methods' recordings of one and the same episode, in the order of tables: the one that most methods flew.

    Who commands more often was sampled more often: all are thinned to the samples of the first.
    """
    known = {method.key for method in evidence.expected}
    episodes: dict[tuple[str, int], dict[str, RecordedFlight]] = {}
    for run in evidence.runs:  # oldest first: the latest flight of a method stays
        key = evidence.flown[run.id]
        if run.raw.get("scenario") == scenario and key in known:
            for recording in recordings(run):
                flown = episodes.setdefault((recording.scene.bank, recording.scene.episode), {})
                flown[key] = RecordedFlight(evidence.methods[key], run, recording)
    together = max(episodes.values(), key=len, default={})
    flights = [together[method.key] for method in evidence.expected if method.key in together]
    for flight in flights:
        scene = flights[0].recording.scene
        if flight.recording.scene.period <= scene.period:
            flight = flight._replace(recording=flight.recording.sampled(scene.period))
        if flight.recording.takes_place_in(scene):
            yield flight


def of_method(evidence: Evidence, method: Method, scenario: str) -> list[Recording]:
    """Every recorded flight of a method in a scenario, one of each episode: the latest."""
    runs = [run for run in evidence.runs if run.raw.get("scenario") == scenario]  # oldest first
    own = [recording for run in runs if evidence.flown[run.id] == method.key for recording in recordings(run)]
    return list({(recording.scene.bank, recording.scene.episode): recording for recording in own}.values())


def recordings(run: Run) -> Iterator[Recording]:
    """The run's recordings that can be read."""
    files = [run.folder / name for name in sorted(run.raw.get("recordings") or ())]
    return (recording for file in files if (recording := _read(file)) is not None)


def stamp(evidence: Evidence, flights: list[RecordedFlight]) -> Stamp:
    """Stamp of a picture of these flights."""
    return Stamp.of(evidence.profile, (flight.run for flight in flights), episodes=(1,), unit="method")


@lru_cache(maxsize=256)
def _read(file: Path) -> Recording | None:
    """A recording, read once for all that is drawn from it; None for a damaged one, which replaying explains."""
    try:
        return mcap_reader.read(file)
    except RecordingError:
        return None
