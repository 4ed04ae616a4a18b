"""Replay page: its clock, poses, wrenches and legend against the result; and that it needs no other file."""

from __future__ import annotations

import base64
import html
import itertools
import json
import re
import subprocess
import sys
import warnings
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
import xarray as xr
import zmq
from cells import planar_scenario, spatial_scenario
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from tiers import by_default

import coop_pin as cp
from coop_pin import run, viz
from coop_pin.base.errors import FieldError, UrdfWarning
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose, quaternions, rotations
from coop_pin.description.catalogue import scenario_names
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.description.urdf import find_urdf
from coop_pin.figures import palette
from coop_pin.grasps.spring_damper import partner_state
from coop_pin.model import geometry, meshes
from coop_pin.model.pinocchio_model import load_unreduced_arm
from coop_pin.model.shapes import Mesh, half_extents
from coop_pin.model.visuals import CellVisuals
from coop_pin.results.run_result import RunResult
from coop_pin.viz import notebook_view, replay_html, save_replay
from coop_pin.viz.cell_scene import LINK_FACES, cell_scene
from coop_pin.viz.contact_scene import ABSENT, HOLDS, SLIDES, contact_items, contact_nodes, contact_poses
from coop_pin.viz.curves import thinned_rows
from coop_pin.viz.frames import frame_samples
from coop_pin.viz.highlights import instants, read_number, telling_instant, verdict_lines
from coop_pin.viz.live.live_scene import LiveScene, initial_scene
from coop_pin.viz.page import page_scripts
from coop_pin.viz.replay import run_names, shared_caption
from coop_pin.viz.scene import TYPICAL_M, recorded_scales

SCRIPTS = ("labels.js", "forces.js", "stage.js", "plots.js", "player.js")
FLOAT32 = 3e-7
"""Frames are single precision: relative error of a number."""


class Replay:
    """Replay page read back: its data, and the frames of its first run by blocks."""

    def __init__(self, result: RunResult) -> None:
        self.result, self.page = result, replay_html(result)
        text = re.search(r'<script type="application/json" id="data">(.*?)</script>', self.page, re.DOTALL)[1]
        self.data = json.loads(text)
        self.run = self.data["runs"][0]
        width = sum(self.run["blocks"].values())
        self.frames = floats(self.run["frames"]).reshape(-1, width)
        self.curves = floats(self.run["curves"]).reshape(-1, self.run["columns"])

    def block(self, name: str) -> np.ndarray:
        start = 0
        for block, width in self.run["blocks"].items():
            if block == name:
                return self.frames[:, start : start + width]
            start += width
        raise KeyError(name)

    def poses(self, node: str) -> np.ndarray:
        return self.block("poses").reshape(len(self.frames), -1, 7)[:, self.run["nodes"].index(node)]

    def items(self, below: str) -> list[dict]:
        return [item for item in self.run["scene"]["items"] if item["node"].startswith(below)]

    def curve(self, plot: str, role: str = "actual", number: int = 0) -> np.ndarray:
        (found,) = (one for one in self.data["plots"] if one["key"] == plot)
        curves = [curve for curve in found["curves"] if curve["role"] == role]
        return self.curves[:, curves[number]["column"]]

    def samples(self) -> np.ndarray:
        """Recorded samples that the frames show."""
        time = self.result.data["time"].values
        return np.searchsorted(time, self.block("time")[:, 0] - 1e-5)


