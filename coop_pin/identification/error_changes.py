"""Errors of a log as changes: those of a scenario with which its run has the errors that a log shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from coop_pin.description.scenario import Scenario
from coop_pin.identification.estimate import Parameter
from coop_pin.identification.payload import HAND_AXES, hand_columns
from coop_pin.identification.views import FRAME_AXES
from coop_pin.model.cell_arm import CellArm


def error_changes(
    scenario: Scenario, values: Mapping[Parameter, float], *, noise: bool = True
) -> dict[str, Any]:
    """Return changes by dotted path: errors of the arms' models, zeros of wrists, clocks, load shares.

    The weight of a hand is a zero of its wrist, as at the start.

    Args:
        scenario: cell and law, whose own errors of the arms' models are replaced.
        values: errors by parameter; those left out are zero.
        noise: whether counts, noise and gains of the sensors are kept.
    """
    known = {(one.arm, one.part, one.axis): value for one, value in values.items()}
    changes: dict[str, Any] = {}
    has_wrists = any(one.part in ("wrist", "hand") for one in values)
    for name in scenario.cell.arms:
        arm = CellArm(scenario.cell, name)
        joints = [one.removeprefix("arm/") for one in arm.limits.joints.names]

        def row(part: str, axes: Any, name: str = name) -> list[float]:
            return [known.get((name, part, axis), 0.0) for axis in axes]

        frames = {
            part: {"xyz": row(part, FRAME_AXES[:3]), "rpy": row(part, FRAME_AXES[3:])}
            for part in ("tip", "base")
        }
        rows = {"joint_offset": row("joint", joints), "link_length": row("link", joints)}
        changes[f"cell.arms.{name}.calibration_error"] = frames | rows
        sensors = scenario.sensors_of(name).model_dump(exclude_none=True) if noise else {}
        R_WE = scenario.start.matrix[:3, :3] @ arm.X_PE[:3, :3]
        weight = hand_columns(R_WE[None], np.array(scenario.cell.gravity))[0] @ row("hand", HAND_AXES)
        zero = (weight + row("wrist", FRAME_AXES)).tolist()
        offset = {"force": zero[:3], "moment": zero[3:]}
        if has_wrists:
            sensors["wrist"] = sensors.get("wrist", {}) | {"offset": offset}
        if has_wrists or not noise:
            changes[f"arm_sensors.{name}"] = sensors
    if shares := {one.arm: value for one, value in values.items() if one.part == "load share"}:
        changes["cell.load_shares"] = shares
    clocks = {one.arm: {"offset": value} for one, value in values.items() if one.part == "clock"}
    network: dict[str, Any] = (
        {} if scenario.network is None else scenario.network.model_dump(exclude_none=True)
    )
    if clocks:
        changes["network"] = network | {"clocks": clocks}
    return changes
