"""What a command is about to spend, said before it is spent: disk, and minutes where this machine has shown them."""

import shutil
import socket
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from formctl import store
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.settings import Config

CHECKPOINT = 8_000_000
"""Bytes of one checkpoint at most: the attention encoder's is 1 to 6 MB with its optimisers."""

TRAINED_WITH = ("encoder", "algo", "drone", "observation")
"""Groups that decide how long a step of training takes."""


def room(needed: float, root: Path) -> str:
    """``12 MB of the 80 GB free in runs``. Raises StoreError when the disk is too small for it."""
    free = shutil.disk_usage(existing(root)).free
    if needed > free:
        raise StoreError(
            f"{root} has {readable(free)} left, {readable(needed)} are needed: make room or type runs=FOLDER"
        )
    return f"{readable(needed)} of the {readable(free)} free in {root}"


def training_minutes(config: "Config", steps: int) -> float | None:
    """Minutes that ``steps`` take, from this machine's finished trainings with the same learner; None without any."""
    rates = []
    for run in store.scan(config.runs, kind="train", status="done")[:20]:
        record = run.record
        same_host = record.get("process", {}).get("host") == socket.gethostname()
        if same_host and record["minutes"] > 0.1 and record["result"].get("steps"):
            settings = run.config
            compiled = settings["train"]["compile"] == config.train.compile
            if compiled and all(settings.get(group) == config.tree[group] for group in TRAINED_WITH):
                rates.append(record["result"]["steps"] / record["minutes"])
    return steps / median(rates) if rates else None


def existing(path: Path) -> Path:
    """The nearest folder above ``path`` that is there already."""
    path = path.absolute()
    while not path.exists():
        path = path.parent
    return path


def readable(amount: float) -> str:
    """Bytes in the largest unit that leaves a number of at least one."""
    for unit in ("B", "kB", "MB", "GB"):
        if amount < 1000:
            return f"{amount:.0f} {unit}"
        amount /= 1000
    return f"{amount:.1f} TB"
