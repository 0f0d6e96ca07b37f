"""Behaviour pictures: every method's recorded flight in the same episode of the paper's two scenes (paper, Fig. 4).

They are drawn from the recordings that ``formctl eval --record`` leaves beside the rows.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from analysis import commands
from analysis.evidence import Evidence
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


def pictures(evidence: Evidence) -> "list[Drawn]":
    """A figure for each scene, or what to type for it."""
    return [_picture(evidence, scenario, title) for scenario, title in SCENES.items()]


def unrecorded(evidence: Evidence) -> tuple[str, ...]:
    """Commands for the methods that are missing in a picture that could be drawn."""
    missing = []
    for scenario in SCENES:
        shown = {method.key for method, _ in recorded(evidence, scenario)}
        missing += [_command(evidence, method, scenario) for method in _methods(evidence) if method.key not in shown]
        if not shown:
            return ()
    return tuple(missing)


def _picture(evidence: Evidence, scenario: str, title: str) -> "Drawn":
    from analysis.plates import Gap

    found = list(recorded(evidence, scenario))
    if not found:
        known = [_command(evidence, method, scenario) for method in _methods(evidence)]
        return Gap(f"behaviour_{scenario}", title, tuple(known or [commands.everything(evidence.profile)]))
    from analysis import figures
    from analysis.recordings import merge

    recording = merge([flown for _, flown in found])
    names = [evidence.names[method.key] for method, _ in found]
    cells = [(method.key, where) for method, _ in found for where in evidence.places(scenario)]
    stamp = str(evidence.stamp(cells))
    figure = figures.draw_behaviour(recording, stamp, names)
    scene = recording.scene
    caption = (
        f"Episode {scene.episode} of bank {scene.bank[:8]}, from above and in perspective; trails darken with time, a "
        "formation every 2 s. Balls are thrown at the drones of each method and so fly differently."
    )
    data = figures.behaviour_data(recording, names)
    return figures.Plate(f"behaviour_{scenario}", title, caption, figure, data, stamp, double=True)


def _methods(evidence: Evidence) -> list[Method]:
    return list(evidence.expected)


def _command(evidence: Evidence, method: Method, scenario: str) -> str:
    return commands.fly(evidence, method, [f"scenario={scenario}", RECORD])


def recorded(evidence: Evidence, scenario: str) -> "Iterator[tuple[Method, Recording]]":
    """The methods' recordings of one and the same episode, in the order of tables; the latest one of each."""
    latest: dict[str, Recording] = {}
    owner = {run: key for (key, _), rows in evidence.cells.items() for run in rows["eval_run"].unique()}
    for run in evidence.runs:  # oldest first
        if run.raw.get("scenario") == scenario and run.id in owner:
            recording = _first(run)
            if recording is not None:
                latest[owner[run.id]] = recording
    scene = next((latest[method.key].scene for method in _methods(evidence) if method.key in latest), None)
    for method in _methods(evidence):
        flown = latest.get(method.key)
        if flown is not None and flown.takes_place_in(scene):
            yield method, flown


def _first(run: Run) -> "Recording | None":
    """The run's first recording that can be read."""
    from analysis.recordings import RecordingError, mcap_reader

    for name in sorted(run.raw.get("recordings") or ()):
        try:
            return mcap_reader.read(run.folder / name)
        except RecordingError:
            continue  # the next one shows the method as well; replaying the file says what is wrong with it
    return None
