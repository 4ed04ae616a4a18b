"""Batches of runs: the dynamics against Pinocchio, whole runs against coop_pin.run."""

import functools

import numpy as np
import pinocchio as pin
import pytest
import xarray as xr
from batches import require_same_bits, require_same_samples
from cells import RIGID
from numpy.testing import assert_allclose, assert_array_equal
from numpy_machine import NumpyMachine

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, InvalidStateError, NotEnoughMemoryError
from coop_pin.compiled import simulate_batch, support
from coop_pin.compiled.engine_choice import choose_engines
from coop_pin.compiled.kind import Cover, Kind
from coop_pin.compiled.plant.arm_dynamics import ArmInput, ArmNumbers, arm_terms
from coop_pin.compiled.plant.cell_dynamics import CellState, cell_motion
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.closures import closure_error
from coop_pin.compiled.plant.serial_arm import SerialArm
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.prepared_plant import PreparedPlant
from coop_pin.compiled.simulate import BatchSimulator
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.transmission import Transmission
from coop_pin.results.energies import WORK
from coop_pin.results.metrics import PHASE_METRICS
from coop_pin.tracing.evaluation import evaluate
from coop_pin.tracing.llvm_machine import LlvmMachine
from coop_pin.tracing.tape import Tape, operands
from coop_pin.tracing.traced_array import inputs
from coop_pin.tracing.tree import SharedFunctions

CATALOGUE = RIGID
QUICK = ("adept-paper", "five-joint-pair")


def in_tiers(names, quick=QUICK):
    """The quick cells in the default tier, the others in the slow one."""
    return [pytest.param(name, marks=[] if name in quick else [pytest.mark.slow]) for name in names]


# ---------------------------------------------------------------- dynamics


@pytest.mark.parametrize("name", in_tiers(CATALOGUE))
def test_the_dynamics_of_every_catalogue_cell_are_pinocchios(name):
    """Accelerations and wrenches at random states, slightly off the closures and pushed."""
    scenario, rng = cp.Scenario.load(name), np.random.default_rng(5)
    chain = CellChain(scenario.cell, scenario.plant)
    model, cell, q_start = (
        chain.mechanism.model,
        CellNumbers.from_chain(chain),
        chain.configuration(scenario.start.matrix),
    )
    tape, friction = Tape(), Transmission(chain.cell, chain.model.arms, model.nv).friction
    state = CellState(*(inputs(tape, model.nv) for _ in range(3)))
    cell = cell._replace(surroundings=cell.surroundings._replace(push=inputs(tape, 6)))
    motion = cell_motion(SharedFunctions(), cell, state)
    seen = motion.observation
    outputs = [*motion.rates, *seen.interaction_wrench.flat, seen.kinetic_energy, seen.potential_energy]
    rows = cell.moving_rows(cell.by_arm(state.q))
    for _ in range(3):
        near = pin.integrate(model, q_start, 0.03 * rng.normal(size=model.nv))
        q = pin.integrate(
            model, chain.mechanism.project_configuration(near), 1e-5 * rng.normal(size=model.nv)
        )
        v = chain.mechanism.project_velocity(q, rng.normal(size=model.nv)) + 1e-4 * rng.normal(size=model.nv)
        tau, external = 20.0 * rng.normal(size=model.nv), np.zeros(6)
        external[rows] = 10.0 * rng.normal(size=len(rows))
        force = tau + friction(v) + chain.payload_jacobian(q).T @ external
        angles = np.concatenate([arm.angles.of(q[arm.q_slice]) for arm in chain.model.arms])
        found = np.array(evaluate(tape, operands(tape, outputs), [*angles, *v, *tau, *external]))
        wanted = chain.mechanism.solver.acceleration(q, v, force)
        F, energy = chain.interaction_wrenches(q, v, force, external), chain.mechanism.energy(q, v)
        assert np.abs(found[: model.nv] - wanted).max() < 1e-10 * np.abs(wanted).max()
        powers = tau @ v, friction(v) @ v, external @ chain.payload_twist(q, v), 0.0
        assert_allclose(found[model.nv :][: len(WORK)], powers, rtol=1e-10, atol=1e-10)
        wrenches = found[model.nv + len(WORK) : -2].reshape(-1, 6)[:, rows]
        assert np.abs(wrenches - F[:, rows]).max() < 1e-10 * np.abs(F).max()
        assert_allclose(found[-2:], energy, rtol=0, atol=1e-10)


