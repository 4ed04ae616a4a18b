"""Replay page: its clock, poses, wrenches and legend against the result; and that it needs no other file."""

from __future__ import annotations

import base64
import html
import json
import re
import subprocess
import sys
import warnings
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
import umsgpack
import yourdfpy
import zmq
from cells import planar_scenario, spatial_scenario
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from coop_pin import run
from coop_pin.description import Arm, Cell, Payload, Pose
from coop_pin.description.urdf import find_urdf
from coop_pin.errors import UrdfWarning
from coop_pin.model import geometry
from coop_pin.model.shapes import Mesh
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import RunResult
from coop_pin.viz import notebook_view, replay_html, save_replay
from coop_pin.viz.arrows import HEAD_LENGTH_M, ArrowScales, quaternions_from_z, recorded_scales
from coop_pin.viz.cell_scene import LINK_VERTICES, cell_scene, replay_samples
from coop_pin.viz.scene import decimated, tube

FLOAT32 = 3e-7
"""Keyframes are single precision: relative error of a number."""


class Replay:
    """Replay page read back: its meshcat commands, by node."""

    def __init__(self, result: RunResult) -> None:
        self.result, self.page = result, replay_html(result)
        self.run = json.loads(
            re.search(r'<script type="application/json" id="data">(.*?)</script>', self.page, re.DOTALL)[1]
        )
        self.commands = [umsgpack.unpackb(base64.b64decode(message)) for message in self.run["messages"]]
        self.animations = next(command for command in self.commands if command["type"] == "set_animation")[
            "animations"
        ]

    def objects(self, below: str) -> dict[str, dict]:
        chosen = (
            command
            for command in self.commands
            if command["type"] == "set_object" and command["path"].startswith(f"/meshcat/{below}")
        )
        return {command["path"].removeprefix("/meshcat/"): command["object"] for command in chosen}

    def tracks(self, path: str) -> dict[str, dict]:
        clip = next(
            animation["clip"] for animation in self.animations if animation["path"] == f"/meshcat/{path}"
        )
        assert clip["fps"] == 1  # times are seconds
        return {track["name"]: track for track in clip["tracks"]}

    def values(self, path: str, name: str) -> np.ndarray:
        track = self.tracks(path)[f".{name}"]
        return floats(track["values"]).reshape(len(floats(track["times"])), -1)

    @property
    def scales(self) -> ArrowScales:
        return recorded_scales(self.result.scenario.cell, self.result.data)

    def samples(self) -> np.ndarray:
        return replay_samples(self.result.data["time"].values, 30.0)


def floats(packed: umsgpack.Ext) -> np.ndarray:
    assert packed.type == 0x17  # what meshcat's viewer reads as a Float32Array
    return np.frombuffer(packed.data, dtype="<f4").astype(float)


@pytest.fixture(scope="module")
def planar() -> Replay:
    return Replay(run(planar_scenario()))


@pytest.fixture(scope="module")
def spatial() -> Replay:
    return Replay(run(spatial_scenario()))


@pytest.fixture(params=["planar", "spatial"])
def replay(request: pytest.FixtureRequest) -> Replay:
    return request.getfixturevalue(request.param)


# ---------------------------------------------------------------- clock


def test_every_keyframe_is_at_a_recorded_time_and_the_last_at_the_end(replay: Replay) -> None:
    recorded = replay.result.data["time"].values
    assert replay.run["duration"] == recorded[-1] == replay.result.end
    for animation in replay.animations:
        for track in animation["clip"]["tracks"]:
            times = floats(track["times"])
            assert_allclose(times, recorded[replay.samples()], rtol=FLOAT32, atol=0.0)
            assert times[0] == 0.0
            assert_allclose(times[-1], recorded[-1], rtol=FLOAT32)


