"""An episode of an evaluation once more, alone or with other methods beside it: what ``formctl replay`` does."""

from collections.abc import Sequence
from pathlib import Path

from analysis.recordings import Recording, mcap_reader, merge, modes
from formctl import extras
from formctl.console import say, warn
from formctl.errors import ConfigError
from formctl.evaluation import stored
from formctl.evaluation.recorder import record_episode, sentence
from formctl.settings import build
from formctl.viewers import files


def replay(
    what: str,
    *,
    vs: Sequence[str] = (),
    out: Path | None = None,
    video: Path | None = None,
    rerun: bool = False,
    view: str = "chase",
    policy: str | None = None,
    runs: Path = Path("runs"),
) -> dict[str, Path]:
    """Write page, MCAP and picture of ``RUN:EPISODE`` or of a recorded .mcap file; what each is, and where.

    ``vs`` are methods flown on the same scene; ``video`` a film of the first method, seen by camera ``view`` of
    ``envs.render.VIEWS``; ``rerun`` adds a .rrd for the Rerun viewer; ``policy`` says where the one that flew is, if it
    is not in the store ``runs``.
    """
    if video is not None and video.suffix not in (".mp4", ".gif"):  # a .png would replace the picture
        raise ConfigError(f"--video {video} cannot be made: the film has to end in .mp4 or .gif")
    if rerun:
        extras.require("rerun", "rerun", "rerun-sdk")
    if what.endswith(".mcap"):
        recording, stem = read_recording(what, vs), Path(what).with_suffix("")
    else:
        recording, stem = fly_again(what, vs, runs, policy), Path(f"replay-{what.rpartition(':')[2]}")
    for trace in recording.traces:
        for mode in modes(recording, trace):
            say(f"{trace.method}: {mode}")
    written = files.write(recording, out or stem)
    if rerun:
        written["rerun"] = files.write_rerun(recording, out or stem)
    if video is not None:
        files.film(recording, video, view)
        written["film"] = video
    for name, path in written.items():
        say(f"{name}: {path}")
    return written


def read_recording(path: str, vs: Sequence[str] = ()) -> Recording:
    """A recorded file. Raises ValueError: unreadable, or methods to be flown beside it."""
    if vs:
        raise ConfigError(f"--vs needs a scene to fly: give RUN:EPISODE instead of {path}")
    return mcap_reader.read(Path(path))


def fly_again(what: str, vs: Sequence[str], runs: Path, policy: str | None) -> Recording:
    """The episode flown again by its own method and by the others, told as they land."""
    episode = stored.find(what, runs, policy, also=", or the path of an .mcap file")
    build.use_threads(episode.config)
    recordings = []
    for method in (episode.method, *(stored.opponent(text, runs) for text in vs)):
        flight = record_episode(method, episode.scene, episode.episode, episode.config)
        say(f"{method.name}: {sentence(flight.row)}")
        if method is episode.method and (changed := stored.differences(flight.row, episode.row)):
            warn(f"this is not the evaluation's flight: {', '.join(changed)} differ (another version, machine?)")
        recordings.append(flight.recording)
    return merge(recordings)
