"""Kernels: traced code that reads and writes slots of a block of runs; programs of them, and machines.

A block holds many runs side by side, one lane each; a slot is one number of every lane. A program says which
kernels run in which order, and what is loaded into slots and recorded from them in between.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .tape import Operand, Tape, operands
from .traced_array import inputs
from .tree import leaves

Array: TypeAlias = NDArray[np.float64]
"""Array of floats."""


class Layout:
    """Slots of a block by names, each an array.

    Attributes:
        size: Number of slots.
    """

    def __init__(self) -> None:
        self.size = 0
        self._fields: dict[str, tuple[int, tuple[int, ...]]] = {}

    def add(self, **shapes: tuple[int, ...]) -> None:
        """Add fields of these names and shapes.

        Raises:
            ValueError: there is one of such a name.
        """
        for name, shape in shapes.items():
            if name in self._fields:
                raise ValueError(f"the block has a field {name!r} already; give this one another name")
            self._fields[name] = self.size, shape
            self.size += math.prod(shape)

    @property
    def names(self) -> list[str]:
        """Names of the fields."""
        return list(self._fields)

    def filled(self, name: str, numbers: int) -> list[int]:
        """Return the slots of a field in a row, for so many numbers.

        Raises:
            ValueError: the field has another size.
        """
        slots: list[int] = self.slots(name).ravel().tolist()
        if len(slots) != numbers:
            raise ValueError(
                f"field {name!r} of the block gets {numbers} numbers; it has the shape"
                f" {self._fields[name][1]} and takes {len(slots)}"
            )
        return slots

    def slots(self, name: str) -> NDArray[np.int64]:
        """Return the slots of a field, in its shape."""
        start, shape = self._fields[name]
        return start + np.arange(math.prod(shape)).reshape(shape)

    def views(self, block: Array) -> dict[str, Array]:
        """Return all fields of one run as views of its block, shape (size,)."""
        return {
            name: block[start : start + math.prod(shape)].reshape(shape)
            for name, (start, shape) in self._fields.items()
        }


class Kernel:
    """Code that reads slots and numbers common to all runs, and writes slots.

    Attributes:
        name: Name in emitted code.
        tape: Operations.
        reads: Source of each input of the tape: "lane" or "uniform", and the slot there.
        writes: Slot and operand of each output.
    """

    def __init__(self, name: str, lanes: Layout, uniforms: Layout) -> None:
        self.name, self.tape = name, Tape()
        self.reads: list[tuple[Literal["lane", "uniform"], int]] = []
        self.writes: list[tuple[int, Operand]] = []
        self._lanes, self._uniforms, self._fields = lanes, uniforms, dict[tuple[str, str], Any]()

    def on_same_tape(self, name: str) -> Kernel:
        """Return a kernel without writes on the same tape: what both need is traced once."""
        other = Kernel(name, self._lanes, self._uniforms)
        other.tape, other.reads, other._fields = self.tape, self.reads, self._fields
        return other

    def read(self, name: str) -> Any:
        """Return a field of the block."""
        return self._read("lane", name, self._lanes)

    def uniform(self, name: str) -> Any:
        """Return a field that all runs share."""
        return self._read("uniform", name, self._uniforms)

    def write(self, name: str, values: Any) -> None:
        """Write a field of the block, after all reads; raises as Layout.filled."""
        numbers = operands(self.tape, leaves(values))
        self.writes += zip(self._lanes.filled(name, len(numbers)), numbers, strict=True)

    def _read(self, space: Literal["lane", "uniform"], name: str, layout: Layout) -> Any:
        key = space, name
        if key not in self._fields:
            slots = layout.slots(name)
            self.reads += [(space, int(slot)) for slot in slots.ravel()]
            self._fields[key] = inputs(self.tape, *slots.shape)
        return self._fields[key]


LOAD, RECORD = -1, -2
"""Codes of instructions other than the indices of kernels."""

CACHE_LINE = 64
"""Bytes. A record begins with a line; whole lines of it are written past the caches, which are smaller."""


class Program(NamedTuple):
    """Kernels and the order of their calls.

    Attributes:
        kernels: Kernels by index.
        lanes: Slots of the block; the recorded ones are first, then those that are loaded.
        recorded: Number of slots that RECORD copies.
        loaded: Number of slots that LOAD fills.
        instructions: Instructions in order, shape (n, 2): index of a kernel to run, LOAD or RECORD, and a row
            of the uniforms, the loads or the record.
        text: LLVM's text of the kernels; they may then be left out.
        width: Number of lanes at once for which the text is.
    """

    kernels: Sequence[Kernel]
    lanes: Layout
    recorded: int
    loaded: int
    instructions: NDArray[np.int64] = np.zeros((0, 2), dtype=np.int64)
    text: str = ""
    width: int = 0

    def rows(self, code: int) -> int:
        """Return the number of rows that a kind of instruction needs."""
        return 1 + int(self.instructions[self.instructions[:, 0] == code, 1].max(initial=-1))


class Machine(ABC):
    """Machine that runs a program on blocks of runs.

    Attributes:
        program: Kernels and the order of their calls.
        width: Number of lanes that it advances at once.
    """

    def __init__(self, program: Program, width: int = 1) -> None:
        self.width = width
        self._take(program)

    def _take(self, program: Program) -> None:
        instructions = np.ascontiguousarray(program.instructions, dtype=np.int64)  # as compiled code reads
        self.program, self._rows = program._replace(instructions=instructions), program.rows(RECORD)

    def run(
        self,
        block: Array,
        uniforms: Array,
        loads: Array,
        out: Array | None = None,
        between: Callable[[], None] | None = None,
    ) -> Array:
        """Run the program.

        Args:
            block: Initial slots, changed in place, shape (slots, lanes).
            uniforms: Numbers that all runs share, shape (rows, uniforms).
            loads: Numbers that LOAD fills in, shape (rows, loaded, lanes).
            out: Memory of the record, which is overwritten, shape (n,) with n of at least record_size(lanes);
                new memory when omitted.
            between: Function that is called between parts of the program, and ends it by an error.

        Returns:
            The record, shape (rows, recorded, lanes): a view of ``out``.

        Raises:
            ValueError: ``out`` is too small, or no row of floats.
        """
        record = self.new_record(block.shape[1], out)
        self.execute(block, uniforms, loads, record, between or (lambda: None))
        return record[:, :, : block.shape[1]]

    @abstractmethod
    def execute(
        self, block: Array, uniforms: Array, loads: Array, record: Array, between: Callable[[], None]
    ) -> None:
        """Run the program with a record of whole registers; see ``run``."""

    def in_order(self, instructions: NDArray[np.int64]) -> Self:
        """Return the machine for the same kernels in another order, with the same code."""
        other = copy.copy(self)
        other._take(self.program._replace(instructions=instructions))
        return other

    def record_size(self, lanes: int) -> int:
        """Return how many numbers of memory a record takes, with whole registers and the start of a line."""
        return math.prod(self._shape(lanes)) + CACHE_LINE // 8

    def new_record(self, lanes: int, out: Array | None = None) -> Array:
        """Return the record of runs in memory, shape (rows, recorded, lanes of whole registers); see run."""
        shape, size = self._shape(lanes), self.record_size(lanes)
        memory = np.empty(size) if out is None else out
        if memory.shape < (size,) or memory.strides != (8,) or memory.dtype != np.float64:
            raise ValueError(f"out has shape {memory.shape}; it must have {size} floats in a row")
        start = -memory.ctypes.data % CACHE_LINE // 8
        return memory[start : start + math.prod(shape)].reshape(shape)

    def _shape(self, lanes: int) -> tuple[int, int, int]:
        return self._rows, self.program.recorded, -(-lanes // self.width) * self.width