def test_a_20_s_run_has_600_frames_and_no_gap_is_longer_than_a_frame_and_a_tick(planar: Replay) -> None:
    kept = planar.result.data["time"].values[planar.samples()]
    assert len(kept) == 601
    assert np.diff(kept).max() <= 1 / 30 + 1 / 80 + 1e-9


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_recording_slower_than_the_frame_rate_is_kept_whole(count: int) -> None:
    assert_array_equal(replay_samples(np.arange(count) * 0.1, 30.0), np.arange(count))


def test_events_are_on_the_clock_of_the_run(planar: Replay) -> None:
    change, push = planar.run["events"]
    assert (change["start"], change["text"]) == (10.0, "mass 11.2 → 5.6 kg")
    assert (push["start"], push["end"]) == (10.0, 10.2)
    assert "(200, 100, 0) N" in push["text"]


# ---------------------------------------------------------------- bodies


def test_every_visual_of_both_urdfs_is_drawn(planar: Replay) -> None:
    count = len(ElementTree.parse(find_urdf("adept_3dof").path).findall(".//visual"))
    for arm in ("left", "right"):
        assert len(planar.objects(f"arms/{arm}/")) == count
    kinds = {shape["geometries"][0]["type"] for shape in planar.objects("arms/").values()}
    assert kinds == {"BoxGeometry", "CylinderGeometry"}


def test_quill_of_a_planar_arm_is_at_its_recorded_tip(planar: Replay) -> None:
    data = planar.result.data.isel(time=planar.samples())
    for index, arm in enumerate(("left", "right")):
        quill = planar.values(f"arms/{arm}/joint_3", "position")
        assert_allclose(quill[:, :2], data["tip_position"].values[:, index, :2], atol=1e-6)
        assert_allclose(quill[:, 2], 0.375, atol=1e-6)


def test_a_tip_stays_fixed_in_the_last_body_of_its_arm(spatial: Replay) -> None:
    data = spatial.result.data.isel(time=spatial.samples())
    for index, arm in enumerate(("left", "right")):
        path = f"arms/{arm}/wrist_3_joint"
        turn = Rotation.from_quat(spatial.values(path, "quaternion"))
        seen = turn.inv().apply(data["tip_position"].values[:, index] - spatial.values(path, "position"))
        assert_allclose(seen, np.tile(seen[0], (len(seen), 1)), atol=2e-6)
        assert_allclose(np.linalg.norm(seen[0]), 0.0823, atol=1e-4)  # the length of a UR5's last link


def test_payload_and_ghost_follow_the_recorded_poses(replay: Replay) -> None:
    data = replay.result.data.isel(time=replay.samples())
    for path, name in (("payload", "payload"), ("desired", "desired")):
        assert_allclose(replay.values(path, "position"), data[f"{name}_position"].values, atol=1e-6)
        assert_allclose(replay.values(path, "quaternion"), data[f"{name}_quaternion"].values, atol=1e-6)
    ghost = replay.objects("desired/shape")["desired/shape"]["materials"][0]
    assert ghost["transparent"]
    assert ghost["opacity"] < 0.5


def test_welded_and_free_payload_show_the_same_arms(spatial: Replay) -> None:
    welded = spatial.result
    cell, q = welded.scenario.cell, welded.data["configuration"].values[:5]
    payload = np.concatenate(
        (welded.data["payload_position"].values[:5], welded.data["payload_quaternion"].values[:5]), axis=1
    )
    free = CellVisuals(cell, "free").poses(np.concatenate((q, payload), axis=1))
    assert_allclose(free, CellVisuals(cell, "welded").poses(q), atol=1e-12)


def test_decimated_links_are_light_and_keep_their_extent(spatial: Replay) -> None:
    bodies = CellVisuals(spatial.result.scenario.cell, "welded").bodies
    meshes = [visual.shape for body in bodies for visual in body.visuals]
    assert len(meshes) == 14
    for mesh in meshes:
        assert isinstance(mesh, Mesh)
        thin = decimated(mesh, LINK_VERTICES)
        assert 300 < len(thin.vertices) <= LINK_VERTICES
        assert_allclose(thin.vertices.min(axis=0), mesh.vertices.min(axis=0), atol=0.012)
        assert_allclose(thin.vertices.max(axis=0), mesh.vertices.max(axis=0), atol=0.012)
        assert thin.faces.max() < len(thin.vertices)


