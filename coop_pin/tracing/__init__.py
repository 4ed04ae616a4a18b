"""Compiler of numerical Python: functions of arrays, recorded as scalar operations, as vector code and C.

It knows no robot and imports nothing but numpy and llvmlite; its imports are relative, so that the folder
works anywhere. A tape records operations, a kernel is a tape that reads and writes slots of a block, a
program has kernels and their order; a machine runs it, compiled by LLVM. ``README.md`` has an
example. In the order in which they build on each other: tape (operations, scalars), comparisons (and
choices), elementary (sine, logarithm, inverse), traced_array (numpy's functions), tree (numbers in nested
values), evaluation (by numpy), kernel (slots, programs), emitter with c_emitter and llvm_emitter (text), and
llvm_machine.
"""
