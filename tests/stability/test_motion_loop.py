"""States of the linear loop along a motion against those of runs, on all kinds of grasps."""

import numpy as np
import pytest
from compliant_cells import anchored, with_grasps

import coop_pin as cp
from coop_pin.base.spatial.internal_wrench import linkage_loads
from coop_pin.feasibility import reachability
from coop_pin.stability.motion_loop import MotionLoop

FILTERED = {"controller.force_path": {"kind": "low-pass", "pole": 0.3}, "controller.gains.force_gain": 0.5}
LATE = {"controller.force_path": {"kind": "late", "delay": 2}}
LEAKY = {"controller.force_path": {"kind": "none"}, "controller.gains.leak": 20.0}
KNOWN = {"controller.zero_at_grasp": True, "controller.knows_deflection": True}
SHORT = {"duration": 0.3, "motion.start_time": 0.02, "motion.duration": 0.2}
QUICK = {"duration": 0.15, "motion.start_time": 0.02, "motion.duration": 0.1}


def on_a_short_line(scenario, **changes):
    """The scenario with a motion so short that its loop is linear, and drives with viscous friction."""
    start, joints = scenario.start, cp.actuators.JointFriction(viscous=2.0)
    z = 2e-4 * (scenario.cell.rows == "full")
    goal = start.replace(xyz=np.add(start.xyz, (4e-4, -3e-4, z)), rpy=np.add(start.rpy, (0.0, 0.0, 1e-3)))
    motion = cp.motions.LineMotion(start=start, goal=goal, start_time=0.05, duration=0.4)
    changes |= {f"cell.arms.{arm}.friction": joints for arm in scenario.cell.arms}
    scenario = scenario.replace(motion=motion, events=(), beyond_bound=True, duration=0.6)
    return scenario.override({"controller.anchor_bias": "none"} | changes)


def palms(name):
    """Two planar arms that press a bar between them with 30 N; two Pandas that press a crate."""
    if name == "spatial":
        scenario = cp.Scenario.load("two-pandas-palms")
        uneven = {"left": 0.3, "right": 0.7}  # the virtual linkage splits the load evenly
        return scenario.override({"cell.load_shares": uneven})
    patch = {"kind": "patch", "mu": 0.6, "radius": 0.014}
    left = patch | {"xyz": (-0.12, 0.0, 0.0), "press": "x"}
    grasps = {"left": left, "right": patch | {"xyz": (0.12, 0.0, 0.0), "press": "-x"}}
    bar = {"kind": "bar", "mass": 1.5, "length": 0.24}
    changes = {"cell.grasps": grasps, "cell.payload": bar, "events": ()}
    scenario = cp.Scenario.load("adept-compliant", changes)
    law = {"controller.force_path.split": "virtual-linkage", "controller.zero_at_grasp": True}
    pressed = {"left": (-30.0, 0.0, 0.0, 0.0, 0.0, 0.0), "right": (30.0, 0.0, 0.0, 0.0, 0.0, 0.0)}
    return scenario.override(law | {"squeeze": pressed})


def cell_of(name, kind):
    """A test cell on rigid grasps, on springs, on a spring and a rigid grasp, or on patches."""
    if kind == "patches":
        return palms(name)
    held = {"rigid": [], "springs": None, "one spring": ["left"]}[kind]
    steps = {"planar": 40, "spatial": 4}[name] if kind != "rigid" else anchored(name).clock.steps_per_tick
    scenario = with_grasps(anchored(name), arms=held, damping_ratio=0.3)
    return scenario.override({"clock.steps_per_tick": steps})


