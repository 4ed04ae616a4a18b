"""Tests in a headless browser: live page, replay, report, site and notebooks; all but JupyterLab offline."""

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from browser import PATIENCE_MS, browser_page, offline_page
from cells import SCENARIOS, planar_scenario, spatial_scenario
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.description.catalogue import scenario_names
from coop_pin.viz import save_replay, save_report
from coop_pin.viz.highlights import telling_instant
from coop_pin.viz.live.live_scene import LiveScene, initial_scene
from coop_pin.viz.live.live_view import open_view
from coop_pin.viz.scene import recorded_scales

REPOSITORY = Path(__file__).parents[2]
NOTEBOOK = REPOSITORY / "notebooks" / "05_live_gains.ipynb"
NOTEBOOKS = sorted(path.stem for path in NOTEBOOK.parent.glob("*.ipynb"))

MESHES = """() => { let meshes = 0;
    coopPin.viewer.scene.traverse(part => { meshes += part.isMesh ? 1 : 0; });
    return meshes; }"""
NOW = "coopPin.time"
DESIRED = "coopPin.runs[0].columns[2]"
"""Desired axial internal force of the planar cell over time, N; column 1 is the actual one."""
STATE = "[coopPin.node('arms/left/joint_1').quaternion.toArray(), coopPin.runs[0].columns[1].at(-1)]"
WRONG = '[data-mime-type="application/vnd.jupyter.stderr"], [data-mime-type="application/vnd.jupyter.error"]'
ARROWS = """() => Object.fromEntries(Object.values(coopPin.arrows).map(arrow => [arrow.name,
    [...arrow.value.toArray(), ...arrow.tip.toArray(), ...arrow.object.position.toArray(),
     arrow.text.textContent]]))"""
"""Value, head and tail of every arrow, and its number."""
TOLD = """[coopPin.arrows["forces/left/internal"].value.length(),
    ...["axial", "shear"].map(key => coopPin.plots.value(coopPin.runs[0],
        coopPin.plots.plots.find(({ curves }) => curves[0].plot === key).curves[0].column)), coopPin.time]"""
"""Internal force as drawn, the two parts of it that tiles and captions have, and the time."""
STRUTS = """coopPin.struts.map(({ name, tension, twist, wanted, radius, text }) =>
    [name, tension, twist, wanted, radius, text.textContent])"""
LINEAR_M, LONGEST_M = 0.25, 0.5
PAYLOAD_PX = """() => {
    const { viewer, node } = coopPin, at = node("payload").position.clone().project(viewer.camera);
    const { left, top, width, height } = viewer.renderer.domElement.getBoundingClientRect();
    return [left + (1 + at.x) * width / 2, top + (1 - at.y) * height / 2]; }"""
"""Where the payload's centre is drawn, pixels from the corner of the page."""
AS_FAR_AS_THE_PANEL = ("import coop_pin as cp", "panel = Panel(scenario)")


def drawn_length(value: np.ndarray, per_metre: float) -> float:
    """Length of an arrow, m: linear, then with the logarithm, then capped."""
    length = float(np.linalg.norm(value)) / per_metre
    if length > LINEAR_M:
        length = LINEAR_M * (1 + 0.4 * np.log(length / LINEAR_M))
    return min(length, LONGEST_M)


def assert_arrows(page, scales, arms, tips, interaction, internal) -> None:
    """The arrows of all arms in the browser's scene, of wrenches on the payload: values, ends, numbers."""
    found = page.evaluate(ARROWS)
    for group, per_metre, rows in zip(("forces", "moments"), scales, (slice(0, 3), slice(3, 6)), strict=True):
        for index, arm in enumerate(arms):
            inner = np.nan_to_num(internal)[index, rows]
            for part, wanted in (
                ("internal", inner),
                ("load", np.nan_to_num(interaction)[index, rows] - inner),
            ):
                *numbers, text = found[f"{group}/{arm}/{part}"]
                value, end, start = np.array(numbers).reshape(3, 3)
                assert_allclose(value, -wanted, rtol=1e-5, atol=2e-5)
                assert_allclose(np.cross(end - tips[index], start - tips[index]), 0.0, atol=1e-6)
                assert (end - tips[index]) @ (start - tips[index]) < 1e-6  # the grasp is on the arrow
                assert_allclose(np.linalg.norm(end - start), drawn_length(wanted, per_metre), atol=1e-5)
                if np.linalg.norm(wanted) > 1e-3:
                    assert_allclose(
                        np.cross(end - start, value), 0.0, atol=1e-5 * (1 + np.linalg.norm(value))
                    )
                    assert_allclose(float(text.split()[0]), np.linalg.norm(wanted), rtol=0.06, atol=6e-4)


def assert_not_blank(image: bytes) -> None:
    """The middle of an image has many colours: a blank page has one, a background alone a few dozen."""
    pixels = (
        np.round(255 * matplotlib.image.imread(io.BytesIO(image))[150:600, 330:870, :3])
        .astype(int)
        .reshape(-1, 3)
    )
    assert len(np.unique(pixels, axis=0)) > 500
    assert pixels.std(axis=0).max() > 20


