"""Feasibility of a motion: rank, reach, singularity, limits, static torques, squeeze, best postures."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, typed
from coop_pin.base.errors import (
    InfeasibleMotionError,
    JointLimitError,
    OpenClosureError,
    UnreachablePoseError,
)
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose
from coop_pin.base.spatial.task_rows import joint_shortage
from coop_pin.description.cell.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.cell_distances import CellDistances
from coop_pin.feasibility.distances import Distances, measured
from coop_pin.feasibility.reachability import ArmReach, Reachability, reachability
from coop_pin.feasibility.statics import StaticTorques, statics_along
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.inverse_kinematics import ik_branches
from coop_pin.model.joint_limits import PASSIVE

_NEARBY = 0.1
"""Distance of the joints to a configuration nearby, rad or m."""
_TORQUE_PART = 0.9
"""Part of the torque limit that holding may need: the rest is for the motion and its control."""
_BRANCHES, _POSES = 8, 41
"""Branches of each arm that are followed along the motion, the nearest to its posture, and most poses."""
_NARROW, _OPENED = 0.1, 0.05
"""Part of a joint's range below which turns of the grasp are tried, and what they must open."""
_ROLLS = (np.pi, np.pi / 2.0, -np.pi / 2.0)
"""Turns of a grasp about its own z axis, rad."""


def require_rank(cell: Cell) -> None:
    """Refuse an arm with fewer joints than task rows, or than its grasp holds where that is a joint.

    Raises:
        InfeasibleMotionError: cause "rank".
    """
    for name in cell.arms:
        arm = CellArm(cell, name)
        if arm.spare < 0:
            rows = (arm.grasp_rows or arm.rows).size
            raise InfeasibleMotionError("rank", f"arm {name!r} has {joint_shortage(arm.nv, rows)}")


@typed
def closure_problem(scenario: Scenario) -> str:
    """Return why the closed chain is singular at the start, or "": closures that lose rank there.

    Between arms that all lack a direction there (level tools of five-joint arms, for example) the closures
    have a smaller rank than at configurations nearby. Then neither the motions of the chain nor its internal
    wrenches are determined: a push opens new motions, and the energy of a run is not explained by work.
    Closures that are redundant everywhere, as between planar arms, are no problem.

    Args:
        scenario: whose start every arm reaches.
    """
    chain, X_WP = CellChain(scenario.cell, scenario.plant), scenario.start.matrix
    stated = scenario.start_angles
    q = chain.posed_configuration(stated, X_WP) if stated else chain.configuration(X_WP)
    model = chain.mechanism.model
    away = _NEARBY * np.random.default_rng(0).normal(size=model.nv)
    near = pin.integrate(model, q, away)
    if scenario.cell.jointed or chain.joints is not None:  # they keep a payload in the plane of its arms
        for part in (1.0, _NEARBY) if scenario.cell.is_pulled else (1.0,):  # a rope's slack is small
            with contextlib.suppress(OpenClosureError):
                near = chain.mechanism.project_configuration(pin.integrate(model, q, part * away))
                break
        else:
            return "the closed chain is singular at the start: nothing near it is closed, as of a taut chain"
    here, nearby = (chain.mechanism.rank(at) for at in (q, near))
    if here >= nearby:
        return ""
    return (
        f"the closed chain is singular at the start: its closures have rank {here} there and {nearby} nearby,"
        " because the arms lack the same direction. Turn a grasp, tilt a tool, or use arms with six joints"
    )


def require_feasible(scenario: Scenario, cell_reach: Reachability, statics: StaticTorques) -> None:
    """Refuse a motion that the arms cannot follow on their best branches, or cannot hold.

    Raises:
        InfeasibleMotionError: cause "reach", "singularity", "limits" or "torque".
    """
    allowed = scenario.trust.jacobian_condition
    for reach in cell_reach.arms:
        detail = f"arm {reach.arm!r} {'; '.join(reach.problems())}"
        if reach.start_error is not None or reach.unreachable is not None:
            raise InfeasibleMotionError("reach", detail)
        if float(reach.condition.max()) > allowed:
            worst = f"condition number {float(reach.condition.max()):.3g} (allowed {allowed:g})"
            raise InfeasibleMotionError("singularity", f"arm {reach.arm!r} passes a pose of {worst}")
        if not reach.ok:
            raise InfeasibleMotionError("limits", detail)
    if singular := closure_problem(scenario):
        raise InfeasibleMotionError("singularity", singular)
    for arm in statics.arms:
        used = arm.used
        if float(used.max()) > _TORQUE_PART:
            at, k = np.unravel_index(int(used.argmax()), used.shape)
            remedy = f"It is passive (effort 0): if a drive moves it, state cell.arms.{arm.arm}.torque_limits"
            remedy = remedy if arm.limit[k] <= PASSIVE else _lighter(scenario, statics)
            raise InfeasibleMotionError(
                "torque",
                f"{arm.arm}/{arm.joints[k]} needs {used[at, k] * arm.limit[k]:.3g} of {arm.limit[k]:.3g}"
                f" {arm.units[k]} to stand still at t = {arm.times[at]:.4g} s without squeeze: arm's weight"
                f" {abs(arm.weight[at, k]):.3g}, load share {abs(arm.load[at, k]):.3g}; at most"
                f" {_TORQUE_PART:g} of the limit leaves room for the motion. {remedy}",
            )


