"""Simulated time for planners: results that become known after a latency, and messages on links that delay and lose.

The clock is ``View.time``. Nothing here looks at a real clock, so a slow machine flies the same episode as a fast one.
"""

import heapq
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from baselines.planner.interface import Array, Links

T = TypeVar("T")

TICK = 1e-9
"""s; what is due this much later is due now: sums of control periods are not exact."""


class Due(Generic[T]):
    """Things that become known later: put in with the time they are due, taken out when that time has come."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, T]] = []
        self._count = 0

    def put(self, time: float, item: T) -> None:
        """``item`` is known from ``time`` (s) on."""
        heapq.heappush(self._heap, (time, self._count, item))
        self._count += 1

    def take(self, now: float) -> list[T]:
        """Everything due up to ``now`` (s), the earliest first; equal times in the order they were put in."""
        due = []
        while self._heap and self._heap[0][0] <= now + TICK:
            due.append(heapq.heappop(self._heap)[2])
        return due

    def __len__(self) -> int:
        return len(self._heap)


class Message(NamedTuple):
    """What arrived at a drone."""

    sender: int
    sent: float  # s
    received: float  # s, when it was due; the receiver may look later
    content: Any


class Bus:
    """Messages between N drones: every link (sender, receiver) has a constant delay and loses a share of them.

    Losses are drawn from ``generator``, one number per link and message whatever the share is: raising the loss only
    ever takes messages away. Where the episode has ``links`` of its own, these hold instead.
    """

    def __init__(
        self,
        drones: int,
        delay: float | Array,
        loss: float | Array,
        generator: np.random.Generator,
        links: Links | None = None,
    ) -> None:
        self.delay = np.broadcast_to(np.asarray(delay, dtype=float), (drones, drones))  # s, [sender, receiver]
        self.loss = np.broadcast_to(np.asarray(loss, dtype=float), (drones, drones))  # share, [sender, receiver]
        if not (self.delay >= 0).all():
            raise ValueError(f"a link delay of {self.delay.min():g} s would deliver before sending: use 0 or more")
        if not ((self.loss >= 0) & (self.loss <= 1)).all():
            raise ValueError("the loss of a link is a share of its messages: use 0 to 1")
        self._generator, self._links = generator, links
        self._boxes: list[Due[Message]] = [Due() for _ in range(drones)]

    def send(self, now: float, sender: int, content: Any) -> None:
        """Send ``content`` to every other drone; it is handed over as it is, so it must not be changed afterwards."""
        delays = self._delays(now, sender)
        for receiver, box in enumerate(self._boxes):
            if receiver != sender and np.isfinite(delays[receiver]):
                due = now + float(delays[receiver])
                box.put(due, Message(sender, now, due, content))

    def _delays(self, now: float, sender: int) -> Array:
        """Delays (N,) in s of a message sent to each drone; inf where it is lost."""
        if self._links is not None:
            number = int((now + TICK) / self._links.period)
            return self._links.delays[sender, :, number % self._links.delays.shape[-1]]
        lost = self._generator.random(len(self._boxes)) < self.loss[sender]
        return np.where(lost, np.inf, self.delay[sender])

    def receive(self, now: float, receiver: int) -> list[Message]:
        """What has arrived at ``receiver`` since it last looked, in the order of arrival."""
        return self._boxes[receiver].take(now)
