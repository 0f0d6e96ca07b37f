"""torch.compile for pieces of the program, falling back to plain PyTorch with one notice where that is impossible."""

import logging
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import torch

P = ParamSpec("P")
R = TypeVar("R")

log = logging.getLogger(__name__)


class Compiler:
    """Compiles functions of fixed shapes; `enabled` turns false for good when the machine cannot compile."""

    def __init__(self, enabled: bool) -> None:
        self.enabled = enabled
        if enabled and (reason := _missing_compiler()):
            self._give_up(reason)

    def __call__(self, function: Callable[P, R]) -> Callable[P, R]:
        """The compiled function; it compiles at its first call and behaves like the original when that fails."""
        if not self.enabled:
            return function
        from torch._dynamo.exc import TorchDynamoException
        from torch._inductor.exc import InductorError

        # What is compiled for one world or policy does not count against the limit of shapes of the next.
        compiled = torch.compile(function, dynamic=False, fullgraph=True, isolate_recompiles=True)

        @wraps(function)
        def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
            if self.enabled:
                try:
                    return compiled(*args, **kwargs)
                except (TorchDynamoException, InductorError) as error:
                    self._give_up(str(error).strip().splitlines()[0])
            return function(*args, **kwargs)

        return guarded

    def _give_up(self, reason: str) -> None:
        self.enabled = False
        log.warning("not compiled, which is several times slower: %s", reason)


def _missing_compiler() -> str | None:
    """Why nothing can be compiled for the CPU here, or None."""
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.exc import InvalidCxxCompiler

    try:
        get_cpp_compiler()
    except (InvalidCxxCompiler, OSError):
        return "no C++ compiler found (apt install g++, or set CXX)"
    return None
