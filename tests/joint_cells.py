"""Cells of the catalogue with joints for grasps, and the internal wrench that a bias leaves there."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import coop_pin as cp
from coop_pin.grasps import CellChain
from coop_pin.model.inverse_kinematics import solve_ik

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


FIVE_JOINTS = Path(__file__).parent / "data" / "five-joint-hinges.toml"


def upright(**changes) -> cp.Scenario:
    """The cell of five joints with four and upright tools: the payload moves in x, y, z and yaw.

    It starts where the arms' parallel axes are askew: on their line the payload may also pitch.
    """
    locked = {"locked": {"wrist_3_joint": 0.0, "wrist_2_joint": -np.pi / 2.0}}
    arm = locked | {"posture": (-0.2, -1.445, 1.518, 4.64)}
    fields = {f"cell.arms.{name}.{key}": value for name in ("left", "right") for key, value in arm.items()}
    aside = (0.0, 0.15, 0.35)
    fields |= {"start.xyz": aside, "motion.start.xyz": aside, "motion.goal.xyz": (0.04, 0.2, 0.42)}
    return cp.Scenario.load(FIVE_JOINTS).override(fields | {"motion.goal.rpy": (0.0, 0.0, 0.15)} | changes)


def four_bar(**changes) -> cp.Scenario:
    """Two Adepts with one joint each and the bar on hinges in a vertical plane: crank, coupler, rocker."""
    scenario = jointed("adept-anchored", {"left": "hinge", "right": "hinge"})
    chain, pose = CellChain(scenario.cell, scenario.plant), scenario.start.model_dump()
    fields = {"motion": {"kind": "hold", "pose": pose}, "start_angles": {}, "events": (), "squeeze": {}}
    for arm in chain.arms:
        q = solve_ik(arm, scenario.start.matrix, posture=arm.description.posture)
        first, *others = arm.joint_angles(q)
        path, names = f"cell.arms.{arm.name}", ("joint_2", "joint_3")
        fields |= {f"{path}.locked": dict(zip(names, others, strict=True)), f"{path}.posture": (first,)}
        fields |= {f"{path}.drive": None, f"{path}.friction": {}}
    return scenario.override(fields | {"cell.gravity": (0.0, -9.81, 0.0)} | changes)


def bias_wrenches(scenario: cp.Scenario, q: np.ndarray, biased: int, bias) -> np.ndarray:
    """Internal wrenches about P in payload axes that a bias of one tip leaves at rest, shape (m, k_0).

    The bias is in axes of the tip, m, of a joint with a tilt, rad; the frame of a joint has no lever.

    With r = k_I gamma / beta, K_i = (B_i^T K^-1 B_i)^-1, of a rigid grasp B_i = I about P, and the part
    P_i = J_i J_i^+ of the rows that the drives of an arm feel, I with joints enough::

        P_i h_i = r P_i c_i K_i (b_i + B_i^T x),    sum_i B_i h_i = 0,    (I - P_i) B_i^T x = 0

    for x, the displacement of the payload, and (I - P_i) h_i, which the structure of an arm bears.
    """
    cell, law, chain = scenario.cell, scenario.controller, CellChain(scenario.cell, scenario.plant)
    gains, rows = law.gains.sized(cell.task_rows.size, 0), list(cell.task_rows.indices)
    rate = float(gains.sign_gain[0, 0] / law.switching.width * gains.pose_gain[0, 0])
    rate *= scenario.clock.period / gains.anchor_gain
    K, terms, R_WP = gains.sliding_gain, [], chain.payload_pose(q)[:3, :3]
    for index, arm in enumerate(chain.arms):
        B, q_i = cell.transmitted()[index], q[chain.model.arms[index].q_slice]
        b, S = np.zeros(B.shape[1]), np.zeros((B.shape[1], 0))
        if index == biased:
            seen, held = R_WP.T @ arm.tip_pose(q_i)[:3, :3], rows
            if arm.grasp_rows is not None:
                held, seen = list(arm.grasp_rows.indices), arm.grasp_rows.X_PC[:3, :3].T @ seen
            b = (np.kron(np.eye(2), seen) @ np.resize((*bias, 0.0, 0.0, 0.0), 6))[held]
        if arm.nv < B.shape[1]:  # an arm does not see the turn of its joint
            R_PC, seen = arm.grasp_rows.X_PC[:3, :3], arm.payload_pose(q_i)[:3, :3]
            turn = np.kron(np.eye(2), R_PC.T @ R_WP.T @ seen @ R_PC)[np.ix_(*[arm.grasp_rows.indices] * 2)]
            S = turn @ np.linalg.svd(arm.task_jacobian(q_i))[0][:, arm.nv :]
        c_K = cell.share(arm.name) * np.linalg.inv(B.T @ np.linalg.inv(K) @ B)
        terms.append((B, rate * c_K, b, S, np.eye(len(S)) - S @ S.T))
    total = sum(B @ P @ r_K @ B.T for B, r_K, _, _, P in terms)
    stiff = np.hstack([B @ S for B, _, _, S, _ in terms])
    load = sum(B @ P @ r_K @ b for B, r_K, b, _, P in terms)
    system = np.block([[total, stiff], [stiff.T, np.zeros((stiff.shape[1],) * 2)]])
    x, borne = np.split(-np.linalg.solve(system, np.pad(load, (0, stiff.shape[1]))), [len(total)])
    parts = np.split(borne, np.cumsum([S.shape[1] for *_, S, _ in terms])[:-1])
    return np.array(
        [B @ (P @ r_K @ (b + B.T @ x) + S @ h) for (B, r_K, b, S, P), h in zip(terms, parts, strict=True)]
    )
