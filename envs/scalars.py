"""Functions of numbers as straight-line programs: built operation by operation, differentiated, written as C++.

A program computes the same expression for every episode; a number in it stands for a vector register of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

FLOAT = {
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
    "abs": "magnitude({0})",
    "sqrt": "root({0})",
    "exp": "exponential({0})",
    "expm1": "exponential({0}) - 1.0f",
    "sin": "sine({0})",
    "cos": "cosine({0})",
    "max": "larger({0}, {1})",
    "min": "smaller({0}, {1})",
    "where": "pick({0}, {1}, {2})",
}
"""Operations that give a number, in C++ (`envs/cpp/vector.h`)."""

MASK = {
    "lt": "(ivec)({0} < {1})",
    "le": "(ivec)({0} <= {1})",
    "gt": "(ivec)({0} > {1})",
    "ge": "(ivec)({0} >= {1})",
    "eq": "(ivec)({0} == {1})",
    "ne": "(ivec)({0} != {1})",
    "and": "{0} & {1}",
    "or": "{0} | {1}",
    "not": "~{0}",
}
"""Operations that give a truth value, all bits set or none."""

Value = int
"""A number or truth value of a program: where it stands in it."""


@dataclass
class Program:
    """Operations in the order they are carried out; equal ones are carried out once."""

    operations: list[tuple[str, ...]] = field(default_factory=list)  # name, then arguments
    known: dict[tuple[object, ...], Value] = field(default_factory=dict)

    def constant(self, number: float) -> Value:
        """A number that is the same for all episodes."""
        return self._enter(("constant", float(number)))

    def truth(self, true: bool) -> Value:
        """A truth value that is the same for all episodes."""
        return self._enter(("truth", bool(true)))

    def input(self, name: str, number: int) -> Value:
        """The `number`-th number of what the program is given under a name."""
        return self._enter(("input", name, number))

    def is_mask(self, value: Value) -> bool:
        """Whether it is a truth value."""
        return self.operations[value][0] in MASK or self.operations[value][0] == "truth"

    def apply(self, name: str, *arguments: Value) -> Value:
        """An operation of `FLOAT` or `MASK`; what adds nothing, multiplies by one or by zero is left out."""
        numbers = [self._number(argument) for argument in arguments]
        match name, numbers:
            case ("add" | "sub", [_, 0.0]) | ("mul" | "div", [_, 1.0]):
                return arguments[0]
            case ("add", [0.0, _]) | ("mul", [1.0, _]):
                return arguments[1]
            case ("sub", [0.0, _]):
                return self.apply("neg", arguments[1])
            case ("mul", [0.0, _]) | ("mul", [_, 0.0]) | ("div", [0.0, _]):
                return self.constant(0.0)
            case ("add" | "sub" | "mul" | "neg", [*known]) if None not in known:
                return self.constant(_fold(name, [x for x in known if x is not None]))
        if name == "where" and arguments[1] == arguments[2]:
            return arguments[1]
        return self._enter((name, *arguments))

    def gradient(self, outputs: Sequence[tuple[Value, Value]], inputs: Sequence[Value]) -> list[Value]:
        """What each of `inputs` changes, given `outputs` and what each of them changes."""
        slopes: dict[Value, Value] = {}

        def add(value: Value, slope: Value) -> None:
            slopes[value] = self.apply("add", slopes[value], slope) if value in slopes else slope

        for value, slope in outputs:
            add(value, slope)
        for value in range(max((value for value, _ in outputs), default=-1), -1, -1):
            if value in slopes:
                for argument, slope in self._partials(value, slopes[value]):
                    add(argument, slope)
        return [slopes.get(value, self.constant(0.0)) for value in inputs]

    def _partials(self, value: Value, g: Value) -> list[tuple[Value, Value]]:
        """Arguments of an operation, and what they change where its value changes `g`."""
        name, *a = self.operations[value]
        do, zero = self.apply, self.constant(0.0)
        match name:
            case "add":
                return [(a[0], g), (a[1], g)]
            case "sub":
                return [(a[0], g), (a[1], do("neg", g))]
            case "mul" if a[0] == a[1]:
                return [(a[0], do("mul", g, do("add", a[0], a[0])))]
            case "mul":
                return [(a[0], do("mul", g, a[1])), (a[1], do("mul", g, a[0]))]
            case "div":
                over = do("div", g, a[1])
                return [(a[0], over), (a[1], do("neg", do("mul", over, value)))]
            case "neg":
                return [(a[0], do("neg", g))]
            case "abs":
                return [
                    (a[0], do("where", do("lt", a[0], zero), do("neg", g), do("where", do("gt", a[0], zero), g, zero)))
                ]
            case "sqrt":
                return [(a[0], do("div", do("mul", g, self.constant(0.5)), value))]
            case "exp":
                return [(a[0], do("mul", g, value))]
            case "expm1":
                return [(a[0], do("mul", g, do("add", value, self.constant(1.0))))]
            case "sin":
                return [(a[0], do("mul", g, do("cos", a[0])))]
            case "cos":
                return [(a[0], do("neg", do("mul", g, do("sin", a[0]))))]
            case "max" | "min":  # the second argument of `max`, the limit of a clamp, has no say in a tie
                first = do("ge" if name == "max" else "le", a[0], a[1])
                return [(a[0], do("where", first, g, zero)), (a[1], do("where", first, zero, g))]
            case "where":
                return [(a[1], do("where", a[0], g, zero)), (a[2], do("where", a[0], zero, g))]
        return []

    def _enter(self, operation: tuple[object, ...]) -> Value:
        key = (*operation[:-1], repr(operation[-1])) if operation[0] == "constant" else operation  # nan, and -0.0
        if key not in self.known:
            self.known[key] = len(self.operations)
            self.operations.append(operation)  # type: ignore[arg-type]
        return self.known[key]

    def _number(self, value: Value) -> float | None:
        name, *rest = self.operations[value]
        return rest[0] if name == "constant" else None  # type: ignore[return-value]

    def number(self, value: Value) -> Value:
        """A truth value as 1 or 0, a number as it is."""
        if not self.is_mask(value):
            return value
        return self.apply("where", value, self.constant(1.0), self.constant(0.0))

    def needed(self, outputs: Sequence[Value]) -> set[Value]:
        """Everything that outputs follow from, themselves included."""
        needed = set(outputs)
        for value in range(max(needed, default=-1), -1, -1):
            name, *arguments = self.operations[value]
            if value in needed and (name in FLOAT or name in MASK):
                needed.update(arguments)  # type: ignore[arg-type]
        return needed

    def source(self, outputs: Sequence[Value]) -> str:
        """C++ statements that end in `out[k] = ` the k-th output; inputs are read from arrays of their names."""
        lines = [self._statement(value) for value in sorted(self.needed(outputs))]
        return "\n".join([*filter(None, lines), *(f"    out[{k}] = {self._text(v)};" for k, v in enumerate(outputs))])

    def _statement(self, value: Value) -> str:
        name, *arguments = self.operations[value]
        kind, forms = ("ivec", MASK) if name in MASK else ("vec", FLOAT)
        if name not in forms:
            return ""
        return f"    const {kind} t{value} = {forms[name].format(*(self._text(a) for a in arguments))};"  # type: ignore[arg-type]

    def _text(self, value: Value) -> str:
        name, *rest = self.operations[value]
        match name:
            case "constant":
                return f"all({_literal(rest[0])})"  # type: ignore[arg-type]
            case "truth":
                return f"truth({int(rest[0])})"
            case "input":
                return f"{rest[0]}[{rest[1]}]"
        return f"t{value}"


def _fold(name: str, known: list[float]) -> float:
    match name, known:
        case "add", [a, b]:
            return a + b
        case "sub", [a, b]:
            return a - b
        case "mul", [a, b]:
            return a * b
    return -known[0]


def _literal(number: float) -> str:
    if math.isnan(number):
        return "NAN"
    if math.isinf(number):
        return "INFINITY" if number > 0 else "-INFINITY"
    return f"{number!r}f" if "." in repr(number) or "e" in repr(number) else f"{number!r}.0f"
