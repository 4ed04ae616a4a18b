"""``cp.blame``: who pulls the object apart, from a record of arms: ranked causes with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import ArgumentError
from coop_pin.description.scenario import Scenario
from coop_pin.identification.causes import Cause, force_interval, ranked_causes
from coop_pin.identification.closure import Fit, Parameter, Priors, ViewClosure
from coop_pin.identification.effects import Effects, effects
from coop_pin.identification.filtering import Filtered, filtered
from coop_pin.identification.friction import DriveFriction, friction_fit
from coop_pin.identification.law_response import LawResponse, uncovered
from coop_pin.identification.misuse import kinematic_findings, prior_findings, wrench_findings
from coop_pin.identification.payload import payload_fit
from coop_pin.logs.log_findings import log_findings
from coop_pin.logs.record import Record
from coop_pin.model.cell_arm import CellArm
from coop_pin.results.finding import Finding, Findings, sorted_findings
from coop_pin.results.run_result import RunResult

_FLOOR = 0.02
"""Forces below it are left out of the summary, N."""
_BELIEVED = 1.1
"""chi up to which noise and priors explain the residual."""


@dataclass(frozen=True, eq=False)
class Blame:
    """Answer to who pulls the object apart.

    Attributes:
        scenario: cell and law.
        record: what the arms logged.
        findings: what is wrong with the log, or doubtful; after an error there are no estimates.
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


def blame(
    log: Record | RunResult | str | Path,
    scenario: Scenario | str | Path | None = None,
    *,
    priors: Priors | None = None,
) -> Blame:
    """Return who pulls the object apart: which parameter, by how many newtons, with intervals.

    Views of the payload by all arms, the sum of their wrenches and their torques are fitted with priors. The
    newtons of a cause are those under the law of the scenario, linear along the record.

    Args:
        log: record, run, or path of a CSV file, an MCAP file or a result.
        scenario: cell and law that ran, as its user believes them, with the table ``log``; of a run its own
            when omitted.
        priors: what is known before; usual sizes when omitted.

    Raises:
        FileReadError: the file is missing or damaged, or has no such topic.
        ArgumentError: there is no scenario.
        ScenarioError: the scenario has mistakes.
    """
    record, scenario = _read(log, scenario)
    priors = priors or Priors()
    require_type("priors", priors, Priors)
    arms = {name: CellArm(scenario.cell, name) for name in scenario.cell.arms}
    found = [*log_findings(record, scenario)]
    if not any(one.severity == "error" for one in found):
        closure = ViewClosure(record, arms, priors, noise=_stated_noise(scenario, arms))
        found += kinematic_findings(closure, record)
    if any(one.severity == "error" for one in found):
        return Blame(scenario, record, Findings(scenario.name, sorted_findings(found)))
    kinematics = closure.fit()
    late = {
        one.arm: float(kinematics.x[k]) for k, one in enumerate(kinematics.parameters) if one.part == "clock"
    }
    samples, payload, friction = filtered(record, late), None, list[DriveFriction]()
    if all(len(record.arms[name].wrench_time) for name in arms):
        payload = payload_fit(record, scenario, arms, samples, priors)
        found += wrench_findings(payload, record, scenario, arms, samples, priors)
        for name, arm in arms.items():
            zeros = payload.of(name, "wrist")
            friction += friction_fit(arm, samples[name], payload.x[zeros], payload.sd[zeros])
    found += prior_findings(kinematics, payload)
    answer = _answer(closure, record, scenario, kinematics, payload, friction, samples)
    findings = Findings(scenario.name, sorted_findings([*found, *_trust(kinematics, payload)]))
    if not findings.ok:
        return Blame(scenario, record, findings)
    return Blame(scenario, record, findings, kinematics, payload, tuple(friction), **answer)


def _read(log: Any, scenario: Any) -> tuple[Record, Scenario]:
    if isinstance(log, str | Path) and Path(log).suffix not in (".csv", ".mcap"):
        log = RunResult.load(log)
    if isinstance(log, RunResult):
        scenario = log.scenario if scenario is None else scenario
    if isinstance(scenario, str | Path):
        scenario = Scenario.load(scenario)
    if scenario is None:
        raise ArgumentError("a log or a record needs its scenario: the cell and the law that ran")
    require_type("scenario", scenario, Scenario)
    if isinstance(log, RunResult):
        return Record.of_run(log), scenario
    if isinstance(log, str | Path):
        return Record.load(log, scenario), scenario
    require_type("log", log, Record)
    return log, scenario


def _stated_noise(scenario: Scenario, arms: Mapping[str, CellArm]) -> dict[str, Array] | None:
    """Return the noise of the joint positions by the sensors of a scenario; None where none is stated."""
    noise = {}
    for name, arm in arms.items():
        encoder = scenario.sensors_of(name).encoder
        sd = np.hypot(np.array(encoder.resolution) / np.sqrt(12.0), np.array(encoder.noise))
        if not np.any(sd):
            return None
        noise[name] = np.sqrt(arm.from_drive**2 @ np.broadcast_to(sd, arm.nv) ** 2)
    return noise


