"""One policy in several bodies: PyTorch, ONNX, C compiled for this machine, and machine code of a Cortex-M4.

Every body but PyTorch's flies what ``formctl export`` writes, checked as it is there: an evaluation is one of the
exported files. Bodies differ in rounding only, which contacts and last-moment evasions amplify: rates agree, single
episodes need not.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from algos.export import contract, layout, onnx
from algos.export.layout import Bounds
from algos.policy import Policy
from analysis.stats import comparison
from baselines.protocol import Capabilities
from envs.formation import FormationEnv
from envs.spec import Scenarios, State
from formctl import console
from formctl.deployment import export, toolchain
from formctl.deployment.export import Subject
from formctl.deployment.library import CompiledPolicy
from formctl.errors import ConfigError
from formctl.evaluation.rows import read_rows
from formctl.settings import build

if TYPE_CHECKING:
    from formctl.evaluation.methods import Method
    from formctl.settings import Config
    from formctl.store import Run

BODIES = ("torch", "onnx", "c", "cortex-m4")
OBSERVATIONS = 200
"""Recorded observations on which an export is held against PyTorch before it flies."""


class OnnxBody:
    """The graph of an export in onnxruntime; (E, N, 4) commands."""

    def __init__(self, path: Path, policy: Policy) -> None:
        self._session, self._names = onnx.session(path), [field.name for field in contract.fields(policy)]

    def command(self, inputs: contract.Inputs, env: FormationEnv) -> np.ndarray:
        """Commands (E, N, 4) in [-1, 1] for measurements."""
        return self._session.run(["command"], {name: inputs[name].numpy() for name in self._names})[0]


class CBody:
    """The C of an export, on this machine or on an emulated chip."""

    def __init__(self, computer: Any, bounds: Bounds) -> None:
        self._computer, self._bounds = computer, bounds

    def command(self, inputs: contract.Inputs, env: FormationEnv) -> np.ndarray:
        """Commands (E, N, 4) in [-1, 1] for measurements."""
        setpoints, _ = self._computer.compute(layout.pack(inputs, env, self._bounds))
        return setpoints["command"].reshape(-1, env.drones, 4)


class BodyAgent:
    """A policy in another body as an agent: deterministic, without memory."""

    def __init__(self, name: str, policy: Policy, body: str, path: Path, bounds: Bounds, env: FormationEnv) -> None:
        """``path`` is what the body runs: the graph, the library or the firmware's image."""
        policy.check(env)
        self.name, self._policy, self._env = name, policy, env
        self.capabilities = Capabilities(
            command="ctbr", batched=body != "cortex-m4", needs_ball_parameters=False, max_drones=None
        )
        self._body = loaded(policy, body, path, bounds)

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Nothing to prepare."""

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Command (E, N, 4) in [-1, 1]."""
        inputs = contract.measure(self._policy, self._env, state, scenarios)
        single = {name: x.float() if x.is_floating_point() else x for name, x in inputs.items()}
        return torch.from_numpy(self._body.command(single, self._env).copy()).to(state.position.dtype)


def loaded(policy: Policy, body: str, path: Path, bounds: Bounds) -> OnnxBody | CBody:
    """The body that runs the file at ``path``."""
    if body == "onnx":
        return OnnxBody(path, policy)
    if body == "c":
        return CBody(CompiledPolicy(path, bounds), bounds)
    from formctl.deployment.cortex_m4 import CortexM4  # of the extra `onboard`

    return CBody(CortexM4(path, bounds), bounds)


def parse(text: str | None) -> tuple[str, ...]:
    """The bodies of ``--body``, PyTorch's where it was not given. Raises ConfigError for one that does not exist."""
    named = [part.strip() for part in text.split(",")] if text else ["torch"]
    if unknown := [name for name in named if name not in BODIES]:
        raise ConfigError(f"--body {text} cannot be used: there is no body {unknown[0]!r}, only {', '.join(BODIES)}")
    if "cortex-m4" in named:
        toolchain.require("ziglang", "unicorn", "elftools")
    if "onnx" in named:
        onnx.require()
    return tuple(dict.fromkeys(named))


def embodied(flown: "Sequence[Method]", bodies: Sequence[str], config: "Config") -> "list[Method]":
    """Every policy of ``flown`` in each of the bodies, exported for the world of ``config``; baselines as they are.

    Raises ValueError for a policy that a body does not compute, RunFailed where an export differs from PyTorch.
    """
    return [
        method if body == "torch" or method.trained is None else embody(method, body, config)
        for method in flown
        for body in (bodies if method.trained is not None else ("torch",))
    ]


def embody(method: "Method", body: str, config: "Config") -> "Method":
    """A policy in another body than PyTorch's."""
    config = method.settings_of(config)
    given = Subject(method, config, build.environment(build.world(config), "torch"))
    scenario, least = config.scenario, Bounds()
    bounds = Bounds(
        max(least.neighbours, given.env.drones - 1),
        max(least.balls, scenario.balls),
        max(least.columns, scenario.columns),
    )
    console.say(f"about to export {method.name} for body {body}, and to compare it with torch")
    run, path = written(given, body, bounds)
    name = f"{method.name} ({body})"
    return replace(
        method,
        facts=method.facts | {"name": name, "body": body},
        parents=(*method.parents, run.id),
        make=partial(BodyAgent, name, method.policy(), body, path, bounds),
    )


def written(given: Subject, body: str, bounds: Bounds) -> "tuple[Run, Path]":
    """The export that a body runs, and the file of it that it loads."""
    if body == "onnx":
        run, _ = export.to_onnx(given, None, OBSERVATIONS)
        return run, run.path / "policy.onnx"
    run = export.to_c(given, None, OBSERVATIONS, "crazyflie", bounds).run
    if body == "c":
        return run, toolchain.shared_library(run.path, run.path / "policy.so")
    return run, toolchain.firmware(run.path, run.path / "policy.elf")


def show_pairs(runs: "Sequence[Run]") -> None:
    """Bodies against PyTorch on the same episodes: a row a body, where both were flown."""
    sides = {}
    for run in runs:
        facts = run.record["method"]
        original = str(facts["name"]).removesuffix(f" ({facts.get('body')})")
        key = original, str(run.config["sim"]), facts.get("body", "torch")
        sides[key] = comparison.Side(str(facts["name"]), read_rows(run.path / "episodes.parquet"))
    rows = []
    for (original, sim, body), side in sides.items():
        if body != "torch" and (reference := sides.get((original, sim, "torch"))):
            pairs = comparison.compare(nameless(reference), nameless(side))
            change, fm = pairs.difference, pairs.fm
            rows.append(
                (
                    side.name, sim, f"{pairs.first.value:.3f}", f"{pairs.second.value:.3f}",
                    f"{change.value:+.3f} ({change.low:+.3f} to {change.high:+.3f})",
                    f"{pairs.only_first} / {pairs.only_second}", f"{pairs.shared}",
                    "-" if fm is None else f"{fm.value:+.4f} m",
                )
            )  # fmt: skip
    if rows:
        columns = ("body", "sim", "CFR torch", "CFR body", "difference", "only torch / only body", "episodes", "FM")
        console.table(columns, rows, title="against torch, on the same episodes")


def nameless(side: comparison.Side) -> comparison.Side:
    """The side without the column that names its method: the same episodes are to be paired."""
    return comparison.Side(side.name, side.rows.drop(columns=["method", "run"]))