def next_frame(page) -> None:
    """Wait until the page has drawn its next frame, with which its labels are placed."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def drawn(page) -> bytes:
    """Screenshot of the page after its next frame."""
    next_frame(page)
    return page.screenshot()


@pytest.mark.gate
@pytest.mark.parametrize("name", [pytest.param("planar", marks=pytest.mark.slow), "spatial"])
def test_the_live_page_draws_the_cell_follows_the_run_and_has_it_after_a_reload(name):
    scenario = SCENARIOS[name]().replace(duration=1.0, events=())
    scene = LiveScene(initial_scene(scenario))
    view = open_view(scenario)
    with browser_page() as page:
        page.goto(view.url)
        page.wait_for_function("window.coopPin !== undefined")
        assert page.evaluate(MESHES) > len(scene.scene.items)
        assert_not_blank(drawn(page))
        seen = []

        def watch(snapshot) -> None:
            seen.append(snapshot)
            view.show(snapshot)

        run = threading.Thread(target=cp.run, args=(scenario,), kwargs={"view": watch, "realtime_rate": 0.5})
        run.start()
        page.wait_for_function(f"{NOW} > 0.99")
        run.join()
        page.wait_for_function(f"Math.abs({NOW} - {seen[-1].time!r}) < 1e-5")
        last = seen[-1]
        assert_arrows(
            page,
            scene.scales,
            scenario.cell.arms,
            last.tip_position,
            last.interaction_wrench,
            last.internal_wrench,
        )
        page.wait_for_function(
            "coopPin.plots.plots.every(({ u, line }) => parseFloat(line.style.left) < u.over.clientWidth + 1)"
        )
        position = page.evaluate("coopPin.node('payload').position.toArray()")
        assert_allclose(position, last.payload_pose[:3, 3], atol=1e-6)
        assert page.evaluate("coopPin.count") > 10
        assert_not_blank(drawn(page))
        page.reload()
        page.wait_for_function(f"window.coopPin !== undefined && coopPin.count === {len(seen)}")
        times = page.evaluate("Array.from(coopPin.runs[0].columns[0])")
        assert_allclose(times, [snapshot.time for snapshot in seen], atol=1e-6)
        view.close()
        page.wait_for_function("document.getElementById('status').textContent.startsWith('no connection')")


@pytest.mark.parametrize(
    "name",
    ["planar", *(pytest.param(name, marks=pytest.mark.slow) for name in ("spatial", "three-ur5-plate"))],
)
def test_arrows_and_struts_show_squeezes_and_pulls(name):
    scenario = cp.Scenario.load(name) if name == "three-ur5-plate" else SCENARIOS[name]()
    view, snapshot = open_view(scenario), initial_scene(scenario).snapshot
    shown = iter(np.arange(0.1, 1.0, 0.1).tolist())
    with browser_page() as page:
        page.goto(view.url)
        page.wait_for_function("window.coopPin !== undefined")

        def show(wrench) -> None:
            time = next(shown)
            view.show(snapshot._replace(time=time, internal_wrench=wrench, interaction_wrench=wrench))
            page.wait_for_function(f"Math.abs({NOW} - {time}) < 1e-6")

        assert_a_squeeze_ends_at_the_grasps_and_a_pull_leaves_them(page, show, scenario, snapshot)
        assert_struts_show_what_acts_between_every_two_grasps(page, show, scenario, snapshot)
    view.close()


def assert_a_squeeze_ends_at_the_grasps_and_a_pull_leaves_them(page, show, scenario, snapshot) -> None:
    tips = snapshot.tip_position
    inwards = tips.sum(axis=0) - len(tips) * tips
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    for newtons in (10.0, -10.0):
        wrench = np.zeros((len(tips), 6))
        wrench[:, :3] = -newtons * inwards  # on the arms
        show(wrench)
        found = page.evaluate(ARROWS)
        for arm, tip, inward in zip(scenario.cell.arms, tips, inwards, strict=True):
            _, head, tail = np.array(found[f"forces/{arm}/internal"][:-1]).reshape(3, 3)
            assert_allclose(head if newtons > 0.0 else tail, tip, atol=1e-6)
            other = tail if newtons > 0.0 else head
            assert (other - tip) @ inward < -0.05  # outside the payload
        assert page.locator("#tiles div").first.inner_text().split("\n")[0] == (
            "squeeze" if newtons > 0.0 else "pull apart"
        )


def assert_struts_show_what_acts_between_every_two_grasps(page, show, scenario, snapshot) -> None:
    """Tensions follow from forces towards the middle of the other tips, by the forces' components."""
    tips, arms = snapshot.tip_position, list(scenario.cell.arms)
    centre, per_metre = snapshot.payload_pose[:3, 3], LiveScene(initial_scene(scenario)).scales[0]
    pairs = [(i, j) for i in range(len(arms)) for j in range(i + 1, len(arms))]
    for newtons in (10.0, -3.0):  # a pull, then a squeeze, of each strut
        wrench = np.where(np.isnan(snapshot.interaction_wrench), np.nan, 0.0)
        for i, j in pairs:
            u = (tips[j] - tips[i]) / np.linalg.norm(tips[j] - tips[i])
            for end, force in ((i, newtons * u), (j, -newtons * u)):
                wrench[end] += np.concatenate((force, np.cross(tips[end] - centre, force)))
        show(wrench)
        found = page.evaluate(STRUTS)
        assert [strut[0] for strut in found] == [f"{arms[i]} to {arms[j]}" for i, j in pairs]
        desired = snapshot.desired_internal_wrench[:, :3]
        for (i, j), (_, tension, twist, wanted, radius, text) in zip(pairs, found, strict=True):
            assert (tension, twist) == (pytest.approx(newtons, abs=1e-4), pytest.approx(0.0, abs=1e-4))
            assert text.startswith("pulled apart 10 N" if newtons > 0.0 else "squeezed 3 N")
            assert wanted < 0.0  # every cell wants a squeeze
            if len(arms) == 2:
                u = (tips[j] - tips[i]) / np.linalg.norm(tips[j] - tips[i])
                assert wanted == pytest.approx(desired[i] @ u, rel=1e-5)
            assert radius == pytest.approx(0.1 * drawn_length([newtons], per_metre), rel=1e-5)


