"""What tests of end stops share: arms whose joint has a stop just ahead, and a plant that runs into it."""

from __future__ import annotations

import re
from pathlib import Path

from cells import SCENARIOS

import coop_pin as cp
from coop_pin.description.urdf import find_urdf
from coop_pin.grasps import CellChain

JOINTS = {"planar": "joint_2", "spatial": "elbow_joint"}
"""Joint of the left arm that runs into its stop."""


def limited(folder: Path, arm: cp.Arm, joint: str, upper: float) -> cp.Arm:
    """The arm with another upper limit of a joint, from a copy of its URDF."""
    text = find_urdf(arm.urdf).path.read_text(encoding="utf-8")
    block = re.search(rf'<joint[^>]*name="{joint}".*?</joint>', text, re.DOTALL)
    assert block is not None
    changed = re.sub(r'upper="[^"]*"', f'upper="{float(upper)!r}"', block[0])
    assert changed != block[0]
    file = folder / f"{joint}.urdf"
    file.write_text(text.replace(block[0], changed), encoding="utf-8")
    return arm.replace(urdf=str(file))


def ahead(name: str, folder: Path, gap: float, alone: bool = False, **stops) -> cp.Scenario:
    """A test cell, or its left arm by itself, with a stop a gap ahead of where a joint starts."""
    scenario = SCENARIOS[name]().replace(events=())
    cell = scenario.cell
    start = CellChain(cell).configuration(scenario.start.matrix)[index(name)]
    left = limited(folder, cell.arms["left"], JOINTS[name], float(start) + gap).replace(stops=stops)
    arms, grasps, shares = {**cell.arms, "left": left}, cell.grasps, cell.load_shares
    if alone:
        arms, grasps, shares = ({"left": part["left"]} for part in (arms, grasps, {"left": 1.0}))
    cell = cell.replace(arms=arms, grasps=grasps, load_shares=shares)
    squeeze = {"left": (0.0,) * 6} if alone else scenario.squeeze
    return scenario.replace(cell=cell, squeeze=squeeze)


def index(name: str) -> int:
    """Number of the joint in the tree's coordinates."""
    arm = SCENARIOS[name]().cell.arms["left"]
    return arm.moving_joints().index(JOINTS[name])
