"""Gains beside tools, from the inertia of each arm alone, and beside joints, in the rows of each grasp."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.spatial import spatial_inertia
from coop_pin.control.laws.payload_space import PayloadSpace
from coop_pin.control.laws.payload_space_controller import PayloadSpaceGains
from coop_pin.control.laws.symmetric import Symmetric
from coop_pin.description.scenario import Scenario
from coop_pin.design.own_inertia import own_inertia
from coop_pin.design.posture_gains import T_LAMBDA, posture_gains, rounded_down, slowest_lag
from coop_pin.design.tuning_rule import anchor_of, damped, force_path_of, sampled_damping, squeeze_rate
from coop_pin.feasibility.path_following import payload_path
from coop_pin.feasibility.reachability import Reachability
from coop_pin.model.cell_arm import CellArm
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.closed_loop import eigenvalues
from coop_pin.stability.sampled_stability import motion_stability

_KAPPA, _ALONG = 0.5, 0.9
"""T lambda of each arm alone at the start, and the largest along the motion; 2 is unstable."""
_INTEGRAL, _POSE = 0.4, 0.1
"""k_I and gamma as parts of the smallest lambda."""
_BORNE = 1e-9
"""Part of an arm's largest mobility that its structure allows in rows that its joints do not move."""
_SEEN = 1e-6
"""Part of the largest lambda above which a direction is moved."""


def with_tool_gains(scenario: Scenario, cell_reach: Reachability) -> tuple[Scenario, str]:
    """Return the scenario with the symmetric law and gains of single arms, and what limits them.

    ::

        G_i = c_i K_i = kappa / (T max(1, rho)) Lambda_i(q_0)      in payload axes, turned with the payload
        k_I = 0.4 lambda_min,  gamma = 0.1 lambda_min              or lower, for a damping ratio of 0.58

    With the inertias Lambda_i of arms alone the absolute and the relative motion of two tools would decouple,
    at kappa / T and rho kappa / T; what the payload adds to its arms makes their lambda smaller.

    Args:
        scenario: Cell with tools, motion and clock; rho is that of its law, if that is symmetric.
        cell_reach: Reachability of the scenario, in which every arm holds the start.

    Raises:
        InfeasibleMotionError: cause "stability": rho is 0, which leaves the relative pose to itself.
    """
    cell, law, T = scenario.cell, scenario.controller, scenario.clock.period
    rho = law.relative_gain if isinstance(law, Symmetric) else 1.0
    if rho == 0.0:
        detail = "controller.relative_gain is 0: nothing keeps a tool on its path; state one above 0"
        raise InfeasibleMotionError("stability", detail)
    inertia, lag, rows = own_inertia(scenario, cell_reach).arms, slowest_lag(scenario), cell.task_rows.indices
    first, payload = inertia[:, 0], cell.payload
    alone = float(np.linalg.eigvals(np.linalg.solve(inertia, first[:, None])).real.max())
    kappa = rounded_down(min(_KAPPA, _ALONG / alone) * T / (T + 2.0 * lag))
    G = kappa / (T * max(1.0, rho)) * first
    holds = np.array([name not in cell.tools for name in cell.arms])
    M_0 = spatial_inertia(payload.mass, payload.inertia_matrix, np.eye(3))[np.ix_(rows, rows)]
    held = np.linalg.eigvals(np.linalg.solve(M_0 + first[holds].sum(axis=0), G[holds].sum(axis=0))).real
    slowest, fastest = float(held.min()) * min(1.0, rho), kappa / T
    damping = sampled_damping(T * slowest, T * fastest, lag / T)
    gamma, k_I = map(rounded_down, damped(damping, _POSE * slowest, _INTEGRAL * slowest, T))
    width = Symmetric.model_fields["switching"].default.width
    gains: dict[str, Any] = {
        name: PayloadSpaceGains(
            pose_gain=gamma,
            sliding_gain=(G_i / c).round(9).tolist(),
            sign_gain=width * k_I,
            leak=0.0 if holds.sum() == 1 else None,  # views of one holder have nothing to pull against
            transient_rate=2.0 * gamma,
        )
        for name, G_i, c in zip(cell.arms, G, cell.gain_shares, strict=True)
    }
    posture = posture_gains(scenario, cell_reach, T, 0.0, tips_give=True)
    proposal = Symmetric(
        relative_gain=rho,
        gains=next(iter(gains.values())),
        arm_gains=gains,
        gain_axes="payload",
        posture=posture,
        force_path=law.force_path,
    )
    sentence = (
        f"gains of each arm alone: T lambda {kappa:.3g} at the start and {kappa * alone:.3g} at most, of 2;"
        f" smallest lambda {slowest:.3g} /s with the payload, pose_gain {gamma:g} /s, k_I {k_I:g} /s"
    )
    return scenario.replace(controller=proposal), sentence


