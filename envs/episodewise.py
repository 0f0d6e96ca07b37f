"""Pieces of the world as C++ on a CPU: one program for a batch of episodes, vector registers across them, with its
gradient. Made from the PyTorch functions themselves, which stay the only place where the world is written down.

A step of 64 episodes is a few thousand operations on vectors. As PyTorch's own kernels, compiled or not, most of its
time goes into calls, guards and loops over three drones. Building takes seconds, once per machine, world and shape.
"""

import copy
import ctypes
import logging
from array import array
from collections.abc import Callable, Iterator
from functools import cached_property
from string import Template
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from envs import memory, native
from envs.scalars import Program
from envs.tracing import Tracer, Untraceable

log = logging.getLogger(__name__)

FRAME = native.HEADERS / "episodewise.cpp"
KINDS = {torch.float32: 0, torch.int64: 1, torch.bool: 2}
ABSENT = (0, 0, 0, 0)
"""An `Array` of the C++ frame that is not there."""


class Episodewise:
    """A function of tensors (E, ...) and named tuples of them that treats every episode alike and by itself.

    The tuples may hold settings beside tensors; a program is made for each. Values and gradients are the function's own
    but for rounding. Whole numbers go through float32 and have to stay below 2^24. Gradients reach the arguments
    numbered in `differentiable` only. Where no program can be made of the function, what `compiler` makes of it is
    called.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        compiler: Callable[[Callable[..., Any]], Callable[..., Any]],
        differentiable: tuple[int, ...] = (0,),
        rows: bool = False,
    ) -> None:
        """`rows`: outputs lie in memory with their episodes outermost, not innermost."""
        self.function, self.compiler = function, compiler
        self.differentiable, self.rows = differentiable, rows
        self.built: dict[Any, _Kernel | None] = {}  # by shapes of an episode
        self.batches: dict[Any, _Kernel | None] = {}  # by shapes

    def __call__(self, *arguments: Any, repeat: int = 1) -> Any:
        """The function; with `repeat`, its result takes the place of the first argument so many times in all."""
        leaves: list[Any] = []
        for argument in arguments:
            leaves.extend(argument) if isinstance(argument, tuple) else leaves.append(argument)
        key = tuple([x.shape if isinstance(x, Tensor) else x for x in leaves])
        if key not in self.batches:
            self.batches[key] = self._prepared(arguments, leaves)
        if kernel := self.batches[key]:
            return kernel(leaves, repeat)
        return self.otherwise(*arguments) if repeat == 1 else self.otherwise(*arguments, repeat=repeat)

    @cached_property
    def otherwise(self) -> Callable[..., Any]:
        """The function by PyTorch."""
        return self.compiler(self.function)

    def _prepared(self, arguments: Any, leaves: list[Any]) -> "_Kernel | None":
        key = tuple(x.shape[1:] if isinstance(x, Tensor) else x for x in leaves)
        if key not in self.built:
            self.built[key] = self._build(arguments, leaves)
        kernel = self.built[key]
        return kernel and kernel.batch(leaves)

    def _build(self, arguments: Any, leaves: list[Any]) -> "_Kernel | None":
        wanted = [
            number in self.differentiable
            for number, argument in enumerate(arguments)
            for _ in pytree.tree_leaves(argument)
        ]
        try:
            kernel = _Kernel(self.function, arguments, leaves, wanted, self.rows)
        except Untraceable as error:
            log.debug("%s is left to PyTorch: %s", self.function, error)
            return None
        return kernel if kernel.library else None


class _Kernel:
    """An `Episodewise` function for arguments of certain shapes; called for the `batch` it is of."""

    episodes: int
    strides: list[tuple[int, ...]]  # of arguments whose episodes are innermost in memory

    def __init__(
        self, function: Callable[..., Any], arguments: Any, leaves: list[Any], wanted: list[bool], rows: bool
    ) -> None:
        self.rows = rows
        structure = pytree.tree_structure(arguments)
        self.tensors = [k for k, x in enumerate(leaves) if isinstance(x, Tensor)]
        examples = [leaves[k][:1].detach().clone() for k in self.tensors]
        wanted = [wanted[k] and x.is_floating_point() for k, x in zip(self.tensors, examples, strict=True)]
        program = Program()
        places = _places(program, examples)

        def flat(*given: Tensor) -> list[Tensor]:
            every = dict(zip(self.tensors, given, strict=True))
            called = pytree.tree_unflatten([every.get(k, x) for k, x in enumerate(leaves)], structure)
            result, self.structure = pytree.tree_flatten(function(*called))
            self.kinds = [x.dtype for x in result]
            return result

        results = Tracer(program).run(flat, examples, places)
        self.shapes = [x.shape[1:] for x in results]
        self.passed = [_same(result, places) for result in results]  # outputs that are inputs as they came
        self.made = [i for i, source in enumerate(self.passed) if source is None]
        self.library = native.generated(self._source(program, examples, places, results, wanted), "episodewise")

    def batch(self, leaves: list[Any]) -> "_Kernel":
        """The same for as many episodes as there are in `leaves`."""
        other = copy.copy(self)
        other.episodes = len(leaves[0])
        other.strides = [memory.ordered(leaves[k]).stride() for k in self.tensors]
        return other

    def _source(
        self, program: Program, examples: list[Tensor], places: list[Tensor], results: list[Tensor], wanted: list[bool]
    ) -> str:
        """The C++; tells which inputs are read and which have gradients."""
        values, slopes = [], []
        for i in self.made:
            for value in results[i].reshape(-1).tolist():
                if self.kinds[i].is_floating_point:
                    slopes.append((value, program.input("dout", len(values))))
                values.append(program.number(value))
        inputs = [x.reshape(-1).tolist() for x in places]
        gradients = [
            program.gradient(slopes, numbers) if one else [] for one, numbers in zip(wanted, inputs, strict=True)
        ]
        nothing = program.constant(0.0)
        self.wanted = [k for k, slopes_of in enumerate(gradients) if any(g != nothing for g in slopes_of)]
        outgoing = [g for k in self.wanted for g in gradients[k]]
        read = program.needed([*values, *outgoing])
        self.used = [k for k, numbers in enumerate(inputs) if k in self.wanted or read & set(numbers)]
        firsts = [sum(x.numel() for x in examples[:k]) for k in range(len(examples) + 1)]
        carried: list[int] = []
        for i in self.made:  # a result takes the place of the argument at the same leaf
            same = i < len(examples) and examples[i].shape[1:] == self.shapes[i]
            carried += range(firsts[i], firsts[i + 1]) if same else [-1] * results[i].numel()
        return Template(FRAME.read_text()).substitute(
            inputs=firsts[-1],
            outputs=len(values),
            wanted=len(outgoing),
            tensors=len(self.used),
            results=len(self.made),
            gradients=len(self.wanted),
            input_sizes=_numbers([examples[k].numel() for k in self.used]),
            input_firsts=_numbers([firsts[k] for k in self.used]),
            output_sizes=_numbers([results[i].numel() for i in self.made]),
            gradient_sizes=_numbers([examples[k].numel() for k in self.wanted]),
            gradient_firsts=_numbers([firsts[k] for k in self.wanted]),
            wanted_inputs=_numbers([v for k in self.wanted for v in range(firsts[k], firsts[k + 1])]),
            carried=_numbers(carried),
            value=program.source(values),
            gradient=program.source(outgoing),
        )

    def __call__(self, leaves: list[Any], repeat: int) -> Any:
        if len(self.tensors) < len(leaves):
            leaves = [leaves[k] for k in self.tensors]
        made: Iterator[Tensor] = iter(())
        if self.made:
            made = iter(_Run.apply(self, repeat, torch.is_grad_enabled(), *[leaves[k] for k in self.used]))
        outputs = [next(made) if source is None else leaves[source] for source in self.passed]
        return pytree.tree_unflatten(outputs, self.structure)

    def empty(self, shape: torch.Size, kind: torch.dtype) -> Tensor:
        """Memory for an output."""
        if self.rows:
            return torch.empty((self.episodes, *shape), dtype=kind)
        return torch.empty((*shape, self.episodes), dtype=kind).movedim(-1, 0)

    def array(self, x: Tensor) -> tuple[int, int, int, int]:
        """A tensor in order as the C++ frame's `Array`: where it is, by episode and by element, and what of."""
        if x.is_contiguous():
            return x.data_ptr(), x[0].numel(), 1, KINDS[x.dtype]
        return x.data_ptr(), 1, self.episodes, KINDS[x.dtype]

    @cached_property
    def functions(self) -> tuple[Any, Any]:
        """C++: (episodes, repeat, inputs, outputs), and (episodes, repeat, inputs, slopes, gradients of inputs)."""
        assert self.library is not None
        forward, backward = self.library.forward, self.library.backward
        forward.argtypes = [ctypes.c_int32] * 2 + [ctypes.c_void_p] * 2
        backward.argtypes = [ctypes.c_int32] * 2 + [ctypes.c_void_p] * 3
        forward.restype = backward.restype = None
        return forward, backward


