"""Check of a scenario before it runs: everything that is known of it, as findings."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.errors import ArgumentError, CoopPinError, DivergedError
from coop_pin.base.memory import free_memory
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.internal_moment import internal_moment
from coop_pin.feasibility.least_squeeze import MARGIN, least_squeeze
from coop_pin.feasibility.motion_feasibility import closure_problem, part_held, squeeze_part
from coop_pin.feasibility.reachability import Reachability, reachability
from coop_pin.feasibility.statics import (
    StaticTorques,
    force_reserve,
    loads_without_an_arm,
    statics_along,
)
from coop_pin.feasibility.table_force import TABLE_ERROR, table_force
from coop_pin.running.finding import LEFT_TO_CHECK, Finding, Findings, Kind, sorted_findings
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.admittance_stability import admittance_stability
from coop_pin.stability.closed_loop import eigenvalues
from coop_pin.stability.grasp_stability import grasp_stability
from coop_pin.stability.loop_stability import loop_stability
from coop_pin.stability.sampled_stability import motion_stability, start_stability
from coop_pin.stability.steady_errors import anchor_biases, steady_errors
from coop_pin.stability.step_size import step_stability

_LARGE_RECORD = 1e9
"""Memory of a record from which on it is a finding, bytes."""
_PATH_POSES, _LOOP_POSES = 41, 3
"""Poses at which a run looks for reach, and for stability."""
_ABOVE = 1.05
"""Factor beyond a limit of a proposed value."""


def check(
    scenario: Scenario | str | Path,
    *,
    poses: int = 401,
    bias: float = 1e-3,
    bias_turn: float = 0.0,
    load: float = 10.0,
    table_error: float = TABLE_ERROR,
) -> Findings:
    """Return what is known of a scenario before it runs: errors, likely mistakes, margins, and remedies.

    Numbers in a likely wrong unit; reach, singular poses, limits and static torques along the motion; rank of
    the closures; squeeze and table forces; stability of the plant's steps and of the law; what remains of a
    bias, of an unknown load and without an arm. Nothing is simulated. Each remedy of an error was applied:
    the error is gone then, and none of another kind has come.

    Args:
        scenario: a Scenario, a name in the catalogue, or the path of a TOML file.
        poses: number of poses looked at along the motion.
        bias: kinematic bias of one arm's tip, m.
        bias_turn: angle by which the base of one arm is off, rad.
        load: constant force on the payload that the law does not know, N.
        table_error: height by which a table on which the payload is put down may be higher than planned, m.

    Raises:
        ScenarioError: the scenario has mistakes.
        CoopPinError: an arm, the motion or the law cannot be built.
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    reach = reachability(scenario, poses=poses)
    simulation = _simulation(scenario, reach)
    entries = [*_examined(scenario, reach, simulation, table_error)]
    left = tuple[Kind, ...]()
    if simulation is None or not reach.ok:
        left = LEFT_TO_CHECK
    else:
        entries += [*_record(simulation), *_loads_without(scenario, reach)]
        if gains_are_known(scenario):
            entries += _steady(simulation, reach, bias, bias_turn, load)
    entries = _with_remedies(scenario, entries, poses, table_error)
    return Findings(scenario.name, sorted_findings(entries), left)


@typed
def quick_findings(simulation: Simulation) -> Findings:
    """Return the findings of a run before it starts, besides implausible numbers: all but ``LEFT_TO_CHECK``.

    Less of the motion is looked at than ``check`` does. What cannot be computed here fails in the run, whose
    error has its time. The closed loop is looked at where nothing faster knows the law.

    Args:
        simulation: the run before its first tick; in the end it is as it was.
    """
    scenario, start = simulation.scenario, simulation.state()
    entries = [*_record(simulation)]
    with contextlib.suppress(Exception):  # of a user's motion: the run raises it again
        entries += _forces(scenario, TABLE_ERROR)
    with contextlib.suppress(Exception):
        path = reachability(scenario, poses=_PATH_POSES)
        entries += [*_torques(scenario, statics_along(scenario, path)), *_reach(path)]
        reach = reachability(scenario, poses=_LOOP_POSES) if path.ok else None
        entries.extend(_stability(simulation, reach, along=False))
    simulation.restore(start)
    left = tuple(kind for kind in LEFT_TO_CHECK if kind not in {finding.kind for finding in entries})
    return Findings(scenario.name, sorted_findings(entries), left)