def floats(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4").astype(float)


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


def test_frames_are_at_recorded_times_evenly_with_start_end_and_instants(replay: Replay) -> None:
    recorded, kept = replay.result.data["time"].values, replay.samples()
    assert replay.data["duration"] == recorded[-1] == replay.result.end
    assert_allclose(replay.block("time")[:, 0], recorded[kept], rtol=FLOAT32, atol=1e-9)
    assert (kept[0], kept[-1]) == (0, len(recorded) - 1)
    assert np.diff(recorded[kept]).max() <= 1 / 30 + 1.5 * recorded[1] + 1e-9
    for instant in [replay.data["start"], *(chip["time"] for chip in replay.data["instants"])]:
        assert np.abs(recorded[kept] - instant).min() < 1e-6


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_recording_slower_than_the_frame_rate_is_kept_whole(count: int) -> None:
    assert_array_equal(frame_samples(np.arange(count) * 0.1, 30.0), np.arange(count))


def test_frame_samples_have_the_sample_that_holds_at_an_instant() -> None:
    kept = frame_samples(np.arange(1001) * 0.001, 10.0, [0.1234])
    assert 123 in kept
    assert len(kept) == 12


def test_events_and_windows_are_on_the_clock_of_the_run(planar: Replay) -> None:
    change, push = [span for span in planar.data["spans"] if span["kind"] == "event"]
    assert (change["start"], change["text"]) == (10.0, "mass 11.2 → 5.6 kg")
    assert (push["start"], push["end"]) == (10.0, 10.2)
    assert "(200, 100, 0) N" in push["text"]
    windows = [(span["start"], span["end"]) for span in planar.data["spans"] if span["kind"] == "window"]
    assert windows == [pytest.approx((2.0875, 9.9875)), pytest.approx((12.2125, 20.0))]
    assert windows == [*planar.result.windows_of("moving")]


# ---------------------------------------------------------------- highlights


def test_the_page_opens_at_the_largest_error_of_the_internal_force(planar: Replay) -> None:
    data = planar.result.data
    error = np.linalg.norm((data.internal_wrench - data.desired_internal_wrench).values[:, 0, :2], axis=1)
    worst = float(data.time.values[np.argmax(error)])
    assert planar.data["start"] == worst
    sample = int(np.searchsorted(data.time.values, worst))
    pull = float(data.internal_axial.values[sample, 0])
    text = telling_instant(planar.result).text
    assert f"{worst:.2f} s" in text
    assert f"pull the payload apart with {pull:.2g} N" in text
    assert "a squeeze of 10 N" in text
    assert "push" in text
    assert text in html.unescape(planar.page)
    moment = np.nan_to_num((data.internal_wrench - data.desired_internal_wrench).values[..., 3:])
    largest = np.linalg.norm(moment, axis=2).max()
    assert f"the internal moment is off by up to {largest:.2g} N m" in text


@pytest.mark.parametrize("seed", by_default(range(4), 0, 2))
def test_the_largest_error_is_that_of_all_samples_after_the_decay_of_the_start(seed) -> None:
    """Pushes at random times in runs of random lengths, planar and spatial."""
    rng = np.random.default_rng(seed)
    duration = float(rng.uniform(0.5, 8.0))
    push = {
        "kind": "wrench-pulse",
        "time": float(rng.uniform(0.05, 0.8)) * duration,
        "duration": 0.1,
        "wrench": rng.uniform(60.0, 120.0, 6) * (1, 1, 0, 0, 0, 0.05),
    }
    name = ("adept-anchored", "two-pandas-box")[seed % 2]
    result = cp.run(name, {"duration": duration, "events": [push]}, engine="auto", warn=False)
    data, time = result.data, result.data.time.values
    parts = [np.nan_to_num(data[f"internal_{part}_error"].values) for part in ("axial", "shear")]
    error = np.hypot(*parts).max(axis=1)
    after = time >= push["time"]
    assert error[after].max() > 5.0
    told = telling_instant(result)
    assert told.time == time[after][error[after].argmax()]
    assert any(f"largest error {read_number(error[after].max())} N" in chip.text for chip in instants(result))


def test_chips_lead_to_the_extremes_and_one_instant_has_one_chip(planar: Replay) -> None:
    data = planar.result.data
    axial, shear, time = data.internal_axial.values, data.internal_shear.values, data.time.values
    chips = {text: chip["time"] for chip in planar.data["instants"] for text in chip["text"].split(", ")}
    times = [chip["time"] for chip in planar.data["instants"]]
    assert len(times) == len(set(times))
    assert next(iter(chips)) == "start"
    assert chips["push"] == chips["new mass"] == 10.0
    assert (
        chips[f"worst squeeze {-axial.min():.2g} N (off by {-axial.min() - 10.0:.2g} N)"]
        == time[axial.min(axis=1).argmin()]
    )
    assert chips[f"worst pull {axial.max():.2g} N"] == time[axial.max(axis=1).argmax()]
    assert chips[f"worst shear {shear.max():.2g} N"] == time[shear.max(axis=1).argmax()]
    error = np.hypot(axial - data.desired_internal_axial.values, shear).max(axis=1)
    assert chips[f"largest error {error.max():.2g} N"] == time[error.argmax()]
    assert chips["end"] == 20.0


def test_a_squeeze_that_is_wanted_has_no_chip() -> None:
    result = run("two-pandas-box", {"duration": 0.2})
    data = result.data.copy(deep=True)
    for name in ("axial", "shear"):
        data[f"internal_{name}"][:] = data[f"desired_internal_{name}"]
        data[f"internal_{name}_error"][:] = 0.0
    data["internal_wrench"][:] = data["desired_internal_wrench"]
    data["internal_moment_error"][:] = 0.0
    assert [chip.text for chip in instants(RunResult(result.scenario, data))] == ["start", "end"]
    data["internal_wrench"][-1, 0, 3] += 20.0
    data["internal_moment_error"][-1, 0] = 20.0
    moved = RunResult(result.scenario, data)
    assert [chip.text for chip in instants(moved)] == ["start", "largest moment error 20 N m, end"]
    assert "the internal moment is off by up to 20 N m" in telling_instant(moved).text
    cell = result.scenario.cell.model_copy(update={"rows": "positional"})
    free = RunResult(result.scenario.model_copy(update={"cell": cell}), data)
    assert "which no arm controls" in telling_instant(free).text


def test_grasps_away_from_the_payload_have_rods_and_hanging_arms_a_plate() -> None:
    cell = Scenario.load("five-joint-pair").cell
    items = cell_scene(cell, (), tips=np.zeros((2, 3)), path=np.zeros((1, 3)), shown=np.ones((2, 3))).items
    rods = [item for item in items if item.node == "payload" and item.colour == "#7d858f"]
    size = np.array(cell.payload.size) / 2.0
    for rod, X_PG in zip(rods, cell.grasps.values(), strict=True):
        half = rod.pose[:3, 2] * rod.drawable.length / 2.0
        assert_allclose(rod.pose[:3, 3] + half, X_PG.matrix[:3, 3], atol=1e-12)
        end = np.abs(rod.pose[:3, 3] - half) - size
        assert end.max() == pytest.approx(0.0, abs=1e-12)  # on the surface
    (plate,) = (item for item in items if item.node == "floor")
    assert 1.1 < plate.pose[2, 3] < 1.2  # above the base at 1.1 m
    flush = Scenario.load("adept-paper").cell
    drawn = cell_scene(flush, (), tips=np.zeros((2, 3)), path=np.zeros((1, 3)), shown=np.ones((2, 3))).items
    assert [item.node for item in drawn if item.colour == "#7d858f"] == []


def test_colours_differ_for_every_eye_and_those_of_arms_in_grey() -> None:
    """CIELAB distances of the colours, as seen with full and with deficient colour vision (Machado 2009)."""
    rows = {
        "full": (1, 0, 0, 0, 1, 0, 0, 0, 1),
        "protan": (0.1523, 1.0526, -0.2049, 0.1145, 0.7863, 0.0992, -0.0039, -0.0481, 1.052),
        "deutan": (0.3673, 0.8606, -0.228, 0.2801, 0.6725, 0.0474, -0.0118, 0.0429, 0.9689),
        "tritan": (1.2555, -0.0767, -0.1788, -0.0784, 0.9308, 0.1476, 0.0047, 0.6914, 0.3039),
    }
    eyes = {name: np.reshape(row, (3, 3)) for name, row in rows.items()}
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])

    def seen(colour: str, eye: str) -> np.ndarray:
        rgb = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        x, y, z = np.cbrt(to_xyz @ np.clip(eyes[eye] @ linear, 0.0, 1.0) / (0.9505, 1.0, 1.089))
        return np.array((116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)))

    for one, other in itertools.combinations([palette.arm(number) for number in range(4)], 2):
        assert min(np.linalg.norm(seen(one, eye) - seen(other, eye)) for eye in eyes) > 15.0
        assert abs(seen(one, "full")[0] - seen(other, "full")[0]) > 10.0
    payload = (palette.ACTUAL, "#06263d", "#f0883e")
    arrows = (
        palette.INTERNAL,
        palette.LOAD,
        palette.EXTERNAL,
        palette.DESIRED,
    )  # in grey their shafts differ
    runs = [palette.series(number) for number in range(4)]  # in grey their dashes differ
    for meanings in (payload, arrows, runs):
        for one, other in itertools.combinations(meanings, 2):
            assert min(np.linalg.norm(seen(one, eye) - seen(other, eye)) for eye in eyes) > 15.0


