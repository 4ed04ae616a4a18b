"""Traced scalars: numbers that record the operations done with them, on a tape.

A tape is straight-line code in static single assignment: constants are folded, equal operations are recorded
once, and branches on values are refused. All operations are exact or correctly rounded by IEEE 754 (+, -, *,
/, sqrt), so that every emitter that keeps to it gives the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple, TypeAlias

from numpy.lib.mixins import NDArrayOperatorsMixin

from coop_pin.errors import TracingError

Number: TypeAlias = "Traced | float"
"""A traced scalar, or a constant."""

Operand: TypeAlias = int | float
"""Of an operation: the index of an earlier one (int), or a constant (float)."""

FOLD: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": abs,
    "sqrt": math.sqrt,
    "less": lambda a, b: float(a < b),
    "select": lambda mask, a, b: a if mask else b,
    "power_of_two": lambda n: math.ldexp(1.0, int(n)),
}
"""The operations, on floats. Masks are 0.0 or 1.0; power_of_two takes whole numbers from -1022 to 1023."""

COMMUTATIVE = {"add", "mul"}


class Operation(NamedTuple):
    """One operation of a tape.

    Attributes:
        name: of FOLD; or "input" (operand: its index), "call" (operands: arguments), "result" (operands: the
            call, the index of the result).
        operands: indices of earlier operations, and constants.
        function: what a call calls.
    """

    name: str
    operands: tuple[Operand, ...]
    function: Function | None = None


class Function:
    """Traced code with inputs and outputs that others call: emitted once, however often it is called.

    Attributes:
        name: in emitted code.
        tape: its operations.
        outputs: its results, numbers of the tape and constants.
    """

    def __init__(self, name: str, tape: Tape, outputs: Sequence[Number]) -> None:
        self.name, self.tape, self.outputs = name, tape, list(outputs)

    def __call__(self, tape: Tape, arguments: Sequence[Number]) -> list[Number]:
        """Record a call, and return its results; constant ones are constants."""
        operands = tuple(tape.operand(argument) for argument in arguments)
        call = tape.record(Operation("call", operands, self))
        return [
            Traced(tape, tape.record(Operation("result", (call, index))))
            if isinstance(output, Traced)
            else output
            for index, output in enumerate(self.outputs)
        ]


class Tape:
    """Operations in the order in which they were recorded.

    Attributes:
        operations: the code.
        inputs: number of inputs.
        guards: conditions, as masks, that hold for every valid run.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self.inputs = 0
        self.guards: list[Number] = []
        self._known: dict[Hashable, int] = {}

    def input(self) -> Traced:
        """Return a new input."""
        self.inputs += 1
        return Traced(self, self.record(Operation("input", (self.inputs - 1,))))

    def record(self, operation: Operation) -> int:
        """Return the index of an operation, which is recorded unless an equal one was."""
        key = (operation.name, operation.function, *map(_key, operation.operands))
        if key not in self._known:
            self._known[key] = len(self.operations)
            self.operations.append(operation)
        return self._known[key]

    def operand(self, number: Number) -> Operand:
        """Return a number as an operand.

        Raises:
            TracingError: it belongs to another tape, or is no number.
        """
        if isinstance(number, Traced):
            if number.tape is not self:
                raise TracingError("mixes traced scalars of two tapes; trace one law at a time")
            return number.index
        return _constant(number)

    def apply(self, name: str, *numbers: Number) -> Number:
        """Return the result of an operation of FOLD, simplified where the bits stay the same."""
        operands = tuple(self.operand(number) for number in numbers)
        constants = [operand for operand in operands if isinstance(operand, float)]
        if len(constants) == len(operands):
            return FOLD[name](*constants)
        shorter = self._simpler(name, operands)
        if shorter is not None:
            return shorter
        if name in COMMUTATIVE:
            operands = tuple(sorted(operands, key=lambda operand: (isinstance(operand, float), operand)))
        return Traced(self, self.record(Operation(name, operands)))

    def _simpler(self, name: str, operands: tuple[Operand, ...]) -> Number | None:
        """Return an equal number that needs no operation or a cheaper one, None if there is none.

        ``0 x`` is 0, also for x = inf and NaN: a run that diverged is refused anyway. Patterns name float or
        int because an index may equal a constant.
        """
        match name, operands:
            case (
                ("add" | "sub", (x, float(0.0)))
                | ("add", (float(0.0), x))
                | ("mul", (x, float(1.0)) | (float(1.0), x))
                | ("select", (int(x), float(1.0), float(0.0)))
            ):
                return self.number(x)
            case ("mul", (_, float(0.0))) | ("mul" | "div", (float(0.0), _)):
                return 0.0
            case ("sub", (float(0.0), x)) | ("mul", (x, float(-1.0)) | (float(-1.0), x)):
                return -self.number(x)
            case "div", (x, float(b)) if abs(math.frexp(b)[0]) == 0.5:  # a power of two: the same bits
                return self.apply("mul", self.number(x), 1.0 / b)
            case "neg", (int(x),) if self.operations[x].name == "neg":
                return self.number(self.operations[x].operands[0])
            case "add", (x, int(y)) if self.operations[y].name == "neg":
                return self.number(x) - self.number(self.operations[y].operands[0])
            case "add", (int(y), x) if self.operations[y].name == "neg":
                return self.number(x) - self.number(self.operations[y].operands[0])
            case "sub", (x, int(y)) if self.operations[y].name == "neg":
                return self.number(x) + self.number(self.operations[y].operands[0])
            case "mul", ((int(y), float(c)) | (float(c), int(y))) if self.operations[y].name == "neg":
                return self.number(self.operations[y].operands[0]) * -c
            case "sub" | "less", (int(a), int(b)) if a == b:
                return 0.0
            case ("less", (float(math.inf), _)):
                return 0.0
            case "select", (float(mask), a, b):
                return self.number(a if mask else b)
            case "select", (_, a, b) if type(a) is type(b) and _key(a) == _key(b):
                return self.number(a)
        return None

    def number(self, operand: Operand) -> Number:
        """Return an operand as a number."""
        return operand if isinstance(operand, float) else Traced(self, operand)

    def live(self, outputs: Sequence[Number]) -> list[int]:
        """Return the indices of the operations that outputs need, in order."""
        found: set[int] = set()
        waiting = [output.index for output in outputs if isinstance(output, Traced)]
        while waiting:
            index = waiting.pop()
            if index in found:
                continue
            found.add(index)
            name, operands, _ = self.operations[index]
            if name == "result":
                operands = operands[:1]
            waiting += [operand for operand in operands if isinstance(operand, int) and name != "input"]
        return sorted(found)


