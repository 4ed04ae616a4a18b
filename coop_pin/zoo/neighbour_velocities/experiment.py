"""Commanded velocities and neighbours' wrenches: three mobile arms relieve the plate that they carry."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace, off_squeeze

LINE = [["arm1", "arm2"], ["arm2", "arm1"], ["arm2", "arm3"], ["arm3", "arm2"]]
BASES = {"arm1": (0.01, 0.0, 0.0), "arm2": (0.0, -0.01, 0.0), "arm3": (-0.005, 0.005, 0.01)}
REDUCED = "local force sensors and neighbours reduce the interaction wrench"
LATE = "delays between robots are survived"
LOCAL = "no global position is needed"
MUTE: dict[str, Any] = {"sensors": {}, "network": None}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "ring": (REDUCED, {}),
    "line": (REDUCED, {"network.graph": LINE}),
    "20 ms late, 10 % lost": (LATE, {"network": {"graph": "ring", "delay": 10, "loss": 0.1}}),
    "bases seen 10 mm off": (
        LOCAL,
        {f"cell.arms.{arm}.calibration_error.base.xyz": off for arm, off in BASES.items()},
    ),
}


def residual(cell: cp.Scenario, changes: dict[str, Any]) -> tuple[Any, Any]:
    """Return times, and the largest error of an arm's internal force, N."""
    data = cp.run(cell, changes, warn=False).data
    return data.time.values, off_squeeze(data)


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Carry the plate without wrenches, and with them over graphs, late, and with bases that are off."""
    length = {"duration": 1.0} if short else {}
    time, alone = residual(cell, length | MUTE)
    last = time > time[-1] - 0.5
    numbers, curves = [], [Trace("no wrenches", time, alone, dashed=True)]
    for label, (claim, changes) in RUNS.items():
        if short and claim == LOCAL:  # 10 mm take longer than a second to let go
            continue
        force, reference = residual(cell, length | changes)[1], alone
        if claim == LOCAL:
            reference = residual(cell, changes | MUTE)[1]
            curves.append(Trace(f"no wrenches, {label}", time, reference, dashed=True))
        part, most = 100 * force[last].mean() / reference[last].mean(), np.inf if claim == LOCAL else 10.0
        numbers.append(Measured(claim, f"{label}: part of no wrenches", part, "%", most=most))
        if claim == LOCAL:
            halves = [(time > end - 0.5) & (time <= end) for end in np.arange(2.0, 4.5, 0.5)]
            worst = 100 * max(force[half].mean() / reference[half].mean() for half in halves)
            numbers.append(Measured(claim, "the same, worst half second from 1.5 s on", worst, "%"))
        curves.append(Trace(label, time, force))
    return numbers, curves
