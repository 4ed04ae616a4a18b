"""Feasibility of a motion: rank, reach, singularity, limits, static torques, and the squeeze beside them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from coop_pin.analysis.reachability import Reachability
from coop_pin.analysis.statics import StaticTorques
from coop_pin.chain.cell_chain import CellChain
from coop_pin.description.scenario import Scenario
from coop_pin.errors import InfeasibleMotionError
from coop_pin.model.cell_arm import CellArm
from coop_pin.spatial.task_rows import joint_shortage

_NEARBY = 0.1
"""Distance of the joints to a configuration nearby, rad or m."""
_TORQUE_PART = 0.9
"""Part of the torque limit that holding may need: the rest is for the motion and its control."""


def require_rank(scenario: Scenario) -> None:
    """Refuse an arm with fewer joints than task rows.

    Raises:
        InfeasibleMotionError: cause "rank".
    """
    for name in scenario.cell.arms:
        joints, rows = CellArm(scenario.cell, name).nv, scenario.cell.task_rows.size
        if joints < rows:
            raise InfeasibleMotionError("rank", f"arm {name!r} has {joint_shortage(joints, rows)}")


def closure_problem(scenario: Scenario) -> str:
    """Return why the closed chain is singular at the start, or "": closures that lose rank there.

    Between arms that all lack a direction there (level tools of five-joint arms, for example) the closures
    have a smaller rank than at configurations nearby. Then neither the motions of the chain nor its internal
    wrenches are determined: a push opens new motions, and the energy of a run is not explained by work.
    Closures that are redundant everywhere, as between planar arms, are no problem.

    Args:
        scenario: whose start every arm reaches.
    """
    chain, X_WP = CellChain(scenario.cell, scenario.plant), scenario.start.matrix
    stated = scenario.start_angles
    q = chain.posed_configuration(stated, X_WP) if stated else chain.configuration(X_WP)
    model = chain.mechanism.model
    rest, away = np.zeros(model.nv), _NEARBY * np.random.default_rng(0).normal(size=model.nv)
    here, nearby = (
        chain.mechanism.forward_dynamics(at, rest, rest).rank for at in (q, pin.integrate(model, q, away))
    )
    if here >= nearby:
        return ""
    return (
        f"the closed chain is singular at the start: its closures have rank {here} there and {nearby} nearby,"
        " because the arms lack the same direction. Turn a grasp, tilt a tool, or use arms with six joints"
    )


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
    if singular := closure_problem(scenario):
        raise InfeasibleMotionError("singularity", singular)
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
