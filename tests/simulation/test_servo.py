"""Servos: inner loops of robots against replicas and closed forms, in both engines, and laws on them."""

import copy
import itertools

import numpy as np
import pytest
from batches import require_same_samples
from cells import SCENARIOS, planar_three_arms
from law_cells import servo_cell
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag, expm
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError, ShapeError
from coop_pin.compiled.laws.support import support
from coop_pin.results.energies import energies
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.servo import JointServo

KINDS = ("velocity", "position")
CASES = list(itertools.product(SCENARIOS, KINDS))
LIMITED = {
    "velocity_bandwidth": 120.0,
    "integral_rate": 8.0,
    "position_bandwidth": 25.0,
    "velocity_feedforward": 0.7,
    "speed_limit": 0.12,
    "acceleration_limit": 1.5,
}


def inertias(scenario):
    """The diagonal of each arm's own inertia at its drives at the start."""
    simulation, values = cp.Simulation(scenario), []
    for slot in simulation.slots:
        M = cp.model.CellArm(scenario.cell, slot.name).mass_matrix(simulation.plant.q[slot.q_slice])
        inverse = np.linalg.inv(slot.drive)
        values.append(np.diag(inverse.T @ M @ inverse))
    return values


def of_arm(data, name, arm):
    """Samples of one arm, without the empty joints of a cell with unequal arms."""
    values = data[name].values[:, arm]
    return values[:, np.isfinite(values[0])]


# ---------------------------------------------------------------- the loop


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_the_servo_is_its_equations(name, kind):
    """A replica written from the page, fed with the recorded motion; one sample a tick."""
    clock = {"clock.rate_hz": 1000.0, "clock.steps_per_tick": 1, "duration": 0.1}
    scenario = servo_cell(name, kind, LIMITED, **clock, **{"actuators.gravity_compensation": {}})
    data, h, limit = cp.run(scenario, engine="pinocchio", warn=False).data, 1e-3, LIMITED["speed_limit"]
    for arm, (inertia, slot) in enumerate(
        zip(inertias(scenario), cp.Simulation(scenario).slots, strict=True)
    ):
        q = of_arm(data, "joint_position", arm) @ slot.drive.T
        v = of_arm(data, "joint_velocity", arm) @ slot.drive.T
        asked, torque = of_arm(data, "servo_command", arm), of_arm(data, "commanded_torque", arm)
        r, w, z, before = q[0], 0.0 * v[0], torque[0], q[0]
        for k, command in enumerate(asked):
            if kind == "velocity":
                target = np.clip(command, -limit, limit)
            else:
                r = r + h * w
                e, slope = before - r, (command - before) / h
                reach = np.minimum(np.abs(e) / h, np.sqrt(2.0 * LIMITED["acceleration_limit"] * np.abs(e)))
                target, before = np.clip(slope + np.sign(e) * reach, -limit, limit), command
            w = w + np.clip(target - w, -1.5 * h, 1.5 * h)
            wanted = w if kind == "velocity" else np.clip(25.0 * (r - q[k]) + 0.7 * w, -limit, limit)
            push = inertia * 120.0 * (wanted - v[k])
            if k == 0:
                z = torque[0] - push  # what holds the cell at rest
            assert_allclose(push + z, torque[k], rtol=0, atol=1e-9 * np.abs(torque).max())
            z = z + h * 8.0 * push
        assert np.abs(w).max() > 0.02
        assert np.abs(asked[-1] - asked[0]).max() > 1e-4
    compensated = of_arm(data, "requested_torque", 0) - of_arm(data, "commanded_torque", 0)
    assert name == "planar" or np.abs(compensated).max() > 10.0


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_samples_within_a_tick_are_those_of_ticks_of_their_own(name, kind):
    """Five samples a tick of commands that are held, or on a line, are one sample a tick of five ticks."""
    fast = {"clock.rate_hz": 1000.0, "clock.steps_per_tick": 1}
    ends = []
    for clock, per_tick in (({}, 5), (fast, 1)):
        scenario = servo_cell(name, kind, LIMITED, duration=0.05, **clock)
        simulation = cp.Simulation(scenario)
        rest = [np.array(one.q) for one in simulation.observe().measurements]
        while not simulation.is_finished:
            number = simulation.ticks_done * per_tick // 5
            share = 1.0 if per_tick == 5 else (simulation.ticks_done % 5 + 1) / 5
            shapes = [np.linspace(0.02, 0.05, len(q)) for q in rest]
            if kind == "velocity":
                command = {"velocities": [np.sin(number) * shape for shape in shapes]}
            else:
                now = 0.01 * (np.sin(number) + share * (np.sin(number + 1) - np.sin(number)))
                command = {"positions": [q + now * shape for q, shape in zip(rest, shapes, strict=True)]}
            simulation.step(cp.CellCommand(**command))
        ends.append(simulation.plant.state())
    assert_allclose(ends[0].q, ends[1].q, rtol=0, atol=1e-12)
    assert_allclose(ends[0].work, ends[1].work, rtol=0, atol=1e-9)
    assert np.abs(ends[0].v).max() > 1e-4