def test_tube_keeps_its_radius_around_the_path() -> None:
    angle = np.linspace(0.0, 2.0, 80)
    path = np.column_stack((np.cos(angle), np.sin(angle), 0.3 * angle))
    around = tube(path, 0.01, 1e-4)
    assert around is not None
    distance = np.linalg.norm(around.vertices.reshape(80, -1, 3) - path[:, None], axis=2)
    assert_allclose(distance, 0.01, rtol=1e-9)
    assert tube(np.zeros((5, 3)), 0.01, 1e-4) is None


def test_the_camera_has_every_joint_and_the_whole_path_in_view(replay: Replay) -> None:
    scene = cell_scene(replay.result)
    eye, target, field = scene.camera
    moved = [
        track.position
        for track in scene.tracks
        if track.position is not None and not track.path.startswith(("forces/", "moments/"))
    ]
    rays = np.concatenate(moved) - eye
    ahead = (target - eye) / np.linalg.norm(target - eye)
    angle = np.degrees(np.arccos(rays @ ahead / np.linalg.norm(rays, axis=1)))
    assert angle.max() < field / 2


# ---------------------------------------------------------------- forces


def drawn_vector(replay: Replay, path: str) -> tuple[np.ndarray, np.ndarray]:
    """Start and vector of an arrow, m, as three.js draws it."""
    along = Rotation.from_quat(replay.values(path, "quaternion")).apply((0.0, 0.0, 1.0))
    head = (
        replay.values(f"{path}/head", "position")[:, 2]
        + HEAD_LENGTH_M * replay.values(f"{path}/head", "scale")[:, 2]
    )
    return replay.values(path, "position"), head[:, None] * along


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize(
    ("group", "rows", "least"), [("forces", slice(0, 3), 10.0), ("moments", slice(3, 6), 0.2)]
)
def test_arrows_are_the_wrenches_of_the_result(
    replay: Replay, group: str, rows: slice, least: float, index: int
) -> None:
    data, arm = replay.result.data.isel(time=replay.samples()), ("left", "right")[index]
    scale = replay.scales.newtons_per_metre if group == "forces" else replay.scales.newton_metres_per_metre
    origin, internal = drawn_vector(replay, f"{group}/{arm}/internal")
    _, load = drawn_vector(replay, f"{group}/{arm}/load")
    wanted_internal = np.nan_to_num(data["internal_wrench"].values)[:, index, rows]
    wanted_load = np.nan_to_num(data["interaction_wrench"].values)[:, index, rows] - wanted_internal
    assert_allclose(origin, data["tip_position"].values[:, index], atol=1e-6)
    assert_allclose(
        internal, wanted_internal / scale, rtol=1e-5, atol=3e-6
    )  # the smallest an arrow can be is 1e-6 of its head
    assert_allclose(load, wanted_load / scale, rtol=1e-5, atol=3e-6)
    assert np.linalg.norm(wanted_internal, axis=1).max() > least  # there was something to draw


def test_the_legend_has_the_scales_of_the_arrows(replay: Replay) -> None:
    assert f"force: 0.1 m is {0.1 * replay.scales.newtons_per_metre:g} N<" in replay.page
    assert f"moment: 0.1 m is {0.1 * replay.scales.newton_metres_per_metre:g} N m<" in replay.page


def test_moments_of_planar_arms_are_vertical(planar: Replay) -> None:
    for arm in ("left", "right"):
        _, moment = drawn_vector(planar, f"moments/{arm}/internal")
        assert_allclose(moment[:, :2], 0.0, atol=1e-6)
        assert np.abs(moment[:, 2]).max() > 0.2


