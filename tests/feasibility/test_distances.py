"""Least distances between bodies: closed forms, alarms and their absence, exempt pairs, hulls and meshes."""

from __future__ import annotations

import itertools
import re
import time

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from cells import SCENARIOS
from lifts import planar_cell, planar_robot, spatial_cell, spatial_robot
from linked_cells import linked
from numpy.testing import assert_allclose
from whole_robots import WholeRobot

import coop_pin as cp
from coop_pin.base.spatial import rotations
from coop_pin.description.urdf import find_urdf
from coop_pin.feasibility import CellDistances, distances, reachability
from coop_pin.feasibility.motion_feasibility import with_best_postures
from coop_pin.model import CellArm
from coop_pin.model.joint_limits import JointLimits
from coop_pin.model.pinocchio_model import load_unreduced_arm
from coop_pin.results.finding import LEFT_TO_CHECK
from coop_pin.running.cell_findings import distance_findings
from coop_pin.running.recorded_distances import recorded_distances

TILTED = {"cell.grasps.second.rpy": (np.pi, -0.6, 2.0 * np.pi / 3.0)}
"""Tool of an arm of three-ur5-far that is tilted so far that its forearm is in the plate."""
FAR_AWAY = 50.0


def payload_at(scenario: cp.Scenario, pose: cp.Pose) -> tuple[CellDistances, np.ndarray, np.ndarray]:
    """Bodies of a cell, their distances with the payload at a pose, and the configuration."""
    bodies = CellDistances(scenario.cell)
    q = [np.zeros(CellArm(scenario.cell, name).nq) for name in scenario.cell.arms]
    configuration = bodies.configuration(q, pose.matrix)
    return bodies, bodies.at(configuration), configuration


@pytest.mark.parametrize(
    ("name", "gap"), [("adept-anchored", 0.03), pytest.param("two-pandas-box", 0.05, marks=pytest.mark.gate)]
)
def test_links_of_a_payload_have_distances_in_closed_form(name, gap):
    """A beam of five rods: in line the ends are 3 pitches apart; two right angles fold the last one back."""
    scenario, pair = linked(name, "beam"), ("payload/rod0", "payload/rod4")
    bodies, pitch = CellDistances(scenario.cell), 2.0 * gap
    half = 0.5 * (0.02 if scenario.cell.rows == "full" else 0.1)  # of the section, in the plane of bending
    q = [np.zeros(CellArm(scenario.cell, arm).nq) for arm in scenario.cell.arms]

    def distance(*angles, pair=pair):
        at = bodies.at(bodies.configuration(q, np.eye(4), links=np.array(angles)))
        return at[bodies.pairs.index(pair)]

    assert distance(0.0, 0.0, 0.0, 0.0) == pytest.approx(3.0 * pitch, abs=1e-6)
    turn = np.pi / 2.0  # of rod3 across the line, and of rod4 back along it
    across = np.hypot(gap, max(pitch - 2.0 * half, 0.0))
    assert distance(0.0, 0.0, turn, turn, pair=("payload/rod1", "payload/rod4")) == pytest.approx(
        across, abs=1e-6
    )
    held = {each.pair for each in bodies.exempt if each.reason == "holds it"}
    assert {end for _, end in held} == {"payload/rod0", "payload/rod4"}
    result = cp.run(scenario.replace(duration=0.02), warn=False)
    assert recorded_distances(result).least[-1] != distances(scenario, poses=5).least[0]


