"""Check of a scenario before it runs: everything that is known of it, as findings with remedies."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.errors import CoopPinError
from coop_pin.base.schema.user_code import code_of, require_allowed
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.carried_motion import seen_by_arms
from coop_pin.feasibility.least_squeeze import MARGIN
from coop_pin.feasibility.motion_feasibility import part_held, squeeze_part, with_best_postures
from coop_pin.feasibility.reachability import reachability
from coop_pin.feasibility.statics import StaticTorques, statics_along
from coop_pin.feasibility.table_force import TABLE_ERROR
from coop_pin.results.finding import LEFT_TO_CHECK, Finding, Findings, Kind, sorted_findings
from coop_pin.running.carrier_findings import carrier_findings
from coop_pin.running.cell_findings import (
    code_findings,
    distance_findings,
    force_findings,
    freedom_findings,
    gains_are_known,
    lost_arm_findings,
    prepared_run,
    reach_findings,
    record_findings,
    stability_findings,
    steady_findings,
    task_findings,
    torque_findings,
)
from coop_pin.running.payload_findings import payload_findings
from coop_pin.running.plausibility import implausible_numbers, tip_forces
from coop_pin.running.release_findings import release_findings
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.admittance_stability import admittance_stability

_PATH_POSES, _LOOP_POSES = 41, 3
"""Poses at which a run looks for reach, and for stability."""
_ABOVE, _WIDER, _HALF = 1.05, 1.5, 0.45
"""Factors beyond a limit of a proposed value, and beyond the gap at which a tip takes hold; part of a limit
at which sampled damping is proposed."""


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
    bias, of an unknown load and without an arm; the least distance between bodies. Nothing is simulated. Each
    remedy of an error was applied: the error is gone then, and none of another kind has come.

    Args:
        scenario: a Scenario, a name in the catalogue, or the path of a TOML file.
        poses: number of poses looked at along the motion.
        bias: kinematic bias of one arm's tip, m.
        bias_turn: angle by which the base of one arm is off, rad.
        load: constant force on the payload that the law does not know, N.
        table_error: height by which a table on which the payload is put down may be higher than planned, m.

    Raises:
        ScenarioError: the scenario has mistakes.
        CodeRefusedError: it names code of a module that is neither the user's nor listed.
        CoopPinError: an arm, the motion or the law cannot be built.
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    require_allowed(code_of(scenario))
    carried, stated, scenario = [*carrier_findings(scenario)], scenario, seen_by_arms(scenario)
    reach = reachability(scenario, poses=poses)
    simulation = prepared_run(scenario, reach)
    entries = [*carried, *code_findings(scenario), *freedom_findings(stated, reach)]
    entries += task_findings(scenario, reach, simulation, table_error)
    left = tuple[Kind, ...]()
    if simulation is None or not reach.ok:
        left = LEFT_TO_CHECK
    else:
        entries += [*record_findings(simulation), *lost_arm_findings(scenario, reach)]
        entries += [*distance_findings(stated, reach), *release_findings(scenario)]
        if gains_are_known(scenario):
            entries += steady_findings(simulation, reach, bias, bias_turn, load)
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
    stated, scenario, start = simulation.scenario, simulation.scenario, simulation.state()
    entries = [*record_findings(simulation), *carrier_findings(scenario)]
    if scenario.cell.driven:
        scenario = seen_by_arms(scenario)
        simulation = Simulation(scenario, build_controller(scenario))
        start = simulation.state()
    with contextlib.suppress(Exception):  # of a user's motion: the run raises it again
        entries += force_findings(scenario, TABLE_ERROR)
    with contextlib.suppress(Exception):
        path = reachability(scenario, poses=_PATH_POSES)
        entries += [*torque_findings(statics_along(scenario, path)), *reach_findings(path)]
        entries += [*freedom_findings(stated, path), *payload_findings(simulation)]
        reach = reachability(scenario, poses=_LOOP_POSES) if path.ok else None
        entries.extend(stability_findings(simulation, reach, along=False))
        entries += release_findings(scenario)
    simulation.restore(start)
    left = tuple(kind for kind in LEFT_TO_CHECK if kind not in {finding.kind for finding in entries})
    return Findings(scenario.name, sorted_findings(entries), left)


@typed
def run_findings(scenario: Scenario) -> Findings:
    """Return the findings that ``cp.run`` warns of, and its notes: implausible numbers and quick findings.

    Args:
        scenario: the scenario.

    Raises:
        CoopPinError: an arm, the motion or the law cannot be built.
    """
    quick = quick_findings(Simulation(scenario, build_controller(scenario)))
    return Findings(scenario.name, sorted_findings([*implausible_numbers(scenario), *quick]), quick.left)


def _with_remedies(
    scenario: Scenario, entries: list[Finding], poses: int, table_error: float
) -> list[Finding]:
    """Return findings, each error with the first change that cures it and brings no error of another kind."""
    errors = dict[Kind, Finding]()
    for finding in (finding for finding in entries if finding.severity == "error"):
        errors[finding.kind] = max(errors.get(finding.kind, finding), finding, key=lambda each: each.value)
    cures, remedies = list[_Cure](), dict[Kind, Mapping[str, Any]]()
    for kind, finding in errors.items():
        candidates = _candidates(scenario, finding, poses)
        tried = (_cure(scenario, changes, poses, table_error) for changes in candidates)
        for cure in itertools.chain(tuple(cures), tried):
            cures.append(cure)
            if kind not in cure.after and cure.after <= errors.keys():
                remedies[kind] = cure.changes
                break
    return [
        finding._replace(remedy=remedies[finding.kind])
        if finding.severity == "error" and finding.kind in remedies
        else finding
        for finding in entries
    ]


class _Cure(NamedTuple):
    """Changes of a scenario, and the kinds of error that it has then."""

    changes: dict[str, Any]
    after: set[Kind]


def _cure(scenario: Scenario, changes: dict[str, Any], poses: int, table_error: float) -> _Cure:
    with contextlib.suppress(CoopPinError):
        changed = scenario.override(changes)
        reach = reachability(changed, poses=poses)
        findings = [*task_findings(changed, reach, prepared_run(changed, reach), table_error)]
        findings += release_findings(changed)
        return _Cure(changes, {finding.kind for finding in findings if finding.severity == "error"})
    return _Cure(changes, {*get_args(Kind)})


def _candidates(scenario: Scenario, finding: Finding, poses: int) -> Iterator[dict[str, Any]]:
    """Yield changes that may cure an error, the smallest first."""
    clock, law = scenario.clock, scenario.controller
    gains: Any = getattr(law, "gains", None)
    if finding.kind == "plant steps":
        yield {
            "clock.steps_per_tick": math.ceil(_ABOVE * clock.steps_per_tick * finding.value / finding.limit)
        }
    elif finding.kind == "static torque":
        yield from _lighter(scenario, statics_along(scenario, reachability(scenario, poses=poses)))
    elif finding.kind == "reach" and not (scenario.cell.splits_load or scenario.cell.tools):
        with contextlib.suppress(CoopPinError):  # no branch reaches
            cell = with_best_postures(scenario, poses)[0].cell
            changes = {
                path: list(value or ())
                for name, arm in cell.arms.items()
                for path, value, stated in (
                    (f"cell.arms.{name}.posture", arm.posture, scenario.cell.arms[name].posture),
                    (f"cell.grasps.{name}.rpy", cell.grasps[name].rpy, scenario.cell.grasps[name].rpy),
                )
                if value != stated
            }
            if changes:
                yield changes
    elif finding.kind == "friction":
        is_pressed = finding.value > 0.0
        yield (
            _scaled(scenario, MARGIN * finding.limit / finding.value) if is_pressed else tip_forces(scenario)
        )
    elif finding.kind == "table force":
        gain = np.array(gains.sliding_gain)
        parts = (finding.limit / finding.value / _ABOVE, 0.5, 0.25)
        yield from ({"controller.gains.sliding_gain": (part * gain).tolist()} for part in parts)
    elif finding.kind == "take-hold":
        event = scenario.events[int(finding.place.split(".")[1])]
        part = math.ceil(_WIDER * finding.value)
        fields = ("tolerance", "angle_tolerance")
        yield {finding.place.replace("tolerance", name): part * getattr(event, name) for name in fields}
    elif finding.kind == "admittance stability":
        factor = _ABOVE * admittance_stability(scenario).least
        damping = factor * np.array(gains.admittance_damping)
        yield {"controller.gains.admittance_damping": np.ceil(damping).tolist()}
    elif finding.kind in ("sampled damping", "loop stability", "grasp stability", "closed loop"):
        yield from _calmer(scenario, finding)


def _calmer(scenario: Scenario, finding: Finding) -> Iterator[dict[str, Any]]:
    """Yield stiffer springs of spare joints, where it is about them, calmer admittances, and higher rates."""
    rate, spring = scenario.clock.rate_hz, scenario.controller.spare_spring
    gains: Any = getattr(scenario.controller, "gains", None)
    posture: Any = getattr(scenario.controller, "posture", None)
    if finding.kind == "sampled damping" and scenario.cell.jointed and np.ndim(posture.damping) == 0:
        part = _HALF * finding.limit / finding.value  # joints that a grasp makes spare move the wrist alone
        yield {f"controller.posture.{gain}": math.floor(1e3 * part * each) / 1e3 for gain, each in posture}
    if spring and finding.place == spring:
        node: Any = scenario
        for field in spring.split("."):
            node = getattr(node, field)
        if np.ndim(node) == 0:
            yield from ({spring: factor * float(node)} for factor in (2.0, 4.0, 8.0))
    if finding.kind == "closed loop" and scenario.cell.jointed and getattr(gains, "anchor_gain", None):
        yield from ({"controller.gains.anchor_gain": part * gains.anchor_gain} for part in (0.3, 0.1))
    if finding.kind == "closed loop" and hasattr(gains, "admittance_damping"):
        for gain, factors in (("admittance_damping", (16.0, 256.0)), ("pose_gain", (0.25, 0.06))):
            stated = np.array(getattr(gains, gain))
            yield from ({f"controller.gains.{gain}": (factor * stated).tolist()} for factor in factors)
    if finding.kind == "sampled damping" and math.isfinite(finding.value):
        yield {"clock.rate_hz": float(math.ceil(_ABOVE * rate * finding.value / finding.limit))}
    yield from ({"clock.rate_hz": factor * rate} for factor in (2.0, 4.0))


def _lighter(scenario: Scenario, statics: StaticTorques) -> Iterator[dict[str, Any]]:
    """Yield the squeeze that the drives hold with the load, and the payload's mass with it."""
    if 0.0 < (part := squeeze_part(statics)) < 1.0:
        yield _scaled(scenario, part)
    part = min(part_held(arm.weight, arm.load + arm.squeeze, arm.limit) for arm in statics.arms)
    if (mass := math.floor(1e3 * part * scenario.cell.payload.mass) / 1e3) > 0.0:
        yield {"cell.payload.mass": mass, **_scaled(scenario, part)}


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
