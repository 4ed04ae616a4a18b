"""Reachability of a reference: reach, singular poses, joint limits and speeds of all arms, without a run."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from coop_pin.base.arrays import Array, as_fitting_count, frozen, require_type
from coop_pin.base.errors import NameNotFoundError, UnreachablePoseError
from coop_pin.base.spatial.task_rows import joint_shortage
from coop_pin.control.terms import CONDITION_LIMIT
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.path_following import (
    FastestJoint,
    JointLimitMargin,
    NearlySingular,
    PathFollowing,
    PayloadPath,
    Unreachable,
    payload_path,
    with_free_turn,
)
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.inverse_kinematics import solve_ik

POSE_SIZE = 4096.0
"""Memory of a pose of a motion that is looked at, bytes."""


@dataclass(frozen=True, eq=False)
class ArmReach:
    """Reachability of the reference for one arm.

    Attributes:
        arm: arm name.
        times: times of the poses, s, shape (n,). The first ones, at t = 0, lead from the scenario's start to
            the reference.
        q: configurations that hold the payload there, shape (n, nq); the nearest ones out of reach.
        sigma_min: smallest singular value of the payload Jacobian in task rows and drive coordinates, shape
            (n,).
        condition: condition number of it, shape (n,).
        joint_shortage: counts and remedy if it has fewer joints than the cell has task rows and its grasp is
            no joint; otherwise "".
        start_error: the arm cannot hold the start; then the arrays are empty and nothing else is known.
        unreachable: the arm cannot follow; None if it can.
        nearest_singularity: pose closest to a singular one; None with too few joints.
        limit_violation: the first joint that exceeds its position limits; None if there is none.
        smallest_margin: the joint with the smallest margin to a position limit; None without limits.
        fastest_joint: the joint closest to its velocity limit; None without limits.
    """

    arm: str
    times: Array
    q: Array
    sigma_min: Array
    condition: Array
    joint_shortage: str = ""
    start_error: UnreachablePoseError | None = None
    unreachable: Unreachable | None = None
    nearest_singularity: NearlySingular | None = None
    limit_violation: JointLimitMargin | None = None
    smallest_margin: JointLimitMargin | None = None
    fastest_joint: FastestJoint | None = None

    @property
    def first(self) -> int:
        """Index of the pose at which the reference begins."""
        return int(np.count_nonzero(self.times == 0.0)) - 1

    @property
    def ok(self) -> bool:
        """Whether the arm can follow within its limits and away from singular poses."""
        return not any(self.problems())

    def problems(self) -> Iterator[str]:
        """Yield one sentence for each reason why the arm cannot follow."""
        if self.joint_shortage:
            yield f"has {self.joint_shortage}"
        if self.start_error is not None:
            yield f"cannot hold the payload at the start: {self.start_error}"
        if (gap := self.unreachable) is not None:
            branch = " on this branch; another branch reaches the pose: change the posture"
            yield (
                f"cannot follow from t = {gap.time:.4g} s on: at t = {gap.gap_time:.4g} s it misses its grasp"
                f" by {gap.gap_m:.3g} m and {gap.gap_rad:.3g} rad{branch if gap.other_branch else ''}"
            )
        if (near := self.nearest_singularity) is not None and not near.condition < CONDITION_LIMIT:
            yield f"is singular at t = {near.time:.4g} s: no controller can follow through that pose"
        if (at := self.limit_violation) is not None:
            yield (
                f"{at.joint} exceeds its limits {at.lower:.4g} to {at.upper:.4g} {at.unit}"
                f" at t = {at.time:.4g} s"
            )
        if (fast := self.fastest_joint) is not None and fast.speed > fast.limit:
            yield (
                f"{fast.joint} must move at {fast.speed:.3g} {fast.unit} at t = {fast.time:.4g} s;"
                f" its limit is {fast.limit:.3g}"
            )

    def margins(self) -> Iterator[str]:
        """Yield one line for each margin: to singular poses, position limits and velocity limits."""
        if (near := self.nearest_singularity) is not None:
            yield (
                f"closest to singular: sigma_min {near.sigma_min:.3g}, condition {near.condition:.3g}"
                f" at t = {near.time:.4g} s"
            )
        if (at := self.smallest_margin) is not None:
            yield (
                f"smallest limit margin: {at.joint}, {at.margin:.3g} {at.unit} at t = {at.time:.4g} s"
                f" (position {at.value:.4g})"
            )
        if (fast := self.fastest_joint) is not None:
            yield (
                f"fastest joint: {fast.joint}, {fast.speed:.3g} of {fast.limit:.3g} {fast.unit}"
                f" at t = {fast.time:.4g} s"
            )


@dataclass(frozen=True, eq=False)
class Reachability:
    """Reachability of a scenario's reference for all arms.

    Attributes:
        scenario: scenario name.
        duration: s.
        poses: number of poses of the reference that were checked.
        arms: findings in the order of the cell.
    """

    scenario: str
    duration: float
    poses: int
    arms: tuple[ArmReach, ...]

    @property
    def ok(self) -> bool:
        """Whether every arm can follow within its limits and away from singular poses."""
        return all(arm.ok for arm in self.arms)

    def summary(self) -> str:
        """Return the findings as text, some lines for each arm."""
        verdict = f"the motion is {'' if self.ok else 'not '}kinematically feasible"
        lines = [
            f"{self.scenario}: {verdict} ({self.poses} poses of the reference, 0 to {self.duration:g} s)"
        ]
        for arm in self.arms:
            lines.append(f"  {arm.arm}: {'ok' if arm.ok else 'not ok'}")
            lines += [f"    ! {problem}" for problem in arm.problems()]
            lines += [f"    {margin}" for margin in arm.margins()]
        return "\n".join(lines)


def reachability(
    scenario: Scenario, *, poses: int = 401, arms: Collection[str] | None = None
) -> Reachability:
    """Return the reachability of a scenario's reference, on the branches that a run would start on.

    The path leads from the scenario's start straight to the beginning of the reference, and then along the
    reference; on positional rows the payload turns as the closed chain lets it. Gains, friction, torques and
    collisions are not considered.

    Args:
        scenario: scenario that would be run.
        poses: number of poses of the reference to check, evenly spaced in time; anything shorter than the
            spacing is missed.
        arms: names of the arms to look at; all when omitted.

    Raises:
        WrongTypeError, OutOfRangeError: poses is not a whole number of at least two.
        UrdfError, NameNotFoundError, FileReadError: an arm or the motion cannot be built, or there is no arm
            of a name.
    """
    require_type("scenario", scenario, Scenario)
    poses = as_fitting_count("poses", poses, 2, POSE_SIZE)
    names = list(scenario.cell.arms if arms is None else arms)
    if strangers := [name for name in names if name not in scenario.cell.arms]:
        raise NameNotFoundError("arm", str(strangers[0]), scenario.cell.arms, "the cell")
    together = payload_path(scenario, poses)
    if scenario.cell.rows == "positional":
        together = with_free_turn(scenario, together)
    alone = {name: payload_path(scenario, poses, name) for name in scenario.cell.tools}
    reaches = tuple(_arm_reach(scenario, name, alone.get(name, together)) for name in names)
    return Reachability(scenario.name, scenario.duration, poses, reaches)


def _arm_reach(scenario: Scenario, name: str, path: PayloadPath) -> ArmReach:
    model, rows = CellArm(scenario.cell, name), scenario.cell.task_rows.size
    is_short = model.nv < rows and model.grasp_rows is None  # beside a joint the motion decides
    shortage = joint_shortage(model.nv, rows) if is_short else ""
    try:
        q = solve_ik(model, path.poses[0], posture=model.description.posture)
    except UnreachablePoseError as error:
        empty = frozen(np.zeros(0))
        no_q = frozen(np.zeros((0, model.nq)))
        return ArmReach(name, empty, no_q, empty, empty, joint_shortage=shortage, start_error=error)
    following = PathFollowing(model, path, q)
    return ArmReach(
        name,
        path.times,
        following.q,
        following.sigma_min,
        following.condition,
        joint_shortage=shortage,
        unreachable=following.unreachable(),
        nearest_singularity=following.nearest_singularity(),
        limit_violation=following.limit_violation(),
        smallest_margin=following.smallest_margin(),
        fastest_joint=following.fastest_joint(),
    )
