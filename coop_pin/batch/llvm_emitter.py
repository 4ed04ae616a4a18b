"""Programs compiled by LLVM (llvmlite): several runs in the lanes of each vector register.

No operation is contracted or reordered, so that the bits do not depend on the width of the registers.
Compiled code is kept on disk under the hash of its text, of the processor and of LLVM's version.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch.kernel import LOAD, RECORD, Kernel, Machine, Program
from coop_pin.batch.tape import Function, Number, Operand, Operation, Tape, Traced
from coop_pin.errors import MissingExtraError
from coop_pin.results.atomic_write import write_atomically

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_DIGEST = 32
"""Bytes of the checksum in front of a file of compiled code."""


def _llvm() -> Any:
    """Return llvmlite's binding.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import llvmlite.binding as llvm
    except ImportError:
        raise MissingExtraError("llvmlite", "fast", "to compile batches of runs") from None
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


def native_width() -> int:
    """Return the number of doubles in a vector register of this processor; raises as _llvm."""
    features = _llvm().get_host_cpu_features()
    return 8 if features.get("avx512f") else 4 if features.get("avx2") else 2


class LlvmText:
    """LLVM's text of functions and kernels for a number of lanes."""

    def __init__(self, width: int) -> None:
        self.width, self.vector = width, f"<{width} x double>"
        self._functions: dict[Function, str] = {}
        self.parts = [
            f"declare {self.vector} @llvm.{name}.v{width}f64({self.vector})" for name in ("sqrt", "fabs")
        ]
        self.parts.append("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")

    def kernel(self, kernel: Kernel) -> str:
        """Add a kernel, ``void (ptr block, ptr uniforms)``, and return its name."""
        loads = [
            self._load(f"%x{index}", "%block", slot) if space == "lane" else self._spread(index, slot)
            for index, (space, slot) in enumerate(kernel.reads)
        ]
        stores = [(slot, number) for slot, number in kernel.writes]
        self._define(f"@{kernel.name}", "ptr %block, ptr %uniforms", kernel.tape, loads, stores, "%block")
        return kernel.name

    def function(self, function: Function) -> str:
        """Add a function, ``void (ptr inputs, ptr outputs)``, unless it is there, and return its name."""
        if function not in self._functions:
            loads = [self._load(f"%x{index}", "%inputs", index) for index in range(function.tape.inputs)]
            stores = list(enumerate(function.outputs))
            self._functions[function] = function.name
            self._define(
                f"@{function.name}", "ptr %inputs, ptr %outputs", function.tape, loads, stores, "%outputs"
            )
        return self._functions[function]

    def _define(
        self,
        name: str,
        arguments: str,
        tape: Tape,
        loads: Sequence[str],
        stores: Sequence[tuple[int, Number]],
        target: str,
    ) -> None:
        lines = [f"define internal void {name}({arguments}) noinline {{"]
        for index in tape.live([number for _, number in stores]):
            operation = tape.operations[index]
            if operation.name == "input":
                lines.append(
                    loads[int(operation.operands[0])].replace(f"%x{operation.operands[0]} ", f"%v{index} ")
                )
            else:
                lines += self._operation(index, operation)
        for count, (slot, number) in enumerate(stores):
            value = self._operand(number.index if isinstance(number, Traced) else float(number))
            lines += self._store(f"%o{count}", value, target, slot)
        self.parts.append("\n".join([*lines, "ret void", "}"]))

    def _operation(self, index: int, operation: Operation) -> Iterator[str]:
        vector, width, name = self.vector, self.width, operation.name
        if operation.function is not None:
            yield from self._call(index, operation)
            return
        if name == "result":
            call, result = operation.operands
            yield self._load(f"%v{index}", f"%r{call}", int(result))
            return
        a, *rest = [self._operand(operand) for operand in operation.operands]
        match name:
            case "add" | "sub" | "mul" | "div":
                yield f"%v{index} = {_ARITHMETIC[name]} {vector} {a}, {rest[0]}"
            case "neg":
                yield f"%v{index} = fneg {vector} {a}"
            case "sqrt" | "abs":
                intrinsic = "fabs" if name == "abs" else name
                yield f"%v{index} = call {vector} @llvm.{intrinsic}.v{width}f64({vector} {a})"
            case "less":
                yield f"%m{index} = fcmp olt {vector} {a}, {rest[0]}"
                yield f"%v{index} = uitofp <{width} x i1> %m{index} to {vector}"
            case "select":
                yield f"%m{index} = fcmp une {vector} {a}, zeroinitializer"
                yield f"%v{index} = select <{width} x i1> %m{index}, {vector} {rest[0]}, {vector} {rest[1]}"
            case "power_of_two":
                integers = f"<{width} x i64>"
                yield f"%c{index} = fptosi {vector} {a} to {integers}"
                yield f"%n{index} = freeze {integers} %c{index}"  # of NaN: any number, but always the same
                yield f"%e{index} = add {integers} %n{index}, splat (i64 1023)"
                yield f"%s{index} = shl {integers} %e{index}, splat (i64 52)"
                yield f"%v{index} = bitcast {integers} %s{index} to {vector}"

    def _call(self, index: int, operation: Operation) -> Iterator[str]:
        function = operation.function
        assert function is not None
        name = self.function(function)
        for buffer, size in (("a", len(operation.operands)), ("r", len(function.outputs))):
            yield f"%{buffer}{index} = alloca [{max(size, 1)} x {self.vector}], align 64"
        for count, operand in enumerate(operation.operands):
            yield from self._store(f"%a{index}.{count}", self._operand(operand), f"%a{index}", count)
        yield f"call void @{name}(ptr %a{index}, ptr %r{index})"

    def _operand(self, operand: Operand) -> str:
        if isinstance(operand, int):
            return f"%v{operand}"
        bits = struct.unpack("<Q", struct.pack("<d", operand))[0]
        return f"splat (double 0x{bits:016X})"

    def _load(self, name: str, pointer: str, slot: int) -> str:
        return (
            f"{name}.p = getelementptr {self.vector}, ptr {pointer}, i64 {slot}\n"
            f"{name} = load {self.vector}, ptr {name}.p, align 8"
        )

    def _spread(self, index: int, slot: int) -> str:
        """Load a number that all lanes share."""
        name, vector = f"%x{index}", self.vector
        return (
            f"{name}.p = getelementptr double, ptr %uniforms, i64 {slot}\n"
            f"{name}.s = load double, ptr {name}.p, align 8\n"
            f"{name}.i = insertelement {vector} poison, double {name}.s, i32 0\n"
            f"{name} = shufflevector {vector} {name}.i, {vector} poison, <{self.width} x i32> zeroinitializer"
        )

    def _store(self, name: str, value: str, pointer: str, slot: int) -> Iterator[str]:
        yield f"{name}.p = getelementptr {self.vector}, ptr {pointer}, i64 {slot}"
        yield f"store {self.vector} {value}, ptr {name}.p, align 8"


