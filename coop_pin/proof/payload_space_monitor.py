"""Monitor of the payload-space law: how the arms' integrals disagree, and V of its motion, along a run.

Equations (1) to (4) of the page "The payload-space law" of the documentation. Of the controller only
the gains are read.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import xarray as xr

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import ArgumentError
from coop_pin.base.spatial import spatial_inertia
from coop_pin.control import AnchorState, PayloadSpaceController
from coop_pin.control.terms import is_new
from coop_pin.description.events import Surroundings
from coop_pin.model.cell_arm import CellArm
from coop_pin.proof.monitored_quantities import monitor_dataset
from coop_pin.proof.recorded_run import RecordedTick, recorded_ticks
from coop_pin.results.run_result import RunResult
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

_STEP = 1e-5
"""Half the span of central differences along the motion, s."""
_POSITIVE = 1e-6
"""A rate of V above it is marked, W."""


def payload_space_monitor(result: RunResult) -> xr.Dataset:
    """Return the quantities of the payload-space law's derivation at every tick of a run.

    Z_i is what the commanded torque holds beside sliding term and squeeze. ``balance_2`` closes with the
    plant's accelerations and wrenches, ``rate_defect`` with the law's update. d is what eq. (1) asks of Zbar
    with C = Adot / 2: at constant d, inside the layer, V falls by ``V_rate_damping``. ``V_may_grow`` marks
    where the sum of the rates is above 1e-6 W, ``integral_is_limited`` where an arm leaves the layer,
    ``anchor_acts`` where it has a new measurement, ``anchor_is_bounded``
    where its bound acts. V is NaN without an integral or without a layer.

    Args:
        result: run of the payload-space law, every tick kept.

    Raises:
        ArgumentError: the torques change between ticks but by a loss, or the law is zeroed at grasp.
    """
    cell = _MonitoredCell(result)
    columns: dict[str, list[Any]] = {}
    for now in recorded_ticks(result, cell.simulation):
        for name, value in cell.at_tick(now).items():
            columns.setdefault(name, []).append(value)
    return _labelled(result, cell, {name: np.array(column) for name, column in columns.items()})


class _MonitoredCell:
    """Laws and dynamics of the arms of a recorded run."""

    def __init__(self, result: RunResult) -> None:
        scenario = result.scenario
        stated: Any = scenario.controller
        controller: Any = build_controller(scenario)
        self.simulation = Simulation(scenario, controller)
        response = self.simulation.actuation.drives.response
        if stated.gain_axes != "world":
            raise ArgumentError("the monitor of the payload-space law needs gain_axes 'world'")
        if stated.zero_at_grasp or not (response is None or response.at_once.all()):
            raise ArgumentError(
                "the monitor of the payload-space law needs torques that are held over a tick and payload"
                " frames without correction; run without lag, rate_limit and zero_at_grasp"
            )
        cell = scenario.cell
        self.rows, self.c, self.period = cell.task_rows, cell.shares[:, None], scenario.clock.period
        self.laws: list[PayloadSpaceController] = [controller.controllers[name] for name in cell.arms]
        self.models = [CellArm(cell, name) for name in cell.arms]
        law = self.laws[0]
        k_I = np.diag(law.gains.sign_gain) / law.switching.width
        has_layer = bool((k_I > 0.0).all())
        self.inverse_gain = np.linalg.inv((k_I if has_layer else 1.0) * law.gains.sliding_gain)
        self.inverse_gain = self.inverse_gain if has_layer else np.full_like(law.gains.sliding_gain, np.nan)
        self.start: list[tuple[Array, Array]] = []
        self.ages, self.Z_hold = np.full(len(self.laws), np.inf), np.zeros(0)
        zero = np.zeros(self.rows.size)
        self.anchors = [AnchorState(zero, zero, zero, 0.0)] * len(self.laws)
        self.commands = list[Array]()

    def at_tick(self, now: RecordedTick) -> dict[str, Any]:
        """Return the monitored quantities of a tick; what needs the next tick comes later."""
        s, f_r = self._surfaces(now)
        error, is_fresh, is_stale = self._measured(now, f_r)
        w = np.array([-np.linalg.pinv(arm.measured.payload_jacobian).T @ arm.commanded for arm in now.arms])
        F = np.array([self.rows.select(arm.F) for arm in now.arms])
        gains = [law.gains for law in self.laws]
        slid = self.c * np.array([gain.sliding_gain @ s_i for gain, s_i in zip(gains, s, strict=True)])
        fed_back = f_r - self._each("force_gain") * error
        Z = w - slid - fed_back
        cut = np.where(is_stale, 0.0, self._cut(now))
        self.Z_hold = np.where(is_fresh, Z, self.Z_hold - cut if self.Z_hold.size else Z)
        a = self._arm_wrenches(now, w)
        ftilde, right = self._internal(F) - f_r, self._internal(a + slid + Z + fed_back) - f_r
        unbounded = is_fresh * self._each("anchor_gain") * error
        bounded = self._bounded(now, unbounded, is_fresh[:, 0], is_stale[:, 0])
        anchor = bounded + cut
        phi = np.array([law.switched(s_i) for law, s_i in zip(self.laws, s, strict=True)])
        integral = self.c * np.array(
            [gain.sliding_gain @ gain.sign_gain @ phi_i for gain, phi_i in zip(gains, phi, strict=True)]
        )
        leak = np.array([[law.integral.leak] for law in self.laws])
        waits = [
            (law.integral.bound is None or is_stale[i, 0]) and now.arms[i].measured.saturated.any()
            for i, law in enumerate(self.laws)
        ]
        rate = ~np.array(waits)[:, None] * integral - is_stale * leak * (Z - self.Z_hold)
        held = np.array([anchor.held for anchor in self.anchors])
        centre = np.zeros_like(held)
        for i, law in enumerate(self.laws):
            if law.integral.bound is not None:
                X_WP = now.arms[i].measured.payload_pose
                centre[i] = law.integral.bound.centre(self.anchors[i], X_WP)
                self.anchors[i] = law.integral.bound.after(
                    self.anchors[i], not is_stale[i, 0], self.period * rate[i], X_WP
                )
        Zbar = Z.sum(axis=0)
        return {
            "s": s,
            "Z": Z,
            "mu": self._internal(a),
            "ftilde": ftilde,
            "balance_2": np.linalg.norm(ftilde - right, axis=1),
            "disagreement": self._internal(Z),
            "anchor": anchor,
            "anchor_sum": np.linalg.norm(anchor.sum(axis=0)),
            "anchor_acts": is_fresh[:, 0],
            "anchor_is_bounded": (bounded != unbounded).any(axis=1),
            "anchor_held": held,
            "anchor_centre": centre,
            "memory_rate": rate,
            "integral_is_limited": (np.abs(phi) >= 1.0).any(axis=1),
            "Zbar": Zbar,
            **self._lyapunov(
                now,
                Zbar,
                (rate - anchor / self.period).sum(axis=0),
                (F - a - fed_back).sum(axis=0),
            ),
        }

    def _bounded(self, now: RecordedTick, unbounded: Array, is_fresh: Mask, is_stale: Mask) -> Array:
        """Return what the anchors take out of the integrals where they ask for this, shape (m, k_0) each."""
        taken = np.array(unbounded)
        for i, (law, arm) in enumerate(zip(self.laws, now.arms, strict=True)):
            if law.integral.bound is not None:
                follows = float(not (is_stale[i] or arm.measured.saturated.any()))
                correction, self.anchors[i] = law.integral.bound.step(
                    self.anchors[i], -unbounded[i], float(is_fresh[i]), follows, arm.measured.payload_pose
                )
                taken[i] = -correction
        return taken

    def _cut(self, now: RecordedTick) -> Array:
        """Return the wrenches by which the drives changed the commands of the tick before, shape (m, k_0)."""
        cut = np.zeros((len(self.laws), self.rows.size))
        for i, (law, arm) in enumerate(zip(self.laws, now.arms, strict=True)):
            x = arm.measured
            if law.integral.bound is not None and self.commands and x.reported_torque is not None:
                cut[i] = np.linalg.pinv(x.payload_jacobian).T @ (x.reported_torque - self.commands[i])
        self.commands = [arm.commanded for arm in now.arms]
        return cut

    def _surfaces(self, now: RecordedTick) -> tuple[Array, Array]:
        """Return s_i and f_r,i of every arm, shape (m, k_0) each; they start from the first tick."""
        if not self.start:
            self.start = [
                (self._surface(i, x.payload_pose, x.payload_twist, now.t), arm.reference.internal_wrench)
                for i, arm in enumerate(now.arms)
                for x in (arm.measured,)
            ]
        e = self._remaining(now.t)
        s, f_r = np.zeros((2, len(now.arms), self.rows.size))
        for i, (arm, (s_0, f_0)) in enumerate(zip(now.arms, self.start, strict=True)):
            X_WP, twist = arm.measured.payload_pose, arm.measured.payload_twist
            s[i] = self._surface(i, X_WP, twist, now.t) - s_0 * e
            f_r[i] = self.rows.turn(X_WP, arm.reference.internal_wrench - f_0 * e)
        return s, f_r

    def _each(self, gain: str) -> Array:
        """Return a scalar gain of every arm, shape (m, 1)."""
        return np.array([[dict(law.gains)[gain]] for law in self.laws])

    def _internal(self, wrenches: Array) -> Array:
        """Return w_i - c_i sum_j w_j, shape (m, k_0)."""
        return wrenches - self.c * wrenches.sum(axis=0)

    def _remaining(self, t: float) -> float:
        """Return exp(-kappa (t - t_0))."""
        return float(np.exp(-self.laws[0].gains.transient_rate * t))

    def _surface(self, arm: int, X_WP: Array, twist: Array, t: float) -> Array:
        """Return xtildedot + gamma xtilde of an arm, shape (k_0,)."""
        target = self.simulation.motion.at(t)
        xtilde = self.rows.pose_error(X_WP, target.X_WP_d)
        return twist - self.rows.select(target.V_WP_d) + self.laws[arm].gains.pose_gain @ xtilde

    def _measured(self, now: RecordedTick, f_r: Array) -> tuple[Array, Mask, Mask]:
        """Return fhat - f_r, shape (m, k_0), and whether it is new and whether it is stale, shape (m, 1)."""
        error, ages = np.zeros_like(f_r), np.full(len(self.laws), np.inf)
        for i, (law, arm) in enumerate(zip(self.laws, now.arms, strict=True)):
            m = arm.measured
            if m.internal_wrench is not None:
                error[i], ages[i] = m.internal_wrench - f_r[i], m.internal_wrench_age
            elif m.interaction_wrench is not None and law.payload_weight is not None:
                error[i] = m.interaction_wrench - self.c[i] * law.payload_weight - f_r[i]
                ages[i] = m.interaction_wrench_age
        is_fresh = np.array([is_new(age, last) for age, last in zip(ages, self.ages, strict=True)])
        self.ages = ages
        return error, is_fresh[:, None], (ages > [law.integral.stale_after for law in self.laws])[:, None]

    def _arm_wrenches(self, now: RecordedTick, w: Array) -> Array:
        """Return a_i = Jdyn^T (M qdd + h - friction - tau - J^T w) by RNEA, shape (m, k_0).

        What of the torque is not -J^T w (posture, cuts, a Jacobian that the arm sees wrong) counts as load.
        """
        wrenches = []
        for model, arm, w_i in zip(self.models, now.arms, w, strict=True):
            model.model.gravity.linear = now.surroundings.gravity
            J = self.rows.select(model.payload_jacobian(arm.q))
            load = model.inverse_dynamics(arm.q, arm.v, arm.a) - arm.forces - J.T @ w_i
            weighted = np.linalg.solve(model.mass_matrix(arm.q), J.T)
            wrenches.append(np.linalg.solve(J @ weighted, weighted.T @ load))
        return np.array(wrenches)

    def _motion(self, t: float, q: Array, v: Array, payload: Surroundings) -> tuple[Array, Array]:
        """Return sbar and A = M_0 + sum (J M^-1 J^T)^-1 at a state, shapes (k_0,) and (k_0, k_0)."""
        slots, rows = self.simulation.slots, list(self.rows.indices)
        first = self.models[0].payload_pose(q[slots[0].q_slice])
        M_0 = spatial_inertia(payload.mass, payload.inertia, first[:3, :3])
        A, sbar = M_0[np.ix_(rows, rows)], np.zeros(len(rows))
        for i, (model, slot) in enumerate(zip(self.models, slots, strict=True)):
            q_i, view = q[slot.q_slice], model.kinematics.view(q[slot.q_slice])
            twist = view.jacobian @ slot.drive @ v[slot.v_slice]
            s = self._surface(i, view.pose, twist, t) - self.start[i][0] * self._remaining(t)
            J = self.rows.select(model.payload_jacobian(q_i))
            A = A + np.linalg.inv(J @ np.linalg.solve(model.mass_matrix(q_i), J.T))
            sbar = sbar + self.c[i] * s
        return sbar, A

    def _lyapunov(self, now: RecordedTick, Zbar: Array, Zbar_rate: Array, held: Array) -> dict[str, Any]:
        """Return V and its rates; held is what the plant says K sbar + Zbar is."""
        model = self.simulation.chain.mechanism.model

        def ahead(dt: float) -> tuple[Array, Array]:
            q = pin.integrate(model, now.q, dt * now.v + dt**2 / 2 * now.a)
            return self._motion(now.t + dt, q, now.v + dt * now.a, now.surroundings)

        (s_0, A_0), (sbar, A), (s_1, A_1) = ahead(-_STEP), ahead(0.0), ahead(_STEP)
        s_rate, A_rate = (s_1 - s_0) / (2.0 * _STEP), (A_1 - A_0) / (2.0 * _STEP)
        d, to_rate = held + A @ s_rate + A_rate @ sbar / 2.0, self.inverse_gain

        def V(s: Array, inertia: Array, dt: float) -> float:
            x = Zbar + dt * Zbar_rate - d
            return float(s @ inertia @ s + x @ to_rate @ x) / 2.0

        K = self.laws[0].gains.sliding_gain
        damping = -float(sbar @ K @ sbar)
        memory = float((Zbar - d) @ (to_rate @ Zbar_rate - sbar))
        rate = (V(s_1, A_1, _STEP) - V(s_0, A_0, -_STEP)) / (2.0 * _STEP)
        return {
            "d": d,
            "V": V(sbar, A, 0.0),
            "V_rate": rate,
            "V_rate_damping": damping,
            "V_rate_memory": memory,
            "V_rate_defect": rate - damping - memory,
        }


def _labelled(result: RunResult, cell: _MonitoredCell, values: dict[str, Array]) -> xr.Dataset:
    """Return the labelled quantities with what needs the next tick, and the marks."""
    T = cell.period
    anchor, rate = values.pop("anchor"), values.pop("memory_rate")
    predicted = rate - np.append(anchor[1:], np.full_like(anchor[:1], np.nan), axis=0) / T
    disagreement = values["disagreement"]
    change = np.diff(disagreement, axis=0, append=np.full_like(disagreement[:1], np.nan)) / T
    predicted = predicted - cell.c * predicted.sum(axis=1, keepdims=True)
    load = -np.einsum(
        "ni,ij,nj->n", values["Zbar"] - values["d"], cell.inverse_gain, np.gradient(values["d"], T, axis=0)
    )
    values |= {"disagreement_rate": change, "predicted_rate": predicted, "V_rate_load": load}
    values["rate_defect"] = np.linalg.norm(change - predicted, axis=2)
    grows = values["V_rate_damping"] + values["V_rate_memory"] + load > _POSITIVE
    marks = {
        name: ("arm", values[name]) for name in ("integral_is_limited", "anchor_acts", "anchor_is_bounded")
    }
    return monitor_dataset(result, values, {"V_may_grow": ("", grows)} | marks)