@pytest.mark.parametrize(
    ("name", "kind", "changes"),
    [
        ("planar", "rigid", FILTERED),
        ("planar", "springs", LEAKY),
        ("planar", "patches", SHORT),
        ("spatial", "springs", KNOWN | QUICK),
        pytest.param("planar", "springs", LATE, marks=pytest.mark.gate),
        pytest.param("spatial", "rigid", QUICK, marks=pytest.mark.gate),
        pytest.param("spatial", "one spring", QUICK, marks=pytest.mark.gate),
        pytest.param("spatial", "patches", QUICK, marks=pytest.mark.gate),
    ],
)
def test_the_states_of_the_loop_are_those_of_a_run(name, kind, changes):
    """Within 6 % of the largest position and force, and 8 % of the largest angle; of palms in space 15 %.

    The reference moves within a tick, too, and a loop knows it at ticks: half of one is some per cent. Of
    rigid grasps a run records the wrenches of the torques that acted, a tick later.
    """
    scenario = on_a_short_line(cell_of(name, kind), **changes)
    loop = MotionLoop(scenario, reachability(scenario, poses=5))
    states, data = loop.run()[1:-1], cp.run(scenario, warn=False).data
    last, later = len(states) - 1, int(kind == "rigid")
    x, rows, linear = states[:last, : loop.k], list(scenario.cell.task_rows.indices), loop.rows.are_linear
    internal = states[later : last + later, -loop.m * loop.k :].reshape(last, loop.m, loop.k)
    errors = data.pose_error.values[1 : last + 1, rows]
    wrenches = data.internal_wrench.values[1 : last + 1][..., rows]
    for loop_part, run_part, allowed in (
        (x[:, linear], errors[:, linear], 0.06),
        (x[:, ~linear], errors[:, ~linear], 0.15 if (name, kind) == ("spatial", "patches") else 0.08),
        (internal[..., linear], wrenches[..., linear], 0.06),
    ):
        assert np.abs(loop_part - run_part).max() < allowed * np.abs(run_part).max()


def test_between_poses_the_matrices_are_interpolated():
    """x[k+1] = A(t_k) x[k] + B(t_k) u[k], with random matrices at uneven times of poses."""
    scenario, rng = on_a_short_line(cell_of("planar", "rigid")), np.random.default_rng(5)
    loop = MotionLoop(scenario, reachability(scenario, poses=3))
    times, size = np.array((0.0, 0.1, 0.25, 0.6)), len(loop.first)
    A = rng.normal(size=(4, size, size)) / size
    B = rng.normal(size=(4, size, loop.inputs.shape[1]))
    loop.matrices = times, A, B
    x, expected = loop.first, [loop.first]
    for time, u in zip(loop.ticks[:-1], loop.inputs[:-1], strict=True):
        k = min(int(np.searchsorted(times, time, side="right")) - 1, 2)
        part = (time - times[k]) / (times[k + 1] - times[k])
        x = (1.0 - part) * (A[k] @ x + B[k] @ u) + part * (A[k + 1] @ x + B[k + 1] @ u)
        expected.append(x)
    np.testing.assert_allclose(loop.run(), expected, rtol=1e-9, atol=1e-9)


def test_the_first_state_of_a_squeeze_that_comes_in_is_that_at_the_start():
    """Palms that begin with 30 N of a squeeze on its way to 60 N: what they bear and are to bear."""
    scenario = on_a_short_line(cell_of("planar", "patches"), **SHORT)
    more = {arm: tuple(2.0 * np.array(f)) for arm, f in scenario.squeeze.wrenches.items()}
    ramp = cp.squeezes.RampSqueeze(start=scenario.squeeze.wrenches, goal=more, duration=0.3, start_time=-0.15)
    loop = MotionLoop(scenario.replace(squeeze=ramp), reachability(scenario, poses=3))
    expected = (
        np.array(ramp.at(0.0, scenario.cell.grasps)).reshape(-1, 2, 3) @ scenario.start.matrix[:3, :3].T
    )
    seen = loop.first[-loop.m * loop.k :].reshape(loop.m, loop.k)
    rows = list(scenario.cell.task_rows.indices)
    np.testing.assert_allclose(seen, expected.reshape(-1, 6)[:, rows], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["springs", "patches"])
def test_loads_are_parts_of_the_weight_in_world_axes(kind):
    """By the load shares, of a payload that is turned at the start; by the virtual linkage on patches."""
    scenario = on_a_short_line(cell_of("spatial", kind), **QUICK)
    cell, rows = scenario.cell, list(scenario.cell.task_rows.indices)
    weight = np.concatenate((cell.payload.mass * np.array(cell.gravity), np.zeros(3)))
    parts = np.outer(cell.shares, weight)
    if kind == "patches":
        tips = np.array([grasp.xyz for grasp in cell.grasps.values()]) @ scenario.start.matrix[:3, :3].T
        parts = linkage_loads(tips) @ weight
    load = MotionLoop(scenario, reachability(scenario, poses=3)).load
    np.testing.assert_allclose(load, parts[:, rows], atol=1e-9)
