"""What a recording becomes: MCAP for Foxglove, a page for a browser, a picture, a film. Files appear complete."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.figures.behaviour import draw_episode
from analysis.recordings import mcap_writer, page
from envs import render
from formctl.console import progress
from formctl.errors import RunFailed
from formctl.store.files import atomic, write_text

if TYPE_CHECKING:
    from analysis.recordings import Recording

LAYOUT = Path(__file__).resolve().parents[2] / "analysis" / "recordings" / "foxglove_layout.json"
"""For Foxglove: Layouts, Import from file."""


GIF: dict[str, Any] = {"width": 480, "height": 270, "fps": 12.5, "speed": 2.0}
"""An animated GIF that a page can carry: about 2 MB for an episode."""


def write(recording: "Recording", stem: Path) -> dict[str, Path]:
    """``STEM.mcap``, ``STEM.html`` and ``STEM.png``; what each of them is, and where."""
    paths = {name: stem.with_name(f"{stem.name}.{name}") for name in ("html", "mcap", "png")}
    write_mcap(recording, paths["mcap"])
    write_text(paths["html"], page.render(recording))
    figure = draw_episode(recording)
    with atomic(paths["png"]) as temporary:
        figure.savefig(temporary, dpi=150, format="png")
    return {"page": paths["html"], "recording": paths["mcap"], "picture": paths["png"]}


def write_mcap(recording: "Recording", path: Path) -> None:
    """A recording as MCAP."""
    with atomic(path) as temporary:
        mcap_writer.write(recording, temporary)


def write_rerun(recording: "Recording", stem: Path) -> Path:
    """A recording as ``STEM.rrd``; where it is."""
    from analysis.recordings import rerun_writer

    path = stem.with_name(f"{stem.name}.rrd")
    with atomic(path) as temporary:
        rerun_writer.write(recording, temporary)
    return path


def film(recording: "Recording", out: Path, view: str) -> None:
    """The first method's flight as .mp4 or .gif. ValueError for a wrong call, RunFailed where nothing renders.

    A .gif is for pages: a quarter of the picture, at twice the speed.
    """
    scene, trace = recording.scene, recording.traces[0]
    taken = render.Recording(
        position=trace.position,
        attitude=trace.attitude,
        balls=trace.ball,
        columns=scene.columns,
        hit=trace.hit(scene),
        dt=scene.period,
        column_radius=scene.column_radius,
        ball_radius=scene.ball_radius,
    )
    try:
        camera = replace(render.VIEWS[view], **(GIF if out.suffix == ".gif" else {}))
        frames = round(len(taken.position) * taken.dt / camera.speed * camera.fps)
        with progress("film", frames, "frames") as bar:
            render.render(taken, out, camera, progress=lambda done, total: bar.update(done))
    except render.RenderError as error:
        raise RunFailed(str(error)) from error