def _lighter(scenario: Scenario, statics: StaticTorques) -> str:
    """Return the mass that the drives can hold at these configurations, as advice."""
    part = min(part_held(arm.weight, arm.load, arm.limit) for arm in statics.arms)
    if not 0.0 < part < 1.0:
        limits = "<limit effort> in its URDF, or torque_limits of the arm"
        return (
            f"The arm's own weight is too much: correct {limits}, or take a stronger arm or another posture"
        )
    mass = scenario.cell.payload.mass
    return f"Lower the payload's mass from {mass:g} to {math.floor(100.0 * part * mass) / 100.0:g} kg"


def squeeze_part(statics: StaticTorques) -> float:
    """Return the largest part of the squeeze, at most 1, that the drives can hold besides weight and load."""
    part = min(1.0, *(part_held(arm.weight + arm.load, arm.squeeze, arm.limit) for arm in statics.arms))
    return part if part == 1.0 else math.floor(100.0 * part) / 100.0


def part_held(fixed: Array, varied: Array, limit: Array) -> float:
    """Return the largest part of some torques that the drives can hold besides others, N m, shape (n, k)."""
    holding = np.copysign(fixed, fixed * varied)
    with np.errstate(divide="ignore", invalid="ignore"):
        held = (_TORQUE_PART * limit - holding) / np.abs(varied)
    return float(np.where(varied == 0.0, np.inf, held).min())


class PostureMargin(NamedTuple):
    """Parts of its limits that an arm has left along the motion: 1 is all, 0 or less is none.

    Attributes:
        arm: arm name.
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
    scenario: Scenario, cell_reach: Reachability, statics: StaticTorques
) -> Iterator[PostureMargin]:
    """Yield the margins of each arm; -inf for one that cannot follow at all."""
    for reach, arm in zip(cell_reach.arms, statics.arms, strict=True):
        if not reach.ok:
            yield PostureMargin(reach.arm, -np.inf, -np.inf, -np.inf)
            continue
        yield PostureMargin(
            reach.arm,
            1.0 - float(arm.used.max()),
            CellArm(scenario.cell, reach.arm).limits.margin(reach.q),
            1.0 - float(reach.condition.max()) / scenario.trust.jacobian_condition,
        )


def with_best_postures(scenario: Scenario, poses: int) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario with each arm on the branch with the largest margin, and the grasps turned for it.

    A grasp is turned about its own z axis where less than a tenth of a joint's range is left and more is left
    then, first by half a turn, which a gripper's jaws do not see. Stated angles are kept.

    Raises:
        InfeasibleMotionError: cause "reach": an arm cannot hold the start, or no branch reaches a pose.
    """
    if scenario.start_angles:
        return scenario, ()
    count, turned = min(poses, _POSES), list[str]()
    reaches = {each.arm: each for each in reachability(scenario, poses=count).arms}
    bodies = _Bodies(CellDistances(scenario.cell), reaches)
    for name, reach in tuple(reaches.items()):
        if not isinstance(reach.start_error, JointLimitError):  # a turn may help against limits only
            _require_reach(reach)
        best, stated = _best_posture(scenario, name, count, bodies)
        patch = scenario.cell.patches.get(name)
        may_turn = patch is None or (patch.size is None and patch.press in ("z", "-z"))  # about its normal
        for roll in _ROLLS if may_turn and stated.position < _NARROW else ():
            tried, margin = _best_posture(_rolled(scenario, name, roll), name, count, bodies)
            if margin.position > max(stated.position, 0.0) + _OPENED and margin.least > stated.least:
                best = tried
                left, before = 100.0 * margin.position, max(100.0 * stated.position, 0.0)
                sentence = f"grasp of {name} TURNED by {np.degrees(roll):.0f} degrees about its own z axis"
                turned.append(
                    f"{sentence}: {left:.0f} % of the joint range are left, {before:.0f} % as stated"
                )
                break
        if best is None:
            _require_reach(reach)
        scenario = best or scenario
        reaches |= {each.arm: each for each in reachability(scenario, poses=count, arms=[name]).arms}
    along = bodies.along(scenario)
    if along is not None and not along.ok:
        kept = f"no postures were seen that keep the clearance of {1e3 * along.clearance:g} mm"
        turned.append(f"distance: {kept}: {along.below[0]}; move a base or grasp, or take a smaller payload")
    return scenario, tuple(turned)


