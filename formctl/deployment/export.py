"""Exports of a policy, as ONNX and as C: written, held against PyTorch on recorded flights, described in a contract."""

import platform
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from algos.export import c, layout, onnx, sources
from algos.export.c import Golden
from algos.export.contract import OUTPUTS, Inputs, record, record_midway
from algos.export.layout import Bounds
from algos.export.onnx import Parity
from formctl.deployment import contract, toolchain
from formctl.deployment.contract import TOLERANCE
from formctl.deployment.library import CompiledPolicy
from formctl.errors import RunFailed
from formctl.evaluation import methods
from formctl.settings import build, restore
from formctl.store import provenance

if TYPE_CHECKING:
    from algos.policy import Policy
    from envs.formation import FormationEnv
    from formctl.deployment.cortex_m4 import Footprint
    from formctl.evaluation.methods import Method
    from formctl.settings import Config
    from formctl.store import Run


@dataclass(frozen=True)
class Subject:
    """A policy and the world that it is exported for."""

    method: "Method"
    config: "Config"
    env: "FormationEnv"

    @property
    def policy(self) -> "Policy":
        """The network."""
        return self.method.policy()

    def beside(self, balls: int) -> "FormationEnv":
        """The same world with another number of balls."""
        scenario = self.config.tree["scenario"] | {"balls": balls}
        return build.environment(build.world(restore(self.config.tree | {"scenario": scenario})), "torch")

    def run(self, folder: Path | None) -> "Run":
        """A new run of kind ``export``."""
        method, config = self.method, self.config
        return provenance.new_run(
            config, "export", method.name, parents=method.parents, method=method.facts,
            scenario=config.scenario.name, folder=folder,
        )  # fmt: skip


@dataclass(frozen=True)
class CExport:
    """What an export as C found out about itself."""

    run: "Run"
    proofs: list[Parity]
    flash: int  # bytes of weights and code, at most
    ram: int  # bytes of stack and inputs, at most
    multiply_accumulates: int  # of one inference in the scenario
    footprint: "Footprint | None"  # measured on an emulated Cortex-M4; None without the extra `onboard`


def subject(text: str, config: "Config", words: list[str]) -> Subject:
    """The policy that RUN, FILE or NAME means, in the world of ``config``. Raises ValueError where they do not fit."""
    method = methods.policy(text, config.runs)
    loaded = method.policy()
    methods.check_observation(config, [method], words)
    config = method.settings_of(config)
    env = build.environment(build.world(config), "torch")
    loaded.check(env)
    return Subject(method, config, env)


def to_onnx(given: Subject, folder: Path | None, observations: int) -> tuple["Run", list[Parity]]:
    """Write ``policy.onnx`` and its contract. Raises RunFailed where onnxruntime and PyTorch differ."""
    onnx.require()
    own = given.config.scenario.balls
    counts = [own, own + 3] if "M" in onnx.free_sizes(given.policy) else [given.policy.balls]
    run = given.run(folder)
    with run.work() as live:
        path = live.path / "policy.onnx"
        onnx.write(given.policy, given.env, path)
        proofs = [prove_onnx(given, path, observations, balls) for balls in counts]
        described = contract.describe(given.config, given.method, given.policy, given.env) | {
            "files": contract.hashes(live.path, ["policy.onnx"]),
            "onnx": {"opset": onnx.OPSET, "free_sizes": list(onnx.free_sizes(given.policy))},
            "parity": contract.parity_lines(proofs, "onnxruntime"),
        }
        contract.write(live.path / "contract.json", described)
        live.update(result={"parity": [asdict(proof) for proof in proofs], "files": described["files"]})
    return run, proofs


def prove_onnx(given: Subject, path: Path, observations: int, balls: int) -> Parity:
    """Hold the file against PyTorch on flights among ``balls`` balls. Raises RunFailed where they differ."""
    inputs = record(given.policy, given.beside(balls), observations, given.config.eval.seed)
    return passed(path, onnx.compare(path, given.policy, given.env, inputs))


