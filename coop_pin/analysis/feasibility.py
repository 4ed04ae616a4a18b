"""Feasibility of a motion: rank, reach, singularity, limits, static torques, and the squeeze beside them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coop_pin.analysis.reachability import Reachability
from coop_pin.analysis.statics import StaticTorques
from coop_pin.description.scenario import Scenario
from coop_pin.errors import InfeasibleMotionError
from coop_pin.model.arm_model import ArmModel
from coop_pin.spatial.task_rows import joint_shortage

_TORQUE_PART = 0.9
"""Part of the torque limit that holding may need: the rest is for the motion and its control."""


def require_rank(scenario: Scenario) -> None:
    """Refuse an arm with fewer joints than task rows.

    Raises:
        InfeasibleMotionError: cause "rank".
    """
    for name in scenario.cell.arms:
        joints, rows = ArmModel.from_cell(scenario.cell, name).nv, scenario.cell.task_rows.size
        if joints < rows:
            raise InfeasibleMotionError("rank", f"arm {name!r} has {joint_shortage(joints, rows)}")


def require_feasible(scenario: Scenario, found: Reachability, statics: StaticTorques) -> None:
    """Refuse a motion that the arms cannot follow on their best branches, or cannot hold.

    Raises:
        InfeasibleMotionError: cause "reach", "singularity", "limits" or "torque".
    """
    allowed = scenario.trust.jacobian_condition
    for reach in found.arms:
        detail = f"arm {reach.arm!r} {'; '.join(reach.problems())}"
        if reach.start_error is not None or reach.unreachable is not None:
            raise InfeasibleMotionError("reach", detail)
        if float(reach.condition.max()) > allowed:
            worst = f"condition number {float(reach.condition.max()):.3g} (trustworthy up to {allowed:g})"
            raise InfeasibleMotionError("singularity", f"arm {reach.arm!r} passes a pose of {worst}")
        if not reach.ok:
            raise InfeasibleMotionError("limits", detail)
    for arm in statics.arms:
        used = np.abs(arm.weight + arm.load) / arm.limit
        if float(used.max()) > _TORQUE_PART:
            at, k = np.unravel_index(int(used.argmax()), used.shape)
            raise InfeasibleMotionError(
                "torque",
                f"{arm.arm}/{arm.joints[k]} needs {used[at, k] * arm.limit[k]:.3g} of {arm.limit[k]:.3g}"
                f" {arm.units[k]} to stand still at t = {arm.times[at]:.4g} s without squeeze: arm's weight"
                f" {abs(arm.weight[at, k]):.3g}, load share {abs(arm.load[at, k]):.3g}; at most"
                f" {_TORQUE_PART:g} of the limit leaves room for the motion. Lower the payload's mass",
            )


def squeeze_part(statics: StaticTorques) -> float:
    """Return the largest part of the squeeze, at most 1, that the drives can hold beside weight and load."""
    part = 1.0
    for arm in statics.arms:
        holding = np.copysign(arm.weight + arm.load, (arm.weight + arm.load) * arm.squeeze)
        with np.errstate(divide="ignore", invalid="ignore"):
            held = (_TORQUE_PART * arm.limit - holding) / np.abs(arm.squeeze)
        held = np.where(arm.squeeze == 0.0, np.inf, held)
        part = min(part, float(held.min()))
    return part if part == 1.0 else math.floor(100.0 * part) / 100.0


def scaled_squeeze(squeeze: Any, part: float) -> Any:
    """Return a squeeze times a part.

    Raises:
        InfeasibleMotionError: it is a function, which cannot be scaled.
    """
    if part == 1.0:
        return squeeze
    tables = {
        name: value for name in ("wrenches", "start", "goal") if (value := getattr(squeeze, name, None))
    }
    fields: dict[str, Any] = {
        name: {arm: tuple(part * np.array(wrench)) for arm, wrench in table.items()}
        for name, table in tables.items()
    }
    if hasattr(squeeze, "force"):
        fields["force"] = part * squeeze.force
    if not fields:
        raise InfeasibleMotionError(
            "torque", f"the drives can hold {part:g} of the squeeze; scale its function"
        )
    return squeeze.replace(**fields)
