"""Grasps of fewer rows: what they transmit, the split of the load within it, closed forms and laws."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest
from joint_cells import FIVE_JOINTS, H, bias_wrenches, four_bar, jointed, upright
from numpy.testing import assert_allclose
from scipy.linalg import null_space

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError
from coop_pin.base.spatial import task_rows
from coop_pin.base.spatial.grasp_rows import (
    GraspRows,
    transmits,
    transmitted_loads,
    unheld_motion,
)
from coop_pin.control.grasp_space import gains_in_grasp
from coop_pin.control.laws.payload_space_controller import PayloadSpaceGains
from coop_pin.design.grasp_gains import with_joint_gains
from coop_pin.design.posture_gains import base_posture_gains, rounded_down
from coop_pin.feasibility import reachability
from coop_pin.feasibility.freedoms import freedoms
from coop_pin.grasps import CellChain
from coop_pin.model import CellArm
from coop_pin.stability.modes import damping_ratio
from coop_pin.stability.sampled_motion import tick_matrix
from coop_pin.stability.sampled_stability import sampled_stability
from coop_pin.viz.frames import run_samples, strut_columns

FULL = task_rows("full")
HELD = {"rigid": (0, 1, 2, 3, 4, 5), "hinge": (0, 1, 2, 3, 4), "cylinder": (0, 1, 3, 4), "ball": (0, 1, 2)}
LEFT, RIGHT = (-0.2, 0.03, 0.05), (0.25, -0.04, 0.02)
DIMENSIONS = {
    ("rigid", "rigid"): 6,
    ("rigid", "hinge"): 5,
    ("rigid", "cylinder"): 4,
    ("rigid", "ball"): 3,
    ("hinge", "hinge"): 4,
    ("hinge", "cylinder"): 3,
    ("hinge", "ball"): 2,
    ("cylinder", "cylinder"): 2,
    ("cylinder", "ball"): 1,
    ("ball", "ball"): 1,
}
"""Dimension of the internal wrenches of two grasps with axes askew."""


def rows(kind: str, p, axis=(0.0, 0.0, 1.0), task=FULL) -> GraspRows:
    X = pin.SE3(
        pin.Quaternion.FromTwoVectors(np.array((0.0, 0.0, 1.0)), np.array(axis)).matrix(), np.array(p)
    )
    grasp = GraspRows.of(task, X.homogeneous, [k in HELD[kind] for k in range(6)])
    assert grasp is not None
    return grasp


def internal_dimension(wrenches: list[np.ndarray]) -> int:
    """Dimension of null(G)."""
    G = np.hstack(wrenches)
    return G.shape[1] - np.linalg.matrix_rank(G, 1e-6)


def pair(first: str, second: str) -> list[np.ndarray]:
    return [rows(first, LEFT, (0.3, 0.8, -0.1)).wrenches, rows(second, RIGHT, (-0.6, 0.2, 0.7)).wrenches]


@pytest.mark.parametrize("kinds", [*itertools.combinations_with_replacement(HELD, 2)])
def test_internal_wrenches_of_two_grasps_have_the_dimension_of_null_g(kinds):
    wrenches = pair(*kinds)
    lost = kinds == ("ball", "ball")
    assert internal_dimension(wrenches) == DIMENSIONS[tuple(sorted(kinds, key=list(HELD).index))]
    assert (unheld_motion(wrenches) is not None) == lost


def test_what_two_balls_or_two_hinges_on_one_line_leave_free_is_the_turn_about_it():
    line = np.subtract(RIGHT, LEFT)
    for kind in ("ball", "hinge"):
        V = unheld_motion([rows(kind, LEFT, line).wrenches, rows(kind, RIGHT, line).wrenches])
        u = line / np.linalg.norm(line)
        turn = np.concatenate((np.cross(LEFT, u), u))
        assert abs(V @ turn) / np.linalg.norm(turn) == pytest.approx(1.0, abs=1e-12)


def test_what_two_parallel_cylinders_leave_free_is_the_slide_along_them():
    axis = np.array((0.3, 0.8, -0.1)) / np.linalg.norm((0.3, 0.8, -0.1))
    V = unheld_motion([rows("cylinder", p, axis).wrenches for p in (LEFT, RIGHT)])
    assert abs(V[:3] @ axis) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("kinds", "dimension"), [(("rigid", "rigid"), 3), (("rigid", "hinge"), 2), (("hinge", "hinge"), 1)]
)
def test_internal_wrenches_of_two_grasps_in_the_plane(kinds, dimension):
    in_plane = [rows(kind, p, task=task_rows("planar")) for kind, p in zip(kinds, (LEFT, RIGHT), strict=True)]
    wrenches = [grasp.wrenches for grasp in in_plane]
    assert internal_dimension(wrenches) == dimension
    assert unheld_motion(wrenches) is None


@pytest.mark.parametrize("kind", ["ball", "hinge"])
def test_a_cell_that_leaves_the_payload_a_turn_is_refused(kind):
    line = {"left": (H, -H, 0.0), "right": (H, -H, 0.0)}
    with pytest.raises(FieldError, match="nobody holds"):
        jointed("two-pandas-box", {"left": kind, "right": kind}, line)


@pytest.mark.parametrize("kinds", [kinds for kinds in DIMENSIONS if kinds != ("ball", "ball")])
def test_the_split_is_the_cheapest_load_that_grasps_transmit(kinds):
    wrenches, shares, length = pair(*kinds), np.array((0.3, 0.7)), 0.15
    L = transmitted_loads(wrenches, shares, FULL, length)
    assert_allclose(L.sum(axis=0), np.eye(6), rtol=0, atol=1e-12)
    assert all(transmits(B, load) for B, load in zip(wrenches, L, strict=True))
    Q = np.diag([1.0, 1.0, 1.0, *[length**-2] * 3])
    G = np.hstack(wrenches)
    null = np.linalg.svd(G)[2][np.linalg.matrix_rank(G, 1e-9) :]
    W = np.array((3.0, -2.0, 9.0, 0.4, 0.7, -0.2))
    for internal in null:
        parts = np.split(internal, [wrenches[0].shape[1]])
        slope = sum(
            (B @ h) @ Q @ (load @ W) / c for B, h, load, c in zip(wrenches, parts, L, shares, strict=True)
        )
        assert abs(slope) < 1e-9


def test_of_rigid_grasps_the_split_is_that_by_load_shares():
    shares = np.array((0.3, 0.7))
    L = transmitted_loads(pair("rigid", "rigid"), shares, FULL, 0.07)
    assert_allclose(L, shares[:, None, None] * np.eye(6), rtol=0, atol=1e-12)


@pytest.mark.parametrize("kinds", [kinds for kinds in DIMENSIONS if kinds != ("ball", "ball")])
def test_motion_terms_leave_no_internal_wrench_where_the_length_is_that_of_the_gains(kinds):
    stiff, twist, shares = 800.0, 60.0, np.array((0.4, 0.6))
    gains = PayloadSpaceGains(
        pose_gain=5.0, sliding_gain=(*[stiff] * 3, *[twist] * 3), sign_gain=0.25, transient_rate=5.0
    ).sized(6, 0)
    grasps = [rows(kinds[0], LEFT, (0.3, 0.8, -0.1)), rows(kinds[1], RIGHT, (-0.6, 0.2, 0.7))]
    x, F, felt = np.array((1e-3, -2e-3, 5e-4, 3e-3, 1e-3, -2e-3)), [], np.zeros((6, 6))
    for grasp, c in zip(grasps, shares, strict=True):
        K_i = gains_in_grasp(gains, grasp, in_payload=False, feedback="sliding_gain").sliding_gain
        felt += c * grasp.wrenches @ K_i @ grasp.wrenches.T
        F.append(c * grasp.wrenches @ K_i @ grasp.wrenches.T @ x)
    L = transmitted_loads([grasp.wrenches for grasp in grasps], shares, FULL, (twist / stiff) ** 0.5)
    assert_allclose(F, L @ np.sum(F, axis=0), rtol=0, atol=1e-12)
    assert np.linalg.eigvalsh(gains.sliding_gain - felt).min() > -1e-9


def test_an_axis_askew_to_the_plane_and_a_squeeze_that_a_hinge_does_not_transmit_are_refused():
    with pytest.raises(FieldError, match="askew"):
        jointed("adept-anchored", {"right": "hinge"}, {"right": (0.0, 0.3, 1.0)})
    with pytest.raises(FieldError, match="does not transmit"):
        jointed("adept-anchored", {"right": "hinge"}, **{"squeeze": MOMENT})


MOMENT = {"left": (-10.0, 0.0, 0.0, 0.0, 0.0, -1.0), "right": (10.0, 0.0, 0.0, 0.0, 0.0, 1.0)}


@pytest.mark.parametrize(
    ("name", "kinds", "kept"),
    [
        ("two-pandas-box", {"right": "hinge"}, {"virtual_linkage"}),
        ("two-pandas-box", {"left": "hinge", "right": "hinge"}, {"virtual_linkage"}),
        ("two-pandas-box", {"right": "ball"}, set()),
        ("adept-anchored", {"right": "hinge"}, {"virtual_linkage"}),
    ],
)
def test_definitions_whose_load_a_grasp_does_not_transmit_are_nan_and_say_why(name, kinds, kept):
    scenario = jointed(name, kinds)
    result = cp.run(scenario.override({"duration": 2.0 / scenario.clock.rate_hz}))
    definitions = result.internal_wrench_definitions()
    known = {str(name) for name in definitions if np.isfinite(definitions[name].values).any()}
    assert known == kept | {"transmitted"}
    for lost in {*map(str, definitions)} - known:
        assert next(iter(kinds)) in definitions[lost].attrs["reason"]
    if kept:  # both are internal, and transmitted
        f = definitions["virtual_linkage"].values.sum(axis=1)
        assert_allclose(f[np.isfinite(f)], 0.0, atol=1e-9)


def test_a_three_hinged_arch_has_the_thrust_of_its_closed_form():
    """Two rods to the crown at (a, h): H = m g a / (2 h), V = m g; by a hinge closure about z."""
    a, h, m, g = 1.3, 0.4, 2.0, 9.81
    length, model, parent, X = float(np.hypot(a, h)), pin.Model(), 0, pin.SE3.Identity()
    model.gravity.linear = np.array((0.0, -g, 0.0))
    for name in ("rise", "fall"):
        parent = model.addJoint(parent, pin.JointModelRZ(), X, name)
        inertia = np.diag((1e-3, m * length**2 / 12.0, m * length**2 / 12.0))
        model.appendBodyToJoint(
            parent, pin.Inertia(m, np.array((length / 2, 0.0, 0.0)), inertia), X.Identity()
        )
        X = pin.SE3(np.eye(3), np.array((length, 0.0, 0.0)))
    model.addFrame(pin.Frame("end", parent, 0, X, pin.FrameType.OP_FRAME))
    support = np.eye(4)
    support[0, 3] = 2.0 * a
    chain = cp.ClosedChain(model, [cp.Closure("end", "world", "axis", X_BC=support)])
    slope = np.arctan2(h, a)
    dynamics = chain.forward_dynamics(np.array((slope, -2.0 * slope)), np.zeros(2), np.zeros(2))
    assert_allclose(dynamics.acceleration, 0.0, atol=1e-11)
    turn = pin.SE3(pin.exp3(np.array((0.0, 0.0, -slope))), np.zeros(3))
    force = turn.rotation @ np.asarray(dynamics.closure_wrenches[0][:3])
    assert_allclose(force, (-m * g * a / (2.0 * h), m * g, 0.0), rtol=0, atol=1e-12 * m * g * a / h)


@pytest.mark.parametrize(
    ("engine", "kind", "text"), [("compiled", "hinge", "joints"), ("mujoco", "cylinder", "four rows")]
)
def test_engines_without_a_joint_refuse_it_by_name(engine, kind, text):
    with pytest.raises(FieldError, match=text):
        cp.run(jointed("two-pandas-box", {"right": kind}), engine=engine)


def test_exports_and_blame_refuse_joints_by_name(tmp_path):
    scenario = jointed("adept-anchored", {"right": "hinge"}, duration=0.1)
    for refuses in (
        lambda: cp.export.export_c(scenario, "left", tmp_path),
        lambda: cp.blame(cp.run(scenario, warn=False)),
    ):
        with pytest.raises(ArgumentError, match="'right'"):
            refuses()


@pytest.mark.parametrize("kind", ["mean-pose", "own wrench"])
def test_laws_and_force_paths_that_know_no_rows_of_grasps_are_refused_by_name(kind):
    """The mean of poses is refused with the gains of the cell's own law, with which it would run."""
    scenario = jointed("two-pandas-box", {"right": "hinge"})
    gains, slot = scenario.controller.gains.model_dump(), "controller.kind"
    changes = {"controller": {"kind": "mean-pose", "gains": gains | {"anchor_gain": 0.0}}}
    if kind == "own wrench":
        changes, slot = (
            {"controller.payload_mass": 3.0, "controller.force_path": {"kind": "none"}},
            "payload_mass",
        )
    with pytest.raises(FieldError, match=slot):
        cp.run(scenario.override(changes))


def at_rest(result) -> np.ndarray:
    """Error of the internal wrenches about P in payload axes on the task rows at the last sample."""
    data = result.data
    R = pin.Quaternion(data["payload_quaternion"].values[-1]).matrix()
    error = np.nan_to_num((data["internal_wrench"] - data["desired_internal_wrench"]).values[-1])
    in_payload = np.concatenate((error[:, :3] @ R, error[:, 3:] @ R), axis=1)
    return in_payload[:, list(result.scenario.cell.task_rows.indices)]


@pytest.mark.gate
def test_a_bias_leaves_the_internal_force_of_its_formula_on_a_planar_hinge():
    bias = (1e-3, 0.0, 0.0)
    pose = cp.Scenario.load("adept-anchored").start.model_dump()
    still = {"motion": {"kind": "hold", "pose": pose}, "duration": 6.0, "squeeze": {}, "start_angles": {}}
    still["cell.arms.right.calibration_error.tip.xyz"] = bias
    scenario = jointed("adept-anchored", {"right": "hinge"}, **still)
    result = cp.run(scenario)
    expected = bias_wrenches(scenario, result.data["configuration"].values[-1], 1, bias)
    assert np.abs(expected).max() > 0.1
    assert_allclose(at_rest(result), expected, rtol=1e-2, atol=1e-3)
    assert result.simulation_sound


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        pytest.param("adept-anchored", {"right": "hinge"}, marks=pytest.mark.gate),
        pytest.param("two-pandas-box", {"left": "hinge", "right": "hinge"}, marks=pytest.mark.slow),
        pytest.param("two-pandas-box", {"right": "ball"}, marks=pytest.mark.slow),
    ],
)
def test_a_zeroed_law_leaves_nothing_of_a_bias_after_the_tips_have_turned_on_their_joints(name, kinds):
    """The frame of a corrected grasp is fixed in the tip, at C from t_0 on: joints turn about C, so b = 0."""
    bias, start = (1e-3, 5e-4, 0.0), cp.Scenario.load(name).start
    goal = start.replace(xyz=np.add(start.xyz, (0.03, 0.04, 0.0)), rpy=np.add(start.rpy, (0.0, 0.0, 0.15)))
    line = cp.motions.LineMotion(start=start, goal=goal, start_time=0.2, duration=1.5)
    changes = {"motion": line, "duration": 4.0, "squeeze": {}, "start_angles": {}, "events": ()}
    changes |= {"cell.arms.right.calibration_error.tip.xyz": bias, "controller.anchor_bias": "none"}
    changes |= LIGHT_WRIST if "ball" in kinds.values() else {}
    scenario = jointed(name, kinds, **changes, **{"controller.zero_at_grasp": True})
    result = cp.run(scenario, warn=False)
    q, slot = result.data["configuration"].values, CellChain(scenario.cell).model.arms[1]
    assert np.abs(bias_wrenches(scenario, q[-1], 1, bias)).max() > 0.05  # without zero
    seen = [
        arm.tip_pose(x[slot.q_slice])[:3, :3] for arm in CellChain(scenario.cell).arms[1:] for x in q[[0, -1]]
    ]
    R = [pin.Quaternion(x).matrix() for x in result.data["payload_quaternion"].values[[0, -1]]]
    turned = pin.log3((R[0].T @ seen[0]).T @ R[1].T @ seen[1])
    assert np.linalg.norm(turned) > 0.02
    assert_allclose(at_rest(result), 0.0, atol=1e-3)


