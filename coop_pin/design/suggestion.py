"""Proposal of control rate, gains, postures and squeeze for the payload-space law, from a cell's physics."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import as_count, require_type
from coop_pin.base.errors import ArgumentError, InfeasibleMotionError, ScenarioWarning
from coop_pin.control.laws.payload_space import SLIP_GUARD, PayloadSpace
from coop_pin.control.laws.payload_space_controller import PayloadSpaceGains
from coop_pin.description.scenario import Scenario
from coop_pin.design.own_inertia import held_by_squeeze, own_inertia_proposal
from coop_pin.design.posture_gains import rounded_down
from coop_pin.design.proposal_limits import (
    friction_limits,
    gain_limits,
    moment_limits,
    null_space_limits,
    posture_limit,
)
from coop_pin.design.stable_gains import LAWS, with_stable_gains
from coop_pin.design.tuning_rule import GainProposal, anchored_enough, force_path_of, gain_proposal
from coop_pin.feasibility.least_squeeze import least_squeeze, with_enough_squeeze
from coop_pin.feasibility.motion_feasibility import (
    posture_margins,
    require_feasible,
    require_rank,
    squeeze_part,
    with_best_postures,
)
from coop_pin.feasibility.reachability import Reachability, reachability
from coop_pin.feasibility.statics import statics_along
from coop_pin.feasibility.table_force import TABLE_ERROR, table_force
from coop_pin.feasibility.task_inertia import with_spare_motion
from coop_pin.results.finding import Findings
from coop_pin.running.check import check
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.forecast import Forecast, forecast
from coop_pin.stability.grasp_stability import grasp_stability
from coop_pin.stability.loop_stability import LoopStability, loop_stability
from coop_pin.stability.sampled_stability import start_stability
from coop_pin.stability.step_size import step_stability

_SPARE_RATE = 1.0
"""Least decay of the spare joints, 1/s: what they are off after a motion is gone in a few seconds."""
_SOFTEST, _STIFFEST = 5.0, 640.0
"""Springs of the posture that are tried, N m/rad."""
_STEP_PART = 0.9
"""Part of the stability limit of the plant's steps that friction may take at the poses that are looked at."""
_LEAST_ANCHOR = 0.01
"""Anchor gain below which it is not lowered further for the stability on springs."""
_AWAY = 0.3
"""Largest angle of a spare motion away from the path of the inverse kinematics, rad."""

_NO_FORECAST = Forecast()


@dataclass(frozen=True, eq=False)
class Suggestion:
    """A scenario with proposed rate, gains, grasps, postures and squeeze, and what limits each.

    Attributes:
        scenario: ready to run.
        proposal: the numbers of the payload-space law; None of a law that is kept.
        limits: one sentence for each value: what limits it.
        changes: differences from what is stated: law, squeeze, grasps; one sentence each.
        forecast: errors to expect of a run.
    """

    scenario: Scenario
    proposal: GainProposal | None
    limits: tuple[str, ...]
    changes: tuple[str, ...] = ()
    forecast: Forecast = _NO_FORECAST

    def findings(self, *, table_error: float = TABLE_ERROR) -> Findings:
        """Return what ``cp.check`` knows of the proposed scenario; table_error as of ``suggest``, m."""
        return check(self.scenario, table_error=table_error)

    def summary(self) -> str:
        """Return the changes, the values and what limits each, as text."""
        law: Any = self.scenario.controller
        numbers = self.proposal.summary() if self.proposal else f"proposal: {law.kind}, {law.gains!r}"
        return "\n".join(
            (
                *(f"! {sentence}" for sentence in self.changes),
                f"{self.scenario.name}: {numbers}",
                f"  {self.forecast.summary()}",
                *(f"  {sentence}" for sentence in self.limits),
            )
        )


