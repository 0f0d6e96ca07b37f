"""Runs as they can be typed where a message is read."""

import shlex
from pathlib import Path

from formctl.store import Run

DEFAULT_STORE = "runs"
"""``runs`` of ``conf/config.yaml``: where commands look when they are not told."""


def typed(run: Run) -> str:
    """The run's id where it lies in the default store of this folder, otherwise its path; quoted for a shell."""
    root = run.path.parents[2] if len(run.path.parents) > 2 else run.path
    default = root.resolve() == Path(DEFAULT_STORE).resolve()
    return shlex.quote(run.path.name if default else str(run.path))


def file(path: Path) -> str:
    """A path, quoted for a shell."""
    return shlex.quote(str(path))
