"""Gains from each arm's own task inertia, which hold however soft the grasps are, and their bias."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, as_array, typed
from coop_pin.base.errors import ArgumentError, InfeasibleMotionError
from coop_pin.base.spatial import TaskRows, spatial_inertia, weight_wrench
from coop_pin.control import PayloadSpace, PayloadSpaceGains, PostureGains, Saturation
from coop_pin.description.scenario import Scenario
from coop_pin.design.posture_gains import rounded_down, slowest_lag
from coop_pin.design.tuning_rule import (
    GainProposal,
    accurate_proposal,
    anchor_of,
    damped,
    expected_internal_errors,
    force_path_of,
    sampled_damping,
    squeeze_rate,
)
from coop_pin.feasibility.least_squeeze import least_squeeze
from coop_pin.feasibility.reachability import Reachability
from coop_pin.feasibility.table_force import TABLE_ERROR, table_force
from coop_pin.feasibility.task_inertia import MotionWrenches
from coop_pin.model.cell_arm import CellArm
from coop_pin.stability.motion_loop import GROWS, MotionLoop

_KAPPA, _ALONG = 0.5, 0.9
"""T lambda of each arm alone at the start, and the largest along the motion; 2 is unstable."""
_INTEGRAL, _FASTEST, _SLOWEST = 0.4, 0.1, 0.025
"""k_I, and the largest and smallest gamma, as parts of lambda_min(A^-1 G)."""
_TRACKED = 5e-6
"""Error to expect while moving for which gamma is not raised, m: the force of a bias goes with it."""
_LESS, _AIM = 0.98, 0.95
"""Factor by which K, gamma and k_I are lowered at a time for a table, or more: its force has their product;
and the part of the allowed force to which: a lower g, which patches may ask for, adds some."""
_TRANSIENT = 2.0
"""Least kappa as a multiple of gamma: with kappa = gamma an error of the start stays longest."""
_CUT, _LEAST_PART, _RESERVE = 0.9, 0.2, 1.1
"""Part by which a squeeze is lowered at a time, least part of it, and its reserve before a patch slips."""
_INSTANTS = 21
"""Times at which deflections are looked at."""


class OwnInertia(NamedTuple):
    """Task inertias along a motion, task rows in payload axes about P.

    Attributes:
        arms: Lambda_i = (J M^-1 J^T)^-1 of every arm alone, shape (m, n, k_0, k_0).
        cell: A = M_0 + sum Lambda_i, shape (n, k_0, k_0).
    """

    arms: Array
    cell: Array


@typed
def own_inertia(scenario: Scenario, cell_reach: Reachability) -> OwnInertia:
    """Return the task inertias of arms and cell at the configurations of a scenario's reachability.

    Args:
        scenario: Cell and motion.
        cell_reach: Reachability of the scenario, in which every arm holds the start.
    """
    cell = scenario.cell
    models = [CellArm(cell, reach.arm) for reach in cell_reach.arms]
    pairs = zip(models, cell_reach.arms, strict=True)
    arms = np.array([[_in_payload_axes(arm, q) for q in reach.q] for arm, reach in pairs])
    rows, payload = list(cell.task_rows.indices), cell.payload
    M_0 = spatial_inertia(payload.mass, payload.inertia_matrix, np.eye(3))[np.ix_(rows, rows)]
    return OwnInertia(arms, M_0 + arms.sum(axis=0))


def _in_payload_axes(arm: CellArm, q: Array) -> Array:
    """Return Lambda of an arm at a configuration, shape (k_0, k_0)."""
    J, Q = arm.rows.select(arm.payload_jacobian(q)), turn_matrix(arm.rows, arm.payload_pose(q))
    return Q.T @ np.linalg.inv(J @ np.linalg.solve(arm.mass_matrix(q), J.T)) @ Q


def turn_matrix(rows: TaskRows, X_WP: Array) -> Array:
    """Return Q with which task rows turn from payload to world axes, shape (k_0, k_0)."""
    return np.array([rows.turn(X_WP, row) for row in np.eye(rows.size)]).T


@typed
def own_inertia_proposal(
    scenario: Scenario,
    cell_reach: Reachability,
    *,
    least_stiffness: float = 0.0,
    table_error: float = TABLE_ERROR,
    tips_give: bool = False,
) -> GainProposal:
    """Return gains with which every arm alone is stable, so that no grasp is too soft for the damping.

    ::

        G_i   = c_i K_i = kappa / T Lambda_i(q_0)       in payload axes, turned with the payload
        k_I   = 0.4 lambda_min(A^-1 G),  gamma <= 0.1 lambda_min,  G = sum G_j

    with kappa = 0.5, or less where ``T lambda_max(Lambda_i(q)^-1 G_i)`` would exceed 0.9 along the motion.
    gamma is lower, down to 0.025 lambda_min, where the motion asks for less: a bias leaves a force in
    proportion to it.
    The bound of the anchor bears the deflection besides its usual bias, and the layer twice of that.
    Where a table takes the load, there is no bound, and kappa is lowered until the largest ``table_force``
    is below 4/3 of the weight.

    Args:
        scenario: Cell, motion, sensors and clock.
        cell_reach: Reachability of the scenario, in which every arm holds the start.
        least_stiffness: Stiffness of the posture's spring, N m/rad.
        table_error: Height by which a table may be higher than planned, m.
        tips_give: Whether the damping of spare joints must hold with tips that the grasps leave free.
    """
    at_rate, part = partial(_at_rate, scenario, own_inertia(scenario, cell_reach)), 1.0
    proposal, wrenches = accurate_proposal(scenario, cell_reach, least_stiffness, at_rate, tips_give)
    while (use := _table_use(scenario, proposal, table_error)) > _AIM:
        part *= min(_LESS, (_AIM / use) ** (1.0 / 3.0))
        proposal = at_rate(proposal.rate_hz, proposal.posture, wrenches, part)
    return proposal


def held_by_squeeze(scenario: Scenario, cell_reach: Reachability) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario with a squeeze with which the loop along the motion is stable, and what was cut.

    The wanted force of an arm turns with what the arm sees: a squeeze too large for the stiffness of grasps
    and law pushes two arms that face each other sidewards.

    Args:
        scenario: Cell with grasps that give, and its law.
        cell_reach: Reachability of the scenario, in which every arm holds the start.

    Raises:
        InfeasibleMotionError: cause "stability": no squeeze that holds the payload is small enough.
    """
    part, stated = 1.0, scenario.replace(events=())
    while (growth := MotionLoop(stated, cell_reach).growth()) > GROWS:
        part *= _CUT
        stated = stated.replace(squeeze=scenario.squeeze.scaled(part))
        least = least_squeeze(stated)
        if part < _LEAST_PART or (least is not None and _RESERVE * least.use > 1.0):
            raise InfeasibleMotionError(
                "stability",
                f"at {part:.2f} of the squeeze the loop grows with {growth:.3g} /s, and less does not hold;"
                " take stiffer grasps, or a tip whose last joint is not along the squeeze",
            )
    cut = f"squeeze CUT to {part:.2f} of it: with more the arms push each other sidewards"
    return scenario.replace(squeeze=stated.squeeze), (cut,) * (part < 1.0)


