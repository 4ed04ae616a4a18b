"""Proposal of gains for admittance and object impedance: the first ones with which the closed loop holds."""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.results.finding import Kind
from coop_pin.running.check import check

_LEVER = 0.02
"""Gain of a rotation for one of a position, m^2."""
_FACTORS = (1.0, 2.0, 4.0, 8.0)
"""Factors of the gains that are tried."""
_STABILITY: tuple[Kind, ...] = (
    "sampled damping",
    "loop stability",
    "grasp stability",
    "admittance stability",
    "closed loop",
)
_POSES = 21
LAWS = ("admittance", "object-impedance")
"""Laws whose gains are proposed besides those of the payload-space law."""


def with_stable_gains(scenario: Scenario) -> Scenario | None:
    """Return the scenario with gains of its law with which no check of stability fails; None without any.

    ::

        admittance          D = s (1000, 20),  gamma = 5 /s,  l = 20 /s
        object impedance    M_d = s (20, 0.4),  D = s (400, 8),  K = s (2000, 40)

    for positions and rotations, with the first s of 1, 2, 4 and 8. Other gains are as stated.

    Args:
        scenario: Scenario with one of ``LAWS``.
    """
    law: Any = scenario.controller
    unit = np.where(scenario.cell.task_rows.are_linear, 1.0, _LEVER)
    for factor in _FACTORS:
        gains = law.gains.replace(**_gains(law.kind, factor * unit))
        changed = scenario.replace(controller=law.replace(gains=gains))
        if not any(finding.kind in _STABILITY for finding in check(changed, poses=_POSES).of("error")):
            return changed
    return None


def _gains(kind: str, unit: Array) -> dict[str, Any]:
    """Return the gains of a law by name; unit is a gain for each task row."""
    rows = {"inertia": 20.0, "damping": 400.0, "stiffness": 2000.0}
    if kind == "object-impedance":
        return {name: tuple((value * unit).tolist()) for name, value in rows.items()}
    return {"admittance_damping": tuple((1e3 * unit).tolist()), "pose_gain": 5.0, "admittance_rate": 20.0}
