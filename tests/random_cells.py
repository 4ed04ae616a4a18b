"""Random cells for ``suggest``: arms of several makers around a box, without any number of the law."""

from __future__ import annotations

import numpy as np

import coop_pin as cp
from coop_pin.base.spatial import exp3
from coop_pin.description.actuators import GravityCompensation
from coop_pin.model import ArmModel

UR = {"tip": "tool0", "posture": (0.0, -1.2, 1.6, -1.97, -1.57, 0.0)}
ROBOTS = {
    # fields of the arm, rated load by its maker in kg
    "panda": (
        {
            "tip": "panda_hand_tcp",
            "locked": {"panda_finger_joint1": 0.03},
            "posture": (0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.78),
        },
        3.0,
    ),
    "xarm7": ({"tip": "link_eef", "posture": (0.0, -0.3, 0.0, 1.2, 0.0, 1.5, 0.0)}, 3.5),
    "ur3": (UR, 3.0),
    "ur5": (UR, 5.0),
    "ur10": (UR, 10.0),
    "z1": (
        {
            "tip": "gripperStator",
            "locked": {"jointGripper": 0.0},
            "posture": (0.0, 1.2, -1.2, 0.0, 0.0, 0.0),
        },
        2.0,
    ),
}
REDUNDANT = ("panda", "xarm7")
_APART = (0.5, 1.5)
"""Distances of neighbouring bases, m."""


def random_cell(seed: int, number: int) -> cp.Scenario:
    """Two to four arms that carry a box along a line and turn it, and hold it for 30 s then.

    Every other cell has a redundant arm; a third of the cells has robots that carry their own weight.

    Args:
        seed: of the set of cells.
        number: of the cell in its set.
    """
    generator = np.random.default_rng((seed, number))
    names = generator.choice(list(ROBOTS), size=generator.choice((2, 2, 2, 3, 4)))
    if number % 2 == 0:
        names[0] = generator.choice(REDUNDANT)
    half = generator.uniform((0.1, 0.06, 0.05), (0.25, 0.2, 0.15))
    arms = _placed(names.tolist(), half, generator)
    rated = min(ROBOTS[name][1] for name in names)
    start, by = cp.Pose(), generator.uniform(-0.08, 0.08, size=3)
    goal = cp.Pose(xyz=tuple(by), rpy=tuple(generator.uniform(-0.15, 0.15, size=3)))
    compensated = number % 3 == 1
    duration = float(generator.uniform(2.0, 4.0))
    return cp.Scenario.draft(
        name=f"random-{seed}-{number}-{'-'.join(names)}",
        cell=cp.Cell(
            arms=arms,
            payload=cp.Payload.box(float(rated * generator.uniform(0.01, 0.6)), tuple(2.0 * half)),
            payload_pose=start,
            grasps="as-posed",
        ),
        controller={"force_path": {"kind": "late"}},
        start=start,
        motion=cp.motions.LineMotion(start=start, goal=goal, start_time=0.5, duration=duration),
        squeeze=cp.squeezes.TipForceSqueeze(force=float(generator.uniform(0.0, 15.0))),
        duration=0.5 + duration + 30.0,
        clock={"rate_hz": float(generator.integers(100, 1001)), "steps_per_tick": 2},
        actuators={"gravity_compensation": GravityCompensation() if compensated else None},
    )


def _placed(names: list[str], half: np.ndarray, generator: np.random.Generator) -> dict[str, cp.Arm]:
    """Arms with their tips on the sides of the box; drawn until the bases are as far apart as wanted."""
    while True:
        arms = {}
        for k, name in enumerate(names):
            fields = ROBOTS[name][0]
            around = 2.0 * np.pi * k / len(names) + generator.uniform(-0.3, 0.3)
            tilt = generator.uniform(0.0, np.pi / 2.0) * (generator.random() < 0.5)
            R = exp3(np.array((0.0, 0.0, around))) @ exp3(np.array((0.0, tilt, 0.0)))
            outward = -np.array((np.cos(around), np.sin(around), 0.0))
            contact = outward * np.min(half[:2] / np.maximum(np.abs(outward[:2]), 1e-9))
            angles = np.array(fields["posture"]) + generator.uniform(-0.3, 0.3, size=len(fields["posture"]))
            tip = ArmModel(cp.Arm(urdf=name, **fields)).tip_pose(angles)[:3, 3]
            base = np.eye(4)
            base[:3, :3], base[:3, 3] = R, contact - R @ tip
            posed = {**fields, "posture": tuple(angles.tolist())}
            arms[f"{name}-{k}"] = cp.Arm(urdf=name, base=cp.Pose.from_matrix(base), **posed)
        bases = np.array([arm.base.xyz for arm in arms.values()])
        gaps = np.linalg.norm(bases - np.roll(bases, 1, axis=0), axis=1)
        if gaps.min() >= _APART[0] and gaps.max() <= _APART[1]:
            return arms
