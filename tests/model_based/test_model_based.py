"""Controllers with a model, each by a published property of its paper, in a planar and a spatial cell."""

import numpy as np
import pytest
from cells import SCENARIOS
from law_cells import force_error, stated, still
from numpy.testing import assert_allclose
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import FieldError, ScenarioError
from coop_pin.control import ArmMeasurement
from coop_pin.model import CellArm
from coop_pin.model_based import ArmDynamics
from coop_pin.model_based.computed_torque import acceleration_torque
from coop_pin.simulation.build_controller import build_controller

STEP = 0.02


def computed_torque(**options):
    return stated("computed-torque", **options)


def x_error(result):
    return result.data.pose_error.values[:, 0]


@pytest.mark.parametrize("name", SCENARIOS)
def test_computed_torque_with_the_exact_model_decays_at_the_chosen_poles(name):
    """Tarn, Bejczy and Yun (1987): e'' + K_v e' + K_p e = 0; what is left is of the order of the tick."""
    worst = []
    for rate in (125.0, 250.0):
        result = cp.run(
            still(name, computed_torque(position_gain=25.0, velocity_gain=10.0), step=STEP, rate=rate),
            warn=False,
        )
        t = result.data.time.values
        worst.append(np.abs(x_error(result) + STEP * (1.0 + 5.0 * t) * np.exp(-5.0 * t)).max())
        assert worst[-1] < 2.5 * STEP / rate
    assert_allclose(worst[0] / worst[1], 2.0, rtol=0.15)


@pytest.mark.parametrize("name", by_default(SCENARIOS, "spatial"))
def test_the_internal_force_integral_takes_out_what_a_wrong_model_leaves(name):
    """Li, Hsu and Sastry (1989): the internal force converges; the tracking error of the model stays."""
    wrong = {"mass": 1.3, "inertia": 0.8, "friction": 0.0}
    left = {}
    for gain in (0.0, 0.2):
        controller = computed_torque(model=wrong, anchor_gain=gain, position_gain=100.0, velocity_gain=20.0)
        result = cp.run(still(name, controller, step=STEP, duration=1.0), warn=False)
        left[gain] = np.abs(force_error(result)[-125:]).max()
        assert np.abs(x_error(result)[-125:]).max() > 1e-4
    assert left[0.2] < 0.2 * left[0.0]


def test_gains_and_factors_that_a_law_does_not_have_are_refused_with_their_path():
    with pytest.raises(FieldError) as refused:
        cp.run("adept-paper", computed_torque(gain=1.0), warn=False)
    assert refused.value.path == "controller.gains.gain"
    with pytest.raises(FieldError) as refused:
        cp.run("adept-paper", computed_torque(position_gain=[1.0, 2.0]), warn=False)
    assert refused.value.path == "controller.gains.position_gain"
    with pytest.raises(ScenarioError):
        cp.run("adept-paper", computed_torque(model={"mas": 2.0}), warn=False)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_payload_answers_a_push_like_the_stated_mass_spring_and_damper(name):
    """Schneider and Cannon (1992): M_d e'' + D e' + K e = F_ext, whatever payload and arms weigh."""
    M_d, D, K, push = 15.0, 240.0, 1500.0, 30.0
    linear, angular = (2, 1) if name == "planar" else (3, 3)
    controller = stated(
        "object-impedance",
        **{
            field: [value] * linear + [value / M_d] * angular
            for field, value in {"inertia": M_d, "damping": D, "stiffness": K}.items()
        },
    )
    event = {"kind": "wrench-pulse", "time": 0.0, "duration": 1.0, "wrench": [push, 0, 0, 0, 0, 0]}
    result = cp.run(
        still(name, controller, duration=1.0, rate=500.0, events=[event], **{"sensors.wrist": {}}), warn=False
    )
    t = result.data.time.values
    p, r = np.roots([M_d, D, K])
    answer = push / K * (1.0 + (r * np.exp(p * t) - p * np.exp(r * t)) / (p - r)).real
    assert_allclose(x_error(result), answer, atol=0.03 * push / K)
    assert_allclose(x_error(result)[-1], push / K, rtol=0.02)


def moving(name, controller, duration, **changes):
    """A test cell whose payload swings, or follows the paper's motion."""
    scenario = SCENARIOS[name]().replace(events=(), duration=duration)
    start = scenario.start.model_dump()
    goal = start | {"xyz": [start["xyz"][0] - 0.1, start["xyz"][1] + 0.05, start["xyz"][2]]}
    motion = {"kind": "line", "start": start, "goal": goal, "start_time": 0.0, "duration": duration}
    return scenario.override(
        {"motion": motion, "clock.rate_hz": 250.0, "clock.steps_per_tick": 1} | controller | changes
    )