def suggest(
    scenario: Scenario | str | Path, *, poses: int = 101, table_error: float = TABLE_ERROR
) -> Suggestion:
    """Return a proposal for the payload-space law: what limits each value, and a scenario that runs with it.

    Admittance and object impedance are kept on rigid grasps and springs where gains are found that hold;
    any other law is replaced, which the first of the ``changes`` says.

    The tuning rule along the whole motion is T lambda_max(A^-1 K) <= 1, k_I T <= 1/4, k_I <= lambda_min / 2,
    gamma <= lambda_min / 4, and a damping ratio of at least 0.58 of every sampled mode.
    The rate is the scenario's, or the first multiple of it up to 1000 Hz at which the error to expect while
    moving is below 0.2 mm and 0.2 N. The integral is anchored where the scenario has a force path, or a wrist
    sensor on every arm; otherwise it leaks (the law of an arm's own wrist is not proposed). The postures are
    the branches of the inverse kinematics with the largest margin of torque, position limits and singularity;
    a grasp is turned about its own z axis where that opens the range of a joint. The spring of spare joints
    is raised until the sampled loop brings them to rest along the motion. The scenario's own gains are not
    used; collisions are not considered. Implausible numbers of the scenario are told as ScenarioWarnings.

    The bound of the anchor, ``anchor_bias``, has what the measured wrenches move along the motion in it.

    Compliant grasps ask for gains of each arm's own task inertia, matrices that turn with the payload:
    ``T lambda_max(Lambda_i^-1 c_i K_i) = 0.5``, k_I = 0.4 lambda_min, gamma up to 0.1 lambda_min, and
    ``zero_at_grasp``, with which the deflection is no bias. The sampled loop of springs, arms and law must be
    stable.

    Patches ask for the same, and for the split of the virtual linkage, guards, and a squeeze of at least 1.5
    times ``least_squeeze``: stated ones are raised, and without one the tips press along the lines between
    them. A put-down leaves the anchor without a bound, and lowers the gains until a table that is
    ``table_error`` higher than planned is pressed with at most 4/3 of the payload's weight.

    Args:
        scenario: cell, motion and squeeze, or a name or file of them, in which gains may be missing; its
            controller gives force_path and zero_at_grasp only, and a dead zone is dropped, with a sentence.
        poses: number of poses looked at along the motion.
        table_error: height by which a table on which the payload is put down may be higher than planned, m.

    Raises:
        InfeasibleMotionError: the cell cannot do it, with the cause: rank, reach, singularity, limits, torque
            or stability.
        UrdfError, NameNotFoundError, FileReadError: an arm or the motion cannot be built.
        ArgumentError: patches hold together with other grasps, or tables are under rigid ones.
    """
    if isinstance(scenario, str | Path):
        scenario = Scenario.load(scenario, draft=True)
    require_type("scenario", scenario, Scenario)
    poses = as_count("poses", poses, 5)
    cell, pressed = scenario.cell, tuple[str, ...]()
    if cell.has_contacts and len(cell.patches) < len(cell.arms):
        names = [*cell.patches, *cell.tables]
        raise ArgumentError(
            "suggest is for cells whose grasps are all patches, or that have none and no tables;"
            f" {names} hold or bear by friction beside others"
        )
    keeps_law = scenario.controller.kind in LAWS and not cell.patches
    changes, scenario = ((), scenario) if keeps_law else _with_law(scenario)
    if cell.patches:
        scenario, pressed = with_enough_squeeze(scenario)
    for number in implausible_numbers(scenario):
        warnings.warn(str(number), ScenarioWarning, stacklevel=2)
    require_rank(scenario.cell)
    scenario, turned = with_best_postures(scenario, poses)
    cell_reach = reachability(scenario, poses=poses)
    statics = statics_along(scenario, cell_reach)
    require_feasible(scenario, cell_reach, statics)
    part = squeeze_part(statics)
    if part < 1.0:
        scenario = scenario.replace(squeeze=scenario.squeeze.scaled(part))
        if (least := least_squeeze(scenario)) is not None and not least.ok:
            raise InfeasibleMotionError(
                "torque", f"{least.summary().removeprefix('! ')}; the drives hold no more"
            )
    cut = f"squeeze CUT to {part:.2f} of what is stated: all that the drives hold beside weight and load"
    pressed = (*pressed, *([cut] if part < 1.0 else []), *turned)
    margins = [posture_limit(arm) for arm in posture_margins(scenario, cell_reach, statics)]
    if keeps_law:
        if (held := with_stable_gains(scenario)) is not None:
            return Suggestion(held, None, (*margins,), pressed, forecast(held, cell_reach))
        if scenario.has_servos:
            detail = f"no gains of the law {scenario.controller.kind!r} were found with which it is stable"
            raise InfeasibleMotionError("stability", detail)
        changes, scenario = _with_law(scenario)
    propose: Callable[..., GainProposal] = gain_proposal
    if cell.unclosed:
        propose = partial(own_inertia_proposal, table_error=table_error)
    try:
        proposal, suggested, loop = _held(scenario, cell_reach, propose)
    except InfeasibleMotionError as error:
        if not cell.unclosed or error.cause != "stability":
            raise
        proposal, suggested, loop = _held(scenario, cell_reach, partial(propose, tips_give=True))
    if cell.unclosed:
        suggested, too_large = held_by_squeeze(suggested, cell_reach)
        pressed = (*pressed, *too_large)
    suggested, errors = anchored_enough(suggested, cell_reach)
    simulation = Simulation(suggested, build_controller(suggested))
    steps = step_stability(simulation, cell_reach)
    count = math.ceil(steps.steps_per_tick * steps.value / (_STEP_PART * steps.limit))
    if count > steps.steps_per_tick:
        suggested = suggested.override({"clock.steps_per_tick": count})
    pressed_table = table_force(suggested, table_error=table_error, lag=proposal.tracking)
    lines = (
        *gain_limits(scenario, proposal, suggested),
        *friction_limits(suggested),
        *([] if pressed_table is None else [pressed_table.summary()]),
        *null_space_limits(proposal, loop),
        *moment_limits(scenario, proposal),
        *margins,
        "squeeze: as stated" if part == 1.0 else f"squeeze: {part:.2f} of what is stated, by the drives",
        f"plant: {suggested.clock.steps_per_tick} steps in a tick; {start_stability(simulation).summary()}",
    )
    return Suggestion(suggested, proposal, lines, (*changes, *pressed), errors)


