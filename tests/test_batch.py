"""Batches of runs: traced numbers, the dynamics against Pinocchio, whole runs against coop_pin.run."""

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pinocchio as pin
import pytest
from batches import require_same_bits, require_same_samples
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin import batch as batch_package
from coop_pin.batch import preparation, simulate_batch, support
from coop_pin.batch.arm_dynamics import ArmInput, ArmNumbers, arm_terms
from coop_pin.batch.cell_dynamics import CellNumbers, CellState, cell_motion
from coop_pin.batch.serial_arm import SerialArm
from coop_pin.batch.simulate import BatchSimulator
from coop_pin.chain.cell_chain import CellChain
from coop_pin.description.scenario import scenario_names
from coop_pin.errors import ArgumentError, MissingExtraError, NotEnoughMemoryError, TracingError
from coop_pin.results.metrics import STEADY_METRICS
from coop_pin.tracing import elementary
from coop_pin.tracing.kernel import RECORD, Instruction, Kernel, Layout, NumpyMachine, Program
from coop_pin.tracing.llvm_machine import LlvmMachine
from coop_pin.tracing.numpy_emitter import evaluate
from coop_pin.tracing.tape import Tape
from coop_pin.tracing.traced_array import inputs, traced
from coop_pin.tracing.tree import SharedFunctions

CATALOGUE = scenario_names()
QUICK = ("adept-paper", "five-joint-pair")


def in_tiers(names, quick=QUICK):
    """The quick cells in the default tier, the others in the slow one."""
    return [pytest.param(name, marks=[] if name in quick else [pytest.mark.slow]) for name in names]


# ---------------------------------------------------------------- traced numbers


def test_constants_fold_and_equal_operations_are_recorded_once():
    tape = Tape()
    x, y = tape.input(), tape.input()
    assert 0.0 * x == 0.0
    assert (1.0 * x).index == (x + 0.0).index == (0.0 + x).index == x.index
    minus = -x
    assert (-minus).index == x.index
    assert x - x == 0.0
    assert (x * y).index == (y * x).index
    assert ((x + 2.0) * y).index == (y * (2.0 + x)).index
    assert elementary.exp(1.0) == math.e
    assert len(tape.live([x * y + x * y])) == 4


def test_numbers_are_not_taken_for_the_indices_of_operations():
    """The first input has index 0, which equals the constant 0.0 in Python."""
    tape = Tape()
    x, y = tape.input(), tape.input()
    values = [x + 5.0, 5.0 + x, x - 5.0, x + y, y * 2.0, y + 1.0, x * 7.0, x / 3.0]
    assert evaluate(tape, values, [10.0, 20.0]) == [15.0, 15.0, 5.0, 30.0, 40.0, 21.0, 70.0, 10.0 / 3.0]


@pytest.mark.parametrize(
    "branch",
    [
        lambda x: 1.0 if x > 0.0 else 2.0,
        math.exp,
        float,
        lambda x: np.linalg.eigvals(traced([[x, 1.0], [0.0, x]])),
        lambda x: np.arcsinh(traced([x])),
        lambda x: x**3,
        lambda x: x + "a",
        lambda x: x + Tape().input(),
    ],
)
def test_what_cannot_be_traced_is_refused(branch):
    with pytest.raises(TracingError):
        branch(Tape().input())


@pytest.mark.parametrize(
    ("name", "low", "high", "allowed"),
    [
        ("sin", -50.0, 50.0, 4e-16),
        ("cos", -50.0, 50.0, 4e-16),
        ("tanh", -20.0, 20.0, 4e-16),
        ("exp", -30.0, 30.0, 5e-16),
        ("sqrt", 0.0, 9.0, 0.0),
    ],
)
def test_elementary_functions_are_accurate(name, low, high, allowed):
    tape = Tape()
    x = np.random.default_rng(1).uniform(low, high, 20_000)
    (found,) = evaluate(tape, [getattr(elementary, name)(tape.input())], [x])
    wanted = getattr(np, name)(x)
    scale = wanted if name == "exp" else np.ones_like(wanted)
    assert np.abs((found - wanted) / scale).max() <= allowed


def test_the_arc_tangent_is_accurate_in_all_quadrants():
    tape, rng = Tape(), np.random.default_rng(2)
    y, x = rng.normal(size=(2, 20_000)) * 10.0 ** rng.uniform(-6, 6, (2, 20_000))
    (found,) = evaluate(tape, [elementary.atan2(tape.input(), tape.input())], [y, x])
    assert np.abs(found - np.arctan2(y, x)).max() < 1e-15