def test_a_position_far_away_is_reached_by_speeding_up_and_braking_at_the_acceleration_limit():
    """Over d with a: the peak sqrt(a d) at half time, at rest after 2 sqrt(d / a).

    Braking is half a sample late, which leaves it h / 2 of the peak too far.
    """
    d, a, h = np.array((0.5, -2.0)), np.array((2.0, 5.0)), 1e-3
    servo = cp.actuators.Servo(command="position", rate_hz=1e3, acceleration_limit=tuple(a))
    loop, speeds, way = JointServo.of(servo, 0.01, np.ones(2), "servo"), [], []
    state = loop.start(np.zeros(2), np.zeros(2))
    for _ in range(2):  # the way from one command to the next is over
        state = loop.received(state, d, 0.0)
    for _ in range(1400):
        speeds.append(state.speed)
        way.append(state.reference)
        motion = state.reference, state.speed
        _, state = loop.sample(state, motion, np.zeros_like, lambda tau: (tau, tau, tau > np.inf, 0.0 * tau))
    speeds, way, size = np.array(speeds), np.array(way), np.abs(d)
    assert_allclose(np.abs(speeds).max(axis=0), np.sqrt(a * size), rtol=5e-3)
    assert_allclose(np.abs(speeds).argmax(axis=0) * h, np.sqrt(size / a), rtol=1e-2)
    assert_allclose(np.abs(way).max(axis=0) - size, 0.5 * h * np.sqrt(a * size), rtol=5e-3)
    done = np.round(2.0 * np.sqrt(size / a) / h).astype(int) + 60
    assert_allclose(way[done, [0, 1]], d, atol=1e-4)
    assert_allclose(speeds[done, [0, 1]], 0.0, atol=5e-3)


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_the_energy_balance_includes_the_servo(name, kind):
    data = cp.run(servo_cell(name, kind, {**LIMITED, "rate_hz": 1000.0}), engine="pinocchio", warn=False).data
    energy, works = energies(data)
    gained, done = energy - energy[0], sum(works) - sum(works)[0]
    assert np.abs(done).max() > 1e-4
    assert_allclose(gained, done, rtol=0, atol=1e-7 * np.abs(data.kinetic_energy.values).max() + 1e-9)


# ---------------------------------------------------------------- both engines


@pytest.mark.parametrize(
    ("name", "kind"),
    [pytest.param(*case, marks=[] if case in CASES[::3] else [pytest.mark.slow]) for case in CASES],
)
def test_batches_have_the_servos_of_single_runs(name, kind):
    """Servos of two rates with delay, watchdog, exact feed-forward, lag of the drives and missed ticks."""
    other = {"rate_hz": 400.0, "command": kind, "exact_feedforward": True, "watchdog": 0.011, "delay": 2}
    changes = {
        "duration": 0.06,
        "clock.steps_per_tick": 10,
        "actuators.missed_ticks": 0.3,
        "actuators.gravity_compensation": {"mass_error": 0.1},
        "arm_actuators": {"right": {"servo": other, "lag": 0.002, "commands_lost_at": 0.0431}},
    }
    base = servo_cell(name, kind, LIMITED, **changes)
    scenarios = [base, base.replace(seed=3), base.override({"actuators.servo.velocity_bandwidth": 60.0})]
    assert support(base) is None
    batch = cp.compiled.simulate_batch(scenarios)
    assert batch.is_valid.all()
    for index, scenario in enumerate(scenarios):
        require_same_samples(batch.result(index).data, cp.run(scenario, engine="pinocchio", warn=False).data)


@pytest.mark.parametrize(
    ("name", "rate_hz", "beside"),
    by_default(
        [
            *(("planar", 200.0, 2e-9), ("spatial", 1000.0, 2e-9)),
            *(
                pytest.param(*others, marks=pytest.mark.gate)
                for others in (
                    *(("planar", 1000.0, -2e-9), ("spatial", 200.0, -2e-9)),
                    *(("planar", 200.0, -2e-9), ("planar", 1000.0, 2e-9)),
                    *(("spatial", 200.0, 2e-9), ("spatial", 1000.0, -2e-9)),
                )
            ),
        ],
        ("planar", 200.0, 2e-09),
    ),
)
def test_an_event_some_nanoseconds_beside_a_tick_is_no_sample_of_a_servo(name, rate_hz, beside):
    """With one sample a tick, and with five of which one comes a plant step after the event."""
    mass = 1.3 * servo_cell(name, "velocity").cell.payload.mass
    event = {"kind": "payload-change", "time": 0.02 + beside, "mass": mass}
    changes = {"duration": 0.04, "events": [event], "actuators.servo.rate_hz": rate_hz}
    scenario = servo_cell(name, "velocity", LIMITED).override(changes)
    batch = cp.compiled.simulate_batch([scenario])
    require_same_samples(batch.result(0).data, cp.run(scenario, engine="pinocchio", warn=False).data)


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_goes_on_from_its_state_with_the_same_bits(kind):
    simulation = cp.Simulation(
        servo := servo_cell("spatial", kind, {"delay": 1}, duration=0.05), build_controller(servo)
    )
    for _ in range(4):
        simulation.tick()
    twin = copy.deepcopy(simulation)
    for _ in range(4):
        simulation.tick()
        twin.tick()
    assert_array_equal(simulation.plant.q, twin.plant.q)
    assert_array_equal(
        np.concatenate(simulation.actuation.state.held), np.concatenate(twin.actuation.state.held)
    )