def test_the_sentence_names_the_arm_where_there_are_three() -> None:
    result = run("three-ur5-plate", {"duration": 0.1}, warn=False)
    for part, said in (
        ("shear", "load the payload across with 50 N at arm 'second', where none is wanted"),
        ("axial", "pull the payload apart with 50 N at arm 'second', where"),
    ):
        data = result.data.copy(deep=True)
        data[f"internal_{part}"][-1, 1] = 50.0
        data[f"internal_{part}_error"][-1, 1] = 50.0
        assert said in telling_instant(RunResult(result.scenario, data)).text


def test_a_force_that_the_motion_hides_is_called_so(spatial: Replay) -> None:
    data = spatial.result.data.copy(deep=True)
    data["internal_axial"][100:, 0] += 50.0
    data["internal_axial_error"][100:, 0] += 50.0
    data["pose_error"][:] = 1e-4
    loaded = RunResult(spatial.result.scenario, data)
    text = telling_instant(loaded).text
    assert "pull the payload apart with" in text
    assert "nothing in the motion shows it" in text
    data["pose_error"][:] = 0.02
    assert "mm and" in telling_instant(loaded).text
    data["internal_axial_error"][:] = 0.0
    data["internal_shear_error"][:] = 0.0
    assert "stays within 0 N of what is wanted" in telling_instant(loaded).text


def test_breaches_of_trust_are_marked_at_their_first_times() -> None:
    weak = run("adept-paper", {"duration": 0.5, "events": (), "cell.arms.left.torque_limits": 3.0})
    page = Replay(weak)
    deviations = weak.task.deviations
    assert deviations
    assert not weak.breaches()
    assert [mark["time"] for mark in page.data["breaches"]] == [breach.time for breach in deviations]
    assert html.escape(weak.task.text) in page.page
    codes = page.block("warnings")
    saturated = weak.data["saturated"].values.astype(bool)[page.samples()]
    assert codes.shape[1] == 8
    assert_array_equal((codes == 2).any(axis=1), saturated.any(axis=(1, 2)))


def test_the_verdict_has_the_numbers_that_were_judged(planar: Replay, spatial: Replay) -> None:
    for result in (planar.result, spatial.result):
        allowed, (_, sound) = result.scenario.trust, verdict_lines(result)
        assert sound.is_good
        condition = result.data["jacobian_condition"].values.max()
        for number in (
            f"{max(result.closure_error_max()):.1g} m (allowed {allowed.closure_error:g})",
            f"{result.energy_balance_max():.1g} J",
            f"{condition:.2g} ({allowed.jacobian_condition:g})",
        ):
            assert number in sound.numbers
    data = planar.result.data.copy()
    for limit in (np.nan, 90.0):
        data["position_upper"] = xr.full_like(data["position_upper"], limit)
        _, sound = verdict_lines(RunResult(planar.result.scenario, data))
        assert ("joints within" in sound.numbers) == np.isfinite(limit)
    for line in verdict_lines(planar.result):
        assert html.escape(line.text) in planar.page
        assert html.escape(line.numbers) in planar.page


def test_a_cell_without_closures_is_not_told_how_far_its_grasps_are_closed() -> None:
    result = run("two-pandas-palms", {"duration": 0.1}, warn=False)
    assert result.closure_error_max() == (0.0, 0.0)
    assert all("closed" not in line.numbers for line in verdict_lines(result))


def test_the_weight_that_bends_a_payload_between_palms_is_no_error() -> None:
    """Its moment is that of half of the weight on the lever of a palm; the page names it."""
    result = run("two-pandas-palms", {"duration": 0.5}, warn=False)
    cell = result.scenario.cell
    lever = np.linalg.norm(cell.grasps["left"].matrix[:3, 3])
    bends = f"with up to {read_number(cell.payload.mass * 9.81 / 2.0 * lever)} N m"
    assert f"its weight bends the payload between the grasps {bends}" in telling_instant(result).text
    assert not any("moment" in chip.text for chip in instants(result))


