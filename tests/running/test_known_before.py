"""Findings that stay with a result, and come before a sweep and in a panel: planar and spatial cells."""

import logging

import pytest
from test_plausibility import cell_of
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import DivergedError
from coop_pin.running.check import run_findings
from coop_pin.sweeps.workers.execution import Execution

WEAK = {"planar": 2.0, "spatial": 15.0}
"""Torque limits below what the arms need to stand still, N m."""


def weak(kind):
    return short(kind).override({"cell.arms.left.torque_limits": WEAK[kind]})


def short(kind):
    cell = cell_of(kind)
    return cell.replace(duration=0.1, events=(), motion=cp.motions.HoldMotion(pose=cell.start))


@pytest.mark.parametrize(
    ("kind", "engine"),
    by_default(
        [
            *(("planar", "compiled"), ("spatial", "pinocchio")),
            *(
                pytest.param(*others, marks=pytest.mark.slow)
                for others in (("planar", "pinocchio"), ("spatial", "compiled"))
            ),
        ],
        ("planar", "compiled"),
    ),
)
def test_what_a_run_warns_of_stays_with_its_result_and_its_pages(kind, engine, tmp_path):
    scenario = weak(kind)
    with pytest.warns(cp.errors.ScenarioWarning):
        result = cp.run(scenario, engine=engine)
    expected = run_findings(scenario).of("error", "warning")
    assert "static torque" in {finding.kind for finding in result.findings}
    assert result.findings.entries == expected.entries
    result.save(tmp_path / "result.nc")
    loaded = cp.RunResult.load(tmp_path / "result.nc")
    assert str(loaded.findings.entries) == str(expected.entries)
    (sentence, *_) = (finding.sentence.split(" needs ")[1][:20] for finding in result.findings)
    cp.viz.save_report(loaded, tmp_path / "report.html")
    cp.viz.save_replay(loaded, tmp_path / "replay.html")
    for page in ("report.html", "replay.html"):
        assert sentence in (tmp_path / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", WEAK)
def test_a_sound_cell_and_a_run_that_does_not_look_have_none(kind):
    assert len(cp.run(short(kind)).findings) == 0
    assert len(cp.run(weak(kind), warn=False).findings) == 0


def test_a_run_that_breaks_off_keeps_what_was_known():
    late = {"controller.force_path": {"kind": "late"}, "controller.gains.force_gain": 1.5}
    with pytest.raises(DivergedError) as caught:
        cp.run("adept-paper", late | {"beyond_bound": True, "events": []})
    known = run_findings(caught.value.result.scenario).of("error", "warning")
    assert str(caught.value.result.findings.entries) == str(known.entries)


@pytest.mark.parametrize("kind", by_default(WEAK, "planar"))
def test_a_sweep_logs_what_is_known_of_its_first_run_unless_it_is_quiet(kind, tmp_path, caplog):
    axes = {"controller.gains.pose_gain": [1.0, 1.1]}
    with caplog.at_level(logging.WARNING, "coop_pin.sweeps"):
        cp.sweep(weak(kind), axes, out=tmp_path / "quiet", execution=Execution(workers=0, quiet=True))
        assert "to stand still" not in caplog.text
        cp.sweep(weak(kind), axes, out=tmp_path / "told", execution=Execution(workers=0))
    assert caplog.text.count("to stand still") == len(run_findings(weak(kind)).of("error"))
