"""Task-space inertia of a cell along its motion, and the wrenches that its arms need there."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.analysis.reachability import Reachability
from coop_pin.arrays import Array
from coop_pin.control.law import PostureGains
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmModel
from coop_pin.simulation.transmission import friction
from coop_pin.spatial import weight_wrench

_RIGID = 1e-9
"""Mobility of a direction in which an arm cannot move the payload, as a part of its largest."""
_SPARE_STEP = 0.02
"""Longest step of the motion of spare joints, s."""


class TaskInertia(NamedTuple):
    """Inertia that a task wrench moves along the motion, rows in world axes about P.

    Attributes:
        times: of the poses, s, shape (n,); the first ones, at t = 0, lead from the start to the reference.
        mobility: A^-1 on the task rows, with A = M_0 + sum (J M^-1 J^T)^-1, shape (n, k_0, k_0).
    """

    times: Array
    mobility: Array


class MotionWrenches(NamedTuple):
    """Wrenches that the motion asks of the law, rows in world axes about P.

    Attributes:
        load_rate: largest rate of the wrench that moves payload and arms, N/s and N m/s, (k_0,).
        load_range: largest change of that wrench from its value at rest, N and N m, shape (k_0,).
        internal_rate: largest rate of mu_i = a_i - c_i sum a_j of any arm, N/s and N m/s, shape (k_0,).
    """

    load_rate: Array
    load_range: Array
    internal_rate: Array


def task_inertia(scenario: Scenario, found: Reachability) -> TaskInertia:
    """Return the task-space inertia at the configurations of a scenario's reachability.

    With arms that cannot move the payload in all six directions, A is infinite in the others, and A^-1 is
    the inverse inertia of the closed chain on the task rows. Every arm must reach the start.

    Args:
        scenario: what is asked of the arms.
        found: its reachability.
    """
    cell, rows = scenario.cell, list(scenario.cell.task_rows.indices)
    times, arms = found.arms[0].times, [ArmModel.from_cell(cell, reach.arm) for reach in found.arms]
    A = _payload_inertia(scenario, found)
    for model, reach in zip(arms, found.arms, strict=True):
        for at, q in enumerate(reach.q):
            J = model.payload_jacobian(q)
            moves = J @ np.linalg.solve(model.mass_matrix(q), J.T)
            A[at] += np.linalg.inv(moves + _RIGID * np.trace(moves) * np.eye(6))
    mobility = np.asarray(np.linalg.inv(A)[np.ix_(range(len(times)), rows, rows)], dtype=np.float64)
    return TaskInertia(times, mobility)


def motion_wrenches(scenario: Scenario, found: Reachability, posture: PostureGains) -> MotionWrenches:
    """Return the wrenches that the motion asks of the payload-space law.

    a_i = Jdyn^T (M qdd + h + friction - what the torques hold besides the law's wrench): the robot's own
    gravity compensation, and in the null space the holding torques of the start and the posture's spring and
    damper. On full rows the spare joints of a redundant arm move as these and the arm's weight let them.

    Args:
        scenario: what is asked of the arms.
        found: its reachability.
        posture: of the spare joints.
    """
    cell, rows = scenario.cell, list(scenario.cell.task_rows.indices)
    first = int(np.count_nonzero(found.arms[0].times == 0.0)) - 1
    t = found.arms[0].times[first:]
    motion = scenario.motion.replace()  # reads a CSV table again
    twist = np.array([motion.at(float(time)).V_WP_d for time in t])
    M_0 = _payload_inertia(scenario, found)[first:]
    payload = np.einsum("nij,nj->ni", M_0, np.gradient(twist, t, axis=0))[:, rows]
    a = np.array(
        [
            _HeldArm(scenario, reach.arm, reach.q[first], posture).wrenches(t, reach.q[first:])
            for reach in found.arms
        ]
    )
    mu = a - cell.shares[:, None, None] * a.sum(axis=0)
    d = a.sum(axis=0) + payload
    load_rate, internal_rate = np.gradient(d, t, axis=0), np.gradient(mu, t, axis=1)
    return MotionWrenches(
        np.abs(load_rate).max(axis=0), np.abs(d - d[0]).max(axis=0), np.abs(internal_rate).max(axis=(0, 1))
    )


def _payload_inertia(scenario: Scenario, found: Reachability) -> Array:
    """Return M_0 at every pose, shape (n, 6, 6)."""
    first = ArmModel.from_cell(scenario.cell, found.arms[0].arm)
    turns = [first.payload_pose(q)[:3, :3] for q in found.arms[0].q]
    return np.array([scenario.cell.payload.spatial_inertia(R) for R in turns])


class _HeldArm:
    """An arm with what its torques hold besides the law's wrench."""

    def __init__(self, scenario: Scenario, name: str, start: Array, posture: PostureGains) -> None:
        cell = scenario.cell
        self.motion, self.rows = scenario.motion.replace(), cell.task_rows
        self.model, self.friction = ArmModel.from_cell(cell, name), friction(cell.arms[name], name)
        self.near = self.model.posture(cell.arms[name].posture)
        self.stiffness, self.damping = float(np.max(posture.stiffness)), float(np.max(posture.damping))
        robot = scenario.actuators_of(name).gravity_compensation
        self.carried = 0.0 if robot is None else 1.0 + robot.mass_error
        self.from_drive = np.linalg.inv(self.model.drive)
        load = float(cell.shares[list(cell.arms).index(name)]) * weight_wrench(
            cell.payload.mass, cell.gravity
        )
        self.held = (
            self.weight(start)
            - self.model.payload_jacobian(start).T @ load
            - self.carried * self.weight(start)
        )
        self.is_redundant = self.model.nv > self.rows.size

    def weight(self, q: Array) -> Array:
        """Return g(q), N m, shape (k,)."""
        return self.model.nonlinear_effects(q, np.zeros(self.model.nv))

    def beside(self, q: Array, v: Array) -> Array:
        """Return the joint torques besides the law's wrench, N m, shape (k,)."""
        torque = self.carried * self.weight(q)
        if self.is_redundant:
            drive, from_drive = self.model.drive, self.from_drive
            pull = (
                -self.stiffness * drive @ pin.difference(self.model.model, self.near, q)
                - self.damping * drive @ v
            )
            torque = torque + drive.T @ self._null_space(q) @ (from_drive.T @ self.held + pull)
        return torque

    def _null_space(self, q: Array) -> Array:
        """Return N = I - J^+ J in drive coordinates, shape (k, k)."""
        J = self.rows.select(self.model.payload_jacobian(q)) @ self.from_drive
        return np.eye(self.model.nv) - np.linalg.pinv(J) @ J

    def wrenches(self, t: Array, q: Array) -> Array:
        """Return a_i along a path of configurations, shape (n, k_0)."""
        model = self.model
        if self.is_redundant and self.rows.size == 6 and self.damping > 0.0:
            q = self._with_spare_motion(t, q)
        steps = [pin.difference(model.model, *pair) for pair in itertools.pairwise(q)]
        positions = np.concatenate((np.zeros((1, model.nv)), np.cumsum(steps, axis=0)))
        v = np.gradient(positions, t, axis=0)
        qdd, rubbing = np.gradient(v, t, axis=0), -self.friction.force(v)
        found = []
        for at, own in enumerate(q):
            J, M = self.rows.select(model.payload_jacobian(own)), model.mass_matrix(own)
            tau = model.inverse_dynamics(own, v[at], qdd[at]) + rubbing[at] - self.beside(own, v[at])
            weighted = np.linalg.solve(M, J.T)
            found.append(np.linalg.lstsq(J @ weighted, weighted.T @ tau, rcond=None)[0])
        return np.array(found)

    def _with_spare_motion(self, t: Array, q: Array) -> Array:
        """Return the path on which the spare joints move.

        ``N M N wdot = N (tau - g - c w - D qdot)`` with ``qdot = J^+ V + w``, implicit in damper c and in
        the friction D. What is left of the pose error is taken out in each step.
        """
        model, rest, from_drive = self.model, np.zeros(self.model.nv), self.from_drive
        own, w, path = q[0], rest, [q[0]]
        for begin, end in itertools.pairwise(t.tolist()):
            count = math.ceil((end - begin) / _SPARE_STEP)
            h = (end - begin) / count
            for time in np.linspace(begin, end, count + 1)[1:].tolist():
                target, N = self.motion.at(time), self._null_space(own)
                J_plus = np.linalg.pinv(self.rows.select(model.payload_jacobian(own)) @ from_drive)
                along = J_plus @ self.rows.select(target.V_WP_d)
                M = from_drive.T @ model.mass_matrix(own) @ from_drive
                D = from_drive.T @ self.friction.damping(from_drive @ (along + w)) @ from_drive
                pulled = from_drive.T @ (self.beside(own, rest) - self.weight(own))
                inert = M + h * (D + self.damping * np.eye(model.nv))
                w = np.linalg.solve(
                    N @ inert @ N + np.eye(model.nv) - N, N @ (M @ w + h * (pulled - D @ along))
                )
                step = J_plus @ self.rows.pose_error(target.X_WP_d, model.payload_pose(own)) + h * w
                own = pin.integrate(model.model, own, from_drive @ step)
            path.append(own)
        return np.array(path)
