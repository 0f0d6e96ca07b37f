"""Our C++ against PyTorch, piece by piece and in a whole update, in one run.

    python -m tests.benchmarks.kernels [--environments 64] [--update] [overrides]

prints microseconds per environment step, forward alone and forward with gradient, of the encoder and of the world's
pieces: PyTorch eager, then the C++ operator, and their ratio. ``--update`` adds SHAC's update: everything in C++, and
everything compiled by ``torch.compile`` (minutes, unless it is in the cache). Times are those that this thread
computed, the best of many: other programs hardly show in them.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from algos.compilation import Compiler
from algos.encoder import Encoder, build_encoder
from algos.trainer import Trainer
from envs import scenarios
from envs.dynamics import hover_action
from envs.formation import FormationEnv
from formctl.settings import build, compose


def best(function: Callable[[], Any], seconds: float = 1.0) -> float:
    """Microseconds of this thread's own time, the least of repeated calls."""
    times: list[int] = []
    begun = time.perf_counter()
    while time.perf_counter() - begun < seconds or len(times) < 3:
        started = time.thread_time_ns()
        function()
        times.append(time.thread_time_ns() - started)
    return min(times) / 1e3


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[float, float]:
    """Microseconds of values alone, and of values with the gradient of every number that went in."""

    def differentiable(x: Tensor) -> Tensor:
        return x.detach().requires_grad_() if x.is_floating_point() else x

    given = pytree.tree_map(differentiable, arguments)

    def both() -> None:
        outputs = [x for x in pytree.tree_leaves(function(*given)) if x.grad_fn is not None]
        torch.autograd.backward(outputs, [torch.ones_like(x) for x in outputs])

    with torch.no_grad():
        alone = best(lambda: function(*arguments))
    return alone, best(both)


def update(overrides: list[str]) -> float:
    """Environment steps per second of computing: SHAC's quickest update out of some."""
    settings = build.training(compose(["algo=shac", "reward=smooth", "curriculum=none", *overrides]))
    trainer = Trainer(replace(settings, steps=10**9))
    done = trainer.train()
    next(done), next(done)
    return trainer.stage.size / best(lambda: next(done), seconds=20.0) * 1e6


def pieces(overrides: list[str], environments: int) -> None:
    """Print the table."""
    config = compose(["scenario=mixed", "reward=smooth", *overrides])
    settings = build.training(config)
    plain = FormationEnv(settings.world)
    fast = plain.compiled(Compiler(True))
    drawn = scenarios.sample(settings.world.scenario, environments, 0)
    state, action = plain.reset(drawn), torch.tensor(hover_action(settings.world.drone)).expand(environments, 3, 4)
    before, after = plain.advance(state, action, drawn)
    encoder = build_encoder(settings.encoder, plain.layout, settings.world.scenario.balls)
    modules: Encoder = build_encoder(replace(settings.encoder, attention="sdpa"), plain.layout)
    rows: list[tuple[str, Callable[..., Any], Callable[..., Any], tuple[Any, ...]]] = [
        ("encoder", modules, encoder, (plain.observe(state, drawn),)),
        ("observe", plain.observe, fast.observe, (state, drawn)),
        ("advance", plain.advance, fast.advance, (state, action, drawn)),
        ("judge", plain.judge, fast.judge, (before, after, drawn)),
    ]
    print(f"{'us per environment step':24}{'PyTorch':>18}{'C++':>18}{'ratio':>14}")
    for name, slow, quick, arguments in rows:
        times = [[x / environments for x in timed(function, *arguments)] for function in (slow, quick)]
        ratios = [one / other for one, other in zip(*times, strict=True)]
        print(f"{name:24}" + "".join(f"{a:9.1f}{b:9.1f}" for a, b in times) + "".join(f"{x:7.1f}" for x in ratios))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--environments", type=int, default=64)
    parser.add_argument("--update", action="store_true", help="time SHAC's whole update as well")
    parser.add_argument("--only-update", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("overrides", nargs="*")
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.only_update:
        print(f"{update(given.overrides):.0f}")
        return
    pieces(given.overrides, given.environments)
    if given.update:
        for name, native in (("C++", "1"), ("torch.compile", "0")):
            command = [sys.executable, "-m", "tests.benchmarks.kernels", "--only-update", *given.overrides]
            environment = os.environ | {"FORMCTL_NATIVE": native}
            found = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
            print(f"SHAC, {name}: {found.stdout.strip()} environment steps per second of computing")


if __name__ == "__main__":
    main()
