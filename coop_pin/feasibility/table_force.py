"""Force with which a law presses a table that is higher than planned, until the put-down is over."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, as_positive, typed
from coop_pin.control.laws.payload_space import PayloadSpace
from coop_pin.description.cell.contact import corners
from coop_pin.description.grasp_events import PutDown
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.inverse_kinematics import solve_ik

TABLE_ERROR = 2e-3
"""Height by which a table may be higher than planned, m."""
_MOST = 4.0 / 3.0
"""Largest force over the weight: arms whose squeeze carries 1.5 times the weight press with a third of it
without sliding."""
_INSTANTS = 401


class TableForce(NamedTuple):
    """Largest force on a table at a put-down.

    Attributes:
        force: force that the law winds up, with the weight, N.
        impact: force of the impact, v sqrt(k A), before the table has the weight, N.
        weight: weight of the payload along the table's normal, N.
        table: name of the table.
        height: height of the table above the end of the motion, m.
        time: time of the largest force, s.
    """

    force: float
    impact: float
    weight: float
    table: str
    height: float
    time: float

    @property
    def allowed(self) -> float:
        """Largest force that is allowed, 4/3 of the weight, N."""
        return _MOST * self.weight

    @property
    def use(self) -> float:
        """Force without the impact as a part of what is allowed."""
        return self.force / self.allowed

    @property
    def ok(self) -> bool:
        """Whether neither force nor impact are more than that."""
        return max(self.force, self.impact) <= self.allowed

    def summary(self) -> str:
        """Return the forces as one line."""
        text = (
            f"table {self.table!r}, {1e3 * self.height:.3g} mm above the end of the motion: pressed with up"
            f" to {self.force:.3g} N at {self.time:.3g} s, of which {self.weight:.3g} N are weight, after an"
            f" impact of up to {self.impact:.3g} N"
        )
        remedy = "more than 4/3 of it: come down more slowly, or lower K, gamma and k_I"
        return text if self.ok else f"{text}; {remedy}"


@typed
def table_force(
    scenario: Scenario, *, table_error: float = TABLE_ERROR, lag: float = 0.0
) -> TableForce | None:
    """Return the largest force on the table of the first put-down from patches; None without one.

    None by laws, too, that do not let go of the load at a put-down.

    From contact on the payload rests at the distance x from its reference along the table's normal n, and the
    arms that hold it bear the support S, at first the weight W::

        S   = Z - G (x' + gamma x)                        G = n^T (sum c_i K_i) n
        Z'  = -G alpha phi(x' + gamma x) - (1 - lambda) (g / T) S
        F   = W - S                                       force on the table

    lambda is the part of the load that arms bear by the plan: while it is one the integral goes on against
    the table, with x at rest by ``G gamma k_I x``; at zero it rests at ``G gamma k_I x T / g`` beyond W.
    Grasps and table are rigid in it, which is more than a run has. Before, payload and arms of the inertia
    A along n meet a table with the speed v, and with k of table and bristles.

    Args:
        scenario: Scenario with motion, plan and law.
        table_error: Least height of the table above the end of the motion, m; what the cell says if more.
        lag: Error of the motion before contact with all arms, m, by which the payload may meet it earlier.

    Raises:
        OutOfRangeError: table_error is not positive.
        CoopPinError: an arm does not reach its grasp there.
    """
    table_error = as_positive("table_error", table_error)
    law: Any = scenario.controller
    cell = scenario.cell
    if not scenario.put_downs or not law.load_transfer.releases or len(cell.patches) < len(cell.arms):
        return None
    put_down = scenario.put_downs[0]
    X_WP = scenario.payload_motion.at(put_down.time).X_WP_d
    below = _table_below(scenario, X_WP)
    if below is None:
        return None
    depth, table, n = below
    G, part, gamma, alpha, beta = _gains_along(scenario, law, put_down.time, X_WP, n)
    height = max(depth, table_error)
    times, x, rate = _errors(scenario, put_down, n, height + lag / part)
    Z = weight = -cell.payload.mass * float(n @ cell.gravity)
    forces, step = list[float](), float(times[1] - times[0])
    for time, s in zip(times.tolist(), (rate + gamma * x).tolist(), strict=True):
        wound = Z - G * (s + step * alpha * float(law.switching(np.array(s))))
        S = wound / (1.0 + step * beta * (1.0 - scenario.grasp_plan_at(time).borne))
        Z = S + G * s
        forces.append(weight - S)
    worst = int(np.argmax(forces))
    impact = float(rate[0]) * _impedance(scenario, put_down.time, X_WP, table, n)
    return TableForce(forces[worst], impact, weight, table, height, float(times[worst]))


def _table_below(scenario: Scenario, X_WP: Array) -> tuple[float, str, Array] | None:
    """Return how deep the payload would be in the table under it, m, the table's name and its normal."""
    points = corners(scenario.cell.payload) @ X_WP[:3, :3].T + X_WP[:3, 3]
    depths = list[tuple[float, str, Array]]()
    for name, table in scenario.cell.tables.items():
        x, (lower, upper) = (points - table.matrix[:3, 3]) @ table.matrix[:3, :3], table.bounds
        within = np.all((x[:, :2] >= lower) & (x[:, :2] <= upper), axis=1)
        if within.any():
            depths.append((-float(x[within, 2].min()), name, table.matrix[:3, 2]))
    return max(depths, key=lambda depth: depth[0], default=None)


