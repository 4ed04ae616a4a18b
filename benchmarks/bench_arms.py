"""Cost of one closed-chain RK4 step against the number of arms: 1 to 12 Pandas around one plate, and MuJoCo.

    python benchmarks/bench_arms.py [--arms 12] [--blocks 7] [--calls 100]

MuJoCo steps the same tree, built from the same numbers.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin
from common import elsewhere, interleaved, ratio

import coop_pin as cp
from coop_pin import Arm, Cell, Payload, Pose
from coop_pin.base.spatial import make_pose
from coop_pin.grasps import CellChain
from coop_pin.plant import PlantOptions
from coop_pin.simulation.pinocchio_plant import PinocchioPlant

POSTURE = (-0.406, -0.537, 0.32, -2.256, 0.164, 1.739, 1.415)
STEP = 1e-3


def ring_cell(count: int) -> Cell:
    """Return a cell of Pandas, evenly spaced around a plate that they hold by its rim."""
    grasp = make_pose((-0.2, 0.0, 0.05), (np.pi, 0.0, 0.0)) @ make_pose(rpy=(0.0, 0.0, np.pi / 4))
    arms, grasps = {}, {}
    for index in range(count):
        turn = make_pose(rpy=(0.0, 0.0, 2.0 * np.pi * index / count))
        base = Pose.from_matrix(turn @ make_pose((-0.6, 0.0, 0.0)))
        arms[f"arm{index}"] = Arm(
            urdf="panda",
            tip="panda_hand_tcp",
            base=base,
            posture=POSTURE,
            locked={"panda_finger_joint1": 0.03},
            friction="none",
        )
        grasps[f"arm{index}"] = Pose.from_matrix(turn @ grasp)
    return Cell(arms=arms, payload=Payload.cylinder(4.0, 0.25, 0.03), grasps=grasps)


def plant_at_rest(cell: Cell) -> PinocchioPlant:
    """Return the plant in its initial state."""
    chain = CellChain(cell)
    return PinocchioPlant(chain, PlantOptions(), chain.configuration(make_pose((0.0, 0.0, 0.4))))


def numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def placement(X: pin.SE3) -> str:
    quaternion = pin.Quaternion(X.rotation)
    return (
        f'pos="{numbers(X.translation)}" quat="{quaternion.w} {quaternion.x} {quaternion.y} {quaternion.z}"'
    )


def body_xml(model: pin.Model, joint: int) -> str:
    """Return the body of a joint with its subtree, from the numbers of the Pinocchio model."""
    assert model.joints[joint].shortname() == "JointModelRZ"
    inertia = model.inertias[joint]
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia
    sites = "".join(
        f'<site name="{frame.name}" {placement(frame.placement)}/>'
        for frame in model.frames
        if frame.parentJoint == joint and (frame.name.startswith("payload/") or frame.name.endswith("/grasp"))
    )
    children = "".join(
        body_xml(model, child) for child in range(joint + 1, model.njoints) if model.parents[child] == joint
    )
    return f"""<body {placement(model.jointPlacements[joint])}><joint axis="0 0 1"/>
        <inertial pos="{numbers(inertia.lever)}" mass="{inertia.mass}"
            fullinertia="{numbers(np.array((xx, yy, zz, xy, xz, yz)))}"/>
        {sites}{children}</body>"""


def mjcf(plant: PinocchioPlant) -> str:
    """Return the same tree with one weld for each closure."""
    tree = plant.chain.model
    roots = [joint for joint in range(1, tree.model.njoints) if tree.model.parents[joint] == 0]
    held = [arm.name for arm in tree.arms if arm.name not in tree.closed_by_tree]
    welds = "".join(
        f'<weld site1="{name}/grasp" site2="payload/{name}" solimp="0.9999 0.9999 0.001 0.5 2"'
        f' solref="{2 * STEP} 1"/>'
        for name in held
    )
    return f"""<mujoco><compiler balanceinertia="true" boundmass="1e-9" boundinertia="1e-9"/>
        <option integrator="RK4" timestep="{STEP}" gravity="{numbers(tree.model.gravity.linear)}"/>
        <worldbody>{"".join(body_xml(tree.model, joint) for joint in roots)}</worldbody>
        <equality>{welds}</equality></mujoco>"""


def mujoco_task(plant: PinocchioPlant):
    """Return a function that makes one MuJoCo step from rest, at the same configuration."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf(plant))
    data = mujoco.MjData(model)
    start = plant.q.copy()

    def task() -> None:
        data.qpos[:], data.qvel[:] = start, 0.0
        mujoco.mj_step(model, data)

    return task


def chain_task(plant: PinocchioPlant):
    """Return a function that makes one step of the closed chain from rest."""
    start = plant.q.copy()

    def task() -> None:
        plant.q, plant.v = start, np.zeros(len(start))
        plant.advance(0.0, STEP)

    return task


def main(argv: list[str] | None = None) -> None:
    """Print one row for each number of arms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=12)
    parser.add_argument("--blocks", type=int, default=7)
    parser.add_argument("--calls", type=int, default=100)
    options = parser.parse_args(argv)
    tasks = {}
    for count in range(1, options.arms + 1):
        plant = plant_at_rest(ring_cell(count))
        tasks[f"coop_pin {count}"] = chain_task(plant)
        tasks[f"mujoco {count}"] = mujoco_task(plant)
    seconds = interleaved(tasks, options.blocks, options.calls)
    unit = seconds["coop_pin 1"]
    print(
        f"coop_pin {cp.__version__}: one RK4 step of 1 ms, in steps of coop_pin with one arm; median (range)"
    )
    for count in range(1, options.arms + 1):
        ours, theirs = seconds[f"coop_pin {count}"], seconds[f"mujoco {count}"]
        print(
            f"{count} arms: coop_pin {ratio(ours, unit)}   mujoco {ratio(theirs, unit)}"
            f"   coop_pin/mujoco {ratio(ours, theirs)}"
        )


if __name__ == "__main__":
    with elsewhere():
        main()
