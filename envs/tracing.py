"""From functions of tensors (E, ...) to programs of numbers: PyTorch traces the function for one episode, and every
number of every tensor becomes one of the program. Moving numbers around then costs nothing, and what is left are a few
thousand operations that all episodes do alike.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import torch
from torch import Tensor
from torch._decomp import core_aten_decompositions
from torch.fx.experimental.proxy_tensor import make_fx

from envs.scalars import Program, Value

aten = torch.ops.aten

MOVING = {
    *(
        aten.view,
        aten.permute,
        aten.unsqueeze,
        aten.squeeze,
        aten.expand,
        aten.select,
        aten.slice,
        aten.cat,
        aten.stack,
    ),
    *(aten.index, aten.index_select, aten.split_with_sizes, aten.split, aten.unbind, aten.clone, aten.alias, aten.flip),
    *(aten.lift_fresh_copy, aten.repeat, aten.diagonal, aten.detach),
}
"""What only moves numbers: carried out on tensors of their places in the program."""

ELEMENTWISE = {
    aten.add: "add",
    aten.sub: "sub",
    aten.mul: "mul",
    aten.div: "div",
    aten.neg: "neg",
    aten.abs: "abs",
    aten.sqrt: "sqrt",
    aten.exp: "exp",
    aten.expm1: "expm1",
    aten.sin: "sin",
    aten.cos: "cos",
    aten.maximum: "max",
    aten.minimum: "min",
    aten.where: "where",
    aten.lt: "lt",
    aten.le: "le",
    aten.gt: "gt",
    aten.ge: "ge",
    aten.eq: "eq",
    aten.ne: "ne",
    aten.bitwise_and: "and",
    aten.logical_and: "and",
    aten.bitwise_or: "or",
    aten.logical_or: "or",
    aten.bitwise_not: "not",
    aten.logical_not: "not",
}

REDUCING = {aten.sum: "add", aten.amin: "min", aten.amax: "max", aten.any: "or", aten.all: "and", aten.mean: "add"}


class Untraceable(Exception):
    """A function does what programs of numbers cannot say."""


class Tracer:
    """Interprets a traced function with tensors of `Value`s in place of numbers."""

    def __init__(self, program: Program) -> None:
        self.program = program

    def run(
        self, function: Callable[..., Sequence[Tensor]], examples: list[Tensor], given: list[Tensor]
    ) -> list[Tensor]:
        """The outputs as int64 tensors of values, for `given` of the shapes of `examples`, one episode each."""
        with torch.no_grad():
            traced = make_fx(function, decomposition_table=core_aten_decompositions())(*examples)
        known: dict[torch.fx.Node, Any] = {}
        left = iter(given)
        for node in traced.graph.nodes:
            if node.op == "placeholder":
                known[node] = next(left)
            elif node.op == "get_attr":
                known[node] = self._constant(getattr(traced, node.target))
            elif node.op == "call_function":
                arguments = torch.fx.map_arg((node.args, node.kwargs), known.__getitem__)
                known[node] = self._call(node.target, *arguments)
            else:
                return torch.fx.map_arg(node.args[0], known.__getitem__)
        raise AssertionError("a graph without an output")

    def _call(self, target: Any, args: Any, kwargs: dict[str, Any]) -> Any:
        packet = getattr(target, "overloadpacket", target)
        if packet in MOVING:
            return target(*(self._places(packet, x, i) for i, x in enumerate(args)), **kwargs)
        if packet in ELEMENTWISE:
            return self._elementwise(ELEMENTWISE[packet], *args)
        if packet in REDUCING:
            return self._reduce(packet, *args)
        match packet:
            case aten.clamp:
                low, high = (*args[1:], None, None)[:2]
                low, high = kwargs.get("min", low), kwargs.get("max", high)
                bounded = args[0] if low is None else self._elementwise("max", args[0], low)
                return bounded if high is None else self._elementwise("min", bounded, high)
            case aten.pow:
                return self._power(*args)
            case aten.square:
                return self._elementwise("mul", args[0], args[0])
            case aten.reciprocal:
                return self._elementwise("div", 1.0, args[0])
            case aten.rsqrt:
                return self._elementwise("div", 1.0, self._elementwise("sqrt", args[0]))
            case aten.isinf:
                return self._elementwise("eq", self._elementwise("abs", args[0]), float("inf"))
            case aten._to_copy:
                return self._converted(args[0], kwargs.get("dtype"))
        if target.__name__ == "getitem":
            return args[0][args[1]]
        try:
            return self._constant(target(*torch.utils._pytree.tree_map_only(Tensor, self._number, args), **kwargs))
        except (KeyError, AttributeError) as error:
            raise Untraceable(str(target)) from error

    def _places(self, packet: Any, argument: Any, position: int) -> Any:
        """An argument of a moving operation; indices are numbers, not places."""
        if packet is aten.index and position == 1:
            return [x if x is None else self._number(x) for x in argument]
        if packet is aten.index_select and position == 2:
            return self._number(argument)
        return argument

    def _elementwise(self, name: str, *arguments: Any) -> Tensor:
        parts = [x if isinstance(x, Tensor) else self._constant(torch.tensor(x)) for x in arguments]
        parts = list(torch.broadcast_tensors(*parts))
        rows = zip(*(x.reshape(-1).tolist() for x in parts), strict=True)
        return torch.tensor([self._apply(name, *row) for row in rows], dtype=torch.int64).view(parts[0].shape)

    def _apply(self, name: str, *values: Value) -> Value:
        if name not in ("and", "or", "not"):
            first = 1 if name == "where" else 0
            values = (*values[:first], *(self.program.number(x) for x in values[first:]))
        return self.program.apply(name, *values)

    def _reduce(self, packet: Any, x: Tensor, dims: Any = None, keepdim: bool = False) -> Tensor:
        dims = list(range(x.dim())) if dims is None or dims == [] else [dims] if isinstance(dims, int) else dims
        dims = [d % x.dim() for d in dims]
        kept = [d for d in range(x.dim()) if d not in dims]
        rows = x.permute(*kept, *dims).reshape([x.shape[d] for d in kept] + [-1])
        empty = {"add": self.program.constant(0.0), "or": self.program.truth(False), "and": self.program.truth(True)}
        name, values = REDUCING[packet], []
        for row in rows.reshape(-1, rows.shape[-1]).tolist():
            value = reduce(lambda one, other: self._apply(name, one, other), row) if row else empty[name]
            if packet is aten.mean:
                value = self.program.apply("mul", value, self.program.constant(1 / len(row)))
            values.append(value)
        out = torch.tensor(values, dtype=torch.int64).view(rows.shape[:-1])
        return out.view([1 if d in dims else n for d, n in enumerate(x.shape)]) if keepdim else out

    def _power(self, x: Tensor, exponent: float) -> Tensor:
        if exponent == 0.5:
            return self._elementwise("sqrt", x)
        if exponent not in (2, 3, 4):
            raise Untraceable(f"power of {exponent}")
        square = self._elementwise("mul", x, x)
        return {2: lambda: square, 3: lambda: self._elementwise("mul", square, x)}.get(
            int(exponent), lambda: self._elementwise("mul", square, square)
        )()

    def _converted(self, x: Tensor, dtype: torch.dtype | None) -> Tensor:
        """Numbers as another kind of number; what is whole stays whole, and nothing here rounds."""
        if dtype == torch.bool:
            return self._elementwise("ne", x, 0.0)
        flat = [self.program.number(value) for value in x.reshape(-1).tolist()]
        return x if dtype is None else torch.tensor(flat, dtype=torch.int64).view(x.shape)

    def _constant(self, x: Any) -> Any:
        if not isinstance(x, Tensor):
            raise Untraceable(f"a result that is no tensor: {x!r}")
        enter = self.program.truth if x.dtype == torch.bool else self.program.constant
        return torch.tensor([enter(v) for v in x.reshape(-1).tolist()], dtype=torch.int64).view(x.shape)

    def _number(self, places: Tensor) -> Tensor:
        """The constants that stand at `places`."""
        found = [self.program.operations[value] for value in places.reshape(-1).tolist()]
        if any(name not in ("constant", "truth") for name, *_ in found):
            raise Untraceable("an operation that has to know numbers which differ from episode to episode")
        numbers = torch.tensor([number for _, number in found]).view(places.shape)
        whole = numbers.is_floating_point() and bool((numbers == numbers.round()).all())
        return numbers.long() if whole else numbers
