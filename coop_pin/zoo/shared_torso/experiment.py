"""Shared torso: two arms carry a tray along its path while the torso under both of them rises."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace, off_path, off_squeeze

ABSOLUTE, HELD = "absolute and relative motion describe the task", "the held object's constraint is kept"
RUNS: dict[str, dict[str, Any]] = {
    "torso rises": {},
    "torso stands": {"cell.shared_joints.torso_lift_joint": {}},
    "left arm told 1 ms late": {"arm_sensors": {"left": {"shared_joints": {"delay": 1}}}},
}


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Carry the tray with a torso that rises, one that stands, and one of which an arm knows late."""
    numbers, curves = [], []
    for label in list(RUNS)[: 1 if short else 3]:
        run = cp.run(cell.override(RUNS[label] | {"duration": 1.5 if short else 4.5}), warn=False)
        begun = run.data.time.values >= 0.5  # the motion; the squeeze is taken up before
        off, force = 1e3 * off_path(run.data)[begun].max(), off_squeeze(run.data)[begun]
        curves.append(Trace(label, run.data.time.values[begun], force))
        most = np.inf if "late" in label else 1.0
        numbers += [
            Measured(ABSOLUTE, f"{label}: tray off its path", off, "mm"),
            Measured(HELD, f"{label}: internal force off", force.max(), "N", most=most),
        ]
        if label == "torso rises":
            closure = 1e6 * run.metrics()["closure_error_max_m"]
            rise = np.ptp(run.data.shared_position.values)
            numbers += [
                Measured(HELD, "torso moved by", rise, "m", least=0.01 if short else 0.2),
                Measured(HELD, "grasps apart at most", closure, "um"),
            ]
    return numbers, curves
