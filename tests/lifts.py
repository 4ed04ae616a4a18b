"""Two-armed robots on shared joints, as URDF text of our own, and cells of them."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.cell.shared_joint import SharedJoint

_INERTIAL = (
    '<inertial><origin xyz="{x}"/><mass value="{m}"/>'
    '<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def _link(name: str, mass: float, centre: str = "0 0 0", inertia: float = 0.02) -> str:
    return f'<link name="{name}">{_INERTIAL.format(x=centre, m=mass, i=inertia)}</link>'


def _joint(name: str, kind: str, parent: str, child: str, axis: str, xyz: str, rpy: str = "0 0 0") -> str:
    limit = '<limit lower="-6" upper="6" effort="4000" velocity="6"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><origin xyz="{xyz}" rpy="{rpy}"/>{"" if kind == "fixed" else limit}'
        '<dynamics damping="0" friction="0"/></joint>'
    )


def planar_robot() -> str:
    """A rail along x and a turn about z under two planar arms of three joints; moves in the x-y plane."""
    parts = [_link("floor", 3.0), _link("slide", 8.0, "0 0.05 0"), _link("torso", 6.0, "0.02 0 0")]
    parts += [
        _joint("rail", "prismatic", "floor", "slide", "1 0 0", "0.1 0 0"),
        _joint("yaw", "revolute", "slide", "torso", "0 0 1", "0 0.1 0"),
    ]
    for side, x in (("l", -0.25), ("r", 0.25)):
        names = ["torso", *(f"{side}{k}" for k in range(1, 4))]
        for k, (above, link) in enumerate(itertools.pairwise(names)):
            parts.append(_link(link, 2.0 - 0.5 * k, "0.15 0 0"))
            place = f"{x} 0.1 0" if k == 0 else "0.4 0 0"
            parts.append(_joint(f"{side}j{k + 1}", "revolute", above, link, "0 0 1", place))
        parts += [
            f'<link name="{side}tip"/>',
            _joint(f"{side}t", "fixed", f"{side}3", f"{side}tip", "0 0 1", "0.2 0 0"),
        ]
    return f'<robot name="planar">{"".join(parts)}</robot>'


def spatial_robot() -> str:
    """A lift and a turn about z under two arms of six joints, a head on it, and a heavy foot on the floor."""
    parts = [_link("foot", 40.0, "0.1 0 0.1"), _link("slide", 30.0, "0.01 0.02 0.1", 0.5)]
    parts += [_link("torso", 12.0, "0.03 0 0.2", 0.3), _link("head", 2.5, "0.05 0 0.05")]
    parts += [
        _joint("lift", "prismatic", "foot", "slide", "0 0 1", "0.05 0 0.3"),
        _joint("yaw", "revolute", "slide", "torso", "0 0 1", "0.02 0 0.1"),
        _joint("neck", "revolute", "torso", "head", "0 0 1", "0 0 0.5"),
    ]
    axes = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "1 0 0")
    places = ("{x} 0.0 0.3", "0 0 0.1", "0 0.02 0.4", "0 -0.02 0.38", "0 0 0.09", "0.02 0 0.09")
    for side, x in (("l", -0.6), ("r", 0.6)):
        names = ["torso", *(f"{side}{k}" for k in range(1, 7))]
        for k, (above, link) in enumerate(itertools.pairwise(names)):
            parts.append(
                _link(
                    link,
                    (5.0, 6.0, 4.0, 1.5, 1.2, 0.8)[k],
                    f"0.01 0.02 {0.15 if k in (1, 2) else 0.03}",
                    0.03,
                )
            )
            turn = "0 0 0" if k or side == "l" else "0 0 3.14159265358979"
            parts.append(
                _joint(f"{side}j{k + 1}", "revolute", above, link, axes[k], places[k].format(x=x), turn)
            )
        parts += [
            f'<link name="{side}tip"/>',
            _joint(f"{side}t", "fixed", f"{side}6", f"{side}tip", "0 0 1", "0.08 0 0.03", "0.2 0.3 0.1"),
        ]
    return f'<robot name="spatial">{"".join(parts)}</robot>'


def planar_cell(folder: Path, **shared: SharedJoint) -> Cell:
    """The planar robot with a bar between its arms; its grasps are turned away from the bar."""
    file = folder / "planar.urdf"
    file.write_text(planar_robot())
    arms = {}
    for name, side, posture in (("left", "l", (2.2, -1.2, -0.6)), ("right", "r", (0.9, 1.2, 0.6))):
        other = "r" if side == "l" else "l"
        locked = {"rail": 0.05, "yaw": 0.2, **{f"{other}j{k}": 0.0 for k in (1, 2, 3)}}
        base = Pose(xyz=(-0.1, 0.2, 0.0), rpy=(0.0, 0.0, 0.3))
        arms[name] = Arm(urdf=str(file), tip=f"{side}tip", base=base, locked=locked, posture=posture)
    poses = {name: arm.tip_poses(np.array(arm.posture)) for name, arm in arms.items()}
    middle = sum(pose[:2, 3] for pose in poses.values()) / 2
    return Cell(
        arms=arms,
        payload=Payload(mass=2.0, inertia=(0.01, 0.02, 0.03, 0.0, 0.0, 0.0), size=(0.3, 0.05, 0.05)),
        payload_pose=Pose(xyz=(*middle, 0.0), rpy=(0.0, 0.0, 0.4)),
        grasps="as-posed",
        rows="planar",
        gravity=(0.0, 0.0, 0.0),
        load_shares={"left": 0.4, "right": 0.6},
        shared_joints=shared,
    )


def spatial_cell(folder: Path, **shared: SharedJoint) -> Cell:
    """The spatial robot with a box between its arms; grasp frames are turned away from box and world."""
    file = folder / "spatial.urdf"
    file.write_text(spatial_robot())
    arms = {}
    for name, side, posture in (
        ("left", "l", (0.3, 0.3, 1.2, -0.7, 0.3, 0.2)),
        ("right", "r", (-0.2, 0.3, 1.2, -0.6, 0.2, 0.3)),
    ):
        other = "r" if side == "l" else "l"
        locked = {"lift": 0.1, "yaw": 0.3, "neck": 0.4, **{f"{other}j{k}": 0.0 for k in range(1, 7)}}
        base = Pose(xyz=(-0.2, 0.1, 0.05), rpy=(0.0, 0.0, 0.5))
        arms[name] = Arm(urdf=str(file), tip=f"{side}tip", base=base, locked=locked, posture=posture)
    poses = {name: arm.tip_poses(np.array(arm.posture)) for name, arm in arms.items()}
    middle = sum(pose[:3, 3] for pose in poses.values()) / 2
    return Cell(
        arms=arms,
        payload=Payload(mass=4.0, inertia=(0.03, 0.05, 0.06, 0.002, -0.003, 0.001), size=(0.3, 0.2, 0.2)),
        payload_pose=Pose(xyz=tuple(middle), rpy=(0.1, -0.2, 0.4)),
        grasps="as-posed",
        load_shares={"left": 0.4, "right": 0.6},
        shared_joints=shared,
    )
