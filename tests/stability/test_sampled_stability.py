"""Sampled stability: against the closed form of square arms, and against runs on both sides of the limit."""

import importlib
import re

import numpy as np
import pinocchio as pin
import pytest
from cells import ANCHORED, SCENARIOS
from close import assert_close
from damping import damping_and_inertia
from joint_cells import FIVE_JOINTS
from numpy.testing import assert_allclose
from random_cells import random_cell
from scipy.linalg import eigvalsh, expm

import coop_pin as cp
from coop_pin.base.errors import CoopPinError, DivergedError, ScenarioWarning
from coop_pin.chain.integrators import INTEGRATORS
from coop_pin.cli import main
from coop_pin.control import ArmCommand, ArmController
from coop_pin.feasibility import reachability
from coop_pin.grasps import CellChain
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import (
    SampledStability,
    loop_stability,
    motion_stability,
    sampled_motion,
    sampled_stability,
    step_stability,
)
from coop_pin.stability.sampled_motion import tick_matrix
from coop_pin.stability.sampled_stability import configurations_along, delayed_factor
from coop_pin.stability.step_stability import REAL_STABILITY

QUIET = {"controller.gains.sign_gain": 0.0, "events": [], "duration": 1.5}


def paper(changes=()):
    return cp.Scenario.load("adept-paper", QUIET | dict(changes))


def with_damping(factor, changes=()):
    return paper(
        {"controller.gains.damping_gain": [60.0 * factor, 60.0 * factor, 10.0 * factor]} | dict(changes)
    )


def closed_form(cell, X, damping_gains, period):
    """T lambda_max(A^-1 B) in the task rows, for arms with as many joints as the cell has task rows."""
    return period * float(eigvalsh(*damping_and_inertia(cell, X, damping_gains))[-1])


@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0])
def test_of_square_arms_it_is_the_closed_form(factor):
    scenario = with_damping(factor)
    gains = dict.fromkeys(scenario.cell.arms, np.diag([60.0 * factor, 60.0 * factor, 10.0 * factor]))
    expected = closed_form(scenario.cell, scenario.start.matrix, gains, scenario.clock.period)
    assert_allclose(sampled_stability(scenario).value, expected, rtol=1e-6)


def test_signs_events_and_the_way_the_payload_is_held_do_not_change_it():
    value = sampled_stability(paper()).value
    assert_allclose(
        sampled_stability(cp.Scenario.load("adept-paper", {"controller.gains.sign_gain": 5.0})).value,
        value,
        rtol=1e-6,
    )
    assert_allclose(sampled_stability(paper({"plant.payload": "free"})).value, value, rtol=1e-6)


def last_speed(scenario):
    """The largest joint speed of the last half second, rad/s; infinite for a run that breaks off."""
    try:
        result = cp.run(scenario, warn=False)
    except CoopPinError:
        return np.inf
    return float(np.abs(result.data.velocity.values[result.data.time.values > 1.0]).max())


@pytest.mark.parametrize("factor", [1.0, 2.6, 2.9, 3.4])
def test_runs_on_both_sides_of_the_bound_do_as_it_says(factor):
    """After a small push, without friction, which would damp a little more."""
    scenario = with_damping(factor, {"cell.arms.left.friction": "none", "cell.arms.right.friction": "none"})
    push = {"kind": "wrench-pulse", "time": 0.1, "duration": 0.1, "wrench": (2.0, 1.0, 0.0, 0.0, 0.0, 0.1)}
    scenario = scenario.override(
        {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}, "events": [push]}
    )
    held = sampled_stability(scenario)
    assert held.ok == (factor < 2.75)
    assert (last_speed(scenario) < 0.05) == held.ok


def test_spare_joints_count_as_well():
    """The posture's damper acts on what does not move the payload."""
    pandas = cp.Scenario.load("two-pandas-box")
    stiff = pandas.override({"controller.posture.damping": 200.0})
    assert sampled_stability(pandas).ok
    assert not sampled_stability(stiff).ok
    assert all("panda_joint" in joint for joint in sampled_stability(stiff).joints)


class Accelerating(ArmController):
    """Speeds a moving arm up."""

    def __init__(self, scenario, arm):
        pass

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        return ArmCommand(0.1 * measurement.v, state)