def _errors(scenario: Scenario, put_down: PutDown, n: Array, height: float) -> tuple[Array, Array, Array]:
    """Return times from contact to the end of the put-down, and the error along n and its rate."""
    motion, start = scenario.payload_motion, 0.0
    z_end = n @ motion.at(put_down.time).X_WP_d[:3, 3]
    for _ in range(2):  # over the whole motion, and from the last time before contact
        times = np.linspace(start, put_down.end, _INSTANTS)
        targets = [motion.at(time) for time in times.tolist()]
        z = np.array([n @ target.X_WP_d[:3, 3] for target in targets]) - z_end
        free = np.flatnonzero((z > height) & (times < put_down.time))
        start = float(times[free[-1]]) if free.size else start
    touches = z <= height
    rate = -np.array([n @ target.V_WP_d[:3] for target in targets])
    return times[touches], height - z[touches], rate[touches]


def _gains_along(
    scenario: Scenario, law: PayloadSpace, time: float, X_WP: Array, n: Array
) -> tuple[float, ...]:
    """Return G of the arms that hold, N s/m, its part of that of all, gamma and alpha along n, and g / T."""
    cell, holds = scenario.cell, scenario.grasp_plan_at(time).holds
    axes = X_WP[:3, :3].T if law.gain_axes == "payload" else np.eye(3)
    row, k_0 = cell.task_rows.select(np.append(axes @ n, np.zeros(3))), cell.task_rows.size
    gains: list[Any] = [law.gains_of(name).sized(k_0, k_0) for name in cell.arms]
    G = cell.shares * [float(row @ of_arm.sliding_gain @ row) for of_arm in gains]
    gamma, alpha = (float(row @ gain @ row) for gain in (gains[0].pose_gain, gains[0].sign_gain))
    held = float(G[holds].sum())
    return held, held / float(G.sum()), gamma, alpha, gains[0].anchor_gain / scenario.clock.period


def _impedance(scenario: Scenario, time: float, X_WP: Array, table: str, n: Array) -> float:
    """Return sqrt(k A) of payload and arms that hold it, on their bristles and a table, N s/m."""
    cell, holds = scenario.cell, scenario.grasp_plan_at(time).holds
    row, inertia, stiffness = cell.task_rows.select(np.append(n, np.zeros(3))), cell.payload.mass, 0.0
    for name in np.array(list(cell.arms))[holds].tolist():
        arm, grasp = CellArm(cell, name), cell.patches[name]
        q = solve_ik(arm, X_WP, posture=cell.arms[name].posture)
        J = cell.task_rows.select(arm.payload_jacobian(q))
        inertia += float(row @ np.linalg.solve(J @ np.linalg.solve(arm.mass_matrix(q), J.T), row))
        in_plane = (X_WP[:3, :3] @ grasp.matrix[:3, :3] @ grasp.plane[:3, :3]).T @ n
        stiffness += float(in_plane**2 @ grasp.stiffnesses[:3])
    return math.sqrt(inertia / (1.0 / stiffness + 1.0 / cell.tables[table].stiffness))
