"""``formctl replay``: an episode of an evaluation once more, to look at, alone or with other methods beside it."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from analysis.recordings import Recording


class View(StrEnum):
    """Cameras of ``envs.render.VIEWS``."""

    chase = "chase"
    above = "above"
    side = "side"


def command(
    what: Annotated[
        str, typer.Argument(metavar="RUN:EPISODE|FILE", help="An evaluation's episode, or a recorded .mcap file.")
    ],
    vs: Annotated[
        list[str] | None, typer.Option(metavar="METHOD", help="A policy or baseline on the same scene; repeatable.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Files without their ending.  [default: replay-EPISODE]")] = None,
    video: Annotated[Path | None, typer.Option(help="A film of the first method too, ending in .mp4 or .gif.")] = None,
    view: Annotated[View, typer.Option(help="Camera of the film.")] = View.chase,
    policy: Annotated[
        str | None, typer.Option(metavar="RUN|FILE|NAME", help="The policy that flew, if it is not in the store.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="The output store.")] = Path("runs"),
) -> None:
    """Show an episode again: page, MCAP, pictures, film."""
    from analysis.recordings import modes
    from formctl import showing
    from formctl.console import say

    check(video)
    if what.endswith(".mcap"):
        recording, stem = stored(what, vs), Path(what).with_suffix("")
    else:
        recording, stem = flown(what, vs or [], runs, policy), Path(f"replay-{what.rpartition(':')[2]}")
    for trace in recording.traces:
        for mode in modes(recording, trace):
            say(f"{trace.method}: {mode}")
    for name, path in showing.write(recording, out or stem).items():
        say(f"{name}: {path}")
    if video is not None:
        showing.film(recording, video, view.value)
        say(f"film: {video}")


def check(video: Path | None) -> None:
    """Raise ConfigError for a film of another kind, before anything is flown. A .png would replace the picture."""
    from formctl.errors import ConfigError

    if video is not None and video.suffix not in (".mp4", ".gif"):
        raise ConfigError(f"--video {video} cannot be made: the film has to end in .mp4 or .gif")


def stored(path: str, vs: list[str] | None) -> "Recording":
    """A recorded file. Raises ValueError: unreadable, or methods to be flown beside it."""
    from analysis.recordings import mcap_reader
    from formctl.errors import ConfigError

    if vs:
        raise ConfigError(f"--vs needs a scene to fly: give RUN:EPISODE instead of {path}")
    return mcap_reader.read(Path(path))


def flown(what: str, vs: list[str], runs: Path, policy: str | None) -> "Recording":
    """The episode flown again by its own method and by the others, told as they land."""
    from analysis.recordings import merge
    from formctl import console
    from formctl.flying import recording, replaying
    from formctl.settings import build

    found = replaying.find(what, runs, policy, also=", or the path of an .mcap file")
    build.use_threads(found.config)
    others = [replaying.other(text, runs) for text in vs]
    taken = []
    for method in (found.method, *others):
        flight = recording.fly(method, found.scene, found.config, found.episode)
        console.say(f"{method.name}: {recording.tell(flight.row)}")
        if method is found.method and (changed := replaying.differences(flight.row, found.row)):
            console.warn(
                f"this is not the evaluation's flight: {', '.join(changed)} differ (another version, machine?)"
            )
        taken.append(flight.recording)
    return merge(taken)
