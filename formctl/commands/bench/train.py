"""``formctl bench train``: how fast the learners train on this machine, and where their time goes."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.commands.options import Overrides, configs

if TYPE_CHECKING:
    from formctl.settings import Config
    from formctl.store import Run
    from formctl.timing.speed import Speed

LEARNERS = ("mappo", "mappo_fast", "shac")
"""Files of ``conf/algo``."""

REWARDS = {"mappo": "shaped", "mappo_fast": "shaped", "shac": "smooth"}
"""Reward of a learner where the call names none."""

STOCK = "mappo_fast"
"""Whose sizes TorchRL's pieces are measured with."""

Learners = Annotated[
    list[str] | None, typer.Option("--learner", help="A file of conf/algo; may be repeated. Default: all of them.")
]


def train(
    overrides: Overrides = None,
    learner: Learners = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Least length of each measurement.")] = 20.0,
    compiled: Annotated[bool, typer.Option(help="Measure the compiled learners as well.")] = True,
    stock: Annotated[bool, typer.Option(help="Measure TorchRL's own MAPPO as well.")] = True,
) -> None:
    """Environment steps per second of every learner and what they go into; TorchRL's own MAPPO as a yardstick."""
    from formctl import console
    from formctl.store import provenance

    chosen = {name: compose_learner(overrides, name) for name in learner or LEARNERS}
    reference = compose_learner(overrides, STOCK)
    modes = (False, True) if compiled else (False,)
    plan = [(name, config, mode) for name, config in chosen.items() for mode in modes]
    compiling = "; compiling takes a minute or more each" if compiled else ""
    console.say(f"about to measure {len(plan) + stock} trainings, three updates or {seconds:g} s each{compiling}")
    run = provenance.new_run(reference, "bench", scenario=reference.scenario.name)
    with run.work() as live:
        speeds = list(measure(plan, reference if stock else None, seconds))
        live.update(result={"speeds": [asdict(speed) for speed in speeds]})
        write(live, speeds)
    peak = speeds[0].peak_gflops
    title = f"scenario {reference.scenario.name}, {reference.engine.threads} thread(s), matrix peak {peak:.1f} GFLOP/s"
    columns = ("learner", "mode", "envs x steps", "env steps/s", *parts(), "GFLOP/s", "of peak")
    console.table(columns, [cells(speed) for speed in speeds], title=title)
    console.say(f"table: {run.path / 'speeds.csv'}")
    console.say(f"figure: {run.path / 'speeds.png'}")


def compose_learner(overrides: list[str] | None, name: str) -> "Config":
    """The settings with one learner and, where none is typed, the reward it is meant for."""
    typed = list(overrides or [])
    reward = [f"reward={REWARDS[name]}"] if name in REWARDS and not any(t.startswith("reward=") for t in typed) else []
    (config,) = configs([*typed, f"algo={name}", *reward])
    return config


def measure(plan: list[tuple[str, "Config", bool]], stock: "Config | None", seconds: float) -> Iterator["Speed"]:
    """Measure every planned training (learner, settings, compiled or not), then TorchRL's."""
    from dataclasses import replace

    import torch

    from formctl.console import track
    from formctl.settings import build
    from formctl.timing import speed

    peak = 0.0
    for name, config, compiled in track(plan, "bench", "trainings"):
        build.use_threads(config)
        torch.compiler.reset()
        peak = peak or speed.matrix_peak()
        yield speed.measure(name, replace(build.training(config), compile=compiled), seconds, peak)
    if stock is not None:
        build.use_threads(stock)
        yield speed.measure_stock(build.training(stock), seconds, peak)


def write(live: "Run", speeds: list["Speed"]) -> None:
    """``speeds.csv`` and ``speeds.png`` in the run's folder."""
    import pandas as pd

    from analysis.figures import speed as figure
    from analysis.figures import style
    from formctl.store.files import atomic, write_text

    table = pd.DataFrame([asdict(speed) for speed in speeds])
    write_text(live.path / "speeds.csv", table.to_csv(index=False))
    with atomic(live.path / "speeds.png") as path, style.styled():
        figure.draw_speeds(table, parts()).savefig(path, format="png")


def parts() -> tuple[str, ...]:
    """What the time is divided into."""
    from formctl.timing.stopwatch import PARTS

    return PARTS


def cells(speed: "Speed") -> tuple[str, ...]:
    """A measurement as a line of the table."""
    shares = (f"{getattr(speed, part):.0%}" for part in parts())
    sizes = f"{speed.environments} x {speed.rollout}"
    share = f"{speed.update_gflops / speed.peak_gflops:.0%}"
    return (
        speed.learner,
        speed.mode,
        sizes,
        f"{speed.steps_per_second:,.0f}",
        *shares,
        f"{speed.update_gflops:.1f}",
        share,
    )