def test_logarithm_and_exponential_less_one_are_accurate_over_all_magnitudes():
    tape, rng = Tape(), np.random.default_rng(6)
    x = rng.normal(size=2000) * 10.0 ** rng.uniform(-12, 2, 2000)
    y = 10.0 ** rng.uniform(-300, 300, 2000)
    outputs = [elementary.expm1(tape.input()), elementary.log(tape.input())]
    with np.errstate(all="ignore"):  # in branches that are not selected
        less_one, logarithm = evaluate(tape, outputs, [x, y])
        assert np.isnan(evaluate(tape, outputs[1:], [x, -y])).all()
    assert_allclose(less_one, np.expm1(x), rtol=2e-15)
    assert_allclose(logarithm, np.log(y), rtol=1e-15)


def test_the_inverse_pivots():
    tape, rng = Tape(), np.random.default_rng(3)
    A = rng.normal(size=(6, 6, 500))
    A[0, 0] = 0.0  # elimination without pivots would divide by zero
    entries = inputs(tape, 6, 6)
    inverse = np.array(evaluate(tape, list(np.linalg.inv(entries).flat), list(A.reshape(36, -1))))
    wanted = np.linalg.inv(np.moveaxis(A, 2, 0))
    error = np.abs(np.moveaxis(inverse.reshape(6, 6, -1), 2, 0) - wanted)
    condition = np.linalg.cond(np.moveaxis(A, 2, 0))
    assert (error.max(axis=(1, 2)) / (condition * np.abs(wanted).max(axis=(1, 2)))).max() < 1e-15


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
    tape, sizes = Tape(), [len(arm.bodies) for arm in cell.arms]
    parts = [[inputs(tape, size) for size in sizes] for _ in range(3)]
    motion = cell_motion(SharedFunctions(), tape, cell, CellState(*parts, inputs(tape, 6)))
    outputs = [*np.concatenate(motion.accelerations), *motion.wrenches.flat, motion.kinetic, motion.potential]
    rows = cell.moving_rows(parts[0])
    for _ in range(3):
        near = pin.integrate(model, q_start, 0.03 * rng.normal(size=model.nv))
        q = pin.integrate(
            model, chain.mechanism.project_configuration(near), 1e-5 * rng.normal(size=model.nv)
        )
        v = chain.mechanism.project_velocity(q, rng.normal(size=model.nv)) + 1e-4 * rng.normal(size=model.nv)
        tau, external = 20.0 * rng.normal(size=model.nv), np.zeros(6)
        external[rows] = 10.0 * rng.normal(size=len(rows))
        force = tau + chain.payload_jacobian(q).T @ external
        angles = np.concatenate([arm.angles.of(q[arm.q_slice]) for arm in chain.model.arms])
        found = np.array(evaluate(tape, outputs, [*angles, *v, *tau, *external]))
        wanted = chain.mechanism.solver.acceleration(q, v, force)
        F, energy = chain.interaction_wrenches(q, v, force, external), chain.mechanism.energy(q, v)
        assert np.abs(found[: model.nv] - wanted).max() < 1e-10 * np.abs(wanted).max()
        wrenches = found[model.nv : -2].reshape(-1, 6)[:, rows]
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
    outputs = [*terms.acceleration(np.zeros(6)), *terms.b, *terms.V, terms.kinetic, terms.potential]
    for q, v, tau in rng.normal(size=(3, 3, n)):
        a = pin.aba(model, data, q, v, tau)
        pin.forwardKinematics(model, data, q, v, a)
        A, V = (
            data.oMi[n].act(data.a[n]).vector - [*gravity, 0.0, 0.0, 0.0],
            data.oMi[n].act(data.v[n]).vector,
        )
        energies = pin.computeKineticEnergy(model, data, q, v), pin.computePotentialEnergy(model, data, q)
        found = evaluate(tape, outputs, [*q, *v, *tau])
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
    return [
        base.override(
            {"controller.gains.transient_rate": 4.0 + k, "cell.payload.mass": (1.0 + 0.1 * k) * mass}
        )
        for k in range(count)
    ]