def test_a_law_that_drives_the_motion_is_told_without_a_rate():
    held = sampled_stability(
        paper().override({"controller": {"kind": "user", "target": f"{__name__}:Accelerating"}})
    )
    assert held.value == np.inf
    assert "clock.rate_hz, or" in held.summary()


def test_what_is_told_of_it():
    text = SampledStability(3.0, 100.0, ("left/wrist",)).summary()
    for part in ("T*lambda = 3 ", "limit 2", "100 Hz", "left/wrist", "above 150 Hz"):
        assert part in text


def test_check_fails_where_the_rate_cannot_bear_the_gains(tmp_path, capsys):
    paper().save(tmp_path / "fast.toml")
    paper({"clock.rate_hz": 25.0}).save(tmp_path / "slow.toml")
    assert main(["check", str(tmp_path / "fast.toml"), "--poses", "5"]) == 0
    assert "T*lambda" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "slow.toml"), "--poses", "5"]) == 1
    assert "unstable" in capsys.readouterr().out


def alone(changes=()):
    """The left arm of the paper's cell with the payload: no closure is left, so D = M^-1 T^T K_d T."""
    scenario = paper(changes)
    cell = scenario.cell
    only = {"arms": {"left": cell.arms["left"]}, "grasps": {"left": cell.grasps["left"]}}
    return scenario.replace(cell=cell.replace(**only, load_shares=None), squeeze={})


@pytest.mark.parametrize("damping", [(60.0, 60.0, 10.0), (10.0, 200.0, 1.0), (300.0, 1.0, 1.0)])
def test_of_a_single_arm_it_is_the_fastest_mode_and_its_joints(damping):
    scenario = alone({"controller.gains.damping_gain": damping})
    chain = CellChain(scenario.cell)
    q, T = chain.configuration(scenario.start.matrix), chain.model.arms[0].drive
    model = chain.mechanism.model
    D = np.linalg.solve(pin.crba(model, model.createData(), q) @ np.eye(3), T.T @ np.diag(damping) @ T)
    values, modes = np.linalg.eig(D)
    worst = np.argmax(values)
    found = sampled_stability(scenario)
    assert_close(found.value, scenario.clock.period * values[worst], atol=1e-6 * found.value)
    share = np.abs(modes[:, worst]) / np.abs(modes[:, worst]).max()
    names = [chain.model.arms[0].angles.names[joint] for joint in np.argsort(-share) if share[joint] >= 0.3]
    assert list(found.joints) == names


@pytest.mark.parametrize("D", [1, 4])
def test_of_one_late_mode_the_limit_is_that_of_levin_and_may(D):
    """Beside a motion that nothing damps; without anything late there is none."""
    late = 0.25 * np.outer((0.6, 0.8), (0.6, 0.8))
    expected = 2.0 * np.sin(np.pi / (4.0 * D + 2.0)) / 0.25
    assert_allclose(delayed_factor(0.0 * late, late, D), expected, rtol=2e-3)
    assert delayed_factor(late, 0.0 * late, D) == np.inf


def test_late_damping_decays_below_its_limit_and_grows_above():
    """v[k+1] = v[k] - now v[k] - late v[k-D], tick by tick."""
    now, late, D = np.array([[0.10, 0.02], [0.02, 0.05]]), np.array([[0.20, 0.05], [0.05, 0.30]]), 3
    factor, sizes = delayed_factor(now, late, D), []
    for part in (0.97, 1.03):
        v = [np.array([1.0, -0.4])] * (D + 1)
        for _ in range(1000):
            v.append(v[-1] - part * factor * (now @ v[-1] + late @ v[-1 - D]))
        sizes.append(np.abs(v[-20:]).max())
    assert sizes[0] < 0.05 < 5.0 < sizes[1]


class Following(ArmController):
    """A damper whose gain is where the reference is."""

    def __init__(self, scenario, arm):
        pass

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        return ArmCommand(-reference.pose[0, 3] * measurement.v, None)


def along(scenario, poses=9):
    simulation = Simulation(scenario, build_controller(scenario))
    return motion_stability(simulation, reachability(scenario, poses=poses))


