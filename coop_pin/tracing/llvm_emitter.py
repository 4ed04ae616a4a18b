"""Traced code as text of LLVM: each run is one lane of the vector registers.

No operation is contracted or reordered, so that the bits do not depend on the width of the registers.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence

from .emitter import Emitter
from .kernel import CACHE_LINE, LOAD, RECORD, Kernel, Program
from .tape import Operand, Subroutine, Tape

_AS_NUMBERS = "%v{i} = uitofp <{width} x i1> %m{i} to {vector}"
_LINES = {
    "add": ["%v{i} = fadd {vector} {0}, {1}"],
    "sub": ["%v{i} = fsub {vector} {0}, {1}"],
    "mul": ["%v{i} = fmul {vector} {0}, {1}"],
    "div": ["%v{i} = fdiv {vector} {0}, {1}"],
    "neg": ["%v{i} = fneg {vector} {0}"],
    "abs": ["%v{i} = call {vector} @llvm.fabs.v{width}f64({vector} {0})"],
    "sqrt": ["%v{i} = call {vector} @llvm.sqrt.v{width}f64({vector} {0})"],
    "less": ["%m{i} = fcmp olt {vector} {0}, {1}", _AS_NUMBERS],
    "less_equal": ["%m{i} = fcmp ole {vector} {0}, {1}", _AS_NUMBERS],
    "select": [
        "%m{i} = fcmp une {vector} {0}, zeroinitializer",
        "%v{i} = select <{width} x i1> %m{i}, {vector} {1}, {vector} {2}",
    ],
    "power_of_two": [
        "%c{i} = fptosi {vector} {0} to <{width} x i64>",
        "%n{i} = freeze <{width} x i64> %c{i}",  # of NaN: any number, but always the same
        "%e{i} = add <{width} x i64> %n{i}, splat (i64 1023)",
        "%s{i} = shl <{width} x i64> %e{i}, splat (i64 52)",
        "%v{i} = bitcast <{width} x i64> %s{i} to {vector}",
    ],
}
"""Lines of each operation; {vector} is the type of a register, {width} its number of lanes."""
ARGUMENTS = {
    "count": "i64",
    "program": "ptr",
    "groups": "i64",
    "blocks": "ptr",
    "uniforms": "ptr",
    "uniform_bytes": "i64",
    "loads": "ptr",
    "load_rows": "i64",
    "record": "ptr",
    "slot_bytes": "i64",
}
"""Arguments of ``run`` with their types, eight bytes each: one pointer to them makes the quickest call."""


def llvm_text(program: Program, width: int) -> str:
    """Return LLVM's text of a program for a number of lanes; it is run by the function ``run``."""
    emitter, size = LlvmEmitter(width), 8 * width
    for kernel in program.kernels:
        emitter.kernel(kernel)
    names = [kernel.name for kernel in program.kernels]
    run = _RUN.format(
        LOAD=LOAD,
        RECORD=RECORD,
        arguments="\n".join(
            f"  %{name}.p = getelementptr i64, ptr %arguments, i64 {index}\n"
            f"  %{name} = load {kind}, ptr %{name}.p, align 8"
            for index, (name, kind) in enumerate(ARGUMENTS.items())
        ),
        block=size * program.lanes.size,
        vector=size,
        type=f"<{width} x double>",
        past_caches=", !nontemporal !0" if size == CACHE_LINE else "",
        recorded=program.recorded,
        after_record=size * program.recorded,
        loaded=size * program.loaded,
        cases="\n".join(f"    i64 {index}, label %do_{name}" for index, name in enumerate(names)),
        calls="\n".join(
            f"do_{name}:\n  call void @{name}(ptr %block, ptr %u)\n  br label %next" for name in names
        ),
    )
    return "\n".join([*emitter.parts, run])