def gains_are_known(scenario: Scenario) -> bool:
    """Return whether analyses of the sampled loop know its gains and grasps.

    Not those of a user's law and of servos, nor of rigid grasps that lay a payload on a table.

    Args:
        scenario: the scenario.
    """
    cell = scenario.cell
    on_tables = bool(cell.tables) and not cell.unclosed
    return not (scenario.controller.user_code or scenario.has_servos or on_tables)


def _examined(
    scenario: Scenario, reach: Reachability, simulation: Simulation | None, table_error: float
) -> Iterator[Finding]:
    """Yield what may lose the task: all but memory, lost arms and steady errors."""
    yield from implausible_numbers(scenario)
    yield from _reach(reach)
    yield from _torques(scenario, statics_along(scenario, reach))
    yield from _forces(scenario, table_error)
    if reach.ok and (singular := closure_problem(scenario)):
        yield Finding("closure rank", "cell.grasps", "error", singular)
    if simulation is not None and reach.ok:
        yield from _stability(simulation, reach)
        if gains_are_known(scenario):
            yield from _closed_loop(scenario)
    elif simulation is not None:
        with contextlib.suppress(CoopPinError):  # of a singular start, which the reach has named
            yield from _stability(simulation, None)


def _simulation(scenario: Scenario, reach: Reachability) -> Simulation | None:
    """Return the run before its first tick; None if an arm cannot hold the start, or has too few joints."""
    if any(arm.start_error is not None or arm.joint_shortage for arm in reach.arms):
        return None
    return Simulation(scenario, build_controller(scenario) if gains_are_known(scenario) else None)


def _of(kind: Kind, field: str, report: Any, value: float, limit: float) -> Finding:
    """Return the finding of a report that has ``ok`` and ``summary``."""
    return Finding(kind, field, "note" if report.ok else "error", report.summary(), value, limit)


def _record(simulation: Simulation) -> Iterator[Finding]:
    """Yield the memory that the record of a long run takes, from 1 GB on."""
    memory = simulation.recorder.memory
    if memory >= _LARGE_RECORD:
        field = "clock.record_every"
        every = simulation.scenario.clock.record_every * math.ceil(memory / _LARGE_RECORD)
        sentence = (
            f"its record takes {1e-9 * memory:.2g} GB of memory of {1e-9 * free_memory():.3g} GB that are"
            f" free; with {field} {every} below 1 GB, and metrics and verdict remain those of all ticks"
        )
        yield Finding("record size", field, "warning", sentence, memory, _LARGE_RECORD, {field: every})


def _reach(reach: Reachability) -> Iterator[Finding]:
    """Yield why arms cannot follow, and the margins of the others."""
    for arm in reach.arms:
        for problem in arm.problems():
            yield Finding("reach", arm.arm, "error", f"arm {arm.arm!r} {problem}")
        if margins := "; ".join(arm.margins()):
            yield Finding("reach", arm.arm, "note", f"arm {arm.arm!r}: {margins}")


def _torques(scenario: Scenario, statics: StaticTorques) -> Iterator[Finding]:
    """Yield the drives that cannot hold the cell at rest, otherwise the one that is closest to its limit."""
    remedy = _lighter(scenario, statics) if statics.overloaded else {}
    for drive in statics.overloaded:
        joint = f"{drive.arm}/{drive.joint}"
        yield Finding("static torque", joint, "error", str(drive), drive.torque, drive.limit, remedy)
    if not statics.overloaded:
        worst = statics.worst
        value, limit = (math.nan, math.nan) if worst is None else (worst.torque, worst.limit)
        yield Finding("static torque", "", "note", statics.summary(), value, limit)


def _lighter(scenario: Scenario, statics: StaticTorques) -> dict[str, Any]:
    """Return the squeeze, or else the payload's mass, that the drives hold; nothing if there is none."""
    if 0.0 < (part := squeeze_part(statics)) < 1.0:
        with contextlib.suppress(CoopPinError):
            return _scaled(scenario, part)
    part = min(part_held(arm.weight, arm.load + arm.squeeze, arm.limit) for arm in statics.arms)
    mass = math.floor(1e3 * part * scenario.cell.payload.mass) / 1e3
    if mass <= 0.0:
        return {}
    with contextlib.suppress(CoopPinError):
        return {"cell.payload.mass": mass, **_scaled(scenario, part)}
    return {}


