"""Where a result comes from: code, call, versions and machine. No environment variables, no secrets."""

import hashlib
import os
import platform
import re
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from formctl.guard import PACKAGES as PACKAGED
from formctl.store.files import write_text

if TYPE_CHECKING:
    from formctl.store import Run

PACKAGES = (
    "formctl",
    "torch",
    "tensordict",
    "torchrl",
    "mujoco",
    "numpy",
    "scipy",
    "pandas",
    "pyarrow",
    "matplotlib",
    "optuna",
    "hydra-core",
    "pydantic",
)
SOURCES = ("formctl", "envs", "algos", "baselines", "analysis", "conf", "pyproject.toml")  # what a diff may show
MAX_DIFF = 2_000_000  # bytes; a larger diff is somebody's data, not a change to the program

_SECRET_KEY = re.compile(r"(?i)\b([\w.-]*(?:password|passwd|secret|token|api_?key|credential)[\w.-]*\s*[=:]\s*)(\S+)")
_SECRET_URL = re.compile(r"(\w+://[^\s:/@]+):[^\s@]+@")


class RunSettings(Protocol):
    """What a run is made from, as far as its record says so: ``formctl.settings.Config``."""

    @property
    def runs(self) -> Path: ...
    @property
    def name(self) -> str: ...
    @property
    def profile(self) -> str: ...
    @property
    def seed(self) -> int: ...
    @property
    def tree(self) -> dict[str, Any]: ...


def new_run(
    config: RunSettings,
    kind: str,
    name: str | None = None,
    *,
    tree: Mapping[str, Any] | None = None,
    call: Sequence[str] | None = None,
    **fields: Any,
) -> "Run":
    """A run folder for what ``config`` describes, with everything that says where its result comes from.

    ``tree`` is what ``config.yaml`` holds and ``call`` the command, where they are not the obvious ones; ``fields`` are
    those of ``store.create``. Raises StoreError.
    """
    from formctl import store

    run = store.create(
        config.runs,
        kind,
        name or config.name,
        config=tree or config.tree,
        provenance=collect(),
        argv=call or argv(),
        profile=config.profile,
        seed=config.seed,
        **fields,
    )
    save_diff(run.path)
    return run


def collect() -> dict[str, Any]:
    """``git``, ``versions`` and ``host`` as JSON types, for ``run.json``."""
    return {"git": git(), "versions": versions(), "host": host()}


def stamp() -> dict[str, Any]:
    """The short form for files that travel alone: commit, versions and call; no machine."""
    return {"git": git(), "versions": versions(), "argv": argv()}


def git() -> dict[str, Any]:
    """Commit and whether tracked sources differ from it; both None when the program does not run from a checkout."""
    top = checkout()
    if top is None:
        return {"commit": None, "dirty": None}
    commit = _git(top, "rev-parse", "HEAD")
    changes = _git(top, "status", "--porcelain", "--", *SOURCES)
    return {"commit": commit.strip() or None, "dirty": bool(changes.strip())}


def diff() -> str:
    """What the checkout's tracked sources changed since their commit; empty outside a checkout."""
    top = checkout()
    text = "" if top is None else _git(top, "diff", "HEAD", "--no-ext-diff", "--", *SOURCES)
    return redact(text) if len(text) <= MAX_DIFF else ""


def save_diff(folder: Path) -> None:
    """Write ``git.diff`` into a run's folder where the sources differ from their commit."""
    text = diff()
    if text:
        write_text(folder / "git.diff", text)


def sources() -> str:
    """Sixteen hexadecimal digits of the program's own Python files: what an interrupted work may only go on with."""
    top = Path(__file__).resolve().parents[2]
    files = sorted(path for package in ("formctl", *PACKAGED) for path in (top / package).rglob("*.py"))
    digest = hashlib.sha256()
    for path in files:
        digest.update(f"{path.relative_to(top)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def checkout() -> Path | None:
    """The git work tree that holds this very package, if there is one: never the user's own project around it."""
    top = Path(__file__).resolve().parents[2]
    return top if (top / ".git").exists() and (top / "pyproject.toml").exists() and (top / "conf").is_dir() else None


def versions() -> dict[str, str]:
    """Python and the packages that a result can depend on, read without importing them."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def host() -> dict[str, Any]:
    """The machine: name, system, processor, cores this process may use, memory in GiB, threads torch was given."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    threads = sys.modules["torch"].get_num_threads() if "torch" in sys.modules else None
    return {
        "name": socket.gethostname(),
        "system": platform.platform(),
        "processor": processor(),
        "cores": usable,
        "memory_gib": _memory(),
        "torch_threads": threads,
    }


def redact(text: str) -> str:
    """``text`` without passwords: those in addresses (scheme://user:password@host) and values of keys that name one."""
    return _SECRET_KEY.sub(r"\1***", _SECRET_URL.sub(r"\1:***@", text))


def argv(words: Sequence[str] | None = None) -> list[str]:
    """The call as typed, secrets removed; the program by its name, wherever it lies."""
    return ["formctl", *(redact(word) for word in (sys.argv if words is None else words)[1:])]


def _git(top: Path, *arguments: str) -> str:
    """Output of a git command; empty where git is missing or fails, for a record must not stop a run."""
    command = ["git", "-C", str(top), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


def processor() -> str:
    """The processor's name, as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _memory() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (OSError, ValueError):
        return None
