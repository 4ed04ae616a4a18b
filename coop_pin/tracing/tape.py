"""Tape: straight-line code in static single assignment, and traced scalars, which record on it.

Constants are folded, and equal operations are recorded once. All operations are exact or correctly rounded by
IEEE 754 (+, -, *, /, sqrt), so that every emitter that keeps to it gives the same bits.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import NamedTuple, NoReturn, TypeAlias

from numpy.lib.mixins import NDArrayOperatorsMixin

Number: TypeAlias = "Traced | float"
"""Traced scalar, or constant."""

Operand: TypeAlias = int | float
"""Operand of an operation: the index of an earlier one (int), or a constant (float)."""

FOLD: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": abs,
    "sqrt": math.sqrt,
    "less": lambda a, b: float(a < b),
    "less_equal": lambda a, b: float(a <= b),
    "select": lambda mask, a, b: a if mask else b,
    "power_of_two": lambda n: math.ldexp(1.0, int(n)),
}
"""The operations, on floats. Masks are 0.0 or 1.0; power_of_two takes whole numbers from -1022 to 1023."""

COMMUTATIVE = {"add", "mul"}


class UntraceableError(Exception):
    """What cannot be traced, such as a branch on a value; the message continues "the function ..."."""


class Operation(NamedTuple):
    """One operation of a tape.

    Attributes:
        name: Name in FOLD; or "input" (operand: its index), "call" (operands: arguments), "result" (operands:
            the call, the index of the result).
        operands: Indices of earlier operations, and constants.
        subroutine: Code that a call runs.
    """

    name: str
    operands: tuple[Operand, ...]
    subroutine: Subroutine | None = None


class Subroutine:
    """Code with inputs and outputs that other tapes call: emitted once, however often it is called.

    Attributes:
        name: Name in emitted code.
        tape: Operations.
        outputs: Results, operands of the tape.
    """

    def __init__(self, name: str, tape: Tape, outputs: Sequence[Operand]) -> None:
        self.name, self.tape, self.outputs = name, tape, outputs


class Tape:
    """Operations in the order in which they were recorded.

    Attributes:
        operations: Code.
        inputs: Number of inputs.
        guards: Conditions, as masks, that hold for every valid run.
        refusals: Errors of what cannot be traced, also of those that the traced code caught.
        is_exact: Whether NaN and inf pass through products and differences as in numpy. Otherwise ``0 x`` and
            ``x - x`` are 0: a run that diverged is refused anyway.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self.inputs = 0
        self.guards: list[Number] = []
        self.refusals: list[Exception] = []
        self.is_exact = False
        self._indices: dict[Hashable, int] = {}

    @contextlib.contextmanager
    def exact(self, is_exact: bool) -> Iterator[None]:
        """Record code with another ``is_exact``."""
        before, self.is_exact = self.is_exact, is_exact
        try:
            yield
        finally:
            self.is_exact = before

    def input(self) -> int:
        """Return the index of a new input."""
        self.inputs += 1
        return self._record(Operation("input", (self.inputs - 1,)))

    def call(self, subroutine: Subroutine, arguments: Sequence[Operand]) -> list[Operand]:
        """Record a call, and return its results; constant ones are constants."""
        call = self._record(Operation("call", tuple(arguments), subroutine))
        return [
            self._record(Operation("result", (call, index))) if isinstance(output, int) else output
            for index, output in enumerate(subroutine.outputs)
        ]

    def apply(self, name: str, *operands: Operand) -> Operand:
        """Return the result of an operation of FOLD, simplified where the bits stay the same."""
        constants = [operand for operand in operands if isinstance(operand, float)]
        if len(constants) == len(operands):
            return FOLD[name](*constants)
        shorter = self._simpler(name, operands)
        if shorter is not None:
            return shorter
        if name in COMMUTATIVE:
            operands = tuple(sorted(operands, key=lambda operand: (isinstance(operand, float), operand)))
        return self._record(Operation(name, operands))

    def live(self, outputs: Sequence[Operand]) -> list[int]:
        """Return the indices of the operations that outputs need, in order."""
        needed: set[int] = set()
        waiting = [output for output in outputs if isinstance(output, int)]
        while waiting:
            index = waiting.pop()
            if index in needed:
                continue
            needed.add(index)
            name, operands, _ = self.operations[index]
            if name == "result":
                operands = operands[:1]
            waiting += [operand for operand in operands if isinstance(operand, int) and name != "input"]
        return sorted(needed)

    def rounds_alike(self, outputs: Sequence[Operand]) -> bool:
        """Return whether the outputs have the bits that numpy gives, however its libraries order operations.

        They may fuse a product with a sum, add in another order, and invert in another way.
        """
        names = {index: self.operations[index].name for index in self.live(outputs)}
        sums = [self.operations[index].operands for index, name in names.items() if name in ("add", "sub")]
        terms = {names[term] for each in sums for term in each if isinstance(term, int)}
        plain = {"input", "neg", "mul", "div", "sqrt", "add", "sub"}
        return {*names.values()} <= plain and not terms & {"mul", "add", "sub"}

    def _record(self, operation: Operation) -> int:
        """Return the index of an operation, which is recorded unless an equal one was."""
        key = (operation.name, operation.subroutine, *map(_key, operation.operands))
        if key not in self._indices:
            self._indices[key] = len(self.operations)
            self.operations.append(operation)
        return self._indices[key]

    def _simpler(self, name: str, operands: tuple[Operand, ...]) -> Operand | None:
        """Return an equal operand that needs no operation or a cheaper one, None if there is none.

        Patterns name float or int because an index may equal a constant.
        """
        match name, operands:
            case "add" | "sub" | "mul" | "div", _ if any(x != x for x in operands):
                return math.nan
            case (
                ("add" | "sub", (x, float(0.0)))
                | ("add", (float(0.0), x))
                | ("mul", (x, float(1.0)) | (float(1.0), x))
                | ("select", (int(x), float(1.0), float(0.0)))
            ):
                return x
            case ("mul", (_, float(0.0))) | ("mul" | "div", (float(0.0), _)) if not self.is_exact:
                return 0.0
            case ("sub", (float(0.0), x)) | ("mul", (x, float(-1.0)) | (float(-1.0), x)):
                return self.apply("neg", x)
            case "div", (x, float(b)) if abs(math.frexp(b)[0]) == 0.5 and math.isfinite(1.0 / b):
                # a power of two: the same bits
                return self.apply("mul", x, 1.0 / b)
            case "neg", (int(x),) if self.operations[x].name == "neg":
                return self.operations[x].operands[0]
            case "add", (x, int(y)) if self.operations[y].name == "neg":
                return self.apply("sub", x, self.operations[y].operands[0])
            case "add", (int(y), x) if self.operations[y].name == "neg":
                return self.apply("sub", x, self.operations[y].operands[0])
            case "sub", (x, int(y)) if self.operations[y].name == "neg":
                return self.apply("add", x, self.operations[y].operands[0])
            case "mul", ((int(x), float(c)) | (float(c), int(x))) if self.operations[x].name == "neg":
                return self.apply("mul", self.operations[x].operands[0], -c)
            case "sub" | "less", (int(a), int(b)) if a == b and not (name == "sub" and self.is_exact):
                return 0.0
            case ("less", (float(math.inf), _)):
                return 0.0
            case "select", (float(mask), a, b):
                return a if mask else b
            case "select", (_, a, b) if type(a) is type(b) and _key(a) == _key(b):
                return a
        return None


