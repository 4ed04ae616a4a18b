"""Rotor inertia: the mass matrix of every engine is that of the links plus a diagonal; proposals feel it."""

from __future__ import annotations

import ctypes
import dataclasses
import shutil
import subprocess

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from cells import ANCHORED, SCENARIOS, kkt_of
from lifts import spatial_cell
from numpy.testing import assert_allclose, assert_array_equal
from reference_plant import replayed

import coop_pin as cp
from coop_pin.base.errors import CoopPinError, FieldError
from coop_pin.base.spatial import spatial_inertia
from coop_pin.cli import main
from coop_pin.compiled import BatchSimulator
from coop_pin.compiled.plant.arm_dynamics import mass_matrix, newton_euler
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.design.tuning_rule import gain_proposal
from coop_pin.feasibility import cell_summary, reachability
from coop_pin.grasps import CellChain
from coop_pin.model import CellArm
from coop_pin.model.pinocchio_model import load_arm_model, without_inertia
from coop_pin.model.transmission import friction
from coop_pin.model_based.arm_dynamics import ArmDynamics
from coop_pin.simulation.mujoco_plant import cell_mjcf
from coop_pin.tracing.c_emitter import CEmitter
from coop_pin.tracing.tape import Tape, operands
from coop_pin.tracing.traced_array import inputs

STATED = {
    "planar": {"left": (0.3, 0.2, 0.05), "right": {"inertia": (1e-4, 2e-5, 1e-5), "gear_ratio": 50.0}},
    "spatial": {
        "left": (2.0, 2.0, 2.0, 0.1, 0.2, 0.3),
        "right": {"inertia": 1e-4, "gear_ratio": (-100.0, 100.0, 80.0, 50.0, 50.0, 40.0)},
    },
}
DIAGONAL = {
    "planar": np.array((0.3, 0.2, 0.05, 0.25, 0.05, 0.025)),
    "spatial": np.array((2.0, 2.0, 2.0, 0.1, 0.2, 0.3, 1.0, 1.0, 0.64, 0.25, 0.25, 0.16)),
}
CC = shutil.which("gcc") or shutil.which("cc")


def geared(name: str, stated: dict | None = None) -> cp.Scenario:
    """A test cell whose drives each move one joint, with rotors."""
    scenario, stated = SCENARIOS[name](), STATED[name] if stated is None else stated
    arms = {
        arm: description.replace(drive=None, armature=stated[arm])
        for arm, description in scenario.cell.arms.items()
    }
    return scenario.replace(cell=scenario.cell.replace(arms=arms), events=())


def links(scenario: cp.Scenario, q: np.ndarray) -> np.ndarray:
    """M of all arms by the URDF files alone, each arm a model of its own."""
    M, first = np.zeros((len(q), len(q))), 0
    for arm in scenario.cell.arms.values():
        model = load_arm_model(arm.replace(armature=0.0))
        n = slice(first, first := first + model.nv)
        upper = pin.crba(model, model.createData(), q[n])
        M[n, n] = np.triu(upper) + np.triu(upper, 1).T
    return M


def states(size: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(3, size))


def close(a: np.ndarray, b: np.ndarray) -> None:
    assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max())


# ------------------------------------------------------------ Pinocchio


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_tree_of_two_arms_has_the_links_inertia_and_the_diagonal(name):
    """crba, aba, rnea and the kinetic energy, of arms that hold nothing and with a free payload."""
    scenario, diagonal = geared(name), DIAGONAL[name]
    chain = CellChain(scenario.cell, cp.plant.PlantOptions(payload="free"))
    model, n = chain.model.model, len(diagonal)
    q, (v, a) = pin.randomConfiguration(model), states(model.nv)[:2]
    q[:n], q[n:] = states(n, 1)[0], pin.neutral(model)[n:]
    data, wanted = model.createData(), links(scenario, q[:n]) + np.diag(diagonal)
    M = np.triu(pin.crba(model, data, q)) + np.triu(data.M, 1).T
    close(M[:n, :n], wanted)
    assert_array_equal(model.armature[n:], 0.0)
    h = pin.rnea(model, data, q, v, np.zeros(model.nv)).copy()
    close(pin.rnea(model, data, q, v, a), M @ a + h)
    close(pin.aba(model, data, q, v, M @ a + h), a)
    close(pin.computeKineticEnergy(model, data, q, v), 0.5 * v @ M @ v)
    assert not without_inertia(model).armature.any()