# ---------------------------------------------------------------- late and lost commands


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_watchdog_brakes_an_arm_without_commands(name):
    servo = {"watchdog": 0.02, "acceleration_limit": 3.0}
    lost = {"commands_lost_at": 0.1, "gravity_compensation": {}}
    scenario = servo_cell(
        name, "velocity", servo, **{"actuators": {"servo": {"command": "velocity", **servo}, **lost}}
    )
    speeds = np.nanmax(
        np.abs(cp.run(scenario, engine="pinocchio", warn=False).data.drive_velocity.values), axis=(1, 2)
    )
    without = {"actuators.servo.watchdog": None}
    on = np.nanmax(
        np.abs(cp.run(scenario.override(without), engine="pinocchio", warn=False).data.drive_velocity.values),
        axis=(1, 2),
    )
    assert on[-1] > 0.5 * on[24]
    assert speeds[-1] < 0.02 * on[-1]


# ---------------------------------------------------------------- refusals


def test_an_arm_takes_what_its_scenario_says():
    torque, servo = SCENARIOS["planar"](), servo_cell("planar", "velocity")
    for scenario, change in (
        (torque, {"actuators.servo": "ur-position"}),
        (torque, {"arm_actuators": {"right": {"servo": {"command": "velocity"}}}}),
        (servo, {"controller.command": "position"}),
    ):
        with pytest.raises(FieldError, match=r"take .*commands") as caught:
            scenario.override({"clock.rate_hz": 100.0, "clock.steps_per_tick": 10, **change})
        assert caught.value.path.endswith("servo")
    for controller in (torque.controller, cp.laws.Admittance(command="position")):
        with pytest.raises(FieldError, match="servo"):
            cp.Simulation(
                servo,
                build_controller(
                    torque if controller is torque.controller else servo_cell("planar", "position")
                ),
            )
    simulation = cp.Simulation(servo)
    with pytest.raises(ArgumentError, match="velocity"):
        simulation.step(cp.CellCommand(velocities=[np.zeros(3), None]))
    with pytest.raises(ArgumentError, match="velocity"):
        simulation.step(cp.CellCommand([np.zeros(3), np.zeros(3)], None))
    with pytest.raises(ShapeError, match="velocity"):
        simulation.step(cp.CellCommand(velocities=[np.zeros(3), np.zeros(4)]))


def test_the_rate_of_a_servo_fits_the_clock():
    for change, path in (
        ({"actuators.servo.rate_hz": 700.0}, "actuators.servo.rate_hz"),
        ({"clock.steps_per_tick": 4}, "actuators.servo.rate_hz"),
        ({"actuators.servo": "ur-3"}, "actuators.servo"),
        ({"actuators.servo.position_bandwidth": (1.0, 2.0)}, "actuators.servo.position_bandwidth"),
    ):
        with pytest.raises(FieldError) as caught:
            cp.Simulation(servo_cell("planar", "velocity").override(change))
        assert caught.value.path == path


def test_analyses_of_torques_say_that_they_do_not_know_servos():
    scenario = servo_cell("spatial", "velocity")
    for analysis in (cp.stability.sampled_stability, cp.stability.steady_errors):
        with pytest.raises(ArgumentError, match=r"servo|take"):
            analysis(scenario)


@pytest.mark.parametrize("cell", by_default(SCENARIOS, "planar"))
def test_a_push_dies_away_with_the_slow_eigenvalues_of_the_loop_with_servos(cell):
    """What the law keeps without a wrench, the offset of each drive's motion, is at 1."""
    scenario = servo_cell(cell, "velocity", duration=1.0)
    scenario = scenario.replace(motion=cp.motions.HoldMotion(pose=scenario.start))
    loop = cp.stability.eigenvalues(scenario, time=0.1)
    assert loop.ok
    assert len(loop.structural) == sum(map(len, inertias(scenario)))
    push = cp.events.WrenchPulse(time=0.2, duration=0.005, wrench=(0.05, 0.025, 0.0, 0.0, 0.0, 0.005))
    runs = [cp.run(scenario.replace(events=events), warn=False).data for events in ((push,), ())]
    apart = np.linalg.norm((runs[0].velocity - runs[1].velocity).values, axis=1)
    decay = (apart[190] / apart[140]) ** (1.0 / 50.0)
    slow = np.abs(loop.z)[np.abs(loop.z) > 0.9]
    assert slow.min() - 2e-5 < decay < slow.max() + 2e-5
    assert slow.max() - slow.min() < 2e-3


def test_commands_unpack_as_before():
    torque, state = cp.ArmCommand(np.ones(2), 3)
    assert (torque.tolist(), state) == ([1.0, 1.0], 3)
    torques, state = cp.CellCommand([torque, torque], 4)
    assert (len(torques), state) == (2, 4)


# ---------------------------------------------------------------- laws on servos, against closed forms


