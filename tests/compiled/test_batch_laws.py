"""Controllers in batches: every law of the package is traced or listed with the reason, and users' own."""

import logging
import re
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from batches import require_same_samples
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose
from numpy_machine import NumpyMachine
from scipy.linalg import expm

import coop_pin as cp
from coop_pin import control
from coop_pin.base.errors import TracingError
from coop_pin.compiled import BatchSimulator, simulate_batch, support
from coop_pin.compiled.constants import run_constants
from coop_pin.compiled.laws.law_code import require_agreement as agree
from coop_pin.compiled.laws.law_code import trace_law, traced_call
from coop_pin.compiled.laws.support import shaken_ticks
from coop_pin.control import CellCommand, CellController, MeanPose, Symmetric
from coop_pin.description.controller import PackageLaw
from coop_pin.simulation.build_controller import build_controller
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.store import SweepStore

GAINS = {"pose_gain": 2.0, "sign_gain": 0.1, "damping_gain": 20.0, "transient_rate": 5.0}
REDUNDANT = {"controller": {"kind": "sliding-mode-redundant", "gains": GAINS}}
WRIST, NO_PATH = {"sensors.wrist": {}}, {"kind": "none"}


def of_kind(kind, **gains):
    return {"controller": {"kind": kind, "gains": gains}}


LAWS = {
    "sliding-mode": [
        ("planar", {}),
        ("planar", {"controller.force_path": {"kind": "late"}}),
        ("planar", {"controller.switching": {"kind": "saturation"}}),
        ("planar", {"controller.switching": {"kind": "tanh"}}),
        ("spatial", {}),
        ("five-joint-pair", {}),
    ],
    "sliding-mode-redundant": [("two-pandas-box", REDUNDANT)],
    "payload-space": [
        ("planar", {"controller": ANCHORED["planar"]}),
        ("spatial", {"controller": ANCHORED["spatial"]}),
        (
            "spatial",
            {"controller": ANCHORED["spatial"].replace(payload_mass=2.0, force_path=NO_PATH), **WRIST},
        ),
        ("two-pandas-box", {}),
        *[
            (cell, {"controller": ANCHORED[cell].replace(gain_axes="payload")})
            for cell in ("planar", "spatial")
        ],
        *[
            (
                cell,
                {"controller": ANCHORED[cell].replace(force_path=NO_PATH, integral_dead_zone=(1e-4, 1e-3))},
            )
            for cell in ("planar", "spatial")
        ],
    ],
    "mean-pose": [
        (cell, {"controller": MeanPose(**ANCHORED[cell].model_dump(exclude={"kind"}))})
        for cell in ("planar", "spatial")
    ],
    "symmetric": [
        (
            cell,
            {"controller": Symmetric(relative_gain=0.3, **ANCHORED[cell].model_dump(exclude={"kind"}))},
        )
        for cell in ("planar", "spatial")
    ],
    "zeroed at grasp": [
        ("spatial", {"controller.zero_at_grasp": True}),
        ("planar", {"controller.zero_at_grasp": True}),
    ],
    "prescribed-performance": [
        (cell, of_kind("prescribed-performance")) for cell in ("planar", "spatial", "two-pandas-box")
    ],
    "admittance": [
        (
            cell,
            of_kind("admittance")
            | {f"controller.{name}": value for name, value in law.items()}
            | {"actuators.servo": {"command": law["command"], "rate_hz": rate}, **WRIST},
        )
        for cell, rate, law in (
            ("planar", 80.0, {"command": "velocity", "force_path": {"kind": "late"}}),
            ("planar", 80.0, {"command": "position", "follows": "leader"}),
            ("spatial", 250.0, {"command": "velocity"}),
            ("spatial", 250.0, {"command": "position", "force_path": {"kind": "late"}}),
            ("two-pandas-box", 500.0, {"command": "position"}),
        )
    ],
    "leader-follower": [
        (cell, of_kind("leader-follower") | WRIST) for cell in ("planar", "spatial", "two-pandas-box")
    ],
}
"""Cells and changes in which each law is traced."""
UNTRACEABLE = {
    "adaptive": "Pinocchio",
    "computed-torque": "Pinocchio",
    "object-impedance": "Pinocchio",
    "torque-qp": "Pinocchio",
}
"""Laws that are not, and what they compute with."""
SLOW = {"two-pandas-box", "five-joint-pair"}


def scenario_with(cell, changes):
    scenario = SCENARIOS[cell]() if cell in SCENARIOS else cp.Scenario.load(cell)
    return scenario.replace(duration=0.05, events=(), beyond_bound=True).override(changes)


def test_every_law_of_the_package_is_traced_or_listed():
    kinds = {law.model_fields["kind"].default for law in get_args(PackageLaw)}
    assert kinds == {*LAWS, *UNTRACEABLE} - {"zeroed at grasp"}


@pytest.mark.parametrize(
    ("cell", "changes"),
    [
        pytest.param(cell, changes, id=f"{name}-{index}", marks=[pytest.mark.slow] if cell in SLOW else [])
        for name, cases in LAWS.items()
        for index, (cell, changes) in enumerate(cases)
    ],
)
def test_traced_laws_are_the_laws_themselves(cell, changes):
    """At the ticks of a run that is shaken, with the memory that each carries on."""
    scenario = scenario_with(cell, changes)
    run = cp.Simulation(scenario, build_controller(scenario))
    constants = run_constants(scenario, run)
    ticks = shaken_ticks(scenario)
    assert support(scenario) is None
    law, rows = build_controller(scenario), scenario.cell.task_rows
    start, step = trace_law(law, partial(traced_call, constants.arms, rows, ticks[0], False))
    agree(start, step, ticks)
    torques = np.array([np.concatenate([own.torque for own in tick]) for tick in ticks])
    assert np.ptp(torques, axis=0).min() > 1e-4
    step.torque[0] = step.tape.apply("add", step.torque[0], float(1e-9 * np.abs(torques).max()))
    with pytest.raises(TracingError, match="differs"):
        agree(start, step, ticks)


@pytest.mark.parametrize("name", UNTRACEABLE)
def test_laws_that_cannot_be_traced_say_why(name):
    assert UNTRACEABLE[name] in support(scenario_with("planar", of_kind(name)))


def test_laws_use_neither_math_nor_scipy():
    for file in Path(control.__file__).parent.rglob("*.py"):
        modules = re.findall(r"^(?:from|import) (\S+)", file.read_text(encoding="utf-8"), re.MULTILINE)
        assert not [module for module in modules if module.split(".")[0] in ("math", "scipy")], file.name


LEADER = {"follower_damping": 20.0, "follower_stiffness": 20.0, "admittance_damping": 100.0}


@pytest.mark.parametrize(
    ("cell", "changes", "path"),
    [
        ("planar", of_kind("leader-follower", **LEADER) | WRIST, "controller.gains.pose_gain"),
        ("planar", of_kind("prescribed-performance"), "controller.gains.velocity_gain"),
        *(
            pytest.param("spatial", of_kind(name, **options) | WRIST, path, marks=pytest.mark.slow)
            for name, options, path in (
                ("leader-follower", LEADER, "controller.gains.pose_gain"),
                ("prescribed-performance", {}, "controller.gains.velocity_gain"),
            )
        ),
    ],
)
def test_whole_runs_of_laws_in_classes_are_those_of_coop_pin_run(cell, changes, path):
    """Two runs whose numbers differ inside the objects of the law."""
    base = scenario_with(cell, changes)
    scenarios = [base.override({path: value}) for value in (1.0, 1.5)]
    batch = simulate_batch(scenarios)
    assert batch.is_valid.all()
    for index, scenario in enumerate(scenarios):
        require_same_samples(batch.result(index).data, cp.run(scenario, warn=False).data)
    assert not np.allclose(batch.samples["torque"][0], batch.samples["torque"][1])


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_laws_with_one_plant_that_differ_in_more_than_numbers_have_their_own_code(cell):
    """All switching functions have one number, so that their runs would fit each other's code."""
    simulator = BatchSimulator(machine=NumpyMachine)
    torques = []
    for switching in ({"kind": "saturation", "width": 9.0}, {"kind": "tanh", "width": 9.0}):
        changes = {"controller.switching": switching, "controller.gains.sign_gain": 1.0}
        scenario = scenario_with(cell, changes).replace(duration=0.03)
        batch = simulator.run([scenario])
        require_same_samples(batch.result(0).data, cp.run(scenario, warn=False).data)
        torques.append(batch.samples["torque"])
    assert not np.allclose(*torques, rtol=1e-9, atol=0.0)


