"""Controller of a scenario: the laws that it names with its gains, or a user's class."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np

from coop_pin.arrays import Array, as_array
from coop_pin.control import (
    ArmController,
    CellController,
    DecentralisedController,
    PayloadSpaceController,
    Posture,
    RedundantSlidingModeController,
    SlidingModeController,
    ZeroedController,
)
from coop_pin.control.terms import gain_matrix
from coop_pin.description.controller import (
    Law,
    NoForcePath,
    PayloadSpace,
    PostureGains,
    RedundantSlidingMode,
    SlidingMode,
    UserController,
)
from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError
from coop_pin.model.arm_model import ArmModel
from coop_pin.schema.user_code import load_class
from coop_pin.spatial import weight_wrench
from coop_pin.spatial.task_rows import joint_shortage


def build_controller(scenario: Scenario, models: Mapping[str, ArmModel] | None = None) -> CellController:
    """Return the controller that a scenario names.

    Args:
        scenario: its controller.
        models: of its arms, by name, when they are there already.

    Raises:
        FieldError: the law does not fit an arm's number of joints; a gain does not fit its arm.
        NameNotFoundError: a user's module or class does not exist.
    """
    chosen = scenario.controller
    if isinstance(chosen, UserController):
        return _users_controller(scenario, chosen)
    models = {} if models is None else models
    laws = {name: _arm_controller(scenario, chosen, name, models.get(name)) for name in scenario.cell.arms}
    if chosen.zero_at_grasp:
        rows, X_start = scenario.cell.task_rows, scenario.start.matrix
        laws = {name: ZeroedController(rows, law, X_start) for name, law in laws.items()}
    return DecentralisedController(laws)


def _arm_controller(scenario: Scenario, law: Law, arm: str, model: ArmModel | None) -> ArmController:
    """Return the law of one arm, its matrix gains sized for the arm's joints or the cell's task rows."""
    rows, model = scenario.cell.task_rows, model or ArmModel(scenario.cell.arms[arm])
    k_0, k = rows.size, model.nv
    _require_joints(law, arm, k, k_0)
    sizes = {"pose_gain": k_0, "sliding_gain": k_0, "sign_gain": k, "damping_gain": k}
    if isinstance(law, PayloadSpace):
        sizes["sign_gain"] = k_0
    own = arm in law.arm_gains
    gains, path = (law.arm_gains[arm], f"arm_gains.{arm}") if own else (law.gains, "gains")
    common: dict[str, Any] = {"rows": rows, "period": scenario.clock.period, "switching": law.switching}
    for name, gain in gains:
        common[name] = gain_matrix(gain, sizes[name], f"controller.{path}.{name}") if name in sizes else gain
    if isinstance(law, PayloadSpace):
        posture = _posture(scenario, law.posture, arm, model) if k > k_0 else None
        common["leak"] = _leak(law, arm, scenario.clock.period)
        return PayloadSpaceController(
            load_share=scenario.cell.share(arm),
            payload_weight=_payload_weight(scenario, law.payload_mass),
            stale_after=law.stale_after + _oldest_in_time(scenario),
            posture=posture,
            **common,
        )
    printed = SlidingModeController(**common)
    if isinstance(law, RedundantSlidingMode):
        posture = _posture(scenario, law.posture, arm, model)
        return RedundantSlidingModeController(printed, posture, law.inverse_damping)
    return printed


def _leak(law: PayloadSpace, arm: str, period: float) -> float:
    """Return lambda of an arm, with lambda T at most 1: beyond, the integral would overshoot its goal."""
    leak = law.leak_of(arm)
    if leak * period > 1.0:
        raise FieldError(
            f"is {leak:g} /s; at {1.0 / period:g} Hz it can be at most {1.0 / period:g}: state a smaller one",
            "controller.gains.leak",
        )
    return leak


def _oldest_in_time(scenario: Scenario) -> int:
    """Return the age that measured wrenches reach without being lost, ticks."""
    path = scenario.controller.force_path
    delay = 0 if isinstance(path, NoForcePath) else path.delay
    return delay + max((wrist.delay + wrist.every - 1 for wrist in scenario.wrists), default=0)


def _payload_weight(scenario: Scenario, mass: float | None) -> Array | None:
    """Return the weight of a payload of this mass as a wrench about P, on the task rows; None without one."""
    if mass is None:
        return None
    return scenario.cell.task_rows.select(weight_wrench(mass, scenario.cell.gravity))


def _require_joints(law: Law, arm: str, joints: int, rows: int) -> None:
    """Refuse an arm with too few joints for the task rows, or too many for the printed law."""
    if joints < rows:
        needs, counts = "at least", joint_shortage(joints, rows)
    elif isinstance(law, SlidingMode) and joints > rows:
        remedy = "choose 'sliding-mode-redundant' or 'payload-space'"
        needs, counts = "exactly", f"{joints} joints, {rows} task rows: {remedy}"
    else:
        return
    raise FieldError(
        f"is {law.kind!r}, which needs {needs} as many joints as task rows; arm {arm!r} has {counts}",
        "controller.kind",
    )


def _posture(scenario: Scenario, gains: PostureGains, arm: str, model: ArmModel) -> Posture:
    """Return the posture term of a redundant arm: a spring towards ``Arm.posture``, and a damper."""
    if model.nq != model.nv:
        raise FieldError(
            f"needs angles, but arm {arm!r} has continuous joints (nq {model.nq}, nv {model.nv}); "
            "lock them or give them limits",
            "controller.posture",
        )
    spring = as_array(f"posture of arm {arm!r}", scenario.cell.arms[arm].posture_angles(model.nv), model.nv)
    stiffness, damping = (
        np.array(gain_matrix(gain, model.nv, f"controller.posture.{name}").diagonal()) for name, gain in gains
    )
    return Posture(model.drive @ spring, stiffness, damping)


def _users_controller(scenario: Scenario, chosen: UserController) -> CellController:
    """Return the controller of a user's class.

    An ArmController is called as ``Class(scenario, arm, **options)`` for each arm, a CellController as
    ``Class(scenario, **options)``.

    Raises:
        FieldError: the class is neither, or it does not take the options.
        NameNotFoundError: there is no such module or class.
    """
    kind: Any = load_class(chosen.target)
    if not issubclass(kind, CellController | ArmController):
        detail = f"is {chosen.target!r}, which is neither an ArmController nor a CellController"
        raise FieldError(detail, "controller.target")
    of_cell = issubclass(kind, CellController)
    try:
        inspect.signature(kind).bind(scenario, *([] if of_cell else [""]), **chosen.options)
    except TypeError as error:
        call = "(scenario, **options)" if of_cell else "(scenario, arm, **options)"
        detail = f"do not fit {chosen.target!r}, which is called as {kind.__name__}{call}: {error}"
        raise FieldError(detail, "controller.options") from None
    if of_cell:
        return kind(scenario, **chosen.options)
    return DecentralisedController(
        {name: kind(scenario, name, **chosen.options) for name in scenario.cell.arms}
    )
