"""Names in scenarios become controller objects here, users' own ``module:Class`` included."""

from __future__ import annotations

import importlib
from typing import Any

from coop_pin.control import ArmController, CellController, Saturation, Sign, SlidingModeController, Switching, Tanh
from coop_pin.control.team import Team
from coop_pin.description import controller as choice
from coop_pin.description.scenario import Scenario
from coop_pin.errors import EntryNotFoundError, FieldError
from coop_pin.model.arm_model import ArmModel


def build_controller(scenario: Scenario) -> CellController:
    """Return the controller that a scenario names.

    Raises:
        FieldShapeError: a gain does not fit its arm.
        EntryNotFoundError: a user's module or class does not exist.
    """
    chosen = scenario.controller
    if isinstance(chosen, choice.UserController):
        return _users_controller(scenario, chosen)
    return Team({name: _sliding_mode(scenario, chosen, name) for name in scenario.cell.arms})


def _sliding_mode(scenario: Scenario, chosen: choice.SlidingMode, arm: str) -> SlidingModeController:
    gains, rows = chosen.gains_of(arm), scenario.cell.task_rows
    joints = ArmModel(scenario.cell.arms[arm]).nv
    if joints != rows.size:
        detail = f"law (23) needs as many joints as task rows; arm {arm!r} has {joints} joints and the cell {rows.size} rows"
        raise FieldError(detail, "controller.kind")
    path = f"controller.{'arm_gains.' + arm if arm in chosen.arm_gains else 'gains'}"
    return SlidingModeController(
        rows=rows,
        period=scenario.clock.period,
        pose_gain=choice.gain_matrix(gains.pose_gain, rows.size, f"{path}.pose_gain"),
        sign_gain=choice.gain_matrix(gains.sign_gain, joints, f"{path}.sign_gain"),
        damping_gain=choice.gain_matrix(gains.damping_gain, joints, f"{path}.damping_gain"),
        force_gain=gains.force_gain,
        transient_rate=gains.transient_rate,
        switching=_switching(chosen.switching),
    )


def _switching(chosen: choice.Sign | choice.Saturation | choice.Tanh) -> Switching:
    match chosen:
        case choice.Saturation():
            return Saturation(chosen.width)
        case choice.Tanh():
            return Tanh(chosen.width)
        case _:
            return Sign()


def _users_controller(scenario: Scenario, chosen: choice.UserController) -> CellController:
    """Call ``Class(scenario, arm, **options)`` for an ArmController, ``Class(scenario, **options)`` for a CellController."""
    kind = _users_class(chosen.target)
    if issubclass(kind, CellController):
        return kind(scenario, **chosen.options)
    if issubclass(kind, ArmController):
        return Team({name: kind(scenario, name, **chosen.options) for name in scenario.cell.arms})
    raise FieldError(f"is {chosen.target!r}, which is neither an ArmController nor a CellController", "controller.target")


def _users_class(target: str) -> Any:
    module_name, _, class_name = target.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise EntryNotFoundError("module", module_name, [], f"the Python path ({error})") from None
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type):
        raise EntryNotFoundError("class", class_name, [name for name in dir(module) if name[0].isupper()], f"module {module_name!r}")
    return kind