class _Bodies(NamedTuple):
    """Bodies of a cell, and the reach of its arms on their present branches, with the same poses."""

    distances: CellDistances
    reaches: dict[str, ArmReach]

    def along(self, scenario: Scenario, *changed: ArmReach) -> Distances | None:
        """Return the distances with some arms on another branch; None if some do not reach all poses."""
        reaches = list((self.reaches | {reach.arm: reach for reach in changed}).values())
        if len({len(each.q) for each in reaches}) > 1:
            return None
        first = CellArm(scenario.cell, reaches[0].arm)
        poses = [first.payload_pose(q) for q in reaches[0].q]
        arms = [list(q) for q in zip(*(each.q for each in reaches), strict=True)]
        return measured(scenario, self.distances, reaches[0].times, arms, poses)


def _best_posture(
    scenario: Scenario, name: str, poses: int, bodies: _Bodies
) -> tuple[Scenario | None, PostureMargin]:
    """Return the scenario with an arm on its branch with the largest margin; None if it has no branch.

    A branch with a joint below the plane on which the arm is mounted comes after those without, and then one
    on which bodies come closer than the clearance.
    """
    best, largest, best_is_clear = None, PostureMargin(name, -np.inf, -np.inf, -np.inf), (False, False)
    model, arm = CellArm(scenario.cell, name), scenario.cell.arms[name]
    with contextlib.suppress(UnreachablePoseError):
        branches = ik_branches(model, scenario.start.matrix, posture=arm.posture or _middle(model))
        for q in branches[:_BRANCHES]:
            tried = scenario.override({f"cell.arms.{name}.posture": model.joint_angles(q)})
            reach = reachability(tried, poses=poses, arms=[name])
            (margin,) = posture_margins(tried, reach, statics_along(tried, reach))
            is_above = min(joint_heights(model, q, arm.base.matrix).values()) >= 0.0
            along = bodies.along(tried, reach.arms[0])
            is_clear = is_above, along is None or along.ok
            if best is None or (is_clear, margin.least) > (best_is_clear, largest.least):
                best, largest, best_is_clear = tried, margin, is_clear
    return best, largest


def joint_heights(model: ArmModel, q: Array, X_WB: Array | None = None) -> dict[str, float]:
    """Return the heights of the joints of an arm, m, by joint; without a mobile base's.

    Args:
        model: model of the arm.
        q: configuration.
        X_WB: pose of its base; heights are then above the plane on which it is mounted, else in the world.
    """
    data, X = model.model.createData(), np.eye(4) if X_WB is None else X_WB
    pin.forwardKinematics(model.model, data, q)
    joints = list(zip(model.model.names, data.oMi, strict=True))[1 + model.base_joints :]
    up, origin = X[:3, 2], X[:3, 3]
    return {name.partition("/")[2]: float(up @ (X_WJ.translation - origin)) for name, X_WJ in joints}


def _require_reach(reach: ArmReach) -> None:
    """Refuse poses that no branch of an arm reaches: the search among them would be long."""
    gap = reach.unreachable
    if reach.start_error is not None or (gap is not None and not gap.other_branch):
        raise InfeasibleMotionError("reach", f"arm {reach.arm!r} {'; '.join(reach.problems())}")


def _rolled(scenario: Scenario, name: str, roll: float) -> Scenario:
    """Return the scenario with the grasp of an arm turned about its own z axis."""
    X_PE = scenario.cell.grasps[name].matrix @ make_pose((0.0, 0.0, 0.0), (0.0, 0.0, roll))
    pose, path = Pose.from_matrix(X_PE), f"cell.grasps.{name}"
    return scenario.override({f"{path}.xyz": pose.xyz, f"{path}.rpy": pose.rpy})


def _middle(model: CellArm) -> tuple[float, ...]:
    """Return the joint angles in the middle of the limits; zero without limits."""
    limits = model.limits
    with np.errstate(invalid="ignore"):
        middle = (limits.lower + limits.upper) / 2.0
    return tuple(np.where(np.isfinite(middle), middle, 0.0).tolist())
