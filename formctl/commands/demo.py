"""``formctl demo``: one mixed episode, in words, as a picture and as a page to look at, on any machine in a minute."""

from pathlib import Path
from typing import Annotated

import typer

from formctl.commands.options import Overrides


def command(
    overrides: Overrides = None,
    out: Annotated[Path, typer.Option(help="Where the picture goes; the page and the recording go beside it.")] = Path(
        "formctl-demo.png"
    ),
) -> None:
    """Fly one episode of the mixed scenario and show what happened."""
    from formctl.stages.demo import demo

    demo(overrides or [], out)
