"""For what is repeated and grows dearer as it goes: at most a twentieth of the time is spent on it."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

SHARE = 20
"""Time between two turns, in units of what the last one took."""


class Patience:
    """Knows when the next turn is due; ``pause`` s lie between two turns at least."""

    def __init__(self, pause: float = 0.0) -> None:
        self._last, self._cost, self._pause = -math.inf, 0.0, pause

    def due(self) -> bool:
        """Whether enough time has passed since the last turn."""
        return time.monotonic() - self._last >= max(self._pause, SHARE * self._cost)

    @contextmanager
    def spend(self) -> Iterator[None]:
        """Take a turn."""
        begun = time.monotonic()
        yield
        self._last = time.monotonic()
        self._cost = self._last - begun
