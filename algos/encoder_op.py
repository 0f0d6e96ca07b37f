"""The attention encoder as one operator in C++ (`algos/native/encoder.cpp`), with its gradient: what trains on a CPU.

PyTorch's own modules (`algos.encoder`) say what it computes and are what it is tested against; they serve wherever this
operator does not: other devices and number formats, the ablations, `torch.compile`, machines without a C++ compiler.
"""

import ctypes
from functools import cache
from math import prod
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from envs import native
from envs.spec import Observation

SOURCE = Path(__file__).parent / "native" / "encoder.cpp"
GROUPS = ("self", "drones", "dynamic", "static")
"""Observation groups in the order of tokens and of parameters."""
MASKS = ("dynamic_mask", "static_mask")


class Shape(ctypes.Structure):
    """`Shape` of the C++ source."""

    _fields_ = (
        ("rows", ctypes.c_int32),
        ("drones", ctypes.c_int32),
        ("balls", ctypes.c_int32),
        ("dims", ctypes.c_int32 * len(GROUPS)),
        ("two_layers", ctypes.c_int32),
    )


class EncoderOp:
    """The operator for one width, number of heads and kind of embedding."""

    def __init__(self, library: ctypes.CDLL, width: int, two_layers: bool) -> None:
        self.forward, self.backward, self.saved_floats = library.encode, library.encode_backward, library.saved_floats
        self.forward.restype = self.backward.restype = None
        self.saved_floats.restype = ctypes.c_int64
        self.block: int = library.rows_of_a_block()
        self.width, self.two_layers = width, two_layers
        self.shapes: dict[tuple[torch.Size, ...], tuple[Any, int]] = {}

    def __call__(self, observation: Observation, parameters: Tensor) -> Tensor:
        """Features (..., 2 * width) of observation groups (..., tokens, d), differentiable with respect to both.

        `parameters` are all of an `algos.encoder.Encoder`'s, one behind the other.
        """
        groups = [observation[name].contiguous() for name in GROUPS]
        masks = [observation[name].contiguous() for name in MASKS]
        return _Encode.apply(self, torch.is_grad_enabled(), parameters, *groups, *masks)

    def shape(self, groups: tuple[Tensor, ...]) -> tuple[Any, int]:
        """What the C++ functions are told of the groups, and the floats that a block of rows keeps for its gradient."""
        key = tuple(x.shape for x in groups)
        if key not in self.shapes:
            rows, dims = prod(key[0][:-2]), (ctypes.c_int32 * len(GROUPS))(*(x[-1] for x in key))
            shape = ctypes.pointer(Shape(rows, key[1][-2], key[2][-2], dims, self.two_layers))
            self.shapes[key] = shape, self.saved_floats(shape)
        return self.shapes[key]


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, op: EncoderOp, differentiable: bool, parameters: Tensor, *inputs: Tensor) -> Tensor:
        groups, masks = inputs[: len(GROUPS)], inputs[len(GROUPS) :]
        shape, floats = op.shape(groups)
        keep = differentiable and any(ctx.needs_input_grad)
        saved = parameters.new_empty(floats * (-(-shape.contents.rows // op.block) if keep else 1))
        features = parameters.new_empty((*groups[0].shape[:-2], 2 * op.width))
        op.forward(
            shape,
            _pointers(groups),
            _pointers(masks),
            _pointer(parameters),
            _pointer(features),
            _pointer(saved),
            keep,
        )
        if keep:
            ctx.op, ctx.shape = op, shape
            ctx.save_for_backward(parameters, saved, *inputs)
        return features

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
        parameters, saved, *inputs = ctx.saved_tensors
        gradient, groups, masks = gradient.contiguous(), inputs[: len(GROUPS)], inputs[len(GROUPS) :]
        _, _, wanted, *observed = ctx.needs_input_grad
        by_parameter = torch.empty_like(parameters) if wanted else None
        by_group = [torch.empty_like(x) for x in groups] if any(observed) else []
        ctx.op.backward(
            ctx.shape,
            _pointers(masks),
            _pointer(parameters),
            _pointer(saved),
            _pointer(gradient),
            _pointers(by_group) if by_group else None,
            None if by_parameter is None else _pointer(by_parameter),
        )
        return None, None, by_parameter, *(by_group or [None] * len(GROUPS)), *[None] * len(MASKS)


@cache
def encoder_op(width: int, heads: int, two_layers: bool) -> EncoderOp | None:
    """The operator for an encoder's sizes, built at first use; None where it cannot be."""
    if width % 16 or width % heads:
        return None
    library = native.library(SOURCE, WIDTH=width, HEADS=heads)
    return library and EncoderOp(library, width, two_layers)


def _pointers(tensors: Any) -> Any:
    return (ctypes.c_void_p * len(tensors))(*(x.data_ptr() for x in tensors))


def _pointer(tensor: Tensor) -> ctypes.c_void_p:
    return ctypes.c_void_p(tensor.data_ptr())