def _scaled(scenario: Scenario, part: float) -> dict[str, Any]:
    """Return the fields of a squeeze that is scaled, by dotted path; none of a squeeze of zero."""
    if not scenario.squeeze_wrenches.any():
        return {}
    return dict(_leaves("squeeze", scenario.squeeze.scaled(part).model_dump(exclude_none=True)))


def _leaves(path: str, node: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(node, dict):
        for name, part in node.items():
            yield from _leaves(f"{path}.{name}", part)
    else:
        yield path, node


def _forces(scenario: Scenario, table_error: float) -> Iterator[Finding]:
    """Yield the squeeze that friction needs, and the force on a table at a put-down."""
    if (least := least_squeeze(scenario)) is not None:
        yield _of("friction", least.arm, least, least.stated, least.force)
    if (pressed := table_force(scenario, table_error=table_error)) is not None:
        yield _of("table force", pressed.table, pressed, pressed.use, 1.0)


def _stability(simulation: Simulation, reach: Reachability | None, along: bool = True) -> Iterator[Finding]:
    """Yield the stability of the plant's steps and of the law, along the motion or for a run."""
    scenario = simulation.scenario
    steps = step_stability(simulation, reach)
    yield _of("plant steps", "clock.steps_per_tick", steps, steps.value, steps.limit)
    if scenario.has_servos and not scenario.controller.user_code:
        yield from _on_servos(scenario)
    elif not gains_are_known(scenario):
        why = "a user's law" if scenario.controller.user_code else "a law whose payload may lie on a table"
        yield Finding("loop stability", "controller", "note", f"the gains of {why} are not checked")
    elif scenario.cell.unclosed:
        grasps = grasp_stability(simulation)
        yield _of("grasp stability", "controller.gains", grasps, grasps.radius, 1.0)
        if not along and {"model", "regressor"} & {*scenario.controller.needs}:  # it knows their damping only
            yield from _closed_loop(scenario)
    else:
        is_along = along and reach is not None
        damping = motion_stability(simulation, reach) if is_along else start_stability(simulation)  # type: ignore[arg-type]
        yield _of("sampled damping", ", ".join(damping.joints), damping, damping.value, damping.limit)
        loop = loop_stability(simulation, reach)
        yield _of("loop stability", "controller.gains", loop, loop.radius, 1.0)


def _on_servos(scenario: Scenario) -> Iterator[Finding]:
    """Yield the stability of a law on servos: of an admittance in closed form, of others by differences."""
    try:
        loop = admittance_stability(scenario)
    except ArgumentError:
        yield from _closed_loop(scenario)
    else:
        yield _of("admittance stability", "controller.gains.admittance_damping", loop, loop.radius, 1.0)


def _closed_loop(scenario: Scenario) -> Iterator[Finding]:
    """Yield the stability of the whole tick by differences, at the start."""
    slot = "controller.gains"
    try:
        loop = eigenvalues(scenario)
    except (ArgumentError, DivergedError) as error:
        severity: Any = "error" if isinstance(error, DivergedError) else "note"
        yield Finding("closed loop", slot, severity, f"closed loop: {error}")
    else:
        yield _of("closed loop", slot, loop, loop.radius, 1.0)


def _loads_without(scenario: Scenario, reach: Reachability) -> Iterator[Finding]:
    """Yield arms whose loss the others do not bear: an error where the scenario plans to lose them."""
    lost = {str(getattr(event, "arm", "")) for event in scenario.events if event.kind == "lose-arm"}
    for arm, (limp, carried) in loads_without_an_arm(scenario, reach).items():
        if limp > 1.0:
            sentence = (
                f"if arm {arm!r} loses its torque, the others need {limp:.3g} times their limits, and"
                f" {carried:.3g} times if it carries its own weight: above 1 no law holds the payload"
            )
            yield Finding("lost arm", arm, "error" if arm in lost else "note", sentence, limp, 1.0)


def _steady(
    simulation: Simulation, reach: Reachability, bias: float, bias_turn: float, load: float
) -> Iterator[Finding]:
    """Yield what the law measures, and what a bias and an unknown load leave."""
    scenario = simulation.scenario
    law: Any = scenario.controller
    if not scenario.cell.controls_turns and "holding torque" in law.needs:
        moment = internal_moment(scenario, reach, law.posture)
        yield Finding("internal moment", moment.arm, "note", moment.summary(), moment.moment)
    errors, slot = steady_errors(scenario, bias=bias, load=load), "controller"
    yield Finding("steady error", slot, "note", errors.summary())
    if scenario.network is not None:
        traffic = simulation.traffic().summary(scenario.clock.rate_hz)
        yield Finding("steady error", "network", "note", traffic)
    reserve = force_reserve(scenario, reach) if errors.growth > 0.0 else math.inf
    if math.isfinite(reserve):  # drives without limits have no end of it
        earliest = max(0.0, reserve) / errors.growth
        sentence = f"the force that grows is beyond the first drive {earliest:.3g} s later or after"
        yield Finding("steady error", slot, "note", sentence, earliest)
    if math.isfinite(errors.free):
        needed = ", ".join(
            f"{arm} {1e3 * position:.3g} mm and {1e3 * angle:.3g} mrad"
            for arm, (position, angle) in anchor_biases(scenario, bias, bias_turn).items()
        )
        sentence = f"anchor_bias for this bias of an arm whenever it begins: {needed}"
        yield Finding("steady error", "controller.anchor_bias", "note", sentence)


# ------------------------------------------------------------ remedies


def _with_remedies(
    scenario: Scenario, entries: list[Finding], poses: int, table_error: float
) -> list[Finding]:
    """Return findings, each error with the first change that cures it and brings no error of another kind."""
    kinds, cures = {finding.kind for finding in entries if finding.severity == "error"}, list[_Cure]()

    def cure(finding: Finding) -> Finding:
        if finding.severity != "error" or finding.remedy:
            return finding
        tried = (_cure(scenario, changes, poses, table_error) for changes in _candidates(scenario, finding))
        for changes, after in itertools.chain(tuple(cures), tried):
            cures.append(_Cure(changes, after))
            if finding.kind not in after and after <= kinds:
                return finding._replace(remedy=changes)
        return finding

    return [cure(finding) for finding in entries]


class _Cure(NamedTuple):
    """Changes of a scenario, and the kinds of error that it has then."""

    changes: dict[str, Any]
    after: set[Kind]


def _cure(scenario: Scenario, changes: dict[str, Any], poses: int, table_error: float) -> _Cure:
    with contextlib.suppress(CoopPinError):
        changed = scenario.override(changes)
        reach = reachability(changed, poses=poses)
        findings = _examined(changed, reach, _simulation(changed, reach), table_error)
        return _Cure(changes, {finding.kind for finding in findings if finding.severity == "error"})
    return _Cure(changes, {*get_args(Kind)})


def _candidates(scenario: Scenario, finding: Finding) -> Iterator[dict[str, Any]]:
    """Yield changes that may cure an error, the smallest first."""
    clock, law = scenario.clock, scenario.controller
    gains: Any = getattr(law, "gains", None)
    if finding.kind == "plant steps":
        yield {
            "clock.steps_per_tick": math.ceil(_ABOVE * clock.steps_per_tick * finding.value / finding.limit)
        }
    elif finding.kind == "friction":
        if finding.value > 0.0:
            yield _scaled(scenario, MARGIN * finding.limit / finding.value)
    elif finding.kind == "table force":
        gain = np.array(gains.sliding_gain)
        yield from ({"controller.gains.sliding_gain": (part * gain).tolist()} for part in (0.9, 0.75, 0.5))
    elif finding.kind == "admittance stability":
        factor = _ABOVE * admittance_stability(scenario).least
        damping = factor * np.array(gains.admittance_damping)
        yield {"controller.gains.admittance_damping": np.ceil(damping).tolist()}
    elif finding.kind in ("sampled damping", "loop stability", "grasp stability", "closed loop"):
        yield from _calmer(scenario, finding)


def _calmer(scenario: Scenario, finding: Finding) -> Iterator[dict[str, Any]]:
    """Yield a stiffer spring of spare joints, where that is asked for, and higher rates."""
    rate, spring = scenario.clock.rate_hz, scenario.controller.spare_spring
    if finding.kind == "loop stability" and spring and f"Raise {spring}" in finding.sentence:
        node: Any = scenario
        for part in spring.split("."):
            node = getattr(node, part)
        if np.ndim(node) == 0:
            yield from ({spring: factor * float(node)} for factor in (2.0, 4.0, 8.0))
    if finding.kind == "sampled damping" and math.isfinite(finding.value):
        yield {"clock.rate_hz": float(math.ceil(_ABOVE * rate * finding.value / finding.limit))}
    yield from ({"clock.rate_hz": factor * rate} for factor in (2.0, 4.0))
