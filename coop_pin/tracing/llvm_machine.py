"""Programs compiled by LLVM (llvmlite), whose code a cache may keep for other processes."""

from __future__ import annotations

import ctypes
import hashlib
import logging
from collections.abc import Callable
from functools import cache, partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .kernel import Array, Machine, Program
from .llvm_emitter import ARGUMENTS, llvm_text

_LOG = logging.getLogger("coop_pin")
_AT_ONCE = 2_000
"""Instructions of one call: some 40 ms with 64 lanes and kernels of ten thousand operations."""


BRIEF, LASTING = 0, 1
"""Levels of LLVM's code generator; both keep every operation as it is written."""


class _Arguments(ctypes.Structure):
    """Arguments of ``run``."""

    _fields_ = [(name, ctypes.c_int64) for name in ARGUMENTS]
    kept: Any


class CodeCache(Protocol):
    """Mapping that keeps compiled code by a digest of text, processor, LLVM and level, such as a dict."""

    def get(self, key: bytes, /) -> bytes | None:
        """Return the code of a key, None for none."""

    def __setitem__(self, key: bytes, code: bytes, /) -> None:
        """Keep the code of a key, or do not."""


class LlvmMachine(Machine):
    """Machine that runs compiled code; its width is that of a vector register."""

    def __init__(
        self,
        program: Program,
        width: int | None = None,
        cache: CodeCache | None = None,
        *,
        is_brief: bool = False,
    ) -> None:
        """Compile a program, or take its code from a cache.

        Args:
            program: Kernels and the order of their calls.
            width: Number of lanes of a register; that of this processor when omitted.
            cache: Cache of compiled code; none when omitted. Whoever can write it can run code here.
            is_brief: Whether it runs briefly: registers are chosen in a quarter of the time, and the code, of
                the same results, takes up to twice as long.

        Raises:
            ValueError: The program's text is for another number of lanes.
        """
        super().__init__(program, native_width() if width is None else width)
        if program.text and program.width != self.width:  # it would read and write beyond its memory
            detail = f"the text of the program is for {program.width} lanes, not for {self.width}"
            raise ValueError(f"{detail}; take that width, or a program of kernels")
        text = program.text or llvm_text(program, self.width)
        self._engine = _engine(text, {} if cache is None else cache, BRIEF if is_brief else LASTING)
        self._run = ctypes.CFUNCTYPE(None, ctypes.POINTER(_Arguments))(
            self._engine.get_function_address("run")
        )

    def execute(
        self, block: Array, uniforms: Array, loads: Array, record: Array, between: Callable[[], None]
    ) -> None:
        """Run the program with a record of whole registers; see ``run``."""
        slots = self.packed(block)
        call = self.bound(slots, np.ascontiguousarray(uniforms), record, self.packed(loads))
        count = len(self.program.instructions)
        for first in range(0, count, _AT_ONCE):  # Python sees Ctrl-C in between
            call(first, min(_AT_ONCE, count - first))
            between()
        block[:] = self.unpacked(slots, block.shape[1])

    def packed(self, values: Array) -> Array:
        """Return values of runs, (..., runs), as registers, (groups, ..., width), the last run repeated."""
        groups = -(-values.shape[-1] // self.width)
        lane = np.minimum(np.arange(groups * self.width), values.shape[-1] - 1)
        registers = values[..., lane].reshape(*values.shape[:-1], groups, self.width)
        return np.ascontiguousarray(np.moveaxis(registers, -2, 0))

    def unpacked(self, registers: Array, runs: int) -> Array:
        """Return the values of runs, shape (..., runs), in registers, shape (groups, ..., width)."""
        return np.moveaxis(registers, 0, -2).reshape(*registers.shape[1:-1], -1)[..., :runs]

    def bound(
        self,
        block: Array,
        uniforms: Array,
        record: Array | None = None,
        loads: Array | None = None,
    ) -> Callable[[int, int], None]:
        """Return a function that runs some instructions of the program, by first and count, on runs.

        Args:
            block: Slots of the runs, changed in place, shape (groups, slots, width); the last axis may be
                missing where it is 1.
            uniforms: Numbers that all runs share, read at every call, shape (rows, uniforms).
            record: Memory that RECORD writes, as of new_record; for programs that record.
            loads: Numbers that LOAD fills in, shape (groups, rows, loaded, width); for programs that load.
        """
        run, instructions = self._run, self.program.instructions
        arguments = self._arguments(instructions, block, uniforms, record, loads)
        start, size = arguments.program, instructions.itemsize * instructions.shape[1]

        def call(first: int, count: int) -> None:
            arguments.count, arguments.program = count, start + first * size
            run(arguments)

        return call

    def single(self, block: Array, uniforms: Array) -> list[Callable[[], object]]:
        """Return a function for each instruction of the program, half as long in the call as ``bound``."""
        instructions = self.program.instructions
        rows = [instructions[i : i + 1] for i in range(len(instructions))]
        return [partial(self._run, self._arguments(row, block, uniforms)) for row in rows]

    def _arguments(
        self,
        instructions: NDArray[np.int64],
        block: Array,
        uniforms: Array,
        record: Array | None = None,
        loads: Array | None = None,
    ) -> _Arguments:
        """Return the arguments of ``run`` for memory as of ``bound``, which they keep."""
        groups = block.size // (self.program.lanes.size * self.width)
        arguments = _Arguments(
            count=len(instructions),
            program=instructions.ctypes.data,
            groups=groups,
            blocks=block.ctypes.data,
            uniforms=uniforms.ctypes.data,
            uniform_bytes=8 * uniforms.shape[1],
            loads=0 if loads is None else loads.ctypes.data,
            load_rows=0 if loads is None else loads.shape[1],
            record=0 if record is None else record.ctypes.data,
            slot_bytes=8 * groups * self.width,
        )
        arguments.kept = self, instructions, block, uniforms, record, loads
        return arguments


def _llvm() -> Any:
    """Return llvmlite's binding, ready to compile."""
    import llvmlite.binding as llvm  # slow to load

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


@cache
def can_compile() -> bool:
    """Return whether llvmlite is there; a line of the log says once that it is not."""
    try:
        _llvm()
    except ImportError:
        _LOG.info("llvmlite is missing: numpy runs what it would compile, several times slower")
        return False
    return True


def native_width() -> int:
    """Return the number of doubles in a vector register of this processor."""
    features = _llvm().get_host_cpu_features()
    return 8 if features.get("avx512f") else 4 if features.get("avx2") else 2


def _engine(text: str, cache: CodeCache, level: int) -> Any:
    """Return an execution engine with the code of a text, compiled at a level or from a cache."""
    llvm = _llvm()
    processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=processor, features=features + ",-prefer-256-bit", opt=level
    )
    version = ".".join(map(str, llvm.llvm_version_info))
    key = hashlib.sha256("\n".join((text, processor, features, version, str(level))).encode()).digest()
    code = cache.get(key)
    if code is None:
        # The tape has folded and shared what LLVM's passes would; this one finds choices by comparisons.
        module, passes = llvm.parse_assembly(text), llvm.create_new_module_pass_manager()
        passes.add_instruction_combine_pass()
        passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
        code = machine.emit_object(module)
        cache[key] = code
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine
