"""Laws exported as C99: compiled with all warnings and sanitizers, against the Python law and the oracle."""

import ctypes
import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from cells import ANCHORED, RIGID, SCENARIOS
from law_cells import servo_cell
from numpy.testing import assert_array_equal
from scipy.linalg import expm
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, NameNotFoundError, TracingError
from coop_pin.cli import main
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.control.measurement import DESIRED
from coop_pin.model.arm_model import ArmKinematics, ArmModel
from coop_pin.simulation.build_controller import build_controller
from coop_pin.tracing.c_emitter import CEmitter, c_number
from coop_pin.tracing.evaluation import evaluate
from coop_pin.tracing.tape import FOLD, Subroutine, Tape, operands
from coop_pin.tracing.traced_array import inputs

CC = shutil.which("gcc") or shutil.which("cc")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
pytestmark = pytest.mark.skipif(CC is None, reason="there is no C compiler")


def compiled(output, *files, options=()):
    subprocess.run([CC, *STRICT, *options, *map(str, files), "-o", output, "-lm"], check=True)
    return output


def self_test(law, folder, *options):
    program = compiled(folder / "self_test", law.source, law.self_test, options=options)
    return subprocess.run([program], capture_output=True, text=True, timeout=60.0)


def measured(cell):
    """The anchored law of a test cell, with a pushed payload so that everything moves."""
    base = SCENARIOS[cell]().replace(controller=ANCHORED[cell], events=(), beyond_bound=True)
    push = {"kind": "wrench-pulse", "time": 0.004, "duration": 0.02, "wrench": (9, 5, 0, 0, 0, 0.5)}
    return base.replace(events=(push,)).override({"controller.anchor_bias": [2e-3, 1e-2]})


# ---------------------------------------------------------------- the code


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_exported_laws_compile_without_warnings_and_pass_their_self_test(cell, tmp_path):
    law = cp.export.export_c(measured(cell), "left", tmp_path, ticks=12)
    done = self_test(law, tmp_path, *SANITIZED)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.match(r"12 ticks, largest difference \S+ N m: passed\n", done.stdout)


@pytest.mark.parametrize("cell", by_default(SCENARIOS, "planar"))
def test_a_law_with_a_dead_zone_is_exported(cell, tmp_path):
    law = ANCHORED[cell].replace(force_path={"kind": "none"}, integral_dead_zone=(1e-4, 1e-3))
    scenario = SCENARIOS[cell]().replace(controller=law, events=())
    assert (
        self_test(cp.export.export_c(scenario, "left", tmp_path, ticks=12), tmp_path, "-O2").returncode == 0
    )


@pytest.mark.parametrize(
    ("cell", "kind"), by_default([("planar", "position"), ("spatial", "velocity")], ("planar", "position"))
)
def test_laws_that_command_servos_are_exported_with_what_they_send(cell, kind, tmp_path):
    """The header names velocities or positions with their unit, and the code is that of the Python law."""
    scenario = servo_cell(
        cell, kind, duration=0.1, **{"sensors.wrist": {}, "controller.force_path.kind": "late"}
    )
    law = cp.export.export_c(scenario, "right", tmp_path, ticks=12)
    done = self_test(law, tmp_path, *SANITIZED)
    assert (done.returncode, done.stderr) == (0, "")
    unit = {"velocity": "rad/s", "position": "rad"}[kind]
    assert re.match(rf"12 ticks, largest difference \S+ {unit}: passed\n", done.stdout)
    header, drives = law.header.read_text(), len(scenario.cell.arms["right"].posture)
    assert f"Set the {kind} of the {drives} drives, {unit}," in header
    assert f"double *{kind});" in header
    assert "torque" not in header.replace("holding_torque", "").split("typedef")[-1]


