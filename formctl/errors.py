"""Errors that a user can cause or meet, and how they are said: one line on stderr."""

import sys


class ConfigError(ValueError):
    """A configuration that cannot be used: exit code 2."""


class RunFailed(RuntimeError):
    """A run that could not finish: exit code 1; the message names the log."""


class Withdrawn(Exception):
    """Work that is no longer wanted: pruned, or handed to somebody else. It is stopped, and may be taken up again."""


def fail(message: str, code: int = 1) -> int:
    """Print one line on stderr and pass the exit code through."""
    print(f"formctl: {' '.join(message.split())}", file=sys.stderr)
    return code
