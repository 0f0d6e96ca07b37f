"""Is this machine ready, and is this installation whole? One finding a line, each with what to do about it."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

from packaging.requirements import Requirement

from formctl import __version__, guard

GIGABYTE = 1e9
GL_PROBE = "import mujoco; context = mujoco.GLContext(64, 64); context.make_current(); context.free()"
GL_BACKENDS = {"egl": "libegl1 libegl-mesa0 libgl1-mesa-dri", "osmesa": "libosmesa6"}
"""What MuJoCo can draw with off screen, and the Debian packages that bring it."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    subject: str
    state: Literal["ok", "note", "broken"]  # broken: formctl cannot work; note: something optional is missing
    detail: str


def examine(runs: Path) -> Iterator[Finding]:
    """Look at everything that a run needs, the quick things first; ``runs`` is the output store."""
    yield Finding("formctl", "ok", f"{__version__} in {Path(__file__).resolve().parent}")
    yield Finding("python", "ok", f"{sys.version.split()[0]} in {sys.prefix}")
    yield from _names()
    yield from _distributions()
    yield _compiler()
    yield _store(runs)
    yield _space(runs)
    yield _torch()
    yield _drawing()


def _names() -> Iterator[Finding]:
    try:
        guard.check()
        clashes = guard.intruders()
    except guard.NameClash as error:
        yield Finding("package names", "broken", str(error))
        return
    for package, culprits in clashes.items():
        names = " ".join(culprits)
        detail = f"{names} installs into our package {package!r}: pip uninstall {names}"
        yield Finding("package names", "broken", detail)
    if not clashes:
        yield Finding("package names", "ok", "no other distribution brings " + ", ".join(guard.PACKAGES))


def _distributions() -> Iterator[Finding]:
    """Every required distribution, against the range that formctl declares."""
    try:
        declared = [Requirement(line) for line in requires("formctl") or []]
    except PackageNotFoundError:
        yield Finding("installation", "note", "not installed, runs from its folder: versions are not checked")
        return
    wrong = []
    needed = [requirement for requirement in declared if requirement.marker is None or requirement.marker.evaluate()]
    for requirement in needed:
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            wrong.append(f"{requirement} is missing")
            continue
        if not requirement.specifier.contains(found, prereleases=True):
            wrong.append(f"{requirement.name} {found} is not {requirement.specifier}")
    if wrong:
        yield Finding("dependencies", "broken", f"{'; '.join(wrong)}: install formctl again")
    else:
        yield Finding("dependencies", "ok", f"{len(needed)} distributions, all in the tested ranges")


def _compiler() -> Finding:
    name = os.environ.get("CXX", "g++")
    path = shutil.which(name) or shutil.which("clang++")
    if path is None:
        return Finding(
            "compiler", "note", f"no {name}: install one (Debian: g++) or set train.compile=false, much slower"
        )
    return Finding("compiler", "ok", f"{path}, for torch.compile; {compiled_code()}")


def compiled_code() -> str:
    """What the cache of compiled code holds."""
    from algos.compilation import cache_folder, use_cache

    use_cache()
    folder = cache_folder()
    files = [path for path in folder.rglob("*") if path.is_file()]
    if not files:
        return f"nothing compiled yet in {folder} (formctl doctor --warm does it ahead)"
    return f"{sum(path.stat().st_size for path in files) / 1e6:.0f} MB compiled in {folder}"


def _store(runs: Path) -> Finding:
    """Whether runs can be written, found out by writing where the store is or would be made."""
    folder = _existing(runs)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        detail = f"{runs.resolve()} cannot be written ({error}): choose another with runs="
        return Finding("output store", "broken", detail)
    return Finding("output store", "ok", f"{runs.resolve()}{'' if runs.exists() else ', made by the first run'}")


def _space(runs: Path) -> Finding:
    free = shutil.disk_usage(_existing(runs)).free / GIGABYTE
    if free < 2:
        return Finding("disk", "note", f"{free:.1f} GB free: a laptop run with videos may need 2 GB")
    return Finding("disk", "ok", f"{free:.0f} GB free")


def _existing(path: Path) -> Path:
    path = path.resolve()
    while not path.is_dir():
        path = path.parent
    return path


def _torch() -> Finding:
    import torch

    build = f"CUDA {torch.version.cuda}" if torch.version.cuda else "CPU build"
    device = torch.cuda.get_device_name() if torch.cuda.is_available() else f"{_cores()} cores"
    return Finding("torch", "ok", f"{torch.__version__}, {build}, {device}, {torch.get_num_threads()} threads")


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _drawing() -> Finding:
    """Tried in processes of its own: GL is chosen before MuJoCo is imported, and may take the process down."""
    chosen = os.environ.get("MUJOCO_GL")
    for backend in [chosen] if chosen else list(GL_BACKENDS):
        environment = os.environ | {"MUJOCO_GL": backend}
        probe = subprocess.run([sys.executable, "-c", GL_PROBE], env=environment, capture_output=True, check=False)
        if probe.returncode == 0:
            return Finding("drawing", "ok", f"MuJoCo draws with {backend}")
    install = " or ".join(f"{packages} (MUJOCO_GL={backend})" for backend, packages in GL_BACKENDS.items())
    return Finding("drawing", "note", f"no pictures or videos from MuJoCo: install {install}")
