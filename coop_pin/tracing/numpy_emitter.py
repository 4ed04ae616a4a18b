"""Traced code run by numpy, one operation at a time on all lanes: the oracle of the compiled code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from coop_pin.tracing.tape import Number, Tape, Traced

Lanes: TypeAlias = NDArray[np.float64]

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "less": lambda a, b: np.less(a, b) * 1.0,
    "select": lambda mask, a, b: np.where(np.not_equal(mask, 0.0), a, b),
    "power_of_two": lambda n: np.ldexp(1.0, np.asarray(n).astype(np.int64)),
}


def evaluate(tape: Tape, outputs: Sequence[Number], inputs: Sequence[Any]) -> list[Any]:
    """Return the values of outputs of a tape; calls are evaluated likewise.

    Args:
        tape: the code.
        outputs: numbers of it.
        inputs: value of each of its inputs, numbers or arrays of lanes.
    """
    values: dict[int, Any] = {}
    for index in tape.live(outputs):
        name, operands, function = tape.operations[index]
        if name == "input":
            values[index] = inputs[int(operands[0])]
        elif name == "result":
            values[index] = values[int(operands[0])][int(operands[1])]
        else:
            given = [values[operand] if isinstance(operand, int) else operand for operand in operands]
            if function is not None:
                values[index] = evaluate(function.tape, function.outputs, given)
            else:
                values[index] = _OPERATIONS[name](*given)
    return [values[output.index] if isinstance(output, Traced) else output for output in outputs]
