"""Closures of a cell as scalar code: errors, and the forces that keep them.

The constraint is that of chain.closure_set: e = -log6(X_i^-1 X_0) of the payload frames that arm i and the
arm with the payload hold, here in world axes about the world's origin, which takes it to V_i - V_0 = e'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from coop_pin.compiled.plant.arm_dynamics import ArmResponse, factor, solve_lower, solve_transposed
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.serial_arm import Numbers, cross, join, motion_cross
from coop_pin.tracing.elementary import polynomial

_ROTATION = (15.0 / 336.0, 3.0 / 40.0, 1.0 / 6.0, 1.0)
_TRANSLATION = (1.0 / 30240.0, 1.0 / 720.0, 1.0 / 12.0)
"""Series of asin(s) / s in s^2, and of (1 - x / 2 cot(x / 2)) / x^2 in x^2: exact for closed grasps."""


def closure_error(R_0: Numbers, p_0: Numbers, R_i: Numbers, p_i: Numbers) -> Numbers:
    """Return e = -log6(X_0 X_i^-1) = -[p - w x p / 2 + beta w x (w x p), w] in the world, shape (6,)."""
    R = R_0 @ R_i.T
    p = p_0 - R @ p_i
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]], dtype=object)
    w = polynomial(sine @ sine, _ROTATION) * sine
    wp = cross(w, p)
    return -join(p - 0.5 * wp + polynomial(w @ w, _TRANSLATION) * cross(w, wp), w)


def closure_forces(
    cell: CellNumbers,
    terms: Sequence[ArmResponse],
    W: Numbers,
    errors: Mapping[int, Numbers],
    rows: Sequence[int],
) -> dict[int, Numbers]:
    """Return f_i on the arms with closures by the payload, about the world's origin, shape (6,) each.

    Args:
        cell: Constants of the cell.
        terms: Dynamics of the arms.
        W: Wrench on the payload besides those of closures, about the world's origin, shape (6,).
        errors: Closure errors of the arms with closures.
        rows: Moving rows; the others are zero.
    """
    if cell.carrier is None or not errors:
        return {}
    first, others, k = terms[cell.carrier], [terms[i] for i in errors], len(rows)
    offset = first.b + first.G @ W[rows]
    right, G = [], np.empty((k * len(others), k * len(others)), dtype=object)
    for i, (arm, error) in enumerate(zip(others, errors.values(), strict=True)):
        drift = arm.V - first.V
        closing = motion_cross(drift, arm.V) + cell.velocity_gain * drift + cell.position_gain * error
        right += [*(offset - arm.b - closing[rows])]
        for j in range(len(others)):
            G[k * i : k * (i + 1), k * j : k * (j + 1)] = first.G + arm.G if i == j else first.G
    L, D_inverse = factor(G)
    f = solve_transposed(L, D_inverse * solve_lower(L, np.array(right, dtype=object)))
    forces = np.zeros((len(others), 6)).astype(object)
    forces[:, rows] = f.reshape(-1, k)
    return dict(zip(errors, forces, strict=True))


def error_sizes(errors: Mapping[int, Numbers], tips: Numbers) -> Any:
    """Return distance and angle of the closure errors of some arms at their tips; 0 of the others, (m, 2)."""
    sizes = np.zeros((len(tips), 2)).astype(object)
    for i, error in errors.items():
        linear, angular = error[:3] + cross(error[3:], tips[i]), error[3:]
        sizes[i] = (linear @ linear) ** 0.5, (angular @ angular) ** 0.5
    return sizes
