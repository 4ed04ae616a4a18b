"""Command ``check``: what is known of a scenario before it runs."""

from __future__ import annotations

import math
import textwrap
from typing import Any

from coop_pin.base.errors import ArgumentError, DivergedError
from coop_pin.cli.exit_codes import FAILED, OK
from coop_pin.cli.inspect import print_wrapped
from coop_pin.cli.overrides import NO_FIELDS, ScenarioName, TypedFields, load_scenario


def check(
    scenario: ScenarioName,
    poses: int = 401,
    bias: float = 1e-3,
    bias_turn: float = 0.0,
    load: float = 10.0,
    table_error: float = 2e-3,
    fields: TypedFields = NO_FIELDS,
) -> int:
    """Check reachability, distance to singularities, limits and static torques along the desired motion.

    Nothing is simulated. Static torques are those that hold the arms, the payload and the squeeze at rest. A
    closed chain whose closures lose rank at the start is named.
    Numbers in a likely wrong unit, and starts, postures and grasps that do not fit, come first.
    For the built-in controllers, also check that the damping gains are stable at the control rate, all gains
    with the lag of the drives along the motion, the slowest and the least damped mode of the whole loop at
    the start, and the joint friction in the plant's steps; say what the law
    measures and what a kinematic bias and an unknown load leave; the proposal of 'coop-pin suggest'
    for these postures follows; on compliant grasps and patches also the stiffness from which the gains hold.
    Patches have the least squeeze that carries the payload along the motion, and a put-down the force with
    which the arms press a table that is higher than planned.
    Every field of the scenario can be changed as in 'coop-pin run'.

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file.
        poses: number of poses checked along the motion.
        bias: kinematic bias of one arm's tip, m.
        bias_turn: angle by which the base of one arm is off, rad.
        load: constant force on the payload that the law does not know, N.
        table_error: height by which a table on which the payload is put down may be higher than planned, m.
        fields: fields of the scenario, as typed.
    """
    from coop_pin import feasibility
    from coop_pin.running.plausibility import gains_are_known, large_record
    from coop_pin.simulation.build_controller import build_controller
    from coop_pin.simulation.simulation import Simulation

    chosen = load_scenario(scenario, fields)
    reach = feasibility.reachability(chosen, poses=poses)
    is_feasible = _feasible(chosen, reach, table_error)
    if not reach.ok:
        return FAILED
    is_known = gains_are_known(chosen)
    simulation = Simulation(chosen, build_controller(chosen) if is_known else None)
    _print_lines([large_record(simulation)])
    if not is_known:
        return OK if is_feasible else FAILED
    is_stable = _stable(simulation, reach, table_error)
    _errors(simulation, reach, bias, bias_turn, load)
    return OK if is_feasible and is_stable else FAILED


def _feasible(scenario: Any, reach: Any, table_error: float) -> bool:
    """Print what does not depend on the law, and return whether the cell can do the motion."""
    from coop_pin import feasibility, stability
    from coop_pin.running.plausibility import implausible_numbers

    print_wrapped(*(f"! {number}" for number in implausible_numbers(scenario)), reach.summary(), sep="\n")
    torques, squeeze = feasibility.statics_along(scenario, reach), feasibility.least_squeeze(scenario)
    singular, is_stable = feasibility.closure_problem(scenario) if reach.ok else "", True
    lines = [torques.summary(), f"! {singular}" if singular else ""]
    if scenario.has_servos:
        try:
            loop = stability.admittance_stability(scenario)
            is_stable = loop.ok
            lines.append(f"{loop.summary()}; errors at rest on servos are not checked")
        except ArgumentError as error:
            lines.append(f"the arms have servos, and gains and errors at rest are not checked: {error}")
    pressed = feasibility.table_force(scenario, table_error=table_error)
    lines += [forces.summary() for forces in (squeeze, pressed) if forces is not None]
    if scenario.cell.tables and not scenario.cell.unclosed:
        lines.append("the payload may lie on a table: gains are not checked")
    _print_lines(lines)
    forces_are_ok = all(forces.ok for forces in (squeeze, pressed) if forces is not None)
    return reach.ok and torques.ok and is_stable and not singular and forces_are_ok


def _stable(simulation: Any, reach: Any, table_error: float) -> bool:
    """Print what gains, sampling and drives allow, and return whether the law is stable."""
    from coop_pin import design, feasibility, stability

    scenario = simulation.scenario
    lines = [
        f"! if arm {arm!r} loses its torque, the others need {limp:.3g} times their limits, and"
        f" {carried:.3g} times if it carries its own weight: above 1 no law holds the payload"
        for arm, (limp, carried) in feasibility.loads_without_an_arm(scenario, reach).items()
        if limp > 1.0
    ]
    findings: list[Any] = [stability.step_stability(simulation, reach)]
    if scenario.cell.unclosed:
        findings.insert(0, stability.grasp_stability(simulation))
    else:
        findings.insert(0, stability.motion_stability(simulation, reach))
        findings.insert(1, stability.loop_stability(simulation, reach))
    lines += [finding.summary() for finding in findings]
    if scenario.cell.unclosed:
        proposal = design.own_inertia_proposal(scenario, reach, table_error=table_error)
    else:
        proposal = design.gain_proposal(scenario, reach)
    lines.append(proposal.summary())
    try:
        lines.append(stability.eigenvalues(scenario).summary())
    except (ArgumentError, DivergedError) as error:  # the steps or gains named above
        lines.append(f"closed loop: {error}")
    _print_lines(lines)
    return all(finding.ok for finding in findings)


def _errors(simulation: Any, reach: Any, bias: float, bias_turn: float, load: float) -> None:
    """Print what the law measures, and what a bias and an unknown load leave."""
    from coop_pin import feasibility, stability

    scenario, lines = simulation.scenario, list[str]()
    law = scenario.controller
    if not scenario.cell.controls_turns and "holding torque" in law.needs:
        lines.append(feasibility.internal_moment(scenario, reach, law.posture).summary())
    errors = stability.steady_errors(scenario, bias=bias, load=load)
    lines.append(errors.summary())
    if scenario.network is not None:
        lines.append(simulation.traffic().summary(scenario.clock.rate_hz))
    reserve = feasibility.force_reserve(scenario, reach) if errors.growth > 0.0 else math.inf
    if math.isfinite(reserve):  # drives without limits have no end of it
        earliest = max(0.0, reserve) / errors.growth
        lines.append(f"! the force that grows is beyond the first drive {earliest:.3g} s later or after")
    if math.isfinite(errors.free):
        biases = stability.anchor_biases(scenario, bias, bias_turn)
        needed = ", ".join(
            f"{arm} {1e3 * position:.3g} mm and {1e3 * angle:.3g} mrad"
            for arm, (position, angle) in biases.items()
        )
        lines.append(f"anchor_bias for this bias of an arm whenever it begins: {needed}")
    _print_lines(lines)


def _print_lines(texts: list[str]) -> None:
    """Print texts that are not empty, each line indented."""
    print_wrapped(*(textwrap.indent(text, "  ") for text in texts if text), sep="\n")
