"""Traced scalars: numbers that record the operations done with them, on a tape.

A tape is straight-line code in static single assignment: constants are folded, equal operations are recorded
once, and branches on values are refused. All operations are exact or correctly rounded by IEEE 754 (+, -, *,
/, sqrt), so that every emitter that keeps to it gives the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

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
        self._known: dict[Operation, int] = {}

    def input(self) -> Traced:
        """Return a new input."""
        self.inputs += 1
        return Traced(self, self.record(Operation("input", (self.inputs - 1,))))

    def record(self, operation: Operation) -> int:
        """Return the index of an operation, which is recorded unless an equal one was."""
        # -0.0 and 0.0 are equal keys, and 1 and 1.0, but indices and constants do not mix up: see _key.
        key = operation._replace(operands=tuple(_key(operand) for operand in operation.operands))
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
        simple = _SIMPLER.get(name)
        shorter = simple(self, *operands) if simple else None
        if shorter is not None:
            return shorter
        if name in COMMUTATIVE:
            operands = tuple(sorted(operands, key=lambda operand: (isinstance(operand, float), operand)))
        return Traced(self, self.record(Operation(name, operands)))

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


def _key(operand: Operand) -> Any:
    return operand if isinstance(operand, int) else (operand, math.copysign(1.0, operand))


def _constant(number: Any) -> float:
    try:
        return float(number)
    except (TypeError, ValueError):
        raise TracingError(f"computes with {type(number).__name__} {number!r}; it must be a number") from None


# ---------------------------------------------------------------- simplification

Simpler: TypeAlias = "Number | None"


def _simpler_sum(tape: Tape, a: Operand, b: Operand) -> Simpler:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, float) and x == 0.0:
            return tape.number(y)
        if (negated := _negated(tape, y)) is not None:
            return tape.apply("sub", tape.number(x), tape.number(negated))
    return None


def _simpler_difference(tape: Tape, a: Operand, b: Operand) -> Simpler:
    if isinstance(b, float) and b == 0.0:
        return tape.number(a)
    if isinstance(a, float) and a == 0.0:
        return -tape.number(b)
    if a is b or (isinstance(a, int) and a == b and isinstance(b, int)):
        return 0.0
    if (negated := _negated(tape, b)) is not None:
        return tape.number(a) + tape.number(negated)
    return None


def _simpler_product(tape: Tape, a: Operand, b: Operand) -> Simpler:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, float):
            if x == 0.0:
                return 0.0  # a diverged run is refused anyway, so that 0 * inf does not matter
            if abs(x) == 1.0:
                return tape.number(y) if x > 0.0 else -tape.number(y)
            if (negated := _negated(tape, y)) is not None:
                return tape.apply("mul", -x, tape.number(negated))
    na, nb = _negated(tape, a), _negated(tape, b)
    if na is not None and nb is not None:
        return tape.apply("mul", tape.number(na), tape.number(nb))
    return None


def _simpler_quotient(tape: Tape, a: Operand, b: Operand) -> Simpler:
    if isinstance(a, float) and a == 0.0:
        return 0.0
    if isinstance(b, float) and math.frexp(b)[0] in (0.5, -0.5):  # a power of two: the same bits
        return tape.apply("mul", tape.number(a), 1.0 / b)
    return None


def _simpler_negative(tape: Tape, a: Operand) -> Simpler:
    negated = _negated(tape, a)
    return None if negated is None else tape.number(negated)


def _simpler_comparison(tape: Tape, a: Operand, b: Operand) -> Simpler:  # noqa: ARG001  all have this form
    if isinstance(a, float) or isinstance(b, float):
        return (
            0.0
            if (isinstance(a, float) and a == math.inf) or (isinstance(b, float) and b == -math.inf)
            else None
        )
    return 0.0 if a == b else None


def _simpler_choice(tape: Tape, mask: Operand, a: Operand, b: Operand) -> Simpler:
    if isinstance(mask, float):
        return tape.number(a if mask else b)
    if type(a) is type(b) and _key(a) == _key(b):
        return tape.number(a)
    return (
        tape.number(mask) if (a, b) == (1.0, 0.0) and isinstance(a, float) and isinstance(b, float) else None
    )


def _negated(tape: Tape, operand: Operand) -> Operand | None:
    """Return x of an operand -x, None for others."""
    if isinstance(operand, float) or tape.operations[operand].name != "neg":
        return None
    return tape.operations[operand].operands[0]


_SIMPLER: dict[str, Callable[..., Simpler]] = {
    "add": _simpler_sum,
    "sub": _simpler_difference,
    "mul": _simpler_product,
    "div": _simpler_quotient,
    "neg": _simpler_negative,
    "less": _simpler_comparison,
    "select": _simpler_choice,
}


# ---------------------------------------------------------------- scalars


class Traced:
    """A traced scalar: the result of an operation of a tape.

    Python's operators record operations. What a branch would need, its truth or its float, is refused.
    """

    __slots__ = ("index", "tape")
    __hash__ = object.__hash__

    def __init__(self, tape: Tape, index: int) -> None:
        self.tape, self.index = tape, index

    def __bool__(self) -> bool:
        raise TracingError("branches on a value; choose with where(condition, a, b) instead")

    def __float__(self) -> float:
        raise TracingError(
            "turns a value into a plain float; use numpy's functions or coop_pin.spatial.scalars"
        )

    __int__ = __index__ = __complex__ = __float__

    def require_less(self, limit: Number) -> None:
        """Note that every valid run has this scalar less than a limit."""
        self.tape.guards.append(self < limit)

    def __neg__(self) -> Number:
        return self.tape.apply("neg", self)

    def __abs__(self) -> Number:
        return self.tape.apply("abs", self)

    def __add__(self, other: Any) -> Any:
        return self._apply("add", self, other, other)

    def __radd__(self, other: Any) -> Any:
        return self._apply("add", other, self, other)

    def __sub__(self, other: Any) -> Any:
        return self._apply("sub", self, other, other)

    def __rsub__(self, other: Any) -> Any:
        return self._apply("sub", other, self, other)

    def __mul__(self, other: Any) -> Any:
        return self._apply("mul", self, other, other)

    def __rmul__(self, other: Any) -> Any:
        return self._apply("mul", other, self, other)

    def __truediv__(self, other: Any) -> Any:
        return self._apply("div", self, other, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._apply("div", other, self, other)

    def __pow__(self, exponent: float) -> Any:
        if exponent == 2:
            return self * self
        if exponent in (0.5, 0.25):
            root = self.tape.apply("sqrt", self)
            return root if exponent == 0.5 else root**0.5
        raise TracingError(f"raises to the power {exponent!r}; 2, 1/2 and 1/4 can be traced")

    def __lt__(self, other: Any) -> Any:
        return self._apply("less", self, other, other)

    def __gt__(self, other: Any) -> Any:
        return self._apply("less", other, self, other)

    def __le__(self, other: Any) -> Any:
        return 1.0 - (self > other)

    def __ge__(self, other: Any) -> Any:
        return 1.0 - (self < other)

    def __ne__(self, other: object) -> Any:
        return (self < other) + (self > other)

    def __eq__(self, other: object) -> Any:
        return 1.0 - (self != other)

    def __invert__(self) -> Number:
        return 1.0 - self

    def _apply(self, name: str, a: Any, b: Any, other: Any) -> Any:
        """Return the result of an operation with another number; arrays answer for their entries."""
        return NotImplemented if getattr(other, "shape", ()) else self.tape.apply(name, a, b)
