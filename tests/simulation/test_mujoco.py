"""Engine "mujoco": beside Pinocchio's numbers, a regularised KKT, and the model that is written."""

from __future__ import annotations

import sys

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from cells import planar_scenario, spatial_scenario
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import FieldError, MissingExtraError
from coop_pin.cli import main
from coop_pin.compiled.engine_choice import choose_engine, choose_engines
from coop_pin.description.cell.arm import JointFriction
from coop_pin.description.plant import MujocoOptions, PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.model.mujoco_model import MujocoModel, mjcf
from coop_pin.simulation.mujoco_plant import MujocoPlant, unlike_plant

CASES = {
    "planar": (planar_scenario, 0.5),
    "spatial": (spatial_scenario, 0.1),
    "continuous": (lambda: cp.Scenario.load("kinova-pair"), 0.06),
    "three": (lambda: cp.Scenario.load("three-driven-ur5"), 0.06),
}
STATES = 100


def eventful(name: str) -> cp.Scenario:
    """A short run whose payload's mass halves between two ticks and that is pushed within one."""
    scenario, duration = CASES[name][0](), CASES[name][1]
    push = (3.0, -2.0, 0.0, 0.0, 0.0, 0.2)
    pulse = {"kind": "wrench-pulse", "time": 0.4711 * duration, "duration": 0.2 * duration, "wrench": push}
    drop = {"kind": "payload-change", "time": 0.31 * duration, "mass": 0.5 * scenario.cell.payload.mass}
    return scenario.override({"duration": duration, "events": [drop, pulse]})


def without_friction(scenario: cp.Scenario) -> cp.Scenario:
    """The scenario with arms that turn freely."""
    arms = {name: arm.replace(friction=JointFriction()) for name, arm in scenario.cell.arms.items()}
    return scenario.replace(cell=scenario.cell.replace(arms=arms))


def differences(ours: cp.RunResult, others: cp.RunResult) -> dict[str, float]:
    """Largest differences of payload and internal wrench; of forces as parts of the largest one."""
    a, b = ours.data, others.data
    wrenches = a["internal_wrench"].values, b["internal_wrench"].values
    assert (np.isnan(wrenches[0]) == np.isnan(wrenches[1])).all()
    apart = np.abs(wrenches[0] - wrenches[1])
    turns = a["payload_quaternion"].values, b["payload_quaternion"].values
    turn = np.minimum(*(np.linalg.norm(turns[0] - sign * turns[1], axis=1) for sign in (1.0, -1.0)))
    gap = np.linalg.norm(a["payload_position"].values - b["payload_position"].values, axis=1)
    return {
        "position": gap.max(),
        "orientation": 2.0 * turn.max(),
        "force": np.nanmax(apart[..., :3]) / np.nanmax(np.abs(wrenches[0][..., :3])),
        "moment": np.nanmax(apart[..., 3:]),
        "end": np.nanmax(apart[-1, :, :3]) / np.nanmax(np.abs(wrenches[0][..., :3])),
    }


@pytest.mark.parametrize("name", CASES)
def test_a_run_with_events_has_the_samples_of_pinocchio(name):
    scenario = eventful(name)
    ours, theirs = (cp.run(scenario, engine=engine, warn=False) for engine in ("pinocchio", "mujoco"))
    apart = differences(ours, theirs)
    assert apart["position"] < 1e-7
    assert apart["orientation"] < 5e-7
    assert apart["force"] < 1e-3
    assert apart["moment"] < 1e-3
    assert theirs.engine == "mujoco"
    assert theirs.simulation_sound
    assert ours.energy_balance_max() < theirs.energy_balance_max() < 2e-6  # what the welds store and lose
    works = ("work_friction", "work_external", "work_payload_change")
    for work in works if name in ("planar", "spatial") else works[1:]:
        assert_allclose(theirs.data[work][-1], ours.data[work][-1], rtol=1e-5, atol=1e-7)
        assert ours.data[work][-1] != 0.0
    assert "soft welds of MuJoCo: wrenches within" in theirs.summary()
    assert "MuJoCo" not in ours.summary()