def test_the_sentence_says_what_the_task_allows(planar: Replay) -> None:
    limits = planar.result.scenario.task
    text = telling_instant(planar.result).text
    assert f"The task allows {read_number(max(limits.force, 10.0 * limits.force_share))} N" in text
    assert (f"until {limits.recovery:g} s after an event" in text) == (limits.recovery > 0.0)


# ---------------------------------------------------------------- curves


def test_curves_are_the_recorded_quantities_and_mirrored_ones_appear_once(replay: Replay) -> None:
    data = replay.result.data
    samples = np.searchsorted(data["time"].values, replay.curves[:, 0] - 1e-5)
    for part in ("axial", "shear", "moment"):
        for role, prefix in (("actual", ""), ("desired", "desired_")):
            wanted = data[f"{prefix}internal_{part}"].values[samples, 0]
            assert_allclose(replay.curve(part, role), wanted, rtol=1e-6, atol=1e-6)
        (plot,) = (one for one in replay.data["plots"] if one["key"] == part)
        assert [curve["role"] for curve in plot["curves"]] == ["actual", "desired"]
    error = data["pose_error"].values[samples]
    assert_allclose(replay.curve("tracking"), 1e3 * np.linalg.norm(error[:, :3], axis=1), rtol=1e-6)
    torque = data["torque"].values[samples].reshape(len(samples), -1)
    limits = data["torque_limit"].values.ravel()
    key, wanted = ("share", 100.0 * torque / limits) if np.isfinite(limits).all() else ("torque", torque)
    for number in range(torque.shape[1]):
        assert_allclose(replay.curve(key, number=number), wanted[:, number], rtol=1e-6)
    (plot,) = (one for one in replay.data["plots"] if one["key"] in ("torque", "share"))
    limit = 100.0 if key == "share" else None
    assert [curve["limit"] for curve in plot["curves"]] == [limit] * torque.shape[1]


def test_thinned_curves_keep_their_extremes_and_ends() -> None:
    rows = np.column_stack((np.arange(30_000.0), np.random.default_rng(1).normal(size=(30_000, 3))))
    thin = thinned_rows(rows)
    assert len(thin) < 3000
    assert (np.diff(thin[:, 0]) > 0).all()
    assert_array_equal(thin.min(axis=0), rows.min(axis=0))
    assert_array_equal(thin.max(axis=0), rows.max(axis=0))
    assert_array_equal(thinned_rows(rows[:1000]), rows[:1000])


def test_what_was_measured_and_the_rate_of_the_proof_are_plotted_where_recorded(planar: Replay) -> None:
    data = planar.result.data.copy()
    for part in ("axial", "shear", "moment"):
        data[f"measured_internal_{part}"] = 1.1 * data[f"internal_{part}"]
    data["V_rate_3_sum"] = ("time", -np.arange(data.sizes["time"], dtype=float))
    page = Replay(RunResult(planar.result.scenario, data))
    assert_allclose(page.curve("axial", "measured"), 1.1 * page.curve("axial"), rtol=1e-5)
    assert page.curve("V_rate_3").min() == 1.0 - data.sizes["time"]
    assert "V_rate_3" not in [plot["key"] for plot in planar.data["plots"]]


def test_runs_side_by_side_have_one_copy_of_scripts_and_meshes_and_one_scale(spatial: Replay) -> None:
    runs = [
        spatial.result,
        run(spatial_scenario().replace(duration=0.2).override({"cell.payload.mass": 4.0})),
    ]
    page = replay_html(*runs)
    assert page.count(page_scripts()) == 1
    data = json.loads(
        re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1]
    )
    assert data["names"] == run_names(runs) == ["run 1", "run 2"]
    panes = [pane for _, pane in data["panes"]]
    assert [pane["runs"][0]["scene"]["meshes"] is None for pane in panes] == [False, True]
    scales = {json.dumps(pane["scales"]) for pane in panes}
    least = min(recorded_scales(each.scenario.cell, each.data).newtons_per_metre for each in runs)
    assert len(scales) == 1
    assert panes[0]["scales"]["forces"] == least
    for result, (layout, _), curves in zip(runs, data["panes"], data["curves"], strict=True):
        assert html.escape(telling_instant(result).text) in layout
        time, axial, distance = floats(curves).reshape(-1, 3).T
        at = result.data.sel(time=time, method="nearest")
        assert_allclose(np.abs(axial), np.abs(at["internal_axial"].values).max(axis=1), rtol=1e-6)
        assert_allclose(distance, 1e3 * np.linalg.norm(at["pose_error"].values[:, :3], axis=1), rtol=1e-6)


def test_more_than_four_runs_and_other_numbers_of_names_are_refused(planar: Replay) -> None:
    for runs, names in ((5, ()), (2, ("one",))):
        with pytest.raises(FieldError):
            replay_html(*[planar.result] * runs, names=names)


# ---------------------------------------------------------------- bodies


def test_every_visual_of_both_urdfs_is_drawn(planar: Replay) -> None:
    count = len(ElementTree.parse(find_urdf("adept_3dof").path).findall(".//visual"))
    for arm in ("left", "right"):
        assert len(planar.items(f"arms/{arm}/")) == count
    assert {item["drawable"]["kind"] for item in planar.items("arms/")} == {"box", "cylinder"}


