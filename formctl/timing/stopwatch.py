"""Where a training's time goes: its parts are wrapped and timed, each second counted once."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

import torch
from torch import nn

from algos.trainer import Trainer

PARTS = ("world", "inference", "loss", "backward", "optimiser", "other")
"""World: observe, step, restart. Inference: networks while flying. Loss: networks and losses on the flown steps.
Backward: through networks, and through the world where a learner does that. Optimiser: clipping and Adam."""


class Stopwatch:
    """Readings of a clock, charged to the innermost part that is under way; to `other` outside of all."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.clock = clock
        self.spent: dict[str, float] = defaultdict(float)
        self._under_way = ["other"]
        self._last = clock()

    @contextmanager
    def charge(self, part: str) -> Iterator[None]:
        """Charge what passes inside to ``part``."""
        self.tick()
        self._under_way.append(part)
        try:
            yield
        finally:
            self.tick()
            self._under_way.pop()

    def tick(self) -> None:
        """Charge what has passed since the last reading."""
        now = self.clock()
        self.spent[self._under_way[-1]] += now - self._last
        self._last = now

    def wrap(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function``, its calls charged to ``part``."""

        @wraps(function)
        def charged(*args: Any, **kwargs: Any) -> Any:
            with self.charge(part):
                return function(*args, **kwargs)

        return charged


Places = list[tuple[Any, str, str]]
"""Owner, attribute and part of what is to be wrapped."""

LEARNING: Places = [
    (torch.Tensor, "backward", "backward"),
    (torch.optim.Adam, "step", "optimiser"),
    (torch.optim.Adam, "zero_grad", "optimiser"),
    (nn.utils, "clip_grad_norm_", "optimiser"),
]


def places(trainer: Trainer) -> Places:
    """What of a training is wrapped."""
    arena, learner = trainer.arena, trainer.learner
    found: Places = [(arena, name, "world") for name in ("observe", "step", "final_observation")]
    found += [(learner, name, "inference") for name in ("act", "value", "forward")]
    found += [(learner, name, "loss") for name in ("losses", "critic_loss")]
    return [*((owner, name, part) for owner, name, part in found if hasattr(owner, name)), *LEARNING]


@contextmanager
def watching(wrapped: Places, watch: Stopwatch) -> Iterator[None]:
    """Charge the calls of everything in ``wrapped`` while the block lasts."""
    before = [(owner, name, vars(owner).get(name)) for owner, name, _ in wrapped]
    for owner, name, part in wrapped:
        setattr(owner, name, watch.wrap(part, getattr(owner, name)))
    watch.tick()
    watch.spent.clear()
    try:
        yield
    finally:
        watch.tick()
        for owner, name, function in before:
            if function is None:
                delattr(owner, name)
            else:
                setattr(owner, name, function)
