"""Exercise 6: freedoms that arms of n joints leave the payload, and what their grasps hold internally."""

import numpy as np

import coop_pin as cp
from coop_pin.feasibility.freedoms import freedoms

KINDS, JOINTS = ("rigid", "hinge", "cylinder", "ball"), (6, 5, 4, 3)


def arms(count, joints, seed=2):
    """UR5 arms around the payload with the last joints locked, at random angles."""
    random, wrists = np.random.default_rng(seed), ("wrist_3_joint", "wrist_2_joint", "wrist_1_joint")
    angles = random.uniform(0.3, 1.3, (count, 6))
    return {
        f"arm{index}": cp.Arm.from_urdf(
            "ur5",
            tip="tool0",
            base=(np.cos(2.0 * index), np.sin(2.0 * index), 0.0),
            posture=tuple(q[:joints]),
            locked=dict(zip(wrists, q[: joints - 1 : -1].tolist(), strict=False)),
        )
        for index, q in enumerate(angles)
    }


def counted(kind, joints):
    """Return freedoms of the payload, and dimension of the internal wrenches; three arms with balls."""
    held = arms(3 if kind == "ball" else 2, joints)
    pose = cp.Pose(xyz=(0.1, 0.2, 0.3), rpy=(0.1, -0.2, 0.3))
    postures = {name: arm.posture for name, arm in held.items()}
    grasps = cp.grasps.grasps_from_configuration(held, postures, pose)
    if kind != "rigid":
        axes = np.random.default_rng(3).normal(size=(len(held), 3)).tolist()
        joint = {name: {"kind": kind, "axis": tuple(axis)} for name, axis in zip(held, axes, strict=True)}
        grasps = {name: grasp.model_dump() | joint[name] for name, grasp in grasps.items()}
    cell = cp.Cell(arms=held, payload=cp.Payload.box(mass=3.0, size=(0.3, 0.2, 0.1)), grasps=grasps)
    still, law = cp.motions.HoldMotion(pose=pose), cp.Scenario.load("two-pandas-hinges").controller
    scenario = cp.Scenario(name=kind, cell=cell, start=pose, motion=still, controller=law, duration=1.0)
    G = np.hstack(list(cell.transmitted()))
    return freedoms(scenario).left, G.shape[1] - int(np.linalg.matrix_rank(G, 1e-6))


def compared():
    """Return freedoms for each number of joints, and the dimension of the internal wrenches, by kind."""
    rows = {}
    for kind in KINDS:
        left, internal = zip(*(counted(kind, joints) for joints in JOINTS), strict=True)
        rows[kind] = (*left, internal[0])
    return rows


if __name__ == "__main__":
    print("grasps    freedoms with arms of", *JOINTS, "joints   internal")
    for kind, (*left, internal) in compared().items():
        print(f"{kind:31}", *left, f"{internal:17}")
