"""Every cell of the catalogue carries its payload along a path, those in space under gravity."""

import os
import subprocess
import sys

import numpy as np
import pytest
from cells import CATALOGUE_CELLS, FAR_CELLS
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.spatial import shift_wrench
from coop_pin.model import ArmModel, CellArm
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

QUIET = {"events": [], "duration": 10.0}
CHANGES = {name: {} if name in CATALOGUE_CELLS else QUIET for name in cp.scenario_names()}
QUICK_PLANTS = ["adept-paper", "adept-anchored", "five-joint-pair", "two-pandas-box", "human-partner"]
"""Cells that run on every plant in the default tier, too: in a plane, in space, on positional rows, held."""
QUICK_CELLS, TIERS = ["adept-anchored"], {"two-pandas-box": pytest.mark.gate}
"""Cells that do their work in the default tier, too, and in the gate; shorter runs are of more cells."""
LARGE_CELLS = ["baxter-box", "four-ur5-plate", "three-driven-ur5"]  # tested in test_robots
SHARED = ["tiago-pro-tray", "three-rolling-ur5"]  # tested in test_shared_joints and test_rolling_bases
for other in [
    "adept-paper",
    "adept-compliant",
    "adept-paper-fit",
    "three-ur5-handover",
    "human-partner",
    "two-pandas-palms",
    "two-ur5-admittance",
    "pick-carry-place",
    "adept-hinges",
    "two-pandas-hinges",
    "two-pandas-door",
    *FAR_CELLS,
    *LARGE_CELLS,
    *SHARED,
]:  # it has the printed law; others have tests below
    del CHANGES[other]


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=[TIERS.get(name, pytest.mark.slow)] * (name not in QUICK_CELLS))
        for name in CHANGES
    ],
)
def result(request):
    return cp.run(request.param, CHANGES[request.param])


def smallest_singular_value(result):
    """Of every arm's payload Jacobian in the task rows, every quarter of a second."""
    cell, rows = result.scenario.cell, result.scenario.cell.task_rows
    every = max(1, round(0.25 / float(result.data.time[1])))
    place, values = 0, []
    for name, arm in cell.arms.items():
        model = ArmModel(arm, cell.grasps[name].matrix)
        angles = result.data.configuration.values[::every, place : place + model.nq]
        place += model.nq
        values += [
            np.linalg.svd(rows.select(model.payload_jacobian(q)), compute_uv=False)[-1] for q in angles
        ]
    return min(values)


@pytest.mark.parametrize(
    ("name", "turns"), [("adept-paper", True), ("two-pandas-box", True), ("five-joint-pair", False)]
)
def test_positional_rows_alone_control_no_turn(name, turns):
    assert cp.Scenario.load(name).cell.controls_turns is turns


def test_cell_does_its_work(result):
    assert result.end == 10.0
    moved = np.ptp(result.data.payload_position.values, axis=0)
    assert np.linalg.norm(moved) > 0.05
    assert result.position_rms() < 2e-3
    assert result.settling_time() < 3.0
    assert not [
        violation for violation in result.limit_violations() if violation.kind in ("position", "velocity")
    ]
    assert smallest_singular_value(result) > 0.05
    assert max(result.closure_error_max()) < 1e-8
    assert result.energy_balance_max() < 1e-5
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()


def error_and_force(result, start, end):
    """Rms of the position error, m, and of the axial, shear and moment errors, N and N m, of a window."""
    force = result.internal_force(window=(start, end))
    return (
        result.position_rms(window=(start, end)),
        force.axial_rms_error,
        force.shear_rms,
        force.moment_rms_error,
    )


LINE_MOTION = (1.0, 6.0)
"""When the cells in space move, s."""


@pytest.mark.parametrize("window", [LINE_MOTION, (7.0, 10.0)], ids=["moving", "last 3 s"])
def test_internal_force_stays_what_is_desired(result, window):
    if result.scenario.name not in CATALOGUE_CELLS:
        window = (4.0, 10.0)
    error, axial, shear, moment = error_and_force(result, *window)
    print(
        f"{result.scenario.name}, {window[0]:g} to {window[1]:g} s: {1e3 * error:.4f} mm,"
        f" {axial:.4f} N axial, {shear:.4f} N shear, {moment:.5f} N m"
    )
    assert error <= 0.1e-3
    assert max(axial, shear) <= 0.05
    assert moment <= 0.02


def test_the_law_takes_over_without_a_jump(result):
    """The first torques are the holding torques; none is cut, and the payload does not move."""
    if result.scenario.name not in CATALOGUE_CELLS:
        pytest.skip("starts off its reference")
    first = result.data.sel(time=slice(0.0, 1.0))
    error = np.linalg.norm(first.pose_error.values[:, :3], axis=1).max()
    print(f"{result.scenario.name}, first second: {1e6 * error:.4f} um")
    assert error <= 1e-6
    assert not result.data.saturated.values.any()
    assert not result.limit_violations()
    simulation = Simulation(result.scenario, build_controller(result.scenario))
    holding = simulation.actuation.holding_commands(simulation.plant.q)
    for torque, held in zip(result.data.torque.values[0], holding, strict=True):
        assert_allclose(torque[: len(held)], held, atol=1e-8)


