"""Actuators against closed forms: lag, rate limit, missed ticks, gravity compensation, loss, stiction."""

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS
from numpy.testing import assert_allclose
from scipy.integrate import quad, solve_ivp

import coop_pin as cp
from coop_pin.base.errors import FieldError, ScenarioError
from coop_pin.control import CellCommand, CellController
from coop_pin.feasibility import static_torques
from coop_pin.model.transmission import friction
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.torque_response import TorqueResponse

ACCELERATION = (0.0, -3.0, -9.81)
"""A gravity that loads the planar arms, too."""

EVERYTHING = {
    "lag": 0.004,
    "rate_limit": 900.0,
    "missed_ticks": 0.3,
    "gravity_compensation": {"mass_error": 0.05},
    "torque_lost_at": 0.1234,
}


class Given(CellController):
    """Commands as a function of the time and the holding torques; keeps them and what it saw."""

    def __init__(self, commands):
        self.commands, self.holding, self.given, self.seen = commands, None, [], []

    def init(self, measurements, references):
        self.holding = [measurement.holding_torque for measurement in measurements]

    def step(self, measurements, references, state):
        self.seen.append(measurements)
        self.given.append(self.commands(measurements[0].time, self.holding))
        return CellCommand(self.given[-1], None)


def cell_of(name, **changes):
    """A test cell under gravity, without torque limits, for a tenth of a second."""
    scenario = SCENARIOS[name]().replace(duration=0.1, events=())
    arms = {f"cell.arms.{arm}.torque_limits": "none" for arm in scenario.cell.arms}
    clock = {"clock.rate_hz": 200.0, "clock.steps_per_tick": 2}
    return scenario.override({"cell.gravity": ACCELERATION, **clock, **arms, **changes})


def stepped(_time, holding):
    """A step of 2, 3, 4 ... N m at the drives of every arm, from the holding torques."""
    return [torque + np.arange(2.0, 2.0 + len(torque)) for torque in holding]


def applied(data, arm):
    """Commanded torques, acting torques and saturation of one arm, without empty joints."""
    joints = np.isfinite(data.torque.values[0, arm])
    return [data[name].values[:, arm, joints] for name in ("commanded_torque", "torque", "saturated")]


# ---------------------------------------------------------------- lag and rate limit


@pytest.mark.parametrize("name", SCENARIOS)
def test_lag_is_a_first_order_response_from_the_holding_torque_at_any_control_rate(name):
    """tau(t) = u + (tau_0 - u) exp(-t / lag), between ticks as well: the motion is the same at 50 Hz."""
    ends = []
    for rate, steps in ((200.0, 1), (50.0, 4)):
        clock = {"clock.rate_hz": rate, "clock.steps_per_tick": 2 * steps}
        controller = Given(stepped)
        data = cp.simulate(cell_of(name, actuators={"lag": 0.03}, **clock), controller).data
        for arm, holding in enumerate(controller.holding):
            _, torque, cut = applied(data, arm)
            target = stepped(0.0, controller.holding)[arm]
            expected = target + (holding - target) * np.exp(-data.time.values / 0.03)[:, None]
            assert_allclose(torque, expected, rtol=0, atol=1e-12 * np.abs(target).max())
            assert not cut.any()
        ends.append(np.concatenate((data.configuration.values[-1], data.velocity.values[-1])))
    assert_allclose(ends[0], ends[1], rtol=0, atol=1e-12)
    assert np.abs(data.velocity.values[-1]).max() > 0.01


