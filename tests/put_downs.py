"""A payload that two palms put down on a table."""

from __future__ import annotations

import coop_pin as cp
from coop_pin.base.spatial import make_pose, rotation_from_rpy


def put_down(turn: tuple[float, float, float], **changes) -> cp.Scenario:
    """A crate between two palms, a bit above a table that is 2 mm too high, and is turned with the cell."""
    X = make_pose((0.1, -0.2, 0.3), turn)
    scenario = cp.Scenario.load("two-pandas-palms")

    def placed(pose: cp.Pose) -> dict:
        moved = cp.Pose.from_matrix(X @ pose.matrix)
        return {"xyz": moved.xyz, "rpy": moved.rpy}

    arms = {f"cell.arms.{name}.base": placed(arm.base) for name, arm in scenario.cell.arms.items()}
    above, goal = (placed(cp.Pose(xyz=(0.0, 0.0, z))) for z in (0.5, 0.4965))
    table = placed(cp.Pose(xyz=(0.0, 0.0, 0.3985))) | {"size": (1.0, 0.8), "mu": 0.4}
    line = {"kind": "line", "start": above, "goal": goal, "duration": 0.2}
    gravity = tuple(rotation_from_rpy(turn) @ (0.0, 0.0, -9.81))
    moved = {"cell.gravity": gravity, "cell.tables": {"bench": table}, "motion": line, "start": above}
    event = {"kind": "put-down", "time": 0.25, "duration": 0.1}
    law = {"controller.anchor_bias": "none", "events": (event,), "duration": 0.45}
    law["controller.gain_axes"] = "payload"  # K has 8 N m s about the line of the palms, 100 across it
    return scenario.override(arms | moved | law | changes)
