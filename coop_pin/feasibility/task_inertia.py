"""Task-space inertia of a cell along its motion, and the wrenches that its arms need there."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import spatial_inertia, weight_wrench
from coop_pin.control.terms import PostureGains
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.path_following import time_at_rest
from coop_pin.feasibility.reachability import ArmReach, Reachability
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.transmission import friction

_RIGID = 1e-9
"""Mobility of a direction in which an arm cannot move the payload, as a part of its largest."""
_SPARE_STEP = 0.02
"""Longest step of the motion of spare joints, s."""
_SAMPLES = 401
"""Samples along a motion: Coulomb friction changes its sign within few of them."""
_NEWTON_STEPS = 2
"""From an interpolated configuration to the reference."""
_SETTLING = 1.0
"""Time after a motion in which spare joints are still looked at, s."""


class TaskInertia(NamedTuple):
    """Inertia that a task wrench moves along the motion, rows in world axes about P.

    Attributes:
        times: times of the poses, s, shape (n,); the first ones, at t = 0, lead from the start to the
            reference.
        mobility: A^-1 on the task rows, with A = M_0 + sum (J M^-1 J^T)^-1, shape (n, k_0, k_0).
    """

    times: Array
    mobility: Array


class MotionWrenches(NamedTuple):
    """Wrenches that the motion asks of the law, rows in world axes about P, evenly spaced in time.

    Attributes:
        period: time between samples, s.
        load: d, what moves payload and arms, N and N m, shape (n, k_0).
        internal: mu_i = a_i - c_i sum a_j of every arm, N and N m, shape (m, n, k_0).
    """

    period: float
    load: Array
    internal: Array

    def tracking(self, K: Array, pose_gain: float, integral_rate: float) -> Array:
        """Return x of K (d/dt + gamma) (d/dt + k_I) x = d', m and rad, shape (n, k_0).

        Args:
            K: Diagonal of K, shape (k_0,), or K, shape (k_0, k_0).
            pose_gain: gamma, 1/s.
            integral_rate: k_I, 1/s.
        """
        unmet = _decayed(self.load, pose_gain * self.period)
        held = unmet - _decayed(unmet, integral_rate * self.period)
        scaled = np.asarray(K * integral_rate, dtype=np.float64)
        return held / scaled if K.ndim == 1 else np.asarray(np.linalg.solve(scaled, held.T).T)

    def shared_by(self, G: Array, shares: Array) -> MotionWrenches:
        """Return what gains G_i make of it, whose arms bear changes of the load by G_i G^-1 instead of c_i.

        Args:
            G: Gains G_i = c_i K_i of every arm, shape (m, k_0, k_0); G is their sum.
            shares: Load shares c_i, shape (m,).
        """
        unequal = G @ np.linalg.inv(G.sum(axis=0)) - shares[:, None, None] * np.eye(G.shape[-1])
        return self._replace(internal=self.internal + np.einsum("ijk,nk->inj", unequal, self.load))

    def internal_error(self, anchor_rate: float) -> Array:
        """Return ftilde_i of ftilde_i' = -beta ftilde_i + mu_i', N and N m, shape (m, n, k_0).

        Args:
            anchor_rate: beta, 1/s.
        """
        return _decayed(self.internal, anchor_rate * self.period)


def _decayed(u: Array, decay: float) -> Array:
    """Return y of y' = -decay y + u' from y = 0 with linear u between samples, along the last axis but one.

    Args:
        u: shape (..., n, k).
        decay: Decay in a sample.
    """
    kept, gained = math.exp(-decay), -math.expm1(-decay) / decay
    y = np.zeros(u.shape)
    for k in range(1, u.shape[-2]):
        y[..., k, :] = kept * y[..., k - 1, :] + gained * (u[..., k, :] - u[..., k - 1, :])
    return y


@typed
def task_inertia(scenario: Scenario, cell_reach: Reachability) -> TaskInertia:
    """Return the task-space inertia at the configurations of a scenario's reachability.

    With arms that cannot move the payload in all six directions, A is infinite in the others, and A^-1 is
    the inverse inertia of the closed chain on the task rows. Every arm must reach the start.

    Args:
        scenario: cell and motion.
        cell_reach: reachability of the scenario.

    Raises:
        ArgumentError: a grasp is compliant.
    """
    scenario.cell.require_rigid("the task-space inertia of the cell")
    cell, rows = scenario.cell, list(scenario.cell.task_rows.indices)
    times, arms = cell_reach.arms[0].times, [CellArm(cell, reach.arm) for reach in cell_reach.arms]
    A = _payload_inertias(cell.payload, [arms[0].payload_pose(q) for q in cell_reach.arms[0].q])
    for model, reach in zip(arms, cell_reach.arms, strict=True):
        J, M = (np.array(list(map(f, reach.q))) for f in (model.payload_jacobian, model.mass_matrix))
        moves = J @ np.linalg.solve(M, J.mT)
        A += np.linalg.inv(moves + _RIGID * np.trace(moves, axis1=1, axis2=2)[:, None, None] * np.eye(6))
    mobility = np.asarray(np.linalg.inv(A)[np.ix_(range(len(times)), rows, rows)], dtype=np.float64)
    return TaskInertia(times, mobility)


@typed
def motion_wrenches(scenario: Scenario, cell_reach: Reachability, posture: PostureGains) -> MotionWrenches:
    """Return the wrenches that the motion asks of the payload-space law.

    a_i = Jdyn^T (M qdd + h + friction - what the torques hold besides the law's wrench): the robot's own
    gravity compensation, and in the null space the holding torques of the start and the posture's spring and
    damper. On full rows the spare joints of a redundant arm move as these and the arm's weight let them.

    Args:
        scenario: cell and motion.
        cell_reach: reachability of the scenario.
        posture: gains of the spare joints.
    """
    cell, rows = scenario.cell, list(scenario.cell.task_rows.indices)
    first = cell_reach.arms[0].first
    t = cell_reach.arms[0].times[first:]
    motion = scenario.payload_motion  # reads a CSV table again
    end = min(time_at_rest(scenario) + _SETTLING, scenario.duration)
    fine = np.linspace(0.0, end, _SAMPLES)
    targets = [motion.at(time) for time in fine.tolist()]
    acceleration = np.gradient(np.array([target.V_WP_d for target in targets]), fine, axis=0)
    M_0 = _payload_inertias(cell.payload, [target.X_WP_d for target in targets])
    held = [(HeldArm(scenario, reach, posture), reach.q[first:]) for reach in cell_reach.arms]
    a = np.array([arm.wrenches(fine, arm.path(fine, t, q)) for arm, q in held])
    mu = a - cell.shares[:, None, None] * a.sum(axis=0)
    d = a.sum(axis=0) + np.einsum("nij,nj->ni", M_0, acceleration)[:, rows]
    return MotionWrenches(float(fine[1]), d, mu)


def with_spare_motion(scenario: Scenario, cell_reach: Reachability, posture: PostureGains) -> Reachability:
    """Return a reachability with the configurations to which the payload-space law lets spare joints move.

    On full rows; arguments as of motion_wrenches.
    """
    arms = list[ArmReach]()
    for reach in cell_reach.arms:
        t, first = reach.times[reach.first :], reach.first
        moved = HeldArm(scenario, reach, posture).path(t, t, reach.q[first:])
        arms.append(dataclasses.replace(reach, q=np.concatenate((reach.q[:first], moved))))
    return dataclasses.replace(cell_reach, arms=tuple(arms))


def _payload_inertias(payload: Payload, poses: Iterable[Array]) -> Array:
    """Return M_0 at poses X_WP, shape (n, 6, 6)."""
    mass, inertia = payload.mass, payload.inertia_matrix
    return np.array([spatial_inertia(mass, inertia, X_WP[:3, :3]) for X_WP in poses])


class HeldArm:
    """An arm with what its torques hold besides the law's wrench."""

    def __init__(self, scenario: Scenario, reach: ArmReach, posture: PostureGains) -> None:
        cell, name, start = scenario.cell, reach.arm, reach.q[reach.first]
        self.motion, self.rows = scenario.payload_motion, cell.task_rows
        self.model, self.friction = CellArm(cell, name), friction(cell.arms[name], name)
        self.stiffness, self.damping = posture.of_drives(self.model.nv, self.model.base_joints)
        robot = scenario.actuators_of(name).gravity_compensation
        self.carried = 0.0 if robot is None else 1.0 + robot.mass_error
        load = self.model.share * weight_wrench(cell.payload.mass, cell.gravity)
        self.held = (
            self.weight(start)
            - self.model.payload_jacobian(start).T @ load
            - self.carried * self.weight(start)
        )
        self.is_redundant = self.model.nv > self.rows.size

    def weight(self, q: Array) -> Array:
        """Return g(q), N m, shape (k,)."""
        return self.model.nonlinear_effects(q, np.zeros(self.model.nv))

    def other_torques(self, q: Array, v: Array, N: Array | None = None) -> Array:
        """Return the joint torques besides the law's wrench, N m, shape (k,); N if it is known."""
        torque = self.carried * self.weight(q)
        if self.is_redundant:
            arm, drive = self.model, self.model.drive
            displacement = pin.difference(arm.model, arm.posture_configuration, q)
            pull = -self.stiffness * (drive @ displacement) - self.damping * (drive @ v)
            N = arm.null_space(q) if N is None else N
            torque = torque + drive.T @ N @ (arm.from_drive.T @ self.held + pull)
        return torque

    def path(self, times: Array, t: Array, q: Array) -> Array:
        """Return configurations at times, shape (n, nq), where spare joints move as law and weight let them.

        Args:
            times: s, shape (n,), from that of the start on.
            t: times of the path of the inverse kinematics, s.
            q: that path.
        """
        if self.is_redundant and self.rows.size == 6 and bool(self.damping.any()):
            return self._with_spare_motion(times, q[0])
        model, moved = self.model, self._unwound(q)
        if self.is_redundant:  # the reference does not determine spare joints; a spline keeps them smooth
            from scipy.interpolate import make_interp_spline  # slow to load

            near = make_interp_spline(t, moved, k=min(3, len(t) - 1))(times)
        else:  # the steps below remove what differs from a spline: 1e-10 is left of 401 poses, 1e-7 of 21
            near = np.stack([np.interp(times, t, column) for column in moved.T], axis=1)
        desired = [self.motion.at(time).X_WP_d for time in times.tolist()]
        between = [pin.integrate(model.model, q[0], step) for step in near]
        for _ in range(_NEWTON_STEPS):
            errors = map(self.rows.pose_error, desired, map(model.payload_pose, between))
            J_plus = np.linalg.pinv(np.array(list(map(model.task_jacobian, between))))
            steps = model.from_drive @ J_plus @ np.array(list(errors))[..., None]
            between = [pin.integrate(model.model, *pair) for pair in zip(between, steps[..., 0], strict=True)]
        return np.array(between)

    def missing(self, t: Array, q: Array) -> Array:
        """Return M qdd + h + friction - what the torques hold besides the law's wrench, N m, shape (n, k)."""
        v = self.speeds(t, q)
        return self.without_payload(t, q) - np.array([self.other_torques(*s) for s in zip(q, v, strict=True)])

    def without_payload(self, t: Array, q: Array) -> Array:
        """Return M qdd + h + friction along a path of configurations, N m, shape (n, k)."""
        v = self.speeds(t, q)
        states = zip(q, v, np.gradient(v, t, axis=0), strict=True)
        return np.array([self.model.inverse_dynamics(*state) for state in states]) - self.friction.force(v)

    def speeds(self, t: Array, q: Array) -> Array:
        """Return the velocities along a path of configurations, shape (n, nv)."""
        return np.gradient(self._unwound(q), t, axis=0)

    def _unwound(self, q: Array) -> Array:
        """Return the displacements from the first configuration of a path, rad or m, shape (n, nv)."""
        steps = [pin.difference(self.model.model, *pair) for pair in itertools.pairwise(q)]
        return np.concatenate((np.zeros((1, self.model.nv)), np.cumsum(steps, axis=0)))

    def wrenches(self, t: Array, q: Array) -> Array:
        """Return a_i along a path of configurations, shape (n, k_0)."""
        J, M = (np.array(list(map(f, q))) for f in (self.model.payload_jacobian, self.model.mass_matrix))
        J = J[:, self.rows.indices]
        weighted = np.linalg.solve(M, J.mT)
        moves = np.linalg.pinv(J @ weighted, rcond=self.rows.size * np.finfo(np.float64).eps)
        wrenches: Array = moves @ weighted.mT @ self.missing(t, q)[..., None]
        return wrenches[..., 0]

    def _with_spare_motion(self, t: Array, q_0: Array) -> Array:
        """Return the path on which the spare joints move.

        ``N M N wdot = N (tau - g - c w - D qdot)`` with ``qdot = J^+ V + w``, implicit in the posture's
        spring k and damper c and in the friction D: proposals try springs that are stiff for light wrists.
        What is left of the pose error is taken out in each step.
        """
        model, rest, from_drive = self.model, np.zeros(self.model.nv), self.model.from_drive
        q_k, w, path = q_0, rest, [q_0]
        for begin, end in itertools.pairwise(t.tolist()):
            count = math.ceil((end - begin) / _SPARE_STEP)
            h = (end - begin) / count
            for time in np.linspace(begin, end, count + 1)[1:].tolist():
                target, J = self.motion.at(time), model.task_jacobian(q_k)
                J_plus = np.linalg.pinv(J)
                N = np.eye(model.nv) - J_plus @ J
                along = J_plus @ self.rows.select(target.V_WP_d)
                M = from_drive.T @ model.mass_matrix(q_k) @ from_drive
                D = from_drive.T @ self.friction.damping(from_drive @ (along + w)) @ from_drive
                pulled = from_drive.T @ (self.other_torques(q_k, rest, N) - self.weight(q_k))
                inert = M + h * (D + np.diag(self.damping + h * self.stiffness))
                w = np.linalg.solve(
                    N @ inert @ N + np.eye(model.nv) - N, N @ (M @ w + h * (pulled - D @ along))
                )
                step = J_plus @ self.rows.pose_error(target.X_WP_d, model.payload_pose(q_k)) + h * w
                q_k = pin.integrate(model.model, q_k, from_drive @ step)
            path.append(q_k)
        return np.array(path)
