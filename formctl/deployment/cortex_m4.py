"""An exported policy on an emulated Cortex-M4: what its own machine code computes, and what that takes.

The emulator (unicorn) counts instructions; it knows nothing of the cycles that silicon takes for them.
"""

from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from elftools.elf.elffile import ELFFile
from numpy.typing import NDArray
from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_MODE_MCLASS, UC_MODE_THUMB, Uc, UcError
from unicorn.arm_const import UC_ARM_REG_FPEXC, UC_ARM_REG_SP, UC_CPU_ARM_CORTEX_M4

from algos.export import layout
from algos.export.layout import Bounds
from formctl.errors import RunFailed

FLASH, RAM, STACK, SYSTEM = 0x08000000, 0x20000000, 0x30000000, 0xE000E000
MEMORY = 1 << 20  # bytes of flash and of RAM that are mapped
STACK_BYTES = 1 << 16
COPROCESSORS = 0xE000ED88  # CPACR: full access to the floating-point unit
PAINT = 0xA5
SELF_TEST = ("policy_golden", "policy_self_test", "policy_weights_crc32")
BOARD = ("board", "mem", "__aeabi", "policy_compute_batch", "policy_inputs_bytes")
"""Names of what is linked beside the policy, by their beginnings."""


@dataclass(frozen=True)
class Footprint:
    """What a policy takes of a Cortex-M4."""

    flash: int  # bytes of code and weights
    self_test: int  # bytes of the golden vectors and their code, which may be left out
    stack: int  # bytes, the deepest that was used
    instructions: int  # of one inference


class CortexM4:
    """An emulated chip with an export's policy in its flash."""

    def __init__(self, image: Path, bounds: Bounds) -> None:
        """``image`` as ``toolchain.firmware`` makes it. Raises RunFailed for another layout of its inputs."""
        with image.open("rb") as file:
            elf = ELFFile(file)
            self._segments = [(s["p_paddr"], s.data()) for s in elf.iter_segments("PT_LOAD")]
            table: Any = elf.get_section_by_name(".symtab")
            self._symbols = {s.name: (s["st_value"], s["st_size"]) for s in table.iter_symbols() if s.name}
        self.dtype = layout.inputs_dtype(bounds)
        _, room = self._symbols["board_inputs"]
        _, drones = self._symbols["board_problems"]
        self.capacity = drones // 4
        if room != self.capacity * self.dtype.itemsize:
            raise RunFailed(f"{image} was compiled for other bounds than {bounds}")
        self._chip = self._started()

    def _started(self) -> Uc:
        chip = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        chip.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M4)
        for start, size in ((FLASH, MEMORY), (RAM, MEMORY), (STACK, STACK_BYTES), (SYSTEM, 0x1000)):
            chip.mem_map(start, size)
        for address, data in self._segments:
            chip.mem_write(address, data)
        chip.mem_write(COPROCESSORS, (0xF << 20).to_bytes(4, "little"))
        chip.reg_write(UC_ARM_REG_FPEXC, 1 << 30)
        return chip

    def compute(self, inputs: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.uint32]]:
        """Set-points (K,) of ``layout.SETPOINT`` and problems (K,) for packed inputs (K,)."""
        setpoints, problems = [], []
        for first in range(0, len(inputs), self.capacity):
            part = inputs[first : first + self.capacity]
            self._write("board_inputs", part.tobytes())
            self._write("board_count", len(part).to_bytes(4, "little"))
            self._run("board_compute")
            setpoints.append(self._read("board_setpoints", layout.SETPOINT, len(part)))
            problems.append(self._read("board_problems", np.dtype("<u4"), len(part)))
        return np.concatenate(setpoints), np.concatenate(problems)

    def self_test(self) -> tuple[int, float]:
        """What ``policy_self_test`` returns there, and the largest difference of a golden command."""
        self._run("board_test")
        found = self._read("board_self_test", np.dtype("<u4"), 1)[0]
        return int(found), float(self._read("board_largest_difference", np.dtype("<f4"), 1)[0])

    def footprint(self, inputs: NDArray[Any]) -> Footprint:
        """What an inference takes: its instructions for that one of packed ``inputs`` (K,) with most balls, the deepest
        stack of all."""
        counting = copy(self)  # code that ran without the counter is not counted: another chip
        counting._chip = self._started()
        counted = counting._count(inputs[np.argmax(inputs["balls"])][None])
        self._chip.mem_write(STACK, bytes([PAINT]) * STACK_BYTES)
        self.compute(inputs)
        painted = np.frombuffer(self._chip.mem_read(STACK, STACK_BYTES), np.uint8)
        deepest = STACK_BYTES - int(np.argmax(painted != PAINT))
        test = sum(self._symbols[name][1] for name in SELF_TEST)
        policy = [at for name, at in self._symbols.items() if not name.startswith((*BOARD, *SELF_TEST))]
        flash = sum(size for address, size in dict(policy).items() if FLASH <= address < FLASH + MEMORY)
        return Footprint(flash, test, deepest, counted)

    def _count(self, one: NDArray[Any]) -> int:
        executed = 0

        def step(chip: Uc, address: int, size: int, data: object) -> None:
            nonlocal executed
            executed += 1

        hook = self._chip.hook_add(UC_HOOK_CODE, step)
        self.compute(one)
        self._chip.hook_del(hook)
        return executed

    def _run(self, entry: str) -> None:
        self._chip.reg_write(UC_ARM_REG_SP, STACK + STACK_BYTES)
        address, size = self._symbols[entry]
        end = (address & ~1) + size - 2
        try:
            self._chip.emu_start(address | 1, end)
        except UcError as error:
            if "exception" not in str(error).lower():
                raise RunFailed(f"the emulated Cortex-M4 stopped in {entry}: {error}") from error

    def _write(self, name: str, data: bytes) -> None:
        self._chip.mem_write(self._symbols[name][0], data)

    def _read(self, name: str, dtype: "np.dtype[Any]", count: int) -> NDArray[Any]:
        return np.frombuffer(bytes(self._chip.mem_read(self._symbols[name][0], count * dtype.itemsize)), dtype)
