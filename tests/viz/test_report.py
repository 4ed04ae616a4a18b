"""The report: one self-contained page with the numbers of the result."""

import base64
import functools
import gzip
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import DivergedError
from coop_pin.cli import main
from coop_pin.figures import internal_force_figure, motion_figure, singularity_figure
from coop_pin.results.run_result import RunResult
from coop_pin.viz import metrics_table, report_html, save_report

SHORT = {"duration": 0.5, "events": ()}
SECTIONS = [
    "motion",
    "metrics",
    "scenario",
    "tracking",
    "internal",
    "torque",
    "exactness",
    "singular",
    "limits",
]


class Page(HTMLParser):
    """What stands in a page: ids, links, addresses that a browser would load, the frame's page, text."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.loaded, self.frames, self.images, self.text = [], [], [], [], [], []
        self.open, self.void = [], {"meta", "img", "input", "br", "link"}
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag not in self.void:
            self.open.append(tag)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given["href"]] if tag == "a" else []
        if "data-page" in given:
            self.frames.append(gzip.decompress(base64.b64decode(given["data-page"])).decode())
        self.images += [given["src"]] if tag == "img" else []
        self.loaded += [given[name] for name in ("src", "data", "poster") if name in given]
        self.loaded += [given["href"]] if tag == "link" else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@functools.cache
def result(name):
    return cp.run(SCENARIOS[name]().replace(**SHORT), warn=False)


@functools.cache
def html(name):
    return report_html(result(name))


@functools.cache
def page(name):
    return Page(html(name))


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_page_is_well_formed_and_has_every_section_and_its_links_lead_to_them(name):
    assert page(name).open == []
    assert [name for name in page(name).ids if name != "picture"] == SECTIONS
    assert sorted(page(name).links) == sorted(f"#{section}" for section in SECTIONS)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_page_asks_for_nothing(name):
    assert all(address.startswith("data:") for address in page(name).loaded)
    (replay,) = page(name).frames
    assert replay.startswith("<!DOCTYPE html>")
    assert "coopPin" in replay
    assert not re.search(r"<(?:script|img|link|iframe)[^>]*(?:src|href)=.https?:", replay)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_figures_are_images_of_vectors_without_addresses(name):
    assert len(page(name).images) == 6
    for address in page(name).images:
        kind, _, content = address.partition(",")
        assert kind == "data:image/svg+xml;base64"
        svg = base64.b64decode(content).decode()
        assert "</svg>" in svg
        assert not re.search(r"(?:href|src)=\"(?!#)", svg)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_metric_has_a_row_in_the_table(name):
    text = "".join(page(name).text).replace("\xa0", " ")  # a unit stays in the line of its number
    rows = metrics_table(result(name))
    applying = {metric for metric, value in result(name).metrics().items() if not np.isnan(value)}
    assert {row.name for row in rows} == applying - {"simulation_sound", "task_kept"}
    assert all(part in text for row in rows for part in row)
    peak = result(name).metrics()["torque_peak_Nm"]
    assert f"{peak:.3g} N m" in text
    assert "nan" not in re.sub("Every field.*?(?=Motion)", "", text, flags=re.DOTALL).lower()


def test_numbers_that_do_not_exist_are_said_in_words():
    text = "".join(page("planar").text)
    assert "never" in text  # half a second does not settle
    assert "does not apply to this run: " in text


def test_the_same_result_gives_the_same_bytes(tmp_path):
    save_report(result("planar"), tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == html("planar")


def test_words_of_a_scenario_stay_words():
    nasty = cp.run(
        SCENARIOS["planar"]().replace(
            name="<b>&", summary="<script>alert(1)</script>", duration=0.05, events=()
        ),
        warn=False,
    )
    text = report_html(nasty)
    assert "<script>alert" not in text
    assert "<b>&" not in text
    assert "&lt;b&gt;&amp;" in text


def test_limits_that_were_exceeded_are_listed():
    weak = cp.run("adept-paper", SHORT | {"cell.arms.left.torque_limits": 3.0}, warn=False)
    assert weak.limit_violations()
    text = "".join(Page(report_html(weak)).text)
    for beyond in weak.limit_violations():
        assert f"{beyond.worst:.4g}" in text
    assert "No joint and no drive" not in text
    assert weak.task.text in text
    assert all(str(breach) in text for breach in weak.task.deviations)
    assert "simulation sound: all checks passed: grasps closed to" in "".join(page("planar").text)
    assert "No joint and no drive" in "".join(page("planar").text)


def test_a_run_that_broke_off_is_told_as_such():
    late = {
        "controller.force_path": {"kind": "late"},
        "controller.gains.force_gain": 1.5,
        "beyond_bound": True,
        "events": [],
    }
    with pytest.raises(DivergedError) as caught:
        cp.run("adept-paper", late, warn=False)
    result = caught.value.result
    assert f"t = {result.end:g} s of {result.scenario.duration:g} s" in report_html(result)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_curves_are_the_recorded_ones(name):
    """Axial and shear are the parts of each internal force; condition numbers are as recorded."""
    data = result(name).data
    axes = internal_force_figure(result(name)).axes
    arms, columns = len(data.arm), len(axes) // 3  # one column if two arms mirror each other
    curves = np.array([panel.lines[0].get_ydata() for panel in axes]).reshape(3, columns, -1)
    wrench = np.nan_to_num(data.internal_wrench.values)[:, :columns]
    np.testing.assert_allclose(
        np.hypot(curves[0], curves[1]), np.linalg.norm(wrench[..., :3], axis=2).T, atol=1e-9
    )
    np.testing.assert_allclose(curves[2], np.linalg.norm(wrench[..., 3:], axis=2).T, atol=1e-12)
    lines = singularity_figure(result(name)).axes[0].lines[:arms]
    np.testing.assert_array_equal(
        np.array([line.get_ydata() for line in lines]).T, data.jacobian_condition.values
    )


# ---------------------------------------------------------------- command line

FAST = ["--duration", "0.1", "--events", "[]", "--quiet", "--no-replay", "--no-figures"]


@pytest.mark.slow
def test_report_is_written_from_a_folder_or_a_file(tmp_path, capsys):
    assert main(["run", "adept-paper", "--out", str(tmp_path), *FAST]) == 4
    assert not (tmp_path / "report.html").exists()
    assert main(["report", str(tmp_path)]) == 0
    assert capsys.readouterr().out.strip() == str((tmp_path / "report.html").resolve())
    assert main(["report", str(tmp_path / "result.nc"), "--out", str(tmp_path / "again.html")]) == 0
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "report.html").read_bytes()


@pytest.mark.gate
def test_run_writes_a_report_when_asked_and_leaves_no_old_one(tmp_path):
    assert main(["run", "adept-paper", "--out", str(tmp_path), "--report", *FAST]) == 4
    written = (tmp_path / "report.html").read_bytes()
    assert b"adept-paper" in written
    assert main(["report", str(tmp_path / "result.nc"), "--out", str(tmp_path / "again.html")]) == 0
    assert (tmp_path / "again.html").read_bytes() == written
    assert main(["run", "adept-paper", "--out", str(tmp_path), *FAST]) == 4
    assert not (tmp_path / "report.html").exists()


def test_a_report_of_nothing_is_bad_input(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert "there is no result file" in capsys.readouterr().err


def test_the_legend_of_the_motion_fits_beside_a_narrow_cell():
    """Two arms that face each other along y, seen from above, leave a tall and narrow picture."""
    run = result("planar")
    data, turn = run.data.copy(deep=True), np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    for name in ("tip_position", "payload_position", "desired_position"):
        data[name] = data[name].copy(data=data[name].values @ turn.T)
    cell = run.scenario.cell
    arms = {
        name: arm.replace(base=cp.Pose(xyz=tuple(turn @ arm.base.xyz))) for name, arm in cell.arms.items()
    }
    narrow = RunResult(run.scenario.replace(cell=cell.replace(arms=arms)), data)
    for figure in (motion_figure(run), motion_figure(narrow)):
        figure.draw_without_rendering()
        (legend,) = figure.legends
        left, _, right, _ = legend.get_window_extent().extents
        assert 0.0 <= left < right <= figure.bbox.width
        assert figure.bbox.width <= 7.5 * figure.dpi
