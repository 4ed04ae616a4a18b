"""Emitters: the text of traced code in a language, one line for each operation that its outputs need."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence

from .tape import Operand, Subroutine, Tape


class Emitter(ABC):
    """Writer of code: each subroutine is defined once and before its callers.

    Attributes:
        parts: Text of each definition, in order.
    """

    def __init__(self, lines: Mapping[str, Sequence[str]], **words: object) -> None:
        """Begin without definitions.

        Args:
            lines: Lines of each operation of FOLD, with {i} for its index and {0}, {1}, {2} for its operands.
            words: Values of the other words in braces.
        """
        self.parts: list[str] = []
        self._lines, self._words = lines, words
        self._emitted: set[Subroutine] = set()

    def body(self, tape: Tape, outputs: Sequence[Operand], read: Callable[[int, int], str]) -> Iterator[str]:
        """Yield the lines that compute outputs of a tape, and define the subroutines that they call.

        Args:
            tape: Code.
            outputs: Operands of it.
            read: Function of the index of an operation and the position of an input; returns the line that
                reads it.
        """
        for index in tape.live(outputs):
            name, operands, subroutine = tape.operations[index]
            if name == "input":
                yield read(index, int(operands[0]))
            elif name == "result":
                yield self._result(index, int(operands[0]), int(operands[1]))
            elif subroutine is not None:
                if subroutine not in self._emitted:
                    self._emitted.add(subroutine)
                    self._define_subroutine(subroutine)
                yield from self._call(index, subroutine, list(map(self.operand, operands)))
            else:
                texts = list(map(self.operand, operands))
                for line in self._lines[name]:
                    yield line.format(*texts, i=index, **self._words)

    @abstractmethod
    def operand(self, operand: Operand) -> str:
        """Return an operand as it is written in an expression."""

    @abstractmethod
    def _define_subroutine(self, subroutine: Subroutine) -> None:
        """Add the definition of a subroutine."""

    @abstractmethod
    def _call(self, index: int, subroutine: Subroutine, arguments: Sequence[str]) -> Iterator[str]:
        """Yield the lines that call a subroutine."""

    @abstractmethod
    def _result(self, index: int, call: int, position: int) -> str:
        """Return the line that reads a result of a call."""
