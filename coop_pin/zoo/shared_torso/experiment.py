"""Shared torso: two arms carry a tray along its path while the torso under both of them rises."""

from pathlib import Path
from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace

CELL = cp.Scenario.load(Path(__file__).with_name("cell.toml"))
ABSOLUTE, HELD = "absolute and relative motion describe the task", "the held object's constraint is kept"
RUNS: dict[str, dict[str, Any]] = {
    "torso rises": {},
    "torso stands": {"cell.shared_joints.torso_lift_joint": {}},
    "left arm told 1 ms late": {"arm_sensors": {"left": {"shared_joints": {"delay": 1}}}},
}


def reproduce(*, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Carry the tray with a torso that rises, one that stands, and one of which an arm is told late."""
    numbers, curves = [], []
    for label in list(RUNS)[: 1 if short else 3]:
        run = cp.run(CELL.override(RUNS[label] | {"duration": 1.5 if short else 4.5}), warn=False)
        begun = run.data.time.values >= 0.5  # the motion; the squeeze is taken up before
        off = 1e3 * np.linalg.norm(run.data.pose_error.values[:, :3], axis=1)
        apart = run.data.internal_wrench.values - run.data.desired_internal_wrench.values
        force = np.linalg.norm(apart[..., :3], axis=-1).max(axis=1)
        curves.append(Trace(label, run.data.time.values[begun], force[begun]))
        limits = {} if "late" in label else {"most": 1.0}
        numbers.append(Measured(ABSOLUTE, f"{label}: tray off its path", off[begun].max(), "mm", **limits))
        numbers.append(Measured(HELD, f"{label}: internal force off", force[begun].max(), "N", **limits))
        if label == "torso rises":
            closure = 1e6 * run.metrics()["closure_error_max_m"]
            rise = np.ptp(run.data.shared_position.values)
            numbers.append(Measured(ABSOLUTE, "torso moved by", rise, "m", least=0.01 if short else 0.2))
            numbers.append(Measured(HELD, "grasps apart at most", closure, "um", most=1.0))
    return numbers, curves