def with_joint_gains(scenario: Scenario, cell_reach: Reachability) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario with the payload-space law in the rows of grasps that are joints, and its limits.

    ::

        K = k diag(1, 1, 1, l^2, l^2, l^2)         so that the terms of the motion leave no internal wrench
        A = M_0 + sum B_i Lambda_i B_i^T,  K_eff = sum c_i B_i (B_i^T K^-1 B_i)^-1 B_i^T
        T lambda_max(A^-1 K_eff) = 0.9,  k_I = lambda_min / 2,  gamma = lambda_min / 4    or lower, damped

    with Lambda_i = (J_i M^-1 J_i^T)^-1 of each arm in the k rows of its grasp, about C. The damping of joints
    that a grasp makes spare has T D / I of 0.9 with the inertia I of what they move alone.

    Args:
        scenario: Cell with joints, motion and clock.
        cell_reach: Reachability of the scenario, in which every arm can follow.

    Raises:
        InfeasibleMotionError: cause "stability": the sampled loop grows.
    """
    cell, T, lag = scenario.cell, scenario.clock.period, slowest_lag(scenario)
    unit = np.where(cell.task_rows.are_linear, 1.0, cell.split_length**2)
    B, shares = cell.transmitted(), cell.shares.tolist()
    felt = sum(c * b @ np.linalg.inv(b.T @ (b.T / unit).T) @ b.T for c, b in zip(shares, B, strict=True))
    rates = np.linalg.eigvals(np.linalg.solve(_inertia_in_grasps(scenario, cell_reach), felt)).real
    k = rounded_down(T_LAMBDA / ((T + 2.0 * lag) * float(rates.max())))
    slowest, fastest = k * float(rates[rates > _SEEN * rates.max()].min()), k * float(rates.max())
    damping = sampled_damping(T * slowest, T * fastest, lag / T)
    gamma, k_I = map(rounded_down, damped(damping, slowest / 4.0, min(slowest / 2.0, 0.25 / T), T))
    fields = PayloadSpace.model_fields
    gains = PayloadSpaceGains(
        pose_gain=gamma,
        sliding_gain=tuple((k * unit).round(9).tolist()),
        sign_gain=round(fields["switching"].default.width * k_I, 9),
        anchor_gain=anchor_of(scenario, T)[1],
        transient_rate=squeeze_rate(scenario, gamma, scenario.clock.rate_hz),
    )
    posture = posture_gains(scenario, cell_reach, T, 0.0)
    law = PayloadSpace(
        gains=gains,
        posture=posture,
        force_path=force_path_of(scenario),
        zero_at_grasp=scenario.controller.near_rest.is_zeroed,
    )
    suggested = scenario.replace(controller=law)
    along = motion_stability(Simulation(suggested, build_controller(suggested)), cell_reach)
    loop = eigenvalues(suggested.replace(events=()))
    if not (along.ok and loop.ok):
        raise InfeasibleMotionError("stability", (loop if along.ok else along).summary())
    limits = (
        f"sliding_gain: T lambda {T * fastest:.3g}, smallest lambda {slowest:.3g} /s, split_length"
        f" {cell.split_length:g} m",
        *(
            [f"posture damping {posture.damping:.3g} N m s/rad, by the inertia of what joints make spare"]
            if any(b.shape[1] < arm.q.shape[1] for b, arm in zip(B, cell_reach.arms, strict=True))
            else []
        ),
        *(each.summary() for each in (along, loop)),
    )
    return suggested, limits


def _inertia_in_grasps(scenario: Scenario, cell_reach: Reachability) -> Array:
    """Return A along a path, on the task rows in payload axes about P, shape (n, k_0, k_0)."""
    cell, rows = scenario.cell, list(scenario.cell.task_rows.indices)
    A = [spatial_inertia(cell.payload.mass, cell.payload.inertia_matrix, np.eye(3))[np.ix_(rows, rows)]]
    A *= len(cell_reach.arms[0].q)
    poses = payload_path(scenario, cell_reach.poses).poses
    for reach, B in zip(cell_reach.arms, cell.transmitted(), strict=True):
        arm = CellArm(cell, reach.arm)
        for index, (q, X_WP) in enumerate(zip(reach.q, poses, strict=True)):
            J, M = arm.task_jacobian(q, X_WP[:3, :3]), arm.from_drive.T @ arm.mass_matrix(q) @ arm.from_drive
            moves = J @ np.linalg.solve(M, J.T)
            A[index] = A[index] + B @ np.linalg.inv(moves + _BORNE * np.trace(moves) * np.eye(len(J))) @ B.T
    return np.array(A)