def test_quill_of_a_planar_arm_is_at_its_recorded_tip(planar: Replay) -> None:
    data = planar.result.data.isel(time=planar.samples())
    for index, arm in enumerate(("left", "right")):
        quill = planar.poses(f"arms/{arm}/joint_3")
        assert_allclose(quill[:, :2], data["tip_position"].values[:, index, :2], atol=1e-6)
        assert_allclose(quill[:, 2], 0.375, atol=1e-6)


def test_a_tip_stays_fixed_in_the_last_body_of_its_arm(spatial: Replay) -> None:
    data = spatial.result.data.isel(time=spatial.samples())
    for index, arm in enumerate(("left", "right")):
        body = spatial.poses(f"arms/{arm}/wrist_3_joint")
        turn = Rotation.from_quat(body[:, 3:])
        seen = turn.inv().apply(data["tip_position"].values[:, index] - body[:, :3])
        assert_allclose(seen, np.tile(seen[0], (len(seen), 1)), atol=2e-6)
        assert_allclose(np.linalg.norm(seen[0]), 0.0823, atol=1e-4)  # the length of a UR5's last link


def test_payload_and_ghost_follow_the_recorded_poses(replay: Replay) -> None:
    data = replay.result.data.isel(time=replay.samples())
    for path in ("payload", "desired"):
        assert_allclose(replay.poses(path)[:, :3], data[f"{path}_position"].values, atol=1e-6)
        assert_allclose(replay.poses(path)[:, 3:], data[f"{path}_quaternion"].values, atol=1e-6)
    (ghost,) = replay.items("desired")
    assert ghost["opacity"] < 0.5


def test_wrenches_of_frames_are_those_of_the_result(replay: Replay) -> None:
    data = replay.result.data.isel(time=replay.samples())
    names = ("interaction_wrench", "internal_wrench", "desired_internal_wrench", "external_wrench")
    for block, name in zip(("interaction", "internal", "wanted", "external"), names, strict=True):
        wanted = np.nan_to_num(data[name].values).reshape(len(replay.frames), -1)
        assert_allclose(replay.block(block), wanted, rtol=FLOAT32, atol=1e-12)
    scenario, struts = replay.result.scenario, replay.block("struts")  # tension, twist; then those wanted
    u = data["tip_position"].values[:, 1] - data["tip_position"].values[:, 0]
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    desired = np.nan_to_num(data["desired_internal_wrench"].values[:, 0, :3])
    assert_allclose(struts[:, 2], (desired * u).sum(axis=1), rtol=1e-5, atol=1e-6)
    resultant = (np.nan_to_num(data["interaction_wrench"].values)[..., :3].sum(axis=1) * u).sum(axis=1)
    shift = (scenario.cell.shares[0] - 0.5) * resultant  # struts divide what moves the payload equally
    assert_allclose(struts[:, 0], data["internal_axial"].values[:, 0] + shift, rtol=1e-5, atol=1e-5)
    tips = data["tip_position"].values.reshape(len(replay.frames), -1)
    assert_allclose(replay.block("tips"), tips, rtol=FLOAT32, atol=1e-7)


def test_welded_and_free_payload_show_the_same_arms(spatial: Replay) -> None:
    welded = spatial.result
    cell, q = welded.scenario.cell, welded.data["configuration"].values[:5]
    payload = np.concatenate(
        (welded.data["payload_position"].values[:5], welded.data["payload_quaternion"].values[:5]), axis=1
    )
    free = CellVisuals(cell, "free").poses(np.concatenate((q, payload), axis=1))
    assert_allclose(free, CellVisuals(cell, "welded").poses(q), atol=1e-12)


