"""Controller of a scenario, built by the law that it names."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import as_array, typed
from coop_pin.base.errors import FieldError
from coop_pin.control import CellController, ControlledArm, FeedForwardController
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmModel


@typed
def build_controller(scenario: Scenario) -> CellController:
    """Return the controller that a scenario names.

    Raises:
        FieldError: the law does not fit an arm's number of joints; a gain or a feed-forward does not fit its
            arm.
        NameNotFoundError: a user's module or class does not exist.
    """
    cell, law = scenario.cell, scenario.controller
    if cell.jointed:
        _require_grasp_rows(scenario)
    if cell.payload.links is not None:
        _require_no_body(scenario)
    if cell.tools and not (law.works_apart or law.user_code):
        detail = f"is {law.kind!r}, but the tips of {list(cell.tools)} are tools, beside what the others hold"
        raise FieldError(f"{detail}; choose 'symmetric' or 'payload-space'", "controller.kind")
    arms = [controlled_arm(scenario, ArmModel(arm, name=name)) for name, arm in cell.arms.items()]
    built, added = law.build(scenario, arms), scenario.feed_forward
    if added is None:
        return built
    for arm, torque in zip(arms, added.at(added.times[-1]), strict=True):
        if len(torque) != arm.drives:
            detail = f"has {len(torque)} torques in a row; the arm has {arm.drives} drives"
            raise FieldError(detail, f"feed_forward.torques.{arm.name}")
        if built.commands_of(arm.name) != "torque":
            detail = f"adds torques, but the law commands {built.commands_of(arm.name)!r} to arm {arm.name!r}"
            raise FieldError(detail, "feed_forward")
    return FeedForwardController(built, lambda time, _: added.at(time))


def _require_no_body(scenario: Scenario) -> None:
    """Refuse laws and force paths that take a payload of several links for one body, or a free one.

    Raises:
        FieldError: with the law or the path.
    """
    law, path = scenario.controller, scenario.controller.force_path
    if {"model", "regressor"} & {*law.needs}:
        detail = f"is {law.kind!r}, whose model has a payload of one body, and this one has several links"
        raise FieldError(detail, "controller.kind")
    if not scenario.cell.splits_load:
        return
    if "own wrench" in law.needs:
        detail = "is for arms that share the weight, and a payload with a base hangs on its joint; leave it"
        raise FieldError(f"{detail} out and state a force path", "controller.payload_mass")
    if path.measures and not path.by_sensors:
        detail = f"is {path.kind!r}, which splits by load shares; beside a base choose 'late' or 'low-pass'"
        raise FieldError(detail, "controller.force_path.kind")


def _require_grasp_rows(scenario: Scenario) -> None:
    """Refuse laws and force paths that know no rows of grasps.

    Raises:
        FieldError: with the law or the path.
    """
    law, path = scenario.controller, scenario.controller.force_path
    which = f"grasps of {list(scenario.cell.jointed)} are joints"
    if not (law.controls_grasps or law.user_code):
        remedy = "choose 'payload-space', or 'sliding-mode-redundant' for arms with joints to spare"
        raise FieldError(
            f"is {law.kind!r}, but {which}, whose rows it does not control; {remedy}", "controller.kind"
        )
    if path.measures and not path.by_sensors:
        detail = f"is {path.kind!r}, which splits by load shares, but {which}; choose 'late' or 'low-pass'"
        raise FieldError(detail, "controller.force_path.kind")


def controlled_arm(scenario: Scenario, model: ArmModel) -> ControlledArm:
    """Return the numbers of an arm that a law may know, apart from measurements."""
    cell, name = scenario.cell, model.name
    stated = cell.arms[name].posture
    angles = [0.0] * model.nv if stated is None else stated
    posture = model.drive @ as_array(f"posture of arm {name!r}", angles, model.nv)
    return ControlledArm(
        name=name,
        leads=name == next(iter(cell.arms)),
        rows=cell.task_rows,
        period=scenario.clock.period,
        load_share=float(cell.gain_shares[list(cell.arms).index(name)]),
        drives=model.nv,
        posture=posture,
        gravity=np.array(cell.gravity),
        start_pose=scenario.start.matrix,
        oldest_wrench=scenario.oldest_wrench,
        base_drives=model.base_joints,
        way_out=cell.way_out(name) if name in cell.patches else None,
        grasp=cell.grasp_rows(name) if name in cell.jointed else None,
        pressed=name in cell.patches or cell.is_pulled,
    )