@pytest.mark.parametrize("name", ["planar", "spatial", "continuous"])
def test_without_closures_accelerations_are_those_of_the_articulated_body_algorithm(name):
    scenario, rng = CASES[name][0](), np.random.default_rng(0)
    chain, options = CellChain(scenario.cell), MujocoOptions()
    tree = chain.model.model
    model, data = MujocoModel(tree, mjcf(tree, [], options, step=1e-3), options), tree.createData()
    q_start = chain.configuration(scenario.start.matrix)
    for _ in range(STATES):
        q = pin.integrate(tree, q_start, rng.normal(size=tree.nv))
        v, tau = rng.normal(size=tree.nv), 20.0 * rng.normal(size=tree.nv)
        expected = pin.aba(tree, data, q, v, tau)
        assert_allclose(model.acceleration(q, v, tau), expected, rtol=0.0, atol=1e-9 * abs(expected).max())


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_with_welds_accelerations_and_wrenches_are_those_of_a_regularised_kkt(name):
    """M a - J^T f = tau - h and J a + R f = -b J v - k e, with M, h and J of Pinocchio and R of MuJoCo.

    A weld of time constant T and impedance d has b = 2 / (d T) and k = 1 / (d T^2).
    """
    scenario, rng, step = CASES[name][0](), np.random.default_rng(1), 1e-3
    chain, options = CellChain(scenario.cell), MujocoOptions()
    tree, frames = chain.model.model, [("right/grasp", "payload/right")]
    model, data = MujocoModel(tree, mjcf(tree, frames, options, step=step), options), tree.createData()
    T, d, scale = options.time_constant * step, options.impedance, options.torque_scale
    tip, grasp = (tree.getFrameId(frame) for frame in frames[0])
    q_start, softness = chain.configuration(scenario.start.matrix), 0.0
    for _ in range(STATES):
        q = chain.mechanism.project_configuration(q_start + 0.03 * rng.normal(size=tree.nv))
        v = chain.mechanism.project_velocity(q, rng.normal(size=tree.nv)) + 1e-3 * rng.normal(size=tree.nv)
        tau = 20.0 * rng.normal(size=tree.nv)
        a, (on_tip,) = model.forces(q, v, tau)
        M, h = pin.crba(tree, data, q), pin.nonLinearEffects(tree, data, q, v)
        M = np.triu(M) + np.triu(M, 1).T
        pin.computeJointJacobians(tree, data, q)
        pin.updateFramePlacements(tree, data)
        axes = [pin.getFrameJacobian(tree, data, frame, pin.LOCAL_WORLD_ALIGNED) for frame in (tip, grasp)]
        X_WE, X_WG = data.oMf[tip], data.oMf[grasp]
        turned = 0.5 * scale * X_WE.rotation.T
        J = axes[0] - axes[1]
        J[3:] = turned @ J[3:]
        e = np.concatenate((X_WE.translation - X_WG.translation, np.zeros(3)))
        R = np.diag(model.data.efc_R)
        right = np.concatenate((tau - h, -2.0 / (d * T) * (J @ v) - e / (d * T**2)))
        solution = np.linalg.solve(np.block([[M, -J.T], [J, R]]), right)
        assert_allclose(a, solution[: tree.nv], rtol=0.0, atol=1e-9 * abs(solution[: tree.nv]).max())
        f = solution[tree.nv :]
        F = np.concatenate((f[:3], turned.T @ f[3:]))
        (rows,) = np.nonzero(np.abs(axes[0] - axes[1]).max(axis=1) > 1e-9)  # the others cause no torques
        found = np.concatenate((X_WE.rotation @ on_tip.linear, X_WE.rotation @ on_tip.angular))
        assert_allclose(found[rows], F[rows], rtol=0.0, atol=1e-6 * abs(F).max())
        rigid = np.linalg.pinv(J @ np.linalg.solve(M, J.T), rcond=1e-10, hermitian=True) @ (
            right[tree.nv :] - J @ np.linalg.solve(M, tau - h)
        )
        softness = max(softness, abs(rigid[:3] - f[:3]).max() / abs(rigid[:3]).max())
    assert 1e-6 < softness < 4e-3


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_the_difference_to_rigid_grasps_falls_with_the_square_of_the_step(name):
    scenario = CASES[name][0]().replace(events=(), duration=CASES[name][1])
    apart = []
    for steps in (2, 4, 8):
        changed = scenario.override({"clock.steps_per_tick": steps})
        runs = [cp.run(changed, engine=engine, warn=False) for engine in ("pinocchio", "mujoco")]
        apart.append((differences(*runs)["position"], runs[1].closure_error_max()[0]))
    orders = np.log2(np.array(apart)[:-1] / np.array(apart)[1:])
    print(name, apart, orders)
    assert (orders[:, 1] > 1.8).all()


