"""Monitored quantities of the convergence proofs, declared in one table by law, and their dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import xarray as xr

from coop_pin.arrays import Array
from coop_pin.results import RunResult


class Monitored(NamedTuple):
    """Quantity of a convergence proof at every tick of a run.

    Attributes:
        dims: Dimensions after time, separated by blanks.
        unit: Unit; two where linear and angular entries differ.
        text: Meaning; the variable's ``long_name``.
    """

    dims: str
    unit: str
    text: str


MONITORED = {
    "sliding-mode": {
        "s_r": Monitored("arm joint", "rad/s", "residual s_r = qdot - qdot_r"),
        "s_q": Monitored("arm joint", "rad/s", "s_q = s - s_d, eq. (21)"),
        "s_d": Monitored("arm joint", "rad/s", "s_d = s(t_0) exp(-kappa (t - t_0)), eq. (20)"),
        "sigma": Monitored("arm joint", "s", "integral of sgn(s_q), eq. (18)"),
        "residual_21": Monitored("arm", "rad/s", "|s_r - s_q - alpha sigma|: zero by eq. (21)"),
        "V": Monitored("arm", "J", "V_i = s_r^T D_i s_r / 2"),
        "V_rate": Monitored("arm", "W", "central difference of V_i along the motion"),
        "V_rate_1": Monitored("arm", "W", "s_r^T (-K_d s_r - Y mu)"),
        "V_rate_2": Monitored("arm", "W", "(xtildedot + gamma xtilde)^T (1 + K_f) ftilde"),
        "V_rate_3": Monitored("arm", "W", "[J (alpha sigma - s_d)]^T (1 + K_f) ftilde"),
        "V_rate_held": Monitored(
            "arm", "W", "of the torque beyond the law with the true force: hold, delay, saturation"
        ),
        "V_rate_defect": Monitored("arm", "W", "V_rate less the four terms"),
        "identity_14": Monitored(
            "arm", "W", "s_r^T (Ddot - 2 C) s_r: zero by eq. (14) without friction in Q"
        ),
        "friction_defect_14": Monitored(
            "arm", "W", "-2 s_r^T F_v s_r: what eq. (14) is off by with friction in Q, as printed"
        ),
        "rho": Monitored("arm", "N m", "|Y mu|: what the law does not know"),
        "damping_force": Monitored("arm", "N m", "lambda_min(K_d) |s_r|"),
        "s_r_rate": Monitored(
            "arm", "rad/s^2", "|sdot_r|, which alpha must exceed for the sliding condition"
        ),
        "u_prime": Monitored("arm row", "N, N m", "u_i' = D_i'^-1 u_i of eqs. (24)-(26)"),
        "balance_25": Monitored(
            "arm", "N", "|ftilde - the right-hand side of eq. (25)|; held torque included"
        ),
        "sigma_min": Monitored("arm", "1", "smallest singular value of J"),
        "condition": Monitored("arm", "1", "condition number of J"),
        "poses_apart": Monitored("", "m", "largest distance of payloads as seen"),
    },
    "payload-space": {
        "s": Monitored("arm row", "m/s, rad/s", "sliding surface s_i"),
        "Z": Monitored("arm row", "N, N m", "integral Z_i, read off the commanded torque"),
        "mu": Monitored("arm row", "N, N m", "mu_i = a_i - c_i sum_j a_j"),
        "ftilde": Monitored(
            "arm row", "N, N m", "error of the internal wrench, with f_d as the arm turns it"
        ),
        "balance_2": Monitored("arm", "N", "|left side - right side| of eq. (2)"),
        "disagreement": Monitored("arm row", "N, N m", "Z_i - c_i Zbar"),
        "disagreement_rate": Monitored("arm row", "N/s, N m/s", "its change to the next tick over T"),
        "predicted_rate": Monitored("arm row", "N/s, N m/s", "what anchor, integral and leak make of it"),
        "rate_defect": Monitored("arm", "N/s", "|disagreement_rate - predicted_rate|"),
        "anchor_sum": Monitored("", "N", "|sum of the anchors|: zero where the measured errors sum to zero"),
        "Zbar": Monitored("row", "N, N m", "sum of the integrals"),
        "d": Monitored("row", "N, N m", "what Zbar must take over"),
        "V": Monitored("", "J", "sbar^T A sbar / 2 + (Zbar - d)^T (k_I K)^-1 (Zbar - d) / 2"),
        "V_rate": Monitored("", "W", "central difference of V along the motion at constant d"),
        "V_rate_damping": Monitored("", "W", "-sbar^T K sbar"),
        "V_rate_memory": Monitored(
            "", "W", "of what else moves Zbar: limited integral, leak, anchors that do not cancel"
        ),
        "V_rate_load": Monitored("", "W", "-(Zbar - d)^T (k_I K)^-1 ddot, by differences over the ticks"),
        "V_rate_defect": Monitored("", "W", "V_rate - V_rate_damping - V_rate_memory"),
    },
}
"""Quantities by ``kind`` of the law and by name."""


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
        name: (("time", *dims.split()), values[name], {"units": unit, "long_name": text})
        for name, (dims, unit, text) in MONITORED[scenario.controller.kind].items()
    } | {name: (("time", *dims.split()), mark) for name, (dims, mark) in marks.items()}
    coordinates = {"time": data["time"], "arm": data["arm"], "row": list(scenario.cell.task_rows.axes)}
    return xr.Dataset(variables, coordinates, {"title": f"theorem monitor of {scenario.name}"})
