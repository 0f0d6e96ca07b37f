"""Who may stop a run, and who listens to it: neither a closed terminal nor a closed pipe decides what is done."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, TextIO

ASKING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask for a clean stop: Ctrl-C, a batch system before its limit, a terminal that is closed."""

Handler = Callable[[int, FrameType | None], Any]


@contextmanager
def handled(handler: Handler, signals: tuple[signal.Signals, ...] = ASKING) -> Iterator[None]:
    """Call ``handler`` when one of ``signals`` asks for a stop while the block lasts.

    What is ignored stays ignored (``nohup``); outside the main thread, where no signal arrives, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heeded = [number for number in signals if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in heeded}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def interrupt(number: int, frame: FrameType | None) -> None:
    """What Ctrl-C does anyway, for the other signals too."""
    raise KeyboardInterrupt("" if number == signal.SIGINT else "asked to stop")


class Audience:
    """A text stream that may lose its reader: what is written after that goes nowhere, and is no error."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write ``text`` while somebody reads it."""
        try:
            return self._stream.write(text)
        except OSError:  # a pipe without a reader, a terminal that is gone
            self._mute()
            return len(text)

    def flush(self) -> None:
        """Let the reader see what was written."""
        try:
            self._stream.flush()
        except OSError:
            self._mute()

    def _mute(self) -> None:
        """Point the descriptor to nowhere, so that what is still buffered is no error either, now or at the end."""
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def outlive_audience() -> None:
    """Make this process's output an ``Audience``."""
    sys.stdout, sys.stderr = (
        stream if stream is None or isinstance(stream, Audience) else Audience(stream)
        for stream in (sys.stdout, sys.stderr)
    )