# ------------------------------------------------------------ far motions


@pytest.mark.parametrize("name", FAR_CELLS)
def test_a_far_motion_can_be_followed_and_held(name):
    """0.5 m and 60 degrees within 5 s: reach, singular poses, limits, static torques and both rules."""
    scenario = cp.Scenario.load(name)
    motion = scenario.motion
    (X_0, *_), (X_1, *_) = motion.at(0.0), motion.at(scenario.duration)
    assert motion.duration <= 5.0
    assert np.linalg.norm(X_1[:3, 3] - X_0[:3, 3]) >= 0.5
    assert Rotation.from_matrix(X_1[:3, :3] @ X_0[:3, :3].T).magnitude() >= np.deg2rad(60.0)
    reach = cp.feasibility.reachability(scenario, poses=9)
    assert reach.ok
    assert min(arm.sigma_min.min() for arm in reach.arms) > 0.1
    assert cp.feasibility.static_torques(scenario, poses=9).ok
    assert cp.stability.sampled_stability(scenario).ok
    cell, gains = scenario.cell, scenario.controller.gains
    k_I, rows = gains.sign_gain / scenario.controller.switching.width, list(cell.task_rows.indices)
    inertia = block_diag(cell.payload.mass * np.eye(3), cell.payload.inertia_matrix)
    models = [CellArm(cell, arm.arm) for arm in reach.arms]
    for at, time in enumerate(reach.arms[0].times.tolist()):
        turn = np.kron(np.eye(2), motion.at(time).X_WP_d[:3, :3])
        A = (turn @ inertia @ turn.T)[np.ix_(rows, rows)]
        for arm, model in zip(reach.arms, models, strict=True):
            J, M = model.payload_jacobian(arm.q[at])[rows], model.mass_matrix(arm.q[at])
            A += np.linalg.inv(J @ np.linalg.solve(M, J.T))
        rates = np.linalg.eigvals(np.linalg.solve(A, np.diag(gains.sliding_gain))).real
        assert scenario.clock.period * rates.max() <= 1.0
        assert k_I <= min(0.25 / scenario.clock.period, rates.min() / 2.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAR_CELLS)
def test_a_far_motion_keeps_tracking_and_internal_force(name):
    """The largest values, not rms. On positional rows no moment is controlled."""
    result = cp.run(name)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert not result.limit_violations()
    R = Rotation.from_quat(result.data.payload_quaternion.values[[0, -1]])
    assert (R[1] * R[0].inv()).magnitude() >= np.deg2rad(60.0)
    assert np.linalg.norm(np.diff(result.data.payload_position.values[[0, -1]], axis=0)) >= 0.5
    time, error = result.data.time.values, result.data.internal_wrench - result.data.desired_internal_wrench
    tracking = np.linalg.norm(result.data.pose_error.values[:, :3], axis=1)
    assert not result.data.saturated.values.any()
    assert tracking[time < 1.0].max() <= 0.5e-3
    for window, force, moment, position in (((1.0, 6.0), 0.3, 0.2, 0.5e-3), ((7.0, 8.0), 0.05, 0.02, 0.1e-3)):
        at = (time >= window[0]) & (time < window[1])
        largest = np.linalg.norm(error.values[at].reshape(at.sum(), -1, 2, 3), axis=3).max(axis=(0, 1))
        print(
            f"{name}, {window[0]:g} to {window[1]:g} s: {1e3 * tracking[at].max():.4f} mm,"
            f" {largest[0]:.4f} N, {largest[1]:.4f} N m"
        )
        assert largest[0] <= force
        assert tracking[at].max() <= position
        if result.scenario.cell.rows == "full":
            assert largest[1] <= moment


# ------------------------------------------------------------ squeeze at the tips

ABOUT_P = {"left": (-10.0, 0.0, 0.0, 0.0, 0.0, 0.0), "right": (10.0, 0.0, 0.0, 0.0, 0.0, 0.0)}
CELLS_AT_REST = {
    "box": {},
    "crate": {  # the arms stand as before, and P hangs 0.2 m below the line between the tips
        "cell.grasps.left.xyz": [-0.2, 0.0, 0.2],
        "cell.grasps.right.xyz": [0.2, 0.0, 0.2],
        "start.xyz": [0.0, 0.0, 0.25],
    },
}