@pytest.mark.parametrize("name", ["adept-anchored", pytest.param("two-pandas-box", marks=pytest.mark.gate)])
def test_meshes_of_links_of_a_payload_count_by_their_hulls_or_are_named(name, tmp_path):
    scenario = linked(name, "lid")
    payload = scenario.cell.payload.model_dump()
    boxes = payload["links"]["urdf"]
    trimesh.creation.box((0.4, 0.01, 0.16)).export(tmp_path / "lid.stl")
    q = [np.zeros(CellArm(scenario.cell, arm).nq) for arm in scenario.cell.arms]

    def bodies(text: str) -> CellDistances:
        (tmp_path / "payload.urdf").write_text(text)
        payload["links"]["urdf"] = str(tmp_path / "payload.urdf")
        return CellDistances(scenario.cell.replace(payload=payload))

    ours = bodies(boxes)
    meshed = bodies(re.sub(r'<box size="0.4 0.01 0.16"/>', '<mesh filename="lid.stl"/>', boxes))
    assert ours.pairs == meshed.pairs
    assert any("payload/lid" in pair for pair in meshed.pairs)
    at = [each.at(each.configuration(q, np.eye(4), links=np.array([0.7]))) for each in (ours, meshed)]
    assert_allclose(at[1], at[0], rtol=0.0, atol=1e-6)
    absent = bodies(re.sub(r'<box size="0.4 0.01 0.16"/>', '<mesh filename="none.stl"/>', boxes))
    assert [text.partition(":")[0] for text in absent.omitted] == ["payload/lid"]
    assert not any("payload/lid" in pair for pair in absent.pairs)


def with_table(scenario: cp.Scenario, **changes) -> cp.Scenario:
    bench = {"xyz": (FAR_AWAY, 0.0, 0.5), "size": (0.6, 0.4), "mu": 0.4, "stiffness": 1e5} | changes
    return scenario.replace(cell=scenario.cell.replace(tables={"bench": bench}))


# ------------------------------------------------------------ closed forms


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_box_beside_over_and_on_a_table_has_distances_in_closed_form(name):
    payload = SCENARIOS[name]().cell.payload.replace(
        shape="box", size=(0.3, 0.2, 0.1), shape_pose=cp.Pose(), mesh_file=""
    )
    scenario = SCENARIOS[name]()
    scenario = with_table(scenario.replace(cell=scenario.cell.replace(payload=payload)))
    cases = [
        ((FAR_AWAY, 0.0, 0.5 + 0.05 + 0.03), 0.03),  # over it
        ((FAR_AWAY + 0.3 + 0.15 + 0.02, 0.0, 0.49), 0.02),  # beside its edge
        ((FAR_AWAY + 0.3 + 0.15 - 0.008, 0.0, 0.49), -0.008),  # into its edge
        ((FAR_AWAY + 0.3, 0.0, 0.5 + 0.05), np.inf),  # on it, half beyond the edge
        ((FAR_AWAY, 0.0, 0.5 + 0.05 - 0.004), np.inf),  # sunk in as a soft one
        ((FAR_AWAY, 0.0, 0.5 + 0.05 - 0.01), -0.01),  # sunk in too far
    ]
    for xyz, wanted in cases:
        bodies, values, _ = payload_at(scenario, cp.Pose(xyz=xyz))
        number = bodies.pairs.index(("payload", "table/bench"))
        assert_allclose(values[number], wanted, atol=2e-6)
    turned = cp.Pose(xyz=(FAR_AWAY, 0.0, 0.7), rpy=(np.pi / 4.0, 0.0, 0.0))
    bodies, values, _ = payload_at(scenario, turned)
    number = bodies.pairs.index(("payload", "table/bench"))
    assert_allclose(values[number], 0.2 - np.sqrt(0.5) * 0.15, atol=2e-6)
    points = bodies.points(number)
    assert_allclose(np.linalg.norm(points[1] - points[0]), values[number], atol=2e-6)


