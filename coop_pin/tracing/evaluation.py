"""Evaluation of traced code by numpy, one operation at a time, on numbers or on arrays of lanes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .tape import Operand, Tape

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "less": lambda a, b: np.less(a, b) * 1.0,
    "less_equal": lambda a, b: np.less_equal(a, b) * 1.0,
    "select": lambda mask, a, b: np.where(np.not_equal(mask, 0.0), a, b),
    "power_of_two": lambda n: np.ldexp(1.0, np.asarray(n).astype(np.int64)),
}


def evaluate(tape: Tape, outputs: Sequence[Operand], inputs: Sequence[Any]) -> list[Any]:
    """Return the values of outputs of a tape; calls are evaluated likewise.

    Args:
        tape: Code.
        outputs: Operands of it.
        inputs: Value of each of its inputs, number or array of lanes.
    """
    values: dict[int, Any] = {}

    def value(operand: Operand) -> Any:
        return values[operand] if isinstance(operand, int) else operand

    for index in tape.live(outputs):
        name, operands, subroutine = tape.operations[index]
        if name == "input":
            values[index] = inputs[int(operands[0])]
        elif name == "result":
            values[index] = values[int(operands[0])][int(operands[1])]
        elif subroutine is not None:
            values[index] = evaluate(subroutine.tape, subroutine.outputs, list(map(value, operands)))
        else:
            values[index] = _OPERATIONS[name](*map(value, operands))
    return list(map(value, outputs))
