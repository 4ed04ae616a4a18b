"""Placement of arms around a payload: bases where the arms have the largest margins."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Self

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import exp3, inverse_pose, task_rows
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.grasp import JointGrasp
from coop_pin.description.thresholds import TrustThresholds
from coop_pin.design.placing.contacts import Contact, Shoulders
from coop_pin.design.placing.tool_axes import tool_axis, triad
from coop_pin.feasibility.cell_summary import maximum_reach
from coop_pin.feasibility.motion_feasibility import joint_heights
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.ik_solver import IKSolver

_DISTANCES = (0.4, 0.5, 0.6, 0.7, 0.8)
"""Distances from base to tip that are tried, over the reach of the arm."""
_SHOULDER_DISTANCES = (0.3, 0.4, 0.5, 0.6)
"""Likewise for the arms of one robot, whose shoulders lie before and beside its base."""
_ROLLS = (0.0, np.pi / 2.0, np.pi, -np.pi / 2.0)
"""Turns of a tool about its approach that are tried, rad."""
_SEEDS, _SHARED_SEEDS, _STEPS = 4, 12, 60
"""Initial guesses of the inverse kinematics of an arm, of one whose base others share, and steps of each."""
_IN_RANGE = 0.02
"""Least part of a joint's range that is left around the start: the motion and the squeeze take some."""
_CONDITION = TrustThresholds().jacobian_condition
"""Condition number of an arm that leaves no margin: a run beyond it is not trustworthy."""
_GRAVITY = np.array((0.0, 0.0, -9.81))
_SAMPLES, _ONE_WAY = 200, 0.3
"""Configurations that are compared, and mean way of the tip over its mean distance from which on an arm
reaches one way: 0.5 and more of real ones, and below 0.2 of those that turn around."""
_SMALL = 1e-9
"""Numbers that count as zero."""
_HINGED = 5
"""Number of joints of an arm whose grasp is a hinge: it leaves free the turn that the arm lacks."""


class Place(NamedTuple):
    """Base and grasp of one arm.

    Attributes:
        margin: least part of torque, joint range and condition number that is left around the start.
        base: X_WB.
        grasp: X_PE; of five joints a hinge.
        posture: joint angles at the start, rad or m.
    """

    margin: float
    base: Pose
    grasp: Pose
    posture: tuple[float, ...]


class Hold(NamedTuple):
    """Grasp at one turn of the tool about its approach.

    Attributes:
        grasp: X_PE; a hinge of an arm that has as many joints as that holds rows.
        solver: inverse kinematics, which leave the turn of a hinge free.
    """

    grasp: Pose
    solver: IKSolver