@pytest.mark.parametrize("name", SCENARIOS)
def test_constrained_accelerations_are_those_of_a_dense_kkt(name):
    scenario, diagonal = geared(name), DIAGONAL[name]
    chain = CellChain(scenario.cell)
    bare = CellChain(geared(name, dict.fromkeys(("left", "right"), 0.0)).cell)
    q = chain.configuration(scenario.start.matrix)
    v = chain.mechanism.project_velocity(q, states(len(q))[0])
    tau, model = states(len(q))[1], bare.model.model
    upper = pin.crba(model, model.createData(), q)
    M = np.triu(upper) + np.triu(upper, 1).T + np.diag(diagonal)
    h = pin.rnea(model, model.createData(), q, v, np.zeros(len(q)))
    closure = bare.mechanism.closures.state(q, v)
    J = closure.jacobian
    still = bare.mechanism.forward_dynamics(q, v, tau).acceleration
    drift = -J @ still  # of the same motion without rotors: the closures ask for the same
    inverse = np.linalg.inv(M)
    lam = np.linalg.pinv(J @ inverse @ J.T, rcond=1e-10) @ (-drift - J @ inverse @ (tau - h))
    wanted = inverse @ (tau - h + J.T @ lam)
    assert np.abs(wanted - still).max() > 0.1
    for mechanism in (chain.mechanism, kkt_of(chain.mechanism)):
        found = mechanism.forward_dynamics(q, v, tau).acceleration
        assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_run_is_that_of_the_reference_plant_and_sound(name):
    """The tests' own plant adds the diagonal to each arm by itself; energy and closures are kept."""
    scenario = geared(name).override({"duration": 0.06})
    result = cp.run(scenario, engine="pinocchio", warn=False)
    assert result.metrics()["simulation_sound"] == 1.0
    data = result.data
    for tick, (found, _) in enumerate(replayed(scenario, data)):
        assert_allclose(found["payload_position"], data["payload_position"].values[tick], atol=1e-10)
        kinetic = float(data["kinetic_energy"].values[tick])
        assert_allclose(found["kinetic_energy"], kinetic, atol=1e-9)


def test_kinetic_energy_has_rotors_on_joints_whose_axis_is_none_of_their_frame(tmp_path):
    """It is v^T M v / 2 with the M of crba; pin.computeKineticEnergy leaves out a part of it."""
    cell = spatial_cell(tmp_path)
    file = tmp_path / "spatial.urdf"
    file.write_text(file.read_text().replace('axis xyz="0 1 0"', 'axis xyz="0.48 0.6 0.64"'))
    cell = cell.replace(arms={name: arm.replace(armature=2.0) for name, arm in cell.arms.items()})
    chain = CellChain(cell)
    model = chain.model.model
    assert "JointModelRevoluteUnaligned" in {joint.shortname() for joint in model.joints}
    q, v = states(model.nv)[:2]
    data = model.createData()
    M = np.triu(pin.crba(model, data, q)) + np.triu(data.M, 1).T
    close(chain.energy(q, v), 0.5 * v @ M @ v + pin.computePotentialEnergy(model, data, q))
    close(chain.mechanism.energy(q, v).kinetic, 0.5 * v @ M @ v)
    seen = chain.observe(q[None], v[None], 0.0 * v[None], np.zeros((1, 6)))
    close(seen.kinetic_energy[0], 0.5 * v @ M @ v)
    assert abs(pin.computeKineticEnergy(model, data, q, v) - 0.5 * v @ M @ v) > 1e-3


# ------------------------------------------------------------ the other engines


