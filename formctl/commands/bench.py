"""``formctl bench``: how fast worlds, learners and evaluations run on this machine."""

from typing import Annotated

import typer

from formctl.commands.options import Overrides, ShowConfig, show_settings


def command(
    overrides: Overrides = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Least length of each measurement.")] = 5.0,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes that the shipped policy flies.")] = 200,
    cfg: ShowConfig = False,
) -> None:
    """Measure the speed of world, learner and evaluation on this machine.

    Environment steps per second of the world and of the learner of the settings (algo=, train.compile=), and seconds
    for a thousand episodes of the policy that ships with formctl.
    """
    if cfg:
        show_settings(overrides or [])
    from formctl.stages.bench import bench

    bench(overrides or [], seconds=seconds, episodes=episodes)