def _table_use(scenario: Scenario, proposal: GainProposal, table_error: float) -> float:
    """Return the force on the table of a put-down as ``TableForce.use``; 0 without one."""
    assert proposal.law is not None
    law, clock = proposal.law.replace(force_path=force_path_of(scenario)), scenario.clock
    planned = scenario.replace(controller=law, clock=clock.replace(rate_hz=proposal.rate_hz))
    force = table_force(planned, table_error=table_error, lag=proposal.tracking)
    return 0.0 if force is None else force.use


def _at_rate(
    scenario: Scenario,
    inertia: OwnInertia,
    rate: float,
    posture: PostureGains,
    needed: MotionWrenches,
    part: float = 1.0,
) -> GainProposal:
    """Return the gains at a control rate and a part of kappa, and the errors to expect on rigid grasps."""
    T, lag, cell, first = 1.0 / rate, slowest_lag(scenario), scenario.cell, inertia.arms[:, 0]
    alone = float(np.linalg.eigvals(np.linalg.solve(inertia.arms, first[:, None])).real.max())
    G = rounded_down(part * min(_KAPPA, _ALONG / alone) / (T + 2.0 * lag)) * first
    rates = np.linalg.eigvals(np.linalg.solve(inertia.cell, G.sum(axis=0))).real
    lambda_min, fastest = float(rates.min()), float(rates.max())
    Q, linear = turn_matrix(cell.task_rows, scenario.start.matrix), cell.task_rows.are_linear

    def tracking(gamma: float, k_I: float) -> float:
        x = needed.tracking(Q @ G.sum(axis=0) @ Q.T, gamma, k_I)
        return float(np.linalg.norm(x[:, linear], axis=1).max())

    k_I, most = min(lambda_min * _INTEGRAL, rate / 4.0), lambda_min * _FASTEST
    gamma = min(most, max(lambda_min * _SLOWEST, most * tracking(most, k_I) / _TRACKED))
    damping = sampled_damping(T * lambda_min, T * fastest, lag / T)
    gamma, k_I = map(rounded_down, damped(damping, gamma, k_I, T))
    bound, g = anchor_of(scenario, T)
    transient_rate = max(_TRANSIENT * gamma, squeeze_rate(scenario, gamma, rate))
    law = _law(scenario, G, gamma, k_I, g, transient_rate)
    force, moment = expected_internal_errors(scenario, needed.shared_by(Q @ G @ Q.T, cell.shares), g * rate)
    return GainProposal(
        rate_hz=rate,
        gains=law.gains,
        posture=posture,
        t_lambda_max=T * alone * float(G[0, 0, 0] / first[0, 0, 0]),
        lambda_min=lambda_min,
        damping=damping(T * gamma, T * k_I),
        integral_rate=k_I,
        anchor_bound=bound,
        tracking=tracking(gamma, k_I),
        internal_force=None if bound is None else force,
        internal_moment=None if bound is None else moment,
        law=law,
    )


