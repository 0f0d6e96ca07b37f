"""A recurring job that may take one twentieth of the time at most: tables that grow with the study."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

SHARE = 20
"""Time between two turns, in units of what the last one took."""


class Throttle:
    """Knows when the job is due again."""

    def __init__(self) -> None:
        self._last, self._cost = -math.inf, 0.0

    def due(self) -> bool:
        """Whether enough time has passed since the last turn."""
        return time.monotonic() - self._last >= SHARE * self._cost

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Take a turn."""
        begun = time.monotonic()
        yield
        self._last = time.monotonic()
        self._cost = self._last - begun
