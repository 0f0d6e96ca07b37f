"""How fast learners train here, against this machine's matrix products and TorchRL's own pieces."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from algos.curriculum import CurriculumSpec, Period
from algos.encoder import EncoderSpec
from algos.trainer import Trainer, TrainSettings
from formctl.timing.stopwatch import PARTS, Places, Stopwatch, places, watching

UPDATE = ("loss", "backward", "optimiser")
"""Parts that make up learning from what was flown."""

ENDLESS = 10**12
"""Environment steps that no measurement uses up."""


@dataclass(frozen=True)
class Speed:
    """One line of the benchmark. An environment step moves all drones of one environment; shares are of the time."""

    learner: str
    mode: str  # eager or compiled
    environments: int
    rollout: int  # steps between updates
    steps_per_second: float  # environment steps, flying and learning together
    world: float
    inference: float
    loss: float
    backward: float
    optimiser: float
    other: float
    update_gflops: float  # matrix products of loss and backward, per second of loss, backward and optimiser, in 1e9
    peak_gflops: float  # of one large matrix product, measured in the same run
    first_seconds: float  # of the first two updates: compiling and what is only done once


def measure(name: str, settings: TrainSettings, seconds: float, peak: float) -> Speed:
    """Train for ``seconds``, at least one update, after two updates that are not counted."""
    settings = replace(settings, curriculum=_one_period(), steps=ENDLESS)
    trainer = Trainer(settings)
    updates = trainer.train()
    begun = time.perf_counter()
    for _ in range(2):
        next(updates)
    first = time.perf_counter() - begun
    size = trainer.stage.size

    def update() -> int:
        next(updates)
        return size

    done, watch = _repeat(update, places(trainer), seconds)
    mode = "eager" if not settings.compile else "compiled" if trainer.compiler.enabled else "not compiled: no compiler"
    sizes = (settings.algo.envs, settings.algo.rollout)
    return _speed(name, mode, sizes, done, watch, flops(settings), peak, first)


def measure_stock(settings: TrainSettings, seconds: float, peak: float) -> Speed:
    """The same of TorchRL's own MAPPO with the sizes of ``settings.algo``, a MAPPO."""
    from formctl.timing.stock import Stock

    stock = Stock(settings)
    begun = time.perf_counter()
    stock.update()
    first = time.perf_counter() - begun
    done, watch = _repeat(stock.update, stock.places(), seconds)
    sizes = (settings.algo.envs, settings.algo.rollout)
    return _speed("torchrl", "eager", sizes, done, watch, flops(settings), peak, first)


def flops(settings: TrainSettings) -> dict[str, float]:
    """Floating-point operations of the matrix products per environment step and part.

    Counted by ``torch.utils.flop_counter`` in one eager update with as few environments as its minibatches divide.
    """
    settings = replace(settings, algo=_smallest(settings.algo), curriculum=_one_period(), compile=False)
    if isinstance(settings.encoder, EncoderSpec):  # PyTorch's modules do the same products, and the counter sees them
        settings = replace(settings, encoder=replace(settings.encoder, attention="broadcast"))
    trainer = Trainer(settings)
    updates = trainer.train()
    with FlopCounterMode(display=False) as counter:
        watch = Stopwatch(counter.get_total_flops)
        with watching(places(trainer), watch):
            next(updates)
    return {part: count / trainer.stage.size for part, count in watch.spent.items()}


def matrix_peak(size: int = 1024, seconds: float = 1.0) -> float:
    """Floating-point operations per second, in 1e9, of the fastest of repeated float32 products of square matrices."""
    left, right = torch.rand((2, size, size), generator=torch.Generator().manual_seed(0))
    best, begun = float("inf"), time.perf_counter()
    while time.perf_counter() - begun < seconds:
        started = time.perf_counter()
        torch.mm(left, right)
        best = min(best, time.perf_counter() - started)
    return 2 * size**3 / best / 1e9


def _repeat(update: Callable[[], int], wrapped: Places, seconds: float) -> tuple[int, Stopwatch]:
    """Environment steps done in ``seconds`` of updates, and what the time was spent on."""
    watch, done = Stopwatch(), 0
    with watching(wrapped, watch):
        begun = time.perf_counter()
        while done == 0 or time.perf_counter() - begun < seconds:
            done += update()
    return done, watch


def _speed(
    name: str,
    mode: str,
    sizes: tuple[int, int],
    done: int,
    watch: Stopwatch,
    counted: dict[str, float],
    peak: float,
    first: float,
) -> Speed:
    total = sum(watch.spent.values())
    learning = sum(watch.spent[part] for part in UPDATE)
    work = done * sum(counted.get(part, 0) for part in UPDATE)
    share = {part: watch.spent[part] / total for part in PARTS}
    return Speed(
        learner=name,
        mode=mode,
        environments=sizes[0],
        rollout=sizes[1],
        steps_per_second=done / total,
        world=share["world"],
        inference=share["inference"],
        loss=share["loss"],
        backward=share["backward"],
        optimiser=share["optimiser"],
        other=share["other"],
        update_gflops=work / learning / 1e9,
        peak_gflops=peak,
        first_seconds=first,
    )


def _smallest(algo: Any) -> Any:
    """The learner with the fewest environments, a power of two from 8, that its settings allow."""
    envs = 8
    while envs < algo.envs:
        try:
            return replace(algo, envs=envs, pool=min(algo.pool, envs))
        except ValueError:
            envs *= 2
    return replace(algo, pool=min(algo.pool, algo.envs))


def _one_period() -> CurriculumSpec:
    return CurriculumSpec("bench", (Period("all", 1, {}, "previous"),))
