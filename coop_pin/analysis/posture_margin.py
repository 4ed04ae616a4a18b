"""Postures with the largest margin of torque, joint range and singularity along a scenario's motion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coop_pin.analysis.reachability import Reachability, reachability
from coop_pin.analysis.statics import StaticTorques, statics_along
from coop_pin.chain.inverse_kinematics import ik_branches
from coop_pin.description.scenario import Scenario
from coop_pin.errors import InfeasibleMotionError
from coop_pin.model.cell_arm import CellArm

_BRANCHES = 8
"""Branches of each arm that are followed along the motion, the nearest to its posture."""
_POSES = 41
"""Largest number of poses on each branch."""


class PostureMargin(NamedTuple):
    """Parts of its limits that an arm has left along the motion: 1 is all, 0 or less is none.

    Attributes:
        arm: its name.
        torque: 1 - |torque| / limit at rest, for weight and load.
        position: distance to the nearer position limit over half of the range, of joints that limit the
            workspace.
        singularity: 1 - condition number of the payload Jacobian over what the scenario trusts.
    """

    arm: str
    torque: float
    position: float
    singularity: float

    @property
    def least(self) -> float:
        """The smallest of them."""
        return min(self.torque, self.position, self.singularity)


def posture_margins(
    scenario: Scenario, found: Reachability, statics: StaticTorques
) -> Iterator[PostureMargin]:
    """Yield the margins of each arm; -inf for one that cannot follow at all."""
    for reach, arm in zip(found.arms, statics.arms, strict=True):
        if not reach.ok:
            yield PostureMargin(reach.arm, -np.inf, -np.inf, -np.inf)
            continue
        limits = CellArm(scenario.cell, reach.arm).limits
        used = np.abs(arm.weight + arm.load) / arm.limit
        positions = limits.joints.of(reach.q)
        gap = np.minimum(positions - limits.lower, limits.upper - positions)
        left = np.where(
            limits.limited, gap / (0.5 * np.minimum(limits.upper - limits.lower, 2.0 * np.pi)), 1.0
        )
        allowed = scenario.trust.jacobian_condition
        yield PostureMargin(
            reach.arm,
            1.0 - float(used.max()),
            float(left.min()),
            1.0 - float(reach.condition.max()) / allowed,
        )


def with_best_postures(scenario: Scenario, poses: int) -> Scenario:
    """Return the scenario with each arm on the branch with the largest margin; stated angles are kept.

    Raises:
        InfeasibleMotionError: cause "reach": an arm cannot hold the start, or no branch reaches a pose.
    """
    if scenario.start_angles:
        return scenario
    count = min(poses, _POSES)
    _require_reach(reachability(scenario, poses=count))
    postures: dict[str, list[tuple[float, ...]]] = {}
    for name, arm in scenario.cell.arms.items():
        model = CellArm(scenario.cell, name)
        branches = ik_branches(model, scenario.start.matrix, posture=arm.posture or _middle(model))
        postures[name] = [tuple(model.joint_angles(q).tolist()) for q in branches[:_BRANCHES]]
    best: dict[str, tuple[float, int]] = {}
    for index in range(max(map(len, postures.values()))):
        tried = _with_postures(
            scenario, {name: found[index % len(found)] for name, found in postures.items()}
        )
        found = reachability(tried, poses=count)
        for margin in posture_margins(tried, found, statics_along(tried, found)):
            best[margin.arm] = max(best.get(margin.arm, (-np.inf, 0)), (margin.least, -index))
    return _with_postures(
        scenario, {name: found[-best[name][1] % len(found)] for name, found in postures.items()}
    )


def _require_reach(found: Reachability) -> None:
    """Refuse poses that no branch of an arm reaches: the search among them would be long."""
    for reach in found.arms:
        gap = reach.unreachable
        if reach.start_error is not None or (gap is not None and not gap.other_branch):
            raise InfeasibleMotionError("reach", f"arm {reach.arm!r} {'; '.join(reach.problems())}")


def _with_postures(scenario: Scenario, postures: dict[str, tuple[float, ...]]) -> Scenario:
    arms = {name: arm.replace(posture=postures[name]) for name, arm in scenario.cell.arms.items()}
    return scenario.replace(cell=scenario.cell.replace(arms=arms))


def _middle(model: CellArm) -> tuple[float, ...]:
    """Return the joint angles in the middle of the limits; zero without limits."""
    limits = model.limits
    with np.errstate(invalid="ignore"):
        middle = (limits.lower + limits.upper) / 2.0
    return tuple(np.where(np.isfinite(middle), middle, 0.0).tolist())