def test_along_the_motion_it_is_the_closed_form_where_that_is_largest():
    scenario = with_damping(1.0)
    gains = dict.fromkeys(scenario.cell.arms, np.diag([60.0, 60.0, 10.0]))
    times = np.linspace(0.0, scenario.duration, 9).tolist()
    expected = [
        closed_form(scenario.cell, np.array(scenario.motion.at(t).X_WP_d), gains, scenario.clock.period)
        for t in times
    ]
    found, worst = along(scenario), int(np.argmax(expected))
    assert_allclose([found.value, found.time], [expected[worst], times[worst]], rtol=1e-6)
    assert f"t = {found.time:.3g} s" in found.summary()


def test_in_space_it_is_that_of_a_cell_that_starts_there():
    scenario = SCENARIOS["spatial"]().override({"events": []})
    found = along(scenario)
    X = cp.Pose.from_matrix(scenario.motion.at(found.time).X_WP_d)
    there = scenario.replace(start=X, motion={"kind": "hold", "pose": X})
    assert_allclose(sampled_stability(there).value, found.value, rtol=1e-4)
    assert found.value >= sampled_stability(scenario).value - 1e-9


@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box", FIVE_JOINTS])
def test_configurations_along_a_motion_hold_the_payload_where_it_is_then(name):
    """Arms of five joints on hinges, too, which do not see how far the payload has turned."""
    scenario = cp.Scenario.load(name, {"events": []})
    goal = scenario.start.replace(rpy=np.add(scenario.start.rpy, (0.0, 0.0, 0.1)))
    turn = cp.motions.LineMotion(start=scenario.start, goal=goal, start_time=0.1, duration=1.0)
    scenario = scenario.replace(motion=turn, duration=1.2)
    run, reach = Simulation(scenario, build_controller(scenario)), reachability(scenario, poses=5)
    along = configurations_along(run, reach, 4)
    assert along[0][0] == 0.0 < along[-1][0]
    for time, q in along:
        expected = scenario.payload_motion.at(time).X_WP_d
        assert_allclose(run.chain.payload_pose(q), expected, rtol=0, atol=1e-8)


def test_a_funnel_is_looked_at_until_its_end():
    """The damping goes with one over the square of the width, and a little with the pose."""
    gains = {"velocity_funnel": 5.0, "velocity_floor": 0.5, "velocity_gain": [80.0, 80.0, 4.0]}
    scenario = SCENARIOS["planar"]().override(
        {"events": [], "duration": 10.0, "controller": {"kind": "prescribed-performance", "gains": gains}}
    )
    start, found = sampled_stability(scenario), along(scenario)
    assert found.time == 10.0
    assert_allclose(found.value / start.value, 100.0, rtol=0.1)


def test_it_is_that_of_the_start():
    law = {"kind": "user", "target": Following}
    scenario = alone().replace(controller=law)
    still = scenario.replace(
        motion={"kind": "hold", "pose": cp.Pose.from_matrix(scenario.motion.at(0.0).X_WP_d)}
    )
    assert_close(sampled_stability(scenario).value, sampled_stability(still).value, atol=1e-12)


def with_friction(viscous, coulomb=0.0, **plant):
    """The paper's arms with other friction on each drive, at two plant steps in a tick."""
    scenario = paper({"clock.steps_per_tick": 2, **{f"plant.{name}": value for name, value in plant.items()}})
    friction = cp.actuators.JointFriction(viscous=viscous, coulomb=coulomb)
    arms = {name: arm.replace(friction=friction) for name, arm in scenario.cell.arms.items()}
    return scenario.replace(cell=scenario.cell.replace(arms=arms), events=())


def steps_of(scenario):
    return step_stability(Simulation(scenario, build_controller(scenario)))


