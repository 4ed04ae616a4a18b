"""Compiler of numerical Python: functions of arrays, recorded as scalar operations, as vector code and C.

It knows no robot. A tape records operations; a kernel is a tape that reads and writes slots of a block; a
program says which kernels run in which order; a machine runs it, by numpy or compiled by LLVM. In the
order in which they build on each other: tape (operations, scalars), elementary (sine, logarithm,
inverse), traced_array (numpy's functions), tree (numbers in nested values), kernel (slots, programs),
emitter with c_emitter and llvm_emitter (text), numpy_machine (the oracle) and
llvm_machine (compiled).
"""
