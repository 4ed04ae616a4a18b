"""Stability of a law on grasps that give: sampled loop of springs, arms and law, and stiffness needed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.bisection import factor_edge
from coop_pin.base.errors import ArgumentError
from coop_pin.base.spatial import internal_wrenches, rotate_vector6
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.modes import NEUTRAL
from coop_pin.stability.sampled_motion import closed_tick, sampled_motion
from coop_pin.stability.sampled_stability import SampledStability, start_stability
from coop_pin.stability.step_stability import plant_matrix

_STIFFEST, _STRIDE, _FACTOR_ERROR = 1e5, 1.2, 1e-3
"""Largest factor of the stiffness that is tried, ratio of those tried below it, error of the one found."""


class GraspStability(NamedTuple):
    """Stability of a law on compliant grasps and on patches that stick, linearised at the start.

    Attributes:
        radius: largest ``|z|`` of the sampled motion of springs, arms and law.
        holds_from: factor of the grasps' stiffness from which on the motion does not grow, at the same
            damping ratios; at most 1 if it does not grow, inf if no factor up to 1e5 suffices.
        window: factors of the widest range below ``holds_from`` in which it does not grow either: the springs
            that it is unstable with above are those that the ticks see as slower ones; None without.
        alone: sampled damping of each arm alone: below 2 no grasp is too soft for it.
        stiffness: smallest translational stiffness of a grasp, of a patch its springs' or bristles', N/m.
        distance: largest displacement of a tip from its grasp at the start, m.
        angle: largest rotation, rad.
        bias: largest distance of P as an arm sees it there from the mean of all whose grasps give, m; a
            kinematic bias, which ``zero_at_grasp`` of the law removes.
        grasps: the grasps, "compliant grasps" or "patches that stick".
    """

    radius: float
    holds_from: float
    window: tuple[float, float] | None
    alone: SampledStability
    stiffness: float
    distance: float
    angle: float
    bias: float
    grasps: str = "compliant grasps"

    @property
    def ok(self) -> bool:
        """Whether the motion does not grow from tick to tick."""
        return self.radius < 1.0 + NEUTRAL

    def summary(self) -> str:
        """Return the findings as text."""
        value = f"T*lambda = {self.alone.value:.3g} of {', '.join(self.alone.joints)}"
        bound = f"each arm alone has {value}; below 2 no grasp is too soft for the damping"
        needed = f"{self.holds_from * self.stiffness:.3g} N/m"
        remedy = f"they hold from {needed} on" if math.isfinite(self.holds_from) else "no stiffness helps"
        if self.window is not None:
            low, high = (f"{factor * self.stiffness:.3g}" for factor in self.window)
            remedy += f", and between {low} and {high} N/m"
        modes = f"|z| = {self.radius:.5f} on {self.grasps} of {self.stiffness:.3g} N/m"
        verdict = "the motion is stable" if self.ok else f"the gains are too large: {remedy}"
        start = (
            f"at the start the grasps give by {1e3 * self.distance:.3g} mm and {1e3 * self.angle:.3g} mrad;"
            f" each arm sees its own tip, and P up to {1e3 * self.bias:.3g} mm from the mean of all:"
            " a kinematic bias, which zero_at_grasp removes"
        )
        return f"{modes}: {verdict}\n{bound}\n{start}"


@typed
def grasp_stability(simulation: Simulation) -> GraspStability:
    """Return the stability of a law on compliant grasps and patches, at the start.

    The motions of arms and payload with springs, dampers and friction, linear and without the load's
    prestress, over a tick in closed form; all gains of the law and the lag of the drives. Patches stick, and
    the payload is off all tables. Where no grasp is rigid and the law measures internal wrenches, their
    feedback is in it, without filter and delay; an estimate of the speed is not.

    Args:
        simulation: Simulation of a law of coop_pin that has not begun, with grasps that give.

    Raises:
        ArgumentError: all grasps are rigid.
        SingularJacobianError: an arm is singular.
    """
    cell, chain, q = simulation.scenario.cell, simulation.chain, simulation.plant.q
    if not cell.unclosed:
        raise ArgumentError(
            "grasp_stability needs a compliant grasp or a patch; loop_stability is for rigid ones"
        )
    loop = _GraspLoop(simulation)
    radius = loop.radius(1.0)
    is_stable = radius < 1.0 + NEUTRAL
    holds_from = 1.0 if is_stable else loop.least_factor()
    springs, patches = chain.springs, chain.patches
    deflection = springs.at(q, simulation.plant.v).deflection if springs.arms else np.zeros((0, 6))
    gaps = [chain.gap(arm, q) for arm in patches.arms]
    distances = [*np.linalg.norm(deflection[:, :3], axis=1), *(gap.distance for gap in gaps)]
    angles = [*np.linalg.norm(deflection[:, 3:], axis=1), *(gap.angle for gap in gaps)]
    positions = np.array([X.translation for part in (springs, patches) for X in part.payload_poses(q)])
    soft = [min(grasp.stiffness[:3]) for grasp in cell.compliant.values()]
    soft += [min(grasp.stiffness, grasp.shear_stiffness) for grasp in cell.patches.values()]
    return GraspStability(
        radius,
        holds_from,
        None if is_stable else loop.widest_window(holds_from),
        start_stability(simulation),
        min(soft),
        float(max(distances)),
        float(max(angles)),
        float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max()),
        "compliant grasps" if cell.compliant else "patches that stick",
    )


def _wrench_errors(simulation: Simulation) -> Callable[[Array, Array], Array] | None:
    """Return the internal wrenches at a state minus those at the start; None if they are not fed back."""
    scenario, plant = simulation.scenario, simulation.plant
    cell, chain, plan = scenario.cell, simulation.chain, scenario.grasp_plan_at(0.0)
    if not scenario.controller.force_path.measures or len(cell.unclosed) < len(cell.arms):
        return None
    springs, patches = chain.springs, chain.patches

    def internal(q: Array, v: Array) -> Array:
        X_WP, about_P = chain.payload_pose(q), np.zeros((len(cell.arms), 6))
        if springs.arms:
            about_P[springs.arms] = springs.at(q, v).on_body
        if patches.arms:
            about_P[patches.arms] = patches.at(q, v).on_bodies[: len(patches.arms)]
        about_P[:, 3:] -= np.cross(X_WP[:3, 3], about_P[:, :3])
        if plan.linkage is None:
            f = internal_wrenches(about_P, cell.shares)
        else:
            in_payload = rotate_vector6(X_WP[:3, :3].T, about_P.sum(axis=0))
            f = about_P - rotate_vector6(X_WP[:3, :3], plan.linkage @ in_payload)
        return np.array([cell.task_rows.select(each) for each in f])

    start = internal(plant.q, plant.v)
    return lambda q, v: internal(q, v) - start


class _GraspLoop:
    """Sampled loop of a law on grasps that give, linear at the start."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, q, errors = simulation, simulation.plant.q, _wrench_errors(simulation)
        motion = sampled_motion(simulation, q, 0.0)
        self._N, self._law = motion.motions.basis, np.array((motion.feedback, motion.integral))
        self._by_wrench = 0.0 * self._law
        if errors is not None:
            fed = sampled_motion(simulation, q, 0.0, errors)
            self._by_wrench = np.array((fed.feedback, fed.integral)) - self._law

    def least_factor(self) -> float:
        """Return the factor of the stiffness from which on the motion does not grow; inf if there is none.

        Stable windows below it do not count, so that the search comes from above.
        """
        low = high = _STIFFEST
        while low > 1.0 and self._is_stable(low):
            low, high = low / _STRIDE, low
        return math.inf if low == _STIFFEST else self._edge(high, low)

    def widest_window(self, below: float) -> tuple[float, float] | None:
        """Return the widest range of factors from 1 to another in which the motion does not grow; or None.

        Ranges narrower than a fifth of their factor may be missed.
        """
        count = math.floor(math.log(min(below, _STIFFEST)) / math.log(_STRIDE))
        factors = [_STRIDE**power for power in range(count + 1)]
        windows, start = list[tuple[float, float]](), 1.0
        for low, high in itertools.pairwise(factors):
            was, stays = self._is_stable(low), self._is_stable(high)
            if stays and not was:
                start = self._edge(high, low)
            if was and not stays:
                windows.append((start, self._edge(low, high)))
        return max(windows, key=lambda window: window[1] / window[0], default=None)

    def _is_stable(self, factor: float) -> bool:
        return self.radius(factor) < 1.0 + NEUTRAL

    def _edge(self, stable: float, unstable: float) -> float:
        """Return the stable side of the edge between two factors."""
        return factor_edge(self._is_stable, stable, unstable, _FACTOR_ERROR)

    def radius(self, stiffer: float) -> float:
        """Return the largest ``|z|`` with the stiffness times a factor, at the same damping ratios."""
        A, basis = plant_matrix(self._simulation.chain, self._simulation.plant.q, stiffer)
        turn = np.kron(np.eye(2), basis.T @ self._N)  # both are bases of the same motions
        A, n = turn.T @ A @ turn, len(A) // 2
        springs = np.repeat((stiffer, math.sqrt(stiffer)), n)  # wrenches of springs, and of dampers
        tick = closed_tick(*_held(A, self._simulation.scenario), *(self._law + springs * self._by_wrench))
        return float(np.abs(np.linalg.eigvals(tick)).max())


def _held(A: Array, scenario: Scenario) -> tuple[Array, Array]:
    """Return the map of [y, w, b] over a tick, and that of a held acceleration by torques, shape (3 n, n).

    Args:
        A: Matrix of [y, w].
        scenario: Period, and lag of the drives, behind which b is the acceleration that acts.
    """
    from scipy.linalg import expm  # slow to load

    n, period, lag = len(A) // 2, scenario.clock.period, scenario.actuator_lag
    to_w, rate = (
        np.vstack((np.zeros((n, n)), np.eye(n))),
        np.eye(n) / (lag * period) if lag else np.zeros((n, n)),
    )
    flow = np.block(
        [[A, to_w * bool(lag), to_w * (not lag)], [np.zeros((n, 2 * n)), -rate, rate], [np.zeros((n, 4 * n))]]
    )
    tick = expm(period * flow)
    return tick[: 3 * n, : 3 * n] * np.repeat((1.0, 1.0, float(lag > 0.0)), n), tick[: 3 * n, 3 * n :]
