"""Compliant grasps: element, plant, runs, and what is refused; planar, and in space with turned grasps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from cells import ANCHORED, SCENARIOS
from compliant_cells import UNEVEN, anchored, mass_matrix, moved, with_grasps
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError, UnknownFieldError
from coop_pin.base.spatial import weight_wrench
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.grasps.spring_damper import SpringDamper
from coop_pin.proof import theorem_monitor
from coop_pin.results.energies import energy_balance
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import grasp_stability, loop_stability, step_stability

# ------------------------------------------------------------ the element


def test_spring_is_the_gradient_of_its_energy_and_stiff_as_stated():
    rng, h = np.random.default_rng(1), 1e-6
    spring = SpringDamper.of(rng.uniform(1.0, 9.0, (3, 6)), rng.uniform(0.1, 1.0, (3, 6)))
    p, turns = rng.normal(size=(3, 3)), [pin.exp3(0.8 * rng.normal(size=3)) for _ in range(3)]
    R = np.array(turns)
    F = spring.elastic(p, R)
    for axis in range(3):
        step = h * np.eye(3)[axis]
        ahead, behind = (spring.energy(p + sign * step, R) for sign in (1, -1))
        assert_allclose((ahead - behind) / (2 * h), -F[:, axis], atol=1e-8)
        ahead, behind = (spring.energy(p, pin.exp3(sign * step) @ R) for sign in (1, -1))
        assert_allclose((ahead - behind) / (2 * h), -F[:, 3 + axis], atol=1e-8)
        small = spring.elastic(np.tile(step, (3, 1)), np.tile(pin.exp3(step), (3, 1, 1)))
        assert_allclose(small[:, [axis, 3 + axis]], -h * spring.stiffness[:, [axis, 3 + axis]], rtol=1e-9)
    V = rng.normal(size=(3, 6))
    assert (-spring.damping * V * V).sum() < 0.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_generalised_force_is_the_gradient_of_the_energy_and_the_damper_takes_power(name):
    scenario = with_grasps(SCENARIOS[name]())
    chain = CellChain(scenario.cell)
    q, v = moved(chain, scenario.start.matrix, 2)
    springs, model, h = chain.springs, chain.mechanism.model, 1e-6
    rest = np.zeros(model.nv)
    slopes = [
        (springs.energy(springs.at(pin.integrate(model, q, h * row), rest)) - energy) / h
        for row in np.eye(model.nv)
        for energy in [springs.energy(springs.at(pin.integrate(model, q, -h * row), rest))]
    ]
    power, still = chain.elements.act(q, rest), chain.elements.force(q)
    assert_allclose(still, -np.array(slopes) / 2.0, rtol=0, atol=1e-6 * np.abs(still).max())
    assert power == 0.0
    springs.damp(q)
    power, force = chain.elements.act(q, v), chain.elements.force(q)
    damped = springs.present()
    assert_allclose(power, (force - still) @ v, rtol=1e-10)
    assert power < 0.0
    B = springs.jacobians(q)
    assert_allclose(force, np.einsum("nij,ni->j", B, damped.wrench), rtol=0, atol=1e-9)
    mobility = B @ np.linalg.solve(mass_matrix(chain, q), B.transpose(0, 2, 1))
    ratio = springs.springs.damping / 2.0 / np.sqrt(UNEVEN / np.einsum("nii->ni", mobility))
    assert_allclose(ratio, 0.3, rtol=1e-12)


# ------------------------------------------------------------ the plant


@pytest.mark.parametrize("stiffness", ["paper", "firm", "soft", UNEVEN])
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_run_starts_deflected_and_at_rest(name, stiffness):
    scenario = with_grasps(anchored(name), stiffness)
    simulation = Simulation(scenario, build_controller(scenario))
    plant, cell = simulation.plant, scenario.cell
    assert plant.chain.model.closed_by_tree == ()
    plant.drive(simulation.actuation.holding_commands(plant.q))
    state, h = plant.state(), 1e-6
    plant.advance(0.0, h)
    a = (plant.v - state.v) / h
    plant.restore(state)
    allowed = 1e-8 if name == "spatial" else 2e-2  # planar arms cannot follow the tilt: the joints feel it
    assert np.abs(a).max() < allowed
    wrenches = plant.interaction_wrenches()
    load = weight_wrench(cell.payload.mass, cell.gravity)
    assert_allclose(wrenches.sum(axis=0), load, rtol=0, atol=1e-8)
    if name == "spatial":
        assert_allclose(wrenches, cell.shares[:, None] * load, rtol=0, atol=1e-8)
        assert_allclose(plant.chain.payload_pose(plant.q), scenario.start.matrix, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_payload_moves_by_the_wrenches_that_are_recorded(name):
    """M_0 a + b = sum of the wrenches by Newton and Euler of the payload alone."""
    scenario = with_grasps(SCENARIOS[name]())
    chain, push = CellChain(scenario.cell), np.array((3.0, -2.0, 1.0, 0.1, 0.2, -0.3))
    q, v = moved(chain, scenario.start.matrix, 3)
    tau = np.concatenate((np.random.default_rng(5).normal(size=len(v) - 6), np.zeros(6)))  # of the arms
    J = chain.payload_jacobian(q)
    F = chain.interaction_wrenches(q, v, tau + J.T @ push, push)
    chain.elements.act(q, v)
    a = chain.mechanism.solver.acceleration(q, v, tau + J.T @ push + chain.elements.force(q))
    R, w, h = chain.payload_pose(q)[:3, :3], (J @ v)[3:], 1e-6
    model, payload = chain.mechanism.model, scenario.cell.payload
    ahead, behind = (pin.integrate(model, q, s * h * v) for s in (1, -1))
    drift = (chain.payload_jacobian(ahead) - chain.payload_jacobian(behind)) @ v / (2.0 * h)
    A, inertia = J @ a + drift, R @ payload.inertia_matrix @ R.T
    force = payload.mass * (A[:3] - np.array(scenario.cell.gravity))
    moment = inertia @ A[3:] + np.cross(w, inertia @ w)
    resultant = push - F.sum(axis=0)
    assert_allclose(resultant, np.concatenate((force, moment)), rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("name", SCENARIOS)
def test_energy_is_explained_by_work_with_order_four(name):
    """A residual of 1e-7 of what is exchanged well below the stable step, 16 times less per halving."""
    scenario, push = with_grasps(anchored(name)), (20.0, -10.0, 0.0, 0.0, 0.0, 0.5)
    events = (cp.events.WrenchPulse(time=0.01, duration=0.02, wrench=push),)
    steps = {"planar": 40, "spatial": 4}[name]
    residuals, ends = [], []
    for factor in (1, 2, 4):
        run = scenario.override({"clock.steps_per_tick": factor * steps, "duration": 0.05})
        data = cp.run(run.replace(events=events), warn=False).data
        residuals.append(np.abs(energy_balance(data)).max())
        ends.append(data["payload_position"].values[-1])
    exchanged = sum(np.ptp(data[f"work_{part}"].values) for part in ("actuation", "external", "grasps"))
    assert residuals[0] < 1e-7 * exchanged
    assert 10.0 < residuals[0] / residuals[1] < 24.0
    errors = [np.linalg.norm(end - ends[-1]) for end in ends[:-1]]
    assert errors[0] > 10.0 * errors[1]
    assert np.all(np.diff(data["work_grasps"].values) <= 0.0)
    assert data["elastic_energy"].values.min() > 0.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_stable_step_is_where_free_vibration_starts_to_grow(name):
    scenario = with_grasps(anchored(name), "paper")
    simulation = Simulation(scenario, build_controller(scenario))
    found = step_stability(simulation)
    step = scenario.clock.period / scenario.clock.steps_per_tick * found.limit / found.value
    growth = []
    for factor in (0.97, 1.03):
        plant = PinocchioPlant(CellChain(scenario.cell), PlantOptions(), simulation.plant.q)
        plant.drive(simulation.actuation.holding_commands(plant.q))
        plant.v = 1e-6 * np.random.default_rng(7).normal(size=len(plant.v))
        first = np.linalg.norm(plant.v)
        for _ in range(400):
            plant.advance(0.0, factor * step)
        growth.append(np.linalg.norm(plant.v) / first)
    assert growth[0] < 50.0  # weight and friction move it slowly
    assert growth[1] > 1e3 * growth[0]


def test_stable_step_of_the_paper_s_bar():
    """The limit of Runge-Kutta 4 at 300 kN/m is set by the bar's roll."""
    limits = []
    for ratio in (0.1, 1.0):
        scenario = with_grasps(
            cp.Scenario.load("adept-anchored", {"events": []}), "paper", damping_ratio=ratio
        )
        found = step_stability(Simulation(scenario, build_controller(scenario)))
        limits.append(scenario.clock.period / scenario.clock.steps_per_tick * found.limit / found.value)
    assert_allclose(limits, (1.57e-3, 0.61e-3), rtol=5e-3)


