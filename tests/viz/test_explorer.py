"""Explorer of many runs: its page and replays, by the address that it gives and no other."""

import contextlib
import json
import re
import urllib.error
import urllib.parse
import urllib.request

import pytest
from browser import browser_page
from cells import planar_scenario, spatial_scenario
from tiers import by_default

import coop_pin as cp
from coop_pin.cli import main
from coop_pin.viz.explorer import Explorer, comparison_replay, is_folder_of_runs

MASS = "cell.payload.mass"


@pytest.fixture(scope="module", params=by_default(["planar", "spatial"], "planar", others=pytest.mark.slow))
def folder(request, tmp_path_factory):
    """Folder of a sweep of three runs."""
    scenario = (planar_scenario if request.param == "planar" else spatial_scenario)().replace(
        duration=0.05, events=()
    )
    out = tmp_path_factory.mktemp(request.param) / "sweep"
    cp.sweep(
        cp.SweepPlan(base=scenario, axes={MASS: [2.0, 3.0, 4.0]}),
        out=out,
        execution=cp.Execution(workers=1, quiet=True),
    )
    return out


@pytest.fixture
def served(folder):
    with contextlib.closing(Explorer(folder)) as found:
        yield found


def got(url):
    with urllib.request.urlopen(url, timeout=60) as answer:
        return answer.read().decode()


def data_of(page):
    return json.loads(
        re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1]
    )


def test_the_page_is_served_and_replays_are_made_when_they_are_asked_for(served, folder):
    page = data_of(got(served.url))
    assert page["served"]
    assert not data_of((folder / "map.html").read_text())["served"]  # of the file, which has no server
    address = f"{served.url}replays/run-1.html?cell=1"
    replay = data_of(got(address))
    file = folder / "replays" / "run-1.html"
    assert file.is_file()
    assert replay["duration"] == pytest.approx(0.05, abs=0.003)
    written = file.stat().st_mtime_ns
    assert data_of(got(address)) == replay
    assert file.stat().st_mtime_ns == written  # not made again


def test_two_cells_are_served_side_by_side(served):
    page = data_of(got(f"{served.url}replays/run-0--2.html?cell=0&cell=2"))
    assert page["names"] == ["run 0", "run 2"]


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("replays/run-99.html?cell=99", 500),
        ("replays/run-x.html?cell=x", 500),
        ("replays/none.html", 404),
        ("replays/..%2Fplan.json", 404),
        ("replays/../../plan.json", 404),
        ("../replays/run-1.html", 404),
        ("other", 404),
    ],
)
def test_nothing_else_is_served(served, path, code):
    for url in (served.url + path, re.sub(r"/[^/]+/$", "/secret/", served.url)):
        with pytest.raises(urllib.error.HTTPError) as refused:
            got(url)
        refused.value.close()
        assert refused.value.code == (code if url.startswith(served.url) else 404)


def test_a_folder_of_one_run_is_none_of_many_and_a_port_in_use_is_refused(served, folder, tmp_path):
    assert is_folder_of_runs(folder)
    assert not is_folder_of_runs(tmp_path)
    port = urllib.parse.urlsplit(served.url).port
    with pytest.raises(cp.CoopPinError, match=str(port)):
        Explorer(folder, port=port)


def test_the_command_writes_runs_side_by_side(folder, tmp_path, capsys):
    assert main(["sweep-show", str(folder), "--page", str(tmp_path / "map.html"), "--replay", "0", "2"]) == 0
    file = tmp_path / "replays" / "run-0--2.html"
    assert str(file) in capsys.readouterr().out
    assert data_of(file.read_text())["names"] == ["run 0", "run 2"]
    assert data_of((tmp_path / "map.html").read_text())["replays"] == [file.name]


def test_a_cell_of_another_form_is_refused(tmp_path):
    with pytest.raises(cp.CoopPinError, match="SCENARIO"):
        comparison_replay(None, ["one"], tmp_path)


@pytest.mark.gate
def test_a_double_click_opens_the_replay_and_two_cells_the_panes(served):
    with browser_page(1400, 900) as page:
        page.goto(served.url)
        cell = page.locator("#map td[data-row]")
        with page.expect_popup() as opened:
            cell.nth(1).dblclick()
        opened.value.wait_for_function("window.coopPin !== undefined")
        assert opened.value.evaluate("coopPin.duration") == pytest.approx(0.05, abs=0.003)
        cell.nth(1).click()
        page.keyboard.press("Enter")
        cell.nth(2).click()
        with page.expect_popup() as opened:
            page.keyboard.press("o")
        opened.value.wait_for_function("window.coopPin?.panes?.length === 2")
