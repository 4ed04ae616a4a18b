"""Payloads of several links, tools and bases on wheels beside each other: what ``check`` and ``run`` say."""

from __future__ import annotations

import numpy as np
import pytest
from linked_cells import linked
from rollers import on_wheels
from tiers import by_default

import coop_pin as cp
from coop_pin.feasibility.reachability import reachability
from coop_pin.feasibility.statics import statics_along
from coop_pin.running.check import run_findings
from coop_pin.running.payload_findings import payload_findings
from coop_pin.simulation.build_controller import build_controller

CELLS = ("adept-anchored", "two-pandas-box")


def kinds(findings, kind):
    return [finding for finding in findings if finding.kind == kind]


@pytest.mark.parametrize("name", CELLS)
def test_the_urdf_of_a_payload_is_read_once_for_all_poses(name, tmp_path):
    scenario, file = linked(name, "lid", duration=0.1), tmp_path / "box_with_lid.urdf"
    file.write_text(scenario.cell.payload.links.text, encoding="utf-8")
    payload = {"kind": "links", "path": str(file), "link": "box"}
    scenario = scenario.override({"cell.payload": payload})
    file.unlink()
    arms = statics_along(scenario, reachability(scenario, poses=21)).arms
    assert all(np.isfinite(arm.load).all() for arm in arms)


@pytest.mark.parametrize("name", by_default(CELLS, "adept-anchored"))
def test_a_motion_that_leaves_the_hinge_of_a_door_is_found_by_check_and_run(name):
    if name == "adept-anchored":  # its motion begins 0.1 m from the start
        scenario = linked(name, "door", duration=0.1)
    else:
        scenario = linked(name, "door", duration=1.0, **{"motion.start_time": 0.0, "motion.duration": 1.0})
    for findings in (cp.check(scenario, poses=3), run_findings(scenario)):
        (freedom,) = kinds(findings, "freedom")
        assert freedom.severity == "error"
        assert freedom.value == 1


@pytest.mark.gate
def test_the_base_of_a_door_stands_in_the_world_where_bases_of_arms_roll():
    door = cp.Scenario.load("two-pandas-door", {"duration": 2.0, "motion.duration": 1.0, "motion.angle": 0.1})
    rolling = door.replace(cell=on_wheels(door.cell, follow="payload"))
    checked = cp.check(rolling, poses=3)
    for findings in (checked, run_findings(rolling)):
        assert [finding.severity for finding in kinds(findings, "freedom")] == ["note"]
    assert kinds(checked, "plant steps")


@pytest.mark.parametrize("name", CELLS)
def test_run_says_of_links_what_check_says(name):
    scenario = linked(name, "lid", duration=0.1)
    checked = [*payload_findings(cp.Simulation(scenario, build_controller(scenario)))]
    assert kinds(checked, "unheld link")
    before = [*run_findings(scenario)]
    assert all(finding in before for finding in checked)


@pytest.mark.parametrize("name", CELLS)
def test_a_change_of_mass_weighs_on_arms_beside_links_as_on_one_body(name):
    gravity = {"cell.gravity": [1.0, -2.0, 0.0]} if name == "adept-anchored" else {}
    one = cp.Scenario.load(name)
    still = {"duration": 1.0, "motion": {"kind": "hold", "pose": one.start.model_dump()}, **gravity}
    loads = []
    for scenario in (one.override({**still, "events": ()}), linked(name, "lid", **still)):
        event = {"kind": "payload-change", "time": 0.5, "mass": scenario.cell.payload.mass + 1.5}
        changed = scenario.override({"events": [event]})
        arms = statics_along(changed, reachability(changed, poses=5)).arms
        loads.append([arm.load[-1] - arm.load[0] for arm in arms])
    np.testing.assert_allclose(loads[1], loads[0], atol=1e-8)
    assert np.abs(loads[0]).max() > 0.1


def test_a_start_beyond_the_limits_of_a_payloads_joint_is_refused():
    scenario = linked("two-pandas-box", "lid")
    with pytest.raises(cp.CoopPinError, match=r"hinge\.start: is 9, beyond the limits -2 to 2"):
        scenario.override({"cell.payload.links.joints.hinge.start": 9.0})
