"""Hinged payload: two arms turn a gate, a bar and a box as hinges let them."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

FREE, APART = "the object moves along what the hinge leaves free", "no internal moment about the axis"
LEVEL = {"xyz": [0.0, 0.0, 0.4]}
TIPPED = {"start": LEVEL, "goal": LEVEL | {"rpy": [0.0, 0.2, 0.0]}, "start_time": 0.5, "duration": 2.0}
TIPS = {"motion": {"kind": "line"} | TIPPED, "duration": 3.0, "clock.steps_per_tick": 1}
PINS: dict[str, tuple[str, Any, tuple[float, ...]]] = {
    "bar": ("adept-hinges", {"duration": 8.0, "events": []}, (0.0, 0.0, 1.0)),
    "box": ("two-pandas-hinges", TIPS, (0.0, 1.0, 0.0)),
}


def about(data: Any, points: Array, axis: tuple[float, ...]) -> Array:
    """Return each arm's moment about an axis of the payload through a point, N m, shape (ticks, arms)."""
    F, P = np.nan_to_num(data.interaction_wrench.values), data.payload_position.values[:, None]
    turned = Rotation.from_quat(data.payload_quaternion.values).apply(axis)
    return np.einsum("tij,tj->ti", F[..., 3:] + np.cross(P - points, F[..., :3]), turned)


def gate(cell: cp.Scenario, seconds: float) -> tuple[Array, Array, float]:
    """Return times, and moments of both hands about the hinge, and the largest turn off the path, degrees."""
    changes = {"motion.duration": seconds, "duration": seconds + 2.0}
    data = cp.run(cell.override(changes), warn=False).data
    off = np.degrees(np.linalg.norm(data.pose_error.values[:, 3:], axis=1).max())
    return data.time.values, about(data, np.array(cell.motion.centre), (0.0, 0.0, 1.0)), float(off)


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Turn a gate slowly and fast; turn a bar and a box on pins, and with rigid grasps."""
    numbers, curves = [], []
    for seconds in (3.0,) if short else (7.0, 3.0):
        time, moments, off = gate(cell, seconds)
        turning, apart = np.abs(moments.sum(1)), np.abs(moments[:, 0] - moments[:, 1]) / 2
        label = f"gate in {seconds:g} s"
        part = 100 * apart.max() / turning.max()
        numbers += [
            Measured(FREE, f"{label}: turn off its path", off, "deg", most=1.0),
            Measured(APART, f"{label}: apart, of what turns it", part, "%"),
            Measured(APART, f"{label}: apart at rest", 100 * apart[-1] / turning.max(), "%"),
        ]
        curves += [
            Trace(f"{label}: of both", time, turning, dashed=True),
            Trace(f"{label}: apart", time, apart),
        ]
    for label, (name, changes, axis) in list(PINS.items())[: 1 if short else 2]:
        base = cp.Scenario.load(name).override(changes)
        rigid = {arm: {"xyz": grasp.xyz, "rpy": grasp.rpy} for arm, grasp in base.cell.grasps.items()}
        for grasps, held in {"pins": base, "rigid": base.override({"cell.grasps": rigid})}.items():
            data = cp.run(held, warn=False).data
            moment = np.abs(about(data, data.tip_position.values, axis)).max()
            numbers.append(Measured(APART, f"{label}, {grasps}: moment about an axis", moment, "N m"))
            if grasps == "pins":
                off = np.degrees(np.linalg.norm(data.pose_error.values[-1, 3:]))
                numbers.append(Measured(FREE, f"{label}: turn off its path at last", off, "deg", most=1.0))
    return numbers, curves
