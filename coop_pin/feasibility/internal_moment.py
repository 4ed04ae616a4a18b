"""Internal moment of a cell on positional rows along a motion, which no task row controls."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import spatial_inertia
from coop_pin.control.terms import PostureGains
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.reachability import Reachability
from coop_pin.feasibility.task_inertia import HeldArm

_ROUND_OFF = 1e-6
"""Singular values below this part of the largest are directions in which an arm cannot push the payload."""


class InternalMoment(NamedTuple):
    """Largest difference of an arm's internal moment from the desired one.

    Attributes:
        arm: arm name.
        time: s.
        moment: size of the difference about P, N m.
    """

    arm: str
    time: float
    moment: float

    def summary(self) -> str:
        """Return the moment as text."""
        return (
            f"internal moment to expect: {self.moment:.3g} N m beside the desired one, of arm {self.arm!r} at"
            f" t = {self.time:.4g} s; no task row controls it: weights, friction and springs of postures do"
        )


@typed
def internal_moment(scenario: Scenario, cell_reach: Reachability, posture: PostureGains) -> InternalMoment:
    """Return the internal moment that the payload-space law leaves on positional rows, along the motion.

    The law pushes the payload at P without a moment, so that the rest of what an arm needs comes from the
    payload: with r_i = M qdd + h + friction - (holding torque and posture, in the null space),

        J_i^T G_i = r_i,    sum of the moments of G_i = -d/dt (I omega),    n_i = moment of G_i.

    An arm of five joints leaves a direction of G_i open; the payload's balance closes it, in least squares
    where arms can push it in all directions. n_i - c_i sum n_j is compared with the desired internal moment.

    Args:
        scenario: cell on positional rows, motion and squeeze.
        cell_reach: reachability of the scenario, in which every arm holds the start.
        posture: gains of the spare joints.
    """
    balance = _Balance.along(scenario, cell_reach, posture)
    t, cell = balance.times, scenario.cell
    desired = np.array([scenario.squeeze.at(time, cell.grasps)[:, 3:] for time in t.tolist()])
    n = balance.moments
    excess = n - cell.shares[:, None] * n.sum(axis=1, keepdims=True) - desired @ balance.turns.mT
    sizes = np.linalg.norm(excess, axis=2)
    at, arm = np.unravel_index(int(sizes.argmax()), sizes.shape)
    return InternalMoment(cell_reach.arms[arm].arm, float(t[at]), float(sizes[at, arm]))


@typed
def positional_torques(
    scenario: Scenario, cell_reach: Reachability, posture: PostureGains
) -> tuple[Array, ...]:
    """Return the drive torques of the payload-space law on positional rows along the motion, N m.

    The closures hold spare joints there, so that a spring of the posture takes torque at rest, too:
    tau_i = M qdd + h + friction + J_i^T F_i, with the forces of F_i those of load and squeeze and its moments
    those of internal_moment. An array of shape (n, k) for each arm.

    Args:
        scenario: cell on positional rows, motion and squeeze.
        cell_reach: reachability of the scenario, in which every arm holds the start.
        posture: gains of the spare joints.
    """
    balance = _Balance.along(scenario, cell_reach, posture)
    return tuple(balance.drive_torques(scenario, k) for k in range(len(balance.arms)))


class _Balance(NamedTuple):
    """Balance of arms and payload along a motion on positional rows.

    Attributes:
        times: s, shape (n,).
        arms: arms, and their paths of configurations.
        turns: R_WP, shape (n, 3, 3).
        moments: n_i about P, N m, shape (n, m, 3).
    """

    times: Array
    arms: list[tuple[HeldArm, Array]]
    turns: Array
    moments: Array

    @classmethod
    def along(cls, scenario: Scenario, cell_reach: Reachability, posture: PostureGains) -> _Balance:
        """Return the balance; arguments as of internal_moment."""
        first = cell_reach.arms[0].first
        t = cell_reach.arms[0].times[first:]
        arms = [(HeldArm(scenario, reach, posture), reach.q[first:]) for reach in cell_reach.arms]
        torques = [arm.missing(t, path) for arm, path in arms]
        turns = np.array([arms[0][0].model.payload_pose(q)[:3, :3] for q in arms[0][1]])
        inertial = _moments_of_payload(scenario, t, turns)
        moments = np.array(
            [
                _moments(
                    [arm.model.payload_jacobian(path[k]) for arm, path in arms],
                    [torque[k] for torque in torques],
                    -inertial[k],
                )
                for k in range(len(t))
            ]
        )
        return cls(t, arms, turns, moments)

    def drive_torques(self, scenario: Scenario, index: int) -> Array:
        """Return the drive torques of an arm, N m, shape (n, k)."""
        arm, path = self.arms[index]
        cell, motion, t = scenario.cell, scenario.payload_motion, self.times
        velocity = np.array([motion.at(time).V_WP_d[:3] for time in t.tolist()])
        inertial = np.gradient(velocity, t, axis=0) - np.array(cell.gravity)
        squeeze = np.array([scenario.squeeze.at(time, cell.grasps)[index, :3] for time in t.tolist()])
        forces = arm.model.share * cell.payload.mass * inertial - np.einsum("nij,nj->ni", self.turns, squeeze)
        wrenches = np.hstack((forces, -self.moments[:, index]))
        J = np.array([arm.model.payload_jacobian(q) for q in path])
        joints = arm.without_payload(t, path) + np.einsum("nij,ni->nj", J, wrenches)
        return np.asarray(joints @ arm.model.from_drive)


def _moments_of_payload(scenario: Scenario, t: Array, turns: Array) -> Array:
    """Return d/dt (I omega) of the payload's orientations, N m, shape (n, 3)."""
    payload = scenario.cell.payload
    spins = np.gradient(turns, t, axis=0) @ turns.transpose(0, 2, 1)
    omega = np.stack((spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]), axis=1)
    inertia = [spatial_inertia(payload.mass, payload.inertia_matrix, R)[3:, 3:] for R in turns]
    return np.asarray(np.gradient(np.einsum("nij,nj->ni", inertia, omega), t, axis=0))


def _moments(jacobians: list[Array], torques: list[Array], total: Array) -> Array:
    """Return the moments of the wrenches J_i^-T r_i that add up to a total, shape (m, 3)."""
    fixed, free = list[Array](), list[Array]()
    for J, r in zip(jacobians, torques, strict=True):
        _, sigma, Vt = np.linalg.svd(J.T)
        rank = int(np.count_nonzero(sigma > _ROUND_OFF * sigma[0]))
        fixed.append((np.linalg.pinv(J.T, rcond=_ROUND_OFF) @ r)[3:])
        free.append(Vt[rank:, 3:].T)
    Z = np.hstack(free)
    s = np.linalg.lstsq(Z, total - np.sum(fixed, axis=0), rcond=None)[0]
    ends = np.cumsum([directions.shape[1] for directions in free])[:-1]
    parts = zip(fixed, free, np.split(s, ends), strict=True)
    return np.array([n + directions @ s_i for n, directions, s_i in parts])
