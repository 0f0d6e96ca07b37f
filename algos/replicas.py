"""Data-parallel training: processes with the same networks fly a share of the episodes each and average gradients.

Sums run in the order of ranks, in every process alike, so that the same seed and the same number of processes give the
same networks, bit for bit, in all of them. Rank 0 leads: it keeps the run folder and tells the others what to do next.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

PATIENCE = timedelta(days=7)
"""Time to wait for another process: it may be compiling or judging. One that has died is noticed at once."""


class ReplicaLost(RuntimeError):
    """Another process of the training is gone."""


class Replicas:
    """The processes of one training, seen from the one of number `rank` among `size`; by itself, a training alone."""

    def __init__(self, rank: int = 0, size: int = 1) -> None:
        self.rank, self.size = rank, size

    @classmethod
    def join(cls, rank: int, size: int, store: dist.Store | None = None) -> "Replicas":
        """Meet the other processes in `store`, or where torchrun's environment variables say. Returns when all came."""
        where: dict[str, Any] = {"init_method": "env://"} if store is None else {"store": store}
        dist.init_process_group("gloo", rank=rank, world_size=size, timeout=PATIENCE, **where)
        return cls(rank, size)

    def leave(self) -> None:
        """Close the connections."""
        if self.size > 1 and dist.is_initialized():
            dist.destroy_process_group()

    @property
    def leads(self) -> bool:
        """Whether this process leads others."""
        return self.size > 1 and self.rank == 0

    def total(self, values: Tensor) -> Tensor:
        """Sum of every process's `values`, of any shape. Raises ReplicaLost."""
        if self.size == 1:
            return values
        parts = [torch.empty_like(values) for _ in range(self.size)]
        with _lost():
            dist.all_gather(parts, values.contiguous())
        result = parts[0]
        for part in parts[1:]:
            result = result + part
        return result

    def mean(self, values: Tensor) -> Tensor:
        """Mean of every process's `values`."""
        return values if self.size == 1 else self.total(values) / self.size

    def mean_figures(self, figures: dict[str, float]) -> dict[str, float]:
        """Mean of every process's `figures`, which have the same keys everywhere."""
        values = self.mean(torch.tensor(list(figures.values()), dtype=torch.float64)) if self.size > 1 else None
        return figures if values is None else dict(zip(figures, values.tolist(), strict=True))

    def average_gradients(self, parameters: Sequence[torch.nn.Parameter], loss: Tensor) -> Tensor:
        """Replace the gradients by their means over all processes; returns the mean of the losses.

        What is not finite in one process is so in all: they agree on whether a training has diverged.
        """
        if self.size == 1:
            return loss
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        mean = self.mean(torch.cat([*(gradient.flatten() for gradient in gradients), loss.detach().flatten()]))
        for gradient, part in zip(gradients, mean.split([*(x.numel() for x in gradients), 1])[:-1], strict=True):
            gradient.copy_(part.view_as(gradient))
        return mean[-1]

    def tell(self, message: Any) -> None:
        """From rank 0 to all others; nothing in a training alone or in another rank. Raises ReplicaLost."""
        if self.leads:
            with _lost():
                dist.broadcast_object_list([message], src=0)

    def hear(self) -> Any:
        """What rank 0 told. Raises ReplicaLost."""
        box = [None]
        with _lost():
            dist.broadcast_object_list(box, src=0)
        return box[0]

    def gather(self, item: Any) -> list[Any]:
        """Every process's `item` in the order of ranks, in rank 0; an empty list elsewhere. Raises ReplicaLost."""
        if self.size == 1:
            return [item]
        found: list[Any] | None = [None] * self.size if self.rank == 0 else None
        with _lost():
            dist.gather_object(item, found, dst=0)
        return found or []


ALONE = Replicas()
"""A training in one process."""


@contextmanager
def _lost() -> Iterator[None]:
    """A connection that breaks means that the process at its other end is gone."""
    try:
        yield
    except RuntimeError as error:
        raise ReplicaLost(str(error).strip().splitlines()[0][:200]) from error
