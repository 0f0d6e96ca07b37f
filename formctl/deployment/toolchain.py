"""C compilers: the one of this machine, and one for the Cortex-M4 that comes as a Python package."""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from formctl.errors import RunFailed

WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror")
CORTEX_M4 = ("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4+vfp4d16sp")
"""Without ``vfp4d16sp`` the compiler calls software for every operation on floats."""

INSTALL = "pip install 'formctl[onboard]'"
BOARD = Path(__file__).parent / "board"


def host_compiler() -> list[str]:
    """The command of a C compiler: ``CC``, one on the path, or the package ziglang. Raises ValueError for none."""
    if named := shlex.split(os.environ.get("CC", "")):
        return named
    found = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
    if found:
        return [found]
    if find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    raise ValueError(f"there is no C compiler here: install gcc or clang, set CC to one, or {INSTALL}")


def cross_compiler() -> list[str]:
    """The command of a C compiler for the Cortex-M4. Raises ValueError where the extra ``onboard`` is missing."""
    require("ziglang")
    return [sys.executable, "-m", "ziglang", "cc", *CORTEX_M4]


def require(*packages: str) -> None:
    """Raise ValueError unless these packages of the extra ``onboard`` are installed."""
    missing = [name for name in packages if not find_spec(name)]
    if missing:
        raise ValueError(f"the Cortex-M4 needs {', '.join(missing)}: {INSTALL}")


def shared_library(sources: Path, library: Path) -> Path:
    """Compile an export's policy for this machine. Raises RunFailed with what the compiler says."""
    options = ["-std=c99", "-O2", "-fno-math-errno", *WARNINGS, "-fPIC", "-shared"]
    names = [sources / name for name in ("policy.c", "policy_test.c", "policy_batch.c")]
    compile_c(host_compiler(), [*options, f"-I{sources}"], names, library)
    return library


def firmware(sources: Path, image: Path) -> Path:
    """Compile an export's policy for a bare Cortex-M4, with the firmware's optimisation (-Os), as an ELF file."""
    options = ["-std=c99", "-Os", "-fno-math-errno", "-ffp-contract=fast", *WARNINGS, "-ffreestanding"]
    options += ["-fno-builtin", "-nostdlib", "-g", f"-I{BOARD}", f"-I{sources}", f"-Wl,-T,{BOARD / 'link.ld'}"]
    options += ["-Wl,-e,board_compute", "-Wl,--no-gc-sections"]
    names = [sources / name for name in ("policy.c", "policy_test.c", "policy_batch.c")]
    compile_c(cross_compiler(), options, [BOARD / "board.c", BOARD / "memory.c", *names], image)
    return image


def compile_c(compiler: Sequence[str], options: Sequence[str], sources: Sequence[Path], target: Path) -> None:
    """Compile and link ``sources``. Raises RunFailed with the compiler's first error."""
    libraries = [] if "-nostdlib" in options else ["-lm"]
    command = [*compiler, *options, *map(str, sources), "-o", str(target), *libraries]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines() or ["?"]
        raise RunFailed(f"{sources[0].parent} does not compile: {errors[0].strip()}")