def test_saturated_links_change_their_colour_and_get_it_back():
    scenario = planar_scenario().replace(duration=0.5, events=())
    view = open_view(scenario)
    snapshot = initial_scene(scenario).snapshot
    colour = """() => { let found = []; coopPin.node("arms/left/joint_1").traverse(part => {
        if (part.material) { found.push(part.material.color.getHexString()); } }); return found; }"""
    saturated, singular = snapshot.saturated.copy(), snapshot.jacobian_condition.copy()
    saturated[0, 0], singular[0] = True, 1e4
    with browser_page() as page:
        page.goto(view.url)
        page.wait_for_function("window.coopPin !== undefined")
        own = page.evaluate(colour)
        for number, (shown, wanted) in enumerate(
            (
                (snapshot._replace(saturated=saturated), ["f0e442"] * len(own)),
                (snapshot._replace(jacobian_condition=singular), ["56b4e9"] * len(own)),
                (snapshot, own),
            ),
            start=1,
        ):
            view.show(shown._replace(time=0.1 * number))
            page.wait_for_function(f"Math.abs({NOW} - {0.1 * number}) < 1e-6")
            assert page.evaluate(colour) == wanted
    view.close()


def test_the_replay_opens_paused_plays_seeks_zooms_and_switches_layers_with_the_network_off(tmp_path):
    limits = {f"cell.arms.{arm}.torque_limits": 90.0 for arm in ("left", "right")}
    result = cp.run(planar_scenario().replace(duration=2.0, events=()).override(limits), warn=False)
    save_replay(result, tmp_path / "replay.html")
    time, scales = result.data["time"].values, recorded_scales(result.scenario.cell, result.data)
    start = telling_instant(result).time
    with offline_page(tmp_path / "replay.html", 1200, 720) as page:
        page.wait_for_function("window.coopPin !== undefined")
        assert page.evaluate("[coopPin.time, coopPin.playing]") == [start, False]
        assert_not_blank(drawn(page))
        sample = int(np.searchsorted(time, start))
        names = ("tip_position", "interaction_wrench", "internal_wrench")
        values = [result.data[name].values[sample] for name in names]
        assert_arrows(page, scales, result.scenario.cell.arms, *values)
        tile = page.locator("#tiles div").first.inner_text()
        assert float(tile.split("\n")[1].split()[0].replace("−", "-")) == pytest.approx(
            result.data["internal_axial"].values[sample, 0], rel=0.06
        )

        axis = page.evaluate("coopPin.runs[0].columns[0]")
        for key in 3 * ["ArrowRight"] + 2 * ["ArrowLeft"]:
            page.keyboard.press(key)
            arrow, axial, shear, now = page.evaluate(TOLD)
            assert arrow == pytest.approx(np.hypot(axial, shear), rel=1e-5)
            assert min(abs(now - time) for time in axis) < 1e-4  # a recorded instant

        page.locator("#play").click()
        page.wait_for_function(f"{NOW} > {start} + 0.1 || {NOW} >= 2")
        page.locator("#chips button", has_text="start").click()
        assert page.evaluate(NOW) == 0.0
        over = page.locator("#plots .u-over").nth(1)
        over.click(position={"x": over.bounding_box()["width"] / 2, "y": 10})
        assert page.evaluate(NOW) == pytest.approx(1.0, abs=0.03)
        assert page.locator("#clock").text_content().startswith(f"t = {page.evaluate(NOW):.2f} s")

        page.evaluate("document.querySelector('#plots .u-over').scrollIntoView()")
        box = page.locator("#plots .u-over").first.bounding_box()
        page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 5)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 5, steps=4)
        page.mouse.up()
        ranges = "coopPin.plots.plots.slice(0, 5).map(({ u }) => [u.scales.x.min, u.scales.x.max])"
        page.wait_for_function(f"{ranges}.every(([low, high]) => Math.abs(low - 0.5) < 0.05 && high < 1.6)")
        assert page.evaluate(NOW) == pytest.approx(1.0, abs=0.03)  # a drag does not seek

        sentence = page.locator("button.told")
        assert "past" in sentence.get_attribute("class")
        sentence.click()
        assert page.evaluate(NOW) == pytest.approx(start, abs=1e-5)
        assert "past" not in sentence.get_attribute("class")
        torques = page.locator("#plots output").last
        assert torques.locator("b").count() == 6
        shares = np.abs(100.0 / 90.0 * result.data["torque"].values)
        assert f"(at most {round(shares.max())} %)" in page.locator("#plots h2").last.inner_text()
        assert page.evaluate(
            "coopPin.plots.plots.every(({ u }) => u.scales.y.min <= 0 && u.scales.y.max >= 0)"
        )
        tiles, over = (page.locator(one).first.bounding_box() for one in ("#tiles", "#plots .u-over"))
        assert tiles["x"] + tiles["width"] == pytest.approx(over["x"] + over["width"], abs=1.0)

        lines = page.locator("#legend li:visible").all_inner_texts()
        assert len(lines) == len(set(lines)) == 8  # without a push and warnings
        shown = "coopPin.arrows['forces/left/internal'].object.visible"
        assert page.evaluate(shown)
        page.locator("[data-layer=internal]").click()
        assert not page.evaluate(shown)
        assert not page.evaluate("coopPin.arrows['moments/left/internal'].object.visible")
        page.locator("[data-view=top]").click()
        above = page.evaluate(
            "coopPin.viewer.camera.position.clone().sub(coopPin.viewer.controls.target).toArray()"
        )
        assert above[2] > 10 * abs(above[0]) + 10 * abs(above[1])


AT_GRASPS = """() => coopPin.arms.map((arm, k) => {
        const pane = document.getElementById("pane"), all = [...document.querySelectorAll("#labels span")];
        const label = all.find((one) => one.textContent.split(/[ ,]/)[0] === arm);
        const at = coopPin.tips[k].clone().project(coopPin.viewer.camera);
        const box = label.getBoundingClientRect(), view = pane.getBoundingClientRect();
        return [label.textContent, box.x, box.y, box.width, box.height,
            view.x + (1 + at.x) * view.width / 2, view.y + (1 - at.y) * view.height / 2]; })"""
"""Text and box of the label of each arm, and where its grasp is, pixels."""