def measured(scenario, arm, *, seed):
    """A measurement of an arm with velocities, from its own model."""
    model, rng = CellArm(scenario.cell, arm), np.random.default_rng(seed)
    q, v = rng.uniform(-1.0, 1.0, (2, model.nv))
    back, joints = np.linalg.inv(model.drive), model.configuration(np.linalg.inv(model.drive) @ q)
    J = scenario.cell.task_rows.select(model.payload_jacobian(joints)) @ back
    pose, no = model.payload_pose(joints), np.zeros(model.nv, dtype=bool)
    return ArmMeasurement(0.0, q, v, pose, J @ v, J, None, no)


@pytest.mark.parametrize("name", [*SCENARIOS, "two-pandas-box"])
def test_the_torque_of_an_acceleration_accelerates_the_payload_and_holds_spare_joints(name):
    scenario = SCENARIOS[name]() if name in SCENARIOS else cp.Scenario.load(name)
    arm = next(iter(scenario.cell.arms))
    measurement, dynamics = measured(scenario, arm, seed=4), ArmDynamics(scenario, arm)
    (M, h, J_dot), J, v = dynamics.terms(measurement), measurement.payload_jacobian, measurement.v
    start, a = np.full(len(v), 0.2), np.arange(1.0, 1.0 + len(J))
    L, r = acceleration_torque(dynamics, measurement, start, (9.0, 5.0))
    acceleration = np.linalg.solve(M, L @ a + r - h)
    assert_allclose(J @ acceleration + J_dot @ v, a, atol=1e-9)
    spare = np.eye(len(v)) - np.linalg.pinv(J) @ J
    assert_allclose(spare @ (acceleration + 9.0 * (measurement.q - start) + 5.0 * v), 0.0, atol=1e-8)


@pytest.mark.parametrize("name", SCENARIOS)
def test_regressors_are_those_of_the_dynamics_and_their_coriolis_terms_are_skew(name):
    """Y theta against CRBA, RNEA and friction; s^T (Mdot / 2 - C) s = 0 with Mdot by finite differences."""
    scenario = SCENARIOS[name]()
    arm = list(scenario.cell.arms)[1]
    dynamics, m = ArmDynamics(scenario, arm), measured(scenario, arm, seed=1)
    theta, phi = dynamics.parameters()
    terms, rng = dynamics.terms(m), np.random.default_rng(2)
    a, s, A = rng.normal(size=(3, len(m.q)))
    assert_allclose(dynamics.regressor(m, m.v, a) @ theta, terms.M @ a + terms.h, atol=1e-10)
    F_0 = dynamics.payload_inertia(m.payload_pose) @ A + dynamics.payload_bias(m)
    assert_allclose(dynamics.payload_regressor(m, m.payload_twist, A) @ phi, F_0, atol=1e-10)

    rest = np.zeros_like(a)
    C_s = (dynamics.regressor(m, s, rest) - dynamics.regressor(m, rest, rest)) @ theta
    viscous = theta[-2 * len(m.q) : -len(m.q)]
    h = 1e-6
    ahead, behind = (dynamics.terms(m._replace(q=m.q + sign * h * m.v)).M for sign in (1.0, -1.0))
    M_dot = (ahead - behind) / (2.0 * h)
    assert_allclose(s @ M_dot @ s / 2.0, s @ (C_s - viscous * s), atol=1e-6)


class Keeper(cp.CellController):
    """Keeps measurements, references and states of a law."""

    def __init__(self, law):
        self.law, self.kept = law, []

    def init(self, measurements, references):
        return self.law.init(measurements, references)

    def step(self, measurements, references, state):
        self.kept.append((measurements, references, state))
        return self.law.step(measurements, references, state)


def lyapunov(scenario, kept):
    """V = sum s^T M s / 2 + s_0^T M_0 s_0 / 2 + weighted parameter errors, from the true parameters."""
    V, gains, rows = 0.0, scenario.controller.gains, scenario.cell.task_rows
    for index, arm in enumerate(scenario.cell.arms):
        m, reference, state = (part[index] for part in kept)
        exact = ArmDynamics(scenario, arm)
        theta, phi = exact.parameters()
        xtilde = rows.pose_error(m.payload_pose, reference.pose)
        s_0 = m.payload_twist - reference.twist + gains.pose_gain * xtilde
        s = np.linalg.solve(m.payload_jacobian, s_0)
        V += s @ exact.terms(m).M @ s / 2.0
        share = scenario.cell.shares[index]
        V += share * s_0 @ exact.payload_inertia(m.payload_pose) @ s_0 / 2.0
        V += ((state.parameters - theta) ** 2).sum() / (2.0 * gains.adaptation)
        V += ((state.payload - share * phi) ** 2).sum() / (2.0 * gains.payload_adaptation)
    return V