def test_the_stability_limits_are_those_of_the_integrators():
    """v' = -lambda v: |v| falls in a step just within the limit, and grows just beyond it."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    for name, limit in REAL_STABILITY.items():
        integrator = INTEGRATORS[name](model)
        for h, decays in ((limit * (1 - 1e-9), True), (limit * (1 + 1e-9), False)):
            step = integrator.step(lambda _t, _q, v: (-v, np.zeros(1)), 0.0, np.zeros(1), np.ones(1), h)
            assert (abs(step.v[0]) < 1.0) == decays


@pytest.mark.parametrize("viscous", [(3.0, 2.0, 0.5), (0.5, 40.0, 8.0)])
def test_of_friction_it_is_the_fastest_decay_of_a_single_arm(viscous):
    """Without a closure D = M^-1 T^T diag(viscous) T; Coulomb friction adds coulomb / coulomb_velocity."""
    scenario = alone({"clock.steps_per_tick": 4})
    friction = cp.actuators.JointFriction(viscous=viscous, coulomb=(0.1, 0.0, 0.2), coulomb_velocity=0.05)
    arm = scenario.cell.arms["left"].replace(friction=friction)
    scenario = scenario.replace(cell=scenario.cell.replace(arms={"left": arm}))
    chain = CellChain(scenario.cell)
    q, T = chain.configuration(scenario.start.matrix), chain.model.arms[0].drive
    M = np.triu(pin.crba(chain.mechanism.model, chain.mechanism.model.createData(), q))
    M += np.triu(M, 1).T
    slope = np.diag(np.array(viscous) + np.array((2.0, 0.0, 4.0)))
    fastest = np.linalg.eigvals(np.linalg.solve(M, T.T @ slope @ T)).real.max()
    assert_allclose(steps_of(scenario).value, scenario.clock.period / 4 * fastest, rtol=1e-6)


@pytest.mark.parametrize("integrator", ["rk4", "semi-implicit-euler"])
def test_a_run_takes_the_steps_that_it_asks_for_and_fails_with_fewer(integrator):
    scenario = with_friction((800.0, 800.0, 160.0), integrator=integrator).override({"duration": 0.2})
    found = steps_of(scenario)
    assert not found.ok
    steps = int(re.search(r"from 2 to (\d+)", found.summary())[1])
    enough, few = (scenario.override({"clock.steps_per_tick": n}) for n in (steps, steps - 1))
    assert steps_of(enough).ok
    assert not steps_of(few).ok
    assert cp.run(enough, warn=False).end == pytest.approx(enough.duration)
    with pytest.raises(DivergedError):
        cp.run(few, warn=False)


@pytest.mark.parametrize(("cell", "by"), [("planar", (-0.05, -0.08, 0.0)), ("spatial", (0.05, 0.08, 0.0))])
def test_along_the_motion_the_steps_are_those_of_the_pose_that_asks_for_most(cell, by):
    """As of a run that starts at that pose."""
    start = SCENARIOS[cell]().start
    goal = start.replace(xyz=tuple(np.add(start.xyz, by)))
    motion = cp.motions.LineMotion(start=start, goal=goal, start_time=0.2, duration=1.5)
    scenario = SCENARIOS[cell]().override({"events": [], "duration": 2.0, "motion": motion})
    run = Simulation(scenario, build_controller(scenario))
    reach = reachability(scenario, poses=21)
    found, at_start = step_stability(run, reach), steps_of(scenario)
    assert found.value > 1.001 * at_start.value
    assert (found.time > 0.0, at_start.time) == (True, 0.0)
    there = cp.Pose.from_matrix(motion.at(found.time).X_WP_d)
    arms = {
        reach_of.arm: scenario.cell.arms[reach_of.arm].replace(posture=tuple(q.tolist()))
        for reach_of in reach.arms
        for q in [reach_of.q[np.searchsorted(reach_of.times, found.time)]]
    }
    moved = scenario.replace(cell=scenario.cell.replace(arms=arms), start=there)
    assert_allclose(found.value, steps_of(moved).value, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "number"), [(1, 17), (2, 19)])
def test_a_proposal_has_steps_for_the_friction_along_the_motion(seed, number):
    """Two random cells in which joint 1 or 3 of an xArm7 turns back on its way: energy came from nothing."""
    scenario = cp.suggest(random_cell(seed, number), poses=21).scenario
    run, reach = Simulation(scenario, build_controller(scenario)), reachability(scenario, poses=101)
    found = step_stability(run, reach)
    assert found.ok
    assert found.time > 0.0
    by_start, along = (
        np.ceil(each.value * each.steps_per_tick / each.limit) for each in (step_stability(run), found)
    )
    assert by_start < along <= found.steps_per_tick


def test_check_and_run_tell_friction_that_the_steps_cannot_integrate(tmp_path, capsys):
    """Two xArm7 at 1 kHz, as a new user had them: the run ended with energy that no work explains."""
    stiff, fine = with_friction((3000.0, 3000.0, 600.0)), with_friction((1.2, 1.2, 1.2), 0.01)
    stiff.save(tmp_path / "stiff.toml")
    fine.save(tmp_path / "fine.toml")
    assert main(["check", str(tmp_path / "fine.toml"), "--poses", "3"]) == 0
    assert main(["check", str(tmp_path / "stiff.toml"), "--poses", "3"]) == 1
    assert "Raise clock.steps_per_tick from 2 to" in " ".join(capsys.readouterr().out.split())
    out = ["--out", str(tmp_path / "out"), "--quiet", "--no-replay", "--no-figures", "--duration", "0.05"]
    with pytest.warns(ScenarioWarning, match="friction of"):
        assert main(["run", str(tmp_path / "stiff.toml"), *out]) in (3, 4)


# ------------------------------------------------------------ all gains under the lag of the drives


def pushed(name, lag, **fields):
    """A test cell without friction that holds its start with the anchored law, pushed gently once."""
    scenario = SCENARIOS[name]().replace(controller=ANCHORED[name], **fields)
    push = {"kind": "wrench-pulse", "time": 0.1, "duration": 0.1, "wrench": (0.5, 0.2, 0.0, 0.0, 0.0, 0.02)}
    still = {
        "motion": {"kind": "hold", "pose": scenario.start.model_dump()},
        "events": [push],
        "clock.steps_per_tick": 1,
        "actuators.lag": lag,
    }
    return scenario.override(still | {f"cell.arms.{arm}.friction": "none" for arm in scenario.cell.arms})


def loop_of(scenario):
    return loop_stability(Simulation(scenario, build_controller(scenario)))


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_the_largest_lag_is_sharp_on_the_plant(cell, factor):
    duration = 20.0 if cell == "planar" else 10.0
    scenario = pushed(cell, 0.0, duration=duration)
    lag = factor * loop_of(scenario).largest_lag
    scenario = scenario.override({"actuators.lag": lag})
    found = loop_of(scenario)
    assert found.ok == (factor < 1.0)
    assert_allclose(found.lag, lag)
    result = cp.run(scenario, warn=False)
    error, time = np.linalg.norm(result.data.pose_error.values, axis=1), result.data.time.values / duration
    early, late = (error[(time >= at) & (time < at + 0.2)].max() for at in (0.4, 0.8))
    assert (late < early) == (factor < 1.0)


def identified(signals, order=24, depth=30):
    """Factors z from tick to tick of signals without noise, shape (ticks, channels), by their ERA."""
    blocks = np.lib.stride_tricks.sliding_window_view(signals, depth, axis=0)
    U, S, _ = np.linalg.svd(blocks.reshape(len(blocks), -1), full_matrices=False)
    states = U[:, :order] * S[:order]
    return np.linalg.eigvals(np.linalg.lstsq(states[:-1], states[1:], rcond=None)[0])


FILTERED = {
    "planar": {"sensors.velocity": {"kind": "difference", "cutoff_hz": 20.0}},
    "spatial": {"sensors.velocity": {"kind": "observer", "bandwidth_hz": 40.0}},
}
LAGGING = {"planar": {"actuators.lag": 0.1}, "spatial": {"actuators.lag": 0.01}}


@pytest.mark.parametrize(
    ("cell", "changes"),
    [
        *(("planar", {}), ("planar", FILTERED), ("spatial", LAGGING)),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("planar", LAGGING), ("spatial", {}), ("spatial", FILTERED))
        ),
    ],
)
def test_the_fastest_growth_and_the_least_damping_are_those_of_a_run(cell, changes):
    """Of a push; the planar cell's motion grows with its lag. Gains that differ between rows."""
    gains = np.array(ANCHORED[cell].gains.sliding_gain)
    rows = np.linspace(0.8, 1.2, len(gains))
    fields = {"controller.gains.pose_gain": (2.0 * rows).tolist(), "cell.gravity": [0.0, 0.0, 0.0]}
    fields |= {"controller.gains.sign_gain": (0.25 * rows[::-1]).tolist(), **changes.get(cell, {})}
    scenario = pushed(cell, 0.0).override(fields | {"duration": {"planar": 4.0, "spatial": 2.4}[cell]})
    simulation = Simulation(scenario, build_controller(scenario))
    motion = sampled_motion(simulation, simulation.plant.q, 0.0)
    modes = motion.modes(simulation, scenario.actuators.lag)
    data = cp.run(scenario, warn=False).data
    error = data.pose_error.values[data.time.values > 0.2]
    error = error[:, np.abs(error).max(axis=0) > 1e-9]
    z = identified(error / np.abs(error).max(axis=0))
    least = min(modes, key=lambda mode: mode.damping)
    for mode in (least, max(modes, key=lambda mode: abs(mode.z))):
        assert_allclose(z[np.abs(z - mode.z).argmin()], mode.z, atol=1.5e-3)
    log = np.log(least.z)
    assert_allclose(least.damping, -log.real / abs(log))
    found = loop_of(scenario)
    assert (found.damping, found.radius) == (least.damping, max(abs(mode.z) for mode in modes))
    assert found.ok == (cell == "spatial" or changes is not LAGGING)
    assert ("lower sign_gain" in found.summary()) == (found.ok and least.damping < 0.55)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_t_lambda_is_that_of_the_speeds_in_the_sampled_motion(cell):
    """D of the damping alone is the part of the closed loop by speeds, where a law is linear in them."""
    simulation = Simulation(scenario := pushed(cell, 0.0), build_controller(scenario))
    motion = sampled_motion(simulation, simulation.plant.q, 0.0)
    D = -motion.feedback[:, len(motion.feedback) :]
    T_lambda = scenario.clock.period * np.linalg.eigvals(D)
    expected = np.max(np.abs(T_lambda) ** 2 / T_lambda.real)
    assert_allclose(sampled_stability(scenario).value, expected, rtol=1e-5)


