"""Servos: inner loops of robots against replicas and closed forms, in both engines, and laws on them."""

import copy
import itertools

import numpy as np
import pytest
from batches import require_same_samples
from cells import SCENARIOS
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.batch.support import support
from coop_pin.build_controller import build_controller
from coop_pin.errors import ArgumentError, FieldError, ShapeError

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


def servo_cell(name, kind, servo=None, **changes):
    """A test cell without friction whose arms have servos, on a line of 11 mm and 20 mrad in 0.5 s."""
    base = SCENARIOS[name]()
    start = base.start
    goal = start.replace(xyz=np.add(start.xyz, (0.01, -0.005, 0.0)), rpy=np.add(start.rpy, (0.0, 0.0, 0.02)))
    arms = {f"cell.arms.{arm}.friction": "none" for arm in base.cell.arms}
    return base.override(
        {
            "duration": 0.5,
            "events": [],
            "clock.rate_hz": 200.0,
            "clock.steps_per_tick": 5,
            "motion": cp.LineMotion(start=start, goal=goal, duration=0.5),
            "controller": cp.Admittance(command=kind),
            "actuators.servo": {"command": kind, "rate_hz": 1000.0, **(servo or {})},
            **arms,
            **changes,
        }
    )


def inertias(scenario):
    """The diagonal of each arm's own inertia at its drives at the start."""
    simulation, values = cp.Simulation(scenario), []
    for slot in simulation.plant.chain.model.arms:
        M = cp.CellArm(scenario.cell, slot.name).mass_matrix(simulation.plant.q[slot.q_slice])
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
    data, h, limit = cp.run(scenario, engine="pinocchio").data, 1e-3, LIMITED["speed_limit"]
    for arm, (inertia, slot) in enumerate(
        zip(inertias(scenario), cp.Simulation(scenario).plant.chain.model.arms, strict=True)
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


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_the_energy_balance_includes_the_servo(name, kind):
    data = cp.run(servo_cell(name, kind, {**LIMITED, "rate_hz": 1000.0}), engine="pinocchio").data
    energy, works = cp.results.quantities.energies(data)
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
    batch = cp.simulate_batch(scenarios)
    assert batch.is_valid.all()
    for index, scenario in enumerate(scenarios):
        require_same_samples(batch.result(index).data, cp.run(scenario, engine="pinocchio").data)


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
    speeds = np.nanmax(np.abs(cp.run(scenario, engine="pinocchio").data.drive_velocity.values), axis=(1, 2))
    without = {"actuators.servo.watchdog": None}
    on = np.nanmax(
        np.abs(cp.run(scenario.override(without), engine="pinocchio").data.drive_velocity.values), axis=(1, 2)
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
    for controller in (torque.controller, cp.Admittance(command="position")):
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
    with pytest.raises(ShapeError, match="velocity"):
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
    for analysis in (cp.eigenvalues, cp.sampled_stability, cp.analysis.steady_errors):
        with pytest.raises(ArgumentError, match=r"servo|take"):
            analysis(scenario)


def test_commands_unpack_as_before():
    torque, state = cp.ArmCommand(np.ones(2), 3)
    assert (torque.tolist(), state) == ([1.0, 1.0], 3)
    torques, state = cp.CellCommand([torque, torque], 4)
    assert (len(torques), state) == (2, 4)
