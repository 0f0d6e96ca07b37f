"""``formctl bench env``: environment steps per second of the torch world, and MuJoCo's rollout as a yardstick."""

import csv
import io
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.commands.options import Overrides, configs

if TYPE_CHECKING:
    from envs.formation import WorldSpec
    from formctl.settings import Config
    from formctl.store import Run

SIZES = (256, 1024, 4096)
"""Environments side by side."""


@dataclass(frozen=True)
class Timing:
    """One line of the benchmark. An environment step moves all drones of one environment."""

    world: str  # torch, or mujoco.rollout (rigid bodies and contacts only: no observation, no reward)
    mode: str  # eager or compiled
    threads: int
    environments: int
    drones: int  # in each environment
    steps_per_second: float  # environment steps
    compile_seconds: float | None


def env(
    overrides: Overrides = None,
    threads: Annotated[list[int] | None, typer.Option(min=1, help="Torch threads; may be repeated. Default 1.")] = None,
    environments: Annotated[list[int] | None, typer.Option(min=1, help="Default 256, 1024 and 4096.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Length of each measurement.")] = 3.0,
    compiled: Annotated[bool, typer.Option(help="Measure the compiled world as well.")] = True,
) -> None:
    """Environment steps per second, observation and reward vector included; MuJoCo's rollout as a yardstick."""
    from formctl import console
    from formctl.store import provenance

    (config,) = configs(overrides)
    counts, sizes = threads or [1], environments or list(SIZES)
    modes = ["eager", *(["compiled"] if compiled else [])]
    plan = [(count, mode, size) for count in counts for mode in modes for size in sizes]
    console.say(f"about to measure {len(plan)} settings, {seconds:g} s each; compiling takes longer than measuring")
    run = provenance.new_run(config, "bench", scenario=config.scenario.name)
    with run.work() as live:
        timings = list(measure(config, plan, seconds)) + list(yardstick(config, counts, sizes))
        live.update(result={"timings": [asdict(timing) for timing in timings]})
        write_csv(live, timings)
    drones = timings[0].drones
    columns = ("world", "mode", "threads", "environments", f"env steps/s, {drones} drones each", "seconds to compile")
    console.table(columns, [cells(timing) for timing in timings], title=f"scenario {config.scenario.name}")
    console.say(f"table: {run.path / 'timings.csv'}")


def measure(config: "Config", plan: list[tuple[int, str, int]], seconds: float) -> Iterator[Timing]:
    """Time the torch world in every setting of ``plan`` (threads, mode, environments)."""
    import torch

    from formctl.console import track
    from formctl.settings import build

    before = torch.get_num_threads()
    try:
        for threads, mode, size in track(plan, "bench", "settings"):
            torch.set_num_threads(threads)
            yield measure_one(build.world(config), threads, mode, size, seconds)
    finally:
        torch.set_num_threads(before)


def measure_one(world: "WorldSpec", threads: int, mode: str, size: int, seconds: float) -> Timing:
    """Steps per second of ``size`` environments under random commands, started again every 50 steps."""
    import torch

    from algos.compilation import Compiler
    from envs.formation import FormationEnv
    from envs.scenarios import sample

    torch.compiler.reset()
    compiler = Compiler(mode == "compiled")
    env = FormationEnv(world).compiled(compiler)
    scenarios = sample(world.scenario, size, seed=0)
    start = env.reset(scenarios)
    actions = torch.rand((50, size, env.drones, 4), generator=torch.Generator().manual_seed(0)) * 2 - 1

    def advance(steps: int) -> None:
        state = start
        for action in actions[:steps]:
            env.observe(state, scenarios)
            state, _, _ = env.step(state, action, scenarios)

    with torch.no_grad():
        begun = time.perf_counter()
        advance(2)
        first = time.perf_counter() - begun
        done, begun = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - begun) < seconds or done == 0:
            advance(len(actions))
            done += len(actions)
    if mode == "compiled" and not compiler.enabled:
        mode = "not compiled: no compiler"
    return Timing(
        "torch", mode, threads, size, env.drones, done * size / elapsed, first if mode == "compiled" else None
    )


def yardstick(config: "Config", counts: list[int], sizes: list[int]) -> Iterator[Timing]:
    """MuJoCo's own rollout of the same bodies."""
    from envs.mujoco_env import rollout_rate
    from envs.shapes import slots
    from formctl.settings import build

    world = build.world(config)
    drones = len(slots(world.scenario))
    for threads in counts:
        for size in sizes:
            rate = rollout_rate(world, size, threads=0 if threads == 1 else threads)
            yield Timing("mujoco.rollout", "native", threads, size, drones, rate, None)


def write_csv(live: "Run", timings: list[Timing]) -> None:
    """``timings.csv`` in the run's folder."""
    from formctl.store.files import write_text

    text = io.StringIO()
    writer = csv.DictWriter(text, list(asdict(timings[0])))
    writer.writeheader()
    writer.writerows(asdict(timing) for timing in timings)
    write_text(live.path / "timings.csv", text.getvalue())


def cells(timing: Timing) -> tuple[str, ...]:
    """A timing as a line of the table."""
    compiling = "" if timing.compile_seconds is None else f"{timing.compile_seconds:.0f}"
    size = f"{timing.environments:,}"
    return timing.world, timing.mode, str(timing.threads), size, f"{timing.steps_per_second:,.0f}", compiling
