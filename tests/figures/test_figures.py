"""Figures show the numbers of the result, say what they are, and are the same bytes each time."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from cells import planar_scenario, spatial_scenario
from figure_texts import meeting_texts, shown_numbers
from matplotlib.axes import Axes
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from coop_pin import run
from coop_pin.description.grasp_events import HandOver
from coop_pin.figures import error_figure, internal_force_figure, save_figure, torque_figure, tracking_figure
from coop_pin.results.energies import energy_balance
from coop_pin.results.run_result import RunResult

FIGURES = [tracking_figure, torque_figure, error_figure]


@pytest.fixture(scope="module")
def planar() -> RunResult:
    return run(planar_scenario())


@pytest.fixture(scope="module")
def spatial() -> RunResult:
    return run(spatial_scenario())


def data_lines(panel: Axes) -> list[np.ndarray]:
    """The curves of a panel, without the marks of events and bands."""
    return [np.asarray(line.get_ydata()) for line in panel.lines if len(line.get_xdata()) > 2]


def down(figure: mpl.figure.Figure) -> list[Axes]:
    """The panels of two columns, as they are read: down the first, then down the second."""
    return [*figure.axes[::2], *figure.axes[1::2]]


def titles(figure: mpl.figure.Figure) -> list[str]:
    return [panel.get_title(loc="left") for panel in down(figure)]


# ---------------------------------------------------------------- tracking


def test_planar_tracking_shows_x_y_psi_and_all_parts_of_the_internal_wrench(planar: RunResult) -> None:
    figure, data = tracking_figure(planar), planar.data
    x, y, psi, moment, axial, shear = down(figure)
    assert titles(figure) == [
        "payload x",
        "payload y",
        "payload ψ",
        "arm left: internal moment",
        "arm left: internal force, axial",
        "arm left: internal force, shear",
    ]
    assert [panel.get_ylabel() for panel in down(figure)] == ["m", "m", "deg", "N m", "N", "N"]
    assert [panel.get_xlabel() for panel in (psi, shear)] == ["time (s)"] * 2
    for part, panel in (("moment", moment), ("axial", axial), ("shear", shear)):
        assert_array_equal(data_lines(panel)[0], data[f"internal_{part}"].values[:, 0])
    for axis, panel in enumerate((x, y)):
        actual, desired = data_lines(panel)
        assert_array_equal(actual, data["payload_position"].values[:, axis])
        assert_array_equal(desired, data["desired_position"].values[:, axis])
    heading, desired_heading = data_lines(psi)
    rotations = (
        Rotation.from_quat(data[f"{name}_quaternion"].values).as_rotvec(degrees=True)[:, 2]
        for name in ("payload", "desired")
    )
    for drawn, wanted in zip((heading, desired_heading), rotations, strict=True):
        assert_allclose(drawn, wanted, atol=1e-9)


def test_the_drawn_axial_force_has_the_mean_and_the_rms_error_of_the_metrics(planar: RunResult) -> None:
    actual, desired = data_lines(down(tracking_figure(planar))[4])
    inside = planar.phases["moving"]
    metrics = planar.internal_force()  # of both arms: their internal forces and axial directions are opposite
    assert_allclose(actual[inside].mean(), metrics.axial_mean, rtol=1e-9)
    assert_allclose(np.sqrt(np.mean((actual - desired)[inside] ** 2)), metrics.axial_rms_error, rtol=1e-9)
    assert_allclose(desired, -10.0, atol=0.6)  # the squeeze turns with the payload, the line with the tips


@pytest.mark.parametrize("panel", [3, 4, 5])
def test_a_peak_that_would_flatten_the_rest_is_whole_in_an_inset(planar: RunResult, panel: int) -> None:
    drawn, time = down(tracking_figure(planar))[panel], planar.data["time"].values
    actual = data_lines(drawn)[0]
    low, high = drawn.get_ylim()
    (inset,) = drawn.child_axes
    start, end = inset.get_xlim()
    least, most = inset.get_ylim()
    assert start < 10.0 < end
    inside = (time >= start) & (time <= end)
    assert ((low < actual) & (actual < high))[~inside].all()
    assert ((least < actual) & (actual < most))[inside].all()
    assert actual.max() > high  # so that the inset is needed


def test_a_run_without_a_peak_has_no_inset(spatial: RunResult) -> None:
    quiet = spatial.data.isel(time=slice(spatial.data.sizes["time"] // 2, None))
    panel = tracking_figure(RunResult(spatial.scenario, quiet)).axes[0]
    assert panel.child_axes == []


def test_internal_forces_that_mirror_each_other_have_one_column(planar: RunResult) -> None:
    figure = internal_force_figure(planar)
    assert [panel.get_title(loc="left") for panel in figure.axes] == [
        f"arms left and right, {part}" for part in ("axial", "shear", "moment about P")
    ]
    data = planar.data.copy(deep=True)
    data["internal_axial"][:, 1] *= 1.1
    assert len(internal_force_figure(RunResult(planar.scenario, data)).axes) == 6


def test_a_figure_for_a_paper_has_its_width_no_title_and_fonts_that_can_be_searched(
    planar: RunResult, tmp_path: Path
) -> None:
    (path,) = save_figure(tracking_figure(planar), tmp_path / "figure", paper=True)
    page = path.read_bytes()
    width = float(re.search(rb"/MediaBox \[ 0 0 ([\d.]+)", page)[1])
    assert path.suffix == ".pdf"
    assert_allclose(width, 7.16 * 72.0, atol=0.1)
    assert b"/Type3" not in page
    assert b"/CIDFontType2" in page
    (named,) = save_figure(tracking_figure(planar), tmp_path / "named.png", paper=True)
    assert named == tmp_path / "named.png"
    assert named.read_bytes().startswith(b"\x89PNG")
    again = save_figure(tracking_figure(planar), tmp_path / "again", paper=True)
    assert again[0].read_bytes() == page


def test_spatial_tracking_shows_x_y_z_both_errors_and_all_parts_of_the_internal_wrench(
    spatial: RunResult,
) -> None:
    figure, data = tracking_figure(spatial), spatial.data
    positions, (*errors, moment, axial, shear) = down(figure)[:3], down(figure)[3:]
    for axis, panel in enumerate(positions):
        actual, desired = (data[f"{of}_position"].values[:, axis] for of in ("payload", "desired"))
        is_still = np.ptp((actual, desired)) < 1e-3 * np.abs(desired).max()
        is_small = is_still or np.ptp((actual, desired)) < 0.01
        assert panel.get_ylabel() == ("mm" if is_small else "m")
        drawn = actual - desired if is_still else actual
        assert_allclose(data_lines(panel)[0], 1e3 * drawn if is_small else drawn)
    for panel, unit, rows in zip(errors, ("mm", "mrad"), (slice(0, 3), slice(3, 6)), strict=True):
        assert panel.get_ylabel() == unit
        assert_allclose(np.column_stack(data_lines(panel)), 1e3 * data["pose_error"].values[:, rows])
    wrench = data["internal_wrench"].values[:, 0]
    force = np.linalg.norm(wrench[:, :3], axis=1)
    assert_allclose(np.hypot(data_lines(axial)[0], data_lines(shear)[0]), force, rtol=1e-9)
    assert_allclose(data_lines(moment)[0], np.linalg.norm(wrench[:, 3:], axis=1), rtol=1e-9)


def test_a_moment_that_no_row_controls_has_no_desired_curve(spatial: RunResult) -> None:
    cell = spatial.scenario.cell.model_copy(update={"rows": "positional"})
    result = RunResult(spatial.scenario.model_copy(update={"cell": cell}), spatial.data)
    assert [len(data_lines(panel)) for panel in down(tracking_figure(result))[-3:]] == [1, 2, 2]
    assert [len(data_lines(panel)) for panel in down(tracking_figure(spatial))[-3:]] == [2, 2, 2]


def test_internal_forces_of_more_than_two_arms_or_of_arms_that_let_go_are_all_drawn(
    planar: RunResult,
) -> None:
    result = run("three-ur5-plate", {"duration": 0.1}, warn=False)
    *_, moment, axial, shear = down(tracking_figure(result))
    for part, panel in (("moment", moment), ("axial", axial), ("shear", shear)):
        drawn = [line for line in panel.lines if line.get_linestyle() == "-" and len(line.get_xdata()) > 2]
        values = result.data[f"internal_{part}"].values
        assert_array_equal(np.column_stack([line.get_ydata() for line in drawn]), values)
        assert len({line.get_color() for line in drawn}) == 3
    event = {"kind": "hand-over", "time": 1.0, "arm": "right"}
    lets_go = planar.scenario.model_copy(update={"events": (HandOver(**event),)})
    axial = down(tracking_figure(RunResult(lets_go, planar.data)))[-2]
    assert len(data_lines(axial)) == 4


def test_a_long_caption_is_wrapped_inside_the_figure(planar: RunResult) -> None:
    long = planar.scenario.replace(summary="Three arms of six joints carry a heavy plate by its rim " * 4)
    figure = tracking_figure(RunResult(long, planar.data))
    figure.draw_without_rendering()
    box, page = figure._supxlabel.get_window_extent(), figure.bbox
    assert figure._supxlabel.get_text().count("\n") >= 2
    assert page.x0 < box.x0
    assert box.x1 < page.x1


# ---------------------------------------------------------------- torque


@pytest.mark.parametrize(("name", "joints"), [("planar", 3), ("spatial", 6)])
def test_torques_stand_in_a_column_for_each_arm_and_a_row_for_each_joint(
    name: str, joints: int, request: pytest.FixtureRequest
) -> None:
    result = request.getfixturevalue(name)
    figure = torque_figure(result)
    assert len(figure.axes) == 2 * joints
    for place, panel in enumerate(figure.axes):
        joint, arm = divmod(place, 2)
        limit = result.data["torque_limit"].values[arm, joint]
        told = f" (limit {limit:g})" if np.isfinite(limit) else ""
        assert panel.get_title(loc="left") == f"arm {('left', 'right')[arm]}, joint {joint + 1}{told}"
        assert panel.get_ylim() == figure.axes[2 * joint].get_ylim()
        assert panel.get_ylabel() == "N m"
        assert panel.lines[0].get_drawstyle() == "steps-post"  # held from the tick on
        assert_array_equal(data_lines(panel)[0], result.data["torque"].values[:, arm, joint])


def test_a_limit_is_in_sight_where_a_torque_comes_near_it(spatial: RunResult) -> None:
    data = spatial.data.copy(deep=True)
    worst = np.abs(data["torque"].values).max(axis=(0, 1))
    data["torque_limit"][:] = np.where(np.arange(6) == 2, 1.2, 3.0) * worst
    for place, panel in enumerate(torque_figure(RunResult(spatial.scenario, data)).axes):
        joint, arm = divmod(place, 2)
        limit, (low, high) = float(data["torque_limit"].values[arm, joint]), panel.get_ylim()
        assert (low < -limit or limit < high) == (joint == 2)


def test_a_joint_that_an_arm_does_not_have_is_left_blank(planar: RunResult) -> None:
    data = planar.data.copy(deep=True)
    data["torque"][:, 1, 2] = np.nan
    panels = torque_figure(RunResult(planar.scenario, data)).axes
    assert [panel.get_visible() for panel in panels] == [True] * 5 + [False]


# ---------------------------------------------------------------- errors


def test_errors_stand_on_logarithmic_axes_with_their_bands(planar: RunResult) -> None:
    figure, data = error_figure(planar), planar.data
    position, orientation, closure, energy = figure.axes
    assert [panel.get_yscale() for panel in figure.axes] == ["log"] * 4
    assert [panel.get_ylabel() for panel in figure.axes] == ["mm", "mrad", "m, rad", "J"]
    error = data["pose_error"].values
    for panel, axes in ((position, slice(0, 3)), (orientation, slice(3, 6))):
        assert_allclose(data_lines(panel)[0], 1e3 * np.linalg.norm(error[:, axes], axis=1), rtol=1e-12)
        assert [line.get_ydata()[0] for line in panel.lines if line.get_linestyle() == "--"] == [5.0]
    assert_allclose(np.nan_to_num(data_lines(closure)[0]), data["closure_distance"].values.max(axis=1))
    assert_allclose(np.nan_to_num(data_lines(energy)[0]), np.abs(energy_balance(data)))
    open_grasps = data.copy()
    for name in ("closure_distance", "closure_angle"):
        open_grasps[name] = 0.0 * data[name]
    panel = error_figure(RunResult(planar.scenario, open_grasps)).axes[2]  # a cell without closures
    errors = np.hypot(data["internal_axial_error"].values, data["internal_shear_error"].values)
    assert panel.get_ylabel() == "N"
    assert_allclose(np.nan_to_num(data_lines(panel)[0]), errors.max(axis=1))


# ---------------------------------------------------------------- what all share


@pytest.mark.parametrize("figure_of", FIGURES)
def test_events_and_windows_are_marked_in_every_panel(figure_of, planar: RunResult) -> None:
    for panel in figure_of(planar).axes:
        marks = [line.get_xdata()[0] for line in panel.lines if line.get_linestyle() == ":"]
        assert marks == [10.0, 10.0]  # the change of mass and the push
        *windows, pulse = panel.patches
        assert_allclose((pulse.get_x(), pulse.get_width()), (10.0, 0.2))
        known = planar.windows_of("moving_position_rms_m")
        spans = [(window.get_x(), window.get_x() + window.get_width()) for window in windows]
        assert_allclose(spans, [(window.start, window.end) for window in known])


@pytest.mark.parametrize("figure_of", FIGURES)
def test_a_run_that_ended_at_once_can_be_drawn(figure_of, planar: RunResult, tmp_path: Path) -> None:
    figure = figure_of(RunResult(planar.scenario, planar.data.isel(time=slice(0, 1))))
    assert len(figure.axes) == len(figure_of(planar).axes)
    assert [file.is_file() for file in save_figure(figure, tmp_path / "short")] == [True, True]


@pytest.mark.parametrize("figure_of", FIGURES)
def test_the_same_result_gives_the_same_bytes(figure_of, planar: RunResult, tmp_path: Path) -> None:
    first, second = (save_figure(figure_of(planar), tmp_path / name) for name in ("first", "second"))
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "first.png",
        "first.svg",
        "second.png",
        "second.svg",
    ]
    assert b"<dc:date>" not in first[1].read_bytes()


@pytest.mark.parametrize("name", ["planar", "spatial"])
@pytest.mark.parametrize("figure_of", [*FIGURES, internal_force_figure])
@pytest.mark.parametrize("scale", [1.0, -1.2345e4])
def test_no_text_meets_another_or_the_edge(figure_of, name: str, scale: float, request) -> None:
    """As matplotlib measures the texts when it draws them, with short and with long numbers at the ticks."""
    result = request.getfixturevalue(name)
    data = result.data.assign(torque=scale * result.data["torque"])
    figure = figure_of(RunResult(result.scenario, data))
    figure.draw_without_rendering()
    texts = [figure._suptitle, figure._supxlabel]
    for panel in figure.axes:
        texts += [panel._left_title, panel.xaxis.label, panel.yaxis.label]
        texts += [text for axis in (panel.xaxis, panel.yaxis) for text in shown_numbers(axis)]
    assert meeting_texts(figure, texts) == []


def test_drawing_changes_no_setting_of_matplotlib(spatial: RunResult, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    save_figure(tracking_figure(spatial), tmp_path / "figure")
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("imported", "absent"),
    [("palette", "matplotlib"), ("tracking_figure, sweep_figure", "matplotlib.pyplot")],
)
def test_figures_do_without_pyplot_and_the_palette_without_matplotlib(imported: str, absent: str) -> None:
    code = f"import sys; from coop_pin.figures import {imported}; print({absent!r} in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
