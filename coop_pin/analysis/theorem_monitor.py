"""Theorem monitor: the quantities of the convergence proof along a recorded run, by its law.

For law (23), Gueaieb et al. (2007), Theorems 2 and 3, with eqs. (13)-(15) as they must read; for the
payload-space law see coop_pin.analysis.payload_space_monitor. Everything is computed from the recorded
motion, torques and wrenches of the plant, in drive coordinates; only the gains are the controller's.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from coop_pin.analysis.payload_space_monitor import payload_space_monitor
from coop_pin.analysis.proof_terms import ArmSample, ProofArm, ProofTerms, proof_terms
from coop_pin.arrays import Array, require_type
from coop_pin.build_controller import build_controller
from coop_pin.chain import CellChain
from coop_pin.description.events import PayloadChange
from coop_pin.errors import ArgumentError
from coop_pin.results import RunResult
from coop_pin.simulation.transmission import Transmission

_POSITIVE = 1e-6
"""sum_i Vdot_3 above it is marked as positive, W."""

MONITORED = {
    # name: (dimensions after time and arm, unit, text)
    "s_r": ("joint", "rad/s", "residual s_r = qdot - qdot_r"),
    "s_q": ("joint", "rad/s", "s_q = s - s_d, eq. (21)"),
    "s_d": ("joint", "rad/s", "s_d = s(t_0) exp(-kappa (t - t_0)), eq. (20)"),
    "sigma": ("joint", "s", "integral of sgn(s_q), eq. (18)"),
    "residual_21": ("", "rad/s", "|s_r - s_q - alpha sigma|: zero by eq. (21)"),
    "V": ("", "J", "V_i = s_r^T D_i s_r / 2"),
    "V_rate": ("", "W", "central difference of V_i along the motion"),
    "V_rate_1": ("", "W", "s_r^T (-K_d s_r - Y mu)"),
    "V_rate_2": ("", "W", "(xtildedot + gamma xtilde)^T (1 + K_f) ftilde"),
    "V_rate_3": ("", "W", "[J (alpha sigma - s_d)]^T (1 + K_f) ftilde"),
    "V_rate_held": ("", "W", "of the torque beyond the law with the true force: hold, delay, saturation"),
    "V_rate_defect": ("", "W", "V_rate less the four terms"),
    "identity_14": ("", "W", "s_r^T (Ddot - 2 C) s_r: zero by eq. (14) without friction in Q"),
    "friction_defect_14": (
        "",
        "W",
        "-2 s_r^T F_v s_r: what eq. (14) is off by with friction in Q, as printed",
    ),
    "rho": ("", "N m", "|Y mu|: what the law does not know"),
    "damping_force": ("", "N m", "lambda_min(K_d) |s_r|"),
    "s_r_rate": ("", "rad/s^2", "|sdot_r|, which alpha must exceed for the sliding condition"),
    "u_prime": ("row", "N, N m", "u_i' = D_i'^-1 u_i of eqs. (24)-(26)"),
    "balance_25": ("", "N", "|ftilde - the right-hand side of eq. (25)|; held torque included"),
    "sigma_min": ("", "1", "smallest singular value of J"),
    "condition": ("", "1", "condition number of J"),
}


def theorem_monitor(result: RunResult) -> xr.Dataset:
    """Return the quantities of the convergence proof of a run's law at every tick.

    Of law (23): rates are central differences along the true motion with the torques of the tick. ``V_rate``
    must be the sum of ``V_rate_1`` to ``V_rate_3`` and ``V_rate_held``; the theorem needs sum_i ``V_rate_3``
    <= 0, and ``V_rate_3_is_positive`` marks where it exceeds 1e-6 W. ``V_may_grow`` marks where ``|rho|``
    exceeds ``lambda_min(K_d) |s_r|``, ``sliding_is_not_assured`` where ``|sdot_r|`` exceeds the smallest
    alpha, ``signs_differ`` where sgn(s_q) differs between arms in some joint. Theorem 3 concludes from
    ``u_prime_sum`` -> 0 that each ``u_prime`` vanishes. Of the payload-space law: what
    ``payload_space_monitor`` returns.

    Args:
        result: every tick kept, of the payload-space law, or of the printed law ("sliding-mode") with planar
            or full task rows.

    Raises:
        ArgumentError: of another law, or without samples at every tick.
    """
    require_type("result", result, RunResult)
    scenario = result.scenario
    if scenario.clock.record_every != 1:
        raise ArgumentError(
            f"clock.record_every is {scenario.clock.record_every}; the integrals need every tick: run again"
            " with 1"
        )
    kind, rows = scenario.controller.kind, scenario.cell.task_rows.name
    if kind == "payload-space":
        return payload_space_monitor(result)
    if kind != "sliding-mode" or rows == "positional":
        raise ArgumentError(
            f"controller.kind is {kind!r} with rows {rows!r}; the proofs are about 'payload-space', and about"
            " 'sliding-mode' with rows 'planar' or 'full'"
        )
    controller: Any = build_controller(scenario)
    arms = [
        ProofArm(scenario, name, float(share), controller.controllers[name])
        for name, share in zip(scenario.cell.arms, scenario.cell.shares, strict=True)
    ]
    samples = [_along(result, index, arm) for index, arm in enumerate(arms)]
    values = {name: np.stack([sample[name] for sample in samples], axis=1) for name in MONITORED}
    return _labelled(result, arms, values)


def _samples(result: RunResult, index: int) -> Iterator[ArmSample]:
    """Yield every tick of one arm."""
    cell, data = result.scenario.cell, result.data
    chain, rows = CellChain(cell, result.scenario.plant), list(cell.task_rows.indices)
    place = chain.model.arms[index]
    transmission, drives = Transmission(cell, chain.model.arms, chain.mechanism.model.nv), len(place.drive)
    f_d = np.nan_to_num(data["desired_internal_wrench"].values[:, index])[:, rows]
    f = np.nan_to_num(data["internal_wrench"].values[:, index])[:, rows]
    F = np.nan_to_num(data["interaction_wrench"].values[:, index])
    changes = [event for event in result.scenario.events if isinstance(event, PayloadChange)]
    for k, t in enumerate(data["time"].values.tolist()):
        payload = cell.payload
        for change in sorted(changes, key=lambda event: event.time):
            payload = change.apply(payload) if change.time <= t else payload
        v = data["velocity"].values[k]
        yield ArmSample(
            t=t,
            q=data["configuration"].values[k, place.q_slice],
            v=v[place.v_slice],
            tau=data["torque"].values[k, index, :drives],
            friction=transmission.friction(v)[place.v_slice],
            F=F[k],
            external=data["external_wrench"].values[k],
            ftilde=f[k] - f_d[k],
            f_d=f_d[k],
            payload=payload,
        )


def _along(result: RunResult, index: int, arm: ProofArm) -> dict[str, Array]:
    """Return the monitored quantities of one arm at every tick, stacked."""
    columns: dict[str, list[Array]] = {name: [] for name in MONITORED}
    drives = len(arm.start_surface)
    sigma, held = np.zeros(drives), np.zeros(drives, dtype=bool)
    saturated = result.data["saturated"].values[:, index, :drives]
    for k, sample in enumerate(_samples(result, index)):
        if k == 0:
            arm.start_surface = arm.law_at(sample.t, sample.q, sample.v, sigma).s
        now = _at_tick(arm, sample, sigma)
        for name, value in now.items():
            columns[name].append(value)
        sigma = sigma + arm.law.period * (arm.law.switching(now["s_q"]) * ~held)
        held = saturated[k]
    return {name: np.array(column) for name, column in columns.items()}


def _lyapunov(arm: ProofArm, x: ArmSample, now: ProofTerms) -> dict[str, Any]:
    """Return V of Theorem 2, its rate in four terms, and identity (14)."""
    law, gains, s_r = now.law, arm.law, now.law.s_r
    ftilde = (1.0 + gains.force_gain) * x.ftilde
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
        "identity_14": s_r @ (now.D_rate - 2 * now.C) @ s_r,
        "friction_defect_14": -2.0 * s_r @ arm.viscous @ s_r,
        "rho": np.linalg.norm(now.Y_mu),
        "damping_force": arm.least_damping * np.linalg.norm(s_r),
        "s_r_rate": np.linalg.norm(now.s_r_rate),
    }


def _theorem_3(arm: ProofArm, x: ArmSample, now: ProofTerms) -> dict[str, Any]:
    """Return u_i' of eq. (26) and the defect of eq. (25)."""
    law, gains, J = now.law, arm.law, now.dynamics.J
    J_D = J @ np.linalg.inv(now.dynamics.D)
    D_prime, damped = (1.0 + gains.force_gain) * J_D @ J.T, J_D @ (gains.damping_gain + now.C)
    s_d_rate = -gains.transient_rate * law.s_d
    u = damped @ (gains.sign_gain @ now.sigma - law.s_d) + J_D @ now.Y_mu
    u = u + J @ (gains.sign_gain @ now.sigma_rate - s_d_rate)
    b = damped - now.J_rate
    right = np.linalg.solve(D_prime, now.surface_rate + b @ law.s + u - J_D @ now.beyond)
    return {"u_prime": np.linalg.solve(D_prime, u), "balance_25": np.linalg.norm(x.ftilde - right)}


