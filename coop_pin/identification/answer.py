"""Answer to who pulls the object apart: estimates, causes, what they leave, and the correction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coop_pin.description.scenario import Scenario
from coop_pin.identification.causes import Cause
from coop_pin.identification.closure import Fit
from coop_pin.identification.effects import Effects
from coop_pin.identification.friction import DriveFriction
from coop_pin.logs.record import Record
from coop_pin.model.cell_arm import CellArm
from coop_pin.results.finding import Findings

_FLOOR = 0.02
"""Forces below it are left out of the summary, N."""


@dataclass(frozen=True, eq=False)
class Blame:
    """Answer to who pulls the object apart.

    Attributes:
        scenario: cell and law.
        record: log of the arms.
        findings: defects of the log; after an error there are no estimates.
        kinematics: estimates of tips, bases, joints, links and clocks; None after an error.
        payload: estimates of the payload and of the wrists' zeros; None without wrenches.
        friction: friction of the drives whose torques are logged.
        effects: forces by unit errors; None where no formula covers the law.
        causes: causes by newtons, the largest first.
        views: newtons of all kinematic errors together, which the mismatch of the views shows, with interval.
        unexplained: force that the wrists read and no cause explains, root mean square, N; NaN without it.
        share: newtons by which the law's shares part the load otherwise than those of the cell.
        uncovered: why no newtons are known; empty if they are.
    """

    scenario: Scenario
    record: Record
    findings: Findings
    kinematics: Fit | None = None
    payload: Fit | None = None
    friction: tuple[DriveFriction, ...] = ()
    effects: Effects | None = None
    causes: tuple[Cause, ...] = ()
    views: tuple[float, float, float] = (np.nan,) * 3
    unexplained: float = np.nan
    share: float = 0.0
    uncovered: str = ""

    @property
    def correction(self) -> dict[str, Any]:
        """Changes of the scenario with which a run has the errors of the log, by dotted path.

        What the log does not tell apart has the likeliest values: their sum counts.
        """
        changes: dict[str, Any] = {}
        for name in self.scenario.cell.arms if self.kinematics is not None else ():
            tip, base, joint, link = (
                _values(self.kinematics, name, part) for part in ("tip", "base", "joint", "link")
            )
            error: dict[str, Any] = {
                "tip": {"xyz": _row(tip, "xyz"), "rpy": _row(tip, ("rx", "ry", "rz"))},
                "base": {"xyz": _row(base, "xyz"), "rpy": _row(base, ("rx", "ry", "rz"))},
            }
            joints = [
                one.removeprefix("arm/") for one in CellArm(self.scenario.cell, name).limits.joints.names
            ]
            error |= {"joint_offset": _row(joint, joints), "link_length": _row(link, joints)}
            changes[f"cell.arms.{name}.calibration_error"] = error
            if self.payload is not None:
                zero = _values(self.payload, name, "wrist")
                sensors = self.scenario.sensors_of(name).model_dump(exclude_none=True)
                offset = {"force": _row(zero, "xyz"), "moment": _row(zero, ("rx", "ry", "rz"))}
                changes[f"arm_sensors.{name}"] = sensors | {
                    "wrist": sensors.get("wrist", {}) | {"offset": offset}
                }
        return changes

    def corrected(self) -> Scenario:
        """Return the scenario whose arms have the errors of the log, for ``cp.run``."""
        return self.scenario.override(self.correction)

    def summary(self) -> str:
        """Return the answer as text: findings, causes by newtons, what is not told apart, and trust."""
        lines = [f"{'!' if one.severity != 'note' else ' '} {one}" for one in self.findings]
        if self.kinematics is None:
            return "\n".join(["no answer:", *lines])
        lines.append(
            f"views of the arms: chi {self.kinematics.chi:.2f} with tips, bases, joints and clocks fitted"
        )
        if self.payload is not None:
            mass = self.payload.x[0] + self.scenario.cell.payload.mass
            lines.append(
                f"payload {mass:.3f} kg +- {1.96 * self.payload.sd[0]:.3f}; chi {self.payload.chi:.2f}"
            )
        if self.uncovered:
            lines.append(f"newtons are not known: {self.uncovered}")
        else:
            low, high = self.views[1:]
            lines.append("internal force by cause, norm, mean over the log (95 %):")
            lines.append(
                f"  {self.views[0]:6.2f} N ({low:.2f} to {high:.2f})  all that the arms see differently"
            )
            shown = [cause for cause in self.causes if cause.newtons > _FLOOR or cause.high > 10.0 * _FLOOR]
            lines += [f"  {cause}{_words(cause)}" for cause in shown]
            if self.share:
                lines.append(f"  {self.share:6.2f} N  load shares of the law, against those of the cell")
            if np.isfinite(self.unexplained):
                lines.append(f"  {self.unexplained:6.2f} N  read by the wrists and not explained")
        return "\n".join(lines)


def _words(cause: Cause) -> str:
    """Return what the log says of a cause, as text."""
    if len(cause.members) == 1:
        return "" if cause.is_known else "; the log does not see it, its prior does"
    if not cause.is_known:
        return "; the log does not see them, their priors do"
    return ": not told apart, only what they make together"


def _values(fit: Fit | None, arm: str, part: str) -> dict[str, float]:
    if fit is None:
        return {}
    return {fit.parameters[k].axis: float(fit.x[k]) for k in fit.of(arm, part)}


def _row(values: Mapping[str, float], axes: Any) -> list[float]:
    return [values.get(axis, 0.0) for axis in axes]