@pytest.mark.parametrize("lag", [0.0, 0.03, 0.2])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_at_a_fast_rate_its_modes_are_those_of_continuous_time(cell, lag):
    """lag s^4 + s^3 + lambda (s + gamma)(s + k_I) for every eigenvalue lambda of A^-1 K, without gravity."""
    scenario = pushed(cell, lag).override({"clock.rate_hz": 2e4, "cell.gravity": [0.0, 0.0, 0.0]})
    gains, start = scenario.controller.gains, scenario.start.matrix
    none = dict.fromkeys(scenario.cell.arms, np.zeros((len(gains.sliding_gain),) * 2))
    _, A = damping_and_inertia(scenario.cell, start, none)
    gamma, k_I = gains.pose_gain, gains.sign_gain / scenario.controller.switching.width
    slowest = max(
        np.roots([lag, 1.0, rate, rate * (gamma + k_I), rate * gamma * k_I]).real.max()
        for rate in eigvalsh(np.diag(gains.sliding_gain), A)
    )
    found = loop_of(scenario)
    assert_allclose(2e4 * np.log(found.radius), slowest, rtol=0.01, atol=0.003)
    assert found.ok == (slowest < 0.0)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_lags_beyond_a_second_are_not_looked_at(cell):
    """s^2 lag + s + lambda decays with any lag; of gamma = 0.1 and no integral."""
    gains = {"controller.gains.pose_gain": 0.1, "controller.gains.sign_gain": 0.0}
    scenario = pushed(cell, 0.0).override(gains | {"cell.gravity": [0.0, 0.0, 0.0]})
    assert loop_of(scenario).largest_lag == 1.0


