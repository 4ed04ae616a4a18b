"""Findings of arms after a release: stability of those that hold alone, and of those that hold nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from coop_pin.base.errors import CoopPinError
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.results.finding import Finding
from coop_pin.running.cell_findings import stability_findings
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

_NOTHING = Payload(mass=1e-6, inertia=(1e-9, 1e-9, 1e-9, 0.0, 0.0, 0.0))
"""Payload of an arm that holds nothing."""


def release_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield what makes arms unstable after an event: those that hold alone, and each that holds nothing.

    The gains of an arm are its part c_i of those of the law, however many hold; they are looked at in the
    postures of the start. Nothing where a table bears the load, of laws without a sliding gain, and of cells
    that need all of their arms.

    Args:
        scenario: the scenario with its events.
    """
    cell, known = scenario.cell, set[str]()
    if cell.tools or not hasattr(getattr(scenario.controller, "gains", None), "sliding_gain"):
        return
    for index, event in enumerate(scenario.events):
        if event not in scenario.grasp_events:
            continue
        plan = scenario.grasp_plan_at(event.end)
        holds = dict(zip(cell.arms, plan.holds.tolist(), strict=True))
        arms, free = ([name for name in holds if holds[name] == held] for held in (True, False))
        parts = [(f"once {name} holds nothing", [name], _NOTHING) for name in free]
        if arms and free and plan.borne == 1.0:
            parts.append((f"once {', '.join(arms)} alone hold the payload", arms, cell.payload))
        for when, group, payload in parts:
            if when not in known:
                known.add(when)
                for finding in _instabilities(scenario, group, payload):
                    yield finding._replace(place=f"events.{index}", sentence=f"{when}: {finding.sentence}")


def _instabilities(scenario: Scenario, arms: list[str], payload: Payload) -> Iterator[Finding]:
    """Yield errors of stability of the law in the cell of some arms, which press nothing."""
    cell, law = scenario.cell, cast(Any, scenario.controller)
    shares = {name: c for name, c in zip(cell.arms, cell.gain_shares.tolist(), strict=True) if name in arms}
    if not (part := sum(shares.values())):
        return
    with contextlib.suppress(CoopPinError):
        tables = ("arms", "grasps", "pads")
        grasped = cell if payload is cell.payload else cell.rigid
        kept: dict[str, Any] = {
            name: {arm: held for arm, held in getattr(grasped, name).items() if arm in arms}
            for name in tables
        }
        kept["load_shares"] = {name: c / part for name, c in shares.items()}
        law = law.replace(gains=_scaled(law.gains, part))
        if stated := getattr(law, "arm_gains", None):
            law = law.replace(arm_gains={arm: _scaled(stated[arm], part) for arm in stated if arm in arms})
        cell = grasped.replace(**kept, payload=payload)
        rest = scenario.replace(cell=cell, controller=law, squeeze={}, events=())
        findings = stability_findings(Simulation(rest, build_controller(rest)), None)
        yield from (finding for finding in findings if finding.severity == "error")


def _scaled(gains: Any, part: float) -> Any:
    """Return gains with a part of K."""
    return gains.replace(sliding_gain=(part * np.array(gains.sliding_gain)).tolist())