def _key(operand: Operand) -> Hashable:
    """Return a key that tells constants from indices and -0.0 from 0.0."""
    return operand if isinstance(operand, int) else (operand, math.copysign(1.0, operand))


def _constant(number: Any) -> float:
    try:
        return float(number)
    except (TypeError, ValueError):
        raise TracingError(f"computes with {type(number).__name__} {number!r}; it must be a number") from None


# ---------------------------------------------------------------- scalars


NUMPY: dict[str, Callable[..., Any]] = {}
"""What answers numpy for traced scalars: "ufunc" and "function" of traced_array, which needs this module."""


class Traced(NDArrayOperatorsMixin):
    """A traced scalar: the result of an operation of a tape.

    Python's operators call numpy's ufuncs, which record operations: see traced_array. What a branch would
    need, its truth or its float, is refused.
    """

    __slots__ = ("index", "tape")
    __hash__ = object.__hash__

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape, self.index = tape, index

    def __bool__(self) -> bool:
        raise TracingError("branches on a value; choose with where(condition, a, b) instead")

    def __float__(self) -> float:
        raise TracingError(
            "turns a value into a plain float, which Pinocchio, scipy and math need;"
            " use numpy's functions or coop_pin.spatial.scalars"
        )

    __int__ = __index__ = __complex__ = __float__

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return NUMPY["ufunc"](ufunc, method, inputs, options)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return NUMPY["function"](func, args, kwargs)

    def require_less(self, limit: Number) -> None:
        """Note that every valid run has this scalar less than a limit."""
        self.tape.guards.append(self < limit)
