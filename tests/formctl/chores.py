"""Work for worker processes: importable there, and cheap."""

import os
import signal


def double(number: int) -> int:
    """Twice the number."""
    return 2 * number


def surroundings(number: int) -> tuple[int, str | None]:
    """The process, and the threads it was given."""
    return os.getpid(), os.environ.get("OPENBLAS_NUM_THREADS")


def stumble(number: int) -> int:
    """Fails at 2."""
    if number == 2:
        raise ValueError("two cannot be done")
    return number


def vanish(number: int) -> int:
    """Is killed at 2."""
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number
