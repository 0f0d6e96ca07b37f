"""``formctl reproduce``: the paper's whole pipeline as one resumable chain of stages."""

from typing import Annotated

import typer

from formctl.commands.options import Overrides, ShowConfig, show_settings


def command(
    overrides: Overrides = None,
    plan: Annotated[bool, typer.Option("--plan", help="Say what is there and what would be run, and stop.")] = False,
    cfg: ShowConfig = False,
) -> None:
    """The whole pipeline as one resumable graph of stages: profile=smoke, laptop or paper.

    With survey=paper: every flight of the report that the store lacks, by the policies it has and by all baselines.
    """
    if cfg:
        show_settings(overrides or [])
    from formctl.stages.reproduce import reproduce

    reproduce(overrides or [], plan=plan)
