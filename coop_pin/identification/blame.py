"""``cp.blame``: who pulls the object apart, from a record of arms: ranked causes with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, as_array, require_type
from coop_pin.base.errors import ArgumentError
from coop_pin.description.scenario import Scenario
from coop_pin.identification.answer import Blame
from coop_pin.identification.closure import ViewClosure, grasp_springs
from coop_pin.identification.estimate import Fit, Priors
from coop_pin.identification.filtering import filtered
from coop_pin.identification.friction import DriveFriction, friction_fit
from coop_pin.identification.misuse import kinematic_findings, prior_findings, wrench_findings
from coop_pin.identification.newtons import newtons
from coop_pin.identification.payload import payload_fit
from coop_pin.logs.findings import log_findings
from coop_pin.logs.record import Record
from coop_pin.model.cell_arm import CellArm
from coop_pin.results.finding import Finding, Findings, sorted_findings
from coop_pin.results.run_result import RunResult

_BELIEVED = 1.1
"""chi up to which noise and priors explain the residual."""
_LEFT, _LEAST = 0.5, 0.3
"""Part of what the wrists read, and force, N, that may be left unexplained."""


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
        log: record, run, or path of a CSV file, an MCAP file, a result or the folder of a run.
        scenario: cell and law that ran, as its user believes them, with the table ``log``; of a run its own
            when omitted.
        priors: knowledge before the log; usual sizes when omitted.

    Raises:
        FileReadError: the file is missing or damaged, or has no such topic.
        ArgumentError: there is no scenario, grasps are joints, shared joints move, or no view may be off.
        ScenarioError: the scenario has mistakes.
    """
    record, scenario = _read(log, scenario)
    _require_views(scenario)
    priors = priors or Priors()
    require_type("priors", priors, Priors)
    _require_sizes(priors)
    arms = {name: CellArm(scenario.cell, name) for name in scenario.cell.arms}
    noted = [*log_findings(record, scenario)]
    if not any(one.severity == "error" for one in noted):
        noise, springs = _stated_noise(scenario, arms), grasp_springs(scenario)
        closure = ViewClosure(record, arms, priors, noise=noise, springs=springs)
        noted += kinematic_findings(closure, record)
    if any(one.severity == "error" for one in noted):
        return Blame(scenario, record, Findings(scenario.name, sorted_findings(noted)))
    kinematics = closure.fit()
    samples = filtered(record, kinematics.late, springs=closure.deflections)
    payload, friction = None, list[DriveFriction]()
    if all(len(record.arms[name].wrench_time) for name in arms):
        payload = payload_fit(record, scenario, closure, kinematics, samples, priors)
        noted += wrench_findings(payload, record, scenario, closure, kinematics, samples, priors)
        for name, arm in arms.items():
            zeros = payload.of(name, "wrist")
            friction += friction_fit(arm, samples[name], payload.x[zeros], payload.sd[zeros])
    noted += prior_findings(kinematics, payload)
    answer = newtons(closure, record, scenario, kinematics, payload, friction, samples, priors)
    noted += _trust(kinematics, payload, answer)
    findings = Findings(scenario.name, sorted_findings(noted))
    if not findings.ok:
        return Blame(scenario, record, findings)
    return Blame(scenario, record, findings, closure, kinematics, payload, tuple(friction), **answer)


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
    if scenario.log is not None and scenario.log.shares:
        scenario = scenario.override({"cell.load_shares": scenario.log.shares, "log.shares": {}})
    if isinstance(log, RunResult):
        return Record.of_run(log), scenario
    if isinstance(log, str | Path):
        return Record.load(log, scenario), scenario
    require_type("log", log, Record)
    return log, scenario


def _require_views(scenario: Scenario) -> None:
    """Refuse cells of one arm, and those whose arms do not see the payload by their joints alone."""
    cell = scenario.cell
    if len(cell.arms) < 2:
        raise ArgumentError(
            "blame compares the views that arms have of the payload, and the cell has one arm"
        )
    moving = [name for name, joint in cell.shared_joints.items() if joint.follow != "hold"]
    moving += [f"{name}.mobile_base" for name in cell.wheels]
    for names, detail in (
        (list(cell.jointed), "grasps of {} are joints, whose turn no log has"),
        (list(cell.tools), "tips of {} are tools beside it"),
        (list(cell.payload.links.start) if cell.payload.links else [], "the payload has joints {}"),
        (moving, "the shared joints {} move, and the record of arms does not have them"),
    ):
        if names:
            raise ArgumentError(
                f"blame compares the views that arms have of the payload, but {detail.format(names)}; log"
                " a motion with rigid grasps and shared joints that hold"
            )


def _stated_noise(scenario: Scenario, arms: Mapping[str, CellArm]) -> dict[str, Array] | None:
    """Return the noise of the drive positions by the sensors of a scenario; None where none is stated."""
    noise = {}
    for name, arm in arms.items():
        encoder = scenario.sensors_of(name).encoder
        sd = np.hypot(np.array(encoder.resolution) / np.sqrt(12.0), np.array(encoder.noise))
        if not np.any(sd):
            return None
        noise[name] = np.broadcast_to(sd, arm.nv)
    return noise


def _trust(kinematics: Fit, payload: Fit | None, answer: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield residuals beyond those of noise, which widen intervals, and a law that explains too little."""
    fits = {"the views of the arms": kinematics} | (
        {} if payload is None else {"the sum of the wrenches": payload}
    )
    for name, fit in fits.items():
        if fit.chi > _BELIEVED:
            sentence = f"chi of {name} is {fit.chi:.2f}, beyond {_BELIEVED}: intervals are wider by it"
            yield Finding("log", "", "warning", sentence, fit.chi, _BELIEVED)
    left, most = answer.get("unexplained", 0.0), max(_LEFT * answer.get("read", 0.0), _LEAST)
    if left > most:
        sentence = (
            f"causes leave {left:.2f} of the {answer['read']:.2f} N that the wrists read: the law, its"
            " gains or its squeeze is another one, or drives are at their limits"
        )
        yield Finding("log", "controller", "warning", sentence, left, most)


def _require_sizes(priors: Priors) -> None:
    for name, usual in Priors()._asdict().items():
        sizes = as_array(f"priors.{name}", getattr(priors, name), *np.shape(usual))
        if (sizes < 0.0).any():
            raise ArgumentError(f"priors.{name} is {sizes.tolist()}; it must not be negative")
    of_views = ("tip", "base", "joint", "link", "clock")
    if not any(np.any(getattr(priors, name)) for name in of_views):
        raise ArgumentError(
            f"priors of {', '.join(of_views)} are all 0: no view may be off; give one of them"
        )