def _answer(
    closure: ViewClosure,
    record: Record,
    scenario: Scenario,
    kinematics: Fit,
    payload: Fit | None,
    friction: list[DriveFriction],
    samples: Mapping[str, Filtered],
) -> dict[str, Any]:
    """Return effects, causes and what they leave, as fields of Blame."""
    if reason := uncovered(scenario):
        return {"uncovered": reason}
    c = _shares(scenario)
    kept = [] if payload is None else [k for k, one in enumerate(payload.parameters) if one.part == "wrist"]
    rows = {"xyz"[k] if k < 3 else ("rx", "ry", "rz")[k - 3] for k in closure.rows.indices}
    kept = [k for k in kept if payload is not None and payload.parameters[k].axis in rows]
    seen = [one for one in friction if one.is_seen]
    wrists = [payload.parameters[k] for k in kept] if payload is not None else []
    parameters: list[Parameter] = [*kinematics.parameters, *wrists]
    grasps = scenario.cell.grasps
    made = effects(
        record,
        closure,
        LawResponse.of(scenario, c),
        parameters,
        seen,
        lambda t: scenario.squeeze.at(t, grasps),
    )
    p, n = len(kinematics.x), len(made.parameters)
    x, covariance = np.zeros(n), np.zeros((n, n))
    x[:p], covariance[:p, :p] = kinematics.x, kinematics.covariance
    if payload is not None:
        w = slice(p, p + len(kept))
        x[w], covariance[w, w] = payload.x[kept], payload.covariance[np.ix_(kept, kept)]
    for k, one in enumerate(seen, p + len(kept)):  # a factor of the friction that was found
        x[k] = 1.0
        covariance[k, k] = min(one.sd[1] / max(abs(one.coulomb), 1e-9), 1.0) ** 2
    answer: dict[str, Any] = {"effects": made, "causes": ranked_causes(made, x, covariance)}
    answer["views"] = force_interval(made.force[..., :p], x[:p], covariance[:p, :p])
    if payload is not None:
        answer |= _left(made, x, scenario, closure, samples, c)
    return answer


def _shares(scenario: Scenario) -> Array:
    """Return the load shares that the law ran with, shape (m,)."""
    stated = {} if scenario.log is None else scenario.log.shares
    return (
        np.array([stated[name] for name in scenario.cell.arms]) if stated else np.array(scenario.cell.shares)
    )


def _left(
    made: Effects,
    x: Array,
    scenario: Scenario,
    closure: ViewClosure,
    samples: Mapping[str, Filtered],
    c: Array,
) -> dict[str, float]:
    """Return what the wrists read of the internal force beyond its causes, and what other shares make."""
    names, grasps = [*closure.arms], scenario.cell.grasps
    law: Any = scenario.controller
    first = samples[names[0]]
    R = closure.view(names[0], first.time).pose[:, :3, :3]
    force = np.array(
        [R @ closure.arms[name].X_PE[:3, :3] @ samples[name].wrench[:, :3, None] for name in names]
    )
    force = np.moveaxis(force[..., 0], 0, 1)[:, :, [k for k in closure.rows.indices if k < 3]]
    total = force.sum(axis=1, keepdims=True)
    f_d = np.array([scenario.squeeze.at(time, grasps)[:, :3] for time in first.time.tolist()])
    f_d = np.einsum("nij,naj->nai", R, f_d)[:, :, [k for k in closure.rows.indices if k < 3]]
    read = force - c[:, None] * total - f_d
    predicted = np.tensordot(made.reading, x, 1)
    expected = np.array(
        [
            [np.interp(first.time, made.times, row) for row in of_arm]
            for of_arm in np.moveaxis(predicted, 0, 2)
        ]
    )
    settled = first.time > first.time[0] + 3.0 / law.gains.transient_rate
    left = (read - np.moveaxis(expected, 2, 0))[settled]
    noise = sum((samples[name].noise[:3] ** 2).sum() for name in names) / 4.0
    off = float(np.abs(c - np.array(scenario.cell.shares)).max())
    rms = float((left**2).sum(axis=2).max(axis=1).mean())
    return {
        "unexplained": float(np.sqrt(max(rms - float(noise), 0.0))),
        "share": off * float(np.linalg.norm(total, axis=2).mean()),
    }


def _trust(kinematics: Fit, payload: Fit | None) -> list[Finding]:
    """Return whether the residuals are those of noise; what exceeds it has widened the intervals."""
    fits = {"the views of the arms": kinematics} | (
        {} if payload is None else {"the sum of the wrenches": payload}
    )
    return [
        Finding(
            "log",
            "",
            "warning",
            f"chi of {name} is {fit.chi:.2f}, beyond {_BELIEVED}: intervals are wider by it",
            fit.chi,
            _BELIEVED,
        )
        for name, fit in fits.items()
        if fit.chi > _BELIEVED
    ]
