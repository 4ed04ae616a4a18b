"""What a real browser shows: the live page, the replay with the network off, and the live notebook in JupyterLab."""

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from browser import browser_page
from cells import SCENARIOS, planar_scenario
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.viz import open_view, save_replay
from coop_pin.viz.arrow_scales import recorded_scales
from coop_pin.viz.arrows import HEAD_LENGTH_M
from coop_pin.viz.live_scene import LiveScene
from coop_pin.viz.standing import standing_scenario

NOTEBOOK = Path(__file__).parent.parent / "notebooks" / "05_live_gains.ipynb"

MESHES = """() => { let meshes = 0; coopPin.viewer.scene_tree.find(["meshcat"]).object.traverse(part => { meshes += part.isMesh ? 1 : 0; });
    return meshes; }"""
SHOWN = "coopPin.shown.time"
AS_FAR_AS_THE_PANEL = ("import coop_pin as cp", "panel = Panel(scenario)")


def arrow(page, path: str, scale: float) -> np.ndarray:
    """The force or moment that an arrow of the browser's scene stands for."""
    read = "path => { const {quaternion: q, position: p, scale: s} = NODE(path); return [q.x, q.y, q.z, q.w, p.z, s.z]; }"
    read = read.replace("NODE(path)", "coopPin.viewer.scene_tree.find(['meshcat', ...path.split('/')]).object")
    along = Rotation.from_quat(page.evaluate(read, path)[:4]).apply((0.0, 0.0, 1.0))
    *_, position, stretch = page.evaluate(read, f"{path}/head")
    return scale * (position + HEAD_LENGTH_M * stretch) * along


def assert_not_blank(picture: bytes) -> None:
    """The middle of the picture has many colours: a blank page has one, a background alone a few dozen."""
    pixels = np.round(255 * matplotlib.image.imread(io.BytesIO(picture))[150:600, 330:870, :3]).astype(int).reshape(-1, 3)
    assert len(np.unique(pixels, axis=0)) > 500
    assert pixels.std(axis=0).max() > 20


