"""Timing in interleaved blocks: on a busy machine only ratios of neighbours in time mean something."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

Task = Callable[[], object]


def interleaved(tasks: Mapping[str, Task], blocks: int, calls: int) -> dict[str, np.ndarray]:
    """Return seconds per call of every task in every block, shape (blocks,): A B C A B C ...; a first round warms up and is dropped."""
    seconds = {name: np.zeros(blocks) for name in tasks}
    for block in range(-1, blocks):
        for name, task in tasks.items():
            start = time.perf_counter()
            for _ in range(calls):
                task()
            seconds[name][block] = (time.perf_counter() - start) / calls
    return seconds


def ratio(seconds: np.ndarray, unit: np.ndarray) -> str:
    """Return the median of the blocks' ratios and their range, for printing."""
    ratios = seconds / unit
    return f"{np.median(ratios):8.2f}   ({ratios.min():.2f} .. {ratios.max():.2f})"