@pytest.mark.parametrize(
    ("name", "end"), [("three-driven-ur5", 3.0), pytest.param("four-ur5-plate", 2.5, marks=pytest.mark.slow)]
)
@pytest.mark.gate
def test_labels_of_many_arms_stand_at_their_grasps_and_have_their_forces(name, end, tmp_path):
    result = cp.run(name, {"duration": end}, warn=False)
    save_replay(result, tmp_path / "replay.html")
    with offline_page(tmp_path / "replay.html") as page:
        for time in (0.0, end):
            page.evaluate(f"coopPin.seek({time})")
            next_frame(page)
            labels = page.evaluate(AT_GRASPS)
            assert page.locator("#labels span:visible").count() == len(labels) + 1  # and the worst strut
            for text, x, y, width, height, right, down in labels:
                assert max(x - right, right - x - width, y - down, down - y - height) < 70.0, text
                for _, a, b, w, h, *_ in [each for each in labels if each[0] != text]:
                    assert x + width <= a + 3 or a + w <= x + 3 or y + height <= b + 3 or b + h <= y + 3
        data = result.data.isel(time=-1)
        forces = np.linalg.norm(data["internal_wrench"].values[:, :3], axis=1)
        for (text, *_), force in zip(labels, forces, strict=True):
            assert float(text.split()[1]) == pytest.approx(force, rel=0.06)
        axial, wanted = (data[name].values for name in ("internal_axial", "desired_internal_axial"))
        arm = int(np.abs(axial).argmax())  # a tile has the worst arm, and what is wanted of the same
        tile = page.locator("#tiles div").first.inner_text().replace("−", "-").split("\n")
        assert float(tile[1].split()[0]) == pytest.approx(axial[arm], rel=0.06)
        assert float(tile[2].split()[1]) == pytest.approx(wanted[arm], rel=0.02)


UNDER_THE_SCALE = """() => {
    const boxes = (which) => [...document.querySelectorAll(which)].map((one) => one.getBoundingClientRect());
    const [scale] = boxes("#tension");
    return boxes("#labels span:not([hidden])").filter(({ left, right, top, bottom }) =>
        Math.min(right, scale.right) - Math.max(left, scale.left) > 3
        && Math.min(bottom, scale.bottom) - Math.max(top, scale.top) > 3).length; }"""
"""Labels that the scale of the struts covers."""


@pytest.mark.gate
def test_no_label_stands_under_the_scale_of_the_struts(tmp_path):
    save_replay(cp.run("two-pandas-door", {"duration": 0.2}, warn=False), tmp_path / "replay.html")
    with offline_page(tmp_path / "replay.html", 420, 900) as page:
        page.evaluate("coopPin.seek(0)")
        next_frame(page)
        assert page.locator("#labels span:visible").count() > 2
        assert page.evaluate(UNDER_THE_SCALE) == 0


JUMPS = """(end) => {
    const spans = [...document.querySelectorAll("#labels span")];
    const read = () => spans.map((one) => one.hidden ? null :
        /translate\\(([-\\d.]+)px, ([-\\d.]+)px/.exec(one.style.transform).slice(1).map(Number)
            .concat([one.textContent]));
    let jumps = 0, changes = spans.map(() => 0), before = null;
    coopPin.viewer.renderer.render = () => {};
    for (let k = 0; k <= 30 * end; k += 1) {
        coopPin.goTo(k / 30);
        coopPin.viewer.scene.updateMatrixWorld(true);
        coopPin.viewer.render();
        const now = read();
        now.forEach((one, i) => {
            const other = before?.[i];
            if (!one || !other || k < 2) { return; }
            jumps += Math.hypot(one[0] - other[0], one[1] - other[1]) > 15;
            changes[i] += one[2] !== other[2]; });
        before = now;
    }
    return [jumps, Math.max(...changes) / end]; }"""


@pytest.mark.slow
def test_labels_do_not_jump_and_numbers_change_four_times_a_second_while_a_run_plays(tmp_path):
    scenario = cp.Scenario.load("three-ur5-handover")
    result = cp.run(scenario.replace(duration=4.0, events=scenario.events[:1]), warn=False)
    save_replay(result, tmp_path / "replay.html")
    with offline_page(tmp_path / "replay.html") as page:
        page.wait_for_function("window.coopPin !== undefined")
        jumps, changes = page.evaluate(JUMPS, 4.0)
        assert jumps <= 3
        assert changes <= 4.0
        page.evaluate("coopPin.seek(3.3)")  # what was asked for is told at once
        text = page.locator("#labels span", has_text="second").text_content()
        sample = int(np.searchsorted(result.data["time"].values, page.evaluate(NOW) - 1e-6))
        force = np.linalg.norm(result.data["internal_wrench"].values[sample, 1, :3])
        assert float(text.split()[1]) == pytest.approx(force, rel=0.06)


@pytest.mark.gate
def test_other_numbers_are_told_where_the_pointer_is_and_stay_after_a_click(tmp_path):
    save_replay(cp.run("four-ur5-plate", {"duration": 2.5}, warn=False), tmp_path / "replay.html")
    with offline_page(tmp_path / "replay.html", 1400, 900) as page:
        page.evaluate("coopPin.seek(2.5)")
        next_frame(page)
        assert [
            text for *_, text in page.evaluate(STRUTS) if "\n" in text
        ] == []  # of struts that have what is wanted
        shown = page.locator("#labels span:visible")
        usual, box = shown.count(), page.locator("#pane").bounding_box()
        head = "coopPin.arrows['forces/arm1/load'].tip.clone().project(coopPin.viewer.camera)"
        x, y = page.evaluate(f"(({{ x, y }}) => [x, y])({head})")
        at = box["x"] + (1 + x) * box["width"] / 2, box["y"] + (1 - y) * box["height"] / 2 + 4
        page.mouse.move(*at)
        next_frame(page)
        assert shown.count() == usual + 1
        page.mouse.click(*at)
        page.mouse.move(box["x"] + 30, box["y"] + 200)
        next_frame(page)
        assert shown.count() == usual + 1
        page.mouse.click(*at)
        page.mouse.move(box["x"] + 30, box["y"] + 200)
        next_frame(page)
        assert shown.count() == usual