@pytest.mark.parametrize("name", ["planar", "spatial", "three"])
def test_the_model_that_is_written_reads_back_to_the_same_numbers_and_moves_alike(name, tmp_path):
    scenario = without_friction(CASES[name][0]().replace(events=(), duration=1.0))
    scenario.save(tmp_path / "cell.toml")
    assert (
        main(["export", str(tmp_path / "cell.toml"), "--to", "mjcf", "--out", str(tmp_path / "cell.xml")])
        == 0
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    data, M = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    chain = CellChain(scenario.cell)
    tree, q = chain.model.model, chain.configuration(scenario.start.matrix)
    expected = pin.crba(tree, tree.createData(), q)
    assert_allclose(np.triu(M), np.triu(expected), rtol=0.0, atol=1e-12 * abs(expected).max())
    X_WP = scenario.start.matrix
    assert_allclose(data.site("payload").xpos, X_WP[:3, 3], rtol=0.0, atol=1e-9)
    assert_allclose(data.site("payload").xmat.reshape(3, 3), X_WP[:3, :3], rtol=0.0, atol=1e-9)
    plant = MujocoPlant(chain, PlantOptions(), q)
    torques, step = 0.1 * np.arange(model.nv), model.opt.timestep
    plant.restore(plant.state()._replace(force=torques))
    for number in range(5):
        data.qfrc_applied[:] = torques
        mujoco.mj_step(model, data)
        plant.advance(step * number, step)
    assert_allclose(data.qvel, plant.v, rtol=0.0, atol=1e-11 * abs(plant.v).max())


REFUSED = {
    "adept-compliant": {},
    "two-pandas-palms": {},
    "three-ur5-handover": {},
    "pick-carry-place": {},
    "adept-paper": {"plant.payload": "free"},
    "two-pandas-box": {"events": [{"kind": "lose-arm", "time": 1.0, "arm": "left"}]},
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_mujoco_lacks_is_refused_before_the_run(name, tmp_path, monkeypatch, capsys):
    scenario = cp.Scenario.load(name, REFUSED[name])
    assert unlike_plant(scenario.cell, scenario.plant, scenario.events)
    with pytest.raises(FieldError, match="does not have"):
        cp.run(scenario, engine="mujoco", warn=False)
    with pytest.raises(FieldError, match="does not have"):
        choose_engines([scenario], "mujoco", [1])
    monkeypatch.chdir(tmp_path)
    scenario.save("cell.toml")
    assert main(["run", "cell.toml", "--engine", "mujoco"]) == 2
    assert "does not have" in capsys.readouterr().err


def test_without_mujoco_the_engine_names_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match="mujoco"):
        cp.run("adept-paper", engine="mujoco", warn=False)


def test_auto_does_not_choose_it():
    for name in cp.scenario_names():
        assert choose_engine(cp.Scenario.load(name), "auto").engine != "mujoco"


def test_a_grasp_neither_opens_nor_closes():
    scenario = planar_scenario()
    chain = CellChain(scenario.cell)
    plant = MujocoPlant(chain, PlantOptions(), chain.configuration(scenario.start.matrix))
    for change in (plant.release, plant.grasp, plant.brake):
        with pytest.raises(FieldError, match="neither open nor close"):
            change(1)


RIGID = (
    *("adept-anchored", "adept-paper", "baxter-box", "five-joint-pair", "four-ur5-plate", "human-partner"),
    *("kinova-pair", "panda-ur5-bar", "three-driven-ur5", "three-ur5-far", "three-ur5-plate"),
    *("two-pandas-box", "two-ur5-admittance"),
)


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGID)
def test_every_rigid_scenario_of_the_catalogue_moves_as_on_pinocchio(name):
    ours, theirs = (cp.run(name, engine=engine, warn=False) for engine in ("pinocchio", "mujoco"))
    apart = differences(ours, theirs)
    assert apart["position"] < 1e-6
    assert apart["orientation"] < 2e-6
    assert apart["force"] < 5e-3
    assert apart["end"] < 2e-4
    assert theirs.simulation_sound
    assert theirs.task.state == ours.task.state