@pytest.mark.parametrize(
    ("cell", "law", "path"),
    [
        ("planar", "all", "messages"),
        pytest.param("spatial", "consensus", "messages", marks=pytest.mark.gate),
        pytest.param("planar", "all", "learned-load", marks=pytest.mark.slow),
        pytest.param("spatial", "all", "consensus", marks=pytest.mark.slow),
    ],
)
def test_laws_that_hear_others_are_exported_with_what_they_say_and_hear(cell, law, path, tmp_path):
    """The header names the numbers that cross; the messages are those of the Python law."""
    fields = ANCHORED[cell].model_dump(exclude={"kind", "force_path"}) | {"averaging": law}
    network = {"network": {"loss": 0.3, "delay": 1}, "duration": 0.2, "events": [], "sensors.wrist": {}}
    fields |= {"force_path": {"kind": path}}
    scenario = SCENARIOS[cell]().override(network | {"controller": {"kind": "mean-pose"} | fields})
    exported = cp.export.export_c(scenario, "left", tmp_path, ticks=12)
    done = self_test(exported, tmp_path, *SANITIZED)
    assert (done.returncode, done.stderr) == (0, "")
    header, k_0 = exported.header.read_text(), scenario.cell.task_rows.size
    size = 6 + k_0 + {"messages": k_0 + 1, "consensus": 2 * k_0, "learned-load": 2}[path]
    assert f"double heard_1_right[{size}]; /* latest message of arm 'right' */" in header
    assert f"tells the others {size} numbers" in header
    off = exported.self_test.read_text().replace("message[index] == expected[index] ||", "1.0 +")
    exported.self_test.write_text(off)
    assert self_test(exported, tmp_path).returncode == 1


