"""Traced code of a family of runs, which is kept on disk: another process need not trace it again."""

from __future__ import annotations

import hashlib
import pickle
import zlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Mask
from coop_pin.batch.block import RunBlock
from coop_pin.batch.preparation import Prepared
from coop_pin.batch.tick import TickCode
from coop_pin.disk_cache import keep, kept, package_digest
from coop_pin.tracing.kernel import Kernel, Layout, Program
from coop_pin.tracing.llvm_emitter import llvm_text
from coop_pin.tracing.tree import leaves, structure, valued


class TracedCode(NamedTuple):
    """Traced code of the runs of a block.

    Attributes:
        names: names of the kernels, by index.
        lanes: slots of the block, those that the states of sensors, network and law take included.
        law: tree like the state of the law.
        text: LLVM's text of the kernels; empty where they are not written for LLVM.
        kernels: the kernels; none where there is a text.
    """

    names: Sequence[str]
    lanes: Layout
    law: Any
    text: str = ""
    kernels: Sequence[Kernel] = ()


def traced_code(block: RunBlock, first: Prepared, differs: Mask, width: int | None) -> TracedCode:
    """Return the traced code of the runs of a block.

    Args:
        block: Block of the runs.
        first: Batch whose first run has the numbers that fold.
        differs: Leaves of the constants that are inputs.
        width: Number of lanes of LLVM's registers; None keeps the kernels themselves.

    Raises:
        TracingError: The runs cannot be traced.
    """
    is_kept = width is not None and not first.is_foreign  # users' modules may change
    key = _key(block, first, differs, width) if is_kept else b""
    if is_kept and (content := kept(key)):
        return TracedCode(*pickle.loads(zlib.decompress(content)))
    code = TickCode(block, exact=first.is_foreign)
    kernels = code.kernels()
    law = valued(code.law, iter([0.0] * len(leaves(code.law))))
    traced = TracedCode([kernel.name for kernel in kernels], block.lanes, law, "", kernels)
    if width is None:
        return traced
    program = Program(kernels, block.lanes, block.recorded, block.loaded, ())
    traced = traced._replace(text=llvm_text(program, width), kernels=())
    if is_kept:
        keep(key, zlib.compress(pickle.dumps(tuple(traced)), 1))
    return traced


def _key(block: RunBlock, first: Prepared, differs: Mask, width: int | None) -> bytes:
    """Return the digest of what the code depends on: the package, structure and numbers of the runs."""
    split, plant = block.signals, first.plants[0]
    varies = split.is_uniform | split.is_loaded
    numbers = first.values[0][~differs], split.constants[~varies], differs, split.is_uniform, split.is_loaded
    shape = first.kind[-3:], structure(split.example), structure(plant.start)
    digest = hashlib.sha256(repr((package_digest(), np.__version__, width, shape)).encode())
    for part in numbers:
        digest.update(part.tobytes())
    return digest.digest()
