"""Cells of the catalogue with joints for grasps, and the internal wrench that a bias leaves there."""

from __future__ import annotations

import numpy as np

import coop_pin as cp

H = 0.5**0.5
ACROSS = {
    "adept-anchored": {"left": (0.0, 0.0, 1.0), "right": (0.0, 0.0, 1.0)},
    "two-pandas-box": {"left": (H, H, 0.0), "right": (H, H, 0.0)},
}
"""Axes of hinges in grasp axes: across the plane, and across the line between the grasps."""
CALM = {
    "adept-anchored": {"controller.posture.stiffness": 20.0, "controller.posture.damping": 0.5, "events": ()},
    "two-pandas-box": {"controller.gains.sign_gain": 0.25},
}
"""Postures that a light wrist bears at the control rate; one k_I."""


def jointed(name: str, kinds: dict[str, str], axes=None, **changes) -> cp.Scenario:
    """A scenario of the catalogue with joints for some grasps."""
    scenario = cp.Scenario.load(name)
    stated = axes or ACROSS.get(name, {})
    joints = {
        arm: {
            "kind": kind,
            "axis": stated.get(arm, (0.0, 0.0, 1.0)),
            **scenario.cell.grasps[arm].model_dump(),
        }
        for arm, kind in kinds.items()
    }
    grasps = scenario.cell.model_dump()["grasps"] | joints
    fields = scenario.model_dump() | {"cell": scenario.cell.model_dump() | {"grasps": grasps}}
    return cp.Scenario(**fields).override(CALM.get(name, {}) | changes)


def bias_wrenches(scenario: cp.Scenario, R_WP: np.ndarray, R_WE: np.ndarray, biased: int, bias) -> np.ndarray:
    """Internal wrenches about P in payload axes that a bias of one tip leaves at rest, shape (m, k_0).

    h_i = (k_I gamma / beta) c_i K_i (b_i + B_i^T x), with the x of the payload at which sum_i B_i h_i = 0 and
    K_i = (B_i^T K^-1 B_i)^-1; of a rigid grasp B_i = I about P.
    """
    cell, law = scenario.cell, scenario.controller
    gains, rows = law.gains.sized(cell.task_rows.size, 0), list(cell.task_rows.indices)
    rate = float(gains.sign_gain[0, 0] / law.switching.width * gains.pose_gain[0, 0])
    rate *= scenario.clock.period / gains.anchor_gain
    K, terms = gains.sliding_gain, []
    for index, name in enumerate(cell.arms):
        B = cell.transmitted()[index]
        b = np.zeros(B.shape[1])
        if index == biased:
            shift = R_WP.T @ R_WE @ np.array(bias)
            if name in cell.jointed:
                grasp = cell.grasp_rows(name)
                shift = grasp.X_PC[:3, :3].T @ shift
                b = np.concatenate((shift, np.zeros(3)))[list(grasp.indices)]
            else:
                b = np.concatenate((shift, np.zeros(3)))[rows]
        c_K = cell.share(name) * np.linalg.inv(B.T @ np.linalg.inv(K) @ B)
        terms.append((B, c_K, b))
    total = sum(B @ c_K @ B.T for B, c_K, _ in terms)
    x = -np.linalg.solve(total, sum(B @ c_K @ b for B, c_K, b in terms))
    return np.array([rate * B @ c_K @ (b + B.T @ x) for B, c_K, b in terms])
