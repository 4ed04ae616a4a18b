"""Runs again by the tests' own plant, under the torques that they recorded; planar, and in space, turned.

The reference plant shares no code with what it judges here: springs, contacts, partners, closures, the free
payload, integration, energies and work.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS, planar_three_arms
from compliant_cells import with_grasps
from numpy.testing import assert_allclose
from reference_plant import replayed
from test_friction_grasps import CELLS
from ways import run_on

import coop_pin as cp
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

AS_ROUNDING = 1e-9
"""Largest difference of a quantity, as a part of its largest size in the run."""
STEPS = {"planar": 10, "spatial": 4}
PUSH = {"planar": (60.0, -40.0, 5.0, 0.5, -0.3, 3.0), "spatial": (30.0, -20.0, 25.0, 4.0, -3.0, 5.0)}
PRESS = {"planar": (2.0, 25.0, 50.0, 0.1, 0.1, 0.2), "spatial": (20.0, 60.0, 150.0, 3.0, 3.0, 4.0)}
ALONG_TABLE = (150.0, 20.0, -20.0, 0.0, 0.0, 2.0)
BENCH = {
    "xyz": (0.0, 0.0, 0.4),
    "rpy": (0.0, 0.0, 0.5 * np.pi),
    "size": (0.5, 0.4002),
    "mu": 0.4,
    "stiffness": 2e5,
}
"""Under the crate; two of its corners leave it after 0.1 mm."""


class Shaken(cp.ArmController):
    """Holds the cell at the first tick; then torques of its own are added, which no measurement changes."""

    def __init__(self, scenario, arm, strength):
        self.strength, self.number = strength, list(scenario.cell.arms).index(arm)

    def init(self, measurement, reference):
        return 0, measurement.holding_torque

    def step(self, measurement, reference, state):
        tick, held = state
        added = np.random.default_rng([self.number, tick]).normal(size=len(held)) * (tick > 0)
        return cp.ArmCommand(held + self.strength * added, (tick + 1, held))


def shaken(scenario: cp.Scenario, strength: float, *events, **changes) -> cp.Scenario:
    """A short run whose drives hold the start, and then shake."""
    law = {"kind": "user", "target": Shaken, "options": {"strength": strength}}
    given = {"controller": law, "actuators": {}, "duration": 0.048}
    return scenario.replace(events=()).override(given | changes).replace(events=events)


def changing(name: str) -> list[Any]:
    """Another mass and another gravity, within ticks, and a push over one."""
    mass = SCENARIOS[name]().cell.payload.mass
    return [
        cp.events.PayloadChange(time=0.0155, mass=0.6 * mass),
        cp.events.WrenchPulse(time=0.0102, duration=0.013, wrench=PUSH[name]),
        cp.events.GravityTurn(time=0.027, gravity=(1.0, -2.0, -9.0)),
    ]


def held(name: str, arms: Any = None, *events, **changes) -> cp.Scenario:
    """A run of which all grasps are springs, or those of some arms; the others are rigid."""
    scenario = with_grasps(SCENARIOS[name](), arms=arms)
    return shaken(scenario, 5.0, *changing(name), *events, **{"clock.steps_per_tick": STEPS[name]} | changes)


def jointed(name: str, kinds: dict[str, str], axis: Any = None, *events, **changes) -> cp.Scenario:
    """A run with joints for grasps, about an axis that is askew to grasp, payload and world in space."""
    scenario, turns = SCENARIOS[name](), {"planar": (0.0, 0.0, 2.0), "spatial": (0.4, -0.7, 0.5)}
    joints = {
        f"cell.grasps.{arm}": {
            "kind": kind,
            "axis": turns[name] if axis is None else axis,
            **scenario.cell.grasps[arm].model_dump(),
        }
        for arm, kind in kinds.items()
    }
    return shaken(scenario, 5.0, *changing(name), *events, **{"squeeze": {}, **joints} | changes)


def opening(rest: str) -> list[Any]:
    """The right grasp opens within a tick, and closes again."""
    back = {"duration": 0.01, "approach_time": 0.01, "wait": 0.0, "tolerance": 0.05, "angle_tolerance": 0.5}
    return [
        cp.events.Release(time=0.0131, arm="right"),
        cp.events.Regrasp(time=0.0337, arm="right", rest=rest, **back),
    ]


def partner(name: str) -> cp.events.Partner:
    """A partner who turns the payload, with a handle beside P."""
    pose, turn = SCENARIOS[name]().start, {"axis": (0.1, -0.2, 1.0), "angle": 0.3, "duration": 0.05}
    return cp.events.Partner(
        time=0.0071,
        duration=0.031,
        motion=cp.motions.TurnMotion(pose=pose, **turn),
        handle=cp.Pose(xyz=(0.05, -0.08, 0.03), rpy=(0.3, -0.2, 0.5)),
        stiffness=(4000.0, 3000.0, 5000.0, 40.0, 30.0, 60.0),
        damping=(20.0, 10.0, 15.0, 0.2, 0.1, 0.3),
    )


def continuous() -> cp.Scenario:
    """Springs between a payload and arms whose configurations are no vectors."""
    scenario = with_grasps(cp.Scenario.load("kinova-pair"))
    return shaken(scenario, 0.5, **{"clock.steps_per_tick": 8, "duration": 0.02})


def three_arms() -> cp.Scenario:
    """Springs of three arms; the third lets go."""
    scenario = cp.Scenario.load("three-ur5-handover")
    return shaken(scenario, 5.0, cp.events.Release(time=0.004, arm="third"), duration=0.016)


def pressed(name: str, wrench: Any = None, **changes) -> cp.Scenario:
    """A run between palms that slide and lean under a push."""
    push = cp.events.WrenchPulse(
        time=0.0041, duration=0.008, wrench=PRESS[name] if wrench is None else wrench
    )
    return shaken(CELLS[name](), 2.0, push, **{"duration": 0.016} | changes)


def rectangles() -> cp.Scenario:
    """Palms with corners, in grasp frames that are turned about the normals."""
    grasps, numbers = {}, {"stiffness": 8e4, "shear_stiffness": 3e4, "damping_ratio": 0.4, "mu": 0.5}
    for arm, turn in (("left", 0.4), ("right", -0.3)):
        X = pin.SE3(CELLS["spatial"]().cell.grasps[arm].matrix) * pin.SE3(
            pin.exp3(turn * np.eye(3)[2]), np.zeros(3)
        )
        pose = cp.Pose.from_matrix(X.homogeneous)
        xyz, outline = (pose.xyz[0], 0.003, -0.002), {"size": (0.06, 0.03), "face": (0.12, 0.08)}
        grasps[arm] = {"kind": "patch", "xyz": xyz, "rpy": pose.rpy} | outline | numbers
    return pressed("spatial", (20.0, 25.0, 90.0, 3.0, 2.0, 4.0), **{"cell.grasps": grasps})


def half_pressed() -> cp.Scenario:
    """A palm that presses against a spring."""
    grasp = CELLS["spatial"]().cell.grasps["right"]
    spring = {"kind": "compliant", "xyz": grasp.xyz, "rpy": grasp.rpy, "stiffness": "firm"}
    return pressed("spatial", **{"cell.grasps.right": spring})


def over_table(arms: Any, gap: float) -> cp.Scenario:
    """A run over a small, tilted table, a gap below the lowest corner of the payload."""
    start, size = SCENARIOS["spatial"]().start.matrix, SCENARIOS["spatial"]().cell.payload.size
    corners = [
        start[:3, :3] @ (0.5 * np.array(size) * (x, y, z)) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)
    ]
    lowest = start[:3, 3] + min(corners, key=lambda corner: corner[2])
    xyz = lowest - (0.004, 0.003, gap)
    table = {"xyz": xyz, "rpy": (0.06, -0.05, 0.4), "size": (0.014, 0.3), "mu": 0.4}
    return held("spatial", arms, **{"cell.tables": {"bench": table}})


def under_table() -> cp.Scenario:
    """A run beside a table that is 2 cm higher than the lowest corner, which then moves under its edge."""
    lowest = (0.3477, -0.0435, 0.3089)
    xyz = (lowest[0], lowest[1] - 0.101, lowest[2] + 0.02)
    return held("spatial", None, **{"cell.tables": {"shelf": {"xyz": xyz, "size": (0.2, 0.2), "mu": 0.4}}})


SPRINGS = {
    "planar springs": lambda: held("planar", None, *opening("found")),
    "spatial springs": lambda: held("spatial"),
    "spatial springs, reopened": lambda: held("spatial", None, *opening("nominal")),
    "continuous springs": continuous,
    "three springs": three_arms,
}
"""No grasp is rigid, and none is held by friction."""
PALMS = {
    "planar palms": lambda: pressed("planar"),
    "spatial palms": lambda: pressed("spatial"),
    "rectangular palms": rectangles,
    "palms and table": lambda: pressed("spatial", ALONG_TABLE, **{"cell.tables.bench": BENCH}),
    "palm and spring": half_pressed,
}
OTHERS = {
    "planar, a spring right": lambda: held("planar", ["right"]),
    "spatial, a spring left": lambda: held("spatial", ["left"]),
    "spatial, a spring and a closure": lambda: held("spatial", ["right"], **{"plant.payload": "free"}),
    "planar partner": lambda: held("planar", None, partner("planar")),
    "spatial partner": lambda: held("spatial", None, partner("spatial")),
    "planar partner, rigid": lambda: held("planar", [], partner("planar")),
    "spatial partner, rigid": lambda: held("spatial", [], partner("spatial")),
    "spatial, a spring right, reopened": lambda: held("spatial", ["right"], *opening("found")),
    "planar, rigid": lambda: held("planar", []),
    "planar, three rigid": lambda: shaken(planar_three_arms("adept-paper"), 5.0, *changing("planar")),
    "spatial, rigid": lambda: held("spatial", []),
    "planar, rigid, reopened": lambda: held("planar", [], *opening("found"), **{"plant.payload": "free"}),
    "spatial, rigid, reopened": lambda: held("spatial", [], *opening("found"), **{"plant.payload": "free"}),
    "planar, a hinge": lambda: jointed("planar", {"right": "hinge"}),
    "planar, two hinges": lambda: jointed("planar", {"left": "hinge", "right": "hinge"}),
    "planar, a slider": lambda: jointed("planar", {"right": "cylinder"}, (1.0, 0.4, 0.0)),
    "spatial, a hinge": lambda: jointed("spatial", {"right": "hinge"}),
    "spatial, a hinge at a free payload": lambda: jointed(
        "spatial", {"right": "hinge"}, **{"plant.payload": "free"}
    ),
    "spatial, a ball": lambda: jointed("spatial", {"left": "ball"}),
    "spatial, a cylinder": lambda: jointed("spatial", {"right": "cylinder"}),
    "spatial, hinge and cylinder": lambda: jointed("spatial", {"left": "hinge", "right": "cylinder"}),
    "spatial, a hinge, reopened": lambda: jointed(
        "spatial", {"right": "hinge"}, None, *opening("found"), **{"plant.payload": "free"}
    ),
    "springs over a table": lambda: over_table(None, 1.2e-3),
    "rigid over a table": lambda: over_table([], 1e-4),
    "springs beside a table": under_table,
}
CASES = SPRINGS | PALMS | OTHERS


def replay(
    scenario: cp.Scenario, engine: str = "pinocchio"
) -> tuple[Any, Iterator[tuple[dict[str, Any], Any]]]:
    """The record of a run; samples of the reference plant, and that plant, which changes, at each tick."""
    start = Simulation(scenario, build_controller(scenario)).chain.patches.state
    data = run_on(engine, scenario).data
    return data, replayed(scenario, data, start.roots)


def require_same(data: Any, ticks: Iterator[tuple[dict[str, Any], Any]]) -> None:
    """Require every quantity of the reference plant in the record, at every tick."""
    samples = [sample for sample, _ in ticks]
    assert len(samples) == data.sizes["time"] > 4
    for name in {name for sample in samples for name in sample}:
        size = max(np.size(sample[name]) for sample in samples if name in sample)
        wanted = np.array([np.ravel(sample.get(name, np.full(size, np.nan))) for sample in samples])
        found = data[name].values.reshape(len(samples), -1)[:, :size]
        if name == "interaction_wrench":  # rigid arms in a plane do not determine what is across it
            wanted[:, np.tile(~data["wrench_is_determined"].values, size // 6)] = np.nan
        if name == "payload_quaternion":
            found = found * np.sign((found * wanted).sum(axis=1, keepdims=True))
        scale = np.nanmax(np.abs(wanted), initial=1e-3)
        assert_allclose(found, wanted, rtol=0, atol=AS_ROUNDING * scale, err_msg=name)


@pytest.mark.parametrize("case", CASES)
def test_a_run_is_that_of_the_reference_plant(case):
    data, ticks = replay(CASES[case]())
    require_same(data, ticks)
    assert np.abs(data["payload_twist"].values).max() > 0.02
    if case in SPRINGS:
        assert np.nanmax(np.abs(data["grasp_deflection"].values[..., 3:])) > 1e-3
    if case in PALMS or case.endswith("over a table"):
        assert data["patch_wrench"].values[..., 2].max() > 1.0
        assert data["patch_slip"].values[-1].max() > 1e-6
    if "work_grasps" in data:
        assert data["work_grasps"].values[-1] < -1e-5


@pytest.mark.parametrize(
    "case", ["planar springs", "spatial, a spring right, reopened", "planar, three rigid"]
)
def test_a_compiled_run_is_that_of_the_reference_plant(case):
    require_same(*replay(CASES[case](), "compiled"))


def at_start(scenario: cp.Scenario) -> Any:
    """The motion of the reference plant at the start, under the torques that hold it."""
    _, ticks = replay(scenario.replace(events=(), duration=2.0 * scenario.clock.period))
    _, plant = next(ticks)
    return plant.motion(0.0, plant.state)


@pytest.mark.parametrize("case", ["planar springs", "spatial springs", "continuous springs", "three springs"])
def test_springs_bear_the_load_shares_at_rest_at_the_start(case):
    scenario = CASES[case]()
    motion, cell = at_start(scenario), scenario.cell
    weight = np.concatenate((cell.payload.mass * np.array(cell.gravity), np.zeros(3)))
    planar = case.startswith("planar")  # its arms cannot follow the tilt: the joints feel it
    assert_allclose(motion.a, 0.0, atol=2e-2 if planar else 1e-8)
    assert_allclose(sum(motion.held), weight, rtol=0, atol=1e-8)
    if not planar:
        assert_allclose(motion.held, np.outer(cell.shares, weight), rtol=0, atol=1e-8)


@pytest.mark.parametrize("case", ["planar palms", "spatial palms", "rectangular palms", "palms and table"])
def test_palms_press_at_rest_at_the_start(case):
    """They bear the load by forces at their middles, beside the squeeze; a table bears it alone."""
    scenario = CASES[case]()
    motion, cell = at_start(scenario), scenario.cell
    X_WP, names = motion.payload.X, list(cell.arms)
    weight = cell.payload.mass * np.array(cell.gravity)
    assert_allclose(motion.a, 0.0, atol=1e-7)
    by_load = np.array(motion.held)
    for one, squeeze in zip(by_load, scenario.squeeze_wrenches, strict=True):
        one -= np.concatenate((X_WP.rotation @ squeeze[:3], X_WP.rotation @ squeeze[3:]))
    if cell.tables:
        assert_allclose(by_load, 0.0, atol=1e-8)
        assert_allclose(motion.contacts[-1].force, -weight, rtol=0, atol=1e-8)
        return
    assert_allclose(by_load.sum(axis=0), (*weight, 0.0, 0.0, 0.0), rtol=0, atol=1e-8)
    if (
        case == "spatial palms"
    ):  # in a plane arms cannot lean; beside P the load turns the palms about their line
        levers = np.array([cell.grasps[name].xyz for name in names]) @ X_WP.rotation.T
        assert_allclose(by_load[:, 3:], np.cross(levers, by_load[:, :3]), rtol=0, atol=1e-8)