@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_without_error_the_motion_tends_to_the_prescribed_one_as_the_bandwidth_rises(name):
    """P on position is late by V_d / k_p: 15, 3.7 and 0.93 um, with the servo's rate raised alike."""
    start = SCENARIOS[name]().start
    goal = start.replace(xyz=np.add(start.xyz, (4e-4, -2e-4, 0.0)), rpy=np.add(start.rpy, (0.0, 0.0, 8e-4)))
    errors = []
    for bandwidth in (250.0, 1000.0, 4000.0):
        n = round(0.04 * bandwidth)
        servo = {"rate_hz": 200.0 * n, "position_bandwidth": bandwidth, "velocity_feedforward": 0.0}
        scenario = servo_cell(
            name,
            "position",
            servo | {"velocity_bandwidth": 4.0 * bandwidth},
            **{"clock.steps_per_tick": n, "duration": 0.2, "squeeze": {}},
            motion=cp.motions.LineMotion(start=start, goal=goal, duration=0.4),
        )
        data, rows = (
            cp.run(scenario, engine="compiled" if n > 100 else "pinocchio", warn=False).data,
            [0, 1, 5],
        )
        error, V_d = (data[key].values[-1][rows] for key in ("pose_error", "desired_twist"))
        assert_allclose(error, -V_d / bandwidth, rtol=0.01)
        errors.append(np.abs(error).max())
    assert errors[-1] < 1e-6


def series_stiffness(scenario, gain):
    """(sum_i (J_i^-T I_i gain J_i^-1)^-1 + compliance of the grasp i)^-1 about P in world axes, task rows."""
    compliance, chosen = 0.0, list(scenario.cell.task_rows.indices)
    simulation = cp.Simulation(scenario)
    for slot, inertia in zip(simulation.slots, inertias(scenario), strict=True):
        arm = cp.model.CellArm(scenario.cell, slot.name)
        J = arm.task_jacobian(simulation.plant.q[slot.q_slice])
        compliance = compliance + J @ np.diag(1.0 / (inertia * gain)) @ J.T
        if slot.name in scenario.cell.compliant:
            grasp, R_WP = scenario.cell.grasps[slot.name], scenario.start.matrix[:3, :3]
            R, (x, y, z) = R_WP @ grasp.matrix[:3, :3], R_WP @ grasp.matrix[:3, 3]
            turned, shift = np.kron(np.eye(2), R), np.eye(6)
            shift[:3, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]  # V_P = V_E + r x w
            C = shift @ turned @ np.diag(1.0 / np.array(grasp.stiffness)) @ turned.T @ shift.T
            compliance = compliance + C[np.ix_(chosen, chosen)]
    return np.linalg.inv(compliance)


def view_error(scenario):
    """By how much the second arm's view of the payload differs from the first's at the start."""
    views = [one.payload_pose for one in cp.Simulation(scenario).observe().measurements]
    return scenario.cell.task_rows.pose_error(views[1], views[0])


BIAS = "cell.arms.right.calibration_error.tip.xyz"


