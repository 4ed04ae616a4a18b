"""Remedies of findings executed, planar and spatial, where ``test_check`` has the other cell or none."""

import numpy as np
import pytest
from compliant_cells import with_grasps
from forecast_cells import drawn
from law_cells import servo_cell
from put_downs import put_down
from test_check import assert_a_remedy_works
from test_plausibility import cell_of

import coop_pin as cp
from coop_pin.base.spatial import make_pose


def scaled_gain(scenario, factor):
    gain = factor * np.array(scenario.controller.gains.sliding_gain)
    return scenario.override({"controller.gains.sliding_gain": gain.tolist()})


def at_servos(kind, command):
    """A soft admittance whose wrench comes ten ticks late."""
    damping = {"planar": [25.0, 25.0, 0.05], "spatial": [25.0] * 3 + [0.5] * 3}[kind]
    law = cp.laws.Admittance(command=command, force_path={"kind": "late"})
    late = {"controller.gains.admittance_damping": damping, "sensors.wrist.delay": 10}
    return servo_cell(kind, command, controller=law, **late)


def turned_grasp():
    """Two Pandas, the left tip turned about its own z until the last joint meets its limit on the way."""
    scenario, turn = cell_of("spatial"), 1.2
    grasp, posture = scenario.cell.grasps["left"].matrix, [*scenario.cell.arms["left"].posture]
    posture[6] += turn
    rpy = cp.Pose.from_matrix(grasp @ make_pose((0.0, 0.0, 0.0), (0.0, 0.0, turn))).rpy
    return scenario.override({"cell.grasps.left.rpy": rpy, "cell.arms.left.posture": posture})


def on_pads():
    """A bar between two pads in the plane, pressed with 3 N."""
    scenario = cp.Scenario.load("adept-compliant", {"events": []})
    pad = {"mu": 0.3, "radius": 0.02}
    pads = {"left": pad | {"press": "x"}, "right": pad | {"press": "-x"}}
    return scenario.replace(squeeze=scenario.squeeze.scaled(0.3)).override({"cell.pads": pads})


def palms():
    return cp.Scenario.load("two-pandas-palms", {"events": []})


def in_degrees(folder):
    """A planar cell whose first posture is in degrees."""
    scenario = cp.suggest(drawn(folder, 1, "rigid", 2), poses=5).scenario
    name, arm = next(iter(scenario.cell.arms.items()))
    return scenario.override({f"cell.arms.{name}.posture": np.degrees(arm.posture).tolist()})


def slow_springs():
    soft = with_grasps(cell_of("spatial"), (5e4,) * 3 + (5e3,) * 3)
    return cp.suggest(soft, poses=5).scenario.override({"clock.rate_hz": 100.0})


CASES = {
    "weak drive, planar": lambda _: (
        cell_of("planar").override({"cell.arms.left.torque_limits": 2.0}),
        "static torque",
        "error",
    ),
    "grasp, spatial": lambda _: (turned_grasp(), "reach", "error"),
    "pads, planar": lambda _: (on_pads(), "friction", "error"),
    **{
        f"{kind} without a squeeze, {name}": lambda _, cell=cell, kind=kind, severity=severity: (
            cell().replace(squeeze={}),
            kind,
            severity,
        )
        for name, cell in (("planar", on_pads), ("spatial", palms))
        for kind, severity in (("squeeze", "warning"), ("friction", "error"))
    },
    "posture, planar": lambda folder: (in_degrees(folder), "posture", "warning"),
    **{
        f"{command}, {kind}": lambda _, kind=kind, command=command, name=name: (
            at_servos(kind, command),
            name,
            "error",
        )
        for kind in ("planar", "spatial")
        for command, name in (("velocity", "admittance stability"), ("position", "closed loop"))
    },
    "springs at 100 Hz, spatial": lambda _: (slow_springs(), "grasp stability", "error"),
    "table, spatial": lambda _: (scaled_gain(put_down((0.4, -0.3, 0.9)), 2.0), "table force", "error"),
}


BEYOND = {
    # a planar cell whose task is stated tighter, and a spatial one on springs with the default limits
    "planar": lambda folder: drawn(folder, 1, "rigid", 2).override({"task.position": 2e-6}),
    "spatial": lambda folder: drawn(folder, 20261203, "compliant", 11),
}


@pytest.mark.parametrize(
    "kind", [pytest.param("planar", marks=pytest.mark.gate), pytest.param("spatial", marks=pytest.mark.slow)]
)
@pytest.mark.filterwarnings("ignore::coop_pin.errors.ScenarioWarning")
def test_errors_beyond_the_task_have_a_slower_motion_as_remedy_which_a_proposal_has(kind, tmp_path):
    """The remedy of the stated speed is executed, and is the proposal; a run keeps the task with it."""
    stated = BEYOND[kind](tmp_path)
    suggested = cp.suggest(stated, poses=21)
    slower, motion = suggested.scenario, stated.motion
    assert slower.motion.duration == 2.0 * motion.duration
    assert slower.duration - stated.duration == pytest.approx(motion.duration)
    assert suggested.changes[0].startswith("motion SLOWED")
    faster = slower.override({"motion.duration": motion.duration, "duration": stated.duration})
    doubts = {finding.kind: finding for finding in cp.check(faster, poses=21).of("error", "warning")}
    beyond = doubts.pop("steady error")
    assert beyond.value > beyond.limit
    assert faster.override(beyond.remedy) == slower
    assert {finding.kind for finding in cp.check(slower, poses=21).of("error", "warning")} <= doubts.keys()
    result = cp.run(slower, warn=False, engine="auto")
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coop_pin.errors.ScenarioWarning")
@pytest.mark.parametrize("case", CASES)
def test_a_remedy_cures_its_finding_and_brings_no_other_error(case, tmp_path):
    assert_a_remedy_works(*CASES[case](tmp_path))