# ------------------------------------------------------------ alarms


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("pick-carry-place", "two-pandas-box") else pytest.param(name, marks=pytest.mark.slow)
        for name in cp.scenario_names()
    ],
)
def test_the_catalogue_has_no_alarm(name):
    """A pose takes less than 2 ms."""
    scenario = cp.Scenario.load(name)
    reach = reachability(cp.feasibility.seen_by_arms(scenario), poses=21)
    found = distances(scenario, reach)
    assert found.omitted == ()
    assert found.nearest is not None
    assert found.ok
    assert found.nearest.distance > 1e-3
    bodies, first = CellDistances(scenario.cell), CellArm(scenario.cell, reach.arms[0].arm)
    q = bodies.configuration([arm.q[0] for arm in reach.arms], first.payload_pose(reach.arms[0].q[0]))
    begun = time.process_time()
    for _ in range(20):
        bodies.at(q)
    assert (time.process_time() - begun) / 20 < 2e-3


@pytest.mark.parametrize("name", SCENARIOS)
def test_crossed_arms_alarm(name):
    """The base of the right arm moves to the left one's, with the joints where they were."""
    scenario = SCENARIOS[name]()
    reach = reachability(scenario, poses=2)
    for shift, crossed in ((np.zeros(3), False), (np.array((0.05, 0.0, 0.0)), True)):
        left, right = scenario.cell.arms.values()
        place = right.base if not crossed else left.base.replace(xyz=tuple(np.add(left.base.xyz, shift)))
        cell = scenario.cell.replace(arms={"left": left, "right": right.replace(base=place)})
        bodies = CellDistances(cell)
        q = bodies.configuration([arm.q[0] for arm in reach.arms], scenario.start.matrix)
        hit = [pair for pair, value in zip(bodies.pairs, bodies.at(q), strict=True) if value <= 0.0]
        between = [pair for pair in hit if {end.partition("/")[0] for end in pair} == {"left", "right"}]
        assert bool(between) == crossed


def test_a_table_in_the_way_alarms_with_pair_place_and_time():
    scenario = cp.Scenario.load("two-pandas-box")
    P, half = np.array(scenario.start.xyz), 0.5 * np.array(scenario.cell.payload.size)
    side = np.array((0.0, half[1] + 0.01, -0.5 * half[2]))  # 10 mm beside the box, on the way of its motion
    scenario = with_table(scenario, xyz=tuple(P + side + np.array((0.0, 0.2, 0.0))), size=(0.4, 0.4))
    found = distances(scenario)
    assert not found.ok
    pairs = {each.pair: each for each in found.below}
    hit = pairs["payload", "table/bench"]
    assert hit.time > 0.0
    assert abs(hit.points.mean(axis=0)[1] - (P + side)[1]) < 0.02
    (finding,) = distance_findings(scenario, reachability(scenario, poses=41))
    assert (finding.kind, finding.severity) == ("distance", "warning")
    assert finding.value < 0.0
    assert finding.place == " - ".join(found.nearest.pair)
    assert "no way round is planned" in finding.sentence
    assert "t = " in finding.sentence


def test_the_clearance_is_what_is_asked_for_and_a_note_tells_the_least_distance():
    scenario = cp.Scenario.load("two-pandas-box")
    (note,) = distance_findings(scenario, reachability(scenario, poses=101))
    assert (note.severity, note.limit) == ("note", 0.0)
    wider = scenario.override({"cell.clearance": note.value + 0.01})
    found = distances(wider)
    assert not found.ok
    assert found.below[0].distance == found.nearest.distance
    assert all(each.distance <= wider.cell.clearance for each in found.below)
    assert "distance" in LEFT_TO_CHECK


@pytest.mark.slow
def test_check_tells_it():
    findings = cp.check(cp.Scenario.load("three-ur5-far", TILTED), poses=21)
    assert [each.severity for each in findings if each.kind == "distance"] == ["warning"]


