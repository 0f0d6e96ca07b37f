"""A policy as C99 for a microcontroller: which policies, what they take, and their weights and golden vectors."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from algos.encoder import EncoderSpec
from algos.export import layout
from algos.export.contract import DeployedPolicy, Inputs, fields
from algos.export.layout import Bounds
from algos.policy import Policy
from envs.formation import FormationEnv
from envs.spec import ObservationSpec

TOLERANCE = 1e-5
"""Largest difference of a golden command, in [-1, 1], from PyTorch's."""


def check(policy: Policy, env: FormationEnv) -> None:
    """Raise ValueError, in one line, for a policy whose observation or encoder the C sources do not compute."""
    policy.check(env)
    encoder, seen = policy.encoder_spec, policy.observation
    if not isinstance(encoder, EncoderSpec) or not isinstance(seen, ObservationSpec):
        raise ValueError(f"--c exports encoder=attention with observation=paper, not a network of {seen.name}")
    if (encoder.embedding, encoder.self_attention, encoder.cross_attention) != ("mlp", "attention", "attention"):
        raise ValueError(f"--c exports encoder=attention, not encoder={encoder.name}: export it as ONNX, without --c")
    if encoder.width % 4:
        raise ValueError(f"--c needs an encoder width that is a multiple of 4, not {encoder.width}: export it as ONNX")
    if not (seen.conditioned and seen.lookahead > 0 and seen.slot_relative) or seen.rotor_throttles:
        raise ValueError(
            f"--c exports observation=paper (conditioned, lookahead, slot_relative, no rotor_throttles), not "
            f"observation={seen.name}: export it as ONNX, without --c"
        )
    widths = policy.layout.self_dim, policy.layout.drones_dim, policy.layout.static_dim, policy.layout.dynamic_dim
    if widths != (25 + 4 * seen.previous_command, 7, 9, 10):
        raise ValueError(f"--c does not know an observation with groups of {widths} numbers: export it as ONNX")


def weights(policy: Policy) -> NDArray[np.float32]:
    """All weights as ``struct policy_weights`` holds them, matrices four outputs at a time."""
    parameters = {name: value.detach().float().numpy() for name, value in policy.named_parameters()}
    parts = [blocked(parameters.pop(name)) for name in _order()]
    left = sorted(set(parameters) - {"log_std"})
    if left:
        raise ValueError(f"--c does not know the parameters {', '.join(left)} of this policy: export it as ONNX")
    return np.concatenate(parts).astype("<f4")


def _order() -> list[str]:
    """Names of parameters in the order of ``struct policy_weights``."""
    embeddings = [
        f"encoder.embed.{group}.{layer}" for group in ("self", "drones", "dynamic", "static") for layer in "02"
    ]

    def attention(norm: str, name: str) -> list[str]:
        return [f"encoder.{norm}", *(f"encoder.{name}.{part}" for part in ("query", "key_value", "output"))]

    def feed(norm: str, name: str) -> list[str]:
        return [f"encoder.{norm}", f"encoder.{name}.0", f"encoder.{name}.2"]

    layers = [
        *embeddings,
        *attention("norm_mix", "mix"),
        *feed("norm_tokens", "feed_tokens"),
        *attention("norm_shared", "gather"),
        *feed("norm_pair", "feed_pair"),
        "head",
    ]
    return [f"{layer}.{kind}" for layer in layers for kind in ("weight", "bias")]


def blocked(parameter: NDArray[np.float32]) -> NDArray[np.float32]:
    """A matrix (outputs, inputs) as [outputs / 4][inputs][4], flat; a vector as it is."""
    if parameter.ndim == 1:
        return parameter
    return parameter.reshape(-1, 4, parameter.shape[1]).transpose(0, 2, 1).reshape(-1)


@dataclass(frozen=True)
class Target:
    """A microcontroller, as far as a policy has to fit in it."""

    name: str
    flash: int  # bytes for code and weights
    ram: int  # bytes for the stack of one inference and its inputs


TARGETS = {
    "crazyflie": Target("crazyflie", flash=512 * 1024, ram=29_000),
}
"""The Crazyflie's STM32F405: half of its megabyte of flash, the RAM that the stock firmware leaves free."""

CODE = 8 * 1024
"""Bytes of machine code at most (a Cortex-M4 takes 5 KB); the rest of a policy's flash is weights."""
FRAMES = 1536
"""Bytes of stack at most beside the tokens (a Cortex-M4 takes 1.1 KB)."""


def needs(policy: Policy, bounds: Bounds) -> tuple[int, int]:
    """Bytes of flash and of RAM that a policy takes at most, by arithmetic."""
    tokens = 1 + bounds.neighbours + bounds.balls + 1
    frames = FRAMES * policy.encoder_spec.width // 32
    ram = 4 * 3 * policy.encoder_spec.width * tokens + frames + layout.inputs_dtype(bounds).itemsize
    return 4 * len(weights(policy)) + CODE, ram


def fit(policy: Policy, bounds: Bounds, target: Target) -> None:
    """Raise ValueError, in one line, for a policy that does not fit."""
    flash, ram = needs(policy, bounds)
    if flash > target.flash or ram > target.ram:
        raise ValueError(
            f"the policy does not fit {target.name}: it takes {flash / 1024:.0f} KiB of flash and {ram / 1024:.1f} KiB "
            f"of RAM, and there are {target.flash // 1024} and {target.ram / 1024:.1f}: train a smaller encoder.width, "
            "or lower --neighbours, --balls and --columns"
        )


def multiply_accumulates(policy: Policy, drones: int, balls: int) -> int:
    """Multiply-accumulates of one inference with columns in sight: matrices and attention, without the observation."""
    seen, width = policy.layout, policy.encoder_spec.width
    others = drones - 1 + balls + 1
    tokens = 1 + others
    inputs = seen.self_dim + (drones - 1) * seen.drones_dim + balls * seen.dynamic_dim + seen.static_dim
    square = width * width
    embedding = width * inputs + square * tokens
    mixing = (4 * square + 2 * width * tokens) * tokens
    gathering = 2 * square + 2 * square * others + 2 * width * others
    return embedding + mixing + 2 * square * tokens + gathering + 2 * 2 * square + 4 * 2 * width


@dataclass(frozen=True)
class Golden:
    """Recorded inputs, one drone each, and the commands that PyTorch gives for them."""

    inputs: NDArray[Any]  # (G,) of layout.inputs_dtype
    commands: NDArray[np.float32]  # (G, 4) in [-1, 1]


@torch.no_grad()
def setpoints(policy: Policy, env: FormationEnv, inputs: Inputs) -> tuple[NDArray[np.float32], ...]:
    """PyTorch's ``OUTPUTS`` for measurements (E, N, ...), one row a drone, in the order of ``layout.pack``.

    Rates (K, 3) in rad/s, thrust (K,) as a share of full scale, command (K, 4) in [-1, 1], where K = E * N.
    """
    given = {field.name: inputs[field.name] for field in fields(policy)}
    return tuple(output.flatten(0, 1).numpy() for output in DeployedPolicy(policy, env).eval()(**given))


def golden(policy: Policy, env: FormationEnv, inputs: Inputs, bounds: Bounds, count: int = 8) -> Golden:
    """``count`` of the recorded measurements, evenly spread, every drone in turn."""
    packed = layout.pack(inputs, env, bounds)
    chosen = np.linspace(0, len(packed) - 1, count).round().astype(int)
    return Golden(packed[chosen], setpoints(policy, env, inputs)[2][chosen])
