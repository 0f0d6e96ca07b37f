"""An exported policy compiled for this machine, called through ctypes with NumPy records."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from algos.export import layout
from algos.export.layout import Bounds
from formctl.errors import RunFailed


class CompiledPolicy:
    """The shared library of an export."""

    def __init__(self, path: Path, bounds: Bounds) -> None:
        """``path`` as ``toolchain.shared_library`` makes it. Raises RunFailed for another layout of its inputs."""
        self.dtype = layout.inputs_dtype(bounds)
        self._library = ctypes.CDLL(str(path))
        self._library.policy_self_test.restype = ctypes.c_uint32
        size = int(self._library.policy_inputs_bytes())
        if size != self.dtype.itemsize:
            raise RunFailed(f"{path}: its inputs take {size} bytes, not {self.dtype.itemsize}: export the policy again")

    def compute(self, inputs: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.uint32]]:
        """Set-points (K,) of ``layout.SETPOINT`` and problems (K,) for packed inputs (K,)."""
        if inputs.dtype != self.dtype:
            raise ValueError("these inputs were packed for other bounds than the library's")
        inputs = np.ascontiguousarray(inputs)
        setpoints = np.zeros(len(inputs), layout.SETPOINT)
        problems = np.zeros(len(inputs), np.uint32)
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (inputs, setpoints, problems))
        self._library.policy_compute_batch(*pointers, ctypes.c_uint32(len(inputs)))
        return setpoints, problems

    def self_test(self) -> tuple[int, float]:
        """What ``policy_self_test`` returns, and the largest difference of a golden command."""
        largest = ctypes.c_float()
        found = self._library.policy_self_test(ctypes.byref(largest))
        return int(found), float(largest.value)
