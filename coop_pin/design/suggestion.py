"""Proposal of control rate, gains, postures and squeeze for the payload-space law, from a cell's physics."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import as_fitting_count, as_positive, require_type
from coop_pin.base.errors import ArgumentError, InfeasibleMotionError, ScenarioWarning
from coop_pin.base.schema.parts import fields_of
from coop_pin.control.gains import Gains
from coop_pin.control.laws.payload_space import PayloadSpace
from coop_pin.control.laws.payload_space_controller import PayloadSpaceGains
from coop_pin.description.scenario import Scenario
from coop_pin.design.grasp_gains import with_joint_gains, with_steps, with_tool_gains
from coop_pin.design.own_inertia import held_by_squeeze
from coop_pin.design.proposal_limits import (
    friction_limits,
    gain_limits,
    moment_limits,
    null_space_limits,
    posture_limit,
)
from coop_pin.design.stable_gains import LAWS, stable_proposal, with_stable_gains
from coop_pin.design.tuning_rule import GainProposal, anchored_enough, force_path_of
from coop_pin.feasibility.carried_motion import seen_by_arms
from coop_pin.feasibility.freedoms import freedoms
from coop_pin.feasibility.least_squeeze import least_squeeze, with_enough_squeeze
from coop_pin.feasibility.motion_feasibility import (
    posture_margins,
    require_feasible,
    require_rank,
    squeeze_part,
    with_best_postures,
)
from coop_pin.feasibility.reachability import POSE_SIZE, Reachability, reachability
from coop_pin.feasibility.statics import StaticTorques, statics_along
from coop_pin.feasibility.table_force import TABLE_ERROR, table_force
from coop_pin.results.finding import Findings
from coop_pin.running.check import check
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.stability.forecast import Forecast, forecast, slower_motion, worst_error
from coop_pin.stability.sampled_stability import sampled_stability

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
        numbers = (
            self.proposal.summary() if self.proposal else f"proposal: {law.kind}, {_gain_text(law.gains)}"
        )
        return "\n".join(
            (
                *(f"! {sentence}" for sentence in self.changes),
                f"{self.scenario.name}: {numbers}",
                f"  {self.forecast.summary()}",
                *(f"  {sentence}" for sentence in self.limits),
            )
        )


def _gain_text(gains: Gains) -> str:
    """Return gains as text; a matrix is that of the first arm, and shown in the file alone."""
    shown = {name: gain for name, gain in fields_of(gains).items() if gain is not None}
    return ", ".join(
        f"{name} {'a matrix for each arm' if np.ndim(gain) == 2 else gain}" for name, gain in shown.items()
    )


def suggest(
    scenario: Scenario | str | Path,
    *,
    poses: int = 101,
    table_error: float = TABLE_ERROR,
    task_part: float = 0.9,
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
    is raised until the sampled loop brings them to rest along the motion. Postures that keep the clearance of
    the cell come first. The scenario's own gains are not used. Implausible numbers of the scenario are told
    as ScenarioWarnings.

    The bound of the anchor, ``anchor_bias``, has what the measured wrenches move along the motion in it.

    Compliant grasps ask for gains of each arm's own task inertia, matrices that turn with the payload:
    ``T lambda_max(Lambda_i^-1 c_i K_i) = 0.5``, k_I = 0.4 lambda_min, gamma up to 0.1 lambda_min, and
    ``zero_at_grasp``, with which the deflection is no bias. The sampled loop of springs, arms and law must be
    stable.

    Beside tools the symmetric law is proposed, with such gains of every arm alone, and beside joints, or
    of a payload of several links, the law in the rows of each grasp; rate, postures and grasps stay.

    Patches ask for the same, and for the split of the virtual linkage, guards, and a squeeze of at least 1.5
    times ``least_squeeze``: stated ones are raised, and without one the tips press along the lines between
    them. A put-down leaves the anchor without a bound, and lowers the gains until a table that is
    ``table_error`` higher than planned is pressed with at most 4/3 of the payload's weight.

    A motion is slowed, to a half, a quarter or an eighth, where no less has its errors to expect within
    ``task_part`` of what the task allows, which the first of the ``changes`` says.

    Args:
        scenario: cell, motion and squeeze, or a name or file of them, in which gains may be missing; its
            controller gives force_path and zero_at_grasp only, and a dead zone is dropped, with a sentence.
        poses: number of poses looked at along the motion.
        table_error: height by which a table on which the payload is put down may be higher than planned, m.
        task_part: part of what the task allows up to which errors are expected, above 0; a forecast is within
            a factor of two of the run, and changes a little with the poses.

    Raises:
        InfeasibleMotionError: the cell cannot do it, with the cause: rank, reach, singularity, limits, torque
            or stability.
        UrdfError, NameNotFoundError, FileReadError: an arm or the motion cannot be built.
        ArgumentError: patches hold together with other grasps, or tables are under rigid ones.
    """
    if isinstance(scenario, str | Path):
        scenario = Scenario.load(scenario, draft=True)
    require_type("scenario", scenario, Scenario)
    poses = as_fitting_count("poses", poses, 5, POSE_SIZE)
    task_part = as_positive("task_part", task_part)
    if scenario.cell.driven:
        return _for_driven(scenario, poses, table_error, task_part)
    cell, pressed = scenario.cell, tuple[str, ...]()
    if cell.jointed or cell.payload.links is not None:
        return _for_joints(scenario, poses)
    if cell.tools:
        return _for_tools(scenario, poses)
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
    scenario, part = _squeezed(scenario, statics)
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
    proposal, suggested, loop = stable_proposal(scenario, cell_reach, table_error)
    if cell.unclosed:
        suggested, too_large = held_by_squeeze(suggested, cell_reach)
        pressed = (*pressed, *too_large)
    suggested, errors = anchored_enough(suggested, cell_reach)
    suggested, errors, slowed = _slowed(with_steps(suggested, cell_reach), errors, poses, task_part)
    pressed_table = table_force(suggested, table_error=table_error, lag=proposal.tracking)
    lines = (
        *gain_limits(scenario, proposal, suggested),
        *friction_limits(suggested),
        *([] if pressed_table is None else [pressed_table.summary()]),
        *null_space_limits(proposal, loop),
        *moment_limits(scenario, proposal),
        *margins,
        "squeeze: as stated" if part == 1.0 else f"squeeze: {part:.2f} of what is stated, by the drives",
        f"plant: {suggested.clock.steps_per_tick} steps in a tick; {sampled_stability(suggested).summary()}",
    )
    return Suggestion(suggested, proposal, lines, (*slowed, *changes, *pressed), errors)