_RUN = """define void @run(i64 %groups, i64 %count, ptr %program, ptr %blocks, ptr %uniforms,
  i64 %uniform_bytes, ptr %loads, i64 %load_rows, ptr %record, i64 %record_rows) {{
entry:
  %load_bytes = mul i64 %load_rows, {loaded}
  %record_bytes = mul i64 %record_rows, {recorded}
  br label %group
group:
  %g = phi i64 [0, %entry], [%g1, %group_end]
  %go = mul i64 %g, {block}
  %block = getelementptr i8, ptr %blocks, i64 %go
  %lo = mul i64 %g, %load_bytes
  %load = getelementptr i8, ptr %loads, i64 %lo
  %ro = mul i64 %g, %record_bytes
  %rec = getelementptr i8, ptr %record, i64 %ro
  br label %step
step:
  %k = phi i64 [0, %group], [%k1, %next]
  %pi = getelementptr {{i64, i64}}, ptr %program, i64 %k
  %code = load i64, ptr %pi, align 8
  %pr = getelementptr i8, ptr %pi, i64 8
  %row = load i64, ptr %pr, align 8
  %uo = mul i64 %row, %uniform_bytes
  %u = getelementptr i8, ptr %uniforms, i64 %uo
  switch i64 %code, label %next [
    i64 {LOAD}, label %do_load
    i64 {RECORD}, label %do_record
{cases}
  ]
do_load:
  %from_o = mul i64 %row, {loaded}
  %from = getelementptr i8, ptr %load, i64 %from_o
  %to = getelementptr i8, ptr %block, i64 {recorded}
  call void @llvm.memcpy.p0.p0.i64(ptr %to, ptr %from, i64 {loaded}, i1 false)
  br label %next
do_record:
  %into_o = mul i64 %row, {recorded}
  %into = getelementptr i8, ptr %rec, i64 %into_o
  call void @llvm.memcpy.p0.p0.i64(ptr %into, ptr %block, i64 {recorded}, i1 false)
  br label %next
{calls}
next:
  %k1 = add i64 %k, 1
  %more = icmp ult i64 %k1, %count
  br i1 %more, label %step, label %group_end
group_end:
  %g1 = add i64 %g, 1
  %again = icmp ult i64 %g1, %groups
  br i1 %again, label %group, label %done
done:
  ret void
}}
"""