@pytest.mark.parametrize("name", SCENARIOS)
def test_rate_limit_is_a_ramp_that_is_told_until_it_is_done(name):
    first, arm = next(iter(SCENARIOS[name]().cell.arms.items()))
    rates, controller = np.linspace(75.0, 101.0, len(arm.posture)), Given(stepped)
    table = {"actuators": {"rate_limit": 117.0}, "arm_actuators": {first: {"rate_limit": rates.tolist()}}}
    data = cp.simulate(cell_of(name, **table), controller).data
    time = data.time.values[:, None]
    for arm, holding in enumerate(controller.holding):
        rate, step = rates if arm == 0 else 117.0, np.arange(2.0, 2.0 + len(holding))
        _, torque, cut = applied(data, arm)
        assert_allclose(torque, holding + np.minimum(rate * time, step), rtol=0, atol=1e-9)
        assert (cut == (rate * (time + 0.005) < step)).all()
        assert cut[0].all()
        assert not cut[-1].any()
        told = np.array([measurements[arm].saturated for measurements in controller.seen])
        assert not told[0].any()
        assert (told[1:] == cut[:-1]).all()


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_lagging_torque_has_no_jump_at_a_tick(name):
    """The wrench measured just before a tick is the one recorded after it: commands act only later."""
    path = {"controller.force_path.kind": "late", "actuators": {"lag": 0.02}, "clock.steps_per_tick": 1}
    scenario = cell_of(name, duration=0.05, **path)
    controller = Given(lambda time, held: [torque * (1.0 + 20.0 * time) for torque in held])
    wrench = cp.simulate(scenario, controller).data.internal_wrench.values
    for k, measurements in enumerate(controller.seen[1:], 1):
        for arm, measurement in enumerate(measurements):
            expected = scenario.cell.task_rows.select(wrench[k, arm])
            assert_allclose(measurement.internal_wrench, expected, rtol=0, atol=1e-9)
    assert np.nanmax(np.abs(wrench[-1] - wrench[1])) > 0.1


def test_the_first_lag_starts_within_the_torque_limits():
    scenario = cell_of("spatial", actuators={"lag": 0.02}).override({"cell.arms.left.torque_limits": 1.0})
    simulation = cp.Simulation(scenario, Given(stepped))
    simulation.tick()
    assert np.abs(simulation.snapshot().torque[0]).max() == 1.0
    assert simulation.snapshot().saturated[0].any()  # by the torque limits, lag or not


def test_lag_with_rate_limit_solves_its_differential_equation():
    rng = np.random.default_rng(0)
    lag, rate = np.array([0.02, 0.0, 0.02, 0.05, 0.0]), np.array([40.0, 40.0, np.inf, 100.0, np.inf])
    found = torque = rng.normal(size=5)
    response = TorqueResponse.of_drives(lag, rate)
    state = response.start(torque)
    for tick in range(6):
        target = rng.normal(scale=3.0, size=5)
        state = response.step(state, 0.03 if tick else 0.0, target)

        def slope(_s, tau, u=target):
            return np.clip((u - tau) / np.maximum(lag, 1e-5), -rate, rate)

        for s in (0.004, 0.03):
            expected = solve_ivp(slope, (0.0, s), torque, method="LSODA", rtol=1e-10, atol=1e-12).y[:, -1]
            found = response.at(state, s)
            assert_allclose(found[[0, 2, 3]], expected[[0, 2, 3]], rtol=0, atol=1e-7)
            assert_allclose(found[1], expected[1], rtol=0, atol=1e-3)  # the oracle has a short lag
            assert found[4] == target[4]
            exact = [quad(lambda t, i=i, now=state: response.at(now, t)[i], s / 2, s)[0] for i in range(5)]
            assert_allclose(response.mean(state, s / 2, s / 2), np.array(exact) / (s / 2), rtol=0, atol=1e-6)
        late = np.abs(target - torque) > rate * (lag + 0.03)
        assert (response.is_limited(state, 0.03) == late).all()
        torque = expected if tick == 0 else found
        torque = found
    with pytest.raises(FieldError) as caught:
        cp.Simulation(cell_of("planar", actuators={"rate_limit": [1.0, 2.0]}), Given(stepped))
    assert caught.value.path == "actuators.rate_limit"


@pytest.mark.parametrize("name", SCENARIOS)
def test_drives_without_a_servo_sense_where_they_are(name):
    run = cp.Simulation(cell_of(name))
    places, state = run.slots, run.plant.state()
    run.plant.restore(state._replace(q=state.q + 0.1, v=state.v + 0.2))
    for index, place in enumerate(places):
        q, v = run.actuation._sensed.motion(index)
        assert_allclose(q, place.drive @ run.plant.q[place.q_slice], rtol=0, atol=1e-15)
        assert_allclose(v, place.drive @ run.plant.v[place.v_slice], rtol=0, atol=1e-15)


