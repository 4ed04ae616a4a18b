"""Monitored quantities of the convergence proofs, declared in one table by law, and their dataset."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

from coop_pin.base.arrays import Array
from coop_pin.results.quantity import Quantity
from coop_pin.results.run_result import RunResult

MONITORED = {
    "sliding-mode": (
        Quantity("s_r", "arm joint", "rad/s", "residual s_r = qdot - qdot_r"),
        Quantity("s_q", "arm joint", "rad/s", "s_q = s - s_d, eq. (21)"),
        Quantity("s_d", "arm joint", "rad/s", "s_d = s(t_0) exp(-kappa (t - t_0)), eq. (20)"),
        Quantity("sigma", "arm joint", "s", "integral of sgn(s_q), eq. (18)"),
        Quantity("residual_21", "arm", "rad/s", "|s_r - s_q - alpha sigma|: zero by eq. (21)"),
        Quantity("V", "arm", "J", "V_i = s_r^T D_i s_r / 2"),
        Quantity("V_rate", "arm", "W", "central difference of V_i along the motion"),
        Quantity("V_rate_1", "arm", "W", "s_r^T (-K_d s_r - Y mu)"),
        Quantity("V_rate_2", "arm", "W", "(xtildedot + gamma xtilde)^T (1 + K_f) ftilde"),
        Quantity("V_rate_3", "arm", "W", "[J (alpha sigma - s_d)]^T (1 + K_f) ftilde"),
        Quantity(
            "V_rate_held",
            "arm",
            "W",
            "of the torque beyond the law with the true force: hold, delay, saturation",
        ),
        Quantity("V_rate_defect", "arm", "W", "V_rate less the four terms"),
        Quantity("identity_14", "arm", "W", "s_r^T (Ddot - 2 C) s_r: zero by eq. (14) without friction in Q"),
        Quantity(
            "friction_defect_14",
            "arm",
            "W",
            "-2 s_r^T F_v s_r: what eq. (14) is off by with friction in Q, as printed",
        ),
        Quantity("rho", "arm", "N m", "|Y mu|: what the law does not know"),
        Quantity("damping_force", "arm", "N m", "lambda_min(K_d) |s_r|"),
        Quantity("s_r_rate", "arm", "rad/s^2", "|sdot_r|, which alpha must exceed for the sliding condition"),
        Quantity("u_prime", "arm row", "N, N m", "u_i' = D_i'^-1 u_i of eqs. (24)-(26)"),
        Quantity(
            "balance_25", "arm", "N", "|ftilde - the right-hand side of eq. (25)|; held torque included"
        ),
        Quantity("sigma_min", "arm", "1", "smallest singular value of J"),
        Quantity("condition", "arm", "1", "condition number of J"),
        Quantity("poses_apart", "", "m", "largest distance of payloads by the arms' kinematics"),
    ),
    "payload-space": (
        Quantity("s", "arm row", "m/s, rad/s", "sliding surface s_i"),
        Quantity("Z", "arm row", "N, N m", "integral Z_i, read off the commanded torque"),
        Quantity("mu", "arm row", "N, N m", "mu_i = a_i - c_i sum_j a_j"),
        Quantity("ftilde", "arm row", "N, N m", "error of the internal wrench, with f_d as the arm turns it"),
        Quantity("balance_2", "arm", "N", "|left side - right side| of eq. (2)"),
        Quantity("disagreement", "arm row", "N, N m", "Z_i - c_i Zbar"),
        Quantity("disagreement_rate", "arm row", "N/s, N m/s", "its change to the next tick over T"),
        Quantity(
            "predicted_rate", "arm row", "N/s, N m/s", "what anchor, cuts, integral and leak make of it"
        ),
        Quantity("rate_defect", "arm", "N/s", "|disagreement_rate - predicted_rate|"),
        Quantity("anchor_sum", "", "N", "|sum of the anchors|: zero where the measured errors sum to zero"),
        Quantity(
            "anchor_held", "arm row", "m, rad", "bias for which the bounded anchor holds what it has moved"
        ),
        Quantity("anchor_centre", "arm row", "m, rad", "C, the bias about which the anchor is bounded"),
        Quantity("Zbar", "row", "N, N m", "sum of the integrals"),
        Quantity("d", "row", "N, N m", "what Zbar must take over"),
        Quantity("V", "", "J", "sbar^T A sbar / 2 + (Zbar - d)^T (k_I K)^-1 (Zbar - d) / 2"),
        Quantity("V_rate", "", "W", "central difference of V along the motion at constant d"),
        Quantity("V_rate_damping", "", "W", "-sbar^T K sbar"),
        Quantity(
            "V_rate_memory",
            "",
            "W",
            "of what else moves Zbar: limited integral, leak, anchors that do not cancel",
        ),
        Quantity("V_rate_load", "", "W", "-(Zbar - d)^T (k_I K)^-1 ddot, by differences over the ticks"),
        Quantity("V_rate_defect", "", "W", "V_rate - V_rate_damping - V_rate_memory"),
    ),
}
"""Quantities by ``kind`` of the law."""


def monitor_dataset(
    result: RunResult, values: Mapping[str, Array], marks: Mapping[str, tuple[str, Array]]
) -> xr.Dataset:
    """Return the labelled quantities of a run's law, with its sums and marks.

    Args:
        result: Recorded run.
        values: Quantities of the law by name, ticks along the first axis.
        marks: Sums and marks by name: dimensions after time, and values.
    """
    scenario, data = result.scenario, result.data
    variables = {
        x.name: (("time", *x.dims.split()), values[x.name], {"units": x.unit, "long_name": x.text})
        for x in MONITORED[scenario.controller.kind]
    } | {name: (("time", *dims.split()), mark) for name, (dims, mark) in marks.items()}
    coordinates = {"time": data["time"], "arm": data["arm"], "row": list(scenario.cell.task_rows.axes)}
    return xr.Dataset(variables, coordinates, {"title": f"theorem monitor of {scenario.name}"})