def moments_at_the_wrists(changes, squeeze):
    """About the tips, by the payload, of two Pandas at rest once the squeeze acts, N m, shape (2, 3)."""
    quick = {"duration": 0.4, "clock.steps_per_tick": 1, "controller.gains.transient_rate": 20.0}
    scenario = cp.Scenario.load("two-pandas-box", {**changes, **quick})
    motion = {"kind": "hold", "pose": scenario.start.model_dump()}
    result = cp.run(scenario, {"motion": motion, **squeeze}, warn=False)
    R_WP = Rotation.from_quat(result.data.payload_quaternion.values[-1]).as_matrix()
    tips = np.array([R_WP @ grasp.xyz for grasp in scenario.cell.grasps.values()])
    return shift_wrench(result.data.interaction_wrench.values[-1], -tips)[:, 3:]


@pytest.mark.parametrize("cell", CELLS_AT_REST)
def test_a_squeeze_at_the_tips_loads_no_wrist(cell):
    """About P it adds r_i x f_i at each; the weight's share acts about P too, unless tip moments carry it."""
    scenario = cp.Scenario.load("two-pandas-box", CELLS_AT_REST[cell])
    tips = np.array([grasp.xyz for grasp in scenario.cell.grasps.values()])
    forces = np.array([f[:3] for f in ABOUT_P.values()])
    of_squeeze = -np.cross(tips, forces)
    share = 0.5 * scenario.cell.payload.mass * np.array(scenario.cell.gravity)
    of_weight = -np.cross(tips, share)
    rows = np.hstack((forces, -of_weight))
    weightless = {"kind": "tip-wrench", "wrenches": dict(zip(ABOUT_P, rows.tolist(), strict=True))}
    for squeeze, expected in (
        ({"squeeze": ABOUT_P}, of_weight + of_squeeze),
        ({}, of_weight),
        ({"squeeze": weightless}, np.zeros((2, 3))),
    ):
        found = moments_at_the_wrists(CELLS_AT_REST[cell], squeeze)
        assert_allclose(found, expected, atol=0.02)
    assert np.abs(of_squeeze).max() > 0.4


PLANTS = {
    "free payload": {"plant.payload": "free"},
    "KKT": {"plant.formulation": "kkt"},
    "free payload, KKT": {"plant.payload": "free", "plant.formulation": "kkt"},
}


ALLOWED = {
    "payload_position": 1e-9,
    "joint_position": 1e-9,
    "interaction_wrench": 1e-7,
    "internal_wrench": 1e-7,
    "torque": 1e-7,
}
"""Largest differences of paths, m and rad, and of wrenches and torques, N and N m."""


def beyond_allowed(data, expected):
    """Quantities that differ by more than is allowed, with their largest difference; NaN where both are."""
    found = {}
    for quantity, allowed in ALLOWED.items():
        now, then = data[quantity].values, expected[quantity].values
        assert np.array_equal(np.isnan(now), np.isnan(then))
        difference = float(np.nanmax(np.abs(now - then)))
        if not difference <= allowed:
            found[quantity] = difference
    return found


def beyond_allowed_by_plant(name, duration, plants):
    """Differences beyond the allowed, with the scenario's own law; events after the end are left out."""
    scenario = cp.Scenario.load(name)
    events = tuple(event for event in scenario.events if event.end < duration)
    scenario = scenario.replace(duration=duration, events=events)
    expected = cp.run(scenario, warn=False).data
    found = {plant: cp.run(scenario, PLANTS[plant], warn=False).data for plant in plants}
    return {plant: beyond_allowed(data, expected) for plant, data in found.items()}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK_PLANTS))
        for name in cp.scenario_names()
    ],
)
def test_every_plant_gives_the_same_run(name):
    """A start at rest on the reference is where sgn would turn rounding into torque."""
    assert beyond_allowed_by_plant(name, 0.2, ["free payload", "KKT"]) == {"free payload": {}, "KKT": {}}


@pytest.mark.slow
@pytest.mark.parametrize("name", cp.scenario_names())
def test_every_plant_gives_the_same_run_over_20_s(name):
    assert beyond_allowed_by_plant(name, 20.0, PLANTS) == {plant: {} for plant in PLANTS}


RUN = """
import sys, coop_pin as cp
cp.run(sys.argv[1], {"duration": 0.2}, warn=False).save(sys.argv[2])
"""


@pytest.mark.parametrize(
    "kernel",
    [pytest.param("Nehalem", marks=pytest.mark.slow), pytest.param("Haswell", marks=pytest.mark.gate)],
)
def test_another_openblas_kernel_gives_the_same_run_but_for_rounding(kernel, tmp_path):
    """What another processor does: OpenBLAS sums in another order. Where it knows no such kernel, nothing."""
    file = tmp_path / "result.nc"
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    subprocess.run([sys.executable, "-c", RUN, "two-pandas-box", str(file)], env=environment, check=True)
    here = cp.run("two-pandas-box", {"duration": 0.2}, warn=False).data
    assert beyond_allowed(cp.RunResult.load(file).data, here) == {}