class _Run(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, kernel: _Kernel, repeat: int, differentiable: bool, *inputs: Tensor) -> tuple[Tensor, ...]:
        given = [_ordered(x, kernel.strides[k]) for k, x in zip(kernel.used, inputs, strict=True)]
        outputs = [kernel.empty(kernel.shapes[i], kernel.kinds[i]) for i in kernel.made]
        arrays = [_arrays(kernel, some) for some in (given, outputs)]
        kernel.functions[0](kernel.episodes, repeat, *(x.buffer_info()[0] for x in arrays))
        if differentiable and any(ctx.needs_input_grad):
            ctx.kernel, ctx.repeat = kernel, repeat
            ctx.save_for_backward(*given)
            ctx.set_materialize_grads(False)
            ctx.mark_non_differentiable(*(x for x in outputs if not x.is_floating_point()))
        return tuple(outputs)

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor | None) -> tuple[Any, ...]:
        kernel, given = ctx.kernel, ctx.saved_tensors
        incoming = [None if x is None else x if x.is_contiguous() else memory.ordered(x) for x in slopes]
        outgoing = [torch.empty_like(given[kernel.used.index(k)]) for k in kernel.wanted]
        arrays = [_arrays(kernel, some) for some in (given, incoming, outgoing)]
        kernel.functions[1](kernel.episodes, ctx.repeat, *(x.buffer_info()[0] for x in arrays))
        found = dict(zip(kernel.wanted, outgoing, strict=True))
        return None, None, None, *(found.get(k) for k in kernel.used)


def _places(program: Program, examples: list[Tensor]) -> list[Tensor]:
    """Inputs of the program in place of the numbers of its arguments."""
    places, count = [], 0
    for x in examples:
        values = [program.input("in", count + i) for i in range(x.numel())]
        if x.dtype == torch.bool:
            values = [program.apply("ne", value, program.constant(0.0)) for value in values]
        places.append(torch.tensor(values, dtype=torch.int64).view(x.shape))
        count += x.numel()
    return places


def _same(result: Tensor, places: list[Tensor]) -> int | None:
    return next((k for k, x in enumerate(places) if x.shape == result.shape and torch.equal(x, result)), None)


def _ordered(x: Tensor, strides: tuple[int, ...]) -> Tensor:
    """The tensor with its episodes innermost or outermost in memory: as it is if it can be."""
    return x if x.stride() == strides or x.is_contiguous() else memory.ordered(x)


def _arrays(kernel: _Kernel, tensors: Any) -> array:
    """`Array`s for C++, four 64-bit numbers each."""
    return array("q", [n for x in tensors for n in (ABSENT if x is None else kernel.array(x))] or ABSENT)


def _numbers(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers or [0]))
