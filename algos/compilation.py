"""torch.compile for pieces of the program, falling back to plain PyTorch with one notice where that is impossible.

What is compiled stays on disk in the user's cache directory, so that a machine compiles once and every later training,
trial and evaluation of the same shapes loads it: minutes become seconds.
"""

import hashlib
import logging
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

import torch
from filelock import FileLock

from envs import native

P = ParamSpec("P")
R = TypeVar("R")

Listen = Callable[[str, int, int], None]
"""Called with the name of the piece that is compiled or loaded next, how many are ready, and how many there are."""

COMPILERS = ("g++", "c++", "clang", "icpx")
"""What is in the name of a C++ compiler."""

log = logging.getLogger(__name__)


class Compiler:
    """Compiles functions of fixed shapes; `enabled` turns false for good when the machine cannot compile.

    `busy` is true while a function is compiled or loaded, which nobody should have to wait for: an exception raised
    then (KeyboardInterrupt by a signal handler) ends the compilers that were started.
    """

    def __init__(self, enabled: bool, listen: Listen = lambda name, ready, pieces: None) -> None:
        self.enabled, self.listen = enabled, listen
        self.busy, self.ready, self.pieces = False, 0, 0
        if enabled:
            use_cache()
            if reason := _missing_compiler():
                self._give_up(reason)

    def __call__(self, function: Callable[P, R]) -> Callable[P, R]:
        """The compiled function; it compiles at its first call and behaves like the original when that fails."""
        if not self.enabled:
            return function
        from torch._dynamo.exc import TorchDynamoException
        from torch._inductor.exc import CppCompileError

        # What is compiled for one world or policy does not count against the limit of shapes of the next.
        compiled = torch.compile(function, dynamic=False, fullgraph=True, isolate_recompiles=True)
        self.pieces += 1
        called = False

        @wraps(function)
        def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
            nonlocal called
            if self.enabled:
                try:
                    if called:
                        return compiled(*args, **kwargs)
                    called = True
                    with self._first_call(function):
                        return compiled(*args, **kwargs)
                except (TorchDynamoException, CppCompileError) as error:
                    self._give_up(str(error))
            return function(*args, **kwargs)

        return guarded

    @contextmanager
    def _first_call(self, function: Callable[..., object]) -> Iterator[None]:
        """Compile the function's gradient at once too, so that all waiting falls into this block."""
        from torch._functorch import config

        self.listen(piece_name(function), self.ready, self.pieces)
        self.busy = True
        try:
            with one_at_a_time(piece_name(function)), config.patch(force_non_lazy_backward_lowering=True):
                yield
        except BaseException:
            end_compilers()
            raise
        finally:
            self.busy = False
        self.ready += 1

    def _give_up(self, reason: str) -> None:
        self.enabled = False
        log.warning("not compiled, which is several times slower: %s", reason.strip().splitlines()[0][:200])
        log.debug("%s", reason)


def piece_name(function: Callable[..., object]) -> str:
    """How a compiled function is called in messages: `FormationEnv.observe`."""
    name: str = getattr(function, "__qualname__", type(function).__name__)
    return name.rpartition("<locals>.")[2].replace("._", ".")


def one_at_a_time(name: str) -> AbstractContextManager[object]:
    """Of several processes that begin together, one compiles a piece; the others wait and load it."""
    folder = os.environ.get("TORCHINDUCTOR_CACHE_DIR")
    return FileLock(Path(folder) / f"{name}.lock") if folder and Path(folder).is_dir() else nullcontext()


def use_cache() -> None:
    """Keep what is compiled in the user's cache directory, unless TORCHINDUCTOR_CACHE_DIR says where.

    Worker processes inherit the choice. Where the directory cannot be written, torch's own choice stays: a folder for
    temporary files.
    """
    if "TORCHINDUCTOR_CACHE_DIR" in os.environ:
        return
    with suppress(OSError):  # a full or read-only disk
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(folder)


def cache_folder() -> Path:
    """Where compiled code is kept; apart for every version of torch and every kind of processor.

    Home directories are shared by machines, and code made for one processor's instructions ends programs on another.
    """
    if given := os.environ.get("TORCHINDUCTOR_CACHE_DIR"):
        return Path(given)
    processor = hashlib.sha256(native.processor().encode()).hexdigest()[:8]
    return native.cache_dir() / f"torch-{torch.__version__}-{processor}"


def end_compilers() -> None:
    """End the C++ compilers that this process has started; where there is no /proc they end by themselves."""
    with suppress(OSError):
        for child in _children(os.getpid()):
            if any(name in os.readlink(f"/proc/{child}/exe") for name in COMPILERS):
                for process in (*_children(child), child):  # the driver waits for what it has started
                    os.kill(process, signal.SIGKILL)


def _children(process: int) -> list[int]:
    files = Path(f"/proc/{process}/task").glob("*/children")
    return [int(word) for file in files for word in file.read_text().split()]


def _missing_compiler() -> str | None:
    """Why nothing can be compiled for the CPU here, or None."""
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.exc import InvalidCxxCompiler

    try:
        get_cpp_compiler()
    except (InvalidCxxCompiler, OSError):
        return "no C++ compiler found (apt install g++, or set CXX)"
    return None
