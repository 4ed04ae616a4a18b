"""Blind baselines: settings of the shipped laws and laws of other papers, each by a published property."""

import numpy as np
import pytest
from cells import SCENARIOS
from law_cells import force_error, stated, still
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.control import CellController
from coop_pin.model import CellArm
from coop_pin.simulation.build_controller import build_controller

GAMMA, K_I = 4.0, 4.0
CARRIED = {"actuators.gravity_compensation": {}}
"""Each robot carries its own weight; what the payload weighs is left to the law."""
SLIDING = {"planar": [400.0, 400.0, 20.0], "spatial": [400.0, 400.0, 400.0, 10.0, 10.0, 10.0]}
LOAD = 20.0


def payload_space(name, **fields):
    """PD in payload space, Wen and Kreutz-Delgado (1992): no integral and no transient."""
    gains = {"pose_gain": GAMMA, "sliding_gain": SLIDING[name], "sign_gain": 0.0, "transient_rate": 1e4}
    gains |= {"anchor_gain": 0.0, "leak": 0.0} | fields.pop("gains", {})
    return {"controller": {"kind": "payload-space", "gains": gains, **fields}}


def proportional_integral(name, width=10.0):
    """PI in payload space: a layer that nothing leaves, so that k_I = alpha / width."""
    return payload_space(
        name, gains={"sign_gain": K_I * width}, switching={"kind": "saturation", "width": width}
    )


PUSH = {"events": [{"kind": "wrench-pulse", "time": 0.1, "duration": 2.4, "wrench": [LOAD, 0, 0, 0, 0, 0]}]}


@pytest.mark.parametrize("name", SCENARIOS)
def test_pd_in_payload_space_sags_by_the_load_over_its_stiffness_and_pi_takes_it_out(name):
    """A set point under a constant load: L / (gamma K) by PD, nothing by PI; what is stated is what runs."""
    left = {}
    for law in (payload_space, proportional_integral):
        scenario = still(name, law(name), rate=125.0, duration=2.5, **CARRIED, **PUSH)
        left[law] = cp.run(scenario, warn=False).data.pose_error.values[-1, 0]
    sag = LOAD / (GAMMA * SLIDING[name][0])
    assert_allclose(left[payload_space], sag, rtol=0.03)
    assert abs(left[proportional_integral]) < 0.05 * sag


class Beside(CellController):
    """Runs a law, and computes another one's torques from the same measurements."""

    def __init__(self, law, other):
        self.law, self.other, self.torques = law, other, []

    def init(self, measurements, references):
        self.state = self.other.init(measurements, references)
        return self.law.init(measurements, references)

    def step(self, measurements, references, state):
        theirs = self.other.step(measurements, references, self.state)
        self.state, ours = theirs.state, self.law.step(measurements, references, state)
        self.torques.append((np.concatenate(ours.torques), np.concatenate(theirs.torques)))
        return ours


class SlidingPid(cp.ArmController):
    """Parra-Vega, Arimoto, Liu, Hirzinger and Akella (2003), the law as published, on exact joint references.

    q_d by the arm's own inverse kinematics; S = Dqdot + alpha Dq, S_q = S - S(t_0) exp(-kappa t),
    tau = -K_d (S_q + K_i int tanh(S_q)), and J^T f_d, which a law in joint space does not have.
    """

    def __init__(self, scenario, arm):
        gains = scenario.controller.gains
        self.rows, self.period = scenario.cell.task_rows, scenario.clock.period
        self.model = CellArm(scenario.cell, arm)
        self.alpha, self.K_d, self.kappa = gains.pose_gain, np.array(gains.damping_gain), gains.transient_rate
        self.K_i, self.phi = gains.sign_gain, scenario.controller.switching

    def surface(self, m, reference):
        back = np.linalg.inv(self.model.drive)
        q_d = m.q.copy()
        for _ in range(20):
            q = self.model.configuration(back @ q_d)
            J = self.rows.select(self.model.payload_jacobian(q)) @ back
            q_d = q_d - np.linalg.solve(J, self.rows.pose_error(self.model.payload_pose(q), reference.pose))
        return m.v - np.linalg.solve(J, reference.twist) + self.alpha * (m.q - q_d)

    def init(self, m, reference):
        return self.surface(m, reference), np.zeros_like(m.q)

    def step(self, m, reference, state):
        start, integral = state
        S_q = self.surface(m, reference) - start * np.exp(-self.kappa * m.time)
        f_d = self.rows.turn(m.payload_pose, reference.internal_wrench)
        tau = -self.K_d * (S_q + self.K_i * integral) - m.payload_jacobian.T @ f_d
        return cp.ArmCommand(tau, (start, integral + self.period * self.phi(S_q)))


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_printed_law_without_force_feedback_is_the_sliding_pid_in_joint_space(name):
    """Their torques differ by the curvature of the kinematics alone: with the square of the error."""
    apart = []
    for step in (4e-3, 2e-3):
        controller = SCENARIOS[name]().controller.model_dump()
        controller |= {"switching": {"kind": "tanh", "width": 0.1}, "force_path": {"kind": "none"}}
        controller["gains"] |= {"sign_gain": 0.5, "force_gain": 0.0, "pose_gain": 3.0}
        scenario = still(
            name, {"controller": controller}, step=step, duration=0.3, **{"cell.gravity": [0, 0, 0]}
        )
        theirs = cp.laws.DecentralisedController(
            {arm: SlidingPid(scenario, arm) for arm in scenario.cell.arms}
        )
        both = Beside(build_controller(scenario), theirs)
        cp.simulate(scenario, both)
        ours, published = np.transpose(both.torques, (1, 0, 2))
        apart.append(np.abs(ours - published).max())
    assert apart[0] < 0.05 * np.abs(ours).max()
    assert_allclose(apart[0] / apart[1], 4.0, rtol=0.2)