def _slowed(
    scenario: Scenario, expected: Forecast, poses: int, part: float
) -> tuple[Scenario, Forecast, tuple[str, ...]]:
    """Return a proposal at the speed at which it has its part of the task, the forecast, and what changes."""
    fields, slower = slower_motion(scenario, expected, poses, part)
    if not fields:
        return scenario, expected, ()
    shown = ", ".join(f"{field} {value:.4g}" for field, value in fields.items())
    why = f"at the stated speed {worst_error(scenario, expected)[2]}"
    return scenario.override(fields), slower, (f"motion SLOWED ({shown}): {why}",)


def _for_driven(scenario: Scenario, poses: int, table_error: float, task_part: float) -> Suggestion:
    """Return a proposal for arms on shared joints or rolling bases; arguments as of ``suggest``."""
    relative = seen_by_arms(scenario)
    proposal = suggest(relative, poses=poses, table_error=table_error, task_part=task_part)
    arms = {
        name: arm.replace(mobile_base=scenario.cell.arms[name].mobile_base)
        for name, arm in proposal.scenario.cell.arms.items()
    }
    cell = proposal.scenario.cell.replace(shared_joints=scenario.cell.shared_joints, arms=arms)
    motion = proposal.scenario.motion if relative.motion == scenario.motion else scenario.motion
    return replace(proposal, scenario=proposal.scenario.replace(cell=cell, motion=motion))


def _for_tools(scenario: Scenario, poses: int) -> Suggestion:
    """Return a proposal for arms of which some have tools; raises as ``suggest``."""
    require_rank(scenario.cell)
    cell_reach = _feasible(scenario, poses)
    suggested, limit = with_tool_gains(scenario, cell_reach)
    uncovered = "it is for arms that hold one payload, and some have tools"
    return _as_stated(scenario, with_steps(suggested, cell_reach), (limit,), uncovered)


def _for_joints(scenario: Scenario, poses: int) -> Suggestion:
    """Return a proposal for joints of grasps or of the payload; raises as ``suggest``."""
    cell_reach = _feasible(scenario, poses)
    if not (leave := freedoms(scenario)).ok:
        raise InfeasibleMotionError("rank", leave.summary())
    suggested, limits = with_joint_gains(scenario, cell_reach)
    uncovered = "it is for rigid grasps of one body, and there are joints of grasps or payload"
    return _as_stated(scenario, suggested, limits, uncovered)


def _feasible(scenario: Scenario, poses: int) -> Reachability:
    """Return the reach of a motion that the arms can follow and hold, in their stated postures."""
    cell_reach = reachability(scenario, poses=poses)
    require_feasible(scenario, cell_reach, statics_along(scenario, cell_reach))
    return cell_reach


def _as_stated(
    scenario: Scenario, suggested: Scenario, limits: tuple[str, ...], uncovered: str
) -> Suggestion:
    """Return a proposal that changes the law, and the steps in a tick that its wrists ask for."""
    limits = (*limits, f"plant: {suggested.clock.steps_per_tick} steps in a tick")
    kinds = [each.controller.kind for each in (scenario, suggested)]
    changed = f"law CHANGED from {kinds[0]!r} to {kinds[1]!r}: gains for such a cell are proposed for it"
    return Suggestion(
        suggested, None, limits, (changed,) * (kinds[0] != kinds[1]), Forecast(uncovered=uncovered)
    )


def _squeezed(scenario: Scenario, statics: StaticTorques) -> tuple[Scenario, float]:
    """Return the scenario with the part of its squeeze that the drives hold, and that part.

    Raises:
        InfeasibleMotionError: cause "torque": patches carry the payload only with more.
    """
    part = squeeze_part(statics)
    if part < 1.0:
        scenario = scenario.replace(squeeze=scenario.squeeze.scaled(part))
        if (least := least_squeeze(scenario)) is not None and not least.ok:
            raise InfeasibleMotionError(
                "torque", f"{least.summary().removeprefix('! ')}; the drives hold no more"
            )
    return scenario, part


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