class ArmPlacement:
    """Search for the base of one arm.

    Attributes:
        name: arm name.
        reach: maximum reach of the arm, m.
        farthest: largest distance of its base from the payload's centre, m.
        is_planar: whether its tip moves in a horizontal plane.
        holds: grasp at each turn of the tool about its approach.
        is_hinged: whether it has five joints: a hinge across the tool frees the turn that it lacks.
        plane: height of the tip above the base at zero joint angles, m.
        slides: names of its prismatic joints.
        tip_heights: least and largest height of the tip above the base, m.
        stand: height of its base above the ground, m.
        shoulders: shoulders of the robot that the arm belongs to; None of an arm with a base of its own.
    """

    def __init__(
        self, name: str, arm: Arm, contact: Contact, load: float, shoulders: Shoulders | None = None
    ) -> None:
        """Build the arm's model on the ground.

        Args:
            name: arm name.
            arm: the arm; its base is not used.
            contact: contact by which it holds the payload; a planar arm does so at the height of P, its tool
                as it is.
            load: share of the payload's mass, kg.
            shoulders: shoulders of the robot that the arm belongs to; None of an arm with a base of its own.
        """
        self.shoulders = shoulders
        self._model = model = ArmModel(arm.replace(base=Pose()), name=name)
        self.name, self.reach = name, maximum_reach(arm)
        kinds = arm.robot.joints
        self.slides = [joint for joint in arm.moving_joints() if kinds[joint] == "prismatic"]
        q = model.posture(arm.posture)
        count = _SHARED_SEEDS if contact.one_base else _SEEDS
        self._seeds = [q, *model.limits.random_configurations(count - 1)]
        self.is_planar = all(np.abs(model.payload_jacobian(seed)[2:5]).max() < _SMALL for seed in self._seeds)
        X_BE, tool = model.tip_pose(q), tool_axis(model, q)
        self.plane = float(X_BE[2, 3])
        if self.is_planar:
            contact = contact._replace(point=contact.point * (1.0, 1.0, 0.0), approach=X_BE[:3, :3] @ tool)
        self._contact, self._load = contact._replace(point=np.round(contact.point, 4) + 0.0), load * _GRAVITY
        self._direction = np.array((np.cos(contact.around), np.sin(contact.around), 0.0))
        self._offset = max(0.0, float(contact.point @ self._direction))
        self.farthest = self._offset + self.reach
        self.is_hinged = model.nv == _HINGED and not self.is_planar
        across = np.eye(3)[2] if abs(contact.approach[2]) < 0.5 else self._direction
        R_WE = triad(contact.approach, across) @ triad(tool, np.eye(3)[np.abs(tool).argmin()]).T
        tips = np.array([model.tip_pose(q)[:3, 3] for q in model.limits.random_configurations(_SAMPLES)])
        self.tip_heights, self.stand = (float(tips[:, 2].min()), float(tips[:, 2].max())), 0.0
        self._facing = 0.0 if self.is_planar else _facing(tips[:, :2])
        self.holds = [self._hold(exp3(roll * contact.approach) @ R_WE, across) for roll in _ROLLS]
        self._rows = task_rows("planar" if self.is_planar else "full")

    def _hold(self, R_PE: Array, across: Array) -> Hold:
        """Return the grasp with an orientation; where it is a hinge, that turns about an axis of P."""
        X_PE = np.eye(4)
        X_PE[:3, :3], X_PE[:3, 3] = R_PE, self._contact.point
        grasp = Pose(**Pose.from_matrix(X_PE).by_axis())
        if self.is_hinged:
            axis = (np.round(R_PE.T @ across, 6) + 0.0).tolist()
            grasp = hinge = JointGrasp(xyz=grasp.xyz, rpy=grasp.rpy, axis=axis)
            self._model.to_held_rows = hinge.to_held_rows
        return Hold(grasp, IKSolver(self._model))

    @property
    def distances(self) -> list[float]:
        """Distances of the base from the payload's centre that are tried, m."""
        parts = _SHOULDER_DISTANCES if self._contact.one_base else _DISTANCES
        return [self._offset + part * self.reach for part in parts]

    def own_weight(self) -> tuple[float, str]:
        """Return the part of a drive's torque that holds the arm alone where it is least, and its joint."""
        model, limits = self._model, self._model.limits
        rest, postures = np.zeros(model.nv), limits.random_configurations(_SAMPLES)
        torques = np.array([model.nonlinear_effects(q, rest) @ model.from_drive for q in postures])
        parts = np.abs(torques / limits.torque)
        best = int(parts.max(axis=1).argmin())
        worst = int(parts[best].argmax())
        return float(parts[best, worst]), limits.joints.names[worst]

    def raised(self) -> Self:
        """Return the search with a base so high that the tip just reaches down to the ground."""
        search = copy.copy(self)
        search.stand = round(max(0.0, -self.tip_heights[0]), 2)
        return search

    def best(
        self, height: float, stroke: float, distances: Sequence[float], origin: Shoulders | None = None
    ) -> Place | None:
        """Return the place with the largest margin; None if the arm cannot hold the payload from any.

        Args:
            height: height of the payload's centre, m.
            stroke: distance from the start of the poses around it, m.
            distances: distances of the base from the payload's centre that are tried, m.
            origin: point of a robot from which they count, and which way is forward.
        """
        best: Place | None = None
        X_WP = Pose(xyz=(0.0, 0.0, height)).matrix
        for distance, hold in itertools.product(distances, self.holds):
            base = self.base(distance, height, origin)
            X_BP = inverse_pose(base.matrix) @ X_WP
            for margin, q in self._solutions(X_BP, hold, stroke, -np.inf if best is None else best.margin):
                best = Place(margin, base, hold.grasp, tuple(self._model.joint_angles(q).tolist()))
        return best

    def base(self, distance: float, height: float, origin: Shoulders | None) -> Pose:
        """Return the base, or of a robot the origin, at a distance from the payload's centre."""
        if origin is not None:
            fx, fy, _ = origin.forward
            yaw = np.arctan2(*-self._direction[1::-1]) - np.arctan2(fy, fx)
            ahead = exp3(yaw * np.eye(3)[2]) @ (origin.middle + distance * origin.forward)
            x, y, _ = (np.round(-ahead, 3) + 0.0).tolist()
            turn = round(float(np.remainder(yaw + np.pi, 2 * np.pi) - np.pi), 6)
            return Pose(xyz=(x, y, -origin.floor), rpy=(0.0, 0.0, turn))
        x, y, _ = (np.round(distance * self._direction, 3) + 0.0).tolist()
        z = height - self.plane if self.is_planar else self.stand
        aim = self._contact.point
        yaw = float(np.arctan2(aim[1] - y, aim[0] - x)) - self._facing
        turn = round(float(np.pi - np.remainder(np.pi - yaw, 2 * np.pi)), 6)
        return Pose(xyz=(x, y, z), rpy=(0.0, 0.0, turn))

    def _solutions(
        self, X_BP: Array, hold: Hold, stroke: float, least: float
    ) -> Iterator[tuple[float, Array]]:
        """Yield configurations that hold the payload and can move it by the stroke, each with more margin."""
        rows = [row for row in self._rows.indices if row < 3]
        for seed in self._seeds:
            q, margin = self._solved(X_BP, hold, seed)
            for row, step in itertools.product(rows, (-stroke, stroke)):
                if margin <= least:
                    break
                moved = X_BP.copy()
                moved[row, 3] += step
                margin = min(margin, self._solved(moved, hold, q)[1])
            if margin > least:
                least = margin
                yield margin, q

    def _solved(self, X_BP: Array, hold: Hold, seed: Array) -> tuple[Array, float]:
        """Return the configuration that holds the payload, and its margin; -inf if there is none."""
        solution = hold.solver.solve(pin.SE3(X_BP @ hold.grasp.matrix), seed, steps=_STEPS)
        q = self._model.limits.wrap_near(solution.q, seed)
        holds = solution.is_closed and self._model.limits.margin(q) > _IN_RANGE
        if holds and not (self.is_planar or self._contact.one_base):  # a robot's root may be its torso
            holds = min(joint_heights(self._model, q).values()) >= -self.stand
        return q, self.margin(q, X_BP, hold) if holds else -np.inf

    def margin(self, q: Array, X_BP: Array, hold: Hold) -> float:
        """Return the least part left of torque, joint range and condition number, as ``posture_margins``.

        Args:
            q: configuration, shape (nq,).
            X_BP: pose of the payload in the base.
            hold: grasp.
        """
        model, J = self._model, self._model.payload_jacobian(q)  # of the tip: the model has no grasp
        X_BE, grasp = model.tip_pose(q), hold.grasp
        at_tip = np.kron(np.eye(2), X_BE[:3, :3].T) @ J
        J[:3] += np.cross(J[3:], X_BP[:3, 3] - X_BE[:3, 3], axis=0)
        held = grasp.to_held_rows @ at_tip if isinstance(grasp, JointGrasp) else self._rows.select(J)
        condition = float(np.linalg.cond(held[held.any(axis=1)] @ model.from_drive))
        tau = (model.nonlinear_effects(q, np.zeros(model.nv)) - J[:3].T @ self._load) @ model.from_drive
        used = float((np.abs(tau) / model.limits.torque).max())
        return min(1.0 - used, model.limits.margin(q), 1.0 - condition / _CONDITION)


def _facing(tips: Array) -> float:
    """Return the direction in base axes, to a quarter turn, to which an arm that does not turn reaches.

    Args:
        tips: places of its tip in the ground plane, m, shape (n, 2).
    """
    x, y = tips.mean(axis=0)
    if np.hypot(x, y) < _ONE_WAY * np.linalg.norm(tips, axis=1).mean():
        return 0.0
    return float(np.round(np.arctan2(y, x) / (np.pi / 2.0)) * np.pi / 2.0)