def _key(operand: Operand) -> Hashable:
    """Return a key that tells constants from indices and -0.0 from 0.0."""
    return operand if isinstance(operand, int) else (operand, math.copysign(1.0, operand))


# ---------------------------------------------------------------- scalars


class Traced(NDArrayOperatorsMixin):
    """Traced scalar: the result of an operation of a tape.

    Python's operators call numpy's ufuncs, which traced_array.TracedScalar answers. What a branch would need,
    a truth value or a float, is refused.

    Attributes:
        tape: Tape of the operation.
        index: Index of the operation.
    """

    __slots__ = ("index", "tape")

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape, self.index = tape, index

    def __bool__(self) -> bool:
        self._refuse("branches on a value; choose with where(condition, a, b) instead")

    def __hash__(self) -> int:
        self._refuse("looks a value up in a set or a table; choose with where(condition, a, b) instead")

    def __float__(self) -> float:
        self._refuse(
            "turns a value into a plain float, which math and compiled libraries need; use numpy's functions"
        )

    __int__ = __index__ = __complex__ = __round__ = __trunc__ = __floor__ = __ceil__ = __float__

    def __getattr__(self, name: str) -> NoReturn:
        if not name.startswith("__"):  # numpy looks for those of its protocols
            self.tape.refusals.append(
                UntraceableError(f"asks a value for {name!r}, which a traced one lacks")
            )
        raise AttributeError(f"a traced value has no attribute {name!r}", name=name, obj=self)

    def _refuse(self, message: str) -> NoReturn:
        error = UntraceableError(message)
        self.tape.refusals.append(error)
        raise error

    def apply(self, name: str, *numbers: Number) -> Number:
        """Return the result of an operation of FOLD on the tape of this scalar."""
        result = self.tape.apply(name, *operands(self.tape, numbers))
        return result if isinstance(result, float) else type(self)(self.tape, result)

    def require_less(self, limit: Number) -> None:
        """Note that every valid run has this scalar less than a limit."""
        self.tape.guards.append(self < limit)


def apply(name: str, *numbers: Number) -> Number:
    """Return the result of an operation of FOLD, on the tape of the traced scalars among the numbers."""
    scalar = next((number for number in numbers if isinstance(number, Traced)), None)
    return FOLD[name](*numbers) if scalar is None else scalar.apply(name, *numbers)


def operands(tape: Tape, numbers: Iterable[Number]) -> list[Operand]:
    """Return numbers as operands of a tape.

    Raises:
        UntraceableError: One belongs to another tape, or is no number.
    """
    return [_operand(tape, number) for number in numbers]


def _operand(tape: Tape, number: Number) -> Operand:
    if isinstance(number, Traced):
        if number.tape is not tape:
            raise UntraceableError("mixes traced scalars of two tapes; trace one function at a time")
        return number.index
    try:
        return float(number)
    except (TypeError, ValueError):
        kind = type(number).__name__
        raise UntraceableError(f"computes with {kind} {number!r}; it must be a number") from None