def _at_tick(arm: ProofArm, x: ArmSample, sigma: Array) -> dict[str, Any]:
    """Return the monitored quantities of one arm at one tick."""
    now = proof_terms(arm, x, sigma)
    law, singular = now.law, np.linalg.svd(now.law.J, compute_uv=False)
    s_q = law.s - law.s_d
    return {
        "s_r": law.s_r,
        "s_q": s_q,
        "s_d": law.s_d,
        "sigma": sigma,
        "residual_21": np.linalg.norm(law.s_r - s_q - arm.law.sign_gain @ sigma),
        **_lyapunov(arm, x, now),
        **_theorem_3(arm, x, now),
        "sigma_min": singular[-1],
        "condition": singular[0] / singular[-1],
    }


def _labelled(result: RunResult, arms: list[ProofArm], values: dict[str, Array]) -> xr.Dataset:
    """Return the labelled quantities, their sums over the arms and the marks of the proof."""
    scenario, data = result.scenario, result.data
    poses = np.stack(
        [[arm.kinematics.view(x.q).pose for x in _samples(result, i)] for i, arm in enumerate(arms)]
    )
    apart = np.linalg.norm(poses[:, None, :, :3, 3] - poses[None, :, :, :3, 3], axis=-1).max(axis=(0, 1))
    alpha = np.array([np.diag(arm.law.sign_gain).min() for arm in arms])
    total = {f"V_rate_{part}_sum": ("time", values[f"V_rate_{part}"].sum(axis=1)) for part in (2, 3)}
    signs = np.sign(values["s_q"])
    variables = {
        name: (("time", "arm", *dims.split()), values[name], {"units": unit, "long_name": text})
        for name, (dims, unit, text) in MONITORED.items()
    } | {
        **total,
        "u_prime_sum": (("time", "row"), values["u_prime"].sum(axis=1)),
        "poses_apart": ("time", apart, {"units": "m", "long_name": "largest distance of payloads as seen"}),
        "V_rate_3_is_positive": ("time", total["V_rate_3_sum"][1] > _POSITIVE),
        "V_may_grow": (("time", "arm"), values["rho"] > values["damping_force"]),
        "sliding_is_not_assured": (("time", "arm"), values["s_r_rate"] > alpha),
        "signs_differ": ("time", (signs != signs[:, :1]).any(axis=(1, 2))),
    }
    coordinates = {"time": data["time"], "arm": data["arm"], "row": list(scenario.cell.task_rows.axes)}
    return xr.Dataset(variables, coordinates, {"title": f"theorem monitor of {scenario.name}"})