CONTRASTS = """() => {
    const rgba = (text) => [...text.match(/[\\d.]+/g).map(Number), 1].slice(0, 4);
    const over = ([r, g, b, a], [x, y, z]) => [a * r + (1 - a) * x, a * g + (1 - a) * y, a * b + (1 - a) * z];
    const linear = (v) => v <= 10.3 ? v / 3294.6 : ((v / 255 + 0.055) / 1.055) ** 2.4;
    const light = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
    const ground = (one) => one
        ? over(rgba(getComputedStyle(one).backgroundColor), ground(one.parentElement)) : [255, 255, 255];
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
    while (texts.nextNode()) {
        const { parentElement: one, textContent: text } = texts.currentNode;
        if (!text.trim() || !one.checkVisibility({ visibilityProperty: true }) || one.closest("option")) {
            continue; }
        const behind = ground(one), ink = over(rgba(getComputedStyle(one).color), behind);
        const [high, low] = [light(behind), light(ink)].sort((a, b) => b - a);
        found.push([text.trim(), (high + 0.05) / (low + 0.05)]);
    }
    return found; }"""
"""Every visible text of the page, and its contrast against what is behind it, by WCAG 2.1."""


@pytest.mark.gate
def test_the_replay_obeys_the_keyboard_and_speaks_to_screen_readers(tmp_path):
    limits = {f"cell.arms.{arm}.torque_limits": 90.0 for arm in ("left", "right")}
    result = cp.run(planar_scenario().replace(duration=1.0, events=()).override(limits), warn=False)
    save_replay(result, tmp_path / "replay.html")
    with offline_page(tmp_path / "replay.html") as page:
        page.wait_for_function("window.coopPin !== undefined")
        low = [(text, ratio) for text, ratio in page.evaluate(CONTRASTS) if ratio < 4.5]
        assert low == []
        for key, time in (("Home", 0.0), ("End", 1.0), ("1", page.evaluate("coopPin.instants[0].time"))):
            page.keyboard.press(key)
            assert page.evaluate(NOW) == pytest.approx(time)
        layer = page.locator("[data-layer=internal]")
        layer.focus()
        page.keyboard.press("Space")  # presses the button, and does not play
        assert (layer.get_attribute("aria-pressed"), page.evaluate("coopPin.playing")) == ("false", False)
        page.locator("#speed").focus()
        before = page.evaluate(NOW)
        page.keyboard.press("ArrowRight")
        assert page.evaluate(NOW) == before
        page.locator("#time").focus()
        page.keyboard.press("End")
        assert page.evaluate(NOW) == 1.0
        spoken = page.locator("#time").get_attribute("aria-valuetext")
        assert re.fullmatch(r"1\.00 s, [\d.]+ N (squeeze|pull apart)", spoken)
        assert page.evaluate("location.hash") == "#t=1"
        page.evaluate("location.hash = '#t=0.5'")
        page.wait_for_function(f"Math.abs({NOW} - 0.5) < 0.02")
        page.locator("#speed").select_option("0.1")  # half a second may pass before the next look
        page.locator("#play").click()
        assert page.get_by_role("button", name="pause").count() == 1
        drawings = page.locator("canvas[role=img]").evaluate_all("all => all.map(one => one.ariaLabel)")
        assert len(drawings) == 1 + page.evaluate("coopPin.plots.plots.length")
        assert all(drawings)
        assert page.locator("#event").get_attribute("aria-live") == "polite"
        assert {*page.locator("#labels span").all_text_contents()} > {*result.scenario.cell.arms}
    with browser_page(offline=True) as page:
        page.goto((tmp_path / "replay.html").resolve().as_uri() + "#t=0.25")
        page.wait_for_function(f"window.coopPin !== undefined && Math.abs({NOW} - 0.25) < 0.02")


@pytest.mark.gate
def test_without_webgl_plots_and_tiles_work_and_the_page_says_so(tmp_path):
    result = cp.run(spatial_scenario().replace(duration=0.3), warn=False)
    save_replay(result, tmp_path / "replay.html")
    with browser_page(offline=True) as page:
        page.add_init_script("""const real = HTMLCanvasElement.prototype.getContext;
            HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
                return kind.includes("webgl") ? null : real.call(this, kind, ...rest); };""")
        page.goto((tmp_path / "replay.html").resolve().as_uri())
        page.wait_for_function("window.coopPin !== undefined")
        assert "no WebGL" in page.locator("#pane").inner_text()
        page.keyboard.press("End")
        assert page.evaluate(NOW) == pytest.approx(0.3)
        assert "N" in page.locator("#tiles b").first.inner_text()
        assert page.locator("#plots .uplot").count() == page.evaluate("coopPin.plots.plots.length") - 1
        for name in ("top", "follow"):
            page.locator(f"[data-view={name}]").click()
        page.locator("#play").click()


INSIDE = """() => {
    coopPin.viewer.render();
    const { camera } = coopPin.viewer;
    const shown = Object.values(coopPin.arrows).filter(({ object }) => object.visible);
    return shown.map(({ name, tip, object }) => {
        const ends = [tip, object.position].map(end => end.clone().project(camera));
        return [name, Math.max(...ends.flatMap(({ x, y }) => [Math.abs(x), Math.abs(y)]))];
    }); }"""


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_names())
def test_the_pages_of_the_catalogue_are_light_and_have_all_arrows_in_view_at_the_worst_moments(
    name, tmp_path
):
    result = cp.run(name, warn=False)
    save_replay(result, tmp_path / "replay.html")
    save_report(result, tmp_path / "report.html")
    assert all((tmp_path / page).stat().st_size < 3e6 for page in ("replay.html", "report.html"))
    with offline_page(tmp_path / "replay.html") as page:
        page.wait_for_function("window.coopPin !== undefined")
        clocks, shown = set(), set()
        for time in [page.evaluate(NOW), *page.evaluate("coopPin.instants.map(({ time }) => time)")]:
            page.evaluate(f"coopPin.seek({time})")
            ends = dict(page.evaluate(INSIDE))
            shown |= set(ends)  # none before there is a force, and after all arms have let go
            assert max(ends.values(), default=0.0) < 1.0, ends
            clocks.add(len(page.locator("#clock").text_content()))
        assert shown
        assert len(clocks) == 1  # so that the scrubber keeps its length