def to_c(given: Subject, folder: Path | None, observations: int, target: str, bounds: Bounds) -> CExport:
    """Write the C sources, the Crazyflie application and their contract.

    Raises ValueError, before anything is written, for a policy that C does not compute or that does not fit ``target``;
    RunFailed where compiled C and PyTorch differ.
    """
    policy, env, config = given.policy, given.env, given.config
    c.check(policy, env)
    c.fit(policy, bounds, c.TARGETS[target])
    toolchain.host_compiler()
    inputs = record_midway(policy, env, observations, config.eval.seed)
    vectors = c.golden(policy, env, inputs, bounds)
    run = given.run(folder)
    with run.work() as live:
        texts = sources.render(policy, env, bounds, vectors, origin(given, run.id))
        for name, text in texts.items():
            path = live.path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        library = compiled(live.path, bounds)
        proofs = [passed(live.path, compare(library, policy, env, inputs, bounds))]
        if (more := min(config.scenario.balls + 3, bounds.balls)) > config.scenario.balls:
            world = given.beside(more)
            flown = record_midway(policy, world, observations, config.eval.seed)
            proofs.append(passed(live.path, compare(library, policy, world, flown, bounds)))
        footprint = measure(live.path, bounds, vectors)
        flash, ram = c.needs(policy, bounds)
        macs = c.multiply_accumulates(policy, env.drones, config.scenario.balls)
        described = contract.describe(config, given.method, policy, env) | {
            "files": contract.hashes(live.path, sorted(texts)),
            "c": {
                "bounds": asdict(bounds),
                "inputs_bytes": layout.inputs_dtype(bounds).itemsize,
                "target": asdict(c.TARGETS[target]),
                "flash_bytes_at_most": flash,
                "ram_bytes_at_most": ram,
                "multiply_accumulates": macs,
                "cortex_m4": None if footprint is None else asdict(footprint),
            },
            "golden": contract.golden_vectors(vectors),
            "parity": contract.parity_lines(proofs, f"C on {platform.machine()}"),
        }
        contract.write(live.path / "contract.json", described)
        live.update(result={"parity": [asdict(proof) for proof in proofs], "c": described["c"]})
    return CExport(run, proofs, flash, ram, macs, footprint)


def origin(given: Subject, run: str) -> dict[str, str]:
    """Where an export comes from, as its header says."""
    facts = given.method.facts
    return {
        "policy": given.method.name,
        "trained in run": str(facts.get("run") or "unknown"),
        "training steps": str(facts.get("steps") or "unknown"),
        "learner": str(facts.get("algo") or "unknown"),
        "exported in run": run,
        "scenario": given.config.scenario.name,
        "drone": given.config.drone.name,
    }


def compiled(folder: Path, bounds: Bounds) -> CompiledPolicy:
    """The export in ``folder`` compiled for this machine, and its self-test passed. Raises RunFailed otherwise."""
    with tempfile.TemporaryDirectory() as scratch:  # a loaded library may be deleted
        library = CompiledPolicy(toolchain.shared_library(folder, Path(scratch) / "policy.so"), bounds)
    found, largest = library.self_test()
    if found:
        raise RunFailed(f"{folder}: its self-test says {found} (largest difference {largest:.1e}): do not fly it")
    return library


def compare(computer: Any, policy: "Policy", env: "FormationEnv", inputs: Inputs, bounds: Bounds) -> Parity:
    """How far the set-points of ``computer`` (``compute(packed)``) are from PyTorch's on the same measurements."""
    setpoints, _ = computer.compute(layout.pack(inputs, env, bounds))
    theirs = (setpoints["body_rates_rad_s"], setpoints["thrust_share"], setpoints["command"])
    ours = c.setpoints(policy, env, inputs)
    largest = {
        field.name: float(np.abs(mine.astype(float) - other).max())
        for field, mine, other in zip(OUTPUTS, ours, theirs, strict=True)
    }
    columns, balls = inputs["columns"].shape[1], inputs["ball_position"].shape[1]
    return Parity(len(inputs["time"]), balls, columns, largest)


def passed(path: Path, parity: Parity) -> Parity:
    """``parity``. Raises RunFailed where it is out of tolerance."""
    if not parity.worst <= TOLERANCE:
        raise RunFailed(
            f"{path}: its command differs from torch's by {parity.worst:.1e} with {parity.balls} balls, more than "
            f"{TOLERANCE:.0e}: do not fly this file"
        )
    return parity


def measure(folder: Path, bounds: Bounds, vectors: Golden) -> "Footprint | None":
    """What the export takes of a Cortex-M4, on an emulator; None without the extra ``onboard``.

    Raises RunFailed where its self-test fails there.
    """
    try:
        toolchain.require("ziglang", "unicorn", "elftools")
    except ValueError:
        return None
    from formctl.deployment.cortex_m4 import CortexM4

    with tempfile.TemporaryDirectory() as scratch:
        chip = CortexM4(toolchain.firmware(folder, Path(scratch) / "policy.elf"), bounds)
    found, largest = chip.self_test()
    if found:
        raise RunFailed(f"{folder}: its self-test says {found} on the Cortex-M4 (largest difference {largest:.1e})")
    return chip.footprint(vectors.inputs)


def check(folder: Path) -> dict[str, Any]:
    """Verify an export: its files by their hashes, and C by its self-test on this machine. Returns its contract.

    Raises ValueError or RunFailed, in one line, for what is not as it was exported.
    """
    described = contract.read(folder)
    if "c" in described:
        compiled(folder, Bounds(**described["c"]["bounds"]))
    return described
