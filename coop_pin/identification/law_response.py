"""Response of the payload-space law to what its arms see wrong: the internal wrench along a record."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmModel
from coop_pin.simulation.build_controller import controlled_arm


def internal_wrenches(
    scenario: Scenario, times: Array, Q: Array, bias: Array, wrist: Array, torque: Array
) -> Array:
    """Return the internal wrench phi_i by errors of the arms' views and wrists, for p causes.

    Of arm i, with what is mean over the arms by their shares c taken off, the biases b_i of the view, w_i of
    the wrist and m_i of the torques (as wrenches about P)::

        s_i   = b_i' + gamma b_i - s_i(t_0) e,    e = exp(-kappa (t - t_0))
        phi_i = [c_i K s_i + Z_i + m_i - K_f w_i] / (1 + K_f)
        Z_i'  = -beta (phi_i + w_i) - lambda Z_i + c_i k_I K s_i

    beta = g / T where a wrench is measured, and zero without; lambda is the leak without. What changes faster
    than one over beta, and the delay of the measured wrench, are not in it.

    Args:
        scenario: cell and law that ``uncovered`` knows nothing against.
        times: times, s, shape (n,).
        Q: matrices that turn task rows from payload to world axes, shape (n, k_0, k_0).
        bias: b_i, m and rad, world axes, shape (n, m, k_0, p).
        wrist: w_i, N and N m, likewise.
        torque: m_i, N and N m, likewise.

    Returns:
        N and N m, shape (n, m, k_0, p).
    """
    law: Any = scenario.controller
    name, arm = next(iter(scenario.cell.arms.items()))
    controlled = controlled_arm(scenario, ArmModel(arm, name=name))
    one: Any = law.controller_of(
        controlled, law.gains_of(name).sized(controlled.rows.size, controlled.drives), scenario
    )
    gains, every = one.gains, max((sensor.every for sensor in scenario.wrists), default=1)
    K_f = float(gains.force_gain) if law.force_path.measures else 0.0
    beta = law.measures * one.integral.gain / (every * scenario.clock.period)
    c = np.array(scenario.cell.shares)[:, None, None]
    w, m = (each - c * each.sum(axis=1, keepdims=True) for each in (wrist, torque))
    b = bias - (c * bias).sum(axis=1, keepdims=True)
    if law.near_rest.is_zeroed:  # the arms place their payload frames at the start pose
        b = b - np.einsum("nij,ajp->naip", Q, np.einsum("ji,ajp->aip", Q[0], b[0]))
    s = np.gradient(b, times, axis=0) + np.einsum("ij,najp->naip", gains.pose_gain, b)
    s = s - s[0] * np.exp(-gains.transient_rate * (times - times[0]))[:, None, None, None]
    K = Q @ gains.sliding_gain @ np.swapaxes(Q, 1, 2) if one.axes.turns else gains.sliding_gain + 0.0 * Q
    forced = np.einsum("nij,najp->naip", K, s) * c
    rate = beta / (1.0 + K_f) + (not law.measures) * one.integral.leak
    held = forced + m - K_f * w
    k_I = (gains.sign_gain.diagonal() / law.switching.width)[:, None]
    drive = -beta * (held / (1.0 + K_f) + w) + k_I * forced
    Z = np.zeros_like(drive)
    for k, step in enumerate(np.diff(times)):
        fades = np.exp(-rate * step)
        gained = (1.0 - fades) / rate if rate else step
        Z[k + 1] = fades * Z[k] + gained * (drive[k] + drive[k + 1]) / 2.0
    return np.asarray((held + Z) / (1.0 + K_f))


def uncovered(scenario: Scenario) -> str:
    """Return why the response of a scenario's law is not known as a formula; empty if it is."""
    law: Any = scenario.controller
    if law.kind != "payload-space":
        return f"the law is {law.kind!r}, not 'payload-space'"
    reasons = {
        "gains differ between the arms": bool(law.arm_gains),
        "the integral's switching is not smooth": not law.switching.is_smooth,
        "the integral has a dead zone": any(law.integral_dead_zone),
        "each arm measures its own wrench alone": law.payload_mass is not None
        and not law.force_path.measures,
        "arms have servos or a feed-forward": scenario.has_servos or scenario.feed_forward is not None,
        "grasps give, open or close": bool(scenario.cell.unclosed or scenario.has_grasp_plan),
        "an arm has a tool": bool(scenario.cell.tools),
    }
    return next((reason for reason, holds in reasons.items() if holds), "")
