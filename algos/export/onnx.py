"""A policy as one ONNX graph. Numbers of episodes (the batch), columns and balls stay free where the encoder allows it;
the number of drones is the formation's."""

import logging
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from algos.export.contract import OUTPUTS, DeployedPolicy, blank, fields
from algos.policy import Policy
from envs.formation import FormationEnv

OPSET = 18
PACKAGES = ("onnx", "onnxscript", "onnxruntime")


def require() -> None:
    """Raise ValueError unless the packages of the extra ``export`` are installed."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise ValueError(f"export needs {', '.join(missing)}: pip install 'formctl[export]'")


def free_sizes(policy: Policy) -> tuple[str, ...]:
    """Sizes that may differ from call to call; without cross-attention the number of balls is not among them."""
    attends = policy.encoder_spec.cross_attention == "attention"
    return ("E", "C", "M") if attends else ("E", "C")


def write(policy: Policy, env: FormationEnv, path: Path) -> None:
    """The graph as an ONNX file. Raises ValueError where a package of the extra ``export`` is missing."""
    require()
    wanted = fields(policy)
    free = free_sizes(policy)
    example = blank(policy, env, 2, 2, 2 if "M" in free else policy.balls)
    shapes = {
        field.name: {axis: torch.export.Dim.DYNAMIC for axis, size in enumerate(field.shape) if size in free}
        for field in wanted
    }
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter's own making
        program = torch.onnx.export(
            DeployedPolicy(policy, env).eval(),
            kwargs={field.name: example[field.name] for field in wanted},
            input_names=[field.name for field in wanted],
            output_names=[field.name for field in OUTPUTS],
            dynamic_shapes=shapes,
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    program.save(path, external_data=False)


@dataclass(frozen=True)
class Parity:
    """How far an ONNX file is from the policy on recorded measurements."""

    observations: int
    balls: int
    columns: int
    largest: dict[str, float]  # absolute difference by output, in its unit

    @property
    def worst(self) -> float:
        """The larger of command and thrust; the rates are the command times their limit, in rad/s."""
        return max(self.largest["command"], self.largest["thrust_setpoint"])


@torch.no_grad()
def compare(path: Path, policy: Policy, env: FormationEnv, inputs: Mapping[str, Tensor]) -> Parity:
    """Run a file with onnxruntime and the policy with torch on the same measurements."""
    names = [field.name for field in fields(policy)]
    ours = DeployedPolicy(policy, env).eval()(**{name: inputs[name] for name in names})
    theirs = session(path).run(None, {name: inputs[name].numpy() for name in names})
    largest = {
        field.name: float(np.abs(mine.numpy().astype(float) - other).max())
        for field, mine, other in zip(OUTPUTS, ours, theirs, strict=True)
    }
    sizes = inputs["ball_position"].shape[1], inputs["columns"].shape[1]
    return Parity(len(inputs["time"]), *sizes, largest)


def session(path: Path) -> Any:
    """The file in onnxruntime, on one CPU thread. Raises ValueError where the package is missing."""
    require()
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
