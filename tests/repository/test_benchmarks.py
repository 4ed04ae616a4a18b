"""The benchmarks run; MuJoCo, an independent simulator, moves the same cell the same way."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.simulation.build_controller import build_controller

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def benchmark_module(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module


def test_the_tick_benchmark_prints_its_ratios(benchmark_module, capsys):
    benchmark_module("bench_tick").main(["--blocks", "2", "--calls", "1", "--duration", "0.05"])
    printed = capsys.readouterr().out
    assert "one arm's tick of law (23), kinematics included" in printed
    assert "whole run: 4 ticks" in printed


@pytest.mark.gate
def test_the_live_benchmark_prints_cost_and_rate(benchmark_module, capsys, monkeypatch):
    live = benchmark_module("bench_live")
    monkeypatch.setattr(live, "in_browser", lambda _: None)  # the browser has tests of its own
    live.main(["--blocks", "1", "--duration", "0.2"])
    printed = capsys.readouterr().out
    assert "a frame costs the run" in printed
    assert ", 0 dropped" in printed


def table_of_plants(page):
    """Cells of each row but the first two, by the row's name."""
    (table,) = re.findall(
        r"^\| plant \|.*\n\|[-| ]+\n((?:\|.*\n)+)", page.read_text(encoding="utf-8"), re.MULTILINE
    )
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    return {name: cells for name, *cells in rows}


def test_the_mujoco_benchmark_prints_its_table_and_writes_it_into_pages(benchmark_module, capsys, tmp_path):
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra 'bench')")
    page = tmp_path / "page.md"
    page.write_text("before\n\n| plant | gap, m |\n|---|---|\n| old | 1 |\n\nafter\n")
    words = ["--rounds", "1", "--duration", "0.05", "--solref", "2", "--pages", str(page)]
    benchmark_module("bench_mujoco").main(words)
    lines = [re.split(r" {2,}", line) for line in capsys.readouterr().out.splitlines() if " ms" in line]
    assert len(lines) == 7
    assert {name: cells[:6] for name, *cells in lines} == {
        name: cells[:6] for name, cells in table_of_plants(page).items()
    }
    assert page.read_text().startswith("before\n\n| plant |")
    assert page.read_text().endswith("|\n\nafter\n")


def test_mujoco_slips_where_the_margin_is_zero(benchmark_module):
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra 'bench')")
    bench = benchmark_module("bench_slip")
    for seed in (2, 3):  # planar with torsion, and three palms in space, turned
        found = bench.slip(bench.grasps(seed), "finger")
        assert_allclose(found.part, 1.0, atol=0.01)
        assert found.inertia < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["finger", "pad"])
def test_two_hundred_grasps_slip_in_mujoco_near_the_margin(benchmark_module, contact):
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra 'bench')")
    bench = benchmark_module("bench_slip")
    slips = np.array([bench.slip(bench.grasps(seed), contact) for seed in range(200)])
    parts, inertia = slips.T
    print(
        contact,
        np.mean(np.abs(parts - 1.0) < 0.05),
        np.quantile(parts, (0, 0.05, 0.5, 0.95, 1)),
        inertia.max(),
    )
    assert np.mean(np.abs(parts - 1.0) < 0.05) >= 0.95
    assert 0.9 < parts.min() < parts.max() < 1.05
    assert inertia.max() < 0.01


def test_at_equal_error_the_mujoco_benchmark_takes_the_coarsest_steps_within_it(
    benchmark_module, capsys, monkeypatch
):
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra 'bench')")
    bench = benchmark_module("bench_mujoco")
    monkeypatch.setattr(bench, "LADDER", (1, 2, 3))
    bench.main(["--equal-error", "1e-6", "1e-30", "--rounds", "1", "--duration", "0.05"])
    lines = [re.split(r" {2,}", line) for line in capsys.readouterr().out.splitlines()[2:]]
    assert [name.split(",")[0] for name, *_ in lines] == 2 * ["coop_pin", "coop_pin compiled", "MuJoCo"]
    for _, limit, step, gap, position, *_ in lines[:3]:
        assert max(float(gap), float(position)) <= float(limit) == 1e-6
        assert 12.5 / float(step) == pytest.approx(round(12.5 / float(step)), rel=1e-3)
    assert all(text.startswith("not with") for _, limit, text in lines[3:])
    errors = {"a": {1: 3e-6, 2: 9e-7, 3: 2e-8}, "b": {1: 2e-6, 2: 3e-7, 3: 4e-8}}
    still = bench.Recorded(*np.zeros((5, 4, 3)))
    runs = {
        name: lambda steps, gaps=gaps: still._replace(gap_m=np.full(3, gaps[steps]))
        for name, gaps in errors.items()
    }
    found = bench.coarsest(runs, still, (1e-6, 1e-7, 1e-8))
    assert {limit: chosen for limit, (*chosen, _) in found.items()} == {1e-6: ["b", 2], 1e-7: ["a", 3]}