# ---------------------------------------------------------------- missed ticks


def missed(name, seed, ticks, probability=0.3):
    """Which commands were missed, shape (ticks, arms): each command is the number of its tick, from 1 on."""
    scenario = cell_of(name, seed=seed, actuators={"missed_ticks": probability})
    run = cp.Simulation(scenario, Given(stepped))
    sizes = [len(place.drive) for place in run.slots]
    last, found = [torque[0] for torque in run.actuation.holding_commands(run.plant.q)], []
    command = CellCommand([np.zeros(size) for size in sizes], None)
    for tick, signals in zip(range(1, ticks + 1), run.signals(), strict=False):
        for torque in command.torques:
            torque.fill(tick)  # as a controller may that computes in place
        acting = [
            torques[0] for torques in run.actuation.apply(tick * 0.005, command, signals.missed).torques
        ]
        found.append([torque != tick for torque in acting])
        last = [old if lost else tick for old, lost in zip(last, found[-1], strict=True)]
        assert acting == last
    return np.array(found)


def test_a_missed_tick_holds_the_last_command_as_often_as_stated():
    found = missed("planar", 1, 4000)
    assert_allclose(found.mean(), 0.3, rtol=0.05)
    assert_allclose((found[1:] & found[:-1]).mean(), 0.09, rtol=0.1)  # each tick by itself
    assert_allclose((found[:, 0] & found[:, 1]).mean(), 0.09, rtol=0.1)  # and each arm
    assert (found[:50] == missed("planar", 1, 50)).all()
    assert (found[:50] != missed("planar", 2, 50)).any()
    assert not missed("spatial", 0, 20, probability=0.0).any()
    assert missed("spatial", 0, 20, probability=1.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("probability", [0.01, 0.3, 0.9])
def test_missed_ticks_over_a_long_run(name, probability):
    assert_allclose(missed(name, 5, 200_000, probability).mean(axis=0), probability, rtol=0.05)


# ---------------------------------------------------------------- gravity compensation


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_robot_that_carries_itself_floats_and_its_mass_error_is_left_to_the_command(name):
    cell = cell_of(
        name, **{"cell.payload.mass": 1e-9, "cell.payload.inertia": [1e-12, 1e-12, 1e-12, 0, 0, 0]}
    )

    def holding(actuators):
        run = cp.Simulation(cell.replace(actuators=actuators), Given(stepped))
        return np.concatenate(run.actuation.holding_commands(run.plant.q))

    def error(mass_error):
        return {"gravity_compensation": {"mass_error": mass_error}}

    weight = holding({})
    assert np.abs(weight).max() > 1.0
    assert_allclose(holding(error(0.0)), 0.0, atol=1e-7)
    for e in (-1.0, -0.2, 0.1):
        assert_allclose(holding(error(e)), -e * weight, rtol=0, atol=1e-7)
    moved = {}
    for label, actuators in (("floats", error(0.0)), ("falls", {}), ("rises", error(0.2))):
        run = cp.simulate(
            cell.replace(actuators=actuators), Given(lambda _time, held: [0.0 * torque for torque in held])
        )
        moved[label] = np.abs(run.data.velocity.values[-1]).max()
    assert moved["floats"] < 1e-6
    assert min(moved["falls"], moved["rises"]) > 1e-3


@pytest.mark.parametrize("name", SCENARIOS)
def test_compensation_follows_the_true_configuration_and_is_cut_with_the_command(name):
    """The weight of a tree whose payload has none is that of the arms."""
    scenario = cell_of(name, actuators={"gravity_compensation": {"mass_error": 0.1}})
    run = cp.Simulation(scenario, Given(lambda _time, held: [1.3 * torque + 0.5 for torque in held]))
    while not run.is_finished:
        run.tick()
    data, chain = run.result().data, run.chain
    chain.surround(scenario.cell.surroundings._replace(mass=1e-12, inertia=1e-12 * np.eye(3)))
    model, pin_data = chain.mechanism.model, chain.mechanism.model.createData()
    for k in range(0, len(data.time), 5):
        g = pin.computeGeneralizedGravity(model, pin_data, data.configuration.values[k])
        for arm, place in enumerate(chain.model.arms):
            commanded, torque, _ = applied(data, arm)
            expected = 1.1 * np.linalg.solve(place.drive.T, g[place.v_slice])
            assert_allclose(torque[k] - commanded[k], expected, rtol=0, atol=1e-9)
    lossy = {"missed_ticks": 1.0, "gravity_compensation": {"mass_error": 0.1}}
    held = cp.simulate(scenario.replace(actuators=lossy), controller := Given(stepped)).data
    again = [torque for torque, _ in (applied(held, arm)[1:] for arm in range(len(controller.holding)))]
    for place, torque, command in zip(chain.model.arms, again, controller.holding, strict=True):
        for k in (0, -1):  # a missed tick does not stop the compensation
            g = pin.computeGeneralizedGravity(model, pin_data, held.configuration.values[k])
            expected = command + 1.1 * np.linalg.solve(place.drive.T, g[place.v_slice])
            assert_allclose(torque[k], expected, rtol=0, atol=1e-9)
    weak = {f"cell.arms.{arm}.torque_limits": 1.5 for arm in scenario.cell.arms}
    cut = cp.simulate(scenario.override(weak), Given(lambda _time, held: [0.0 * torque for torque in held]))
    assert np.nanmax(np.abs(cut.data.torque.values)) == 1.5
    assert cut.data.saturated.values.any()
    # The limit is exceeded by what the drives are asked for: zero commands, and the compensation.
    asked = cut.data.requested_torque.values
    np.testing.assert_array_equal(np.nan_to_num(np.abs(asked)) > 1.5, cut.data.saturated.values)
    found = cut.limit_violations()
    assert {violation.kind for violation in found} == {"torque"}
    assert len(found) == cut.data.saturated.values.any(axis=0).sum()
    assert_allclose(max(abs(v.worst) for v in found), np.nanmax(np.abs(asked)), rtol=0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_static_torques_are_the_whole_drive_torques_whoever_commands_them(name):
    plain = SCENARIOS[name]()
    carried = plain.override({"actuators.gravity_compensation.mass_error": 0.1})
    assert carried.actuators.gravity_compensation == cp.actuators.GravityCompensation(mass_error=0.1)
    assert static_torques(plain, poses=2).drives == static_torques(carried, poses=2).drives


# ---------------------------------------------------------------- loss of torque


@pytest.mark.parametrize(("lag", "steps", "accuracy"), [(0.0, 7, 1e-5), (0.02, 8, 1e-11)])
@pytest.mark.parametrize("name", SCENARIOS)
def test_an_arm_gives_no_torque_from_its_time_on_between_ticks_as_well(name, lag, steps, accuracy):
    """The motion is that of a fourfold control rate, whose ticks include the time; 7 steps do not."""
    last = list(SCENARIOS[name]().cell.arms)[-1]
    ends = []
    for rate, steps_per_tick in ((100.0, steps), (400.0, 2)):
        actuators = {
            "actuators": {"lag": lag},
            "arm_actuators": {last: {"lag": lag, "torque_lost_at": 0.0325}},
        }
        clock = {"clock.rate_hz": rate, "clock.steps_per_tick": steps_per_tick}
        result = cp.simulate(cell_of(name, **clock, **actuators), Given(stepped))
        lost = result.data.time.values > 0.0325 - 1e-9
        torque = result.data.torque.values
        assert (applied(result.data, -1)[1][lost] == 0.0).all()
        assert (applied(result.data, -1)[1][~lost][1:] != 0.0).any()
        assert np.abs(np.nan_to_num(torque[lost, 0])).min(axis=0).max() > 1.0
        assert result.energy_balance_max() < 1e-6
        ends.append(result.data.velocity.values[-1])
    assert_allclose(ends[0], ends[1], rtol=0, atol=accuracy)


@pytest.mark.parametrize("lag", [0.0, 0.02])
@pytest.mark.parametrize("name", SCENARIOS)
def test_an_arm_without_commands_keeps_its_own_weight(name, lag):
    """As with a command of zero, from the first tick at or after the time."""
    last = list(SCENARIOS[name]().cell.arms)[-1]
    robot = {"lag": lag, "gravity_compensation": {"mass_error": 0.1}}
    runs = []
    for actuators, lost in (({"commands_lost_at": 0.0325}, np.inf), ({}, 0.035)):
        scenario = cell_of(name, **{f"arm_actuators.{last}": robot | actuators})

        def commands(t, holding, lost=lost):
            *others, own = stepped(t, holding)
            return [*others, own * float(t < lost - 1e-9)]

        runs.append(cp.simulate(scenario, Given(commands)).data)
    assert_allclose(runs[0].torque.values, runs[1].torque.values, rtol=0, atol=1e-12)
    assert (applied(runs[0], -1)[0][-1] != 0.0).all()
    assert (applied(runs[1], -1)[0][-1] == 0.0).all()


# ---------------------------------------------------------------- stiction


def rough(name, **fields):
    """Overrides that give every arm of a cell a friction with stiction."""
    friction = cp.actuators.JointFriction(**{"viscous": 0.5, "coulomb": 1.0, "stiction": 1.5} | fields)
    return {f"cell.arms.{arm}.friction": friction for arm in SCENARIOS[name]().cell.arms}


@pytest.mark.parametrize("name", SCENARIOS)
def test_stiction_falls_to_coulomb_friction_with_the_speed_of_the_drive(name):
    joints = len(next(iter(SCENARIOS[name]().cell.arms.values())).posture)
    stiction = np.linspace(1.0, 2.0, joints)
    fields = {"coulomb": 1.0, "coulomb_velocity": 0.02, "stribeck_velocity": 0.3}
    plant = cp.Simulation(cell_of(name, **rough(name, stiction=stiction, **fields)), Given(stepped)).plant
    for scale in (1e-6, 0.1, 0.3, 30.0):
        v = scale * np.random.default_rng(0).choice([-1.0, 1.0], len(plant.v))
        for place in plant.chain.model.arms:
            w = place.drive @ v[place.v_slice]
            level = 1.0 + (stiction - 1.0) * np.exp(-((w / 0.3) ** 2))
            expected = place.drive.T @ -(0.5 * w + level * np.tanh(w / 0.02))
            assert_allclose(plant.transmission.friction(v)[place.v_slice], expected, rtol=1e-12, atol=1e-15)
    plain = cp.Simulation(cell_of(name, **rough(name, stiction=None)), Given(stepped)).plant.transmission
    equal = cp.Simulation(cell_of(name, **rough(name, stiction=1.0)), Given(stepped)).plant.transmission
    assert (plain.friction(v) == equal.friction(v)).all()


@pytest.mark.parametrize("name", SCENARIOS)
def test_stiction_keeps_the_order_of_the_integrator_and_the_energy_balance(name):
    smooth, ends = rough(name, coulomb_velocity=0.3, stribeck_velocity=0.6), []
    for steps in (1, 2, 4):
        scenario = cell_of(name, duration=0.05, **smooth, **{"clock.steps_per_tick": steps})
        result = cp.simulate(scenario, Given(stepped))
        ends.append(result.data.velocity.values[-1])
    assert np.abs(ends[2]).max() > 0.1  # through the peak
    assert 12.0 < np.abs(ends[0] - ends[1]).max() / np.abs(ends[1] - ends[2]).max() < 22.0
    assert result.energy_balance_max() < 1e-8
    assert float(result.data.work_friction[-1]) < 0.0


# ---------------------------------------------------------------- all of it


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_seed_determines_a_run_and_its_energy_is_accounted_for(name):
    smooth = rough(name, coulomb_velocity=0.2, stribeck_velocity=0.5)
    scenario = cell_of(name, duration=0.2, actuators=EVERYTHING, **smooth)
    runs = [
        cp.simulate(scenario.replace(seed=seed), Given(lambda t, held: [x + np.sin(60 * t) for x in held]))
        for seed in (3, 3, 4)
    ]
    first, again, other = (run.data.configuration.values for run in runs)
    assert (first == again).all()
    assert (first != other).any()
    balances = [run.energy_balance_max() for run in runs]
    assert max(balances) < 1e-6
    assert float(runs[0].data.work_actuation[-1]) != 0.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_neutral_values_change_no_bit(name):
    scenario = SCENARIOS[name]().replace(duration=0.1, events=())
    neutral = {"lag": 0.0, "missed_ticks": 0.0}
    stated = scenario.replace(actuators=neutral, arm_actuators=dict.fromkeys(scenario.cell.arms, neutral))
    assert stated.actuators == cp.Actuators() == scenario.actuators
    without = {"gravity_compensation": {"mass_error": -1.0}, "rate_limit": 1e299, "torque_lost_at": 0.1}
    usual, same, ideal = (
        cp.run(each, warn=False).data for each in (scenario, stated, scenario.replace(actuators=without))
    )
    for quantity in usual:
        np.testing.assert_array_equal(usual[quantity].values, same[quantity].values, err_msg=quantity)
    assert_allclose(usual.velocity.values, ideal.velocity.values, rtol=0, atol=1e-9)
    assert (np.nan_to_num(ideal.torque.values[-1]) == 0.0).all()


@pytest.mark.parametrize(
    ("changes", "path"),
    [
        ({"actuators.lag": -0.01}, "actuators.lag"),
        ({"actuators.rate_limit": 0.0}, "actuators.rate_limit"),
        ({"actuators.rate_limit": [1.0, -1.0, 1.0]}, "actuators.rate_limit"),
        ({"actuators.missed_ticks": 1.01}, "actuators.missed_ticks"),
        ({"actuators.missed_ticks": -0.01}, "actuators.missed_ticks"),
        ({"actuators.torque_lost_at": -1.0}, "actuators.torque_lost_at"),
        ({"actuators.torque_lost_at": 20.1}, "actuators.torque_lost_at"),
        ({"arm_actuators.left": {"torque_lost_at": 20.1}}, "arm_actuators.left.torque_lost_at"),
        ({"actuators.commands_lost_at": 20.1}, "actuators.commands_lost_at"),
        ({"actuators": {"commands_lost_at": 1.0, "torque_lost_at": 1.0}}, "actuators.commands_lost_at"),
        ({"actuators.gravity_compensation.mass_error": -1.5}, "actuators.gravity_compensation.mass_error"),
        ({"arm_actuators.lefft": {"lag": 0.1}}, "arm_actuators.lefft"),
        ({"cell.arms.left.friction.coulomb": 2.0, "cell.arms.left.friction.stiction": 1.0},
         "cell.arms.left.friction.stiction"),
    ],
)  # fmt: skip
def test_actuators_that_do_not_exist_are_refused(changes, path):
    with pytest.raises(ScenarioError) as caught:
        cp.Scenario.load("adept-paper", changes)
    assert [problem.path for problem in caught.value.problems] == [path]


def test_a_law_runs_on_imperfect_actuators():
    """The printed law on the paper's cell tracks through a lag of a millisecond with robots of their own."""
    changes = {"duration": 0.5, "events": [], "clock.steps_per_tick": 13, "actuators.lag": 0.001}
    scenario = cp.Scenario.load("adept-paper", changes)
    again = cp.Scenario.from_toml(scenario.to_toml())
    assert again == scenario
    result = cp.simulate(again, build_controller(again))
    assert result.energy_balance_max() < 1e-6


@pytest.mark.parametrize("name", SCENARIOS)
def test_friction_of_an_arm_is_that_of_the_transmission(name):
    scenario = cell_of(name, **rough(name, stiction=1.7))
    plant = cp.Simulation(scenario, build_controller(scenario)).plant
    v = np.random.default_rng(1).normal(size=(5, len(plant.v))) * 0.3
    for arm in plant.chain.model.arms:
        found = friction(scenario.cell.arms[arm.name], arm.name)
        own = found.force(v[:, arm.v_slice])
        assert_allclose(own, [plant.transmission.friction(row)[arm.v_slice] for row in v], atol=1e-13)
        assert_allclose(own[0], -found.damping(v[0, arm.v_slice]) @ v[0, arm.v_slice], rtol=1e-12)
        steepest = found.damping(np.zeros(len(arm.drive)))
        assert_allclose(
            steepest @ v[0, arm.v_slice], -found.force(1e-7 * v[0, arm.v_slice]) / 1e-7, rtol=1e-6
        )
