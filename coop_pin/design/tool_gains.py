"""Gains of arms that hold different things, from the task inertia of each arm alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.spatial import spatial_inertia
from coop_pin.control.laws.payload_space_controller import PayloadSpaceGains
from coop_pin.control.laws.symmetric import Symmetric
from coop_pin.description.scenario import Scenario
from coop_pin.design.own_inertia import own_inertia
from coop_pin.design.posture_gains import posture_gains, rounded_down, slowest_lag
from coop_pin.design.tuning_rule import damped, sampled_damping
from coop_pin.feasibility.reachability import Reachability

_KAPPA, _ALONG = 0.5, 0.9
"""T lambda of each arm alone at the start, and the largest along the motion; 2 is unstable."""
_INTEGRAL, _POSE = 0.4, 0.1
"""k_I and gamma as parts of the smallest lambda."""


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
