"""``formctl replay``: an episode of an evaluation once more, to look at, alone or with other methods beside it."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from formctl.commands.options import StoreOption, StoreWords, store_of


class Camera(StrEnum):
    """Cameras of ``envs.render.VIEWS``."""

    chase = "chase"
    above = "above"
    side = "side"


def command(
    what: Annotated[
        str, typer.Argument(metavar="RUN:EPISODE|FILE", help="An evaluation's episode, or a recorded .mcap file.")
    ],
    overrides: StoreWords = None,
    vs: Annotated[
        list[str] | None, typer.Option(metavar="METHOD", help="A policy or baseline on the same scene; repeatable.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Files without their ending.  [default: replay-EPISODE]")] = None,
    video: Annotated[Path | None, typer.Option(help="A film of the first method too, ending in .mp4 or .gif.")] = None,
    rerun: Annotated[bool, typer.Option("--rerun", help="A .rrd file for the Rerun viewer too.")] = False,
    view: Annotated[Camera, typer.Option(help="Camera of the film.")] = Camera.chase,
    policy: Annotated[
        str | None, typer.Option(metavar="RUN|FILE|NAME", help="The policy that flew, if it is not in the store.")
    ] = None,
    runs: StoreOption = None,
) -> None:
    """Show an episode again: page, MCAP, pictures, film."""
    store = store_of(overrides, runs)
    from formctl.stages.replay import replay

    replay(what, vs=vs or [], out=out, video=video, rerun=rerun, view=view.value, policy=policy, runs=store)