@pytest.mark.parametrize("lag", [0.0, 2e-3, 0.1])
def test_a_tick_with_a_lag_is_that_of_a_matrix_exponential(lag):
    """y' = w, w' = b, lag b' = u - b, with u held; the integral in what H reaches, and an estimate."""
    n, T, rng = 3, 0.01, np.random.default_rng(7)
    G, velocity = rng.normal(size=(n, 2 * n)), rng.normal(size=(2, 3))
    U = np.linalg.qr(rng.normal(size=(n, 2)))[0]
    H = U @ rng.normal(size=(2, 2 * n))
    tick = tick_matrix(G, H, T, lag=lag, velocity=velocity)
    reached = np.linalg.svd(H)[0][:, :2]
    y, w, b, h, e = np.split(x := rng.normal(size=4 * n + 2), np.cumsum((n, n, n, 2)))
    seen = np.stack((y, w, e))
    measured = np.concatenate((y, velocity[0] @ seen))
    u = G @ measured + reached @ h
    flow = np.zeros((4, 4))
    flow[0, 1] = flow[1, 2] = 1.0
    if lag:
        flow[2] = (0.0, 0.0, -1.0 / lag, 1.0 / lag)
    moved = expm(T * flow) @ np.stack((y, w, b if lag else u, u))
    expected = (*moved[:2], moved[2] if lag else u, h + reached.T @ H @ measured, velocity[1] @ seen)
    assert_allclose(tick @ x, np.concatenate(expected), rtol=0, atol=1e-12)


