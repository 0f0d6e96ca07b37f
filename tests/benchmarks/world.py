"""Environment steps per second of the torch world at several sizes, and MuJoCo's rollout of the same bodies.

python -m tests.benchmarks.world scenario=mixed --environments 256 --environments 4096 --compiled
"""

from typing import Annotated

import torch
import typer

from envs.mujoco_env import rollout_rate
from formctl.console import table
from formctl.settings import build, compose
from formctl.stages.bench import world_speed


def main(
    overrides: Annotated[list[str] | None, typer.Argument()] = None,
    environments: Annotated[list[int] | None, typer.Option(min=1, help="Default 256, 1024 and 4096.")] = None,
    threads: Annotated[int, typer.Option(min=1, help="Torch threads.")] = 1,
    seconds: Annotated[float, typer.Option(min=0.1, help="Length of each measurement.")] = 3.0,
    compiled: Annotated[bool, typer.Option("--compiled", help="Measure the compiled world as well.")] = False,
) -> None:
    """Print one line per size."""
    world = build.world(compose(overrides or []))
    torch.set_num_threads(threads)
    lines = []
    for size in environments or (256, 1024, 4096):
        for mode in (False, True) if compiled else (False,):
            speed = world_speed(world, size, mode, seconds)
            lines.append((speed.what, speed.mode, f"{size:,}", f"{speed.steps_per_second:,.0f}"))
        rate = rollout_rate(world, size, threads=0 if threads == 1 else threads)
        lines.append(("mujoco.rollout, bodies and contacts only", "native", f"{size:,}", f"{rate:,.0f}"))
    table(("world", "mode", "environments", "environment steps/s"), lines)


if __name__ == "__main__":
    typer.run(main)