def test_the_page_of_benchmarks_has_a_table_of_plants():
    table = table_of_plants(BENCHMARKS / "README.md")
    assert {"coop_pin, 2.5 ms", "coop_pin compiled, 2.5 ms", "MuJoCo, 2.5 ms, solref 2 dt"} <= set(table)


@pytest.mark.slow
def test_the_errors_in_the_table_of_plants_are_those_of_its_runs(benchmark_module):
    """To a factor of two: the smallest are rounding, which another machine does differently."""
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra 'bench')")
    bench, cell = benchmark_module("bench_mujoco"), benchmark_module("mujoco_cell")
    scenario = cp.Scenario.load("adept-paper", bench.OVERRIDES)
    reference = bench.recorded(bench.coop_pin_run(scenario, 64))
    found = {
        "coop_pin, 2.5 ms": bench.recorded(bench.coop_pin_run(scenario, 5)),
        "coop_pin compiled, 2.5 ms": bench.recorded(bench.coop_pin_run(scenario, 5, "compiled")),
        "MuJoCo, 2.5 ms, solref 2 dt": cell.MujocoRun(scenario, build_controller(scenario), 2.0).run(),
    }
    table = table_of_plants(BENCHMARKS / "README.md")
    for name, run in found.items():
        shown = np.array([float(error) for error in table[name][:6]])
        assert_allclose(np.log2(bench.errors(run, reference) / shown), 0.0, atol=1.0, err_msg=name)


def test_mujoco_agrees_on_motion_and_internal_wrench(benchmark_module):
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra 'bench')")
    bench, cell = benchmark_module("bench_mujoco"), benchmark_module("mujoco_cell")
    events = [
        {"kind": "payload-change", "time": 0.2, "mass": 5.6},
        {"kind": "wrench-pulse", "time": 0.2, "duration": 0.1, "wrench": [200.0, 100.0, 0.0, 0.0, 0.0, 2.0]},
    ]
    scenario = cp.Scenario.load("adept-paper", bench.OVERRIDES | {"duration": 0.5, "events": events})
    ours = bench.recorded(bench.coop_pin_run(scenario, 5))
    theirs = cell.MujocoRun(scenario, build_controller(scenario)).run()
    assert_allclose(theirs.position, ours.position, rtol=0, atol=1e-6)
    assert_allclose(theirs.angle, ours.angle, rtol=0, atol=1e-5)
    assert_allclose(theirs.internal_wrench, ours.internal_wrench, rtol=0, atol=0.05)
    assert abs(ours.internal_wrench[:, 0]).max() > 5.0


def test_the_arms_benchmark_starts_both_engines_alike(benchmark_module, capsys):
    pytest.importorskip("mujoco", reason="mujoco is not installed (extra 'bench')")
    benchmark_module("bench_arms").main(["--arms", "2", "--blocks", "1", "--calls", "1"])
    assert "2 arms: coop_pin" in capsys.readouterr().out


@pytest.mark.slow
def test_the_benchmark_of_the_command_prints_time_of_run_and_tick(benchmark_module, capsys, monkeypatch):
    bench, known = benchmark_module("bench_run"), {}

    def child_once(tree, *words):
        if words[:2] not in known:  # the first round, which writes bytecode, and the others are the same
            known[words[:2]] = child(tree, *words)
        return known[words[:2]]

    child = bench.child
    monkeypatch.setattr(bench, "child", child_once)
    bench.main(["--rounds", "1", "--duration", "0.05", "--ticks", "4", "--runs", "0"])
    printed = capsys.readouterr().out
    assert re.search(r"coop-pin run adept-paper, all files\n .* best +\d+\.\d+ s", printed)
    assert re.search(r"a tick of two-pandas-box, best block\n .* best +\d+\.\d+ us", printed)
