"""The two cells every law is tested on: the planar one of the paper and a spatial one with turned grasps."""

from __future__ import annotations

import numpy as np

from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.control import (
    ControlledArm,
    LateForcePath,
    PayloadSpace,
    PayloadSpaceGains,
    SlidingMode,
    SlidingModeGains,
)
from coop_pin.description.catalogue import scenario_names
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.joint_friction import JointFriction
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.reference.motions import HoldMotion

SPATIAL_START = Pose(xyz=(0.45, 0.05, 0.4), rpy=(0.3, -0.2, 0.5))


def arm_of(rows: TaskRows, period: float, load_share: float = 0.5) -> ControlledArm:
    """What a law may know of an arm without a scenario."""
    k = rows.size
    return ControlledArm("left", True, rows, period, load_share, k, np.zeros(k), np.zeros(3), np.eye(4), 0)


def planar_scenario() -> Scenario:
    """The paper's experiment."""
    return Scenario.load("adept-paper")


def spatial_cell() -> Cell:
    """Two UR5 that hold a box between them; the grasp frames are turned away from box and world."""
    friction = JointFriction(viscous=(2.0, 2.0, 1.5, 0.5, 0.5, 0.5), coulomb=0.2, coulomb_velocity=0.1)
    return Cell(
        arms={
            "left": Arm(
                urdf="ur5",
                tip="tool0",
                base=Pose(xyz=(-0.2, 0.0, 0.0)),
                posture=(0.1, -1.2, 1.6, -1.0, -1.4, 0.2),
                friction=friction,
            ),
            "right": Arm(
                urdf="ur5",
                tip="tool0",
                base=Pose(xyz=(1.1, 0.1, 0.05), rpy=(0.0, 0.0, 3.0)),
                posture=(0.1, -1.2, 1.6, -1.0, -1.4, 0.2),
                friction=friction,
            ),
        },
        payload=Payload(mass=3.0, inertia=(0.02, 0.03, 0.04, 0.002, -0.003, 0.001), size=(0.3, 0.1, 0.1)),
        grasps={
            "left": Pose(xyz=(-0.15, 0.01, 0.02), rpy=(0.2, 1.4, 0.3)),
            "right": Pose(xyz=(0.15, -0.02, 0.01), rpy=(-0.3, -1.5, 0.4)),
        },
        load_shares={"left": 0.3, "right": 0.7},
    )


def spatial_scenario() -> Scenario:
    """Hold the box of the spatial cell, squeezed."""
    gains = SlidingModeGains(
        pose_gain=2.0,
        sign_gain=0.0,
        damping_gain=(60.0, 60.0, 30.0, 4.0, 4.0, 2.0),
        force_gain=0.0,
        transient_rate=5.0,
    )
    return Scenario(
        name="spatial-hold",
        cell=spatial_cell(),
        controller=SlidingMode(gains=gains),
        motion=HoldMotion(pose=SPATIAL_START),
        squeeze={"left": (-8.0, 1.0, 0.0, 0.0, 0.2, 0.0), "right": (8.0, -1.0, 0.0, 0.0, -0.2, 0.0)},
        start=SPATIAL_START,
        clock={"rate_hz": 250.0, "steps_per_tick": 2},
        duration=1.0,
    )


SCENARIOS = {"planar": planar_scenario, "spatial": spatial_scenario}


def planar_three_arms(name: str) -> Scenario:
    """The paper's cell with a third arm, unequal shares and a squeeze of all three."""
    scenario = Scenario.load(name, {"events": (), "duration": 0.1, "clock.steps_per_tick": 1})
    cell = scenario.cell
    base, posture = Pose(xyz=(0.5, 0.65, 0.0), rpy=(0.0, 0.0, -1.0)), (-1.2, 1.6, 0.0)
    third = cell.arms["left"].replace(base=base, posture=posture)
    squeeze = {
        "left": (-10.0, 2.0, 0.0, 0.0, 0.0, 0.3),
        "right": (6.0, -4.0, 0.0, 0.0, 0.0, -0.1),
        "third": (4.0, 2.0, 0.0, 0.0, 0.0, -0.2),
    }
    cell = cell.replace(
        arms={**cell.arms, "third": third},
        grasps={**cell.grasps, "third": Pose(rpy=(0.0, 0.0, 0.4))},
        load_shares={"left": 0.2, "right": 0.3, "third": 0.5},
    )
    return scenario.replace(cell=cell, squeeze=squeeze)


def random_velocity(chain: object, q: np.ndarray, seed: int) -> np.ndarray:
    """A velocity on the closures."""
    v = np.random.default_rng(seed).normal(size=chain.model.nv)
    return chain.project_velocity(q, v)


def cell_and_start(name: str) -> tuple[Cell, np.ndarray]:
    """A test cell and the payload pose X_WP it starts from."""
    scenario = SCENARIOS[name]()
    return scenario.cell, scenario.start.matrix


RIGID = [
    name
    for name, scenario in ((name, Scenario.load(name)) for name in scenario_names())
    if not (scenario.cell.has_force_elements or scenario.cell.jointed or scenario.cell.driven)
    and scenario.cell.payload.links is None
    and "partner" not in [event.kind for event in scenario.events]
]
"""Scenarios of the catalogue that compiled code can run."""

CATALOGUE_CELLS = ["two-pandas-box", "panda-ur5-bar", "three-ur5-plate", "kinova-pair"]
"""In space, with gravity: redundant, mixed, three-armed and with continuous joints."""
FAR_CELLS = ["three-ur5-far", "five-joint-pair"]
"""In space, with gravity: 0.5 m and 60 degrees in 5 s; the last one has five joints and positional rows."""


def catalogue_cell(name: str) -> tuple[Cell, np.ndarray]:
    """A cell of the catalogue, and the payload pose X_WP that it starts from."""
    scenario = Scenario.load(name)
    return scenario.cell, scenario.start.matrix


def kkt_of(chain: ClosedChain) -> ClosedChain:
    """The same chain (sharing the tree) solved by the KKT solver."""
    other = ClosedChain(
        chain.model, chain.closures.closures, stabilisation=chain.stabilisation, formulation="kkt"
    )
    other.open_allowed = chain.open_allowed
    return other


ANCHORED = {
    "planar": Scenario.load("adept-anchored").controller,
    "spatial": PayloadSpace(
        gains=PayloadSpaceGains(
            pose_gain=5.0,
            sliding_gain=(600.0, 600.0, 600.0, 20.0, 20.0, 20.0),
            sign_gain=0.25,
            transient_rate=5.0,
        ),
        force_path=LateForcePath(),
    ),
}
"""The anchored law of each test cell."""
