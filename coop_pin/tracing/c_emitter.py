"""Traced code as C99: straight-line functions of doubles, without loops, branches or allocation.

Each operation is one statement, so that a compiler that does not contract them (``-std=c99``, or
``-ffp-contract=off``) gives the bits of the numpy oracle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from .emitter import Emitter
from .tape import Operand, Subroutine, Tape

_EXPRESSIONS = {
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
    "abs": "fabs({0})",
    "sqrt": "sqrt({0})",
    "less": "{0} < {1} ? 1.0 : 0.0",
    "less_equal": "{0} <= {1} ? 1.0 : 0.0",
    "select": "{0} != 0.0 ? {1} : {2}",
    "power_of_two": "power_of_two({0})",
}

_POWER_OF_TWO = """/* 2^n for a whole number n; NaN for one that is no exponent of a double. */
static double power_of_two(double n)
{
    return n >= -1022.0 && n <= 1023.0 ? ldexp(1.0, (int)n) : NAN;
}
"""


def c_number(value: float) -> str:
    """Return a constant of C with exactly this value."""
    if math.isnan(value):
        return "NAN"
    text = "INFINITY" if math.isinf(value) else abs(value).hex()
    return f"(-{text})" if math.copysign(1.0, value) < 0.0 else text


class CEmitter(Emitter):
    """Writer of functions; subroutines are ``static void (const double *x, double *y)``."""

    def __init__(self) -> None:
        super().__init__({name: [f"const double v{{i}} = {text};"] for name, text in _EXPRESSIONS.items()})

    def text(self) -> str:
        """Return the file of all definitions so far."""
        helpers = [_POWER_OF_TWO] if any("power_of_two(" in part for part in self.parts) else []
        return "\n".join(["#include <math.h>\n", *helpers, *self.parts])

    def define(
        self,
        head: str,
        tape: Tape,
        stores: Sequence[tuple[str, Operand]],
        read: Callable[[int], str],
        first: str = "",
        last: str = "",
    ) -> None:
        """Add the definition of a function, after those that it calls.

        Args:
            head: Type, name and arguments.
            tape: Code.
            stores: Expressions on the left of assignments, and operands that are assigned.
            read: Function that returns the expression of the input at a position.
            first: Statements before the code.
            last: Statements after it.
        """
        outputs = [operand for _, operand in stores]
        code = self.body(tape, outputs, lambda index, at: f"const double v{index} = {read(at)};")
        lines = [first, *code, *(f"{left} = {self.operand(operand)};" for left, operand in stores), last]
        self.parts.append("\n".join([head, "{", *(f"    {line}" for line in lines if line), "}\n"]))

    def operand(self, operand: Operand) -> str:
        """Return an operand as it is written in an expression."""
        return f"v{operand}" if isinstance(operand, int) else c_number(operand)

    def _define_subroutine(self, subroutine: Subroutine) -> None:
        head = f"static void {subroutine.name}(const double *x, double *y)"
        stores = [(f"y[{index}]", operand) for index, operand in enumerate(subroutine.outputs)]
        self.define(head, subroutine.tape, stores, "x[{}]".format)

    def _call(self, index: int, subroutine: Subroutine, arguments: Sequence[str]) -> Iterator[str]:
        yield f"const double x{index}[] = {{{', '.join(arguments)}}};"
        yield f"double y{index}[{len(subroutine.outputs)}];"
        yield f"{subroutine.name}(x{index}, y{index});"

    def _result(self, index: int, call: int, position: int) -> str:
        return f"const double v{index} = y{call}[{position}];"