@pytest.mark.parametrize("name", SCENARIOS)
def test_errors_stay_in_their_funnels_under_a_push_whatever_the_payload(name):
    """Verginis, Mastellaro and Dimarogonas (2018): |xtilde_j| < rho(t) for an unknown, here doubled, mass."""
    options = {"pose_funnel": 0.05, "pose_floor": 0.01, "pose_gain": 5e-4, "funnel_rate": 2.0}
    options |= {"velocity_gain": [4.0, 4.0, 0.3] if name == "planar" else [12.0] * 3 + [0.15] * 3}
    scenario = still(
        name,
        stated("prescribed-performance", **options),
        step=0.04,
        rate=500.0,
        duration=1.5,
        **CARRIED,
        **{"cell.payload.mass": 2.0 * SCENARIOS[name]().cell.payload.mass},
        **{
            "events": [{"kind": "wrench-pulse", "time": 1.0, "duration": 0.2, "wrench": [30, 20, 0, 0, 0, 0]}]
        },
    )
    result = cp.run(scenario, warn=False)
    rho = 0.04 * np.exp(-2.0 * result.data.time.values) + 0.01
    used = np.abs(result.data.pose_error.values) / rho[:, None]
    assert used[0].max() > 0.79
    assert used.max() < 0.95
    assert np.abs(result.data.pose_error.values[-1]).max() < 0.01


@pytest.mark.parametrize("name", SCENARIOS)
def test_followers_reach_their_wrench_whatever_their_kinematics_are_off_by(name):
    """Kosuge and Oosumi (1996): the internal force converges by the follower's own wrist alone."""
    scenario = SCENARIOS[name]()
    follower = list(scenario.cell.arms)[1]
    rows = list(scenario.cell.task_rows.indices)
    weight = scenario.cell.payload.mass * np.array([*scenario.cell.gravity, 0.0, 0.0, 0.0])
    B = [60.0, 60.0, 3.0] if name == "planar" else [60.0] * 3 + [3.0] * 3
    options = {
        "payload_weight": weight[rows].tolist(),
        "sliding_gain": SLIDING[name],
        "follower_damping": B,
        "follower_stiffness": [10.0 * b for b in B],
        "admittance_damping": B,
    }
    leader_follower = stated("leader-follower", **options)
    bias = {f"cell.arms.{follower}.calibration_error.tip.xyz": [1e-3, 0.0, 0.0], "sensors.wrist": {}}
    result = cp.run(still(name, leader_follower, duration=2.0, **CARRIED, **bias), warn=False)
    assert np.abs(force_error(result)).max() > 0.01
    assert np.abs(force_error(result)[-1]).max() < 1e-3
    assert np.abs(result.data.pose_error.values[-1]).max() < 1e-4


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("kind", ["admittance", "leader-follower"])
def test_the_payload_weight_is_that_of_the_scenario_unless_stated(kind, name):
    """As a wrench on an arm, [m g, 0]: negative along z where gravity is."""
    scenario = SCENARIOS[name]()
    if name == "planar":
        scenario = scenario.override({"cell.gravity": [0.0, -9.81, 0.0]})
    law = stated(kind, **({"admittance_damping": 50.0} if kind == "admittance" else {}))
    changed = scenario.override(law | _commands(kind))
    weight = scenario.cell.payload.mass * np.array([*scenario.cell.gravity, 0.0, 0.0, 0.0])
    for controller in build_controller(changed).controllers.values():
        assert_allclose(controller.gains.payload_weight, scenario.cell.task_rows.select(weight), rtol=1e-15)
    chosen = build_controller(changed.override({"controller.gains.payload_weight": 0.5}))
    for controller in chosen.controllers.values():
        assert_allclose(controller.gains.payload_weight, 0.5, rtol=0)


def _commands(kind):
    timing = {
        "clock": {"rate_hz": 500.0, "steps_per_tick": 2},
        "actuators": {"servo": {"command": "velocity"}},
    }
    return timing if kind == "admittance" else {}


@pytest.mark.parametrize(("weight", "rate"), [({}, 0.0), (0.0, -24.525e-3), (9.81 * 5.0, -49.05e-3)], ids=str)
def test_a_payload_sinks_by_the_weight_that_an_admittance_does_not_know(weight, rate):
    """By own wrists alone the arms yield to what they do not expect: its share over D = 1000 N s/m."""
    base = cp.Scenario.load("two-ur5-admittance")
    gains = {} if weight == {} else {"controller.gains.payload_weight": [0, 0, weight, 0, 0, 0]}
    still = {"controller.force_path": {"kind": "none"}, "motion": {"kind": "hold", "pose": base.start}}
    result = cp.run(base.override({"duration": 1.0, "events": [], **still, **gains}), warn=False)
    z = result.data.pose_error.values[:, 2]
    half = len(z) // 2
    assert (z[-1] - z[half]) / 0.5 == pytest.approx(rate, abs=1e-3)