def test_thinned_links_are_light_keep_their_extent_and_are_stored_once(spatial: Replay) -> None:
    bodies = CellVisuals(spatial.result.scenario.cell, "welded").bodies
    meshes = [visual.shape for body in bodies[: len(bodies) // 2] for visual in body.visuals]
    tables = spatial.run["scene"]["meshes"]
    assert len(tables) == len(meshes) > 7  # two equal arms, with a piece for every colour
    for mesh, table in zip(meshes, tables, strict=True):
        assert isinstance(mesh, Mesh)
        steps, faces = (
            np.frombuffer(base64.b64decode(table[name]), dtype=kind).astype(int).reshape(-1, 3)
            for name, kind in (("vertices", "<u2"), ("faces", f"<u{table['bytes']}"))
        )
        vertices = table["low"] + steps * np.array(table["step"])
        assert len(faces) <= max(LINK_FACES, 0.97 * len(mesh.faces))
        assert faces.max() < len(vertices)
        assert_allclose(vertices.min(axis=0), mesh.vertices.min(axis=0), atol=0.005)
        assert_allclose(vertices.max(axis=0), mesh.vertices.max(axis=0), atol=0.005)


ROBOTS = ("adept-paper", "kinova-pair", "panda-ur5-bar")
"""Scenarios of the catalogue that have all its robots."""
OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in scenario_names() if name not in ROBOTS]


@pytest.mark.parametrize("name", [*ROBOTS, *OTHERS])
def test_arms_stand_on_the_floor(name: str) -> None:
    """The lowest drawn point of every base is on the floor or on a plate on it, but of one that hangs."""
    initial = initial_scene(name)
    items, _, floor = LiveScene(initial).scene
    plates = [item for item in items if item.node == "floor"]
    heights = [floor, *(plate.pose[2, 3] + plate.drawable.size[2] / 2 for plate in plates)]
    for plate in plates:
        assert_allclose(plate.pose[2, 3] - plate.drawable.size[2] / 2, floor, atol=1e-9)
    lowest = {}
    for item in items:
        if item.node.startswith("arms/") and item.node.endswith("/base"):
            X = initial.cell.arms[item.node.split("/")[1]].base.matrix @ item.pose
            corners = (
                item.drawable.vertices if isinstance(item.drawable, Mesh) else box_corners(item.drawable)
            )
            low = float((corners @ X[2, :3]).min() + X[2, 3])
            lowest[item.node] = min(low, lowest.get(item.node, np.inf))
    hanging = {f"arms/{arm}/base" for arm, one in initial.cell.arms.items() if one.base.matrix[2, 2] < 0.0}
    assert set(lowest) == {f"arms/{arm}/base" for arm in initial.cell.arms}
    for node, low in lowest.items():
        if node not in hanging:
            assert np.abs(np.subtract(heights, low)).min() < 1e-3


def box_corners(shape) -> np.ndarray:
    """Corners of the box around an upright box or cylinder."""
    half = half_extents(shape)
    return half * np.array(list(itertools.product((-1, 1), repeat=3)))


def seen_from(camera: dict, points: np.ndarray) -> np.ndarray:
    """Coordinates of points in the window, each between -1 and 1 where it is in view."""
    eye, target = np.array(camera["eye"]), np.array(camera["target"])
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    rays, half = points - eye, np.tan(np.radians(camera["field_of_view"] / 2.0))
    seen = np.stack((rays @ right / 1.4, rays @ np.cross(right, ahead)), axis=1)
    return np.abs(seen) / half / (rays @ ahead)[:, None]


def test_the_camera_is_close_and_has_links_path_and_arrows_in_view(replay: Replay) -> None:
    """Of arrows the ends by the formula of their lengths; what is framed fills the view."""
    camera, scales = replay.run["scene"]["camera"], replay.data["scales"]
    assert camera["follows"] is None
    tips = replay.block("tips").reshape(len(replay.frames), -1, 3)
    k = int(np.argmin(np.abs(replay.block("time")[:, 0] - replay.data["start"])))
    forces = -replay.block("internal")[k].reshape(-1, 6)[:, :3] / scales["forces"]
    length = np.linalg.norm(forces, axis=1, keepdims=True)
    drawn = np.where(length > 0.25, 0.25 * (1.0 + 0.4 * np.log(np.maximum(length, 1e-9) / 0.25)), length)
    arrows = forces / np.maximum(length, 1e-9) * np.minimum(drawn, 0.5)
    inwards = tips[k].mean(axis=0) - tips[k]
    squeezes = (arrows * inwards).sum(axis=1, keepdims=True) > 0.9 * np.linalg.norm(inwards, axis=1)[
        :, None
    ] * np.linalg.norm(arrows, axis=1, keepdims=True)
    ends = tips[k] + np.where(squeezes, -1.0, 1.0) * arrows
    links = [replay.poses(node)[k : k + 1, :3] for node in replay.run["nodes"] if node.startswith("arms/")]
    points = np.concatenate((tips.reshape(-1, 3), ends, replay.poses("payload")[:, :3], *links))
    assert seen_from(camera, points).max() < 1.0
    shown = np.concatenate([corners_of(item, replay, k) for item in replay.items("arms/")])
    assert 0.85 < seen_from(camera, np.concatenate((points, shown))).max() < 1.0


def corners_of(item: dict, replay: Replay, k: int) -> np.ndarray:
    """Corners of the box around a drawn shape of a link, in the world, in frame k."""
    shape, X = item["drawable"], np.reshape(item["pose"], (4, 4)).T
    if shape["kind"] == "mesh":
        table = replay.run["scene"]["meshes"][shape["mesh"]]
        steps = np.frombuffer(base64.b64decode(table["vertices"]), dtype="<u2").reshape(-1, 3)
        points = table["low"] + steps * np.array(table["step"])
    else:
        size = shape["size"]
        half = np.array(size) / 2 if shape["kind"] == "box" else np.array((size[0], size[0], size[1] / 2))
        points = half * np.array(list(itertools.product((-1, 1), repeat=3)))
    p, R = replay.poses(item["node"])[k, :3], Rotation.from_quat(replay.poses(item["node"])[k, 3:])
    return R.apply(points @ X[:3, :3].T + X[:3, 3]) + p


@pytest.mark.gate
def test_a_payload_that_travels_is_followed_and_its_bases_are_in_view_at_the_opening_instant() -> None:
    page = Replay(run("three-driven-ur5", {"duration": 5.0}, warn=False))
    camera = page.run["scene"]["camera"]
    k = int(np.argmin(np.abs(page.block("time")[:, 0] - page.data["start"])))
    assert_allclose(camera["follows"], page.poses("payload")[k, :3], atol=1e-6)
    links = [page.poses(node)[k, :3] for node in page.run["nodes"] if node.startswith("arms/")]
    assert seen_from(camera, np.array(links)).max() < 1.0


@pytest.mark.gate
def test_two_arms_of_one_robot_are_seen_from_the_front_and_whole() -> None:
    initial = initial_scene("baxter-box")
    live = LiveScene(initial)
    camera, tips = live.scene.camera, initial.snapshot.tip_position
    (origins,) = live.frames.visuals.poses(initial.snapshot.configuration[None])[..., :3]
    assert seen_from(camera._asdict(), np.concatenate((origins, tips))).max() < 1.0
    base = np.array(initial.cell.arms["left"].base.xyz)
    ahead = (tips.mean(axis=0) - base)[:2]
    towards = (camera.eye - camera.target)[:2]
    assert ahead @ towards > 0.9 * np.linalg.norm(ahead) * np.linalg.norm(towards)


# ---------------------------------------------------------------- forces


def test_the_legend_has_the_scales_of_the_arrows(replay: Replay) -> None:
    scales = replay.data["scales"]
    assert f"0.1 m of arrow: {0.1 * scales['forces']:g} N, {0.1 * scales['moments']:g} N m<" in replay.page
    assert f"Beyond {scales['linear'] * scales['forces']:g} N" in replay.page
    recorded = recorded_scales(replay.result.scenario.cell, replay.result.data)
    assert (scales["forces"], scales["moments"]) == recorded


def test_undetermined_moments_have_neither_arrow_nor_legend(spatial: Replay) -> None:
    data = spatial.result.data.copy(deep=True)
    for name, value in (
        ("interaction_wrench", np.nan),
        ("internal_wrench", np.nan),
        ("external_wrench", 0.0),
    ):
        data[name][..., 3:] = value
    bare = Replay(RunResult(spatial.result.scenario, data))
    assert bare.data["scales"]["moments"] is None
    assert spatial.data["scales"]["moments"] is not None
    assert np.isfinite(bare.frames).all()


def test_what_all_captions_say_stands_over_the_panes_once() -> None:
    captions = ["changed: no events; tip off; alpha 0", "changed: no events; tip off"]
    assert shared_caption(captions).endswith(": no events; tip off")
    assert shared_caption([*captions, "A bar"]) == ""


def test_a_force_across_that_is_wanted_is_no_error(spatial: Replay) -> None:
    data = spatial.result.data.copy(deep=True)
    for name, value in (("internal_axial_error", 0.0), ("internal_shear_error", 0.25)):
        data[name][:] = value
    for name in ("internal_shear", "desired_internal_shear"):
        data[name][:] = 20.0
    assert "within 0.25 N" in telling_instant(RunResult(spatial.result.scenario, data)).text
    data["internal_shear_error"][:] = 7.0
    result = RunResult(spatial.result.scenario, data)
    assert "in another direction is wanted: off by 7 N" in telling_instant(result).text
    assert "largest error 7 N" in ", ".join(instant.text for instant in instants(result))


def test_a_run_without_a_push_has_no_line_for_it_in_the_legend(planar: Replay, spatial: Replay) -> None:
    assert planar.data["pushes"]
    assert not spatial.data["pushes"]


@pytest.mark.parametrize("factor", [1e-3, 0.3, 1.0, 7.0, 1e4])
def test_the_scales_of_arrows_are_round_and_fit_the_run(spatial: Replay, factor: float) -> None:
    data, cell = spatial.result.data.copy(deep=True), spatial.result.scenario.cell
    data["internal_wrench"] = factor * data["internal_wrench"]
    forces, moments = recorded_scales(cell, data)
    assert f"{forces:.6e}"[0] in "125"
    assert f"{moments:.6e}"[0] in "125"
    typical = np.median(np.linalg.norm(data["internal_wrench"].values[..., :3], axis=-1)) / forces
    assert 0.05 < typical <= TYPICAL_M + 1e-9
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
    ours = "".join(Path(viz.__file__).parent.joinpath("web", name).read_text() for name in SCRIPTS)
    assert not re.search(r"fetch\(|XMLHttpRequest|import\(|https?://", ours)
    assert replay.data["live"] is False  # so that no WebSocket is opened


def test_the_page_is_light_and_the_same_each_time(replay: Replay) -> None:
    assert len(replay.page.encode()) < 3e6
    assert replay_html(replay.result) == replay.page


def test_building_the_page_starts_no_process_and_opens_no_port(
    planar: Replay, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a replay must not do this")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    monkeypatch.setattr(zmq.Context, "socket", refuse)
    assert replay_html(planar.result) == planar.page


def test_names_are_text_and_not_markup(planar: Replay) -> None:
    scenario = planar.result.scenario.replace(name="<b>&'\"", summary="</script><i>$viewer")
    page = replay_html(RunResult(scenario, planar.result.data))
    assert "<h1>&lt;b&gt;&amp;&#x27;&quot;</h1>" in page
    assert "&lt;/script&gt;&lt;i&gt;$viewer" in page


def test_saving_leaves_the_page_and_nothing_else(planar: Replay, tmp_path) -> None:
    save_replay(planar.result, tmp_path / "out" / "replay.html")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["replay.html"]
    assert (tmp_path / "out" / "replay.html").read_text(encoding="utf-8") == planar.page


def test_a_notebook_gets_the_same_page_in_a_frame(planar: Replay) -> None:
    shown = notebook_view(planar.result, height=321)._repr_html_()
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', shown)[1]) == planar.page
    assert "height: 321px" in shown


def test_importing_the_package_loads_no_viewer() -> None:
    viewers = ("IPython", "meshcat", "matplotlib", "zmq")
    code = f"import sys, coop_pin.viz; print([name for name in {viewers} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_pieces_of_a_link_have_its_bounds_and_the_colours_of_its_file() -> None:
    """Pinocchio reads the same file without its materials: an independent check of axes and scale."""
    locked = {"panda_finger_joint1": 0.03}
    arm = Arm(urdf="panda", tip="panda_hand_tcp", locked=locked)
    whole = load_unreduced_arm(arm)
    located, _ = geometry.with_located_meshes(whole.text, arm.file)
    objects, _ = geometry.geometry_objects(whole.model, located)
    (link,) = (part for part in objects if part.name == "panda_link0_0")
    pieces = meshes.coloured_meshes(Path(link.meshPath), tuple(link.meshScale.ravel()))
    vertices, known = np.concatenate([mesh.vertices for mesh, _ in pieces]), link.geometry.vertices()
    assert_allclose(vertices.min(axis=0), known.min(axis=0), atol=1e-6)
    assert_allclose(vertices.max(axis=0), known.max(axis=0), atol=1e-6)
    assert len({colour for _, colour in pieces}) == len(pieces) >= 3


@pytest.mark.parametrize(
    "file",
    [
        "tiago_description/meshes/sensors/xtion_pro_live/xtion_pro_live.dae",
        "kinova_description/meshes/jaco_mounting_block.dae",
    ],
    ids=["textured", "no material"],
)
def test_a_mesh_without_a_plain_colour_is_drawn_whole(file) -> None:
    folders = Arm(urdf="panda", tip="panda_hand_tcp").file.package_dirs
    (path,) = {one for folder in folders for one in folder.glob(f"**/{file}")}
    vertices = np.concatenate([mesh.vertices for mesh, _ in meshes.coloured_meshes(path, (1.0, 1.0, 1.0))])
    known = trimesh.load_scene(path, process=False).bounds
    assert_allclose((vertices.min(axis=0), vertices.max(axis=0)), known, atol=1e-6)


# ---------------------------------------------------------------- locked joints


def test_links_beyond_a_locked_joint_are_drawn_at_the_locked_position() -> None:
    import yourdfpy

    locked = {"panda_finger_joint1": 0.03}  # the other finger mimics it
    arm = Arm(urdf="panda", tip="panda_hand_tcp", locked=locked)
    cell = Cell(arms={"only": arm}, payload=Payload.box(1.0, (0.1, 0.1, 0.1)), grasps={"only": Pose()})
    q = np.array((0.3, -0.4, 0.2, -1.9, 0.1, 1.6, 0.7))
    shown = CellVisuals(cell, "welded")
    drawn = dict(zip((body.name for body in shown.bodies), shown.poses(q[None])[0], strict=True))
    hand = next(body for body in shown.bodies if body.name == "only/panda_joint7")
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


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "endless.dae")) for name in HOSTILE]
)
def test_a_mesh_that_would_end_or_stop_the_process_or_is_not_finite_is_not_drawn(name, tmp_path):
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


