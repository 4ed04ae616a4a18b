"""Stable gains: the first ones that are proposed for a law with which the closed loop holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError, DivergedError, InfeasibleMotionError
from coop_pin.control.laws.payload_space import SLIP_GUARD, PayloadSpace
from coop_pin.description.scenario import Scenario
from coop_pin.design.grasp_gains import with_steps
from coop_pin.design.own_inertia import own_inertia_proposal
from coop_pin.design.posture_gains import rounded_down
from coop_pin.design.tuning_rule import GainProposal, force_path_of, gain_proposal
from coop_pin.feasibility.least_squeeze import least_squeeze
from coop_pin.feasibility.reachability import Reachability
from coop_pin.feasibility.task_inertia import with_spare_motion
from coop_pin.results.finding import Kind
from coop_pin.running.check import check
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.closed_loop import eigenvalues
from coop_pin.stability.grasp_stability import grasp_stability
from coop_pin.stability.loop_stability import LoopStability, loop_stability

_SPARE_RATE = 1.0
"""Least decay of the spare joints, 1/s: what they are off after a motion is gone in a few seconds."""
_SOFTEST, _STIFFEST = 5.0, 640.0
"""Springs of the posture that are tried, N m/rad."""
_LEAST_ANCHOR = 0.01
"""Anchor gain below which it is not lowered further for the stability on springs."""
_AWAY = 0.3
"""Largest angle of a spare motion away from the path of the inverse kinematics, rad."""
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


def stable_proposal(
    scenario: Scenario, cell_reach: Reachability, table_error: float
) -> tuple[GainProposal, Scenario, LoopStability]:
    """Return the gains of the payload-space law whose sampled loop holds, a scenario with them, and its loop.

    Args:
        scenario: Scenario of the proposal.
        cell_reach: Poses along the motion.
        table_error: Height by which a table may be higher than planned, m.

    Raises:
        InfeasibleMotionError: cause "stability": none hold.
    """
    if not scenario.cell.unclosed:
        return _held(scenario, cell_reach, gain_proposal)
    propose = partial(own_inertia_proposal, table_error=table_error)
    try:
        return _held(scenario, cell_reach, propose)
    except InfeasibleMotionError as error:
        if error.cause != "stability":
            raise
        return _held(scenario, cell_reach, partial(propose, tips_give=True))


def _held(
    scenario: Scenario, cell_reach: Reachability, propose: Callable[..., GainProposal]
) -> tuple[GainProposal, Scenario, LoopStability]:
    """Return the proposal whose spring holds the spare joints along the motion, its scenario and its loop.

    Raises:
        InfeasibleMotionError: cause "stability": the sampled motion grows, or no spring holds them.
    """
    stiffness = 0.0
    while True:
        proposal = propose(scenario, cell_reach, least_stiffness=stiffness)
        suggested = _with_gains(scenario, proposal)
        rigid = (
            suggested.replace(cell=suggested.cell.rigid, events=()) if suggested.cell.unclosed else suggested
        )
        loop = loop_stability(Simulation(rigid, build_controller(rigid)), cell_reach)
        if (
            loop.ok
            and loop.spare_rate >= _SPARE_RATE
            and _spare_angle(suggested, cell_reach, proposal) < _AWAY
        ):
            return (*_stable_on_springs(proposal, suggested, cell_reach), loop)
        tried = float(np.max(proposal.posture.stiffness))
        is_held = tried < stiffness  # on positional rows the drives hold no stiffer one
        stiffness = max(_SOFTEST, 2.0 * tried)
        if is_held or stiffness > _STIFFEST or not (loop.ok or loop.spare):
            detail = loop.summary()
            if loop.ok:
                limit = f"the {tried:g} N m/rad that the drives hold" if is_held else f"{_STIFFEST:g} N m/rad"
                detail = f"no spring up to {limit} keeps the spare joints on their path"
            raise InfeasibleMotionError("stability", detail)


def _stable_on_springs(
    proposal: GainProposal, scenario: Scenario, cell_reach: Reachability
) -> tuple[GainProposal, Scenario]:
    """Return them with g lowered until the sampled loop of springs, arms and law is stable.

    Raises:
        InfeasibleMotionError: cause "stability": it is not.
    """
    while scenario.cell.unclosed:
        stability = grasp_stability(Simulation(scenario, build_controller(scenario)))
        g = proposal.gains.anchor_gain
        is_least = proposal.law is None or g < _LEAST_ANCHOR
        if stability.ok and (is_least or _decays(with_steps(scenario, cell_reach))):
            break
        if is_least:
            raise InfeasibleMotionError("stability", stability.summary().partition("\n")[0])
        proposal = proposal.with_anchor_gain(g / 2.0)
        scenario = _with_gains(scenario, proposal)
    return proposal, scenario


def _decays(scenario: Scenario) -> bool:
    """Return whether the whole tick is stable by differences, with spare joints; True where it has none."""
    try:
        return eigenvalues(scenario.replace(events=())).ok
    except ArgumentError:  # no derivative there
        return True
    except DivergedError:
        return False


def _spare_angle(scenario: Scenario, cell_reach: Reachability, proposal: GainProposal) -> float:
    """Return by how much spare joints move away from the path of the inverse kinematics, rad."""
    moved = with_spare_motion(scenario, cell_reach, proposal.posture)
    pairs = zip(cell_reach.arms, moved.arms, strict=True)
    return max(float(np.abs(path.q - reach.q).max()) for reach, path in pairs)


def _with_gains(scenario: Scenario, proposal: GainProposal) -> Scenario:
    clock, law = scenario.clock, proposal.law or PayloadSpace(gains=proposal.gains)
    steps = max(2, math.ceil(clock.steps_per_tick * clock.rate_hz / proposal.rate_hz))
    steps = clock.steps_per_tick if proposal.rate_hz == clock.rate_hz else steps
    controller = law.replace(
        posture=proposal.posture,
        force_path=force_path_of(scenario),
        zero_at_grasp=scenario.controller.near_rest.is_zeroed,
        **_on_patches(scenario),
    )
    clock = clock.replace(rate_hz=proposal.rate_hz, steps_per_tick=steps)
    return scenario.replace(controller=controller, clock=clock)


def _on_patches(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of the law that patches ask for."""
    fields, least = dict[str, Any](), least_squeeze(scenario)
    if scenario.cell.patches and least is not None:
        reach = min(float(grasp.reach.min()) for grasp in scenario.cell.patches.values())
        fields["slip_guard"] = min(SLIP_GUARD, reach / 2.0)
        if len(scenario.wrists) == len(scenario.cell.arms):
            fields["normal_guard"] = rounded_down(least.stated / 4.0)
    return fields
