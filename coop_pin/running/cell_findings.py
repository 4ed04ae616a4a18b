"""Findings of a cell before it runs, by subject: reach, torques, squeeze, stability and others."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any

from coop_pin.base.errors import ArgumentError, CoopPinError, DivergedError, shown
from coop_pin.base.loaded_code import edited_files
from coop_pin.base.memory import free_memory
from coop_pin.base.schema.user_code import code_of
from coop_pin.description.arm_events import LoseArm
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.carried_motion import seen_by_arms
from coop_pin.feasibility.distances import distances
from coop_pin.feasibility.freedoms import freedoms
from coop_pin.feasibility.internal_moment import internal_moment
from coop_pin.feasibility.least_squeeze import least_squeeze
from coop_pin.feasibility.motion_feasibility import closure_problem
from coop_pin.feasibility.reachability import Reachability
from coop_pin.feasibility.reserves import force_reserve, loads_without_an_arm
from coop_pin.feasibility.statics import StaticTorques, statics_along
from coop_pin.feasibility.table_force import table_force
from coop_pin.results.finding import Finding, Kind
from coop_pin.running.payload_findings import payload_findings
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.admittance_stability import admittance_stability
from coop_pin.stability.closed_loop import pressed_loop
from coop_pin.stability.forecast import forecast, slower_motion, worst_error
from coop_pin.stability.grasp_stability import grasp_stability
from coop_pin.stability.loop_stability import loop_stability
from coop_pin.stability.regrasp import grasp_sags, regrasp_gaps
from coop_pin.stability.sampled_stability import motion_stability, start_stability
from coop_pin.stability.steady_errors import anchor_biases, steady_errors
from coop_pin.stability.step_stability import step_stability

_LARGE_RECORD = 1e9
"""Memory of a record from which on it is a finding, bytes."""


def _expected(scenario: Scenario, reach: Reachability) -> Finding:
    """Return the errors to expect: a warning beyond what the task allows, whose remedy is a slower motion."""
    expected = forecast(scenario, reach)
    sentence, (value, limit, words) = expected.summary(), worst_error(scenario, expected)
    if value <= limit:
        return Finding("steady error", "controller", "note", sentence)
    remedy, _ = slower_motion(scenario, expected, len(reach.arms[0].times))
    return Finding("steady error", "controller", "warning", f"{sentence}; {words}", value, limit, remedy)


def gains_are_known(scenario: Scenario) -> bool:
    """Return whether analyses of the sampled loop know its gains and grasps.

    Not those of a user's law and of servos, nor of rigid grasps that lay a payload on a table.

    Args:
        scenario: the scenario.
    """
    cell = scenario.cell
    on_tables = bool(cell.tables) and not cell.unclosed
    return not (scenario.controller.user_code or scenario.has_servos or on_tables)


def code_findings(scenario: Scenario) -> Iterator[Finding]:
    """Yield the user's code that was edited after it was loaded, so that a run is that of the old one."""
    for name in code_of(scenario):
        for file in map(shown, edited_files(name)):
            sentence = (
                f"{name} runs as it was loaded: {file} has changed, or what it imports was loaded anew;"
                " load it again (importlib.reload, in the order of the imports), or restart"
            )
            yield Finding("user code", file, "warning", sentence)


def task_findings(
    scenario: Scenario, reach: Reachability, simulation: Simulation | None, table_error: float
) -> Iterator[Finding]:
    """Yield what may lose the task: all but memory, lost arms and steady errors."""
    yield from implausible_numbers(scenario)
    yield from reach_findings(reach)
    yield from torque_findings(statics_along(scenario, reach))
    yield from force_findings(scenario, table_error)
    if reach.ok and (singular := closure_problem(scenario)):
        yield Finding("closure rank", "cell.grasps", "error", singular)
    if simulation is not None and reach.ok:
        yield from payload_findings(simulation)
        yield from stability_findings(simulation, reach)
        if gains_are_known(scenario):
            yield from _closed_loop(scenario)
    elif simulation is not None:
        with contextlib.suppress(CoopPinError):  # of a singular start, which the reach has named
            yield from stability_findings(simulation, None)


