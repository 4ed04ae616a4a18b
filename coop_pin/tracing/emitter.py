"""Emitters: the text of traced code in a language, one line for each operation that its outputs need."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence

from coop_pin.tracing.tape import Function, Number, Operand, Tape, Traced


class Emitter(ABC):
    """Writes functions and what they call, each once and before its callers.

    Attributes:
        parts: text of each function, in order.
    """

    def __init__(self) -> None:
        self.parts: list[str] = []
        self._known: set[Function] = set()

    def function(self, function: Function) -> None:
        """Add a function of input and output arrays, unless it is there."""
        if function not in self._known:
            self._known.add(function)
            self._function(function)

    def body(self, tape: Tape, outputs: Sequence[Number], read: Callable[[int, int], str]) -> Iterator[str]:
        """Return the lines that compute outputs of a tape, and add the functions that they call.

        Args:
            tape: the code.
            outputs: numbers of it.
            read: the line of an operation, by its index, that reads the input at a position.
        """
        for index in tape.live(outputs):
            name, operands, called = tape.operations[index]
            if name == "input":
                yield read(index, int(operands[0]))
            elif name == "result":
                yield self._result(index, int(operands[0]), int(operands[1]))
            elif called is not None:
                self.function(called)
                yield from self._call(index, called, [self._operand(operand) for operand in operands])
            else:
                yield from self._operation(index, name, [self._operand(operand) for operand in operands])

    def value(self, number: Number) -> str:
        """Return a number of the body as it is written in an expression."""
        return self._operand(number.index if isinstance(number, Traced) else float(number))

    @abstractmethod
    def _function(self, function: Function) -> None:
        """Add a function."""

    @abstractmethod
    def _operand(self, operand: Operand) -> str:
        """Return an operand as it is written in an expression."""

    @abstractmethod
    def _call(self, index: int, function: Function, arguments: Sequence[str]) -> Iterator[str]:
        """Return the lines that call a function."""

    @abstractmethod
    def _result(self, index: int, call: int, position: int) -> str:
        """Return the line that reads a result of a call."""

    @abstractmethod
    def _operation(self, index: int, name: str, operands: Sequence[str]) -> Iterator[str]:
        """Return the lines of an operation of FOLD."""
