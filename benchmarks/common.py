"""Processor time in interleaved blocks, whose ratios are reproducible on a busy machine."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np

import coop_pin as cp

Task = Callable[[], object]


@contextlib.contextmanager
def elsewhere() -> Iterator[None]:
    """Work in a temporary folder: MuJoCo writes MUJOCO_LOG.TXT into the present one."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        yield


def interleaved(tasks: Mapping[str, Task], blocks: int, calls: int) -> dict[str, np.ndarray]:
    """Return seconds per call of every task in every block, shape (blocks,).

    The tasks alternate (A B C A B C ...), after one warm-up round.
    """
    rounds = {name: np.zeros(blocks + 1) for name in tasks}
    for block in range(blocks + 1):
        for name, task in tasks.items():
            start = time.process_time()
            for _ in range(calls):
                task()
            rounds[name][block] = (time.process_time() - start) / calls
    return {name: seconds[1:] for name, seconds in rounds.items()}


def ratio(seconds: np.ndarray, unit: np.ndarray) -> str:
    """Return the median of the blocks' ratios and their range, for printing."""
    ratios = seconds / unit
    return f"{np.median(ratios):8.2f}   ({ratios.min():.2f} .. {ratios.max():.2f})"


def shortened(scenario: cp.Scenario, duration: float) -> cp.Scenario:
    """Return the scenario with another duration; without its events if the duration changes."""
    return scenario if duration == scenario.duration else scenario.replace(duration=duration, events=())