def test_forces_and_moments_have_different_heads(replay: Replay) -> None:
    for group, points in (("forces", 1), ("moments", 2)):
        heads = replay.objects(f"{group}/left/internal/head/")
        assert len(heads) == points
        assert_allclose(
            [shape["geometries"][0]["height"] for shape in heads.values()],
            HEAD_LENGTH_M / points,
            rtol=FLOAT32,
        )
    force, moment = (
        replay.objects(f"{group}/left/internal/shaft/")[f"{group}/left/internal/shaft/body"]
        for group in ("forces", "moments")
    )
    assert moment["materials"][0]["color"] == force["materials"][0]["color"]
    assert moment["geometries"][0]["radiusTop"] < force["geometries"][0]["radiusTop"]


def test_undetermined_moments_have_neither_arrow_nor_legend(spatial: Replay) -> None:
    data = spatial.result.data.copy(deep=True)
    for name, value in (
        ("interaction_wrench", np.nan),
        ("internal_wrench", np.nan),
        ("external_wrench", 0.0),
    ):
        data[name][..., 3:] = value
    bare = Replay(RunResult(spatial.result.scenario, data))
    assert not bare.objects("moments/")
    assert bare.objects("forces/")
    assert "moment: " not in bare.page


@pytest.mark.parametrize("group", ["forces", "moments"])
def test_shaft_and_head_meet(replay: Replay, group: str) -> None:
    path = f"{group}/left/internal"
    shaft, head = (
        replay.values(f"{path}/shaft", "scale")[:, 2],
        replay.values(f"{path}/head", "position")[:, 2],
    )
    assert_allclose(shaft, head, atol=2e-6)


@pytest.mark.parametrize("group", ["forces", "moments"])
def test_internal_arrows_of_two_arms_are_opposite(replay: Replay, group: str) -> None:
    left, right = (drawn_vector(replay, f"{group}/{arm}/internal")[1] for arm in ("left", "right"))
    assert_allclose(left, -right, atol=1e-5)


@pytest.mark.parametrize(("group", "push"), [("forces", (200.0, 100.0, 0.0)), ("moments", (0.0, 0.0, 2.0))])
def test_the_push_is_drawn_on_the_payload_while_it_lasts(
    planar: Replay, group: str, push: tuple[float, ...]
) -> None:
    scale = planar.scales.newtons_per_metre if group == "forces" else planar.scales.newton_metres_per_metre
    origin, drawn = drawn_vector(planar, f"{group}/external")
    time = planar.result.data["time"].values[planar.samples()]
    during = (time >= 10.0) & (time < 10.2)
    assert_allclose(origin, planar.result.data["payload_position"].values[planar.samples()], atol=1e-6)
    assert_allclose(scale * drawn[during], np.tile(push, (during.sum(), 1)), rtol=1e-5, atol=1e-3)
    assert_allclose(drawn[~during], 0.0, atol=1e-6)


def test_a_run_without_a_push_has_no_arrow_for_it(spatial: Replay) -> None:
    assert not spatial.objects("forces/external")
    assert not spatial.objects("moments/external")
    assert "push on the payload" not in spatial.page


def test_forces_are_held_between_ticks_and_bodies_are_interpolated(replay: Replay) -> None:
    hold = 2300  # three.js: InterpolateDiscrete
    for arrow in ("forces/left/internal", "forces/right/load", "moments/left/internal", "moments/right/load"):
        for path in (arrow, f"{arrow}/shaft", f"{arrow}/head"):
            assert {track.get("interpolation") for track in replay.tracks(path).values()} == {hold}
    assert {track.get("interpolation") for track in replay.tracks("payload").values()} == {None}