# ---------------------------------------------------------------- users' controllers


class Law(cp.ArmController):
    """A user's law: a spring and damper, or one of the ways in which it cannot be traced."""

    def __init__(self, scenario, arm, mode="spring", stiffness=300.0):
        self.rows, self.mode, self.steps, self.stiffness = scenario.cell.task_rows, mode, 0, stiffness

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        error = self.rows.pose_error(measurement.payload_pose, reference.pose)
        damping = 20.0 * measurement.v
        match self.mode:
            case "branch":
                error = error if error[0] > 0.0 else 2.0 * error
            case "scipy":
                error = expm(np.diag(error)) @ error
            case "hidden":
                self.steps += 1
                error = error * self.steps
            case "raises":
                raise ValueError("no such law")
            case "shape":
                return cp.ArmCommand(np.zeros(7), state)
            case "state":
                state = (error,)
        return cp.ArmCommand(-measurement.payload_jacobian.T @ (self.stiffness * error) - damping, state)


class OfTheCell(CellController):
    """A law that sees all arms: each pulls at the mean of what they see, with an integral."""

    def __init__(self, scenario, stiffness=300.0):
        self.rows, self.stiffness, self.period = scenario.cell.task_rows, stiffness, scenario.clock.period

    def init(self, measurements, references):
        return {"integral": np.zeros(self.rows.size)}

    def step(self, measurements, references, state):
        error = sum(
            self.rows.pose_error(seen.payload_pose, wanted.pose)
            for seen, wanted in zip(measurements, references, strict=True)
        )
        integral = state["integral"] + self.period * error
        pull = self.stiffness * (error + integral)
        torques = [-seen.payload_jacobian.T @ pull - 20.0 * seen.v for seen in measurements]
        return CellCommand(torques, {"integral": integral})


def users(target, cell="planar", **options):
    controller = {"kind": "user", "target": f"{__name__}:{target}", "options": options}
    return scenario_with(cell, {"controller": controller})


@pytest.mark.parametrize("target", ["Law", "OfTheCell"])
@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_a_users_controller_runs_in_a_batch_if_it_can_be_traced(target, cell):
    scenarios = [users(target, cell, stiffness=stiffness) for stiffness in (300.0, 400.0)]
    assert support(scenarios[0]) is None
    batch = simulate_batch(scenarios)
    for index, scenario in enumerate(scenarios):
        require_same_samples(batch.result(index).data, cp.run(scenario, warn=False).data)


REASONS = {
    "branch": "branches",
    "scipy": "cannot be traced|plain float",
    "hidden": "attribute 'steps'",
    "raises": "no such law",
    "shape": "ShapeError",
    "state": "another kind of state",
}


@pytest.mark.parametrize("mode", REASONS)
def test_a_users_controller_that_cannot_be_traced_is_refused_and_the_reason_told(mode):
    scenario = users("Law", mode=mode)
    assert re.search(REASONS[mode], support(scenario))
    with pytest.raises(TracingError, match=REASONS[mode]):
        simulate_batch([scenario])


def test_a_sweep_runs_such_controllers_singly_and_tells_why_once(tmp_path, caplog):
    """Of three controllers in one plan one is in a batch, and the user is told of the others once."""
    cases = {mode: {"controller.options.mode": mode} for mode in ("spring", "branch", "hidden")}
    axes = {"controller.options.stiffness": [300.0, 320.0]}
    plan = SweepPlan(
        base=users("Law", mode="spring", stiffness=300.0), cases={"mode": cases}, axes=axes, engine="compiled"
    )
    with caplog.at_level(logging.WARNING, "coop_pin.sweeps"):
        table = cp.sweep(plan, out=tmp_path, execution=cp.Execution(workers=0, quiet=True)).table
    engines = [record.engine for record in SweepStore(tmp_path).records() if record.metrics]
    assert engines == ["compiled"] * 6
    assert [REASONS[mode] in caplog.text for mode in ("branch", "hidden")] == [True, True]
    assert len(caplog.records) == 2
    torques = table["torque_peak_Nm"].to_numpy()
    single = cp.run(plan.scenario(0), warn=False).metrics()["torque_peak_Nm"]
    assert_allclose(torques[0], single, rtol=1e-9)
    assert len(set(torques.round(9))) == 6