@pytest.mark.parametrize("payload", ["welded", "free"])
@pytest.mark.parametrize("held", ["left", "right"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_rigid_and_compliant_grasps_mix(name, held, payload):
    """One motion whether the payload is welded to the rigid arm or free; energy and balance as everywhere."""
    scenario = with_grasps(anchored(name), arms=[held]).override(
        {"clock.steps_per_tick": 20, "duration": 0.05, "plant.payload": payload}
    )
    data = cp.run(scenario, warn=False).data
    assert float(np.abs(energy_balance(data)).max()) < 1e-7
    arms = list(scenario.cell.arms)
    deflection = data["grasp_deflection"].values
    assert np.isnan(deflection[:, 1 - arms.index(held)]).all()
    assert np.isfinite(deflection[:, arms.index(held)]).all()
    welded = cp.run(scenario.override({"plant.payload": "welded"}), warn=False).data
    for quantity in ("payload_position", "grasp_wrench"):
        assert_allclose(data[quantity].values, welded[quantity].values, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", SCENARIOS)
def test_deflection_at_the_start_goes_as_the_inverse_of_the_stiffness(name):
    scenario = anchored(name)
    sizes = 3.0 * np.logspace(4, 7, 4)
    found = []
    for k in sizes:
        chain = CellChain(with_grasps(scenario, (k, k, k, k / 100, k / 100, k / 100)).cell)
        q = chain.configuration(scenario.start.matrix)
        found.append(np.linalg.norm(chain.springs.at(q, np.zeros(chain.mechanism.model.nv)).deflection))
    slope = np.polyfit(np.log(sizes), np.log(found), 1)[0]
    assert_allclose(slope, -1.0, atol=0.01)


# ------------------------------------------------------------ the law on such grasps


def stability(scenario: cp.Scenario):
    """Stability of the scenario's law on its grasps."""
    return grasp_stability(Simulation(scenario, build_controller(scenario)))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_stiffness_from_which_gains_hold_is_that_of_runs(name):
    """Runs at rest: 8 % below it they leave the start, 8 % above they stay; the same radius says so."""
    scenario = SCENARIOS[name]().replace(controller=ANCHORED[name], events=(), beyond_bound=True)
    steps = {"planar": 24, "spatial": 6}[name]
    pose = {"controller.gains.sign_gain": 0.05, "duration": 0.6, "clock.steps_per_tick": steps}
    motion = cp.motions.HoldMotion(pose=scenario.start)
    scenario = scenario.replace(motion=motion, squeeze=cp.squeezes.ConstantSqueeze()).override(pose)
    found = stability(with_grasps(scenario, "firm", damping_ratio=1.0))
    assert found.alone.value > 2.0
    assert not found.ok
    k, ends = 3e4 * found.holds_from, []
    for factor in (0.92, 1.08):
        run = with_grasps(scenario, (factor * k,) * 3 + (factor * k / 100.0,) * 3, damping_ratio=1.0)
        assert stability(run).ok == (factor > 1.0)
        pushed = run.replace(
            events=[cp.events.WrenchPulse(time=0.0, duration=0.01, wrench=(1, 1, 0, 0, 0, 0.1))]
        )
        speed = np.abs(cp.run(pushed, warn=False).data["joint_velocity"].values)
        third = len(speed) // 3
        ends.append(np.nanmax(speed[-third:]) / np.nanmax(speed[third : 2 * third]))
    assert ends[0] > 1.5
    assert ends[1] < 1.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_gains_of_arms_that_are_stable_alone_hold_at_every_stiffness(name):
    for stiffness in ("paper", "firm", "soft"):
        found = stability(with_grasps(anchored(name), stiffness))
        assert found.alone.value < 2.0
        assert found.ok
        assert found.holds_from == 1.0
    assert found.distance > 1e-3  # the soft one


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_squeeze_of_20_N_at_5_kN_per_m_is_20_N(name):
    scenario = with_grasps(anchored(name), "soft", damping_ratio=1.0)
    axis = scenario.cell.grasps["right"].matrix[:3, 3] - scenario.cell.grasps["left"].matrix[:3, 3]
    force = 20.0 * axis / np.linalg.norm(axis)
    squeeze = {arm: (*(sign * force), 0.0, 0.0, 0.0) for arm, sign in (("left", -1), ("right", 1))}
    motion = cp.motions.HoldMotion(pose=scenario.start)
    changes = {
        "duration": 0.8,
        "controller.gains.transient_rate": 15.0,
        "controller.knows_deflection": True,  # else it is a bias, on which the integral pulls
        "controller.zero_at_grasp": True,  # so is the deflection by the weight
        "clock.steps_per_tick": {"planar": 8, "spatial": 1}[name],
    }
    data = cp.run(scenario.replace(squeeze=squeeze, motion=motion).override(changes), warn=False).data
    rows = [row for row in scenario.cell.task_rows.indices if row < 3]  # forces: the tilt is a bias in moment
    f, f_d = (data[f"{kind}internal_wrench"].values[-1][:, rows] for kind in ("", "desired_"))
    assert_allclose(np.linalg.norm(f_d, axis=1), 20.0, rtol=1e-3)
    assert_allclose(f, f_d, rtol=0, atol=0.2)


@pytest.mark.slow
def test_the_paper_s_experiment_on_the_paper_s_grasps():
    """Through the loss of half the mass and the push; stable at the start, sound, the task kept."""
    assert stability(cp.Scenario.load("adept-compliant")).ok
    result = cp.run("adept-compliant", warn=False)
    force = result.internal_force(window=(4.0, 10.0))
    print(f"\n{1e3 * result.position_rms():.3f} mm, {force.axial_rms_error:.5f} N")
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert result.position_rms() < 0.4e-3
    assert force.axial_rms_error < 0.01


# ------------------------------------------------------------ description


def test_rigid_grasps_are_written_as_before_and_compliant_ones_come_back():
    rigid, compliant = SCENARIOS["spatial"](), with_grasps(SCENARIOS["spatial"]())
    assert {*rigid.model_dump(mode="json")["cell"]["grasps"]["left"]} == {"xyz", "rpy"}
    assert cp.Scenario.from_toml(compliant.to_toml()) == compliant
    assert cp.Scenario.from_toml(compliant.to_toml(commented=True)) == compliant
    assert compliant.cell.rigid == rigid.cell
    assert list(compliant.cell.compliant) == ["left", "right"]
    assert not rigid.cell.compliant


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        ({"stiffness": "wool"}, FieldError),
        ({"stiffness": (1.0, 2.0)}, FieldError),
        ({"stiffness": (-1.0,) * 6}, FieldError),
        ({"stiffness": (0.0,) * 6}, FieldError),
        ({"stiffness": (1.0, 1.0, np.inf, 1.0, 1.0, 1.0)}, FieldError),
        ({}, FieldError),
        ({"stiffness": "soft", "damping": (1.0, 1.0, 1.0, 1.0, 1.0, -1.0)}, FieldError),
        ({"stiffness": "soft", "damping_ratio": 0.0}, FieldError),
        ({"stiffness": "soft", "strength": 1.0}, UnknownFieldError),
        ({"stiffness": "soft", "kind": "velcro"}, FieldError),
    ],
)
def test_bad_grasps_are_refused_by_their_field(fields, error):
    with pytest.raises(error) as caught:
        SCENARIOS["planar"]().override({"cell.grasps.left": {"xyz": (0, 0, 0), "kind": "compliant"} | fields})
    assert caught.value.path.startswith("cell.grasps.left.")


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_grasp_too_soft_for_its_load_is_refused_with_the_moment(name):
    scenario = with_grasps(SCENARIOS[name](), (1e3, 1e3, 1e3, 0.5, 0.5, 0.5))
    with pytest.raises(FieldError, match="N m") as caught:
        CellChain(scenario.cell).configuration(scenario.start.matrix)
    assert caught.value.path == "cell.grasps.left.stiffness"


@pytest.mark.parametrize("name", SCENARIOS)
def test_what_is_for_rigid_grasps_is_refused(name):
    scenario = with_grasps(anchored(name), arms=["right"])
    with pytest.raises(ArgumentError, match="compliant"):
        loop_stability(Simulation(scenario, build_controller(scenario)))
    with pytest.raises(FieldError, match="rk4") as caught:
        scenario.override({"plant.integrator": "semi-implicit-euler"})
    assert caught.value.path == "plant.integrator"
    result = cp.run(scenario.override({"duration": 0.02, "clock.steps_per_tick": 20}), warn=False)
    with pytest.raises(ArgumentError, match="compliant"):
        theorem_monitor(result)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_payload_at_rest_tends_to_that_of_rigid_grasps_as_the_inverse_of_the_stiffness(name):
    """After 10 / min(k_I, gamma), with equal gains: slope -1 from 3e4, of the force from 3e5 N/m on.

    After half of that, what has not decayed yet looks like a floor of the force, 7e-5 N in the plane.
    """
    rate = {"clock.rate_hz": 1000.0, "clock.steps_per_tick": 1, "controller.gains.anchor_gain": 0.02}
    planar = {"controller.gains.sliding_gain": (800.0, 800.0, 10.0), "controller.gains.pose_gain": 4.0}
    rate |= {"duration": 2.6, "controller.gains.sign_gain": 0.25} | (planar if name == "planar" else {})
    scenario = SCENARIOS[name]().replace(controller=ANCHORED[name], events=())
    scenario = scenario.replace(motion=cp.motions.HoldMotion(pose=scenario.start)).override(rate)
    rows, sizes = list(scenario.cell.task_rows.indices), 3.0 * np.logspace(4, 7, 4)
    linear, found = [row for row in rows if row < 3], []
    rigid = cp.run(scenario, engine="compiled", warn=False).data
    for k in sizes:
        compliant = with_grasps(scenario, (k, k, k, k / 100, k / 100, k / 100), damping_ratio=0.5)
        stable = step_stability(Simulation(compliant, build_controller(compliant)))
        steps = int(np.ceil(2.0 * stable.value / stable.limit))
        run = compliant.override({"clock.steps_per_tick": steps})
        data = cp.run(run, engine="compiled", warn=False).data
        moved, force = (
            (data[quantity].values[-1] - rigid[quantity].values[-1])[..., kept]
            for quantity, kept in (("pose_error", rows), ("internal_wrench", linear))
        )
        found.append((np.linalg.norm(moved), np.abs(force).max()))
    moves, forces = np.log(found).T
    slopes = [np.polyfit(np.log(sizes[first:]), of[first:], 1)[0] for first, of in ((0, moves), (1, forces))]
    print(f"\n{name}: {found} m or rad, N; slopes {slopes[0]:.3f}, {slopes[1]:.3f}")
    assert_allclose(slopes, -1.0, atol=0.02)


@pytest.mark.parametrize("stiffness", [UNEVEN, "soft"])
def test_bias_at_the_start_is_what_the_run_records(stiffness):
    """How far each arm sees P from the mean of all, by the check and by the first sample."""
    scenario = with_grasps(anchored("spatial"), stiffness).override({"duration": 0.002})
    found = grasp_stability(Simulation(scenario, build_controller(scenario)))
    seen = cp.run(scenario, warn=False).data["seen_pose_error"].values[0, :, :3]
    recorded = np.linalg.norm(seen - seen.mean(axis=0), axis=1).max()
    assert_allclose(found.bias, recorded, rtol=1e-9)
    assert found.bias > 1e-5
    assert f"{1e3 * found.bias:.3g} mm from the mean" in found.summary()
