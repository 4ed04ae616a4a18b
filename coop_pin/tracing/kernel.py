"""Kernels: traced code that reads and writes the slots of a block of runs, and programs of them.

A block holds many runs side by side, one lane each; a slot is one number of every lane. A program says which
kernels run in which order, and what is loaded into slots and recorded from them in between.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coop_pin.arrays import Array
from coop_pin.tracing.numpy_emitter import evaluate
from coop_pin.tracing.tape import Number, Tape
from coop_pin.tracing.traced_array import inputs
from coop_pin.tracing.tree import leaves


class Layout:
    """Slots of a block by names, each an array.

    Attributes:
        size: number of slots.
    """

    def __init__(self) -> None:
        self.size = 0
        self._fields: dict[str, tuple[int, tuple[int, ...]]] = {}

    def add(self, name: str, *shape: int) -> None:
        """Add a field."""
        self._fields[name] = self.size, shape
        self.size += math.prod(shape)

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def slots(self, name: str) -> NDArray[np.int64]:
        """Return the slots of a field, in its shape."""
        start, shape = self._fields[name]
        return start + np.arange(math.prod(shape)).reshape(shape)


class Kernel:
    """Code that reads slots and numbers common to all runs, and writes slots.

    Attributes:
        name: in emitted code.
        tape: its operations.
        reads: where each input of the tape comes from: "lane" or "uniform", and the slot there.
        writes: slot and number of each output.
    """

    def __init__(self, name: str, lanes: Layout, uniforms: Layout) -> None:
        self.name, self.tape = name, Tape()
        self.reads: list[tuple[Literal["lane", "uniform"], int]] = []
        self.writes: list[tuple[int, Number]] = []
        self._lanes, self._uniforms, self._known = lanes, uniforms, dict[tuple[str, str], Any]()

    def read(self, name: str) -> Any:
        """Return a field of the block."""
        return self._read("lane", name, self._lanes)

    def uniform(self, name: str) -> Any:
        """Return a field that all runs share."""
        return self._read("uniform", name, self._uniforms)

    def write(self, name: str, values: Any) -> None:
        """Write a field of the block, after all reads."""
        numbers = leaves(values)
        self.writes += zip(self._lanes.slots(name).ravel().tolist(), numbers, strict=True)

    @property
    def outputs(self) -> list[Number]:
        """The numbers that are written."""
        return [number for _, number in self.writes]

    def _read(self, space: Literal["lane", "uniform"], name: str, layout: Layout) -> Any:
        key = space, name
        if key not in self._known:
            slots = layout.slots(name)
            self.reads += [(space, int(slot)) for slot in slots.ravel()]
            self._known[key] = inputs(self.tape, *slots.shape)
        return self._known[key]


class Instruction(NamedTuple):
    """One instruction of a program.

    Attributes:
        code: index of a kernel to run, or LOAD or RECORD.
        row: of the uniforms, the loads, or the record.
    """

    code: int
    row: int


LOAD, RECORD = -1, -2


class Program(NamedTuple):
    """Kernels and the order of their calls.

    Attributes:
        kernels: by index.
        lanes: slots of the block; those of ``record`` are first, then those of ``load``.
        recorded: number of slots that RECORD copies.
        loaded: number of slots that LOAD fills.
        instructions: in order.
    """

    kernels: Sequence[Kernel]
    lanes: Layout
    recorded: int
    loaded: int
    instructions: Sequence[Instruction]

    def rows(self, code: int) -> int:
        """Return the number of rows that a kind of instruction needs."""
        return 1 + max((row for found, row in self.instructions if found == code), default=-1)


class Machine(ABC):
    """Runs programs."""

    @abstractmethod
    def run(self, block: Array, uniforms: Array, loads: Array) -> Array:
        """Run the program.

        Args:
            block: initial slots, changed in place, shape (slots, lanes).
            uniforms: shape (rows, uniforms).
            loads: shape (rows, loaded, lanes).

        Returns:
            The record, shape (rows, recorded, lanes).
        """


class NumpyMachine(Machine):
    """Runs a program by numpy: slow, the oracle."""

    def __init__(self, program: Program) -> None:
        self._program = program

    def run(self, block: Array, uniforms: Array, loads: Array) -> Array:
        """Run the program; see Machine."""
        program = self._program
        record = np.empty((program.rows(RECORD), program.recorded, block.shape[1]))
        with np.errstate(all="ignore"):
            for code, row in program.instructions:
                if code == RECORD:
                    record[row] = block[: program.recorded]
                elif code == LOAD:
                    block[program.recorded : program.recorded + program.loaded] = loads[row]
                else:
                    kernel = program.kernels[code]
                    given = [
                        block[slot].copy() if space == "lane" else uniforms[row, slot]
                        for space, slot in kernel.reads
                    ]
                    values = evaluate(kernel.tape, kernel.outputs, given)
                    for (slot, _), value in zip(kernel.writes, values, strict=True):
                        block[slot] = value
        return record