@pytest.mark.gate
def test_proposed_postures_keep_the_clearance_where_they_can():
    scenario = cp.Scenario.load("three-ur5-far", TILTED)
    assert not distances(scenario, poses=21).ok
    proposed, _ = with_best_postures(scenario, 21)
    assert distances(proposed, poses=21).ok


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_postures_tell_a_clearance_that_none_of_them_keeps(name):
    """Twice what the cell has, which no branch reaches; nothing is told of what it keeps."""
    scenario = SCENARIOS[name]()
    apart = distances(scenario, poses=5).nearest.distance
    for clearance, is_told in ((0.5 * apart, False), (apart + 1.0, True)):
        _, told = with_best_postures(scenario.override({"cell.clearance": clearance}), 5)
        lines = [line for line in told if line.startswith("distance")]
        assert bool(lines) == is_told
        assert all(f"{1e3 * clearance:g} mm" in line for line in lines)


# ------------------------------------------------------------ exempt pairs


def test_exempt_pairs_are_fixed_by_rule_and_printed(tmp_path):
    scenario = cp.Scenario.load("two-pandas-box")
    found = distances(scenario, poses=2)
    assert found.rules == {"left": "panda.srdf", "right": "panda.srdf"}
    reasons = {frozenset(each.pair): each.reason for each in found.exempt}
    assert reasons[frozenset(("left/panda_link0", "left/panda_link1"))] == "SRDF"
    assert reasons[frozenset(("left/panda_hand", "payload"))] == "holds it"
    assert frozenset(("left/panda_hand", "right/panda_hand")) not in reasons
    assert frozenset(("left/panda_link6", "payload")) not in reasons
    text = found.summary()
    for each in found.exempt:
        assert " - ".join(each.pair) in text
    planar = distances(SCENARIOS["planar"](), poses=2)
    assert {*planar.rules.values()} == {"adjacency"}
    near = {frozenset(each.pair) for each in planar.exempt if each.reason == "adjacent"}
    assert frozenset(("left/link_1", "left/link_3")) in near
    assert frozenset(("left/base_link", "left/link_3")) not in near
    # An SRDF beside a copy of the URDF takes the place of adjacency beyond one joint.
    copy = tmp_path / "adept.urdf"
    copy.write_text(find_urdf("adept_3dof").path.read_text(encoding="utf-8"), encoding="utf-8")
    cell = SCENARIOS["planar"]().cell
    mine = cell.replace(arms={name: arm.replace(urdf=str(copy)) for name, arm in cell.arms.items()})
    assert CellDistances(mine).rules["left"] == "adjacency"
    line = '<disable_collisions link1="base_link" link2="link_3" reason="Never"/>'
    (tmp_path / "adept.srdf").write_text(f'<robot name="adept_3dof">{line}</robot>', encoding="utf-8")
    bodies = CellDistances(mine)
    assert bodies.rules["left"] == "adept.srdf"
    reasons = {frozenset(each.pair): each.reason for each in bodies.exempt}
    assert reasons[frozenset(("left/base_link", "left/link_3"))] == "SRDF"
    assert reasons[frozenset(("left/link_1", "left/link_2"))] == "adjacent"
    assert frozenset(("left/link_1", "left/link_3")) not in reasons


def test_fixed_parts_of_a_robot_with_two_arms_stand_once():
    scenario = cp.Scenario.load("baxter-box")
    bodies = CellDistances(scenario.cell)
    ends = {*itertools.chain(*bodies.pairs)}
    assert not [end for end in ends if end.startswith("right/") and f"left/{end[6:]}" in ends]
    assert len(bodies.rules) == 1