def _law(
    scenario: Scenario, G: Array, gamma: float, k_I: float, g: float, transient_rate: float
) -> PayloadSpace:
    """Return the law with gains G_i in payload axes, shape (m, k_0, k_0)."""
    fields, cell = PayloadSpace.model_fields, scenario.cell
    position, angle = deflection_bias(scenario, G)
    b_0 = tuple(np.add(fields["anchor_bias"].default, (position, angle)).round(6).tolist())
    b_max = tuple(np.maximum(b_0, fields["anchor_bias_answered"].default).tolist())
    width = max(fields["switching"].default.width, float(np.round(2.0 * gamma * max(b_0), 6)))
    arm_gains = {
        name: PayloadSpaceGains(
            pose_gain=gamma,
            sliding_gain=tuple(map(tuple, (G_i / cell.share(name)).tolist())),
            sign_gain=width * k_I,
            anchor_gain=g,
            transient_rate=transient_rate,
        )
        for name, G_i in zip(cell.arms, G, strict=True)
    }
    return PayloadSpace(
        gains=next(iter(arm_gains.values())),
        arm_gains=arm_gains,
        switching=Saturation(width=width),
        anchor_bias="none" if scenario.put_downs else b_0,
        anchor_bias_answered=b_max,
        gain_axes="payload",
        knows_deflection=bool(cell.compliant) and scenario.controller.near_rest.is_zeroed,
    )


@typed
def deflection_bias(scenario: Scenario, G: Array) -> tuple[float, float]:
    """Return how far the payload is, as an arm sees it, from the mean that G weights, m and rad.

    Grasps that give do so by C_i F_i under load and squeeze, the largest along the motion, so that the arms
    see the payload at b_i = C_i F_i, about P in payload axes; with ``zero_at_grasp`` less b_i(t_0)::

        max_i |b_i - G^-1 sum G_j b_j|

    Args:
        scenario: Cell and motion.
        G: Gains G_i in payload axes, shape (m, k_0, k_0).

    Raises:
        ShapeError: they have another shape.
        ArgumentError: their sum has no inverse.
    """
    cell, motion = scenario.cell, scenario.payload_motion
    rows, linkage = cell.task_rows, scenario.grasp_plan_at(0.0).linkage
    parts = cell.shares[:, None, None] * np.eye(6) if linkage is None else linkage
    C, weight = (
        np.array([cell.compliance(name) for name in cell.arms]),
        weight_wrench(cell.payload.mass, cell.gravity),
    )
    is_zeroed, biases = scenario.controller.near_rest.is_zeroed, list[Array]()
    for time in np.linspace(0.0, scenario.duration, _INSTANTS).tolist():
        R = (motion.at(time).X_WP_d if time else scenario.start.matrix)[:3, :3]
        force = parts @ np.concatenate((R.T @ weight[:3], R.T @ weight[3:]))
        if time or cell.patches:  # on compliant grasps the squeeze is not on at the start
            force = force + scenario.squeeze.at(time, cell.grasps)
        biases.append(np.array([rows.select(b) for b in np.einsum("ijk,ik->ij", C, force)]))
    G = as_array("G", G, len(cell.arms), rows.size, rows.size)
    if np.linalg.matrix_rank(G.sum(axis=0)) < rows.size:
        raise ArgumentError("the sum of G has no inverse; give gains in every direction")
    b = np.array(biases) - is_zeroed * biases[0]
    off = b - np.linalg.solve(G.sum(axis=0), np.einsum("ijk,tik->tj", G, b).T).T[:, None]
    sizes = np.linalg.norm(rows.expand(off).reshape(*off.shape[:2], 2, 3), axis=-1).max(axis=(0, 1))
    return float(sizes[0]), float(sizes[1])