@pytest.mark.slow
def test_the_page_of_a_long_run_has_as_many_numbers_as_that_of_one_of_some_minutes():
    """Frames are further apart."""
    lengths = [
        len(replay_html(cp.run("adept-paper", {"duration": duration}, engine="compiled", warn=False)))
        for duration in (20.0, 300.0, 400.0)
    ]
    assert lengths[1] > 1.5 * lengths[0]
    assert lengths[2] < 1.02 * lengths[1]


def test_cones_and_needles_show_friction_and_a_hand_where_its_partner_holds() -> None:
    """A cone has the angle of its mu about the normal, its needle the direction of the force on the arm."""
    scenario, rng = Scenario.load("two-pandas-palms"), np.random.default_rng(3)
    cell, n = scenario.cell, 4
    X_WP = np.stack([make_pose(rng.normal(size=3), rng.normal(size=3)) for _ in range(n)])
    patch = cell.patches["left"]
    bears = patch.mu * 10.0
    F = np.zeros((n, 2, 6))
    F[:, 0, :3] = (
        (0.5 * bears, 0.0, 10.0),
        (1.01 * bears, 0.0, 10.0),
        (0.0, 0.0, 0.0),
        (0.0, (1 - 1e-12) * bears, 10.0),
    )
    event = Scenario.load("human-partner").events[0]
    times = event.time + np.array((-0.1, 0.5, 1.0, event.duration + 0.1))
    states = [partner_state(event, time, X, np.zeros(6)) for time, X in zip(times, X_WP, strict=True)]
    samples = {
        "time": times,
        "payload_position": X_WP[:, :3, 3],
        "payload_quaternion": quaternions(X_WP[:, :3, :3]),
        "patch_wrench": F,
        "partner_deflection": np.stack([state.deflection for state in states]),
    }
    poses, codes = contact_poses(samples, cell, [event])
    assert contact_nodes(cell, [event]) == (
        "cones/left",
        "needles/left",
        "cones/right",
        "needles/right",
        "hand",
    )
    assert codes[:, 0].tolist() == [HOLDS, SLIDES, ABSENT, HOLDS]
    assert (codes[:, 2] == ABSENT).all()
    assert codes[:, 4].tolist() == [ABSENT, HOLDS, HOLDS, ABSENT]
    R = rotations(poses[..., 3:])
    normal = X_WP[:, :3, :3] @ cell.grasps["left"].matrix[:3, :3] @ patch.plane[:3, :3]
    assert_allclose(R[:, 0], normal, atol=1e-12)
    needles = np.einsum("nij,nj->ni", normal, F[:, 0, :3]) / np.linalg.norm(F[:, 0, :3], axis=1)[
        :, None
    ].clip(1e-9)
    assert_allclose(R[[0, 1, 3], 1, :, 2], needles[[0, 1, 3]], atol=1e-12)
    (cone,) = (item.drawable for item in contact_items(cell, ()) if item.node == "cones/left")
    rim = cone.vertices[1:]
    assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), patch.mu * rim[:, 2], rtol=1e-12)
    for k in (1, 2):
        X_WG = event.motion.at(times[k]).X_WP_d @ event.handle.matrix
        assert_allclose(poses[k, 4, :3], X_WG[:3, 3], atol=1e-12)
        assert_allclose(R[k, 4], X_WG[:3, :3], atol=1e-12)
    samples["patch_slip"] = np.array(((0.0, 0.0), (2e-6, 0.0), (2e-6, 0.0), (2e-6, 0.0)))
    assert contact_poses(samples, cell, ())[1][:, 0].tolist() == [HOLDS, SLIDES, ABSENT, HOLDS]
