"""One mixed episode, in words, as a picture and as a page to look at, on any machine in a minute."""

from collections.abc import Sequence
from pathlib import Path

from envs.bank import Bank
from formctl.console import say
from formctl.evaluation import methods
from formctl.evaluation.recorder import RecordedFlight, record_episode, sentence
from formctl.evaluation.scenes import EvaluationScene
from formctl.settings import Config, build, compose
from formctl.viewers import files

SHIPPED = "mixed"
"""The trained policy that is shown."""


def demo(overrides: Sequence[str] = (), out: Path = Path("formctl-demo.png")) -> dict[str, Path]:
    """Fly one episode, say what happened and write page, recording and picture beside ``out``; where they are."""
    flight = fly(compose(overrides))
    say(sentence(flight.row))
    written = files.write(flight.recording, out.with_suffix(""))
    for name, path in written.items():
        say(f"{name}: {path}")
    say("open the page with a double click; MCAP is for Foxglove, with the layout")
    say(f"  {files.LAYOUT}")
    return written


def fly(config: Config) -> RecordedFlight:
    """The first scenario of the configured seed, flown by the shipped policy."""
    method = methods.policy(str(methods.shipped()[SHIPPED]), config.runs)
    say(f"flying {method.name}, the policy that ships with formctl")
    build.use_threads(config)
    return record_episode(
        method, EvaluationScene(build.world(config), Bank.create(config.scenario, 1, config.seed)), 0, config
    )
