"""Redundant sliding-mode law in a closed loop, built from a description: a planar cell and two Pandas."""

import numpy as np
import pytest
from close import assert_close
from linkages import bar, robot

import coop_pin as cp
from coop_pin.base.schema.pose import Pose
from coop_pin.control import RedundantSlidingModeController
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.grasps import CellChain
from coop_pin.simulation.build_controller import build_controller

STIFFNESS, DAMPING = 60.0, 4.0
PULL = 0.1
"""Distance of every posture from the start along the spare joint, rad."""


def four_bar_arm(folder):
    """An arm with four hinges in the plane: one more than the planar task has rows."""
    bars = [bar("one", "ground", (0, 0, 0), length=0.4, mass=2.0)]
    for parent, child in (("one", "two"), ("two", "three"), ("three", "four")):
        bars.append(bar(child, parent, (0.4, 0, 0), length=0.4, mass=1.0))
    path = folder / "four_hinges.urdf"
    path.write_text(robot(*bars))
    return str(path)


def planar(folder):
    """Two arms of four hinges hold a bar."""
    arms, grasps = {}, {}
    for name, side in (("left", -1.0), ("right", 1.0)):
        arms[name] = Arm(
            urdf=four_bar_arm(folder),
            tip="four",
            base=Pose(xyz=(side * 0.6, 0, 0), rpy=(0, 0, 0.0 if side < 0 else np.pi)),
            posture=tuple(np.array((1.5, -0.6, -0.8, 0.5)) * -side),
            friction="none",
        )
        grasps[name] = Pose(xyz=(side * 0.1, 0, 0), rpy=(0, 0, 0.6 if side < 0 else np.pi - 0.6))
    cell = Cell(arms=arms, payload=Payload.bar(2.0, 0.2), grasps=grasps, rows="planar", gravity=(0, 0, -9.81))
    return cell, Pose(xyz=(0.0, 0.55, 0.0)), [8.0, 6.0, 4.0, 2.0]


def spatial(_folder):
    scenario = cp.Scenario.load("two-pandas-box")
    arms = {name: arm.replace(friction="none") for name, arm in scenario.cell.arms.items()}
    return (
        scenario.cell.replace(arms=arms, gravity=(0, 0, 0)),
        scenario.start,
        [20.0, 20.0, 15.0, 15.0, 4.0, 4.0, 2.0],
    )


CELLS = {"planar": planar, "spatial": spatial}


@pytest.fixture(params=CELLS, scope="module")
def scenario(request, tmp_path_factory):
    """At the start every arm stands off its posture by what its spare joint can move."""
    cell, start, damping = CELLS[request.param](tmp_path_factory.mktemp("robots"))
    chain = CellChain(cell)
    q = chain.configuration(start.matrix)
    angles = {place.name: place.angles.of(q[place.q_slice]).tolist() for place in chain.model.arms}
    pulled = {}
    for place in chain.model.arms:
        spare = spare_direction(cell, place.name, angles[place.name])
        pulled[place.name] = cell.arms[place.name].replace(
            posture=tuple(np.array(angles[place.name]) + PULL * spare)
        )
    return cp.Scenario(
        name="redundant",
        cell=cell.replace(arms=pulled),
        controller={
            "kind": "sliding-mode-redundant",
            "posture": {"stiffness": STIFFNESS, "damping": DAMPING},
            "gains": {
                "pose_gain": 4.0,
                "sign_gain": 0.0,
                "damping_gain": damping,
                "transient_rate": 5.0,
            },
        },
        motion={"kind": "hold", "pose": start},
        squeeze={"left": (-8, 0, 0, 0, 0, 0), "right": (8, 0, 0, 0, 0, 0)},
        start=start,
        start_angles=angles,
        clock={"rate_hz": 500.0, "steps_per_tick": 1},
        duration=1.0,
    )


def spare_direction(cell, name, angles):
    """The unit joint velocity that leaves the payload at rest."""
    model = cp.model.CellArm(cell, name)
    J = cell.task_rows.select(model.payload_jacobian(model.posture(np.array(angles))))
    assert J.shape[1] == J.shape[0] + 1
    return np.linalg.svd(J)[2][-1]


def off_posture(scenario, result, sample):
    """How far each spare joint is from the posture, rad."""
    off = []
    for index, (name, arm) in enumerate(scenario.cell.arms.items()):
        at = result.data.joint_position.values[sample, index]
        off.append(abs(spare_direction(scenario.cell, name, at) @ (at - np.array(arm.posture))))
    return np.array(off)


def test_the_law_of_a_description_has_its_posture_term(scenario):
    for name, controller in build_controller(scenario).controllers.items():
        assert isinstance(controller, RedundantSlidingModeController)
        posture = controller.posture
        assert_close(posture.angles, scenario.cell.arms[name].posture, atol=0.0)
        assert_close(posture.stiffness, np.full(len(posture.angles), STIFFNESS), atol=0.0)
        assert_close(posture.damping, np.full(len(posture.angles), DAMPING), atol=0.0)


def test_the_payload_is_held_and_squeezed_while_the_spare_joints_go_to_their_posture(scenario):
    """Without the posture term nothing moves the spare joints but what couples them to the others."""
    result = cp.run(scenario, warn=False)
    error = np.abs(result.data.pose_error.values)
    assert error[:, :3].max() < 5e-3
    assert error[:, 3:].max() < 3e-2
    assert_close(off_posture(scenario, result, 0), [PULL, PULL], atol=1e-6)
    assert off_posture(scenario, result, -1).max() < 0.05 * PULL
    assert_close(error[-1], np.zeros(6), atol=5e-3)
    assert_close(result.data.internal_axial[-1], [-8.0, -8.0], atol=0.1)
    assert result.energy_balance_max() < 1e-6
