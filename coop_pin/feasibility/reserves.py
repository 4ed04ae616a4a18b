"""Reserves of the drives at rest: an internal force in addition to the load, and the load without an arm."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.reachability import Reachability
from coop_pin.feasibility.statics import statics_along
from coop_pin.model.cell_arm import CellArm

_NO_LEVER = 1e-12
"""Torque by a newton that counts as none, m."""
_POSES = 9
"""Poses of the motion at which arms are left out."""


@typed
def force_reserve(scenario: Scenario, cell_reach: Reachability) -> float:
    """Return the internal force that no drive is too weak for, whatever its direction, at rest, N.

    Beside weight, load share and squeeze, the least at the poses of the motion; inf without limits.

    Args:
        scenario: arms and payload.
        cell_reach: reachability of the scenario; every arm reaches the whole motion.
    """
    reserve = np.inf
    for reach, arm in zip(cell_reach.arms, statics_along(scenario, cell_reach).arms, strict=True):
        model = CellArm(scenario.cell, reach.arm)
        for q, torque in zip(reach.q, arm.torque, strict=True):
            J = model.rows.select(model.payload_jacobian(q)) @ model.from_drive
            per_newton = np.linalg.norm(J[model.rows.are_linear], axis=0)
            reserve = min(
                reserve, float(np.min((arm.limit - np.abs(torque)) / np.maximum(per_newton, _NO_LEVER)))
            )
    return reserve


@typed
def loads_without_an_arm(scenario: Scenario, cell_reach: Reachability) -> dict[str, tuple[float, float]]:
    """Return for each arm the part of their torque limits that the others need without it, at rest.

    Largest over nine poses of the motion; above 1 no law can hold the payload. By linear programming over
    the wrenches F_i, so that the internal wrench is the best one::

        min t,  |g_i(q) - J_i^T F_i| <= t limit_i for every other arm,  sum_i F_i + F_dead = [m_0 g, 0]

    F_dead = (J^+)^T g(q) of an arm that is limp, and 0 of one that still carries its own weight.

    Args:
        scenario: arms and payload.
        cell_reach: reachability of the scenario; every arm reaches the whole motion.

    Returns:
        By arm the parts with the arm limp, and with it carrying its own weight; 0.0 without limits, inf
        where the others cannot balance the load at all; empty for a single arm.
    """
    if len(cell_reach.arms) < 2:
        return {}
    names, loads = [arm.arm for arm in cell_reach.arms], dict[str, list[tuple[float, float]]]()
    models = [CellArm(scenario.cell, name) for name in names]
    for at in np.linspace(0, len(cell_reach.arms[0].times) - 1, _POSES).astype(int):
        weights, jacobians = [], []
        for arm, model in zip(cell_reach.arms, models, strict=True):
            weights.append(model.nonlinear_effects(arm.q[at], np.zeros(model.nv)))
            jacobians.append(model.payload_jacobian(arm.q[at]))
        surroundings = scenario.surroundings_at(float(cell_reach.arms[0].times[at]))
        W = np.append(surroundings.mass * surroundings.gravity, np.zeros(3))
        for dead, name in enumerate(names):
            F_dead = np.linalg.pinv(jacobians[dead]).T @ weights[dead]
            others = [
                (weights[i] @ model.from_drive, jacobians[i] @ model.from_drive, model.limits.torque)
                for i, model in enumerate(models)
                if i != dead
            ]
            loads.setdefault(name, []).append((_least_part(others, W - F_dead), _least_part(others, W)))
    return {name: tuple(np.max(parts, axis=0).tolist()) for name, parts in loads.items()}


def _least_part(arms: list[tuple[Array, Array, Array]], load: Array) -> float:
    """Return the least t of arms with their g, J and limits, in drive coordinates, under a load, (6,)."""
    if len(arms) == 1:  # its wrench is the load
        g, J, limits = arms[0]
        return float(np.max(np.abs(g - J.T @ load) / limits))
    from scipy.linalg import block_diag  # slow to load
    from scipy.optimize import linprog

    g, limits = (np.concatenate([arm[part] for arm in arms]) for part in (0, 2))
    J, limited = block_diag(*(arm[1] for arm in arms)), np.isfinite(limits)
    A = np.hstack([J.T, limits[:, None]])[limited]  # J^T F + t limit >= g, and likewise for -g
    A, b = np.vstack([-A, A * np.append(np.ones(len(J)), -1.0)]), np.concatenate([-g[limited], g[limited]])
    balance = np.hstack([*(np.eye(6) for _ in arms), np.zeros((6, 1))])
    bounds = [(None, None)] * len(J) + [(0.0, None)]
    solution = linprog(np.eye(len(J) + 1)[-1], A_ub=A, b_ub=b, A_eq=balance, b_eq=load, bounds=bounds)
    return float(solution.fun) if solution.success else np.inf
