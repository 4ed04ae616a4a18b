"""Task-space inertia of a cell along its motion, and the wrenches that its arms need there."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.analysis.reachability import ArmReach, Reachability
from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.model.arm_model import ArmModel
from coop_pin.simulation.transmission import friction

_RIGID = 1e-9
"""Mobility of a direction in which an arm cannot move the payload, as a part of its largest."""


class TaskInertia(NamedTuple):
    """Inertia that a task wrench moves, and what the arms need along the motion, rows in world axes about P.

    Attributes:
        times: of the poses, s, shape (n,); the first ones, at t = 0, lead from the start to the reference.
        mobility: A^-1 on the task rows, with A = M_0 + sum (J M^-1 J^T)^-1, shape (n, k_0, k_0).
        load_rate: largest rate of the wrench that moves payload and arms, N/s and N m/s, (k_0,).
        load_range: largest change of that wrench from its value at rest, N and N m, shape (k_0,).
        internal_rate: largest rate of mu_i = a_i - c_i sum a_j of any arm, N/s and N m/s, shape (k_0,).
    """

    times: Array
    mobility: Array
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
    turns = [arms[0].payload_pose(q)[:3, :3] for q in found.arms[0].q]
    M_0 = np.array([cell.payload.spatial_inertia(R) for R in turns])
    A = M_0.copy()
    for model, reach in zip(arms, found.arms, strict=True):
        for at, q in enumerate(reach.q):
            J = model.payload_jacobian(q)
            moves = J @ np.linalg.solve(model.mass_matrix(q), J.T)
            A[at] += np.linalg.inv(moves + _RIGID * np.trace(moves) * np.eye(6))
    mobility = np.asarray(np.linalg.inv(A)[np.ix_(range(len(times)), rows, rows)], dtype=np.float64)

    first = int(np.count_nonzero(times == 0.0)) - 1
    t = times[first:]
    motion = scenario.motion.replace()  # reads a CSV table again
    twist = np.array([motion.at(float(time)).V_WP_d for time in t])
    payload = np.einsum("nij,nj->ni", M_0[first:], np.gradient(twist, t, axis=0))[:, rows]
    a = np.array([_arm_wrench(scenario, *pair, rows, first) for pair in zip(arms, found.arms, strict=True)])
    mu = a - cell.shares[:, None, None] * a.sum(axis=0)
    d = a.sum(axis=0) + payload
    load_rate, internal_rate = np.gradient(d, t, axis=0), np.gradient(mu, t, axis=1)
    return TaskInertia(
        times,
        mobility,
        np.abs(load_rate).max(axis=0),
        np.abs(d - d[0]).max(axis=0),
        np.abs(internal_rate).max(axis=(0, 1)),
    )


def _arm_wrench(scenario: Scenario, model: ArmModel, reach: ArmReach, rows: list[int], first: int) -> Array:
    """Return a_i = Jdyn^T (M qdd + h + friction) along the reference, Jdyn^T = (J M^-1 J^T)^-1 J M^-1."""
    t, q = reach.times[first:], reach.q[first:]
    steps = [pin.difference(model.model, *pair) for pair in itertools.pairwise(q)]
    positions = np.concatenate((np.zeros((1, model.nv)), np.cumsum(steps, axis=0)))
    v = np.gradient(positions, t, axis=0)
    qdd = np.gradient(v, t, axis=0)
    rubbing = -friction(scenario.cell.arms[reach.arm], reach.arm).force(v)
    wrenches = []
    for at, configuration in enumerate(q):
        J, M = model.payload_jacobian(configuration)[rows], model.mass_matrix(configuration)
        tau = model.inverse_dynamics(configuration, v[at], qdd[at]) + rubbing[at]
        weighted = np.linalg.solve(M, J.T)
        wrenches.append(np.linalg.lstsq(J @ weighted, weighted.T @ tau, rcond=None)[0])
    return np.array(wrenches)
