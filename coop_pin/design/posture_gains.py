"""Null-space gains of a cell's spare joints, by control period, lag and what its drives hold."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.control import PostureGains
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.internal_moment import positional_torques
from coop_pin.feasibility.motion_feasibility import part_held
from coop_pin.feasibility.reachability import Reachability
from coop_pin.model.cell_arm import CellArm

T_LAMBDA = 0.9
"""T lambda_max(A^-1 K): the rule allows 1, and the poses between those that are looked at need something."""
_BASE_POSTURE = PostureGains(stiffness=160.0, damping=80.0)
"""Null-space gains of arms on mobile bases: their spring moves the mass of the base."""
ROUND_OFF = 1e-9
"""Part below which a value counts as zero."""


def slowest_lag(scenario: Scenario) -> float:
    """Return the largest time constant between a velocity and the torque that answers it, s."""
    arms = scenario.cell.arms
    filters = [1.0 / (2.0 * np.pi * scenario.sensors_of(name).velocity.filter_hz) for name in arms]
    return float(max((*filters, *(scenario.actuators_of(name).lag for name in arms))))


def stands_on_bases(scenario: Scenario) -> bool:
    """Return whether an arm stands on a driven base."""
    return any(arm.base_joints for arm in scenario.cell.arms.values())


def posture_gains(
    scenario: Scenario,
    cell_reach: Reachability,
    T: float,
    least_stiffness: float = 0.0,
    tips_give: bool = False,
) -> PostureGains:
    """Return null-space gains, at most the usual ones but for a spring that has to be stiffer.

    The damping keeps T lambda below 0.9 with the payload held, or with free tips that ``tips_give``: their
    light wrists then join the spare motion, as one does that a joint makes spare. The spring is lowered with
    it. On full rows the spring takes no more torque at rest than gravity asks for, however stiff it is; on
    positional ones the closures hold the spare joints against it, so that it is lowered to what the drives
    can hold.
    """
    usual, decay = _BASE_POSTURE if stands_on_bases(scenario) else PostureGains(), 0.0
    for U, M in _spare_motions(scenario, cell_reach):
        inertia = np.linalg.inv(U.T @ np.linalg.solve(M, U)) if tips_give else U.T @ M @ U
        decay = max(decay, 1.0 / float(np.linalg.eigvalsh(inertia)[0]))
    stiffness, damping = float(np.max(usual.stiffness)), float(np.max(usual.damping))
    if decay > 0.0:
        damping = min(damping, rounded_down(T_LAMBDA / ((T + 2.0 * slowest_lag(scenario)) * decay)))
    stiffness *= damping / float(np.max(usual.damping))
    stiffness = max(stiffness, least_stiffness)
    if decay > 0.0 and not scenario.cell.controls_turns:
        stiffness = min(stiffness, _largest_held(scenario, cell_reach, damping))
    return PostureGains(stiffness=stiffness, damping=damping)


def base_posture_gains(scenario: Scenario, cell_reach: Reachability, T: float) -> PostureGains:
    """Return null-space gains of arms on bases that hold by joints: one for each drive, none of the bases.

    ::

        D_j = min(80, s M_jj),   T lambda_max((U^T M U)^-1 U^T s diag(M_jj) U) = 0.9
        K_j = min(160, D_j / (5 T))

    with the least M_jj of all arms along the motion: a wrist that a joint makes spare bears only as much
    damping as its own inertia. The springs, which move the bases, stay: they are weak for the wrist that they
    turn, which is beyond critical damping up to 0.9 D_j / (4 T).

    Raises:
        InfeasibleMotionError: cause "stability": the arms have drives of different numbers.
    """
    kinds = {(arm.nv, arm.description.base_joints) for arm in _arms(scenario, cell_reach)}
    if len(kinds) > 1:
        detail = "arms on bases beside joints of grasps or payload need postures of each drive, and have"
        remedy = "make the grasps rigid, or state" if scenario.cell.jointed else "state"
        raise InfeasibleMotionError("stability", f"{detail} unlike ones; {remedy} a law and its gains")
    ((drives, base_drives),) = kinds
    if not (motions := [*_spare_motions(scenario, cell_reach)]):
        return posture_gains(scenario, cell_reach, T)
    inertias = np.min([np.diag(M) for _, M in motions], axis=0) * (np.arange(drives) >= base_drives)
    decays = (np.linalg.eigvals(np.linalg.solve(U.T @ M @ U, (U.T * inertias) @ U)).real for U, M in motions)
    largest = max(float(each.max()) for each in decays)
    factor = T_LAMBDA / ((T + 2.0 * slowest_lag(scenario)) * largest)
    usual = float(np.max(_BASE_POSTURE.damping))
    damping = [rounded_down(min(usual, factor * entry)) if entry else 0.0 for entry in inertias.tolist()]
    spring = float(np.max(_BASE_POSTURE.stiffness))
    stiffness = tuple(min(spring, rounded_down(entry / (5.0 * T))) if entry else 0.0 for entry in damping)
    return PostureGains(stiffness=stiffness, damping=tuple(damping))


def _arms(scenario: Scenario, cell_reach: Reachability) -> list[CellArm]:
    return [CellArm(scenario.cell, reach.arm) for reach in cell_reach.arms]


def _spare_motions(scenario: Scenario, cell_reach: Reachability) -> Iterator[tuple[Array, Array]]:
    """Yield an orthonormal basis of the spare motions and M of each redundant arm, at up to 21 poses."""
    for arm, reach in zip(_arms(scenario, cell_reach), cell_reach.arms, strict=True):
        if arm.spare <= 0:
            continue
        for q in reach.q[:: max(1, len(reach.q) // 20)]:
            U = np.linalg.svd(arm.null_space(q))[0][:, : arm.spare]
            yield U, arm.from_drive.T @ arm.mass_matrix(q) @ arm.from_drive


def _largest_held(scenario: Scenario, cell_reach: Reachability, damping: float) -> float:
    """Return the stiffest spring that the drives hold along the motion on positional rows, N m/rad.

    It is infinite where no joint moves away from its posture.
    """
    without, with_one = (
        positional_torques(scenario, cell_reach, PostureGains(stiffness=stiffness, damping=damping))
        for stiffness in (0.0, 1.0)
    )
    limits = [arm.limits.torque for arm in _arms(scenario, cell_reach)]
    held = min(
        part_held(torque, pulled - torque, limit)
        for torque, pulled, limit in zip(without, with_one, limits, strict=True)
    )
    return held if math.isinf(held) else rounded_down(max(held, ROUND_OFF))


def rounded_down(value: float) -> float:
    """Return a positive value with three significant digits, not above it."""
    digits = 2 - math.floor(math.log10(value))
    scaled = value * 10.0**digits
    return float(f"{math.floor(scaled * (1.0 + 1e-12)) / 10.0**digits:.6g}")