@pytest.mark.parametrize("name", in_tiers(CATALOGUE))
def test_whole_runs_and_their_metrics_are_those_of_coop_pin_run(name):
    scenarios = runs(name, DURATIONS[name.startswith("adept")], count=3)
    batch = simulate_batch(scenarios)
    assert batch.is_valid.all()
    found, wanted = batch.result(1), cp.run(scenarios[1])
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
    base = cp.Scenario.load("adept-paper", changes)
    largest = float(simulate_batch([base]).samples["jacobian_condition"].max())
    scenarios = [
        base,
        *(base.override({"trust.jacobian_condition": f * largest}) for f in (1.0 - 1e-6, 1.0 + 1e-6)),
        base.override({"controller.gains.damping_gain": 1e5}),
        base.override({"controller.gains.pose_gain": 6.0, "trust.energy_floor": 1e-3}),
    ]
    batch = simulate_batch(scenarios)
    assert batch.is_valid.tolist() == [True, True, True, False, True]
    found = batch.metrics()
    for index in np.flatnonzero(batch.is_valid):
        assert repr(found[index]) == repr(batch.result(index).metrics())
    assert [run["trustworthy"] for run in found] == [1.0, 0.0, 1.0, 0.0, 1.0]
    assert np.isfinite([found[4][f"after_event_{name}"] for name in STEADY_METRICS]).all()
    assert found[4]["position_rms_m"] != found[0]["position_rms_m"]


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_bits_do_not_depend_on_vector_width_batch_size_or_emitter(name):
    scenarios = runs(name, DURATIONS[name.startswith("adept")], count=3)
    record = require_same_bits(scenarios)
    assert np.isfinite(record).all()
    assert np.ptp(record[-1], axis=1).max() > 0.0


def test_runs_with_equal_plants_share_one_and_have_the_numbers_of_their_own():
    base, masses = cp.Scenario.load("adept-paper").replace(duration=0.05, events=()), (1.0, 2.0)
    changes = [{"controller.gains.pose_gain": g, "cell.payload.mass": m} for g in (5.0, 6.0) for m in masses]
    scenarios = [base.override(change) for change in changes]
    first = preparation.prepare(scenarios)
    again = preparation.prepare(scenarios, first.plants)
    assert {*again.plants} == {*first.plants}
    assert len({*first.plants}) == len(masses)
    for run, scenario in enumerate(scenarios):
        alone = preparation.prepare([scenario])
        for found in (first, again):
            assert_array_equal(found.values[run], alone.values[0])
            assert_array_equal(found.signals[run], alone.signals[0])
            assert_array_equal(found.plants[run].start.last, alone.plants[0].start.last)
    numbers = first.values[:, np.isfinite(first.values).all(axis=0)]
    assert (np.ptp(numbers, axis=0) > 0.0).sum() > 1


@pytest.mark.slow
def test_batches_of_one_simulator_share_their_code_and_have_the_bits_of_any_other():
    scenarios = runs("adept-paper", 0.05, count=3)
    simulator = BatchSimulator(machine=NumpyMachine)
    whole, code = simulator.run(scenarios).samples, simulator._program
    alone = simulator.run(scenarios[2:]).samples  # numbers that were inputs stay inputs
    assert simulator._program is code
    folded = BatchSimulator(machine=NumpyMachine).run(scenarios[2:]).samples  # no number is an input
    for name, values in folded.items():
        assert_array_equal(values[0], whole[name][2], err_msg=name)
        assert_array_equal(alone[name], values, err_msg=name)
    simulator.run([scenario.override({"controller.gains.damping_gain": 31.0}) for scenario in scenarios])
    assert simulator._program is not code


def test_blocks_of_runs_and_later_batches_leave_samples_as_they_are(monkeypatch):
    """The record of each block is in the same memory."""
    scenarios, simulator = runs("adept-paper", 0.05, 4), BatchSimulator()
    together, kept = simulator.run(scenarios).samples, simulator.run(scenarios[:1]).samples
    monkeypatch.setattr("coop_pin.batch.simulate.LARGEST_BLOCK", 3)
    in_blocks = simulator.run(scenarios).samples
    for name, values in together.items():
        assert_array_equal(in_blocks[name], values, err_msg=name)
        assert_array_equal(kept[name][0], values[0], err_msg=name)


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
        cp.run(scenarios[2])
    for index in (0, 1):
        wanted = cp.run(scenarios[index]).data
        for name in ("configuration", "torque", "internal_wrench", "seen_pose_error"):
            assert_allclose(batch.result(index).data[name], wanted[name], rtol=0, atol=1e-9)
    assert not np.allclose(batch.samples["torque"][0], batch.samples["torque"][1])