AXIAL = "pane => pane.plots.value(pane.runs[0], 1)"


@pytest.mark.gate
def test_runs_side_by_side_follow_one_clock_and_one_camera_and_fit_a_phone(tmp_path):
    """What the panes tell is of the runs: with the same motion, the forces differ."""
    scenario = spatial_scenario().replace(duration=0.5)
    runs = [cp.run(scenario, warn=False), cp.run(scenario.override({"cell.payload.mass": 5.0}), warn=False)]
    save_replay(runs[0], tmp_path / "both.html", runs[1], names=["light", "heavy"])
    with offline_page(tmp_path / "both.html", 420, 900) as page:
        page.wait_for_function("window.coopPin !== undefined")
        page.locator("#time").focus()
        page.keyboard.press("Home")
        assert page.evaluate("[coopPin.time, ...coopPin.panes.map(pane => pane.time)]") == [0, 0, 0]
        page.evaluate("coopPin.goTo(0.4)")
        shown = page.evaluate(f"coopPin.panes.map({AXIAL})")
        positions = page.evaluate("coopPin.panes.map(pane => pane.node('payload').position.toArray())")
        for run, axial, position in zip(runs, shown, positions, strict=True):
            sample = int(np.searchsorted(run.data["time"].values, 0.4 - 1e-9))
            assert_allclose(position, run.data["payload_position"].values[sample], atol=1e-4)
            assert axial == pytest.approx(run.data["internal_axial"].values[sample, 0], rel=1e-5)
        assert page.locator("figcaption").all_inner_texts() == ["light", "heavy"]
        page.frame_locator("iframe").nth(1).locator("button.told").click()
        told = telling_instant(runs[1]).time
        page.wait_for_function(f"Math.abs(coopPin.time - {told}) < 1e-4")
        assert page.evaluate("coopPin.panes[0].time") == pytest.approx(told, abs=1e-4)
        page.evaluate("coopPin.panes[0].view('top')")
        seen = "coopPin.panes.map(({ viewer }) => viewer.camera.position.toArray())"
        page.wait_for_function(
            f"(([one, two]) => Math.hypot(...one.map((x, k) => x - two[k])) < 1e-3)({seen})"
        )
        assert page.evaluate("document.documentElement.scrollWidth") <= 420
        page.set_viewport_size({"width": 900, "height": 600})
        assert page.evaluate("document.documentElement.scrollHeight") <= 600
        tops = [one.locator("#view").bounding_box()["y"] for one in page.frames[1:]]
        assert np.ptp(tops) < 1.0  # however long their sentences are
        assert_not_blank_anywhere(drawn(page))


def assert_not_blank_anywhere(image: bytes) -> None:
    pixels = np.round(255 * matplotlib.image.imread(io.BytesIO(image))[..., :3]).astype(int).reshape(-1, 3)
    assert len(np.unique(pixels, axis=0)) > 500


@pytest.mark.gate
def test_the_report_plays_fits_narrow_windows_and_prints_with_the_network_off(tmp_path):
    result = cp.run(planar_scenario().replace(duration=2.0, events=()), warn=False)
    save_report(result, tmp_path / "report.html")
    with offline_page(tmp_path / "report.html") as page:
        assert (
            shown_widths(page, "main img") == [pytest.approx(832, abs=1)] * 5
        )  # the drawing of the motion is for paper
        applying = [name for name, value in result.metrics().items() if not np.isnan(value)]
        rows = len([name for name in applying if name not in ("simulation_sound", "task_kept")])
        assert page.locator("#metrics tbody tr").count() == rows
        assert page.locator("#scenario tbody tr").count() > 5
        assert_plays(page.locator("#motion iframe"))
        assert_fits(page)
        page.set_viewport_size({"width": 420, "height": 900})
        assert_fits(page)
        assert len(shown_widths(page, "main img")) == 8  # three figures of two columns, one below the other
        page.emulate_media(media="print")
        page.set_viewport_size({"width": 720, "height": 1000})
        assert len(shown_widths(page, "main img")) == 6
        assert not page.locator("#motion iframe").is_visible()
        assert not page.locator("nav").is_visible()
        assert len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4"))) <= 4
        assert page.locator("#picture").evaluate("one => one.width") > 300  # with the forces, on sheet 1
        assert not page.locator("figure.paper").is_visible()


