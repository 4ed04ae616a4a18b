"""Random cells for forecasts: planar and spatial, on rigid grasps, on springs, and on patches."""

from __future__ import annotations

import numpy as np
from random_cells import ROBOTS, random_cell

import coop_pin as cp
from coop_pin.base.spatial import exp3
from coop_pin.description.actuators import GravityCompensation
from coop_pin.model import ArmModel

KINDS = ("rigid", "compliant", "patch")
PALMS = {
    # postures in which the tip's z is level, so that it presses on a side
    "panda": (0.0, -0.2, 0.0, -2.3, 0.0, 3.6, 0.785),
    **dict.fromkeys(("ur3", "ur5", "ur10"), (0.0, -1.2, 1.6, -0.4, -1.57, 0.0)),
}


def drawn(folder, seed, kind, number):
    """A cell without gains; three in ten of rigid and compliant ones are planar, half have spare joints."""
    if kind == "patch":
        return on_patches(seed, number)
    of_kind = number + 100 * (kind == "compliant")
    if number % 10 in (2, 5, 9):
        scenario = planar(folder, seed, of_kind, has_spare=number % 2 == 1)
    else:
        scenario = random_cell(seed, of_kind)
        motion = scenario.motion
        scenario = scenario.replace(duration=motion.start_time + motion.duration + 3.0)
    return scenario if kind == "rigid" else on_springs(scenario, seed, number)