def freedom_findings(scenario: Scenario, reach: Reachability) -> Iterator[Finding]:
    """Yield the freedoms that joints leave the payload, against its motion: nothing without such joints.

    A base of the payload stands in the world, whatever carries the arms.

    Args:
        scenario: the scenario as it is stated.
        reach: reachability of what its arms see.
    """
    links = scenario.cell.payload.links
    if scenario.cell.splits_load and all(arm.start_error is None for arm in reach.arms):
        seen = seen_by_arms(scenario)
        has_base = links is not None and links.base is not None
        leave = freedoms(seen.replace(motion=scenario.motion) if has_base else seen)
        severity: Any = "note" if leave.ok else "error"
        yield Finding("freedom", "motion", severity, leave.summary(), leave.left, leave.asked)


def prepared_run(scenario: Scenario, reach: Reachability) -> Simulation | None:
    """Return the run before its first tick; None if an arm cannot hold the start, or has too few joints."""
    if any(arm.start_error is not None or arm.joint_shortage for arm in reach.arms):
        return None
    return Simulation(scenario, build_controller(scenario) if gains_are_known(scenario) else None)


def _of(kind: Kind, field: str, report: Any, value: float, limit: float) -> Finding:
    """Return the finding of a report that has ``ok`` and ``summary``."""
    return Finding(kind, field, "note" if report.ok else "error", report.summary(), value, limit)


def record_findings(simulation: Simulation) -> Iterator[Finding]:
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


def reach_findings(reach: Reachability) -> Iterator[Finding]:
    """Yield why arms cannot follow, and the margins of the others."""
    for arm in reach.arms:
        for problem in arm.problems():
            yield Finding("reach", arm.arm, "error", f"arm {arm.arm!r} {problem}")
        if margins := "; ".join(arm.margins()):
            yield Finding("reach", arm.arm, "note", f"arm {arm.arm!r}: {margins}")


def distance_findings(scenario: Scenario, reach: Reachability) -> Iterator[Finding]:
    """Yield the least distance between arms, payload and tables: a warning below the clearance."""
    along = distances(scenario, reach)
    if (nearest := along.nearest) is not None:
        severity: Any = "note" if along.ok else "warning"
        pair, limit = " - ".join(nearest.pair), along.clearance
        yield Finding("distance", pair, severity, along.sentence(), nearest.distance, limit)


def torque_findings(statics: StaticTorques) -> Iterator[Finding]:
    """Yield the drives that cannot hold the cell at rest, otherwise the one that is closest to its limit."""
    for drive in statics.overloaded:
        joint = f"{drive.arm}/{drive.joint}"
        yield Finding("static torque", joint, "error", str(drive), drive.torque, drive.limit)
    if not statics.overloaded:
        worst = statics.worst
        value, limit = (math.nan, math.nan) if worst is None else (worst.torque, worst.limit)
        yield Finding("static torque", "", "note", statics.summary(), value, limit)


def force_findings(scenario: Scenario, table_error: float) -> Iterator[Finding]:
    """Yield the squeeze that friction needs, forces on tables, gaps at take-holds, and payloads that hang."""
    if (least := least_squeeze(scenario)) is not None:
        yield _of("friction", least.arm, least, least.stated, least.force)
    if (pressed := table_force(scenario, table_error=table_error)) is not None:
        largest = max(pressed.force, pressed.impact)
        yield _of("table force", pressed.table, pressed, largest, pressed.allowed)
    for gap in regrasp_gaps(scenario):
        field = f"events.{scenario.events.index(gap.event)}.tolerance"
        yield _of("take-hold", field, gap, gap.use, 1.0)
    for sag in grasp_sags(scenario):
        if (use := sag.use(scenario.task)) > 1.0:
            slot, sentence = f"events.{scenario.events.index(sag.event)}", sag.summary(scenario.task)
            yield Finding("steady error", slot, "warning", sentence, use, 1.0)


