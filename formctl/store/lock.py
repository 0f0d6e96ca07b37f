"""Locks on files, which the operating system drops when their process goes away, however it goes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from filelock import FileLock, Timeout

from formctl.store.files import disk_errors

NETWORKED = ("nfs", "cifs", "smb", "9p", "fuse.", "lustre", "beegfs", "gpfs", "ceph", "afs", "glusterfs", "virtiofs")
"""Beginnings of the names of file systems on which a lock of another host may not show."""


class Held(Exception):
    """Another process holds the lock."""


@contextmanager
def hold(path: Path, patience: float = 0.5) -> Iterator[None]:
    """Hold the lock at ``path`` while the block lasts. Raises Held when another process does.

    A reader that is just looking lets go within microseconds; ``patience`` (s) outlasts it.
    """
    lock = FileLock(path, timeout=patience, poll_interval=0.02)
    try:
        with disk_errors(path):
            lock.acquire()
    except Timeout as error:
        raise Held(str(path)) from error
    try:
        yield
    finally:
        lock.release()


def is_held(path: Path) -> bool:
    """Whether some process holds the lock at ``path``: on this host, whatever it is called in its container."""
    if not path.exists():
        return False
    lock = FileLock(path, blocking=False)
    try:
        lock.acquire()
    except Timeout:
        return True
    except OSError:  # a store that nobody can write to is nobody's work
        return False
    lock.release()
    return False


def shows(path: Path) -> bool:
    """Whether a lock at ``path`` shows to everybody who can see the file: on every file system but some networked."""
    path, best, kind = path.resolve(), "", ""
    for place, name in _mounts():
        if path.is_relative_to(place) and len(place) >= len(best):
            best, kind = place, name
    return not kind.startswith(NETWORKED)


@cache
def machine() -> str:
    """What tells this running system from any other, whatever its host name is; empty where nobody knows."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _mounts() -> Iterator[tuple[str, str]]:
    """Mount points and the kinds of their file systems."""
    try:
        lines = Path("/proc/self/mounts").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        _, place, kind, *_ = line.split(" ")
        yield os.fsdecode(place.encode().decode("unicode_escape").encode("latin-1")), kind