def _with_law(scenario: Scenario) -> tuple[tuple[str, ...], Scenario]:
    """Return what of the law changes, a sentence each, and the scenario with the one that is proposed."""
    stated, gives = scenario.controller, bool(scenario.cell.unclosed)
    ones = PayloadSpaceGains(pose_gain=1.0, sliding_gain=1.0, sign_gain=1.0, transient_rate=1.0)
    is_zeroed = stated.near_rest.is_zeroed or gives
    law = PayloadSpace(gains=ones, force_path=force_path_of(scenario), zero_at_grasp=is_zeroed)
    changed = f"law CHANGED from {stated.kind!r} to {law.kind!r}: no gains of it are proposed, or none hold"
    integral = "is anchored" if law.measures else "leaks"
    zone = f"integral_dead_zone DROPPED: the integral that is proposed {integral} instead"
    sentences = (changed,) * (stated.kind != law.kind) + (zone,) * (stated.beyond_dead_zone is not stated)
    return sentences, scenario.replace(controller=law)


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
            return (*_stable_on_springs(proposal, suggested), loop)
        tried = float(np.max(proposal.posture.stiffness))
        is_held = tried < stiffness  # on positional rows the drives hold no stiffer one
        stiffness = max(_SOFTEST, 2.0 * tried)
        if is_held or stiffness > _STIFFEST or not (loop.ok or loop.spare):
            detail = loop.summary()
            if loop.ok:
                limit = f"the {tried:g} N m/rad that the drives hold" if is_held else f"{_STIFFEST:g} N m/rad"
                detail = f"no spring up to {limit} keeps the spare joints on their path"
            raise InfeasibleMotionError("stability", detail)


def _stable_on_springs(proposal: GainProposal, scenario: Scenario) -> tuple[GainProposal, Scenario]:
    """Return them with g lowered until the sampled loop of springs, arms and law is stable.

    Raises:
        InfeasibleMotionError: cause "stability": it is not.
    """
    while scenario.cell.unclosed:
        stability = grasp_stability(Simulation(scenario, build_controller(scenario)))
        g = proposal.gains.anchor_gain
        if stability.ok:
            break
        if proposal.law is None or g < _LEAST_ANCHOR:
            raise InfeasibleMotionError("stability", stability.summary().partition("\n")[0])
        proposal = proposal.with_anchor_gain(g / 2.0)
        scenario = _with_gains(scenario, proposal)
    return proposal, scenario


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