# ------------------------------------------------------------ runs


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_a_run_records_distances_on_demand_and_the_replay_draws_the_pair(name, tmp_path):
    scenario = SCENARIOS[name]().replace(events=()).override({"duration": 0.04})
    result = cp.run(scenario, engine="pinocchio", warn=False)
    assert "least_distance" not in result.data
    measured = cp.findings.with_distances(result)
    least, points = (measured.data[key].values for key in ("least_distance", "nearest_points"))
    assert_allclose(np.linalg.norm(points[:, 0] - points[:, 1], axis=1), np.abs(least), atol=2e-6)
    bodies = CellDistances(scenario.cell)
    poses = distances(scenario.replace(motion=cp.motions.HoldMotion(pose=scenario.start)), poses=2)
    assert_allclose(least[0], poses.least[0], atol=1e-5)
    assert tuple(measured.data["nearest_bodies"].values[0]) in bodies.pairs
    measured.save(tmp_path / "run.nc")
    loaded = cp.RunResult.load(tmp_path / "run.nc")
    assert_allclose(loaded.data["least_distance"].values, least)
    np.testing.assert_equal(loaded.metrics(), result.metrics())
    pages = [cp.viz.replay_html(each) for each in (result, measured)]
    assert ["nearest/first" in page for page in pages] == [False, True]


# ------------------------------------------------------------ hulls and meshes


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two-pandas-box", "kinova-pair"])
def test_hulls_miss_no_hit_of_meshes_at_1000_random_postures(name):
    """Pinocchio's own reader and meshes, each arm by itself, against the hulls of the cell."""
    scenario, rng = cp.Scenario.load(name), np.random.default_rng(0)
    cell = scenario.cell
    bodies = CellDistances(cell)
    arms = {}
    for arm_name, arm in cell.arms.items():
        whole = load_unreduced_arm(arm)
        geometry = pin.buildGeomFromUrdf(
            whole.model,
            str(arm.file.path),
            pin.GeometryType.COLLISION,
            None,
            list(map(str, arm.file.package_dirs)),
        )
        model, geometry = pin.buildReducedModel(whole.model, geometry, whole.locked, whole.configuration)
        arms[arm_name] = (
            model,
            model.createData(),
            geometry,
            geometry.createData(),
            JointLimits(arm, arm_name),
        )
    box = coal.Box(*cell.payload.size)
    pairs, requests = {*bodies.pairs}, coal.CollisionRequest()
    counts = np.zeros((2, 2), dtype=int)
    for _ in range(1000):
        q, placed = [], {"payload": [(box, pin.SE3(scenario.start.matrix))]}
        for arm_name, (model, data, geometry, results, limits) in arms.items():
            lower = np.where(np.isfinite(limits.lower), limits.lower, -np.pi)
            upper = np.where(np.isfinite(limits.upper), limits.upper, np.pi)
            q.append(limits.joints.configuration(rng.uniform(lower, upper)))
            pin.updateGeometryPlacements(model, data, geometry, results, q[-1])
            X_WB = pin.SE3(cell.arms[arm_name].base.matrix)
            for part, pose in zip(geometry.geometryObjects, results.oMg, strict=True):
                link = f"{arm_name}/{part.name.rpartition('_')[0]}"
                placed.setdefault(link, []).append((part.geometry, X_WB * pose))
        values = bodies.at(bodies.configuration(q, scenario.start.matrix))
        hulls = {pair for pair, value in zip(bodies.pairs, values, strict=True) if value <= 0.0}
        meshes = set()
        for pair in pairs:
            for (one, A), (other, B) in itertools.product(placed[pair[0]], placed[pair[1]]):
                if coal.collide(one, _pose(A), other, _pose(B), requests, coal.CollisionResult()):
                    meshes.add(pair)
                    break
        assert meshes <= hulls
        counts[int(bool(meshes)), int(bool(hulls))] += 1
    assert counts[1, 0] == 0
    assert counts[1, 1] > 50
    assert counts[0, 1] <= 10