class LlvmMachine(Machine):
    """Runs a program by compiled code.

    Attributes:
        width: lanes of a register.
    """

    def __init__(self, program: Program, width: int | None = None) -> None:
        """Compile a program, or load its code from disk.

        Args:
            program: what to run.
            width: lanes of a register; those of this processor when omitted.

        Raises:
            MissingExtraError: llvmlite is not installed.
        """
        self._program, self.width = program, native_width() if width is None else width
        self._engine = _engine(_text(program, self.width))
        pointer, whole = ctypes.c_void_p, ctypes.c_int64
        kinds = (whole, whole, pointer, pointer, pointer, whole, pointer, whole, pointer, whole)
        self._run = ctypes.CFUNCTYPE(None, *kinds)(self._engine.get_function_address("run"))
        self._instructions = np.array(program.instructions, dtype=np.int64).reshape(-1, 2)

    def run(self, block: Array, uniforms: Array, loads: Array) -> Array:
        """Run the program; see Machine."""
        lanes, width, program = block.shape[1], self.width, self._program
        groups, rows = -(-lanes // width), program.rows(RECORD)
        lane = np.minimum(np.arange(groups * width), lanes - 1)  # the last run fills the last group
        slots = np.ascontiguousarray(block[:, lane].reshape(-1, groups, width).swapaxes(0, 1))
        given = loads[:, :, lane].reshape(*loads.shape[:2], groups, width)
        given = np.ascontiguousarray(np.moveaxis(given, 2, 0))
        uniforms = np.ascontiguousarray(uniforms)
        record = np.empty((groups, rows, program.recorded, width))
        self._run(
            groups,
            len(self._instructions),
            self._instructions.ctypes.data,
            slots.ctypes.data,
            uniforms.ctypes.data,
            8 * uniforms.shape[1],
            given.ctypes.data,
            len(loads),
            record.ctypes.data,
            rows,
        )
        block[:] = slots.swapaxes(0, 1).reshape(len(block), -1)[:, :lanes]
        return np.moveaxis(record, 0, 2).reshape(rows, program.recorded, -1)[:, :, :lanes]


def _text(program: Program, width: int) -> str:
    """Return LLVM's text of a program."""
    text, size = LlvmText(width), 8 * width
    names = [text.kernel(kernel) for kernel in program.kernels]
    text.parts.append(
        _RUN.format(
            LOAD=LOAD,
            RECORD=RECORD,
            block=size * program.lanes.size,
            recorded=size * program.recorded,
            loaded=size * program.loaded,
            cases="\n".join(f"    i64 {index}, label %do_{name}" for index, name in enumerate(names)),
            calls="\n".join(
                f"do_{name}:\n  call void @{name}(ptr %block, ptr %u)\n  br label %next" for name in names
            ),
        )
    )
    return "\n".join(text.parts)


def _engine(text: str) -> Any:
    """Return an execution engine with the code of a text, compiled or from disk."""
    llvm = _llvm()
    processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=processor, features=features + ",-prefer-256-bit", opt=1
    )
    version = ".".join(map(str, llvm.llvm_version_info))
    key = hashlib.sha256("\n".join((text, processor, features, version)).encode()).hexdigest()
    path = _cache() / f"{key}.o"
    code = _read(path)
    if code is None:
        # The tape has folded and shared what LLVM's passes would: they cost time and gain 8 % at most.
        code = machine.emit_object(llvm.parse_assembly(text))
        _keep(path, code)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _cache() -> Path:
    """Return the folder of compiled code, in that of the user's caches."""
    caches = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(caches) if caches else Path.home() / ".cache") / "coop_pin" / "compiled"


def _read(path: Path) -> bytes | None:
    """Return compiled code that was kept, unless it is not there or damaged."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    digest, code = data[:_DIGEST], data[_DIGEST:]
    return code if hashlib.sha256(code).digest() == digest else None


def _keep(path: Path, code: bytes) -> None:
    """Keep compiled code; a folder that cannot be written costs the time to compile it again."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_atomically(path, lambda part: part.write_bytes(hashlib.sha256(code).digest() + code))
    except OSError:
        return
