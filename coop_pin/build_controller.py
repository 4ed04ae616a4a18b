"""Controller of a scenario, built by the law that it names."""

from __future__ import annotations

import numpy as np

from coop_pin.control import CellController
from coop_pin.control.interface import ControlledArm
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmModel


def build_controller(scenario: Scenario) -> CellController:
    """Return the controller that a scenario names.

    Raises:
        FieldError: the law does not fit an arm's number of joints; a gain does not fit its arm.
        NameNotFoundError: a user's module or class does not exist.
    """
    arms = (controlled_arm(scenario, name) for name in scenario.cell.arms)
    return scenario.controller.build(scenario, arms)


def controlled_arm(scenario: Scenario, name: str) -> ControlledArm:
    """Return what a law may know of an arm besides measurements."""
    cell, path = scenario.cell, scenario.controller.force_path
    model = ArmModel(cell.arms[name], name=name)
    posture = model.drive @ model.posture(cell.arms[name].posture) if model.nq == model.nv else None
    return ControlledArm(
        name=name,
        leads=name == next(iter(cell.arms)),
        rows=cell.task_rows,
        period=scenario.clock.period,
        load_share=cell.share(name),
        drives=model.nv,
        posture=posture,
        gravity=np.array(cell.gravity),
        start_pose=scenario.start.matrix,
        oldest_wrench=path.delay
        + max((wrist.delay + wrist.every - 1 for wrist in scenario.wrists), default=0),
        base_drives=model.base_joints,
        way_out=cell.way_out(name) if name in cell.patches else None,
    )
