"""``cp.blame``: who pulls the object apart, from a record of arms: ranked causes with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import ArgumentError
from coop_pin.description.scenario import Scenario
from coop_pin.identification.answer import Blame
from coop_pin.identification.causes import force_interval, ranked_causes
from coop_pin.identification.closure import Fit, Parameter, Priors, ViewClosure
from coop_pin.identification.effects import Effects, effects
from coop_pin.identification.filtering import Filtered, filtered
from coop_pin.identification.friction import DriveFriction, friction_fit
from coop_pin.identification.law_response import LawResponse, uncovered
from coop_pin.identification.misuse import kinematic_findings, prior_findings, wrench_findings
from coop_pin.identification.payload import payload_fit
from coop_pin.logs.findings import log_findings
from coop_pin.logs.record import Record
from coop_pin.model.cell_arm import CellArm
from coop_pin.results.finding import Finding, Findings, sorted_findings
from coop_pin.results.run_result import RunResult

_BELIEVED = 1.1
"""chi up to which noise and priors explain the residual."""


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
        priors: knowledge before the log; usual sizes when omitted.

    Raises:
        FileReadError: the file is missing or damaged, or has no such topic.
        ArgumentError: there is no scenario, grasps are joints, or shared joints move.
        ScenarioError: the scenario has mistakes.
    """
    record, scenario = _read(log, scenario)
    _require_views(scenario)
    priors = priors or Priors()
    require_type("priors", priors, Priors)
    arms = {name: CellArm(scenario.cell, name) for name in scenario.cell.arms}
    noted = [*log_findings(record, scenario)]
    if not any(one.severity == "error" for one in noted):
        closure = ViewClosure(record, arms, priors, noise=_stated_noise(scenario, arms))
        noted += kinematic_findings(closure, record)
    if any(one.severity == "error" for one in noted):
        return Blame(scenario, record, Findings(scenario.name, sorted_findings(noted)))
    kinematics = closure.fit()
    late = {
        one.arm: float(kinematics.x[k]) for k, one in enumerate(kinematics.parameters) if one.part == "clock"
    }
    samples, payload, friction = filtered(record, late), None, list[DriveFriction]()
    if all(len(record.arms[name].wrench_time) for name in arms):
        payload = payload_fit(record, scenario, closure, kinematics, samples, priors)
        noted += wrench_findings(payload, record, scenario, closure, kinematics, samples, priors)
        for name, arm in arms.items():
            zeros = payload.of(name, "wrist")
            friction += friction_fit(arm, samples[name], payload.x[zeros], payload.sd[zeros])
    noted += prior_findings(kinematics, payload)
    answer = _answer(closure, record, scenario, kinematics, payload, friction, samples)
    findings = Findings(scenario.name, sorted_findings([*noted, *_trust(kinematics, payload)]))
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


def _require_views(scenario: Scenario) -> None:
    """Refuse cells whose arms do not see the payload by their joints alone."""
    cell = scenario.cell
    moving = [name for name, joint in cell.shared_joints.items() if joint.follow != "hold"]
    for names, detail in (
        (list(cell.jointed), "grasps of {} are joints, whose turn no log has"),
        (moving, "the shared joints {} move, and the record of arms does not have them"),
    ):
        if names:
            raise ArgumentError(
                f"blame compares the views that arms have of the payload, but {detail.format(names)}; log"
                " a motion with rigid grasps and shared joints that hold"
            )


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