def test_sampled_damping_names_the_light_wrist_that_a_hinge_makes_spare():
    usual = {"controller.posture.damping": 8.0, "controller.posture.stiffness": 40.0}
    stability = sampled_stability(jointed("adept-anchored", {"right": "hinge"}, **usual))
    assert stability.joints == ("right/joint_3",)
    assert 9.0 < stability.value < 11.0
    assert sampled_stability(jointed("adept-anchored", {"right": "hinge"})).ok


@pytest.mark.slow
def test_a_light_wrist_that_a_hinge_makes_spare_is_a_finding_with_a_remedy_that_works():
    scenario = jointed("adept-anchored", {"right": "hinge"}, duration=1.0).override(
        {"controller.posture.damping": 8.0, "controller.posture.stiffness": 40.0}
    )
    findings = [each for each in cp.check(scenario, poses=21) if each.kind == "sampled damping"]
    assert findings[0].severity == "error"
    assert findings[0].place == "right/joint_3"
    cured = cp.check(scenario.override(findings[0].remedy), poses=21)
    assert not [each for each in cured if each.severity == "error"]


LIGHT_WRIST = {"controller.posture.stiffness": 15.0, "controller.posture.damping": 3.0}
"""Of four joints that a ball makes spare: T lambda is 2.48 at 8 N m s/rad, and the force grew to 4 N."""
RESTING = {
    "Adepts, a hinge": ("adept-anchored", {"right": "hinge"}),
    "Adepts, two hinges": ("adept-anchored", {"left": "hinge", "right": "hinge"}),
    "Pandas, a hinge": ("two-pandas-box", {"right": "hinge"}),
    "Pandas, two hinges": ("two-pandas-box", {"left": "hinge", "right": "hinge"}),
    "Pandas, a cylinder": ("two-pandas-box", {"right": "cylinder"}),
    "Pandas, a ball": ("two-pandas-box", {"right": "ball"}),
    "three UR5, balls": ("three-ur5-plate", {"first": "ball", "second": "ball", "third": "ball"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", RESTING)
def test_a_bias_at_rest_leaves_what_its_formula_says(case):
    name, kinds = RESTING[case]
    scenario, bias, arms = cp.Scenario.load(name), (6e-4, -3e-4, 2e-4), cp.Scenario.load(name).cell.arms
    biased = list(arms).index([*kinds][-1])
    pose, arm = scenario.start.model_dump(), [*kinds][-1]
    still = {"motion": {"kind": "hold", "pose": pose}, "duration": 3.0, "events": ()}
    scenario = jointed(name, kinds, **still, **{f"cell.arms.{arm}.calibration_error.tip.xyz": bias})
    scenario = scenario.override(LIGHT_WRIST if "a ball" in case else {})
    scenario = scenario.override({"controller.anchor_bias": "none"})
    result = cp.run(scenario)
    expected = bias_wrenches(scenario, result.data["configuration"].values[-1], biased, bias)
    assert np.abs(expected).max() > 0.02
    assert_allclose(at_rest(result), expected, rtol=1e-2, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("case", RESTING)
@pytest.mark.parametrize("zeroed", [False, True])
def test_the_task_is_kept_with_joints(case, zeroed):
    name, kinds = RESTING[case]
    changes = (LIGHT_WRIST if "a ball" in case else {}) | {"controller.zero_at_grasp": zeroed}
    result = cp.run(jointed(name, kinds, **changes))
    assert result.simulation_sound
    assert result.task.state == "kept"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adept-hinges", "two-pandas-hinges"])
def test_the_cells_of_the_catalogue_keep_their_task(name):
    result = cp.run(name)
    assert result.simulation_sound
    assert result.task.state == "kept"
    assert not [each for each in cp.check(name) if each.severity == "error"]


def test_hinges_in_place_of_a_joint_keep_all_freedoms_and_the_task():
    goal = {"motion.goal.xyz": (4e-3, 5e-3, 0.356), "motion.goal.rpy": (0.02, 0.0, 0.01)}
    scenario = cp.Scenario.load(FIVE_JOINTS).override(SHORT | goal)
    assert freedoms(scenario)[:2] == (6, 6)
    assert freedoms(scenario).ok
    result = cp.run(scenario)
    assert result.data["joint_position"].sizes["joint"] == 5
    assert np.abs(result.data["pose_error"].values).max() < 2e-3
    error = (result.data["internal_wrench"] - result.data["desired_internal_wrench"]).values
    assert np.abs(error[len(error) // 2 :]).max() < 0.1


SHORT = {"motion.start_time": 0.05, "motion.duration": 0.4, "duration": 0.6, "squeeze.force": 0.0}


@pytest.mark.gate
def test_arms_of_four_joints_with_hinges_keep_four_freedoms_and_the_task_within_them():
    goal = {"motion.goal.xyz": (4e-3, 0.155, 0.356), "motion.goal.rpy": (0.0, 0.0, 0.02)}
    scenario = upright(**SHORT, **goal)
    leave = freedoms(scenario)
    assert (leave.left, leave.rows, leave.ok) == (4, 6, True)
    result = cp.run(scenario)
    assert result.data["joint_position"].sizes["joint"] == 4
    assert np.abs(result.data["pose_error"].values).max() < 2e-3
    error = (result.data["internal_wrench"] - result.data["desired_internal_wrench"]).values
    assert np.abs(error).max() < 0.2
    assert np.abs(error[-1]).max() < 5e-3


@pytest.mark.slow
def test_arms_of_four_joints_keep_their_task_and_a_motion_beyond_their_freedoms_is_an_error():
    result = cp.run(upright())
    assert result.simulation_sound
    assert result.task.state == "kept"
    assert not [each for each in cp.check(upright(), poses=21) if each.severity == "error"]
    pitched = cp.check(upright(**{"motion.goal.rpy": (0.1, 0.0, 0.0)}), poses=21)
    assert {"freedom", "reach"} <= {each.kind for each in pitched if each.severity == "error"}


def test_laws_that_control_all_rows_refuse_arms_with_fewer_joints_than_a_joint_holds():
    law = {"kind": "sliding-mode-redundant", "force_path": {"kind": "late"}}
    law["gains"] = {"pose_gain": 2.0, "sign_gain": 0.0, "damping_gain": 1.0, "transient_rate": 5.0}
    with pytest.raises(FieldError, match="joints"):
        cp.run(upright(controller=law))


def test_a_four_bar_of_two_arms_with_one_joint_rests_under_the_torque_of_virtual_work():
    """tau_1 + tau_2 dq_2/dq_1 is the rate of the weights, by one motor or two; hinges leave one freedom."""
    scenario = four_bar()
    assert freedoms(scenario)[:2] == (1, 3)
    chain = CellChain(scenario.cell, scenario.plant)
    q, (crank, rocker) = chain.configuration(scenario.start.matrix), chain.arms
    turns = [q[slot.q_slice] for slot in chain.model.arms]
    pins = [complex(*arm.tip_pose(turn)[:2, 3]) for arm, turn in zip(chain.arms, turns, strict=True)]
    bases = [complex(*arm.description.base.xyz[:2]) for arm in (crank, rocker)]
    arms, coupler = np.subtract(pins, bases), pins[1] - pins[0]
    # The length of the coupler is kept: Re(conj(coupler) i (arms_2 dq_2 - arms_1)) = 0.
    rate = np.real(np.conj(coupler) * 1j * arms[0]) / np.real(np.conj(coupler) * 1j * arms[1])
    rise = np.imag(1j * arms[0] + 1j * arms[1] * rate) / 2.0 * scenario.cell.payload.mass * 9.81
    weights = [
        arm.nonlinear_effects(turn, np.zeros(1))[0] for arm, turn in zip(chain.arms, turns, strict=True)
    ]
    work = rise + weights[0] + weights[1] * rate
    for part in (1.0, 0.3, 0.0):
        tau = np.zeros(chain.mechanism.model.nv)
        for slot, torque in zip(chain.model.arms, (part * work, (1.0 - part) * work / rate), strict=True):
            tau[slot.v_slice] = torque
        motion = chain.mechanism.forward_dynamics(q, 0.0 * tau, tau)
        assert np.abs(motion.acceleration).max() < 1e-12 * 9.81 / abs(coupler)
    data = cp.run(scenario.override({"duration": 0.1}), warn=False).data
    held = data["torque"].values[:, :, 0] @ (1.0, rate)
    assert_allclose(held, work, rtol=1e-12)


def test_sampled_damping_is_that_of_the_gains_that_the_payload_feels_beyond_a_turned_hinge():
    """T lambda_max(A^-1 sum c_i B_i K_i B_i^T) with A of the closed chain; the arms do not see the turns."""
    scenario = cp.Scenario.load(FIVE_JOINTS)
    chain, cell = CellChain(scenario.cell, scenario.plant), scenario.cell
    q = chain.configuration(scenario.start.matrix)
    reduced = chain.mechanism.reduced_dynamics(q, np.zeros(chain.mechanism.model.nv))
    JN = chain.payload_jacobian(q) @ reduced.coordinates.null_space
    A = np.linalg.inv(JN @ np.linalg.solve(reduced.mass_matrix, JN.T))
    K = scenario.controller.gains.sized(6, 0).sliding_gain
    parts = zip(cell.shares, cell.transmitted(), strict=True)
    felt = sum(c * B @ np.linalg.inv(B.T @ np.linalg.inv(K) @ B) @ B.T for c, B in parts)
    largest = np.linalg.eigvals(np.linalg.solve(A, felt)).real.max() * scenario.clock.period
    assert sampled_stability(scenario).value == pytest.approx(largest, rel=1e-6)


@pytest.mark.gate
def test_gains_beside_joints_leave_lags_their_part_of_the_tick():
    """(T + 2 lag) lambda_max = 0.9 of what the payload feels at rest; gamma and k_I by lambda_min."""
    scenario = cp.Scenario.load(FIVE_JOINTS, {"events": []})
    T, lag = scenario.clock.period, 0.5 * scenario.clock.period
    scenario = scenario.replace(motion=cp.motions.HoldMotion(pose=scenario.start))
    scenario = scenario.override({"actuators.lag": lag})
    proposed, _ = with_joint_gains(scenario, reachability(scenario, poses=3))
    chain, cell, gains = CellChain(scenario.cell), scenario.cell, proposed.controller.gains
    q = chain.configuration(scenario.start.matrix)
    reduced = chain.mechanism.reduced_dynamics(q, np.zeros(chain.mechanism.model.nv))
    JN = chain.payload_jacobian(q) @ reduced.coordinates.null_space
    K = gains.sized(6, 0).sliding_gain
    parts = zip(cell.shares, cell.transmitted(), strict=True)
    felt = sum(c * B @ np.linalg.inv(B.T @ np.linalg.inv(K) @ B) @ B.T for c, B in parts)
    rates = np.linalg.eigvals(JN @ np.linalg.solve(reduced.mass_matrix, JN.T) @ felt).real
    rates = rates[rates > 1e-6 * rates.max()]
    assert 0.99 * 0.9 < (T + 2.0 * lag) * rates.max() <= 0.9 * (1.0 + 1e-6)
    gamma, k_I = float(np.max(gains.pose_gain)), np.max(gains.sign_gain) / proposed.controller.switching.width
    assert gamma <= rates.min() / 4.0 * (1.0 + 1e-6)
    assert k_I <= min(rates.min() / 2.0, 0.25 / T) * (1.0 + 1e-6)
    by_motion = [
        T * rate * np.array([[T * gamma, 1.0]]) for rate in np.geomspace(rates.min(), rates.max(), 12)
    ]
    ticks = [tick_matrix(-part, -T * k_I * part, 1.0, lag=lag / T) for part in by_motion]
    least = min(damping_ratio(z) for tick in ticks for z in np.linalg.eigvals(tick))
    assert least >= 0.58 - 1e-3
    assert gamma > 0.98 * rates.min() / 4.0 or least < 0.6


@pytest.mark.gate
def test_a_proposal_beside_joints_is_stable_by_half_and_damps_the_light_wrist():
    scenario = cp.Scenario.load("adept-hinges").override({"controller.posture.damping": 8.0})
    proposed = cp.suggest(scenario, poses=11)
    law, cell = proposed.scenario.controller, scenario.cell
    assert law.posture.damping == pytest.approx(0.72, rel=1e-9)
    K = np.array(law.gains.sliding_gain)
    assert_allclose(K / K[0], (1.0, 1.0, cell.split_length**2), rtol=1e-9)
    assert 0.85 < sampled_stability(proposed.scenario).value < 1.0
    assert not proposed.findings().of("error")
    assert "[" not in proposed.summary()


def on_bases() -> cp.Scenario:
    """Three UR5 on bases, one of which holds by a hinge: its wrist bears a tenth of the others' damping.

    With a tenth of their spring as well, all bases swing at 0.78 rad/s and press each other with 1.08 N.
    """
    return jointed("three-driven-ur5", {"arm1": "hinge"}, **{"cell.split_length": 0.3})


@pytest.mark.parametrize("T", [0.002, 0.05])
def test_postures_on_bases_damp_each_drive_by_its_own_inertia(T):
    """D_j = min(80, s M_jj), (T + 2 lag) lambda_max = 0.9; K_j = min(160, D_j / (5 T)); none of the bases."""
    scenario = on_bases().override({"actuators.lag": 0.003})
    cell_reach, poses = reachability(scenario, poses=3), []
    for reach in cell_reach.arms:
        arm = CellArm(scenario.cell, reach.arm)
        for q in reach.q:
            M = arm.from_drive.T @ arm.mass_matrix(q) @ arm.from_drive
            poses.append((null_space(arm.task_jacobian(q)), M))
    least = np.min([np.diag(M) for _, M in poses], axis=0)
    least[:3] = 0.0  # of the base
    largest = max(
        np.linalg.eigvals(np.linalg.solve(U.T @ M @ U, U.T @ np.diag(least) @ U)).real.max() for U, M in poses
    )
    damping = np.minimum(80.0, 0.9 / ((T + 2.0 * 0.003) * largest) * least)
    gains = base_posture_gains(scenario, cell_reach, T)
    assert_allclose(gains.damping, damping, rtol=0.01, atol=0)
    assert (np.array(gains.damping) <= damping * (1.0 + 1e-9)).all()
    stiffness = np.minimum(160.0, np.array(gains.damping) / (5.0 * T))
    assert_allclose(gains.stiffness, stiffness, rtol=0.01, atol=0)


@pytest.mark.parametrize(
    ("value", "expected"), [(0.123456, 0.123), (98765.0, 98700.0), (0.9, 0.9), (4.99999, 4.99), (1e-6, 1e-6)]
)
def test_gains_are_rounded_down_to_three_digits(value, expected):
    assert rounded_down(value) == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [lambda: cp.Scenario.load("two-pandas-hinges"), lambda: cp.Scenario.load(FIVE_JOINTS), upright, on_bases],
    ids=["two-pandas-hinges", "five joints", "four joints", "bases"],
)
def test_a_proposal_beside_joints_passes_its_own_check_and_keeps_the_task(make):
    proposed = cp.suggest(make(), poses=21)
    assert (proposed.scenario.controller.anchor_bias == "none") == (make is on_bases)
    assert not proposed.findings().of("error")
    result = cp.run(proposed.scenario, warn=False)
    assert result.simulation_sound
    assert result.task.state == "kept"


FEWER = {
    "five joints, hinges": (cp.Scenario.load, 3.0),
    "four joints, hinges": (upright, 3.0),
    "four-bar": (four_bar, 6.0),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "tilt"), [(case, tilt) for case in FEWER for tilt in ((), (4e-3, -3e-3, 0.0))][:-1]
)
def test_a_bias_at_rest_leaves_what_its_formula_says_with_fewer_joints(case, tilt):
    """A bias of 1 mm, and of 5 mrad of the axis of a hinge; the arm's structure bears what drives do not."""
    make, duration = FEWER[case]
    scenario, tip = (
        make(FIVE_JOINTS) if make == cp.Scenario.load else make(),
        "cell.arms.right.calibration_error.tip",
    )
    bias, still = (6e-4, 7e-4, 4e-4), {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}}
    changes = {"duration": duration, "squeeze": {}, "controller.anchor_bias": "none", f"{tip}.xyz": bias}
    changes |= {f"{tip}.rpy": tilt} if tilt else {}
    scenario = scenario.override(still | changes)
    result = cp.run(scenario, warn=False)
    expected = bias_wrenches(scenario, result.data["configuration"].values[-1], 1, (*bias, *tilt))
    assert np.abs(expected).max() > 0.02
    assert_allclose(at_rest(result), expected, rtol=1e-2, atol=1e-3)


def test_the_redundant_printed_law_runs_in_the_rows_of_hinges():
    """K_d acts on the spare wrist as well: at the paper's 10 N m s/rad T lambda is far beyond 2."""
    gains = {"pose_gain": 2.0, "sign_gain": 0.0, "damping_gain": (60.0, 60.0, 0.5), "transient_rate": 5.0}
    law = {
        "kind": "sliding-mode-redundant",
        "gains": gains,
        "force_path": {"kind": "late"},
        "posture": {"stiffness": 5.0, "damping": 0.1},
    }
    scenario = jointed("adept-anchored", {"left": "hinge", "right": "hinge"}, controller=law, duration=3.0)
    data = cp.run(scenario).data
    assert np.abs(data["pose_error"].values[-1, :2]).max() < 1e-4
    error = (data["internal_wrench"] - data["desired_internal_wrench"]).values[-1]
    assert np.nanmax(np.abs(error)) < 0.05


@pytest.mark.gate
def test_the_redundant_printed_law_runs_on_hinges_in_space():
    """Without gravity, whose load the law alone does not hold; squeezed by 10 N."""
    gains = {"pose_gain": 4.0, "sign_gain": 0.0, "transient_rate": 5.0}
    law = {
        "kind": "sliding-mode-redundant",
        "gains": gains | {"damping_gain": (20.0, 20.0, 15.0, 15.0, 4.0, 4.0, 2.0)},
        "force_path": {"kind": "late"},
        "posture": {"stiffness": 20.0, "damping": 2.0},
    }
    changes = {"controller": law, "cell.gravity": (0.0, 0.0, 0.0), "duration": 1.6, "motion.duration": 0.8}
    changes |= {"motion.start_time": 0.1, "motion.goal.xyz": (0.01, 0.012, 0.416)}
    data = cp.run(cp.Scenario.load("two-pandas-hinges").override(changes), warn=False).data
    assert np.abs(data["pose_error"].values).max() < 2e-2
    assert np.abs(data["pose_error"].values[-1]).max() < 5e-4
    error = (data["internal_wrench"] - data["desired_internal_wrench"]).values
    assert np.abs(error[len(error) // 20 :]).max() < 1.0
    assert np.abs(error[-1]).max() < 0.1


def test_a_hinge_hands_its_load_over_and_what_it_alone_would_hold_is_refused():
    leave = {"kind": "hand-over", "time": 0.1, "arm": "right", "duration": 0.2}
    free = {"plant.payload": "free", "duration": 0.4}
    scenario = jointed("two-pandas-box", {"right": "hinge"}, **free, events=[leave])
    data = cp.run(scenario).data
    assert_allclose(data["interaction_wrench"].values[-1, 1], 0.0, atol=0)
    assert_allclose(data["internal_wrench"].values.sum(axis=1), 0.0, atol=1e-9)
    with pytest.raises(FieldError, match="nobody holds"):
        jointed("two-pandas-box", {"right": "hinge"}, **free, events=[leave | {"arm": "left"}])


def test_struts_beside_joints_are_those_of_the_internal_wrench():
    """Two arms have one strut; the split puts 1.9 N along it into the load of two-pandas-hinges."""
    for name in ("adept-hinges", "two-pandas-hinges"):
        result = cp.run(name, {"duration": 0.1, "events": []}, warn=False)
        struts, _ = strut_columns(run_samples(result), result.scenario.cell)
        assert_allclose(struts[:, 0, 0, 0], result.data.internal_axial.values[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("kind", "meant"), [("hnge", "hinge"), ("patc", "patch"), ("rigd", "rigid")])
def test_a_kind_of_grasp_that_there_is_not_is_answered_with_the_nearest(kind, meant):
    with pytest.raises(FieldError, match=f"{kind}.*{meant}"):
        cp.Scenario.load("two-pandas-box", {"cell.grasps.left.kind": kind})


def test_hinges_that_a_squeeze_turns_away_are_an_error_with_a_remedy_that_works():
    """Stable at the start, before the squeeze is on: no arm sees the turn of a payload between hinges."""
    scenario = cp.Scenario.load("adept-hinges").replace(events=(), duration=3.0)
    pressed = scenario.replace(squeeze=scenario.squeeze.scaled(5.0))
    assert cp.stability.eigenvalues(pressed).radius < 1.0
    (finding,) = cp.check(pressed, poses=21).of("error")
    assert finding.kind == "closed loop"
    assert finding.value > 1.0
    cured = cp.check(pressed.override(finding.remedy), poses=21)
    assert cured.ok
    assert cp.check(scenario, poses=21).ok


@pytest.mark.gate
def test_new_arms_on_hinges_that_a_squeeze_turns_away_have_a_lower_anchor_and_keep_their_task():
    """Two SO-101 with a light box: with the usual anchor the turn about the vertical grows."""
    suggestion = cp.new_cell(["so101"] * 2, mass=0.3)
    assert suggestion.findings().ok
    assert suggestion.scenario.controller.gains.anchor_gain < 0.05
    assert cp.run(suggestion.scenario, warn=False).metrics()["task_kept"] == 1.0
    usual = cp.check(suggestion.scenario.override({"controller.gains.anchor_gain": 0.1}), poses=21)
    assert [finding.kind for finding in usual.of("error")] == ["closed loop"]