def test_sgn_has_no_linear_integral_and_check_says_the_lag(tmp_path, capsys):
    lag = loop_of(paper()).largest_lag
    assert loop_of(paper({"controller.gains.sign_gain": 5.0})).largest_lag == pytest.approx(lag)
    scenario = pushed("planar", 0.2)
    scenario.save(tmp_path / "lagging.toml")
    assert main(["check", str(tmp_path / "lagging.toml"), "--poses", "3"]) == 1
    assert "unstable (stable with lags up to" in " ".join(capsys.readouterr().out.split())
    slow = loop_of(paper({"clock.rate_hz": 25.0}))
    assert (slow.ok, slow.largest_lag) == (False, 0.0)
    assert "without any lag" in slow.summary()


def pandas_with(stiffness, **fields):
    return cp.Scenario.load("two-pandas-box", {"controller.posture.stiffness": stiffness, **fields})


def test_an_elbow_that_its_spring_does_not_hold_is_named_with_its_field():
    """Gravity pushes the elbow over: without it, or with a stiffer spring, the same gains hold it."""
    soft = loop_of(pandas_with(3.0))
    assert not soft.ok
    assert soft.mode.is_spare
    assert soft.spare_rate < 0.0
    assert {joint.partition("/")[0] for joint in soft.mode.joints} == {"left", "right"}
    assert all(word in soft.summary() for word in ("elbow", "left and right", "controller.posture.stiffness"))
    assert loop_of(pandas_with(3.0, **{"cell.gravity": [0.0, 0.0, 0.0]})).ok
    held = loop_of(pandas_with(40.0))
    assert held.ok
    assert held.spare_rate > 1.0
    planar = loop_of(pushed("planar", 0.2))
    assert (planar.mode.is_spare, planar.spare, planar.spare_rate) == (False, None, np.inf)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [3.0, 5.0])
def test_the_elbow_drifts_as_fast_as_its_mode_says(stiffness):
    """Growth of its speed over two seconds of a run at rest; started by a push of the payload."""
    push = {"kind": "wrench-pulse", "time": 0.1, "duration": 0.1, "wrench": (3.0, 5.0, 0.0, 0.0, 0.0, 0.5)}
    start = cp.Scenario.load("two-pandas-box").start.model_dump()
    still = {"motion": {"kind": "hold", "pose": start}, "events": [push], "duration": 6.0, "squeeze": {}}
    scenario = pandas_with(stiffness, **still)
    frictionless = {f"cell.arms.{arm}.friction": "none" for arm in scenario.cell.arms}
    scenario = scenario.override(frictionless)
    speed = np.linalg.norm(
        np.nan_to_num(cp.run(scenario, warn=False).data.joint_velocity.values), axis=(1, 2)
    )
    growth = np.log(speed[-1] / speed[-1001]) / 2.0
    assert_allclose(growth, -loop_of(scenario).spare_rate, rtol=0.2)


def test_the_joints_are_those_of_the_worst_mode_the_fastest_first(monkeypatch):
    """Modes by hand: the second decays worst."""
    modules = [
        importlib.import_module(f"coop_pin.stability.{name}")
        for name in ("sampled_stability", "step_stability")
    ]
    simulation, modes = Simulation(paper(), build_controller(paper())), np.eye(6)
    modes[:, 1] = (0.0, 0.4, 0.0, -1.0, 0.5, 0.2)
    D = modes @ np.diag([1.0, 90.0, 2.0, 0.0, 0.0, 0.0]) @ np.linalg.inv(modes)
    for module in modules:
        monkeypatch.setattr(module, "damping_matrix", lambda *_: D)
    names = [name for place in simulation.slots for name in place.angles.names]
    for found in (modules[0].start_stability(simulation), modules[1].step_stability(simulation)):
        assert found.joints == (names[3], names[4], names[1])