def test_quaternions_rotate_z_to_any_vector() -> None:
    vectors = np.concatenate(
        (np.random.default_rng(1).normal(size=(200, 3)), np.eye(3), -np.eye(3), [[1e-7, 0.0, -1.0]])
    )
    turned = Rotation.from_quat(quaternions_from_z(vectors)).apply((0.0, 0.0, 1.0))
    assert_allclose(turned, vectors / np.linalg.norm(vectors, axis=1, keepdims=True), atol=1e-7)
    assert_array_equal(quaternions_from_z(np.zeros((1, 3))), [[0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize("factor", [1e-3, 0.3, 1.0, 7.0, 1e4])
def test_the_scales_of_arrows_are_round_and_fit_the_run(spatial: Replay, factor: float) -> None:
    data, cell = spatial.result.data.copy(deep=True), spatial.result.scenario.cell
    data["internal_wrench"] = factor * data["internal_wrench"]
    forces, moments = recorded_scales(cell, data)
    assert f"{forces:.6e}"[0] in "125"
    assert f"{moments:.6e}"[0] in "125"
    typical = np.median(np.linalg.norm(data["internal_wrench"].values[..., :3], axis=-1)) / forces
    assert 0.07 < typical <= 0.2 + 1e-9
    lever = max(np.linalg.norm(grasp.xyz) for grasp in cell.grasps.values())
    assert (
        0.4 * lever - 1e-9 <= moments / forces <= lever + 1e-9
    )  # a moment is drawn as long as its force on that lever, or longer


# ---------------------------------------------------------------- page


class _References(HTMLParser):
    """Collects everything by which a page could request another file."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [
            f"{tag} {name}={value}"
            for name, value in attrs
            if name in {"src", "href", "srcset", "data", "action"}
        ]
        if tag in {"link", "img", "iframe", "object", "base"}:
            self.found.append(tag)


def test_the_page_refers_to_nothing_outside_itself(replay: Replay) -> None:
    references = _References()
    references.feed(replay.page)
    assert references.found == ["link href=data:,", "link"]  # an empty icon, so that browsers request none
    style = re.search(r"<style>(.*?)</style>", replay.page, re.DOTALL)[1]
    assert "url(" not in style
    assert "@import" not in style
    ours = replay.page[replay.page.rindex("<script>") :]
    assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|import\(|https?://", ours)


def test_the_page_is_light_and_the_same_each_time(replay: Replay) -> None:
    assert len(replay.page.encode()) < 3e6
    assert replay_html(replay.result) == replay.page


def test_building_the_page_starts_no_process_and_opens_no_port(
    spatial: Replay, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a replay must not do this")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    monkeypatch.setattr(zmq.Context, "socket", refuse)
    assert replay_html(spatial.result) == spatial.page


def test_names_are_text_and_not_markup(spatial: Replay) -> None:
    scenario = spatial.result.scenario.replace(name="<b>&'\"", summary="</script><i>$viewer")
    page = replay_html(RunResult(scenario, spatial.result.data))
    assert "<h1>&lt;b&gt;&amp;&#x27;&quot;</h1>" in page
    assert "&lt;/script&gt;&lt;i&gt;$viewer" in page


def test_saving_leaves_the_page_and_nothing_else(spatial: Replay, tmp_path) -> None:
    save_replay(spatial.result, tmp_path / "out" / "replay.html")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["replay.html"]
    assert (tmp_path / "out" / "replay.html").read_text(encoding="utf-8") == spatial.page


def test_a_notebook_gets_the_same_page_in_a_frame(spatial: Replay) -> None:
    shown = notebook_view(spatial.result, height=321)._repr_html_()
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', shown)[1]) == spatial.page
    assert "height: 321px" in shown


def test_importing_the_package_loads_no_viewer() -> None:
    viewers = ("IPython", "meshcat", "matplotlib", "zmq")
    code = f"import sys, coop_pin.viz; print([name for name in {viewers} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# ---------------------------------------------------------------- locked joints


def test_links_beyond_a_locked_joint_are_drawn_at_the_locked_position() -> None:
    locked = {"panda_finger_joint1": 0.03}  # the other finger mimics it
    arm = Arm(urdf="panda", tip="panda_hand_tcp", locked=locked)
    cell = Cell(arms={"only": arm}, payload=Payload.box(1.0, (0.1, 0.1, 0.1)), grasps={"only": Pose()})
    q = np.array((0.3, -0.4, 0.2, -1.9, 0.1, 1.6, 0.7))
    visuals = CellVisuals(cell, "welded")
    drawn = dict(zip((body.name for body in visuals.bodies), visuals.poses(q[None])[0], strict=True))
    hand = next(body for body in visuals.bodies if body.name == "only/panda_joint7")
    fingers = {visual.name: visual.pose for visual in hand.visuals if "finger" in visual.name}

    robot = yourdfpy.URDF.load(str(arm.file.path), load_meshes=False, build_scene_graph=True)
    robot.update_cfg({f"panda_joint{number}": angle for number, angle in enumerate(q, start=1)} | locked)
    assert len(fingers) == 2
    for name, pose in fingers.items():
        X_WJ = np.eye(4)
        X_WJ[:3, :3] = Rotation.from_quat(drawn[hand.name][3:]).as_matrix()
        X_WJ[:3, 3] = drawn[hand.name][:3]
        link = name.rsplit("_", 1)[0]
        (origin,) = [visual.origin for visual in robot.link_map[link].visuals]
        wanted = robot.get_transform(link) @ (np.eye(4) if origin is None else origin)
        assert_allclose(X_WJ @ pose, wanted, atol=1e-6)


# ---------------------------------------------------------------- unreadable meshes


BOX = trimesh.creation.box()
HOSTILE = {
    "crash.ply": BOX.export(file_type="ply")[:-1],
    "endless.dae": BOX.export(file_type="dae").replace(b"<p>1 1", b"<p>1 nan"),
    "nan.obj": BOX.export(file_type="obj").replace("0.5", "nan", 1).encode(),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_mesh_that_would_end_or_stop_the_process_or_is_not_finite_is_not_drawn(name, tmp_path, monkeypatch):
    monkeypatch.setattr(geometry, "_CPU_S", 1)
    (tmp_path / name).write_bytes(HOSTILE[name])
    text = find_urdf("adept_3dof").path.read_text()
    mesh = f'<mesh filename="package://{tmp_path.name}/{name}"/>'
    path = tmp_path / "hostile.urdf"
    path.write_text(text.replace('<box size="0.05 0.044 0.0275"/>', mesh))
    cell = planar_scenario().cell
    arm = cell.arms["left"].replace(urdf=str(path))
    with pytest.warns(UrdfWarning, match=r"hostile\.urdf"):
        bodies = CellVisuals(cell.replace(arms={**cell.arms, "left": arm}), "welded").bodies
    drawn = {body.name: len(body.visuals) for body in bodies}
    assert drawn["left/joint_3"] == drawn["right/joint_3"] - 1
    assert drawn["left/joint_2"] == drawn["right/joint_2"]


def test_an_unreadable_mesh_is_warned_of_and_the_rest_is_drawn(tmp_path) -> None:
    text = find_urdf("adept_3dof").path.read_text()
    broken = text.replace('<box size="0.05 0.044 0.0275"/>', '<mesh filename="package://nowhere/clamp.stl"/>')
    assert broken != text
    path = tmp_path / "broken.urdf"
    path.write_text(broken)
    cell = planar_scenario().cell
    arm = cell.arms["left"].replace(urdf=str(path))
    with pytest.warns(UrdfWarning, match=r"link 'link_3' of .*broken\.urdf.*clamp\.stl"):
        broken_bodies = CellVisuals(cell.replace(arms={**cell.arms, "left": arm}), "welded").bodies
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        whole = CellVisuals(cell, "welded").bodies
    missing = {body.name for body in whole} - {body.name for body in broken_bodies}
    assert missing == {"left/joint_3"}
