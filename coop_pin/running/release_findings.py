"""Findings of arms after a release: stability of those that hold alone, and of those that hold nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from coop_pin.base.errors import CoopPinError
from coop_pin.description.cell.cell import Cell
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
    postures of the start. Nothing where a table bears the load, and of laws without a sliding gain.

    Args:
        scenario: the scenario with its events.
    """
    known, cell = set[str](), scenario.cell
    for index, event in enumerate(scenario.events):
        if event not in scenario.grasp_events:
            continue
        plan = scenario.grasp_plan_at(event.end)
        holds = dict(zip(cell.arms, plan.holds.tolist(), strict=True))
        arms, free = ([name for name in holds if holds[name] == held] for held in (True, False))
        left = {
            f"once {name} holds nothing": _part(cell.rigid.replace(payload=_NOTHING), [name]) for name in free
        }
        if arms and free and plan.borne == 1.0:
            left[f"once {', '.join(arms)} alone hold the payload"] = _part(cell, arms)
        for when in (when for when in left if when not in known):
            for finding in _instabilities(scenario, left[when]):
                yield finding._replace(place=f"events.{index}", sentence=f"{when}: {finding.sentence}")
        known |= left.keys()


def _part(cell: Cell, arms: list[str]) -> Cell:
    """Return the cell of some of the arms, with their shares of the load."""
    kept = {name: {arm: getattr(cell, name)[arm] for arm in arms} for name in ("arms", "grasps")}
    shares = {name: c for name, c in zip(cell.arms, cell.gain_shares.tolist(), strict=True) if name in arms}
    whole = sum(shares.values())
    return cell.replace(**kept, load_shares={name: c / whole for name, c in shares.items()})


def _instabilities(scenario: Scenario, cell: Cell) -> Iterator[Finding]:
    """Yield errors of stability of the law in the cell of some arms, which press nothing."""
    gains: Any = getattr(scenario.controller, "gains", None)
    if not hasattr(gains, "sliding_gain"):
        return
    shares = zip(scenario.cell.arms, scenario.cell.gain_shares.tolist(), strict=True)
    part = sum(c for name, c in shares if name in cell.arms)
    law = scenario.controller.replace(gains=_scaled(gains, part))
    if stated := getattr(law, "arm_gains", None):
        law = law.replace(arm_gains={arm: _scaled(stated[arm], part) for arm in stated if arm in cell.arms})
    with contextlib.suppress(CoopPinError):
        rest = scenario.replace(cell=cell, controller=law, squeeze={}, events=())
        findings = stability_findings(Simulation(rest, build_controller(rest)), None)
        yield from (finding for finding in findings if finding.severity == "error")


def _scaled(gains: Any, part: float) -> Any:
    """Return gains with a part of K."""
    return gains.replace(sliding_gain=(part * np.array(gains.sliding_gain)).tolist())
