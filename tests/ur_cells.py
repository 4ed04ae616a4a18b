"""Carries by arms like the UR5, also one of five joints."""

from __future__ import annotations

import numpy as np

import coop_pin as cp
from coop_pin.model import ArmModel

ONES = cp.laws.PayloadSpace(
    gains=cp.laws.PayloadSpaceGains(pose_gain=1.0, sliding_gain=1.0, sign_gain=1.0, transient_rate=1.0),
    force_path=cp.laws.LateForcePath(),
)
"""A controller has to be stated; its gains are not used."""

UR = {"tip": "tool0", "posture": (0.0, -1.2, 1.6, -1.97, -1.57, 0.0)}

UR5_OF_FIVE = {
    "urdf": "ur5",
    "tip": "tool0",
    "locked": {"wrist_3_joint": 0.0},
    "posture": UR["posture"][:5],
}


def carry(name, arms, *, by=(0.0, 0.12, 0.16), mass=2.0, **cell):
    """Arms in a ring, at their postures, carry a box along 0.2 m in 3 s; nothing is stated about the law."""
    placed, angle = {}, 2.0 * np.pi / len(arms)
    for k, fields in enumerate(arms):
        tip = ArmModel(cp.Arm(**fields)).tip_pose(fields["posture"])[:3, 3]
        away = np.array((-(tip[0] + 0.15), 0.0, -tip[2]))
        turn = cp.Pose(rpy=(0.0, 0.0, k * angle)).matrix[:3, :3]
        base = cp.Pose(xyz=tuple(turn @ away), rpy=(0.0, 0.0, k * angle))
        placed[f"arm{k}"] = cp.Arm(base=base, **fields)
    start = cp.Pose()
    return cp.Scenario(
        name=name,
        cell=cp.Cell(
            arms=placed,
            payload=cp.Payload.box(mass, (0.3, 0.2, 0.1)),
            payload_pose=start,
            grasps="as-posed",
            **cell,
        ),
        controller=ONES,
        start=start,
        motion=cp.motions.LineMotion(start=start, goal=cp.Pose(xyz=by), start_time=1.0, duration=3.0),
        duration=5.0,
    )


def short(scenario):
    return scenario.replace(motion=scenario.motion.replace(start_time=0.2, duration=1.5), duration=2.0)