@pytest.mark.parametrize(
    ("name", "arm"),
    by_default([("adept-compliant", "left"), ("three-ur5-handover", "third")], ("adept-compliant", "left")),
)
def test_laws_on_grasps_that_give_and_let_go_are_exported(name, arm, tmp_path):
    """With matrices that turn, through a release; a law that needs the plan for its share is refused."""
    scenario = cp.Scenario.load(name)
    events = (cp.events.Release(time=0.004, arm=arm),) if len(scenario.cell.arms) > 2 else ()
    scenario = scenario.replace(events=events, duration=1.0)
    done = self_test(cp.export.export_c(scenario, arm, tmp_path, ticks=12), tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    own = {"controller.payload_mass": 5.0, "controller.force_path.kind": "none", "sensors.wrist": {}}
    if events:
        with pytest.raises(ArgumentError, match="plan of the grasps"):
            cp.export.export_c(scenario.override(own), arm, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGID)
def test_every_scenario_of_the_catalogue_is_exported(name, tmp_path):
    scenario = cp.Scenario.load(name)
    for arm in scenario.cell.arms:
        assert self_test(cp.export.export_c(scenario, arm, tmp_path), tmp_path, "-O2").returncode == 0


def test_the_self_test_fails_when_a_torque_is_off(tmp_path):
    law = cp.export.export_c(measured("planar"), "left", tmp_path, ticks=3)
    text = law.source.read_text()
    law.source.write_text(re.sub(r"(torque\[1\] = \w+);", r"\1 + 1e-9;", text))
    done = self_test(law, tmp_path)
    assert done.returncode == 1
    assert "FAILED" in done.stdout


def test_operations_are_counted_as_they_are_written(tmp_path):
    law = cp.export.export_c(measured("planar"), "right", tmp_path, ticks=1)
    step = law.source.read_text().split("int right_step")[1]
    signs = {"add": " + ", "sub": " - ", "mul": " * ", "div": " / ", "sqrt": "sqrt("}
    assert law.flops == {name: step.count(sign) for name, sign in signs.items()}
    assert sum(law.flops.values()) > 300
    assert not re.search(r"\b(for|while|if|malloc)\b", step)


def test_every_operation_and_constant_has_the_bits_of_the_oracle(tmp_path):
    tape, inner = Tape(), Tape()
    x, y = inputs(tape, 2)
    twice = Subroutine("twice", inner, [*operands(inner, [inputs(inner) * 2.0]), 3.0, -0.1])
    numbers = [x + y, x - y, x * y, x / y, -x, abs(y), abs(x) ** 0.5, x < y, np.exp(x), np.sin(y), x * np.pi]
    numbers += [np.where(x > y, x, -0.0), np.tanh(y), np.arctan2(x, y), math.inf, 0.1 * x]
    outputs = operands(tape, numbers)
    outputs += tape.call(twice, operands(tape, [y]))
    emitter = CEmitter()
    stores = [(f"y[{index}]", number) for index, number in enumerate(outputs)]
    emitter.define("void f(const double *x, double *y)", tape, stores, "x[{}]".format)
    (tmp_path / "f.c").write_text("void f(const double *x, double *y);\n" + emitter.text())
    library = ctypes.CDLL(compiled(tmp_path / "f.so", tmp_path / "f.c", options=("-O3", "-shared", "-fPIC")))
    for given in np.random.default_rng(1).normal(scale=3.0, size=(50, 2)):
        found = np.empty(len(outputs))
        library.f(given.ctypes.data_as(ctypes.c_void_p), found.ctypes.data_as(ctypes.c_void_p))
        assert_array_equal(found, np.array(evaluate(tape, outputs, list(given)), dtype=float))
    used = {operation.name for operation in tape.operations}
    assert used >= set(FOLD)
    assert [c_number(value) for value in (math.nan, -math.inf, -0.0)] == ["NAN", "(-INFINITY)", "(-0x0.0p+0)"]


@pytest.mark.parametrize(
    ("cell", "ticks"),
    [("planar", 3_000), *(pytest.param(cell, 1_000_000, marks=pytest.mark.slow) for cell in SCENARIOS)],
)
def test_a_million_ticks_of_c_are_those_of_the_python_law(cell, ticks, tmp_path):
    """Swinging joints, noisy wrenches, saturation at times; the state is carried on by each side."""
    scenario = measured(cell)
    law, python = (
        cp.export.export_c(scenario, "left", tmp_path),
        build_controller(scenario).controllers["left"],
    )
    options = ("-O2", "-shared", "-fPIC")
    library = ctypes.CDLL(compiled(tmp_path / "law.so", law.source, options=options))
    arm, rows = scenario.cell.arms["left"], scenario.cell.task_rows
    kinematics = ArmKinematics(arm, scenario.cell.grasps["left"].matrix, rows)
    rng, posture = np.random.default_rng(2), np.array(arm.posture)
    n, k, motion, drive = len(posture), rows.size, scenario.motion.at(0.0), ArmModel(arm).drive
    reference = ArmReference(
        motion.X_WP_d, rows.select(motion.V_WP_d), rows.select(motion.A_WP_d), rng.normal(size=k)
    )
    desired = np.concatenate([np.ravel(getattr(reference, name)) for name in DESIRED])
    state, torque, scale, worst = np.zeros(1000), np.zeros(n), 0.0, 0.0
    memory, wanted = None, np.zeros(n)
    for tick in range(ticks):
        t = tick * scenario.clock.period
        angles, cut = posture + 0.1 * np.sin(3.0 * t + np.arange(n)), rng.random(n) < 0.02
        q, v = drive @ angles, drive @ (0.3 * np.cos(3.0 * t + np.arange(n)))
        wrench, hold = rng.normal(size=k), rng.normal(size=n)
        reported = np.where(cut, 0.9, 1.0) * wanted
        view = kinematics.view(angles)
        seen = ArmMeasurement(
            t,
            q,
            v,
            view.pose,
            view.jacobian @ v,
            view.jacobian,
            wrench,
            cut,
            1.0,
            None,
            np.inf,
            hold,
            reported,
        )
        given = np.concatenate(([t], q, v, cut, wrench, [1.0], hold, reported))
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (given, desired, state, torque)]
        if tick == 0:
            assert library.left_start(*pointers[:3]) == 1
            memory = python.init(seen, reference)
        assert library.left_step(*pointers) == 1
        wanted, memory = python.step(seen, reference, memory)
        scale, worst = max(scale, np.abs(wanted).max()), max(worst, np.abs(torque - wanted).max())
    print(f"{ticks} ticks: {worst:.2e} of {scale:.2e} N m")
    assert 0.0 < worst < 1e-12 * scale


