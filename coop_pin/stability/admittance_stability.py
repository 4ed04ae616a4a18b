"""Stability of an admittance on velocity servos, from tick to tick, for arms that may differ."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.bisection import factor_edge
from coop_pin.base.errors import ArgumentError
from coop_pin.base.spatial import spatial_inertia
from coop_pin.control.consensus import laplacian
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.stability.modes import NEUTRAL

_ERROR = 1e-8
"""Accuracy of the least damping, as a part of it."""
_STIFFEST = 1e3
"""A damping that may be divided by it counts as without a bound."""


class AdmittanceStability(NamedTuple):
    """Stability of an admittance on velocity servos at the start.

    Attributes:
        radius: largest ``|z|`` of a tick, without the offsets of all arms together, which rest.
        least: factor of the admittance's damping below which the loop grows; 0 for any.
    """

    radius: float
    least: float

    @property
    def ok(self) -> bool:
        """Whether the loop decays from tick to tick."""
        return self.radius < 1.0

    def summary(self) -> str:
        """Return the finding as text, in one line."""
        if self.ok:
            return f"the admittance decays on these servos; its damping may be down to {self.least:.3g} times"
        return (
            f"the force loop of the admittance grows by a factor of {self.radius:.4g} a tick on these servos:"
            f" multiply gains.admittance_damping by at least {self.least:.3g}"
        )


class _Arms(NamedTuple):
    """Arms and payload on the task rows about P; the arms' arrays have the shape (m, k_0, k_0).

    Attributes:
        inertia: A_i = J^-T M J^-1.
        push: B_i = J^-T I k_v J^-1.
        gain: J^-T I k_v k_i J^-1.
        total: inertia of arms and payload together, shape (k_0, k_0).
        samples: samples of the servos in a tick.
    """

    inertia: Array
    push: Array
    gain: Array
    total: Array
    samples: int


@typed
def admittance_stability(scenario: Scenario) -> AdmittanceStability:
    """Return the stability of an admittance on velocity servos, linear at rest at the start.

    Of the velocity V of P, its pose x, the wrenches F_i that were measured, and V_a, d and the servos'
    integrals z of the arms::

        w    = f_m - S d of the internal wrenches, or of those heard
        V_a <- p V_a + (1 - p) D^-1 w,  d <- d + T V_a,  V_c = V_a - gamma (x - d)
        at each sample of the servos    u_i = B_i (V_ci - V) + z_i,  a = (sum A + A_P)^-1 sum u_i
        V   <- V + h a,  x <- x + h V + h^2 a / 2,  F_i = A_i a - u_i

    A_i and A_P are the inertias of arms and payload, B_i = J^-T I k_v J^-1: what an arm's servo pushes with.
    Two equal arms whose common velocity settles within a tick have the gain 2 B_s / D over the filter; arms
    whose A_i and B_i differ in shape have less. Friction, limits and lag of the drives are not considered.

    Args:
        scenario: scenario with the law "admittance" by velocities, whose arms have no spare joints.

    Raises:
        ArgumentError: the law is another one, or an arm has spare joints, a position servo, a servo of
            another rate or a late one, or a compliant grasp.
    """
    law: Any = scenario.controller
    if law.command_kind != "velocity" or "role" in law.needs:
        raise ArgumentError("the law is no admittance by velocities that follows the reference")
    if scenario.cell.compliant or not (law.measures or scenario.network):
        raise ArgumentError("a grasp is compliant, or no wrench is measured")
    arms = _arms(scenario)

    def radius(factor: float) -> float:
        z = np.linalg.eigvals(_tick_matrix(scenario, arms, factor))
        return float(np.abs(z[np.abs(z - 1.0) > NEUTRAL]).max())  # of what does not rest

    if radius(1.0 / _STIFFEST) < 1.0:
        return AdmittanceStability(radius(1.0), 0.0)
    least = factor_edge(lambda factor: radius(factor) < 1.0, _STIFFEST, 1.0 / _STIFFEST, _ERROR)
    return AdmittanceStability(radius(1.0), least)


def _arms(scenario: Scenario) -> _Arms:
    """Return arms and payload at the start."""
    cell, rows, chain = scenario.cell, scenario.cell.task_rows, CellChain(scenario.cell, scenario.plant)
    q, parts, samples = chain.configuration(scenario.start.matrix), list[Array](), set[int]()
    for slot in chain.model.arms:
        servo, arm = scenario.actuators_of(slot.name).servo, CellArm(cell, slot.name)
        J, M = arm.task_jacobian(q[slot.q_slice]), arm.mass_matrix(q[slot.q_slice])
        if servo is None or servo.command != "velocity" or servo.delay or J.shape[0] != J.shape[1]:
            raise ArgumentError(f"arm {slot.name!r} has spare joints, or no velocity servo without delay")
        samples.add(servo.per_tick(scenario.clock.rate_hz))
        M, J_inverse = arm.from_drive.T @ M @ arm.from_drive, np.linalg.inv(J)
        push = np.diag(M) * np.array(servo.velocity_bandwidth)
        drives = (M, np.diag(push), np.diag(push * np.array(servo.integral_rate)))
        parts.append(np.array([J_inverse.T @ each @ J_inverse for each in drives]))
    if len(samples) > 1:
        raise ArgumentError(f"the servos sample {sorted(samples)} times in a tick; they must be alike")
    payload, R_WP = cell.payload, scenario.start.matrix[:3, :3]
    A_P = spatial_inertia(payload.mass, payload.inertia_matrix, R_WP)[np.ix_(rows.indices, rows.indices)]
    A, B, C = np.array(parts).swapaxes(0, 1)
    return _Arms(A, B, C, A.sum(axis=0) + A_P, samples.pop())


def _wrench_errors(scenario: Scenario) -> tuple[Array, int]:
    """Return w of all arms by their wrenches, shape (m, m), and how late these are, ticks."""
    law: Any = scenario.controller
    path, c, names = law.force_path, scenario.cell.shares, list(scenario.cell.arms)
    late = max((wrist.delay for wrist in scenario.wrists), default=0)
    if path.measures:
        return np.eye(len(c)) - np.outer(c, np.ones(len(c))), path.delay + late
    network: Any = scenario.network
    L = laplacian(network.edges_at(0.0, names), names)
    heard = np.diag(L.diagonal()) - L
    return np.diag(heard @ c) - c[:, None] * heard, late + network.oldest_of(names, scenario.clock)


def _tick_matrix(scenario: Scenario, arms: _Arms, factor: float) -> Array:
    """Return the matrix of [V, x, F of the last ticks, f_m, V_a, d, z], with a factor of the damping."""
    law: Any = scenario.controller
    rows, m, T = scenario.cell.task_rows.size, len(arms.push), scenario.clock.period
    gains, h = law.gains.sized(rows, rows), T / arms.samples
    gamma, S, D = (
        gain[:, None]
        for gain in (gains.pose_gain, gains.admittance_stiffness, factor * gains.admittance_damping)
    )
    W, late = _wrench_errors(scenario)
    p, pole, inverse = np.exp(-gains.admittance_rate * T), law.force_path.pole, np.linalg.inv(arms.total)

    def tick(V: Array, x: Array, F: Array, f_m: Array, V_a: Array, d: Array, z: Array) -> tuple[Array, ...]:
        f_m = pole * f_m + (1.0 - pole) * F[-1]
        V_a = p * V_a + (1.0 - p) * (np.einsum("ij,jkn->ikn", W, f_m) - S * d) / D
        d = d + T * V_a
        V_c = V_a - gamma * (x - d)
        a, u = 0.0 * V, z
        for _ in range(arms.samples):
            u, z = arms.push @ (V_c - V) + z, z + h * arms.gain @ (V_c - V)
            a = inverse @ u.sum(axis=0)
            V, x = V + h * a, x + h * V + h * h / 2.0 * a
        return V, x, np.concatenate(((arms.inertia @ a - u)[None], F[:-1])), f_m, V_a, d, z

    arm = (m, rows)
    return matrix_of(tick, [(rows,), (rows,), (late + 1, *arm), arm, arm, arm, arm])


def matrix_of(function: Callable[..., tuple[Array, ...]], shapes: list[tuple[int, ...]]) -> Array:
    """Return the matrix of a linear function of arrays, whose last axis it leaves alone.

    Args:
        function: Function that returns new values of all arrays, or of the first ones.
        shapes: Shapes of the arrays without the last axis.
    """
    sizes = [int(np.prod(shape)) for shape in shapes]
    unit = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])
    values = function(*(part.reshape(*shape, -1) for part, shape in zip(unit, shapes, strict=True)))
    return np.concatenate([value.reshape(size, -1) for value, size in zip(values, sizes, strict=False)])
