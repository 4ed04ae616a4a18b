"""Cells of which one arm holds the payload and the other has a tool beside it."""

from __future__ import annotations

import numpy as np

import coop_pin as cp
from coop_pin.base.spatial import inverse_pose

NAMES = {"planar": "adept-anchored", "spatial": "two-pandas-box"}
RATES = {"planar": 200.0, "spatial": 1000.0}


def two_things(cell: str, *, rho: float = 1.0, motion=None, **changes) -> cp.Scenario:
    """A cell of the catalogue whose right arm has a tool, carried by its robots, without friction."""
    base = cp.Scenario.load(NAMES[cell])
    grasp = {"kind": "tool", "motion": motion, **base.cell.grasps["right"].model_dump()}
    grasps = base.cell.model_dump()["grasps"] | {"right": grasp}
    fields = base.model_dump() | {"cell": base.cell.model_dump() | {"grasps": grasps}, "events": ()}
    law = {"kind": "symmetric", "relative_gain": rho, "gains": base.controller.gains.model_dump()}
    still = {"motion": {"kind": "hold", "pose": base.start.model_dump()}, "squeeze": {}, "controller": law}
    frictionless = {f"cell.arms.{arm}.friction": "none" for arm in base.cell.arms}
    light = {"actuators.gravity_compensation": {}, "cell.payload.mass": 0.5}
    inertia = {"cell.payload.inertia": [0.002, 0.004, 0.005, 0.0, 0.0, 0.0]}
    clock = {"clock.rate_hz": RATES[cell], "clock.steps_per_tick": 2}
    free = {"sensors.wrist": None} if base.sensors.wrist is not None else {}
    scenario = cp.Scenario(**fields | still)
    return scenario.override(frictionless | light | inertia | clock | free | changes)


def with_gains(scenario: cp.Scenario, **gains) -> cp.Scenario:
    """The scenario with gains of single arms, some of them replaced."""
    suggested = cp.suggest(scenario, poses=5).scenario
    changes = {
        f"controller.arm_gains.{arm}.{name}": x for arm in scenario.cell.arms for name, x in gains.items()
    }
    changes |= {f"controller.gains.{name}": x for name, x in gains.items()}
    return suggested.override(changes)


def tool_pose(result) -> np.ndarray:
    """X_PE of the right arm's tip at the end of a run, by Pinocchio on its configuration."""
    import pinocchio as pin

    from coop_pin.grasps.cell_chain import CellChain

    scenario = result.scenario
    model = CellChain(scenario.cell, scenario.plant).model
    data = model.model.createData()
    pin.framesForwardKinematics(model.model, data, result.data.configuration.values[-1])
    tip = data.oMf[model.model.getFrameId("right/grasp")].homogeneous
    return inverse_pose(data.oMf[model.payload_frame].homogeneous) @ tip
