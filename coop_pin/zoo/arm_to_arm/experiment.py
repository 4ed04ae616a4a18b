"""Hand-over between the arms of one robot: what counts is where the hands are to each other."""

import numpy as np
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace, off_path

RELATIVE = "the relative pose counts, not the absolute one"
PASSES = "the object passes and is never without a holder"
OFF = {"exact": (), "both 12 mm off": ("left", "right"), "left 12 mm off": ("left",)}
"""Arms that see their base 12 mm off along the line between the hands."""


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Hand the box over as both arms move on, with exact bases, and with both or one off alike."""
    tolerance, weight = 1e3 * cell.events[1].tolerance, 9.81 * cell.cell.payload.mass
    numbers, curves = [], []
    for label, arms in list(OFF.items())[: 1 if short else 3]:
        bases = {f"cell.arms.{arm}.calibration_error.base.xyz": (0.012, 0.0, 0.0) for arm in arms}
        data = cp.run(cell.override(bases), warn=False).data
        time, P = data.time.values, data.payload_position.values
        turn = Rotation.from_quat(data.payload_quaternion.values).inv()
        tip = turn.apply(data.tip_position.values[:, 0] - P)
        gap = 1e3 * np.linalg.norm(tip - tip[0], axis=1)
        grasp, end = np.searchsorted(time, [cell.events[1].time, cell.events[2].end])
        curves.append(Trace(f"gap, {label}", time[:end], gap[:end]))
        limit = {"exact": {"most": tolerance}, "left 12 mm off": {"least": tolerance}}.get(label, {})
        numbers.append(Measured(RELATIVE, f"{label}: gap at the grasp", gap[grasp], "mm", **limit))
        off = 1e3 * off_path(data)
        if arms:
            numbers.append(Measured(RELATIVE, f"{label}: box off its path by then", off[:grasp].max(), "mm"))
            continue
        moved, up = 1e3 * np.linalg.norm(P - P[0], axis=1), -data.interaction_wrench.values[..., 2] / weight
        curves.append(Trace("way of the box", time[:end], moved[:end]))
        numbers += [
            Measured(RELATIVE, "box moved on meanwhile by", moved[grasp], "mm", least=5 * tolerance),
            Measured(PASSES, "both hands bear at least", 100 * up.sum(1).min(), "%", least=50.0),
            Measured(PASSES, "right hand bears at the end", 100 * abs(up[-1, 1]), "%", most=1.0),
            Measured(PASSES, "box off its path at most", off.max(), "mm", most=tolerance),
        ]
    return numbers, curves
