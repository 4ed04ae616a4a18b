"""Event-triggered messages: two arms send each other what changed, and hold a box as if they sent all."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace, off_path

RATES = (250.0, 125.0, 62.5)
FEWER = "fewer messages than its baselines"
PRECISE = "more precise than its baselines"


def carried(cell: cp.Scenario, changes: dict[str, Any]) -> tuple[Array, Array, Array, float]:
    """Return times, bytes sent by then, position error, m, and rms error of the internal force, N."""
    data = cp.run(cell, changes, warn=False).data
    off = np.hypot(data.internal_axial_error.values, data.internal_shear_error.values)
    sent = data.bytes_sent.values.sum(axis=1)
    return data.time.values, sent, off_path(data), float(np.sqrt(np.mean(off**2)))


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Carry the box with messages upon events, at every tick, and at lower rates."""
    time, upon, error, force = carried(cell, {})
    _, every, error_0, force_0 = carried(cell, {"network": {}})
    curves = [Trace("events", time, 1e-3 * upon), Trace("every tick", time, 1e-3 * every)]
    fewest, part, worst = every[-1], 100 * upon[-1] / every[-1], error.max() / error_0.max()
    for rate in () if short else RATES:
        _, sent, error_r, force_r = carried(cell, {"network": {"rate_hz": rate}})
        curves.append(Trace(f"{rate:g} Hz", time, 1e-3 * sent, dashed=True))
        if error_r.max() <= 1.1 * error_0.max() and force_r <= 1.1 * force_0:
            fewest = sent[-1]
    slowest = Measured(FEWER, "over those of the slowest rate as precise", upon[-1] / fewest)
    return [
        Measured(FEWER, "bytes, part of those at every tick", part, "%"),
        *(() if short else (slowest,)),
        Measured(PRECISE, "largest position error over every tick's", worst),
        Measured(PRECISE, "internal-force error over every tick's", force / force_0),
    ], curves
