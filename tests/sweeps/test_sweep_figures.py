"""Figures of sweeps against the sweep's data, on stores filled with records of made-up metrics."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import LogNorm
from numpy.testing import assert_allclose, assert_array_equal
from test_sweep_result import filled

from coop_pin.base.errors import FieldError, NameNotFoundError
from coop_pin.cli import main
from coop_pin.figures import pareto_figure, sweep_figure
from coop_pin.figures.sweep_figures import apart, map_figure
from coop_pin.sweeps.plan import SweepPlan

GAIN, RATE, MASS = "controller.gains.sign_gain", "clock.rate_hz", "cell.payload.mass"
GAINS, RATES = [0.0, 0.2, 0.4, 0.6], [50.0, 100.0, 200.0, 400.0]
METRIC = "moving_internal_axial_rms_error_N"


@pytest.fixture
def grid(tmp_path):
    """Unstable where gain rate >= 60; the metric is a trade-off against g."""
    plan = SweepPlan(base="adept-paper", axes={GAIN: GAINS, RATE: RATES})
    return filled(
        tmp_path,
        plan,
        lambda p: {METRIC: p[RATE] + p[GAIN], "g": 1.0 - p[GAIN]},
        lambda p: p[GAIN] * p[RATE] >= 60.0,
    )


def line(tmp_path, axes, metric=lambda _: {METRIC: 1.0}, fails=lambda _: False, **plan):
    return filled(tmp_path, SweepPlan(base="adept-paper", axes=axes, **plan), metric, fails)


def test_a_map_has_every_finished_run_in_its_cell(grid):
    panel = sweep_figure(grid, METRIC).axes[0]
    mesh = panel.collections[0].get_array()
    expected = grid.values(METRIC).values.T
    assert_array_equal(np.ma.getmaskarray(mesh), np.isnan(expected))
    assert_allclose(mesh.compressed(), expected[np.isfinite(expected)], rtol=0, atol=0)
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("sign gain", "clock rate (Hz)")


def test_a_map_hatches_failed_runs_and_draws_the_boundary_once_around_them(grid):
    panel = sweep_figure(grid, METRIC).axes[0]
    failed = (grid.data["status"] == "failed").values
    assert len(panel.patches) == failed.sum()
    sides = np.count_nonzero(failed[1:] != failed[:-1]) + np.count_nonzero(failed[:, 1:] != failed[:, :-1])
    assert len([drawn for drawn in panel.lines if len(drawn.get_xdata())]) == sides


def test_the_boundary_lies_between_the_last_stable_and_the_first_unstable_value(grid):
    level = [
        side
        for side in sweep_figure(grid, METRIC).axes[0].lines
        if len(side.get_ydata()) and np.ptp(side.get_ydata()) == 0.0
    ]
    found = sorted((np.mean(side.get_xdata()), side.get_ydata()[0]) for side in level)
    known = grid.stability_boundary(RATE)
    between = np.sqrt(known["last_stable"] * known["first_unstable"]).values
    assert_allclose([y for _, y in found], between[np.isfinite(between)], rtol=1e-12)


def test_a_map_is_the_same_whichever_way_its_values_were_listed(grid, tmp_path):
    plan = SweepPlan(base="adept-paper", axes={GAIN: GAINS[::-1], RATE: RATES[::-1]})
    fails = lambda p: p[GAIN] * p[RATE] >= 60.0  # noqa: E731
    turned = filled(tmp_path / "turned", plan, lambda p: {METRIC: p[RATE] + p[GAIN]}, fails)
    first, second = (sweep_figure(result, METRIC).axes[0].collections[0] for result in (grid, turned))
    assert_allclose(first.get_array().filled(-1), second.get_array().filled(-1))
    assert_allclose(first.get_coordinates(), second.get_coordinates())


def test_one_field_makes_one_line_through_its_runs_and_crosses_where_they_failed(tmp_path):
    result = line(
        tmp_path, {GAIN: [0.4, 0.0, 0.2]}, lambda p: {METRIC: p[GAIN] ** 2}, lambda p: p[GAIN] == 0.2
    )
    panel = sweep_figure(result, METRIC).axes[0]
    curve, crosses, *_ = panel.lines
    assert_allclose(panel.get_xticks(), [0.0, 0.2, 0.4])
    assert_allclose(curve.get_xdata(), [0.0, 0.2, 0.4])
    assert_allclose(curve.get_ydata(), [0.0, np.nan, 0.16])
    assert_allclose(crosses.get_xdata(), [0.2])


def test_cases_are_lines_of_their_own_with_their_names(tmp_path):
    cases = {"law": {"first": {}, "second": {MASS: 5.0}}}
    result = line(tmp_path, {GAIN: GAINS}, lambda p: {METRIC: 1.0 + (p["law"] == "second")}, cases=cases)
    figure = sweep_figure(result, METRIC)
    curves = [c for c in figure.axes[0].lines if len(c.get_xdata()) == len(GAINS)]
    assert [(c.get_label(), c.get_ydata()[0]) for c in curves] == [("first", 1.0), ("second", 2.0)]


@pytest.mark.parametrize("axes", [{GAIN: GAINS}, {GAIN: GAINS, RATE: RATES}])
def test_runs_that_are_not_sound_or_not_kept_have_marks_and_lines_in_the_legend(tmp_path, axes):
    trusted = lambda p: {  # noqa: E731
        METRIC: 1.0 + p[GAIN],
        "simulation_sound": float(p[GAIN] < 0.3),
        "task_kept": float(p[GAIN] > 0.0),
    }
    figure = sweep_figure(line(tmp_path, axes, trusted, lambda p: p[GAIN] == 0.6), METRIC)
    panel = figure.axes[0]
    rings, squares = (
        drawn for drawn in panel.lines if drawn.get_fillstyle() == "none" and len(drawn.get_xdata())
    )
    assert (set(rings.get_xdata()), set(squares.get_xdata())) == ({0.4}, {0.0})  # 0.6 failed
    (legend,) = figure.legends or [panel.get_legend()]
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["failed", "simulation not sound", "task not kept"]


def test_three_fields_make_a_map_for_each_value_of_the_shortest_on_one_scale(tmp_path):
    axes = {GAIN: GAINS, MASS: [5.0, 11.2, 2.0], RATE: RATES}
    result = line(tmp_path, axes, lambda p: {METRIC: p[MASS] * p[RATE] + p[GAIN]}, lambda p: p[GAIN] == 0.6)
    *panels, _ = sweep_figure(result, METRIC).axes
    assert [panel.get_title(loc="left").split()[-1] for panel in panels] == ["2", "5", "11.2"]
    for panel, mass in zip(panels, (2.0, 5.0, 11.2), strict=True):
        mesh, expected = panel.collections[0], result.values(METRIC).sel({MASS: mass}).transpose(RATE, GAIN)
        assert_array_equal(mesh.get_array().filled(np.nan), expected.values)
        assert len(panel.patches) == len(RATES)
        assert mesh.norm is panels[0].collections[0].norm
    values = result.values(METRIC).values
    assert (mesh.norm.vmin, mesh.norm.vmax) == (np.nanmin(values), np.nanmax(values))
    with pytest.raises(FieldError):
        map_figure(xr.Dataset({"value": (("a", "b", "c"), np.zeros((13, 13, 13)))}))


def test_a_metric_without_a_value_is_refused_by_its_name(tmp_path):
    empty = line(tmp_path, {GAIN: GAINS}, lambda _: {METRIC: np.nan})
    with pytest.raises(FieldError, match=METRIC):
        sweep_figure(empty, METRIC)


def test_scales_are_logarithmic_where_the_numbers_ask_for_it(tmp_path):
    plan = {GAIN: GAINS, RATE: RATES}
    figure = sweep_figure(line(tmp_path, plan, lambda p: {METRIC: 10.0 ** (p[RATE] / 100.0)}), METRIC)
    panel = figure.axes[0]
    assert (panel.get_xscale(), panel.get_yscale()) == ("linear", "log")
    assert isinstance(panel.collections[0].norm, LogNorm)


def test_lines_along_a_chosen_field_and_no_more_than_a_figure_tells_apart(grid, tmp_path):
    panel = sweep_figure(grid, METRIC, over=RATE).axes[0]
    assert panel.get_xlabel() == "clock rate (Hz)"
    assert (
        panel.get_ylabel() == "internal force along the line, rms of its error, while the reference moves (N)"
    )
    many = line(tmp_path / "many", {GAIN: np.linspace(0, 1, 9), RATE: RATES})
    with pytest.raises(FieldError, match="9 lines"):
        sweep_figure(many, METRIC, over=RATE)
    with pytest.raises(NameNotFoundError, match="nothing"):
        sweep_figure(grid, METRIC, over="nothing")
    with pytest.raises(FieldError, match="no numbers"):
        sweep_figure(line(tmp_path / "cases", {}, cases={"law": {"a": {}, "b": {MASS: 5.0}}}), METRIC)


def test_the_front_is_that_of_the_sweep(grid):
    runs, front = pareto_figure(grid, "g", METRIC).axes[0].lines
    places = grid.pareto("g", METRIC)
    assert_allclose(front.get_xdata(), [place.metrics["g"] for place in places])
    assert_allclose(front.get_ydata(), [place.metrics[METRIC] for place in places])
    assert len(runs.get_xdata()) == grid.counts()["ok"]


def test_labels_of_a_front_stand_apart():
    """16 points sideways or 9 upwards; both ends have theirs."""
    points = np.array([(0.0, 0.0), (5.0, 3.0), (17.0, 0.0), (20.0, 8.0), (20.0, 9.5), (100.0, 50.0)])
    assert apart(points) == [0, 2, 4, 5]
    assert apart(points[:2]) == [0]
    assert (apart(points[:1]), apart(points[:0])) == ([0], [])


def test_sweep_show_writes_both_kinds_of_figure(grid, tmp_path, capsys):
    for name, more in (("map", []), ("lines", ["--over", GAIN]), ("front", ["--against", "g"])):
        more = ["--metric", METRIC, *more]
        assert (
            main(["sweep-show", str(grid.store.folder), "--figure", str(tmp_path / f"{name}.png"), *more])
            == 0
        )
        assert f"{name}.svg" in capsys.readouterr().out
        assert (tmp_path / f"{name}.png").stat().st_size > 5000
    part = ["--metric", METRIC, "--at", f"{GAIN}=0.2", "--figure", str(tmp_path / "part")]
    assert main(["sweep-show", str(grid.store.folder), *part]) == 0
    curve = sweep_figure(grid.at({GAIN: "0.2"}), METRIC).axes[0].lines[0]
    assert_allclose(curve.get_xdata(), RATES)
    assert (
        main(["sweep-show", str(grid.store.folder), "--figure", str(tmp_path / "x"), "--metric", "nonsense"])
        == 2
    )


def test_metrics_in_metres_are_drawn_in_millimetres_and_verdicts_in_two_colours(tmp_path):
    axes = {GAIN: GAINS, RATE: RATES}
    metric = lambda p: {"position_error_max_m": 1e-5 * p[RATE], "task_kept": float(p[RATE] > 100.0)}  # noqa: E731
    result = line(tmp_path, axes, metric)
    figure = sweep_figure(result, "position_error_max_m")
    drawn = figure.axes[0].collections[0].get_array()
    assert_allclose(drawn, 1e3 * result.values("position_error_max_m").values.T)
    assert figure.axes[-1].get_ylabel().endswith("(mm)")
    figure = sweep_figure(result, "task_kept")
    assert figure.axes[0].collections[0].get_cmap().N == 2
    assert [text.get_text() for text in figure.axes[-1].get_yticklabels()] == ["no", "yes"]
    lines = sweep_figure(result, "position_error_max_m", RATE).axes[0]
    assert_allclose(lines.lines[0].get_ydata(), [0.5, 1.0, 2.0, 4.0])
    front = pareto_figure(result, "position_error_max_m", "task_kept").axes[0]
    assert front.get_xlabel().endswith("(mm)")
    assert front.lines[0].get_xdata().max() == pytest.approx(4.0)
