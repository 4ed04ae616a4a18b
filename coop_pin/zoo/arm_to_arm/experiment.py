"""Hand-over between the arms of one robot: what counts is where the hands are to each other."""

import numpy as np
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace, off_path

RELATIVE = "the relative pose counts, not the absolute one"
PASSES = "the object passes and is never without a holder"
PUSH = cp.events.WrenchPulse(time=1.7, duration=0.15, wrench=(0.0, 0.0, -5.0, 0.0, 0.0, 0.0))


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Hand the box over as both arms move on, and as a push displaces it in the hand that holds it."""
    tolerance, weight = 1e3 * cell.events[1].tolerance, 9.81 * cell.cell.payload.mass
    numbers, curves = [], []
    for label in ("moved on",) if short else ("moved on", "pushed in the hand"):
        events = cell.events if label == "moved on" else (*cell.events, PUSH)
        data = cp.run(cell.override({"events": events}), warn=False).data
        time, P = data.time.values, data.payload_position.values
        turn = Rotation.from_quat(data.payload_quaternion.values).inv()
        tip = turn.apply(data.tip_position.values[:, 0] - P)
        gap = 1e3 * np.linalg.norm(tip - tip[0], axis=1)
        grasp, end = np.searchsorted(time, [cell.events[1].time, cell.events[2].end])
        curves.append(Trace(f"gap of the left hand, {label}", time[:end], gap[:end]))
        if label == "moved on":
            moved = 1e3 * float(np.linalg.norm(P[grasp] - P[0]))
            up = -data.interaction_wrench.values[..., 2] / weight
            off = 1e3 * off_path(data).max()
            curves.append(Trace("way of the box", time[:end], 1e3 * np.linalg.norm(P - P[0], axis=1)[:end]))
            numbers += [
                Measured(RELATIVE, "box moved on meanwhile by", moved, "mm", least=5 * tolerance),
                Measured(RELATIVE, "gap at the grasp, moved on", gap[grasp], "mm", most=tolerance),
                Measured(PASSES, "both hands bear at least", 100 * up.sum(1).min(), "%", least=50.0),
                Measured(PASSES, "right hand bears at the end", 100 * abs(up[-1, 1]), "%", most=1.0),
                Measured(PASSES, "box off its path at most", off, "mm", most=tolerance),
            ]
        else:
            numbers.append(Measured(RELATIVE, "gap at the grasp, pushed", gap[grasp], "mm", least=tolerance))
    return numbers, curves