def test_the_dynamics_of_arms_with_turning_and_sliding_joints_are_pinocchios():
    """Joints about and along axes of the body and others; no cell of the catalogue has a sliding joint."""
    axis, model, rng, n = np.array([0.48, 0.6, 0.64]), pin.Model(), np.random.default_rng(8), 5
    kinds = (
        *(pin.JointModelPY(), pin.JointModelRX(), pin.JointModelPrismaticUnaligned(axis)),
        *(pin.JointModelRevoluteUnaligned(axis), pin.JointModelRZ()),
    )
    for parent, kind in enumerate(kinds):
        joint = model.addJoint(parent, kind, pin.SE3.Random(), f"joint_{parent}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    arm = SerialArm.from_model(model, range(1, n + 1), pin.SE3.Random(), model.inertias[n])
    first, last, gravity = arm.bodies[0], arm.bodies[-1].inertia, model.gravity.linear
    tape, data = Tape(), model.createData()
    q, v, tau = (inputs(tape, n) for _ in range(3))
    state = ArmInput(q, v, tau, (first.R, first.p), last, (arm.R_JP, arm.p_JP))
    terms = arm_terms(ArmNumbers(arm, gravity, "012345"), state)
    outputs = [*terms.acceleration(np.zeros(6)), *terms.b, *terms.V, terms.kinetic, -(terms.moment @ gravity)]
    for q, v, tau in rng.normal(size=(3, 3, n)):
        a = pin.aba(model, data, q, v, tau)
        pin.forwardKinematics(model, data, q, v, a)
        A, V = (
            data.oMi[n].act(data.a[n]).vector - [*gravity, 0.0, 0.0, 0.0],
            data.oMi[n].act(data.v[n]).vector,
        )
        energies = pin.computeKineticEnergy(model, data, q, v), pin.computePotentialEnergy(model, data, q)
        found = evaluate(tape, operands(tape, outputs), [*q, *v, *tau])
        assert_allclose(found, [*a, *A, *V, *energies], rtol=1e-11, atol=1e-11)


# ---------------------------------------------------------------- whole runs


DURATIONS = {True: 0.05, False: 0.02}
"""Of whole runs in a plane and in space, s; the numpy oracle takes 0.1 s a tick."""


def runs(name, duration, count):
    """Scenarios that differ in a gain and in the payload's mass, with a mass drop and a push."""
    base = cp.Scenario.load(name)
    mass = base.cell.payload.mass
    events = (
        {"kind": "payload-change", "time": 0.31 * duration, "mass": 0.5 * mass},
        {
            "kind": "wrench-pulse",
            "time": 0.5 * duration,
            "duration": 0.1 * duration,
            "wrench": (5, 2, 0, 0, 0, 0.2),
        },
    )
    base = base.replace(duration=duration, events=events)
    gain = "pose_gain" if base.has_servos else "transient_rate"
    return [
        base.override({f"controller.gains.{gain}": 4.0 + k, "cell.payload.mass": (1.0 + 0.1 * k) * mass})
        for k in range(count)
    ]


@pytest.mark.parametrize("name", in_tiers(CATALOGUE))
def test_whole_runs_and_their_metrics_are_those_of_coop_pin_run(name):
    scenarios = runs(name, DURATIONS[name.startswith("adept")], count=3)
    batch = simulate_batch(scenarios)
    assert batch.is_valid.all()
    found, wanted = batch.result(1), cp.run(scenarios[1], warn=False)
    require_same_samples(found.data, wanted.data)
    numbers = {key: value for key, value in wanted.metrics().items() if np.isfinite(value)}
    assert len(numbers) > 5
    for key, value in numbers.items():
        assert found.metrics()[key] == pytest.approx(value, rel=1e-9, abs=1e-9), key
    assert [repr(run) for run in batch.metrics()] == [repr(batch.result(n).metrics()) for n in range(3)]
    exact, bounds, again = (
        batch.samples["jacobian_condition"].max(axis=1),
        *(batch.samples.extremes(allowed)["jacobian_condition"][:, 0] for allowed in (np.inf, 1.0)),
    )
    assert (bounds >= exact * (1.0 - 1e-9)).all()
    assert (bounds <= 6.0 * exact).all()
    assert_array_equal(again, exact)


def test_the_metrics_of_a_batch_have_the_bits_of_those_of_each_run():
    """With steady windows before and after an event, own trust thresholds, and a run that diverges."""
    event = {"kind": "payload-change", "time": 5.0, "mass": 2.0}
    changes = {"duration": 10.0, "events": [event], "clock.record_every": 7, "beyond_bound": True}
    base = cp.Scenario.load("adept-paper", changes | {"controller.gains.sign_gain": 0.2, "task.moment": 0.7})
    largest = float(simulate_batch([base]).samples["jacobian_condition"].max())
    scenarios = [
        base,
        *(base.override({"trust.jacobian_condition": f * largest}) for f in (1.0 - 1e-6, 1.0 + 1e-6)),
        base.override({"controller.gains.damping_gain": 1e5}),
        base.override({"controller.gains.pose_gain": 6.0, "trust.energy_floor": 1e-3, "task.force": 90.0}),
    ]
    batch = simulate_batch(scenarios)
    assert batch.is_valid.tolist() == [True, True, True, False, True]
    found = batch.metrics()
    for index in np.flatnonzero(batch.is_valid):
        assert repr(found[index]) == repr(batch.result(index).metrics())
    assert [run["simulation_sound"] for run in found] == [1.0, 0.0, 1.0, 0.0, 1.0]
    assert [run["task_kept"] for run in found] == [0.0, 0.0, 0.0, 0.0, 1.0]
    assert np.isfinite([found[4][f"after_event_{name}"] for name in PHASE_METRICS]).all()
    assert found[4]["moving_position_rms_m"] != found[0]["moving_position_rms_m"]


def test_a_batch_of_one_run_has_its_metrics_its_last_tick_and_the_trust_of_its_condition_number():
    """Seven ticks of which every fourth is recorded; limits between the condition number and its bound."""
    base = cp.Scenario.load("adept-paper", {"duration": 7 * 0.0125, "events": [], "clock.record_every": 4})
    largest = float(cp.run(base, warn=False).data["jacobian_condition"].max())
    simulator = BatchSimulator()
    for limit, is_trusted in ((1.0 + 1e-3, True), (1.1, True), (1.0 - 1e-3, False)):
        scenario = base.override({"trust.jacobian_condition": limit * largest})
        batch, single = simulator.run([scenario]), cp.run(scenario, warn=False)
        assert batch.samples["time"].shape == (1, 3)
        require_same_samples(batch.result(0).data, single.data)
        (metrics,) = batch.metrics()
        assert metrics["simulation_sound"] == is_trusted == single.simulation_sound
        expected = {name: value for name, value in single.metrics().items() if np.isfinite(value)}
        assert {name: metrics[name] for name in expected} == pytest.approx(expected, rel=1e-9, abs=1e-9)
    bounds = batch.samples.extremes(np.inf)["jacobian_condition"].max()
    assert 1.1 * largest < bounds < 6.0 * largest


def test_a_run_that_diverges_is_not_valid():
    gains = {"controller.gains.sliding_gain": 1e7, "beyond_bound": True}
    scenario = cp.Scenario.load("adept-anchored", {"duration": 0.1, "events": [], **gains})
    assert simulate_batch([scenario]).is_valid.tolist() == [False]


def test_an_event_at_the_last_tick_is_that_of_a_single_run():
    event = {"kind": "payload-change", "time": 0.1, "mass": 4.0}
    scenario = cp.Scenario.load("adept-paper", {"duration": 0.1, "events": [event]})
    batch, single = simulate_batch([scenario]), cp.run(scenario, warn=False)
    require_same_samples(batch.result(0).data, single.data)
    assert abs(float(single.data["work_payload_change"][-1])) > 1e-3


def test_the_closure_error_is_the_logarithm_of_the_offset():
    """Of the order of a milliradian, where the terms that are left out are 1e-12."""
    rng = np.random.default_rng(6)
    for _ in range(5):
        X, offset = pin.SE3.Random(), pin.exp6(1e-3 * rng.normal(size=6))
        Y = offset.actInv(X)
        found = closure_error(X.rotation, X.translation, Y.rotation, Y.translation)
        assert_allclose(found.astype(float), -pin.log6(offset).vector, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_bits_do_not_depend_on_vector_width_batch_size_or_emitter(name):
    scenarios = runs(name, DURATIONS[name.startswith("adept")], count=3)
    record = require_same_bits(scenarios)
    assert not np.isnan(record).any()  # wrenches are of infinite age before the first
    assert np.ptp(record[-1], axis=1).max() > 0.0


def test_runs_with_equal_plants_share_one_and_have_the_numbers_of_their_own():
    base, masses = cp.Scenario.load("adept-paper").replace(duration=0.05, events=()), (1.0, 2.0)
    changes = [{"controller.gains.pose_gain": g, "cell.payload.mass": m} for g in (5.0, 6.0) for m in masses]
    scenarios = [base.override(change) for change in changes]
    simulator = BatchSimulator()
    first, again = (Prepared.joined([simulator.prepare(each) for each in scenarios]) for _ in range(2))
    assert {*again.plants} == {*first.plants}
    assert len({*first.plants}) == len(masses)
    for run, scenario in enumerate(scenarios):
        alone = BatchSimulator().prepare(scenario)
        for found in (first, again):
            assert_array_equal(found.values[run], alone.values[0])
            assert_array_equal(found.signals[run], alone.signals[0])
            assert_array_equal(found.plants[run].begins["holding"], alone.plants[0].begins["holding"])
    numbers = first.values[:, np.isfinite(first.values).all(axis=0)]
    assert (np.ptp(numbers, axis=0) > 0.0).sum() > 1


@pytest.mark.parametrize("name", RIGID)
def test_a_plant_with_another_payload_has_the_bits_of_one_built_anew(name):
    """Also with other numbers of an event; what holds the payload in another way is built anew."""
    late = {"kind": "payload-change", "time": 0.5, "mass": 3.0}
    base = cp.Scenario.load(name).override({"duration": 1.0, "events": [late], "beyond_bound": True})
    heavy = base.override({"cell.payload.mass": 1.7 * base.cell.payload.mass, "events.0.mass": 0.9})
    built, cover = PreparedPlant(heavy), None
    carried = PreparedPlant(base).carrying(heavy, cover)
    assert carried.values.tobytes() == built.values.tobytes()
    assert carried.begins == built.begins
    assert carried.scenario == heavy
    assert carried.kind == built.kind
    assert PreparedPlant(base).carrying(base.override({"events.0.time": 0.6}), cover) is None
    assert PreparedPlant(base).carrying(base.override({"duration": 0.8}), cover) is None
    first, *_ = base.cell.arms
    moved = base.override({f"cell.arms.{first}.calibration_error.joint_offset": 1e-4})
    assert carried.carrying(moved, cover) is None


def families(simulator):
    """What a simulator keeps of each kind of runs: its code, and the run for which it was made."""
    return simulator._families


@pytest.mark.slow
def test_batches_of_one_simulator_share_their_code_and_have_the_bits_of_any_other():
    scenarios = runs("adept-paper", 0.05, count=3)
    simulator = BatchSimulator(machine=NumpyMachine)
    whole, (family,) = simulator.run(scenarios).samples, families(simulator)
    alone = simulator.run(scenarios[2:]).samples  # numbers that were inputs stay inputs
    assert families(simulator)[0].code is family.code
    folded = BatchSimulator(machine=NumpyMachine).run(scenarios[2:]).samples  # no number is an input
    for name, values in folded.items():
        assert_array_equal(values[0], whole[name][2], err_msg=name)
        assert_array_equal(alone[name], values, err_msg=name)
    simulator.run([scenario.override({"controller.gains.damping_gain": 31.0}) for scenario in scenarios])
    (wider,) = families(simulator)
    assert wider.first is family.first
    assert wider.code is not family.code


TRIALS = {
    "nominal": {},
    "mass": {"events": [{"kind": "payload-change", "time": 0.0, "mass": 9.0}]},
    "push": {"events": [{"kind": "wrench-pulse", "time": 0.03, "duration": 0.02, "wrench": [9.0] * 6}]},
    "late": {"sensors.wrist.delay": 1},
    "later": {"sensors.wrist.delay": 3},
    "lost": {"sensors.wrist.lost": [[0.03, 0.06]]},
    "rate": {"clock.rate_hz": 250.0},
    "torque": {"arm_actuators": {"right": {"torque_lost_at": 0.05}}},
    "commands": {"arm_actuators": {"right": {"commands_lost_at": 0.05}}},
}
"""Changes that runs of one code may have."""


OWN_CODE = {
    "lag": {"actuators.lag": 0.01},
    "missed ticks": {"actuators.missed_ticks": 0.1},
    "rate limit": {"actuators.rate_limit": 50.0},
    "no wrist": {"sensors.wrist": None},
    "encoder": {"sensors.encoder.resolution": 1e-5},
    "speed": {"sensors.velocity.kind": "difference"},
}
"""Changes that need code of their own."""


@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box"])
def test_the_engine_is_decided_for_those_runs_together_that_share_their_code(name):
    base = cp.Scenario.load(name, {"duration": 0.1, "events": [], "sensors.wrist": {}})
    changed = {change: base.override(fields) for change, fields in {**TRIALS, **OWN_CODE}.items()}
    cover, simulator = Cover.of_all([base, *changed.values()]), BatchSimulator()
    code = {change: simulator.prepare(scenario, cover).kind.code for change, scenario in changed.items()}
    shared = {change for change in changed if code[change] == code["nominal"]}
    kind = Kind.of_scenario(base)
    assert shared == {change for change in changed if Kind.of_scenario(changed[change]) == kind}
    assert shared == {*TRIALS}
    release = base.override({"events": [{"kind": "lose-arm", "time": 0.05, "arm": "left", "form": "braked"}]})
    assert [choice.obstacle for choice in choose_engines([base, release], "compiled", [1, 1])] == [
        None,
        "plant",
    ]


@pytest.mark.parametrize(
    ("name", "whole"),
    [
        ("adept-anchored", ["later"]),
        *(
            pytest.param(name, TRIALS, marks=pytest.mark.slow)
            for name in ("adept-anchored", "two-pandas-box")
        ),
    ],
)
def test_runs_with_other_events_rates_delays_and_losses_share_their_code_and_keep_their_bits(name, whole):
    base = cp.Scenario.load(name, {"duration": 0.1, "events": [], "sensors.wrist": {}})
    scenarios = [base.override(changes) for changes in TRIALS.values()]
    cover = Cover.of_all(scenarios)
    simulator, batches = BatchSimulator(), dict[object, list[Prepared]]()
    for scenario in scenarios:
        run = simulator.prepare(scenario, cover)
        batches.setdefault(run.kind.times, []).append(run)
    lagging = simulator.prepare(base.override({"actuators.lag": 0.01}), cover)
    assert lagging.kind.code != run.kind.code
    code = simulator.family([Prepared.joined(runs) for runs in batches.values()]).code
    assert [len(runs) for runs in batches.values()] == [4, 1, 1, 1, 1, 1]
    found = dict[str, xr.Dataset]()
    for runs in batches.values():
        batch = simulator.run_prepared(runs)
        names = [
            name
            for run in runs
            for name, one in zip(TRIALS, scenarios, strict=True)
            if one is run.scenarios[0]
        ]
        found |= {name: batch.result(index).data for index, name in enumerate(names)}
    assert families(simulator)[-1].code is code
    ends = np.array([found[name].configuration[-1] for name in ("mass", "push", "torque", "commands")])
    assert np.abs(ends - found["nominal"].configuration[-1].values).max(axis=1).min() > 1e-9
    for name, scenario in zip(TRIALS, scenarios, strict=True):
        require_same_samples(found[name], cp.run(scenario, warn=False).data)
        if name in whole:
            assert found[name].equals(BatchSimulator().run([scenario]).result(0).data)


@pytest.mark.parametrize("name", in_tiers(["adept-anchored", "five-joint-pair"], ["adept-anchored"]))
def test_another_process_neither_traces_nor_compiles_and_other_numbers_have_other_code(
    name, tmp_path, monkeypatch
):
    """Traced code on disk gives the bits of the kernels, with numbers that fold, a damaged file too."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    field, folder = "controller.gains.transient_rate", tmp_path / "coop_pin" / "compiled"
    base = cp.Scenario.load(name).replace(duration=0.1, events=())
    heavy = base.override({"cell.payload.mass": 1.1 * base.cell.payload.mass})  # folds

    def positions(scenario, **machine):
        runs = [scenario, scenario.override({field: 4.0})]
        return simulate_batch(runs, **machine).samples["configuration"]

    traced = [positions(scenario, machine=LlvmMachine) for scenario in (base, heavy)]

    def written():
        return {file.name: file.stat().st_ino for file in folder.iterdir()}

    for scenario, expected in zip((base, heavy), traced, strict=True):
        assert_array_equal(positions(scenario), expected)
    kept = written()
    for scenario, expected in zip((base, heavy), traced, strict=True):
        assert_array_equal(positions(scenario), expected)
    assert written() == kept
    assert len(kept) == 2 * 2  # traced and compiled code
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[:-1])
    assert_array_equal(positions(base), traced[0])
    assert sum(number != kept[name] for name, number in written().items()) == 2


@pytest.fixture
def largest_block(monkeypatch):
    """A function that sets how many runs at most go through the kernels together."""
    return functools.partial(monkeypatch.setattr, "coop_pin.compiled.simulate.LARGEST_BLOCK")


def test_blocks_of_runs_and_later_batches_leave_samples_as_they_are(largest_block):
    scenarios, simulator = runs("adept-paper", 0.05, 4), BatchSimulator()
    together, kept = simulator.run(scenarios).samples, simulator.run(scenarios[:1]).samples
    largest_block(3)
    in_blocks = simulator.run(scenarios).samples
    for name, values in together.items():
        assert_array_equal(in_blocks[name], values, err_msg=name)
        assert_array_equal(kept[name][0], values[0], err_msg=name)


def test_a_released_batch_lends_its_memory_and_what_was_read_of_it_stays(largest_block):
    """Each of three blocks has memory of its own, which later batches overwrite; nobody reads it any more."""
    largest_block(2)
    scenarios = runs("adept-paper", 0.05, 5)
    simulator, others = BatchSimulator(), runs("adept-paper", 0.05, 2)[::-1]
    batch, again = simulator.run(scenarios), simulator.run(scenarios)
    names = [name for name in batch.samples if name != "torque"]
    read = {name: batch.samples[name] for name in names}
    copies, metrics = {name: values.copy() for name, values in read.items()}, batch.metrics()
    result = batch.result(4).data.copy(deep=True)
    for _ in range(2):
        batch.release()  # a second time changes nothing
    free = simulator._free
    released = len(free)
    later = [simulator.run(others) for _ in range(3)]
    assert (released, len(free)) == (3, 0)
    for name, values in read.items():
        assert_array_equal(values, copies[name], err_msg=name)
        assert_array_equal(again.samples[name], values, err_msg=name)
        for own in later:
            assert_array_equal(own.samples[name][::-1], values[:2], err_msg=name)
    assert repr(again.metrics()) == repr(metrics)
    assert again.result(4).data.equals(result)
    batch.samples._made.clear()
    for ask in (lambda: batch.samples["torque"], lambda: batch.result(0), batch.metrics):
        with pytest.raises(InvalidStateError):
            ask()


def test_runs_that_differ_in_motion_start_friction_and_squeeze_are_one_batch():
    """One more of them diverges: it is not valid, and the others do not notice."""
    base = cp.Scenario.load("adept-anchored").replace(duration=0.1, events=())
    scenarios = [
        base.override(
            {
                "motion.constant": [0.4 + 0.01 * k, 0.03, 0.0],
                "start.xyz": [0.6, 0.14 + 0.01 * k, 0.0],
                "cell.arms.left.friction.coulomb": 0.01 * k,
                "squeeze": {"left": [-10.0 - k, 0, 0, 0, 0, 0], "right": [10.0 + k, 0, 0, 0, 0, 0]},
                "cell.grasps.right.rpy": [0.0, 0.0, 0.05 * k],
                "cell.arms.right.base.xyz": [1.0 - 0.01 * k, 0.0, 0.0],
                "cell.arms.right.calibration_error": {"tip": {"xyz": [1e-4 * (1 + k), 0.0, 0.0]}},
            }
        )
        for k in range(2)
    ]
    scenarios.append(base.override({"controller.gains.sliding_gain": 1e7}))
    batch = simulate_batch(scenarios)
    assert batch.is_valid.tolist() == [True, True, False]
    with pytest.raises(cp.CoopPinError):
        cp.run(scenarios[2], warn=False)
    for index in (0, 1):
        wanted = cp.run(scenarios[index], warn=False).data
        for name in ("configuration", "torque", "internal_wrench", "seen_pose_error"):
            assert_allclose(batch.result(index).data[name], wanted[name], rtol=0, atol=1e-9)
    assert not np.allclose(batch.samples["torque"][0], batch.samples["torque"][1])


def test_samples_that_do_not_fit_are_refused_before_they_are_made(leave_free):
    leave_free(1_000_000)
    scenario = cp.Scenario.load("adept-paper").replace(duration=0.05, events=())
    with pytest.raises(NotEnoughMemoryError):
        simulate_batch([scenario] * 100, machine=NumpyMachine)


# ---------------------------------------------------------------- support


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"plant.payload": "free"}, "free"),
        ({"plant.integrator": "semi-implicit-euler"}, "semi-implicit-euler"),
        ({"plant.project": "step"}, "step"),
    ],
)
def test_what_cannot_run_in_a_batch_is_said_in_words(changes, word):
    scenario = cp.Scenario.load("adept-paper")
    assert support(scenario) is None
    scenario = scenario.override(changes)
    assert word in support(scenario)
    with pytest.raises(ArgumentError, match=word):
        simulate_batch([scenario])


def test_scenarios_that_differ_in_more_than_numbers_are_refused():
    base = cp.Scenario.load("adept-paper").replace(duration=0.1, events=())
    for change in ({"duration": 0.2}, {"controller.switching": {"kind": "tanh"}}, {"clock.rate_hz": 100.0}):
        with pytest.raises(ArgumentError, match=r"scenarios\[1\]"):
            simulate_batch([base, base.override(change)], machine=NumpyMachine)
    with pytest.raises(ArgumentError):
        simulate_batch([])


def test_calls_of_few_instructions_have_the_bits_of_one(monkeypatch):
    """Between calls Python sees Ctrl-C: a block of long runs takes many seconds."""
    base = cp.Scenario.load("adept-anchored").replace(duration=0.5, events=())
    runs = [base.override({"controller.gains.pose_gain": gain}) for gain in (1.0, 2.0)]
    whole = simulate_batch(runs)
    monkeypatch.setattr("coop_pin.tracing.llvm_machine._AT_ONCE", 7)
    parts = simulate_batch(runs)
    for name, values in whole.samples.items():
        assert_array_equal(parts.samples[name], values, err_msg=name)