def stability_findings(
    simulation: Simulation, reach: Reachability | None, along: bool = True
) -> Iterator[Finding]:
    """Yield the stability of the plant's steps and of the law, along the motion or for a run.

    A law whose integral has a dead zone counts as it acts beyond it.
    """
    beyond = simulation.scenario.controller.beyond_dead_zone
    if beyond is not simulation.scenario.controller:
        scenario = simulation.scenario.replace(controller=beyond)
        simulation = Simulation(scenario, build_controller(scenario))
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
        law: Any = scenario.controller
        is_part = {"model", "regressor"} & {*law.needs} or law.kind == "prescribed-performance"
        if not along and is_part:  # it knows the damping of these laws only
            yield from _closed_loop(scenario)
    else:
        is_along = along and reach is not None
        damping = motion_stability(simulation, reach) if is_along else start_stability(simulation)  # type: ignore[arg-type]
        yield _of("sampled damping", ", ".join(damping.joints), damping, damping.value, damping.limit)
        if scenario.cell.jointed or simulation.chain.joints is not None:  # known by the closed loop alone
            return
        loop = loop_stability(simulation, reach)
        field = loop.remedy if loop.mode.is_spare and loop.remedy else "controller.gains"
        yield _of("loop stability", field, loop, loop.radius, 1.0)


def _on_servos(scenario: Scenario) -> Iterator[Finding]:
    """Yield the stability of a law on servos: of an admittance in closed form, of others by differences."""
    try:
        loop = admittance_stability(scenario)
    except ArgumentError:
        yield from _closed_loop(scenario)
    else:
        yield _of("admittance stability", "controller.gains.admittance_damping", loop, loop.radius, 1.0)


def _closed_loop(scenario: Scenario) -> Iterator[Finding]:
    """Yield the stability of the whole tick by differences, at the start, beside hinges under the squeeze."""
    slot = "controller.gains"
    try:
        loop = pressed_loop(scenario)
    except (ArgumentError, DivergedError) as error:
        severity: Any = "error" if isinstance(error, DivergedError) else "note"
        yield Finding("closed loop", slot, severity, f"closed loop: {error}")
    else:
        yield _of("closed loop", slot, loop, loop.radius, 1.0)


def lost_arm_findings(scenario: Scenario, reach: Reachability) -> Iterator[Finding]:
    """Yield arms whose loss the others do not bear: an error where the scenario plans to lose them.

    Nothing beside joints, which do not transmit every wrench, of tools, which are arms of their own, nor of a
    payload of several links.
    """
    if scenario.cell.jointed or scenario.cell.tools or scenario.cell.payload.links is not None:
        return
    for arm, (limp, carried) in loads_without_an_arm(scenario, reach).items():
        if limp > 1.0:
            sentence = (
                f"if arm {arm!r} loses its torque, the others need {limp:.3g} times their limits, and"
                f" {carried:.3g} times if it carries its own weight: above 1 no law holds the payload"
            )
            drives = scenario.actuators_of(arm)
            is_braked = any(
                isinstance(event, LoseArm) and event.arm == arm and event.form == "braked"
                for event in scenario.events
            )
            is_limp = drives.torque_lost_at is not None and not is_braked
            is_lost = is_limp or (drives.commands_lost_at is not None and carried > 1.0)
            yield Finding("lost arm", arm, "error" if is_lost else "note", sentence, limp, 1.0)


def steady_findings(
    simulation: Simulation, reach: Reachability, bias: float, bias_turn: float, load: float
) -> Iterator[Finding]:
    """Yield what the law measures, what a bias and an unknown load leave, and the errors to expect."""
    scenario = simulation.scenario
    law: Any = scenario.controller
    if scenario.cell.jointed or scenario.cell.tools or simulation.chain.joints is not None:
        beside = "tools" if scenario.cell.tools else "joints of grasps or payload"
        why = f"errors at rest and the loss of an arm are not forecast beside {beside}"
        yield Finding("steady error", "controller", "note", why)
        return
    if not scenario.cell.controls_turns and "holding torque" in law.needs:
        moment = internal_moment(scenario, reach, law.posture)
        yield Finding("internal moment", moment.arm, "note", moment.summary(), moment.moment)
    errors, slot = steady_errors(scenario, bias=bias, load=load), "controller"
    yield Finding("steady error", slot, "note", errors.summary())
    yield _expected(scenario, reach)
    if scenario.network is not None:
        traffic = simulation.traffic().summary(scenario.clock.rate_hz)
        is_quiet = scenario.network.longest_silence_of(list(scenario.cell.arms), scenario.clock) > 0.0
        yield Finding("steady error", "network", "note", f"{'without its threshold ' * is_quiet}{traffic}")
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
