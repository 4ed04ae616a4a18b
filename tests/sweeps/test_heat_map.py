"""Heat maps of comparisons and sweeps in a headless browser: filters, keyboard, commands, colours."""

import numpy as np
import pandas as pd
import pytest
from browser import offline_page
from made_up import made_up
from test_sweep_result import GAIN, MASS, RATE, filled

import coop_pin as cp
from coop_pin.sweeps.heat_map import replay_file, wanted_squeeze, write_heat_map
from coop_pin.sweeps.plan import SweepPlan

SHOWN = """() => [...document.querySelectorAll("#map tbody tr")].filter(row => row.cells[0].scope === "row")
    .map(row => [row.cells[0].textContent, ...[...row.cells].slice(1).map(cell => cell.textContent)])"""
FOCUSED = "document.activeElement.closest('tr').cells[0].textContent"
COMMAND = "document.querySelector('aside pre').textContent"
COLOURS = """() => [...document.querySelectorAll("#map td[data-row]:not(.none)")].map(cell => {
    const { color, backgroundColor } = getComputedStyle(cell);
    const rgb = (text) => text.match(/[\\d.]+/g).slice(0, 3).map(Number);
    return [cell.title, rgb(color), rgb(backgroundColor)]; })"""
ALL = np.eye(3)
PROTAN = [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
DEUTAN = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]
"""Colours as readers without red or green cones see them, linear RGB (Machado, Oliveira, Fernandes 2009)."""


def luminance(rgb, seen=ALL):
    """Relative luminance of sRGB colours, shape (..., 3), 0 to 255 (WCAG 2)."""
    part = np.asarray(rgb) / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    return (linear @ np.transpose(seen)).clip(0.0, 1.0) @ [0.2126, 0.7152, 0.0722]


def numbers(texts):
    """Numbers of cells; infinite where there is none."""
    return np.array([np.inf if text in ("none", "failed") else float(text) for text in texts])


@pytest.fixture(scope="module")
def table():
    return made_up(6, 14, 12, 1e6)


@pytest.fixture(scope="module")
def page_file(table, tmp_path_factory):
    path = tmp_path_factory.mktemp("heat map") / "comparison.html"
    table.write_html(path)
    return path


@pytest.fixture(scope="module")
def page(page_file):
    """Page of one browser, with the network off."""
    with offline_page(page_file) as found:
        yield found


def test_a_large_page_is_small_and_loads_nothing(page_file):
    assert page_file.stat().st_size < 1e6
    assert "http" not in page_file.read_text()


def test_filters_keyboard_and_sorting_lead_to_cells_and_their_commands(table, page, page_file):
    scenarios, controllers, trials = (table.data[name].values.tolist() for name in table.data.dims)
    values = table.data["axial_rms_N"].sel(scenario=scenarios[2]).values
    page.goto(page_file.as_uri())
    page.select_option("[name='only.scenario']", scenarios[2])
    shown = page.evaluate(SHOWN)
    assert [row[0] for row in shown] == controllers
    np.testing.assert_allclose([numbers(row[1:]) for row in shown], values, rtol=0.06)

    page.locator("#map td[data-row]").first.focus()
    for key in ("ArrowDown", "ArrowDown", "ArrowRight", "ArrowUp", "ArrowDown", "End"):
        page.keyboard.press(key)
    assert page.evaluate(FOCUSED) == controllers[2]
    text = f'{scenarios[2]} --controllers {controllers[2]} --trials "{trials[-1]}"'
    assert page.evaluate(COMMAND) == f"coop-pin compare {text}"
    for key in ("Home", "Enter", "ArrowDown"):
        page.keyboard.press(key)
    heads = page.locator("aside thead th[scope=col]").all_inner_texts()
    assert heads == controllers[2:4]
    page.keyboard.press("c")
    page.wait_for_function("document.querySelector('aside figcaption').textContent === 'copied'")
    address = page.url

    for order in (np.sort(values[:, 3]), -np.sort(-values[:, 3])):
        page.locator("#map thead button").nth(3).click()
        found = numbers([row[4] for row in page.evaluate(SHOWN)])
        np.testing.assert_allclose(found, order, rtol=0.06)
    page.select_option("[name=columns]", "measures")
    assert page.locator("#map thead button").count() == 8
    page.keyboard.press("Escape")
    page.goto(address)
    page.reload()
    assert page.locator("aside thead th[scope=col]").all_inner_texts() == heads


