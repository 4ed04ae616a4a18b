"""Monitor of law (23): the quantities of its convergence proof along a recorded run.

Gueaieb et al. (2007), Theorems 2 and 3, with eqs. (13)-(15) as they must read; in drive coordinates.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from coop_pin.base.arrays import Array
from coop_pin.proof.monitored_quantities import monitor_dataset
from coop_pin.proof.recorded_run import ArmTick, RecordedTick, recorded_ticks
from coop_pin.proof.sliding_mode_terms import ProofArm, ProofTerms, proof_terms
from coop_pin.results.run_result import RunResult
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

_POSITIVE = 1e-6
"""sum_i Vdot_3 above it is marked as positive, W."""


def sliding_mode_monitor(result: RunResult) -> xr.Dataset:
    """Return the quantities of the convergence proof of law (23) at every tick of a run.

    Rates are central differences along the true motion with the torques of the tick. ``V_rate`` must be the
    sum of ``V_rate_1`` to ``V_rate_3`` and ``V_rate_held``; the theorem needs sum_i ``V_rate_3`` <= 0, and
    ``V_rate_3_is_positive`` marks where it exceeds 1e-6 W. ``V_may_grow`` marks where ``|rho|`` exceeds
    ``lambda_min(K_d) |s_r|``, ``sliding_is_not_assured`` where ``|sdot_r|`` exceeds the smallest alpha,
    ``signs_differ`` where sgn(s_q) differs between arms in some joint. Theorem 3 concludes from
    ``u_prime_sum`` -> 0 that each ``u_prime`` vanishes.

    Args:
        result: Run of the printed law, every tick kept.
    """
    controller: Any = build_controller(result.scenario)
    simulation = Simulation(result.scenario, controller)
    arms = [ProofArm(result.scenario, name, law) for name, law in controller.controllers.items()]
    rows = [
        [_at_tick(arm, tick, x) for arm, x in zip(arms, tick.arms, strict=True)]
        for tick in recorded_ticks(result, simulation)
    ]
    values = {name: np.array([[sample[name] for sample in row] for row in rows]) for name in rows[0][0]}
    p = values["position"]  # as each arm sees it
    values["poses_apart"] = np.linalg.norm(p[:, :, None] - p[:, None], axis=-1).max(axis=(1, 2))
    return monitor_dataset(result, values, _marks(arms, values))


def _lyapunov(arm: ProofArm, x: ArmTick, now: ProofTerms) -> dict[str, Any]:
    """Return V of Theorem 2, its rate in four terms, and identity (14)."""
    law, gains, s_r = now.law, arm.law.gains, now.law.s_r
    ftilde = (1.0 + gains.force_gain) * (x.f - x.f_d)
    lost = law.J @ (gains.sign_gain @ now.sigma - law.s_d)
    terms = {
        "V_rate_1": s_r @ (-gains.damping_gain @ s_r - now.Y_mu),
        "V_rate_2": law.surface @ ftilde,
        "V_rate_3": lost @ ftilde,
        "V_rate_held": s_r @ (now.beyond + (now.dynamics.J - law.J).T @ ftilde),
    }
    return terms | {
        "V": s_r @ now.dynamics.D @ s_r / 2,
        "V_rate": now.V_rate,
        "V_rate_defect": now.V_rate - sum(terms.values()),
        "identity_14": s_r @ (now.dynamics_rate.D - 2 * now.C) @ s_r,
        "friction_defect_14": -2.0 * s_r @ arm.viscous @ s_r,
        "rho": np.linalg.norm(now.Y_mu),
        "damping_force": arm.least_damping * np.linalg.norm(s_r),
        "s_r_rate": np.linalg.norm(now.law_rate.s_r),
    }


def _theorem_3(arm: ProofArm, x: ArmTick, now: ProofTerms) -> dict[str, Any]:
    """Return u_i' of eq. (26) and the defect of eq. (25)."""
    law, gains, J = now.law, arm.law.gains, now.dynamics.J
    J_D = J @ np.linalg.inv(now.dynamics.D)
    D_prime, damped = (1.0 + gains.force_gain) * J_D @ J.T, J_D @ (gains.damping_gain + now.C)
    s_d_rate = -gains.transient_rate * law.s_d
    u = damped @ (gains.sign_gain @ now.sigma - law.s_d) + J_D @ now.Y_mu
    u = u + J @ (gains.sign_gain @ now.sigma_rate - s_d_rate)
    b = damped - now.dynamics_rate.J
    right = np.linalg.solve(D_prime, now.law_rate.surface + b @ law.s + u - J_D @ now.beyond)
    return {"u_prime": np.linalg.solve(D_prime, u), "balance_25": np.linalg.norm(x.f - x.f_d - right)}


def _at_tick(arm: ProofArm, tick: RecordedTick, x: ArmTick) -> dict[str, Any]:
    """Return the monitored quantities of one arm at one tick, whose sigma is then that of the next."""
    now = proof_terms(arm, tick, x)
    law, sigma, singular = now.law, now.sigma, np.linalg.svd(now.law.J, compute_uv=False)
    s_q = law.s - law.s_d
    arm.sigma = sigma + arm.law.arm.period * (arm.law.switching(s_q) * ~arm.held)
    arm.held = x.saturated
    return {
        "position": law.position,
        "s_r": law.s_r,
        "s_q": s_q,
        "s_d": law.s_d,
        "sigma": sigma,
        "residual_21": np.linalg.norm(law.s_r - s_q - arm.law.gains.sign_gain @ sigma),
        **_lyapunov(arm, x, now),
        **_theorem_3(arm, x, now),
        "sigma_min": singular[-1],
        "condition": singular[0] / singular[-1],
    }


def _marks(arms: list[ProofArm], values: dict[str, Array]) -> dict[str, tuple[str, Array]]:
    """Return sums over the arms and the marks of the proof, with their dimensions after time."""
    alpha = np.array([np.diag(arm.law.gains.sign_gain).min() for arm in arms])
    rate_3, signs = values["V_rate_3"].sum(axis=1), np.sign(values["s_q"])
    return {
        "V_rate_2_sum": ("", values["V_rate_2"].sum(axis=1)),
        "V_rate_3_sum": ("", rate_3),
        "u_prime_sum": ("row", values["u_prime"].sum(axis=1)),
        "V_rate_3_is_positive": ("", rate_3 > _POSITIVE),
        "V_may_grow": ("arm", values["rho"] > values["damping_force"]),
        "sliding_is_not_assured": ("arm", values["s_r_rate"] > alpha),
        "signs_differ": ("", (signs != signs[:, :1]).any(axis=(1, 2))),
    }