@pytest.mark.slow
def test_a_report_with_events_has_at_most_four_sheets_of_a4(tmp_path):
    save_report(cp.run("adept-anchored", warn=False), tmp_path / "report.html")  # every metric applies to it
    with offline_page(tmp_path / "report.html") as page:
        page.locator("#motion iframe").scroll_into_view_if_needed()
        page.frame_locator("#motion iframe").locator("#pane canvas").wait_for()
        assert len(re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4"))) <= 4


def shown_widths(page, images: str) -> list[float]:
    """Widths at which images are shown, pixels; each of them must have been loaded."""
    sizes = "[image.naturalWidth, image.naturalHeight, image.offsetWidth]"
    read = f"all => all.filter(image => image.offsetWidth).map(image => {sizes})"
    found = page.eval_on_selector_all(images, read)
    assert all(min(sizes) > 0 for sizes in found)
    return [width for _, _, width in found]


def assert_plays(element) -> None:
    """The replay in an iframe draws the arms and plays."""
    element.scroll_into_view_if_needed()
    frame = element.element_handle().content_frame()
    frame.wait_for_function("window.coopPin !== undefined")
    start = frame.evaluate("() => { coopPin.seek(0); coopPin.play(); return coopPin.time; }")
    frame.wait_for_function(f"coopPin.time > {start} + 0.1")
    assert frame.evaluate(MESHES) > 10


def assert_fits(page) -> None:
    """The page is not wider than its window."""
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0


# ---------------------------------------------------------------- the documentation


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built from copies, with its notebooks executed."""
    pytest.importorskip("sphinx", reason="sphinx is not installed: pip install 'coop-pin[docs]'")
    copy = tmp_path_factory.mktemp("site")
    for folder in ("docs", "notebooks"):
        shutil.copytree(REPOSITORY / folder, copy / folder)
    (copy / "studies").symlink_to(REPOSITORY / "studies")
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-b", "html", "-q", str(copy / "docs"), str(copy / "html")],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return copy / "html"


@pytest.mark.slow
@pytest.mark.parametrize("width", [420, 1400])
def test_the_pages_of_the_site_show_their_equations_and_images_with_the_network_off(site, width):
    pages = [
        site / "index.html",
        site / "quickstart.html",
        site / "verification.html",
        site / "api" / "index.html",
    ]
    pages += [
        page
        for name in ("concepts", "howto", "studies", "reference")
        for page in sorted((site / name).glob("*.html"))
    ]
    equations = 0
    for path in pages:
        with offline_page(path, width) as page:
            page.wait_for_function(
                "[...document.querySelectorAll('.math')].every(one => one.querySelector('mjx-container'))"
            )
            equations += page.locator("mjx-container").count()
            assert page.locator("mjx-merror").count() == 0
            shown_widths(page, "article img")
            assert page.locator("article h1").inner_text()
            assert_fits(page)
    assert equations > 100


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_of_the_site_shows_what_it_computed_with_the_network_off(site, name):
    with offline_page(site / "notebooks" / f"{name}.html") as page:
        assert page.locator(".cell_output .traceback, .cell_output .stderr").count() == 0
        assert len(shown_widths(page, ".cell_output img")) > 0
        assert_plays(page.locator(".cell_output iframe[title='coop_pin replay']").last)
        assert_fits(page)


# ---------------------------------------------------------------- JupyterLab


@contextmanager
def jupyter(folder, module):
    """Address and token of a new JupyterLab or Notebook 7 that serves the notebooks, without outputs."""
    pytest.importorskip(module, reason=f"{module} is not installed: pip install 'coop_pin[test]'")
    import nbformat

    for name in NOTEBOOKS:
        notebook = nbformat.read(NOTEBOOK.with_name(f"{name}.ipynb"), as_version=4)
        for cell in notebook.cells:
            if cell.cell_type == "code":
                cell.outputs, cell.execution_count = [], None
        nbformat.write(notebook, folder / f"{name}.ipynb")
    own = {
        name: str(folder / name.lower())
        for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR")
    }
    options = (
        "--no-browser",
        "--allow-root",
        "--ip=127.0.0.1",
        "--port=0",
        f"--ServerApp.root_dir={folder}",
        "--expose-app-in-browser",
    )
    server = subprocess.Popen(
        [sys.executable, "-m", module, *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **own},
        start_new_session=True,
    )
    try:
        address = None
        while address is None:
            line = server.stderr.readline()
            assert line, f"{module} did not start"
            address = re.search(r"(http://127\.0\.0\.1:\d+)/(?:lab|tree)\?(token=\w+)", line)
        drain = threading.Thread(target=server.stderr.read, daemon=True)
        drain.start()
        yield address.groups()
    finally:
        os.killpg(server.pid, signal.SIGTERM)
        server.wait(PATIENCE_MS / 1e3)
        drain.join(PATIENCE_MS / 1e3)
        server.stderr.close()


@pytest.fixture
def lab(tmp_path):
    """Address of a new JupyterLab; its path goes before the mark."""
    with jupyter(tmp_path, "jupyterlab") as (server, token):
        yield f"{server}/lab?{token}"


def wait_for_the_notebook(page) -> None:
    """Wait for a kernel, and for the last cell of a notebook.

    JupyterLab renders its cells one by one, code before text, and shows "idle" before there is a kernel; a
    command to run "the first four cells" that comes too early runs others, or none.
    """
    page.get_by_text(re.compile(r"\(ipykernel\) \| Idle")).wait_for()
    page.locator(
        ".jp-MarkdownCell.jp-mod-rendered", has=page.locator("h2", has_text=re.compile("^Try"))
    ).wait_for(state="attached")


def run_cells(page, *words: str) -> None:
    """Run the code cells that contain these words, one after the other, each to its end."""
    wait_for_the_notebook(page)
    page.evaluate(
        "jupyterapp.commands.execute('notebook:clear-all-cell-outputs')"
    )  # and the numbers of cells that ran before
    for word in words:
        cell = page.locator(".jp-CodeCell", has_text=word)
        cell.locator(".jp-InputArea-prompt").click()
        page.keyboard.press("Shift+Enter")
        cell.locator(".jp-InputArea-prompt", has_text=re.compile(r"\[\d+\]")).wait_for()
        assert cell.locator(WRONG).all_inner_texts() == []


def run_until_it_runs(page, word: str) -> None:
    """Run the cell that contains a word: again, if the notebook has no kernel yet and forgets the command."""
    prompt = page.locator(".jp-CodeCell", has_text=word).locator(".jp-InputArea-prompt")
    end = time.monotonic() + PATIENCE_MS / 1e3
    while prompt.inner_text().strip("[]: ") == "" and time.monotonic() < end:
        prompt.click()
        page.keyboard.press("Shift+Enter")
        page.wait_for_timeout(5000)
    prompt.filter(has_text=re.compile(r"\[\d+\]")).wait_for()


def live_frame(page):
    """Iframe of the live view inside the notebook."""
    element = page.wait_for_selector('iframe[title="coop_pin live"]')
    frame = element.content_frame()
    frame.wait_for_function("window.coopPin !== undefined")
    return frame


@pytest.mark.slow
def test_the_sliders_of_the_live_notebook_change_the_run(lab):
    with browser_page(width=1500, height=1300) as page:
        page.goto(lab.replace("/lab?", f"/lab/tree/{NOTEBOOK.name}?"))
        run_cells(page, *AS_FAR_AS_THE_PANEL)
        frame = live_frame(page)
        page.locator(".jupyter-button", has_text="Start").click()
        paused = frame.evaluate(NOW)
        frame.wait_for_function(f"{NOW} > {paused} + 0.5")
        before = frame.evaluate(STATE)
        handle = page.locator(".widget-slider", has_text="squeeze, N").locator(".noUi-handle")
        handle.focus()
        for _ in range(30):
            handle.press("ArrowRight")
        frame.wait_for_function(f"{DESIRED}.at(-1) < -12")
        asked = frame.evaluate(NOW)
        frame.wait_for_function(f"{NOW} > {asked} + 1")
        after = frame.evaluate(STATE)
        desired = frame.evaluate(f"Array.from({DESIRED})")
        assert np.abs(np.subtract(before[0], after[0])).max() > 1e-4  # the arm moves on
        assert after[1] < before[1] - 1.5  # and squeezes harder
        assert {round(value, 4) for value in desired} >= {-10.0, round(desired[-1], 4)}
        page.locator(".jupyter-button", has_text="Pause").click()
        if folder := os.environ.get("COOP_PIN_PICTURES"):  # to keep a screenshot
            page.screenshot(path=Path(folder) / "lab.png")


@pytest.mark.slow
def test_a_new_kernel_of_the_live_notebook_has_a_new_view(lab):
    with browser_page(width=1500, height=1300) as page:
        page.goto(lab.replace("/lab?", f"/lab/tree/{NOTEBOOK.name}?"))
        run_cells(page, *AS_FAR_AS_THE_PANEL)
        frame = live_frame(page)
        page.get_by_role("button", name="Restart the kernel", exact=True).click()
        page.locator(".jp-Dialog .jp-mod-accept").click()
        frame.wait_for_function("document.getElementById('status').textContent.startsWith('no connection')")
        run_cells(page, *AS_FAR_AS_THE_PANEL)
        frame = live_frame(page)
        frame.wait_for_function("document.getElementById('status').textContent.startsWith('live')")
        page.locator(".jupyter-button", has_text="Start").click()
        frame.wait_for_function(f"{NOW} > 0.5")


@pytest.mark.slow
@pytest.mark.parametrize("module", ["jupyterlab", "notebook"])
def test_a_payload_that_is_dragged_in_the_panel_is_pushed(module, tmp_path):
    with jupyter(tmp_path, module) as (server, token), browser_page(width=1500, height=1100) as page:
        folder = {"jupyterlab": "lab/tree", "notebook": "notebooks"}[module]
        page.goto(f"{server}/{folder}/{NOTEBOOK.name}?{token}")
        for word in AS_FAR_AS_THE_PANEL:
            run_until_it_runs(page, word)
        frame, element = live_frame(page), page.locator('iframe[title="coop_pin live"]')
        page.locator(".jupyter-button", has_text="Start").click()
        frame.wait_for_function(f"{NOW} > 1")
        page.locator(".jupyter-button", has_text="Pause").click()
        element.scroll_into_view_if_needed()
        box = element.bounding_box()
        x, y = np.add((box["x"], box["y"]), frame.evaluate(PAYLOAD_PX))
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 40, y - 20, steps=4)
        frame.wait_for_function("document.querySelector('#labels .push').textContent.startsWith('push ')")
        said = frame.evaluate("document.querySelector('#labels .push').textContent")
        page.mouse.up()
        frame.wait_for_function("coopPin.marks().length === 1")
        (mark,) = frame.evaluate("coopPin.marks()")
        assert_allclose(float(mark["text"].split()[1]), float(said.split()[1]), rtol=0.05)
        assert_allclose(mark["end"] - mark["start"], 0.2, rtol=1e-6)
        page.locator(".jupyter-button", has_text="Start").click()
        frame.wait_for_function(f"{NOW} > {mark['end']}")
        pushed = frame.evaluate(
            "Math.max(...coopPin.runs[0].columns[1]) - Math.min(...coopPin.runs[0].columns[1])"
        )
        assert pushed > 5.0  # N, of the internal force
        page.locator(".jupyter-button", has_text="Reset").click()
        frame.wait_for_function("coopPin.marks().length === 0")
        if kept := os.environ.get("COOP_PIN_PICTURES"):
            page.screenshot(path=Path(kept) / f"{module}-push.png")


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_is_shown_in_jupyterlab(lab, name):
    with browser_page(width=1400, height=5500) as page:  # JupyterLab draws only what is in sight
        page.goto(lab.replace("/lab?", f"/lab/tree/{name}.ipynb?"))
        wait_for_the_notebook(page)
        page.evaluate("void jupyterapp.commands.execute('notebook:run-all-cells')")
        prompts = "[...document.querySelectorAll('.jp-CodeCell .jp-InputArea-prompt')]"
        done = prompts + ".every(one => /\\[\\d+\\]/.test(one.textContent))"
        page.wait_for_function(done, timeout=4 * PATIENCE_MS)
        assert page.locator(WRONG).all_inner_texts() == []
        assert len(shown_widths(page, ".jp-OutputArea-output img")) > 0
        assert_plays(page.locator("iframe[title='coop_pin replay']"))
        if folder := os.environ.get("COOP_PIN_PICTURES"):
            page.screenshot(path=Path(folder) / f"{name}.png")
