"""Findings of the arms that hold the payload alone once others let go: stability of what is left."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from coop_pin.base.errors import CoopPinError
from coop_pin.description.scenario import Scenario
from coop_pin.results.finding import Finding
from coop_pin.running.cell_findings import stability_findings
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation


def release_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield what makes the arms unstable that hold the payload alone after an event, at the start's postures.

    Nothing where a table bears the load, nor of laws and cells that cannot be built with these arms alone.

    Args:
        scenario: the scenario with its events.
    """
    known = set[tuple[str, ...]]()
    for index, event in enumerate(scenario.events):
        if event not in scenario.grasp_events:
            continue
        plan = scenario.grasp_plan_at(event.end)
        arms = tuple(name for name, holds in zip(scenario.cell.arms, plan.holds, strict=True) if holds)
        if not 0 < len(arms) < len(plan.holds) or arms in known or plan.borne < 1.0:
            continue
        known.add(arms)
        with contextlib.suppress(CoopPinError):
            rest = _held_by(scenario, arms)
            for finding in stability_findings(Simulation(rest, build_controller(rest)), None):
                if finding.severity == "error":
                    sentence = f"once {', '.join(arms)} alone hold the payload: {finding.sentence}"
                    yield finding._replace(place=f"events.{index}", sentence=sentence)


def _held_by(scenario: Scenario, arms: tuple[str, ...]) -> Scenario:
    """Return the scenario with some of its arms, which share the load alike and press nothing."""
    cell, law = scenario.cell, scenario.controller
    kept = {name: {arm: getattr(cell, name)[arm] for arm in arms} for name in ("arms", "grasps")}
    if stated := getattr(law, "arm_gains", None):
        law = law.replace(arm_gains={arm: gains for arm, gains in stated.items() if arm in arms})
    cell = cell.replace(**kept, load_shares=None)
    return scenario.replace(cell=cell, controller=law, squeeze={}, events=())
