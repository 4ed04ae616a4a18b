"""Names in scenarios become controller objects here, users' own ``module:Class`` included."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from coop_pin.control import (
    ArmController,
    CellController,
    PayloadSpaceController,
    Posture,
    RedundantSlidingModeController,
    Saturation,
    Sign,
    SlidingModeController,
    Switching,
    Tanh,
)
from coop_pin.control.interface import DecentralisedController
from coop_pin.description import controller as choice
from coop_pin.description import switching
from coop_pin.description.gains import PostureGains, gain_matrix
from coop_pin.description.scenario import Scenario
from coop_pin.description.switching import Switching as SwitchingChoice
from coop_pin.errors import FieldError, NameNotFoundError
from coop_pin.model.arm_model import ArmModel


def build_controller(scenario: Scenario) -> CellController:
    """Return the controller that a scenario names.

    Raises:
        FieldError: a gain does not fit its arm.
        NameNotFoundError: a user's module or class does not exist.
    """
    chosen = scenario.controller
    if isinstance(chosen, choice.UserController):
        return _users_controller(scenario, chosen)
    return DecentralisedController(
        {name: _arm_controller(scenario, chosen, name) for name in scenario.cell.arms}
    )


def _arm_controller(scenario: Scenario, chosen: choice.Prescribed, arm: str) -> ArmController:
    path = f"controller.{'arm_gains.' + arm if arm in chosen.arm_gains else 'gains'}"
    rows, model = scenario.cell.task_rows, ArmModel(scenario.cell.arms[arm])
    _require_joints(chosen, arm, model.nv, rows.size)
    gains = chosen.gains_of(arm)
    common: dict[str, Any] = {
        "rows": rows,
        "period": scenario.clock.period,
        "pose_gain": gain_matrix(gains.pose_gain, rows.size, f"{path}.pose_gain"),
        "force_gain": gains.force_gain,
        "transient_rate": gains.transient_rate,
        "switching": _switching(chosen.switching),
    }
    if isinstance(chosen, choice.PayloadSpace):
        return PayloadSpaceController(
            load_share=float(scenario.cell.shares[list(scenario.cell.arms).index(arm)]),
            sliding_gain=gain_matrix(chosen.gains_of(arm).sliding_gain, rows.size, f"{path}.sliding_gain"),
            sign_gain=gain_matrix(gains.sign_gain, rows.size, f"{path}.sign_gain"),
            posture=_posture(scenario, chosen.posture, arm, model) if model.nv > rows.size else None,
            **common,
        )
    common["sign_gain"] = gain_matrix(gains.sign_gain, model.nv, f"{path}.sign_gain")
    common["damping_gain"] = gain_matrix(chosen.gains_of(arm).damping_gain, model.nv, f"{path}.damping_gain")
    printed = SlidingModeController(**common)
    if isinstance(chosen, choice.RedundantSlidingMode):
        return RedundantSlidingModeController(
            printed, _posture(scenario, chosen.posture, arm, model), chosen.inverse_damping
        )
    return printed


def _require_joints(chosen: choice.Prescribed, arm: str, joints: int, rows: int) -> None:
    """Refuse an arm with too few joints for the task rows, or too many for the printed law."""
    if joints < rows or (isinstance(chosen, choice.SlidingMode) and joints != rows):
        wanted = "exactly as many" if isinstance(chosen, choice.SlidingMode) else "at least as many"
        detail = f"is {chosen.kind!r}, which needs {wanted} joints as task rows; arm {arm!r} has {joints} joints and the cell {rows} rows"
        raise FieldError(
            f"{detail}. For more joints choose 'sliding-mode-redundant' or 'payload-space'", "controller.kind"
        )


def _posture(scenario: Scenario, gains: PostureGains, arm: str, model: ArmModel) -> Posture:
    """Return the posture term of a redundant arm: a spring towards the posture that its description states."""
    if model.nq != model.nv:
        detail = f"needs angles, but arm {arm!r} has continuous joints (nq {model.nq}, nv {model.nv}); lock one or give limits"
        raise FieldError(detail, "controller.posture")
    angles = scenario.cell.arms[arm].posture
    spring = np.zeros(model.nv) if angles is None else np.array(angles)
    stiffness, damping = (
        np.broadcast_to(np.array(gain, dtype=float), (model.nv,)) for gain in (gains.stiffness, gains.damping)
    )
    return Posture(model.drive @ spring, stiffness, damping)


def _switching(chosen: SwitchingChoice) -> Switching:
    match chosen:
        case switching.Saturation():
            return Saturation(chosen.width)
        case switching.Tanh():
            return Tanh(chosen.width)
        case _:
            return Sign()


def _users_controller(scenario: Scenario, chosen: choice.UserController) -> CellController:
    """Call ``Class(scenario, arm, **options)`` for an ArmController, ``Class(scenario, **options)`` for a CellController."""
    kind = _users_class(chosen.target)
    if issubclass(kind, CellController):
        return kind(scenario, **chosen.options)
    if issubclass(kind, ArmController):
        return DecentralisedController(
            {name: kind(scenario, name, **chosen.options) for name in scenario.cell.arms}
        )
    raise FieldError(
        f"is {chosen.target!r}, which is neither an ArmController nor a CellController", "controller.target"
    )


def _users_class(target: str) -> Any:
    module_name, _, class_name = target.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise NameNotFoundError("module", module_name, [], f"the Python path ({error})") from None
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type):
        raise NameNotFoundError(
            "class",
            class_name,
            [name for name in dir(module) if name[0].isupper()],
            f"module {module_name!r}",
        )
    return kind