def serial_arm(folder, generator, count):
    """URDF of hinges about z, one behind the other."""
    lengths = 3.0 / count * generator.uniform(0.2, 0.45, count)
    masses = generator.uniform(1.0, 6.0) * np.linspace(1.0, 0.5, count)
    text, parent, x = '<link name="base"/>', "base", 0.0
    for k, (length, mass) in enumerate(zip(lengths, masses, strict=True)):
        around = mass * length**2 / 12.0
        text += (
            f'<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>'
            f'<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-2.9" upper="2.9" effort="80" velocity="4"/></joint>'
            f'<link name="l{k}"><inertial><origin xyz="{length / 2.0} 0 0"/><mass value="{mass}"/>'
            f'<inertia ixx="{around / 50.0}" iyy="{around}" izz="{around}" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )
        parent, x = f"l{k}", length
    text += (
        f'<joint name="t" type="fixed"><parent link="{parent}"/><child link="tip"/><origin xyz="{x} 0 0"/>'
        '</joint><link name="tip"/>'
    )
    file = folder / f"serial_{count}_{lengths[0]:.9f}.urdf"
    file.write_text(f'<robot name="serial">{text}</robot>')
    return str(file)


def carried(name, arms, payload, grasps, start, goal, **fields):
    """A draft that carries a payload along a line."""
    begin, duration, rest = fields.pop("times")
    return cp.Scenario.draft(
        name=name,
        cell=cp.Cell(arms=arms, payload=payload, payload_pose=start, grasps=grasps, **fields.pop("cell", {})),
        controller={"force_path": {"kind": "late"}},
        start=start,
        motion=cp.motions.LineMotion(start=start, goal=goal, start_time=begin, duration=duration),
        duration=begin + duration + rest,
        **fields,
    )


def planar(folder, seed, number, has_spare):
    """Two or three planar arms around a box; the first one may have a spare joint."""
    generator, arms = np.random.default_rng((seed, number, 7)), {}
    count = int(generator.choice((2, 2, 3)))
    half = np.array((generator.uniform(0.05, 0.15), generator.uniform(0.03, 0.08), 0.05))
    for k in range(count):
        usual = (-1.1, 0.9, 0.8, -0.6) if has_spare and k == 0 else (-0.9, 1.3, -0.4)
        around = 2.0 * np.pi * k / count + generator.uniform(-0.2, 0.2)
        outward = -np.array((np.cos(around), np.sin(around), 0.0))
        contact = outward * np.min(half[:2] / np.maximum(np.abs(outward[:2]), 1e-9))
        posture = np.array(usual) + generator.uniform(-0.2, 0.2, len(usual))
        arm = cp.Arm(urdf=serial_arm(folder, generator, len(usual)), tip="tip", posture=tuple(posture))
        tip, base = ArmModel(arm).tip_pose(posture)[:3, 3], np.eye(4)
        base[:3, :3] = exp3(np.array((0.0, 0.0, around - np.arctan2(tip[1], tip[0]))))
        base[:3, 3] = contact - base[:3, :3] @ tip
        arms[f"arm{k}"] = arm.replace(base=cp.Pose.from_matrix(base))
    if generator.random() < 0.5:
        friction = cp.actuators.JointFriction(viscous=1.0, coulomb=0.2, coulomb_velocity=0.1)
        arms = {name: arm.replace(friction=friction) for name, arm in arms.items()}
    by, turn = generator.uniform(-0.06, 0.06, 2), float(generator.uniform(-0.2, 0.2))
    return carried(
        f"planar-{seed}-{number}",
        arms,
        cp.Payload.box(float(generator.uniform(0.3, 4.0)), tuple(2.0 * half)),
        "as-posed",
        cp.Pose(),
        cp.Pose(xyz=(*by.tolist(), 0.0), rpy=(0.0, 0.0, turn)),
        cell={"rows": "planar", "gravity": (0.0, 0.0, 0.0)},
        times=(0.5, float(generator.uniform(1.5, 3.5)), 3.0),
        squeeze=cp.squeezes.TipForceSqueeze(force=float(generator.uniform(0.0, 15.0))),
        clock={"rate_hz": float(generator.integers(200, 1001)), "steps_per_tick": 2},
    )


def on_springs(scenario, seed, number):
    """The cell on compliant grasps of 5 to 300 kN/m."""
    generator = np.random.default_rng((seed, number, 11))
    k, lever, softer = (
        5e3 * 60.0 ** generator.random(),
        generator.uniform(0.07, 0.15),
        generator.uniform(0.5, 1),
    )
    stiffness, ratio = (k, k, k * softer, *(3 * [k * lever**2])), float(generator.uniform(0.1, 0.6))
    grasps = {
        name: cp.CompliantGrasp(xyz=grasp.xyz, rpy=grasp.rpy, stiffness=stiffness, damping_ratio=ratio)
        for name, grasp in scenario.cell.grasps.items()
    }
    return scenario.override({"cell.grasps": grasps, "name": f"{scenario.name}-springs-{1e-3 * k:.0f}"})


def on_patches(seed, number):
    """Two arms that press a box between their palms; every other cell has a redundant one."""
    generator, arms, grasps = np.random.default_rng((seed, number, 13)), {}, {}
    names = generator.choice(list(PALMS), size=2)
    if number % 2 == 0:
        names[0] = "panda"
    half, stiffness = (
        generator.uniform((0.1, 0.08, 0.06), (0.2, 0.16, 0.12)),
        1e4 * 10.0 ** generator.random(),
    )
    for name, side in zip(names, (-1.0, 1.0), strict=True):
        fields, inward = ROBOTS[name][0], np.array((-side, 0.0, 0.0))
        posture = np.array(PALMS[name]) + generator.uniform(-0.1, 0.1, len(PALMS[name]))
        arm = cp.Arm(urdf=str(name), **{**fields, "posture": tuple(posture)})
        tip = ArmModel(arm).tip_pose(posture)
        z = exp3(np.array((0.0, 0.0, np.arctan2(0.0, -side) - np.arctan2(tip[1, 2], tip[0, 2]))))
        axis = np.cross(z @ tip[:3, 2], inward)
        sine = np.linalg.norm(axis)
        base, grasp = np.eye(4), np.eye(4)
        base[:3, :3] = exp3(axis / max(sine, 1e-9) * np.arctan2(sine, z @ tip[:3, 2] @ inward)) @ z
        grasp[:3, :3] = base[:3, :3] @ tip[:3, :3]
        grasp[:3, 3] = (side * half[0], *generator.uniform(-0.02, 0.02, 2))
        base[:3, 3] = grasp[:3, 3] - base[:3, :3] @ tip[:3, 3]
        label, at = ("left", "right")[side > 0.0], cp.Pose.from_matrix(grasp)
        arms[label] = arm.replace(base=cp.Pose.from_matrix(base))
        grasps[label] = cp.PatchGrasp(
            kind="patch",
            xyz=at.xyz,
            rpy=at.rpy,
            mu=float(generator.uniform(0.4, 0.9)),
            radius=float(generator.uniform(0.02, 0.04)),
            stiffness=stiffness,
            shear_stiffness=stiffness * float(generator.uniform(0.5, 1.0)),
        )
    rated = min(ROBOTS[name][1] for name in names)
    by, turn = generator.uniform(-0.06, 0.06, 3), generator.uniform(-0.1, 0.1, 3)
    return carried(
        f"patch-{seed}-{number}-{'-'.join(names)}",
        arms,
        cp.Payload.box(float(rated * generator.uniform(0.1, 0.5)), tuple(2.0 * half)),
        grasps,
        cp.Pose(),
        cp.Pose(xyz=tuple(by.tolist()), rpy=tuple(turn.tolist())),
        times=(0.3, float(generator.uniform(1.0, 1.8)), 0.8),
        clock={"rate_hz": float(generator.choice((500.0, 1000.0, 1000.0, 2000.0))), "steps_per_tick": 2},
        actuators={"gravity_compensation": GravityCompensation() if number % 3 == 1 else None},
    )