def _pose(X: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(X.rotation, X.translation)


# ------------------------------------------------------------ shared joints

BALL = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
ON_LIFTS = {
    "planar": (planar_cell, planar_robot(), ("rail", "yaw"), (0.3, -0.4)),
    "spatial": (spatial_cell, spatial_robot(), ("lift", "yaw"), (0.35, -0.4)),
}


@pytest.mark.parametrize("name", ON_LIFTS)
def test_bodies_on_shared_joints_are_where_the_whole_robot_has_them(name, tmp_path):
    """Balls at the origins of all links, by kinematics in plain numpy."""
    make, text, joints, angles = ON_LIFTS[name]
    cell = make(tmp_path, **{joint: cp.actuators.SharedJoint() for joint in joints})
    file = tmp_path / f"{name}.urdf"
    file.write_text(text.replace("</inertial>", f"</inertial>{BALL}"))
    bodies, robot = CellDistances(cell), WholeRobot(text, cell.arms["left"].base.matrix)
    rng = np.random.default_rng(2)
    postures = [rng.normal(size=len(arm.posture)) for arm in cell.arms.values()]
    q = bodies.configuration(postures, np.eye(4), np.array(angles))
    names = itertools.chain(*(arm.moving_joints() for arm in cell.arms.values()))
    moved = zip(names, np.concatenate(postures), strict=True)
    at = dict(zip(joints, angles, strict=True)) | {"neck": 0.4} | dict(moved)
    still = dict.fromkeys(robot.names, 0.0)
    X = robot.motion(at, still, still)[0]
    links = [pair for pair in bodies.pairs if "payload" not in pair]
    assert {link for pair in links for link in pair} >= {f"left/{next(iter(X))}", "left/l3", "right/r3"}
    values = dict(zip(bodies.pairs, bodies.at(q).tolist(), strict=True))
    for one, other in links:
        a, b = (X[body.partition("/")[2]][:3, 3] for body in (one, other))
        assert abs(values[one, other] - (np.linalg.norm(a - b) - 0.02)) < 1e-6


def test_a_payload_that_a_lift_raises_leaves_its_table(tmp_path):
    """Its lowest corner is a gap above the table, and rises with the lift, in the plan as in the run."""
    rise, gap = 0.1, 0.02
    cell = spatial_cell(tmp_path, lift=cp.actuators.SharedJoint(follow="payload"))
    X = cell.payload_pose
    corners = np.array([*itertools.product(*((-s / 2, s / 2) for s in cell.payload.size))])
    low = float((corners @ X.matrix[:3, :3].T)[:, 2].min()) + X.xyz[2]
    bench = {"xyz": (*X.xyz[:2], low - gap), "size": (2.0, 2.0), "mu": 0.4, "stiffness": 1e5}
    goal = cp.Pose(xyz=(*X.xyz[:2], X.xyz[2] + rise), rpy=X.rpy)
    motion = {"kind": "line", "start": X, "goal": goal, "duration": 0.5}
    gains = {"pose_gain": 10.0, "sign_gain": 0.25, "anchor_gain": 0.1, "transient_rate": 5.0}
    gains |= {"sliding_gain": (800.0, 800.0, 800.0, 15.0, 15.0, 15.0)}
    law = {"kind": "payload-space", "gains": gains, "force_path": {"kind": "late"}}
    common = {"controller": law, "motion": motion, "start": X, "duration": 0.6}
    scenario = cp.Scenario(name="raise", cell=cell, clock={"rate_hz": 500.0}, **common)
    tabled = scenario.replace(cell=cell.replace(tables={"bench": bench}))
    planned = distances(tabled, poses=7)
    s = np.clip(planned.times / 0.5, 0.0, 1.0)
    rising = gap + rise * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    assert {*planned.pairs} == {("payload", "table/bench")}
    assert_allclose(planned.least, rising, rtol=0, atol=1e-5)
    run = cp.run(scenario, warn=False)
    result = type(run)(tabled, run.data)
    recorded = cp.findings.with_distances(result).data["least_distance"].values
    quaternions, height = run.data["payload_quaternion"].values, run.data["payload_position"].values[:, 2]
    lowest = np.array([(corners @ R.T)[:, 2].min() for R in rotations(quaternions)]) + height
    assert_allclose(recorded, lowest - (low - gap), rtol=0, atol=1e-6)
    assert_allclose(recorded[-1], gap + rise, rtol=0, atol=1e-3)