class LlvmEmitter(Emitter):
    """Writer of kernels ``void (ptr block, ptr uniforms)``, subroutines ``void (ptr x, ptr y)``."""

    def __init__(self, width: int) -> None:
        """Write for a number of lanes."""
        self._width, self._vector = width, f"<{width} x double>"
        super().__init__(_LINES, width=width, vector=self._vector)
        for name in ("sqrt", "fabs"):
            self.parts.append(f"declare {self._vector} @llvm.{name}.v{width}f64({self._vector})")
        self.parts.append("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")

    def kernel(self, kernel: Kernel) -> None:
        """Add a kernel."""

        def read(index: int, position: int) -> str:
            space, slot = kernel.reads[position]
            if space == "uniform":
                return self._spread(f"%v{index}", slot)
            return self._load(f"%v{index}", "%block", slot)

        head = f"@{kernel.name}(ptr %block, ptr %uniforms)"
        self._define(head, kernel.tape, kernel.writes, "%block", read)

    def operand(self, operand: Operand) -> str:
        """Return an operand as it is written in an expression."""
        if isinstance(operand, int):
            return f"%v{operand}"
        bits = struct.unpack("<Q", struct.pack("<d", operand))[0]
        return f"splat (double 0x{bits:016X})"

    def _define_subroutine(self, subroutine: Subroutine) -> None:
        self._define(
            f"@{subroutine.name}(ptr %inputs, ptr %outputs)",
            subroutine.tape,
            list(enumerate(subroutine.outputs)),
            "%outputs",
            lambda index, position: self._load(f"%v{index}", "%inputs", position),
        )

    def _define(
        self,
        head: str,
        tape: Tape,
        stores: Sequence[tuple[int, Operand]],
        target: str,
        read: Callable[[int, int], str],
    ) -> None:
        lines = [f"define internal void {head} noinline {{"]
        lines += self.body(tape, [operand for _, operand in stores], read)
        for count, (slot, operand) in enumerate(stores):
            lines += self._store(f"%o{count}", self.operand(operand), target, slot)
        self.parts.append("\n".join([*lines, "ret void", "}"]))

    def _call(self, index: int, subroutine: Subroutine, arguments: Sequence[str]) -> Iterator[str]:
        for buffer, size in (("a", len(arguments)), ("r", len(subroutine.outputs))):
            yield f"%{buffer}{index} = alloca [{max(size, 1)} x {self._vector}], align 64"
        for count, argument in enumerate(arguments):
            yield from self._store(f"%a{index}.{count}", argument, f"%a{index}", count)
        yield f"call void @{subroutine.name}(ptr %a{index}, ptr %r{index})"

    def _result(self, index: int, call: int, position: int) -> str:
        return self._load(f"%v{index}", f"%r{call}", position)

    def _load(self, name: str, pointer: str, slot: int) -> str:
        return (
            f"{name}.p = getelementptr {self._vector}, ptr {pointer}, i64 {slot}\n"
            f"{name} = load {self._vector}, ptr {name}.p, align 8"
        )

    def _spread(self, name: str, slot: int) -> str:
        """Load a number that all lanes share."""
        vector = self._vector
        return (
            f"{name}.p = getelementptr double, ptr %uniforms, i64 {slot}\n"
            f"{name}.s = load double, ptr {name}.p, align 8\n"
            f"{name}.i = insertelement {vector} poison, double {name}.s, i32 0\n"
            f"{name} = shufflevector {vector} {name}.i, {vector} poison, "
            f"<{self._width} x i32> zeroinitializer"
        )

    def _store(self, name: str, value: str, pointer: str, slot: int) -> Iterator[str]:
        yield f"{name}.p = getelementptr {self._vector}, ptr {pointer}, i64 {slot}"
        yield f"store {self._vector} {value}, ptr {name}.p, align 8"


_RUN = """define void @run(ptr %arguments) {{
entry:
{arguments}
  %load_bytes = mul i64 %load_rows, {loaded}
  %row_bytes = mul i64 %slot_bytes, {recorded}
  br label %group
group:
  %g = phi i64 [0, %entry], [%g1, %group_end]
  %go = mul i64 %g, {block}
  %block = getelementptr i8, ptr %blocks, i64 %go
  %lo = mul i64 %g, %load_bytes
  %load = getelementptr i8, ptr %loads, i64 %lo
  %ro = mul i64 %g, {vector}
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
  %to = getelementptr i8, ptr %block, i64 {after_record}
  call void @llvm.memcpy.p0.p0.i64(ptr %to, ptr %from, i64 {loaded}, i1 false)
  br label %next
do_record:
  %into_o = mul i64 %row, %row_bytes
  %into = getelementptr i8, ptr %rec, i64 %into_o
  br label %copy
copy:
  %s = phi i64 [0, %do_record], [%s1, %copy]
  %so = mul i64 %s, {vector}
  %sp = getelementptr i8, ptr %block, i64 %so
  %to_o = mul i64 %s, %slot_bytes
  %top = getelementptr i8, ptr %into, i64 %to_o
  %value = load {type}, ptr %sp, align 8
  store {type} %value, ptr %top, align {vector}{past_caches}
  %s1 = add i64 %s, 1
  %on = icmp ult i64 %s1, {recorded}
  br i1 %on, label %copy, label %next
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
!0 = !{{i32 1}}
"""