def test_a_singular_arm_is_told_by_the_return_value(tmp_path):
    scenario = SCENARIOS["planar"]()
    law = cp.export.export_c(scenario, "left", tmp_path, ticks=2)
    stretched = ArmModel(scenario.cell.arms["left"]).drive @ [0.3, 0.0, 0.0]
    text = law.self_test.read_text()
    text = re.sub(
        r"(measured\[\] = \{\n    \{\S+) \{[^}]*\}", rf"\1 {{{', '.join(map(str, stretched))}}}", text
    )
    law.self_test.write_text(re.sub(r"good &= error <= .*", "", text))  # only what the functions return
    assert self_test(law, tmp_path).returncode == 1


# ---------------------------------------------------------------- what can be exported


class Law(cp.ArmController):
    """A user's law."""

    def __init__(self, scenario, arm, mode="spring"):
        self.rows, self.mode, self.steps = scenario.cell.task_rows, mode, 0

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        error = self.rows.pose_error(measurement.payload_pose, reference.pose)
        self.steps += self.mode == "hidden"
        match self.mode:
            case "branch":
                error = error if error[0] > 0.0 else 2.0 * error
            case "scipy":
                error = expm(np.diag(error)) @ error
            case "hidden":
                error = error * self.steps
        damping = 20.0 * measurement.v
        return cp.ArmCommand(-measurement.payload_jacobian.T @ (300.0 * error) - damping, state)


class OfTheCell(cp.CellController):
    """A law that sees all arms."""

    def __init__(self, scenario):
        pass

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        raise NotImplementedError


def users(target, **options):
    controller = {"kind": "user", "target": f"{__name__}:{target}", "options": options}
    return SCENARIOS["planar"]().replace(controller=controller, events=())


def test_a_users_law_is_exported_if_it_can_be_traced(tmp_path):
    law = cp.export.export_c(users("Law"), "right", tmp_path, ticks=5)
    assert self_test(law, tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("mode", "reason"),
    [("branch", "branches"), ("scipy", "cannot be traced|plain float"), ("hidden", "state")],
)
def test_a_law_that_cannot_be_traced_is_refused_and_the_reason_told(mode, reason, tmp_path):
    with pytest.raises(TracingError, match=reason) as caught:
        cp.export.export_c(users("Law", mode=mode), "left", tmp_path)
    assert "'left'" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_files_are_written_into_new_folders_and_over_those_of_before(tmp_path):
    folder = tmp_path / "new" / "folder"
    laws = [cp.export.export_c(cp.Scenario.load("adept-paper"), "left", folder, ticks=2) for _ in range(2)]
    assert laws[0] == laws[1]
    assert {path.name for path in folder.iterdir()} == {"left.h", "left.c", "left_self_test.c"}


def test_what_is_no_law_of_one_arm_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="all arms"):
        cp.export.export_c(users("OfTheCell"), "left", tmp_path)
    with pytest.raises(NameNotFoundError):
        cp.export.export_c(SCENARIOS["planar"](), "middle", tmp_path)
    with pytest.raises(ArgumentError, match="ticks"):
        cp.export.export_c(SCENARIOS["planar"](), "left", tmp_path, ticks=0)


def test_the_command_writes_the_files_and_prints_how_to_test_them(tmp_path, capsys):
    words = ["export", "adept-paper", "--to", "c", "--arm", "left", "--out", str(tmp_path), "--ticks", "2"]
    assert main([*words, "--controller.gains.pose-gain", "7"]) == 0
    assert {file.name for file in tmp_path.iterdir()} == {"left.c", "left.h", "left_self_test.c"}
    out = capsys.readouterr().out
    assert str(tmp_path / "left_self_test.c") in out
    assert "operations a step" in out
