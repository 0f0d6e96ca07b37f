"""Where a learner's time goes, by torch.profiler, and TorchRL's own MAPPO as a yardstick.

python -m tests.benchmarks.learners algo=shac reward=smooth --updates 5
python -m tests.benchmarks.learners algo=mappo_fast reward=shaped --stock
"""

import time
from typing import Annotated

import torch
import typer
from torch.profiler import ProfilerActivity, profile

from algos.mappo import MappoSpec
from algos.trainer import Trainer
from formctl.settings import build, compose
from formctl.stages.bench import learner_speed, one_period


def main(
    overrides: Annotated[list[str] | None, typer.Argument()] = None,
    updates: Annotated[int, typer.Option(min=1, help="Updates that are profiled.")] = 3,
    rows: Annotated[int, typer.Option(min=1, help="Operators that are shown.")] = 20,
    seconds: Annotated[float, typer.Option(help="Length of the unprofiled measurement.")] = 10.0,
    stock: Annotated[
        bool, typer.Option("--stock", help="Measure TorchRL's MAPPO with the sizes of algo= too.")
    ] = False,
) -> None:
    """Profile some updates and measure others without the profiler, which slows them."""
    config = compose(overrides or [])
    build.use_threads(config)
    trainer = Trainer(one_period(build.training(config)))
    running = trainer.train()
    next(running)
    with profile(activities=[ProfilerActivity.CPU], with_flops=True) as profiled:
        for _ in range(updates):
            next(running)
    print(profiled.key_averages().table(sort_by="self_cpu_time_total", row_limit=rows))
    speed = learner_speed(config, config.train.compile, seconds)
    print(f"{speed.what}, {speed.mode}: {speed.steps_per_second:,.0f} environment steps/s")
    print(f"matrix products of float32 here: {matrix_peak():.1f} GFLOP/s")
    if stock and isinstance(config.algo, MappoSpec):
        from tests.benchmarks.stock import Stock  # TorchRL takes five seconds to import

        yardstick = Stock(build.training(config))
        yardstick.update()
        begun = time.perf_counter()
        steps = sum(yardstick.update() for _ in range(updates))
        print(f"TorchRL's MAPPO, eager: {steps / (time.perf_counter() - begun):,.0f} environment steps/s")


def matrix_peak(size: int = 1024, seconds: float = 1.0) -> float:
    """Floating-point operations per second, in 1e9, of the fastest of repeated float32 products of square matrices."""
    left, right = torch.rand((2, size, size), generator=torch.Generator().manual_seed(0))
    best, begun = float("inf"), time.perf_counter()
    while time.perf_counter() - begun < seconds:
        started = time.perf_counter()
        torch.mm(left, right)
        best = min(best, time.perf_counter() - started)
    return 2 * size**3 / best / 1e9


if __name__ == "__main__":
    typer.run(main)