@pytest.mark.parametrize("name", SCENARIOS)
def test_mujoco_has_the_same_mass_matrix(name):
    scenario = geared(name)
    chain = CellChain(scenario.cell)
    q = chain.configuration(scenario.start.matrix)
    model = mujoco.MjModel.from_xml_string(cell_mjcf(chain, scenario.plant, 1e-3, q))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    _full(model, data, M)
    tree = chain.model.model
    upper = pin.crba(tree, tree.createData(), q)
    assert_allclose(tree.armature, DIAGONAL[name], rtol=1e-12)
    assert_allclose(M, np.triu(upper) + np.triu(upper, 1).T, atol=1e-12)


def _full(model: mujoco.MjModel, data: mujoco.MjData, M: np.ndarray) -> None:
    for column, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, M[column], unit)


@pytest.mark.skipif(CC is None, reason="there is no C compiler")
@pytest.mark.parametrize("name", SCENARIOS)
def test_traced_code_and_its_c_have_the_diagonal(name, tmp_path):
    """Mass matrix and Newton-Euler of both arms, as compiled plants, batches and exported C have them."""
    scenario, diagonal = geared(name), DIAGONAL[name]
    numbers = CellNumbers.from_chain(CellChain(scenario.cell, cp.plant.PlantOptions(payload="free")))
    n, tape = len(diagonal), Tape()
    q, a = inputs(tape, n), inputs(tape, n)
    parts = zip(numbers.arms, numbers.by_arm(q), numbers.by_arm(a), strict=True)
    outputs: list = []
    for arm, x, xdd in parts:
        M, _ = mass_matrix(arm, x)
        tau, *_ = newton_euler(arm, np.zeros(3), x, np.zeros(len(x)), xdd)
        outputs += [*M.ravel(), *tau]
    stores = [(f"y[{k}]", number) for k, number in enumerate(operands(tape, outputs))]
    emitter = CEmitter()
    emitter.define("void f(const double *x, double *y)", tape, stores, "x[{}]".format)
    (tmp_path / "f.c").write_text("void f(const double *x, double *y);\n" + emitter.text())
    command = [CC, "-std=c99", "-O2", "-shared", "-fPIC", "f.c", "-o", "f.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "f.so"))
    x = states(n)[:2].copy()
    y = np.empty(len(outputs))
    library.f(x.ctypes.data_as(ctypes.c_void_p), y.ctypes.data_as(ctypes.c_void_p))
    wanted, first = links(scenario, x[0]) + np.diag(diagonal), 0
    for part in numbers.by_arm(np.arange(n)):
        k, rows = len(part), slice(int(part[0]), int(part[-1]) + 1)
        close(y[first : first + k * k].reshape(k, k), wanted[rows, rows])
        close(y[first + k * k : first + k * k + k], wanted[rows, rows] @ x[1, rows])
        first += k * k + k


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_batch_and_compiled_plant_run_as_pinocchio(name):
    scenario = geared(name).override({"duration": 0.1})
    heavier = scenario.override({"cell.arms.left.armature": 0.5})
    wanted = [cp.run(one, engine="pinocchio", warn=False).data for one in (scenario, heavier)]
    batch = BatchSimulator().run([scenario, heavier]).samples
    single = cp.run(scenario, engine="compiled", warn=False).data
    for key in ("payload_pose", "kinetic_energy", "work_actuation"):
        mine = [batch[key][lane] for lane in range(2)]
        theirs = [w[key].values for w in wanted] if key != "payload_pose" else None
        if theirs is None:
            mine = [values[..., :3, 3] for values in mine]
            theirs = [w["payload_position"].values for w in wanted]
        for a, b in zip(mine, theirs, strict=True):
            assert_allclose(a, b, rtol=0, atol=1e-9)
    assert_allclose(
        single["payload_position"].values, wanted[0]["payload_position"].values, rtol=0, atol=1e-10
    )
    apart = np.abs(wanted[0]["work_actuation"].values - wanted[1]["work_actuation"].values)
    assert apart.max() > 1e-8


# ------------------------------------------------------------ laws, proposals, words


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_regressor_has_the_rotors(name):
    """Y theta = M a + h of the arm's own model, with rotors as its last parameters."""
    scenario = geared(name)
    dynamics = ArmDynamics(scenario, "left")
    theta, _ = dynamics.parameters()
    n = dynamics.model.nv
    assert_array_equal(theta[-n:], dynamics.model.armature)
    q, v, a = states(n)
    measurement = dataclasses.make_dataclass("Reading", ("q", "v"))(q, v)
    Y = dynamics.regressor(measurement, v, a)
    rubbing = friction(scenario.cell.arms["left"])
    smooth = rubbing.viscous * v + rubbing.coulomb * np.tanh(v / rubbing.coulomb_velocity)
    wanted = pin.rnea(dynamics.model, dynamics.model.createData(), q, v, a) + smooth
    close(Y @ theta, wanted)
    less = ArmDynamics(scenario, "left", {"inertia": 0.5})
    assert_array_equal(less.model.armature, 0.5 * dynamics.model.armature)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_gain_proposal_changes_as_the_inertia_that_the_payload_feels(name):
    """A = M_0 + sum (J (M + diag)^-1 J^T)^-1 by hand: K_j is as 1 / (A^-1)_jj, and the wrist's part grows."""
    gains, felt = [], []
    for factor in (0.0, 1.0):
        diagonal = np.split(factor * DIAGONAL[name], 2)
        scenario = geared(name, {"left": tuple(diagonal[0]), "right": tuple(diagonal[1])})
        hold = cp.motions.HoldMotion(pose=scenario.start)
        scenario = scenario.replace(controller=ANCHORED[name], motion=hold)
        reach = reachability(scenario)
        gains.append(gain_proposal(scenario, reach).gains.sliding_gain)
        payload, rows = scenario.cell.payload, scenario.cell.task_rows.indices
        A = spatial_inertia(payload.mass, payload.inertia_matrix, scenario.start.matrix[:3, :3])
        A = A[np.ix_(rows, rows)]
        M = links(scenario, np.concatenate([arm.q[0] for arm in reach.arms]))
        for index, arm in enumerate(scenario.cell.arms):
            model, q = CellArm(scenario.cell, arm), reach.arms[index].q[0]
            n = slice(index * model.nv, (index + 1) * model.nv)
            J = model.rows.select(model.payload_jacobian(q))
            A = A + np.linalg.inv(J @ np.linalg.solve(M[n, n] + np.diag(diagonal[index]), J.T))
        felt.append(1.0 / np.diag(np.linalg.inv(A)))
    for found, wanted in zip(gains, felt, strict=True):
        assert_allclose(np.divide(found, found[0]), wanted / wanted[0], rtol=0.05)
    turning = ~scenario.cell.task_rows.are_linear
    assert (felt[1][turning] > 1.2 * felt[0][turning]).all()


def test_a_mobile_base_has_no_rotors_unless_each_joint_is_stated():
    arm = next(iter(cp.Scenario.load("three-driven-ur5").cell.arms.values()))
    model = load_arm_model(arm.replace(armature=0.2))
    assert_array_equal(model.armature, [0.0, 0.0, 0.0] + 6 * [0.2])
    stated = tuple(np.arange(9.0))
    assert_array_equal(load_arm_model(arm.replace(armature=stated)).armature, stated)


def test_what_is_wrong_is_refused_by_name():
    arm = SCENARIOS["spatial"]().cell.arms["left"]
    for wrong in (-1.0, (1.0, 2.0), {"inertia": 1.0}, "urdf"):
        with pytest.raises(CoopPinError, match=r"armature|entries|inertia"):
            arm.replace(armature=wrong)
    planar = SCENARIOS["planar"]().cell.arms["left"]
    with pytest.raises(FieldError, match="couples joints"):
        planar.replace(armature=0.1)
    assert planar.replace(armature=0.0).armature == 0.0


def test_show_says_whether_rotors_are_stated(capsys):
    assert main(["show", "adept-paper"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "none stated (armature): the wrist may feel lighter than it is" in text
    scenario = geared("spatial")
    summary = cell_summary(scenario.cell, scenario.start.matrix)
    assert_allclose(summary.arms[1].armature, DIAGONAL["spatial"][6:], rtol=1e-12)
    assert "(2, 2, 2, 0.1, 0.2, 0.3) kg m^2" in summary.summary()
