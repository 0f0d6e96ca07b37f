"""``formctl train``: stage 2, one policy through the periods of a curriculum (paper, Sec. V-B)."""

from typing import Annotated

import typer

from formctl.commands.options import Multirun, Overrides, ShowConfig, show_settings


def command(
    overrides: Overrides = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Go on with a training: path, id or name of its run.")
    ] = None,
    multirun: Multirun = False,
    cfg: ShowConfig = False,
) -> None:
    """Stage 2: one policy through the periods of the curriculum, e.g. curriculum=three_period encoder=no_sa seed=3."""
    from formctl.stages import train, train_sweep

    words = list(overrides or [])
    if train.follows_another():
        return
    if cfg:
        show_settings(words, multirun, lambda combination: train.compose_training(combination)[0])
    if resume is not None:
        train.resume(resume, words)
    elif multirun:
        train_sweep.train_all(words)
    else:
        train.train(words)