def test_samples_that_do_not_fit_are_refused_before_they_are_made(monkeypatch):
    monkeypatch.setattr("coop_pin.arrays.free_memory", lambda: 1_000_000)
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


def small_program():
    lanes, uniforms = Layout(), Layout()
    lanes.add("x", 2)
    uniforms.add("h")
    kernel = Kernel("advance", lanes, uniforms)
    x = kernel.read("x")
    kernel.write("x", [x[0] + kernel.uniform("h") * x[1], np.exp(x[1])])
    return Program([kernel], lanes, 2, 0, [Instruction(0, 0), Instruction(RECORD, 0)])


def run_small_program():
    block = np.array([[1.0, 2.0, 3.0], [0.0, 1.0, -1.0]])
    record = LlvmMachine(small_program()).run(block, np.array([[0.5]]), np.zeros((1, 0, 3)))
    assert_allclose(record[0], [[1.0, 2.5, 2.5], np.exp([0.0, 1.0, -1.0])], rtol=4e-16)


def test_the_bits_of_a_small_program_do_not_depend_on_the_vector_width():
    block = np.vstack((np.arange(11.0), 0.3 * np.arange(11.0)))
    machines = [
        NumpyMachine(small_program()),
        *(LlvmMachine(small_program(), width) for width in (1, 2, 4, 8)),
    ]
    given = np.array([[0.1]]), np.zeros((1, 0, 11))
    records = [machine.run(block.copy(), *given) for machine in machines]
    for record in records:
        assert_array_equal(record, records[0])


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """The folder and the file of the small program's code."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    run_small_program()
    (file,) = (tmp_path / "coop_pin" / "compiled").iterdir()
    return file


def test_compiled_code_is_kept(kept, monkeypatch):
    assert kept.stat().st_mode & 0o777 == 0o600
    assert kept.parent.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr("llvmlite.binding.TargetMachine.emit_object", None)
    run_small_program()


@pytest.mark.parametrize(
    "spoil",
    [
        lambda file: file.write_bytes(file.read_bytes()[:-100]),
        lambda file: file.write_bytes(b""),
        lambda file: file.write_bytes(file.read_bytes()[:-1] + b"?"),
        lambda file: file.chmod(0o660),  # others may have written it
        lambda file: (file.unlink(), file.mkdir()),
    ],
    ids=["truncated", "empty", "changed", "writable by a group", "a folder"],
)
def test_code_that_is_damaged_or_may_be_anothers_is_compiled_again(spoil, kept, monkeypatch):
    spoil(kept)
    compiled, emit = [], llvm.TargetMachine.emit_object
    monkeypatch.setattr(llvm.TargetMachine, "emit_object", lambda *args: compiled.append(args) or emit(*args))
    run_small_program()
    assert len(compiled) == 1
    run_small_program()
    assert len(compiled) == (2 if kept.is_dir() else 1)


def test_code_under_the_name_of_another_program_is_not_run(kept):
    program = small_program()
    program.kernels[0].write("x", [1.0, 2.0])
    other = LlvmMachine(program).run(np.zeros((2, 1)), np.array([[0.5]]), np.zeros((1, 0, 1)))
    (file,) = set(kept.parent.iterdir()) - {kept}
    kept.write_bytes(file.read_bytes())
    assert_array_equal(other[0], [[1.0], [2.0]])
    run_small_program()


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    run_small_program()


@pytest.mark.slow
def test_programs_that_are_compiled_at_the_same_time_keep_one_whole_file(kept):
    kept.unlink()
    script = "from test_batch import run_small_program; run_small_program()"
    folders = os.pathsep.join((str(Path(__file__).parent), *sys.path))
    started = [
        subprocess.Popen([sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": folders})
        for _ in range(3)
    ]
    assert [process.wait(timeout=120.0) for process in started] == [0, 0, 0]
    assert list(kept.parent.iterdir()) == [kept]


def test_without_llvmlite_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    with pytest.raises(MissingExtraError) as caught:
        LlvmMachine(small_program())
    assert caught.value.extra == "fast"
    for file in Path(batch_package.__file__).parent.glob("*.py"):
        assert not re.search(r"^(import|from) llvmlite", file.read_text(encoding="utf-8"), re.MULTILINE)