def test_a_darker_colour_is_a_larger_ratio_for_every_reader_and_numbers_can_be_read(table, page, page_file):
    best = table.data["axial_rms_N"].min("controller")
    page.goto(page_file.as_uri())
    page.select_option("[name='only.scenario']", "")
    found = page.evaluate(COLOURS)
    ratios = []
    for title, *_ in found:
        scenario, controller, rest = title.split(" | ")
        cell = {"scenario": scenario, "trial": rest.partition(":")[0]}
        value = table.data["axial_rms_N"].sel(cell | {"controller": controller})
        ratios.append(min(float(value / best.sel(cell)), 1e3))
    written, ground = (np.array([colours[k] for _, *colours in found]) for k in (0, 1))
    order = np.argsort(ratios)
    for seen in (ALL, PROTAN, DEUTAN):
        assert (np.diff(luminance(ground[order], seen)) < 5e-3).all()
    dark, light = np.sort([luminance(written), luminance(ground)], axis=0)
    assert ((light + 0.05) / (dark + 0.05)).min() >= 4.5
    lightness = 116.0 * np.cbrt(luminance(ground)) - 16.0
    assert np.ptp(lightness) > 70.0
    slope = np.polyfit(np.log(ratios), lightness, 1)
    assert np.abs(np.polyval(slope, np.log(ratios)) - lightness).max() < 12.0  # even steps


def test_replays_are_linked_a_phone_scrolls_in_the_map_alone_and_names_stay(table, page, tmp_path):
    names = [table.data[name].values[0] for name in table.data.dims]
    (tmp_path / "replays").mkdir()
    (tmp_path / "replays" / replay_file([names])).write_text("")
    table.write_html(tmp_path / "map.html")
    page.set_viewport_size({"width": 420, "height": 900})
    page.goto((tmp_path / "map.html").as_uri())
    page.locator("#map td[data-row]").first.click()
    assert page.locator("aside a").get_attribute("href") == f"replays/{replay_file([names])}"
    page.keyboard.press("End")
    assert page.locator("aside a").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= 420
    page.evaluate("document.querySelector('main').scrollTo(1000, 60)")
    head, name = (page.locator(one).bounding_box() for one in ("#map thead th >> nth=0", "main"))
    assert (head["x"], head["y"]) == pytest.approx((name["x"], name["y"]), abs=2.0)
    assert page.locator("#map tbody th[scope=row]").nth(3).bounding_box()["x"] == pytest.approx(0, abs=2.0)


def test_a_sweep_of_three_fields_is_explored_by_the_numbers_of_its_runs(page, tmp_path):
    axes = {MASS: [2.0, 5.0], GAIN: [0.0, 0.2], RATE: [50.0, 100.0, 200.0]}
    plan = SweepPlan(base="adept-paper", axes=axes)
    metrics = lambda p: {"f": -p[MASS] * p[RATE], "simulation_sound": float(p[MASS] < 3.0)}  # noqa: E731
    result = filled(tmp_path / "sweep", plan, metrics, lambda p: p[GAIN] * p[RATE] > 30.0)
    result.write_html(tmp_path / "map.html", "f")
    page.goto((tmp_path / "map.html").as_uri())
    rows = [["0", "-100", "-200", "-400"], ["0.2", "-100", "-200", "failed"]]
    rows += [["0", "-250", "-500", "-1000"], ["0.2", "-250", "-500", "failed"]]
    assert page.evaluate(SHOWN) == rows
    assert page.locator("#map td.unsound").count() == 5
    page.locator("#map td[data-row]").nth(7).click()
    assert page.evaluate(COMMAND).endswith("--replay 7")


def test_the_page_opens_on_the_internal_force_and_its_colour_is_the_share_of_the_squeeze(page, tmp_path):
    """Darker is a larger share, whatever the rivals have: from 1 to 1000 % of what each cell wants."""
    table = pd.DataFrame({"cell": ["a", "b", "c", "d"], "law": ["one"] * 4, "force": [1e-5, 0.1, 10.0, 1.0]})
    table = table.assign(unsound=False, unkept=False, failure="", other=1.0)
    texts = {"force": "internal force (N)", "other": "other (mm)"}
    write_heat_map(
        table,
        tmp_path / "map.html",
        title="shares",
        names=("cell", "law"),
        rivals=("law",),
        measures=texts,
        forces=("force",),
        squeezes=(10.0, 10.0, 10.0, float("nan")),
        command="run {cell}",
    )
    page.set_viewport_size({"width": 1400, "height": 900})
    page.goto((tmp_path / "map.html").as_uri())
    assert page.locator("[name=measure]").input_value() == "0"
    assert "share of the squeeze" in page.locator("#scale").inner_text()
    least, one, most, unknown = (np.array(ground) for _, _, ground in page.evaluate(COLOURS))
    assert (least == one).all()  # 1 % and less
    assert luminance(most) < luminance(one) - 0.3
    assert (unknown == least).all()  # the least among its rivals
    assert "100 % of the squeeze" in page.locator("#map td[data-row]").nth(2).get_attribute("title")
    page.select_option("[name=measure]", "1")
    assert "share" not in page.locator("#scale").inner_text()


def test_the_squeeze_that_is_wanted_is_the_largest_of_the_run():
    ramp = cp.Scenario.load("two-pandas-box")
    force = np.linalg.norm(ramp.squeeze.at(ramp.duration, ramp.cell.grasps)[:, :3], axis=1).max()
    assert wanted_squeeze(ramp) == pytest.approx(force)
    planar = cp.Scenario.load("adept-paper")
    assert wanted_squeeze(planar) == pytest.approx(10.0)