@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_adaptation_lowers_its_lyapunov_function_and_the_error(name):
    """Slotine and Li (1987): V falls, so that the estimates stay bounded, and the error shrinks."""
    K_d, gain, rate = {
        "planar": ([20.0, 20.0, 2.0], 300.0, 250.0),
        "spatial": ([30.0, 30.0, 20.0, 2.0, 2.0, 1.0], 5.0, 500.0),
    }[name]
    options = {"damping_gain": K_d, "model": {"mass": 0.5}}
    options |= {"adaptation": gain, "payload_adaptation": gain}
    scenario = moving(name, stated("adaptive", **options), 1.0, **{"clock.rate_hz": rate})
    keeper = Keeper(build_controller(scenario))
    result = cp.simulate(scenario, keeper)
    V = np.array([lyapunov(scenario, kept) for kept in keeper.kept[::25]])
    assert np.diff(V).max() < 2e-4 * V[0]
    assert V[-1] < V[0]
    frozen = {"controller.gains.adaptation": 0.0, "controller.gains.payload_adaptation": 0.0}
    without = cp.run(scenario, frozen, warn=False)
    last = np.linalg.norm(result.data.pose_error.values[-100:], axis=1).max()
    assert last < 0.5 * np.linalg.norm(without.data.pose_error.values[-100:], axis=1).max()


def torque_qp(**options):
    pytest.importorskip("proxsuite", reason="proxsuite is not installed (extra 'compare')")
    return stated("torque-qp", **options)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_torque_qp_without_active_constraints_is_computed_torque(name):
    both = [
        cp.run(still(name, law(), step=STEP, duration=0.2), warn=False)
        for law in (computed_torque, torque_qp)
    ]
    torques = [result.data.commanded_torque.values for result in both]
    assert_allclose(torques[1], torques[0], atol=1e-5 * np.nanmax(np.abs(torques[0])))


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_torque_qp_keeps_torque_limits_and_friction_cones(name):
    """Bouyarmane et al. (2019): constraints hold in every tick, and the motion still arrives."""
    scenario = still(name, torque_qp(friction_coefficient=0.5, anchor_gain=0.0), step=STEP, duration=0.8)
    peak = np.nanmax(np.abs(cp.run(scenario, warn=False).data.commanded_torque.values), axis=0)
    limits = {}
    for index, arm in enumerate(scenario.cell.arms):
        joints = CellArm(scenario.cell, arm).nv
        limits[f"cell.arms.{arm}.torque_limits"] = (0.95 * peak[index][:joints] + 0.1).tolist()
    result = cp.run(scenario, limits, warn=False)
    beyond = np.abs(result.data.commanded_torque.values) - result.data.torque_limit.values
    assert np.nanmax(beyond) < 1e-6
    assert (np.abs(beyond) < 1e-6).any()
    assert np.abs(x_error(result)[-1]) < 0.25 * STEP
    tips, force = result.data.tip_position.values, -result.data.interaction_wrench.values[..., :3]
    axis = tips[:, ::-1] - tips
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    force = np.nan_to_num(force)
    pressed = (force * axis).sum(axis=-1)
    across = np.linalg.norm(force - pressed[..., None] * axis, axis=-1)
    assert pressed[1:].min() > 0.0
    assert (across - 0.5 * np.sqrt(2.0) * pressed)[1:].max() < 0.5


@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_the_disturbance_estimate_takes_out_a_constant_push(name):
    """Verginis, Mastellaro and Dimarogonas (2018): the pose error vanishes under an unknown disturbance."""
    K_d = [20.0, 20.0, 2.0] if name == "planar" else [30.0, 30.0, 20.0, 2.0, 2.0, 1.0]
    options = {
        "damping_gain": K_d,
        "adaptation": 0.0,
        "payload_adaptation": 0.0,
        "anchor_gain": 0.0,
        "model": {},
    }
    event = {"kind": "wrench-pulse", "time": 0.0, "duration": 2.0, "wrench": [20.0, 0, 0, 0, 0, 0]}
    left = {}
    for rate in (0.0, 100.0):
        controller = stated("adaptive", **options, disturbance_rate=rate)
        left[rate] = np.abs(
            x_error(cp.run(still(name, controller, duration=2.0, events=[event]), warn=False))[-1]
        )
    assert left[0.0] > 1e-3
    assert left[100.0] < 0.05 * left[0.0]
