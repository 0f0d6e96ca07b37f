"""``formctl demo``: one mixed episode, in words, as a picture and as a page to look at, on any machine in a minute."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.commands.options import Overrides, configs

if TYPE_CHECKING:
    from formctl.flying.recording import Flight
    from formctl.settings import Config

SHIPPED = "mixed"
"""The trained policy that is shown."""


def command(
    overrides: Overrides = None,
    out: Annotated[Path, typer.Option(help="Where the picture goes; the page and the recording go beside it.")] = Path(
        "formctl-demo.png"
    ),
) -> None:
    """Fly one episode of the mixed scenario and show what happened."""
    from formctl import showing
    from formctl.console import say
    from formctl.flying import recording

    (config,) = configs(overrides)
    flight = fly(config)
    say(recording.tell(flight.row))
    for name, path in showing.write(flight.recording, out.with_suffix("")).items():
        say(f"{name}: {path}")
    say("open the page with a double click; MCAP is for Foxglove, with the layout")
    say(f"  {showing.LAYOUT}")


def fly(config: "Config") -> "Flight":
    """The first scenario of the configured seed, flown by the shipped policy."""
    from envs.bank import Bank
    from formctl.console import say
    from formctl.flying import methods, recording
    from formctl.flying.evaluation import Scene
    from formctl.settings import build

    method = methods.policy(str(methods.shipped()[SHIPPED]), config.runs)
    say(f"flying {method.name}, the policy that ships with formctl")
    build.use_threads(config)
    scene = Scene(build.world(config), Bank.create(config.scenario, 1, config.seed))
    return recording.fly(method, scene, config, 0)
