"""C++ of this project, built once per machine by the system's compiler and kept in the user's cache directory."""

import ctypes
import hashlib
import logging
import os
import platform
import shutil
import subprocess
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

log = logging.getLogger(__name__)

HEADERS = Path(__file__).parent / "cpp"
"""What the project's C++ sources share."""

FLAGS = ("-std=c++17", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")
"""Not -ffast-math: numbers that stop being finite have to be seen."""


def library(source: Path, **constants: int) -> ctypes.CDLL | None:
    """The functions of a C++ source, its macros set to ``constants``; None, said once, where nothing can be built.

    A library is built anew when its sources, the flags, the compiler or the processor change. Takes some seconds the
    first time. ``FORMCTL_NATIVE=0`` in the environment goes without.
    """
    return _library(source, tuple(sorted(constants.items())))


def generated(text: str, name: str) -> ctypes.CDLL | None:
    """The functions of C++ that a program has written; otherwise as `library`."""
    path = cache_dir() / "native" / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:20]}.cpp"
    try:
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
                file.write(text)
            Path(file.name).replace(path)
    except OSError as error:
        log.warning("%s is not built, plain PyTorch does its work several times slower: %s", name, error)
        return None
    return _library(path, ())


def cache_dir() -> Path:
    """This program's folder in the user's cache directory, in that for temporary files where there is no home."""
    with suppress(RuntimeError):
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "formctl"
    return Path(tempfile.gettempdir()) / f"formctl-{os.getuid()}"


def processor() -> str:
    """What tells processors with other instructions apart: a cache directory may be shared by several machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    return "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))}))


@cache
def _library(source: Path, constants: tuple[tuple[str, int], ...]) -> ctypes.CDLL | None:
    if os.environ.get("FORMCTL_NATIVE") == "0":
        return None
    try:
        return ctypes.CDLL(str(_built(source, [f"-D{name}={value}" for name, value in constants])))
    except (OSError, subprocess.CalledProcessError) as error:
        said = error.stderr.strip().splitlines() if isinstance(error, subprocess.CalledProcessError) else []
        log.warning(
            "%s is not built, plain PyTorch does its work several times slower: %s", source.name, (said or [error])[0]
        )
        return None


def _built(source: Path, defines: list[str]) -> Path:
    """The library's file, built if it is not there. Raises OSError or CalledProcessError."""
    compiler = _compiler()
    folders = dict.fromkeys((source.parent, HEADERS))
    parts = [path.read_bytes() for path in (source, *(p for folder in folders for p in sorted(folder.glob("*.h"))))]
    flags = (*FLAGS, *defines)
    key = hashlib.sha256(b"\0".join([*parts, repr((flags, _version(compiler), processor())).encode()])).hexdigest()
    path = cache_dir() / "native" / f"{source.stem}-{key[:20]}.so"
    if not path.exists():
        log.info("building %s for this processor (once, some seconds)", source.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            fresh = Path(folder) / path.name
            command = [compiler, *flags, f"-I{HEADERS}", "-fPIC", "-shared", str(source), "-o", str(fresh)]
            subprocess.run(command, check=True, capture_output=True, text=True)
            fresh.replace(path)  # whoever builds at the same time makes the same file
    return path


def _compiler() -> str:
    """The C++ compiler. Raises OSError where there is none."""
    for name in (os.environ.get("CXX"), "g++", "clang++", "c++"):
        if name and (path := shutil.which(name)):
            return path
    raise OSError("no C++ compiler found (apt install g++, or set CXX)")


@cache
def _version(compiler: str) -> str:
    return subprocess.run([compiler, "--version"], check=True, capture_output=True, text=True).stdout