def drawn(page) -> bytes:
    """A picture of the page after it has drawn what it was told."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return page.screenshot()


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_live_page_draws_the_cell_and_follows_the_run(name):
    scenario = SCENARIOS[name]().replace(duration=1.0, events=())
    scene = LiveScene(*standing_scenario(scenario))
    meshes = sum(1 for item in scene.scene.items if type(item.drawable).__name__ != "Segments")
    view = open_view(scenario)
    with browser_page() as page:
        page.goto(view.url)
        page.wait_for_function("window.coopPin !== undefined")
        assert page.evaluate(MESHES) == meshes + 1  # and the trail
        assert_not_blank(drawn(page))
        seen = []

        def watch(moment) -> None:
            seen.append(moment)
            view.show(moment)

        run = threading.Thread(target=cp.run, args=(scenario,), kwargs={"view": watch, "pace": 0.5})
        run.start()
        page.wait_for_function("coopPin.shown.time > 0.99")
        run.join()
        page.wait_for_function(f"{SHOWN} === {seen[-1].time!r}")
        for index, arm in enumerate(scenario.cell.arms):
            internal = np.nan_to_num(seen[-1].internal_wrench)[index]
            load = np.nan_to_num(seen[-1].interaction_wrench)[index] - internal
            for group, per_metre, rows in zip(("forces", "moments"), scene.scales, (slice(0, 3), slice(3, 6)), strict=True):
                assert_allclose(arrow(page, f"{group}/{arm}/internal", per_metre), internal[rows], atol=2e-3)
                assert_allclose(arrow(page, f"{group}/{arm}/load", per_metre), load[rows], atol=2e-3)
        place = page.evaluate("coopPin.node('payload').position.toArray()")
        assert_allclose(place, seen[-1].payload_pose[:3, 3], atol=1e-6)
        assert page.evaluate("coopPin.count") > 10
        assert page.evaluate("coopPin.samples.length") > 10  # the charts have something to draw
        assert_not_blank(drawn(page))
        view.close()
        page.wait_for_function("document.getElementById('status').textContent.startsWith('no connection')")


def test_saturated_links_change_their_colour_and_get_it_back():
    scenario = planar_scenario().replace(duration=0.5, events=())
    view = open_view(scenario)
    moment = standing_scenario(scenario).moment
    colour = """() => { let found = []; coopPin.node("arms/left/joint_1").traverse(part => {
        if (part.material) { found.push(part.material.color.getHexString()); } }); return found; }"""
    saturated, singular = moment.saturated.copy(), moment.jacobian_condition.copy()
    saturated[0, 0], singular[0] = True, 1e4
    with browser_page() as page:
        page.goto(view.url)
        page.wait_for_function("window.coopPin !== undefined")
        own = page.evaluate(colour)
        for number, (shown, wanted) in enumerate(
            (
                (moment._replace(saturated=saturated), ["f0e442"] * len(own)),
                (moment._replace(jacobian_condition=singular), ["56b4e9"] * len(own)),
                (moment, own),
            ),
            start=1,
        ):
            view.show(shown._replace(time=0.1 * number))
            page.wait_for_function(f"Math.abs({SHOWN} - {0.1 * number}) < 1e-9")
            assert page.evaluate(colour) == wanted
    view.close()


def test_the_replay_plays_with_the_network_off(tmp_path):
    result = cp.run(planar_scenario().replace(duration=2.0, events=()))
    save_replay(result, tmp_path / "replay.html")
    with browser_page(offline=True) as page:
        asked = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto((tmp_path / "replay.html").as_uri())
        page.wait_for_function("window.coopPin !== undefined")
        page.wait_for_function("Number(document.getElementById('time').value) > 0.5")  # it plays by itself
        page.evaluate("coopPin.seek(1.0)")
        sample = int(np.argmin(np.abs(result.data["time"].values - 1.0)))
        internal = np.nan_to_num(result.data["internal_wrench"].values)[sample, 0]
        scales = recorded_scales(result.scenario.cell, result.data)
        assert_allclose(arrow(page, "forces/left/internal", scales.newtons_per_metre), internal[:3], atol=1.0)
        assert_allclose(arrow(page, "moments/left/internal", scales.newton_metres_per_metre), internal[3:], atol=0.1)
        assert page.locator("#clock").text_content().startswith("t = 1.00 s")
        assert_not_blank(drawn(page))
        assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


# ---------------------------------------------------------------- JupyterLab


@pytest.fixture
def lab(tmp_path):
    """The address of a JupyterLab of its own, which has the live notebook."""
    pytest.importorskip("jupyterlab", reason="jupyterlab is not installed: pip install 'coop-pin[test]'")
    shutil.copy(NOTEBOOK, tmp_path)
    own = {name: str(tmp_path / name.lower()) for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR")}
    options = ("--no-browser", "--allow-root", "--ip=127.0.0.1", "--port=0", f"--ServerApp.root_dir={tmp_path}", "--expose-app-in-browser")
    server = subprocess.Popen(
        [sys.executable, "-m", "jupyterlab", *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **own},
        start_new_session=True,
    )
    address = None
    while address is None:
        line = server.stderr.readline()
        assert line, "JupyterLab did not start"
        address = re.search(r"http://127\.0\.0\.1:\d+/lab\?token=\w+", line)
    drain = threading.Thread(target=server.stderr.read, daemon=True)
    drain.start()
    yield address[0]
    os.killpg(server.pid, signal.SIGTERM)
    server.wait(20)
    drain.join(20)
    server.stderr.close()


def run_cells(page, *beginnings: str) -> None:
    """Run the code cells that begin so, one after the other, and see each through to its end.

    JupyterLab draws its cells bit by bit, code before words, and its indicator says "idle" before there is a kernel: so wait for the last
    cell and for a kernel, and choose each cell by what stands in it, not by its place.
    """
    page.get_by_text(re.compile(r"\(ipykernel\) \| Idle")).wait_for()
    page.locator(".jp-MarkdownCell.jp-mod-rendered", has_text="Try").last.wait_for(state="attached")
    page.evaluate("jupyterapp.commands.execute('notebook:clear-all-cell-outputs')")  # and the numbers of cells that ran before
    for beginning in beginnings:
        cell = page.locator(".jp-CodeCell", has_text=beginning)
        cell.locator(".jp-InputArea-prompt").click()
        page.keyboard.press("Shift+Enter")
        cell.locator(".jp-InputArea-prompt", has_text=re.compile(r"\[\d+\]")).wait_for()
        wrong = cell.locator('[data-mime-type="application/vnd.jupyter.stderr"], [data-mime-type="application/vnd.jupyter.error"]')
        assert wrong.all_inner_texts() == []


def live_frame(page):
    """The frame of the live view inside the notebook."""
    element = page.wait_for_selector('iframe[title="coop_pin live"]')
    frame = element.content_frame()
    frame.wait_for_function("window.coopPin !== undefined")
    return frame


def test_the_live_notebook_answers_to_its_sliders(lab):
    with browser_page(width=1500, height=1300) as page:
        page.goto(lab.replace("/lab?", f"/lab/tree/{NOTEBOOK.name}?"))
        run_cells(page, *AS_FAR_AS_THE_PANEL)
        frame = live_frame(page)
        page.locator(".jupyter-button", has_text="Start").click()
        paused = frame.evaluate(SHOWN)
        frame.wait_for_function(f"{SHOWN} > {paused} + 1.5")
        before = frame.evaluate("[coopPin.node('arms/left/joint_1').quaternion.toArray(), coopPin.shown.internal]")
        handle = page.locator(".widget-slider", has_text="squeeze, N").locator(".noUi-handle")
        handle.focus()
        for _ in range(30):
            handle.press("ArrowRight")
        frame.wait_for_function("coopPin.shown.desired_internal > 12")
        asked = frame.evaluate(SHOWN)
        frame.wait_for_function(f"{SHOWN} > {asked} + 2")
        after = frame.evaluate("[coopPin.node('arms/left/joint_1').quaternion.toArray(), coopPin.shown.internal]")
        samples = json.loads(frame.evaluate("JSON.stringify(coopPin.samples)"))
        assert np.abs(np.subtract(before[0], after[0])).max() > 1e-4  # the arm moves on
        assert after[1] > before[1] + 1.5  # and squeezes harder
        assert {round(sample["desired_internal"], 6) for sample in samples} >= {10.0, round(samples[-1]["desired_internal"], 6)}
        page.locator(".jupyter-button", has_text="Pause").click()
        if folder := os.environ.get("COOP_PIN_PICTURES"):  # for people who want to look
            page.screenshot(path=Path(folder) / "lab.png")

        old = frame.url
        page.get_by_role("button", name="Restart the kernel", exact=True).click()
        page.locator(".jp-Dialog .jp-mod-accept").click()
        frame.wait_for_function("document.getElementById('status').textContent.startsWith('no connection')")
        run_cells(page, *AS_FAR_AS_THE_PANEL)
        page.wait_for_function(f"""() => {{ const frame = document.querySelector('iframe[title="coop_pin live"]');
            return frame && frame.src !== {old!r}; }}""")
        frame = live_frame(page)
        page.locator(".jupyter-button", has_text="Start").click()
        frame.wait_for_function("coopPin.shown.time > 0.5")  # a new kernel, a new view