@pytest.mark.parametrize("grasps", ["rigid", "compliant"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_stiff_pair_pulls_with_the_stiffness_of_its_servos(name, grasps):
    """1 mm at one tip: planar 192 N rigid, 84 N with grasps of 300 kN/m; spatial 13.3 N and 10.1 N."""
    base = SCENARIOS[name]()
    arms = {f"cell.arms.{arm}.torque_limits": "none" for arm in base.cell.arms}
    changes = {"squeeze": {}, "duration": 0.3, "motion": cp.motions.HoldMotion(pose=base.start), **arms}
    if grasps == "compliant":
        changes["clock.steps_per_tick"] = 40
        for arm in base.cell.arms:
            changes |= {f"cell.grasps.{arm}.kind": "compliant", f"cell.grasps.{arm}.stiffness": "paper"}
    bandwidths = {"velocity_bandwidth": 300.0, "position_bandwidth": 60.0}
    true = servo_cell(name, "position", bandwidths, **changes)
    off, rows = true.override({BIAS: [1e-3, 0.0, 0.0]}), true.cell.task_rows
    forces = [
        rows.select(cp.run(one, warn=False).data.interaction_wrench.values[-1, 1]) for one in (true, off)
    ]
    b = view_error(off) - view_error(true)
    expected = series_stiffness(true, 300.0 * 60.0) @ b
    linear = slice(0, 2) if name == "planar" else slice(0, 3)
    pull, closed = (forces[1] - forces[0])[linear], expected[linear]
    assert np.linalg.norm(pull - closed) < 0.02 * np.linalg.norm(closed)
    figures = {"planar": (192.0, 84.0), "spatial": (13.3, 10.1)}[name]
    assert_allclose(np.linalg.norm(pull), figures[grasps == "compliant"], rtol=0.01)


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_servos_that_integrate_pull_apart_without_end(name, kind):
    """What no motion can remove: f' = k_i B_s gamma b by velocities, k_i S b by positions, S = k_p B_s."""
    base = SCENARIOS[name]()
    arms = {f"cell.arms.{arm}.torque_limits": "none" for arm in base.cell.arms}
    changes = {"squeeze": {}, "motion": cp.motions.HoldMotion(pose=base.start), "duration": 1.0, **arms}
    servo = {"velocity_bandwidth": 200.0, "integral_rate": 5.0, "position_bandwidth": 40.0}
    scenario = servo_cell(name, kind, servo, **changes, **{BIAS: [5e-4, 0.0, 0.0]})
    data, rows = cp.run(scenario, warn=False).data, scenario.cell.task_rows
    f = rows.select(data.internal_wrench.values[:, 1].T).T
    rate = 5.0 * (scenario.controller.gains.pose_gain if kind == "velocity" else 40.0)
    expected = series_stiffness(scenario, 200.0 * rate) @ view_error(scenario)
    growth = (f[-1] - f[100]) / 0.5
    linear = slice(0, 2) if name == "planar" else slice(0, 3)
    assert np.linalg.norm((growth - expected)[linear]) < 0.02 * np.linalg.norm(expected[linear])


def pair_of_ur5(wrist, bias, **changes):
    """Two UR5 with friction carry 5 kg along 0.11 m, turning by 0.14 rad, in 3 s; velocities at 500 Hz."""
    base = SCENARIOS["spatial"]()
    goal = base.start.replace(
        xyz=np.add(base.start.xyz, (0.0, 0.05, 0.1)), rpy=np.add(base.start.rpy, (0.1, 0.0, 0.1))
    )
    damping = (1000.0, 1000.0, 1000.0, 20.0, 20.0, 20.0)
    gains = {"admittance_damping": damping, "pose_gain": 5.0, "admittance_rate": 20.0}
    return base.override(
        {
            "duration": 6.0,
            "events": [],
            "cell.payload.mass": 5.0,
            "clock.rate_hz": 500.0,
            "clock.steps_per_tick": 1,
            "motion": cp.motions.LineMotion(start=base.start, goal=goal, duration=3.0, start_time=0.5),
            "controller": {"kind": "admittance", "gains": gains},
            "controller.force_path": {"kind": "late" if wrist else "none"},
            "actuators": {"servo": {"command": "velocity", "rate_hz": 500.0, "integral_rate": 20.0}},
            "actuators.gravity_compensation": {},
            "sensors.wrist": {"noise": {"force": 0.5, "moment": 0.02}} if wrist else None,
            BIAS: [bias, 0.0, 0.0],
            **changes,
        }
    )


def force_error(data):
    """Size of the error of the internal force on the first arm at each tick, N."""
    error = data.internal_wrench.values - data.desired_internal_wrench.values
    return np.linalg.norm(error[:, 0, :3], axis=1)


def test_two_ur5_with_wrist_sensors_carry_5_kg():
    """0.37 N at most from 1 s on under 0.5 mm of bias: while moving and after."""
    error = force_error(cp.run(pair_of_ur5(True, 5e-4), engine="compiled", warn=False).data)
    assert_allclose(error[500:].max(), 0.373, atol=0.02)
    assert error[-500:].mean() < 0.15


@pytest.mark.slow
def test_two_ur5_without_wrist_sensors_pull_apart():
    """0.5 mm of bias: 22.6 N after 6 s, growing by 3.7 N/s; 5.5 N without bias."""
    blind = {
        bias: force_error(cp.run(pair_of_ur5(False, bias), engine="compiled", warn=False).data)
        for bias in (0.0, 5e-4)
    }
    assert_allclose([blind[0.0][-1], blind[5e-4][-1]], [5.5, 22.6], rtol=0.02)
    b = view_error(pair_of_ur5(False, 5e-4))
    rate = np.linalg.norm((series_stiffness(pair_of_ur5(False, 0.0), 2000.0) @ (5.0 * b))[:3])
    assert_allclose(rate, 3.69, rtol=0.01)
    assert_allclose((blind[5e-4][-1] - blind[5e-4][-501]) / 1.0, rate, rtol=0.1)


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_a_follower_of_the_leader_s_pose_pulls_with_its_whole_stiffness(name):
    """f = S_2 b, not the series of both: it follows the pose that its own pull shifts."""
    base = SCENARIOS[name]()
    arms = {f"cell.arms.{arm}.torque_limits": "none" for arm in base.cell.arms}
    changes = {"squeeze": {}, "motion": cp.motions.HoldMotion(pose=base.start), "duration": 8.0, **arms}
    servo = {"position_bandwidth": 60.0, "velocity_bandwidth": 300.0, "velocity_feedforward": 0.5}
    law = cp.laws.Admittance(command="position", follows="leader")
    true = servo_cell(name, "position", servo, controller=law, **changes)
    off, rows = true.override({BIAS: [2e-5, 0.0, 0.0]}), true.cell.task_rows
    ends = [
        rows.select(cp.run(one, engine="compiled", warn=False).data.interaction_wrench.values[-1, 1])
        for one in (true, off)
    ]
    slot, inertia = cp.Simulation(true).slots[1], inertias(true)[1]
    J = cp.model.CellArm(true.cell, "right").task_jacobian(cp.Simulation(true).plant.q[slot.q_slice])
    b = view_error(off) - view_error(true)
    S_2 = np.linalg.inv(J @ np.diag(1.0 / (inertia * 18e3)) @ J.T)
    assert_allclose(ends[1] - ends[0], S_2 @ b, rtol=0, atol=0.02 * np.linalg.norm(S_2 @ b))
    series = np.linalg.norm(series_stiffness(true, 18e3) @ b)
    assert np.linalg.norm(S_2 @ b) > (2.0 if name == "planar" else 8.0) * series
    assert "poses of all arms" in law.needs
    assert "poses of all arms" not in cp.laws.Admittance().needs


def yielding_pair(name, damping, **changes):
    """A still test cell under 1 mm of bias whose P servos take velocities of an admittance with damping D."""
    base = SCENARIOS[name]()
    arms = {f"cell.arms.{arm}.torque_limits": "none" for arm in base.cell.arms}
    law = {"kind": "admittance", "force_path": {"kind": "late"}, "gains": {"admittance_damping": damping}}
    # Without weight: its moment about a point that is seen 1 mm off counts as an internal one.
    weightless = {"cell.gravity": (0.0, 0.0, 0.0)}
    still = {"motion": cp.motions.HoldMotion(pose=base.start), "controller": law, "squeeze": {}} | weightless
    changes = {BIAS: [1e-3, 0.0, 0.0]} | still | arms | changes
    return servo_cell(name, "velocity", {"velocity_bandwidth": 40.0}, **changes)


def internal_forces(scenario):
    """Internal wrench of the second arm in task rows at each tick."""
    data = cp.run(scenario, warn=False).data
    return scenario.cell.task_rows.select(data.internal_wrench.values[:, 1].T).T


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_admittance_lets_a_bias_go_at_its_rate(name):
    """f' = -gamma (1 + 2 B_s / D)^-1 2 B_s / D f, with D twice the largest 2 B_s."""
    B_s = series_stiffness(yielding_pair(name, 1e4), 40.0)
    unit = B_s.diagonal()
    D = 2.0 * np.linalg.eigvals(2.0 * B_s / unit).real.max() * unit
    f, G = internal_forces(yielding_pair(name, D.tolist(), duration=1.0)), 2.0 * B_s / D
    expected = expm(-2.0 * 0.5 * np.linalg.solve(np.eye(len(G)) + G, G)) @ f[100]
    assert_allclose(f[200], expected, rtol=0, atol=0.02 * np.abs(f[100]).max())
    assert np.abs(f[200]).max() < 0.9 * np.abs(f[100]).max()


def changes_of_force(scenario, part):
    """Largest change of an internal wrench in a tick, early and late in a run, at a part of the least."""
    damping = np.array(scenario.controller.gains.admittance_damping)
    damping = part * cp.stability.admittance_stability(scenario).least * damping
    run = scenario.override({"controller.gains.admittance_damping": damping.tolist()})
    f = run.cell.task_rows.select(cp.run(run, warn=False).data.internal_wrench.values[:, 1].T)
    early, *_, late = np.array_split(np.abs(np.diff(f)), 5, axis=1)
    return early.max(), late.max()


ADMITTANCES = {
    "two": lambda name: yielding_pair(name, np.ones(len(rows_of(name))).tolist(), duration=0.8),
    "three": lambda name: three_arms(name).override({"controller.force_path.kind": "late", "duration": 0.6}),
    "a line": lambda name: three_arms(name).override({"network": {"delay": 1, "graph": line_of(name)}}),
}


def rows_of(name):
    return SCENARIOS[name]().cell.task_rows.indices


def line_of(name):
    one, two, three = three_arms(name).cell.arms
    return [[one, two], [two, one], [two, three], [three, two]]


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize(
    "arms", [pytest.param(arms, marks=[pytest.mark.slow] * (arms != "two")) for arms in ADMITTANCES]
)
def test_an_admittance_grows_below_its_least_damping_and_decays_above(name, arms):
    """Of arms that are not alike; by the rule of equal ones the pairs could have a third and a half of it."""
    scenario = ADMITTANCES[arms](name)
    below, above = (changes_of_force(scenario, part) for part in (0.97, 1.03))
    assert above[1] < 0.2 * above[0]
    assert below[1] > 3.0 * below[0]


@pytest.mark.parametrize(
    "path",
    [{"kind": "late", "delay": 2}, pytest.param({"kind": "low-pass", "pole": 0.4}, marks=pytest.mark.gate)],
)
@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_the_radius_of_an_admittance_is_that_of_the_linearised_tick(name, path):
    """With springs to the reference, an integral in the servos, and messages that come late or filtered."""
    damping = np.where(np.array(rows_of(name)) < 3, 3000.0, 60.0)
    gains = {"controller.gains.admittance_stiffness": (0.5 * damping).tolist()}
    still = gains | {"controller.force_path": path, "actuators.servo.integral_rate": 5.0}
    scenario = yielding_pair(name, damping.tolist(), **{BIAS: [0.0, 0.0, 0.0]}).override(still)
    scenario = scenario.override({f"cell.arms.{arm}.friction": "none" for arm in scenario.cell.arms})
    found = cp.stability.admittance_stability(scenario)
    assert_allclose(found.radius, cp.stability.eigenvalues(scenario).radius, rtol=0, atol=1e-9)
    edge = scenario.override({"controller.gains.admittance_damping": (found.least * damping).tolist()})
    assert_allclose(cp.stability.eigenvalues(edge).radius, 1.0, rtol=0, atol=1e-6)


def test_what_the_least_damping_is_not_known_of_is_refused():
    pair = yielding_pair("planar", 1e3)
    for other, reason in (
        (SCENARIOS["planar"](), "no admittance"),
        (servo_cell("planar", "position"), "no admittance"),
        (servo_cell("planar", "velocity"), "no wrench"),
        (pair.override({"actuators.servo.delay": 1}), "without delay"),
        (pair.override({"arm_actuators": {"right": {"servo": {"command": "velocity"}}}}), None),
    ):
        if reason is None:
            assert cp.stability.admittance_stability(other).radius > 0.0
            continue
        with pytest.raises(ArgumentError, match=reason):
            cp.stability.admittance_stability(other)


@pytest.mark.parametrize("name", SCENARIOS)
def test_exact_feed_forward_takes_the_inertia_off_the_servo(name):
    """Without payload to speak of, what P on velocity leaves is the arms' inertia: M a / (I k_v)."""
    light = {"cell.payload.mass": 1e-3, "cell.payload.inertia": (1e-6, 1e-6, 1e-6, 0.0, 0.0, 0.0)}
    changes = {"squeeze": {}, "actuators.gravity_compensation": {}, **light}
    servo = {"position_bandwidth": 100.0, "velocity_bandwidth": 200.0, "rate_hz": 1000.0}
    errors = []
    for exact in (False, True):
        scenario = servo_cell(name, "position", servo | {"exact_feedforward": exact}, **changes)
        data = cp.run(scenario, warn=False).data
        errors.append(np.abs(data.pose_error.values[20:]).max(axis=0))
    assert errors[1].max() < 0.3 * errors[0].max()


# ---------------------------------------------------------------- exchanged wrenches


def three_arms(name):
    """Three arms of unequal shares at one payload, still, without weight, 0.5 mm of bias at the first tip."""
    if name == "planar":
        base = planar_three_arms("adept-anchored")
    else:
        base = cp.Scenario.load("three-ur5-plate")
        base = base.override({"cell.load_shares": dict(zip(base.cell.arms, (0.2, 0.3, 0.5), strict=True))})
    first, *_ = arms = list(base.cell.arms)
    free = {f"cell.arms.{arm}.{name}": "none" for arm in arms for name in ("friction", "torque_limits")}
    damping = np.where(np.array(base.cell.task_rows.indices) < 3, 3000.0, 60.0).tolist()
    gains = {"admittance_damping": damping, "pose_gain": 5.0}
    return base.override(
        {
            "duration": 1.0,
            "events": [],
            "cell.gravity": (0.0, 0.0, 0.0),
            "squeeze": {},
            "motion": cp.motions.HoldMotion(pose=base.start),
            "clock.rate_hz": 200.0,
            "clock.steps_per_tick": 4,
            "actuators.servo": {"command": "velocity", "rate_hz": 200.0, "velocity_bandwidth": 50.0},
            "controller": {"kind": "admittance", "gains": gains},
            "sensors.wrist": {},
            f"cell.arms.{first}.calibration_error.tip.xyz": [5e-4, 0.0, 0.0],
            **free,
        }
    )


def wrenches(scenario):
    """Interaction wrenches of all arms in task rows at each tick, shape (ticks, m, k_0)."""
    data = cp.run(scenario, warn=False).data
    return data.interaction_wrench.values[..., list(scenario.cell.task_rows.indices)]


@pytest.mark.slow
@pytest.mark.parametrize("follows", ["reference", "leader"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_three_unequal_arms_pull_with_the_stiffness_of_their_servos(name, follows):
    """f_i = S_i (b_i - x), x = (sum S_j)^-1 sum S_j b_j; followers of a leader f_i = S_i (b_i - b_1), 2 %."""
    law = {"kind": "admittance", "command": "position", "follows": follows}
    servo = {"command": "position", "rate_hz": 200.0, "velocity_bandwidth": 100.0, "position_bandwidth": 20.0}
    servo |= {"velocity_feedforward": 0.5}
    stiff = {"controller": law, "actuators.servo": servo, "sensors.wrist": None, "duration": 8.0}
    first, *_ = three_arms(name).cell.arms
    tip = f"cell.arms.{first}.calibration_error.tip.xyz"
    b_x = 5e-4 if follows == "reference" else 2e-5  # a leader's pose moves by as much as it is pulled
    off, true = (three_arms(name).override(stiff | {tip: [b, 0.0, 0.0]}) for b in (b_x, 0.0))
    rows, simulation, S = off.cell.task_rows, cp.Simulation(true), []
    for slot, inertia in zip(simulation.slots, inertias(true), strict=True):
        J = cp.model.CellArm(true.cell, slot.name).task_jacobian(simulation.plant.q[slot.q_slice])
        S.append(np.linalg.inv(J @ np.diag(1.0 / (inertia * 2000.0)) @ J.T))
    views = [[one.payload_pose for one in cp.Simulation(each).observe().measurements] for each in (off, true)]
    b = [rows.pose_error(seen, exact) for seen, exact in zip(*views, strict=True)]
    rest = np.linalg.solve(sum(S), sum(S_i @ b_i for S_i, b_i in zip(S, b, strict=True)))
    goal = rest if follows == "reference" else b[0]
    pulls = np.array([S_i @ (b_i - goal) for S_i, b_i in zip(S, b, strict=True)])
    pulls[0] = -pulls[1:].sum(axis=0)
    found = wrenches(off)[-1] - wrenches(true)[-1]
    assert_allclose(found, pulls, rtol=0, atol=0.02 * np.abs(pulls).max())


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_where_all_hear_all_it_is_the_law_of_the_measured_internal_wrench(name):
    base = three_arms(name).replace(duration=0.4)
    by_path, by_messages = (
        wrenches(base.override(change))
        for change in ({"controller.force_path.kind": "late"}, {"network": {}})
    )
    assert_allclose(by_messages, by_path, rtol=0, atol=1e-10)
    blind = wrenches(base.override({"sensors.wrist": None}))
    assert np.abs(by_path - blind).max() > 0.05


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_over_a_line_of_arms_a_bias_goes_at_the_rate_of_its_graph(name):
    """F' = gamma (1 - B D^-1 L)^-1 B D^-1 L F with the Laplacian L weighted by shares."""
    base = three_arms(name)
    arms, shares = list(base.cell.arms), base.cell.shares
    edges = [(0, 1), (1, 0), (1, 2), (2, 1)]
    scenario = base.override({"network.graph": [[arms[i], arms[j]] for i, j in edges]})
    F, k = wrenches(scenario), base.cell.task_rows.size
    laplacian, blocks = np.zeros((3, 3)), []
    for i, j in edges:
        laplacian[i, i] += shares[j]
        laplacian[i, j] -= shares[i]
    simulation = cp.Simulation(base)
    for slot, inertia in zip(simulation.slots, inertias(base), strict=True):
        J_inverse = np.linalg.inv(
            cp.model.CellArm(base.cell, slot.name).task_jacobian(simulation.plant.q[slot.q_slice])
        )
        blocks.append(J_inverse.T @ np.diag(50.0 * inertia) @ J_inverse)
    row = np.hstack(blocks)
    B = np.vstack([block @ np.linalg.solve(sum(blocks), row) for block in blocks]) - block_diag(*blocks)
    D_inverse = np.diag(np.tile(1.0 / np.array(base.controller.gains.admittance_damping), 3))
    loop = B @ D_inverse @ np.kron(laplacian, np.eye(k))
    rate = 5.0 * np.linalg.solve(np.eye(3 * k) - loop, loop)
    expected = expm(rate * 0.5) @ F[100].ravel()
    assert_allclose(F[200].ravel(), expected, rtol=0, atol=0.02 * np.abs(F[100]).max())
    assert np.abs(F[200]).max() < 0.9 * np.abs(F[100]).max()
    late = wrenches(scenario.override({"network.delay": 3, "network.loss": 0.1, "duration": 2.0}))
    blind = wrenches(base.override({"sensors.wrist": None}))
    assert np.abs(late[-1]).max() < 0.6 * np.abs(blind[-1]).max()


class Mixed(cp.CellController):
    """The first arm by torques, about what holds it; the second by positions."""

    def __init__(self, scenario):
        self.first, self.second = scenario.cell.arms

    def commands_of(self, arm):
        return "torque" if arm == self.first else "position"

    def init(self, measurements, references):
        return measurements[0].holding_torque, measurements[0].q, measurements[1].q

    def step(self, measurements, references, state):
        torque, q_0, q_1 = state
        pull = torque - 200.0 * (measurements[0].q - q_0) - 20.0 * measurements[0].v
        goal = q_1 + 0.01 * np.sin(20.0 * measurements[1].time)
        return cp.CellCommand([pull, None], state, positions=[None, goal])


@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_arms_of_one_cell_take_different_commands(name):
    second = list(SCENARIOS[name]().cell.arms)[1]
    servo = {"command": "position", "rate_hz": 400.0, "position_bandwidth": 50.0}
    changes = {"actuators.servo": None, "arm_actuators": {second: {"servo": servo}}, "duration": 0.1}
    law = {"controller": cp.UserController(target=f"{__name__}:Mixed")}
    clock = {"clock.rate_hz": 200.0, "clock.steps_per_tick": 4}
    scenario = SCENARIOS[name]().override({"events": [], **clock, **law, **changes})
    single = cp.run(scenario, engine="pinocchio", warn=False).data
    require_same_samples(cp.compiled.simulate_batch([scenario]).result(0).data, single)
    commands = single.servo_command.values
    assert np.isnan(commands[:, 0]).all()
    assert np.nanmax(np.abs(commands[:, 1] - commands[0, 1])) > 0.005
    assert np.nanmax(np.abs(single.drive_velocity.values)) > 0.01
    with pytest.raises(FieldError, match="'torque'"):
        cp.run(scenario.override({f"arm_actuators.{second}.servo": None}), warn=False)


@pytest.mark.slow
def test_two_ur5_that_take_velocities_stand_in_the_catalogue():
    """Under 0.5 mm: 0.30 N while moving with wrists; without 19.6 N/s from the start pose on, as by B_s."""
    scenario = cp.Scenario.load("two-ur5-admittance")
    data = cp.run(scenario, engine="compiled", warn=False).data
    error, time = force_error(data), data.time.values
    assert error[(time > 1.0) & (time < 5.0)].max() < 0.35
    assert error[time > 7.0].mean() < 0.1
    assert np.linalg.norm(data.pose_error.values[-1, :3]) < 3e-4  # half of the bias
    blind = {"controller.force_path.kind": "none", "sensors.wrist": None, "duration": 0.9}
    blind = scenario.override({**blind, "motion": cp.motions.HoldMotion(pose=scenario.start)})
    f = cp.run(blind, warn=False).data.internal_wrench.values[:, 1, :3]
    stiffness = 100.0 * scenario.actuators.servo.integral_rate
    expected = series_stiffness(blind, stiffness) @ (5.0 * view_error(blind))
    assert_allclose((f[-1] - f[200]) / ((len(f) - 201) * 0.002), expected[:3], atol=0.02 * 19.6)
    assert_allclose(np.linalg.norm(expected[:3]), 19.6, atol=0.1)
