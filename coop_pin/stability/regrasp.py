"""Payloads that hang on the springs of the arms that hold them, and gaps of tips that come back to them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import weight_wrench
from coop_pin.description.cell.grasp_plan import GraspPlan
from coop_pin.description.grasp_events import GraspEvent, Regrasp
from coop_pin.description.scenario import Scenario
from coop_pin.description.thresholds import TaskLimits

_BEFORE = 1e-9
"""Time before a take-hold at which the others still hold alone, s."""


class RegraspGap(NamedTuple):
    """Gap to expect when an arm takes hold again.

    Attributes:
        event: the take-hold.
        distance: distance of the tip from its nominal grasp, m.
        angle: angle between them, rad.
    """

    event: Regrasp
    distance: float
    angle: float

    @property
    def use(self) -> float:
        """Gap over its tolerance, of distance or angle."""
        return max(self.distance / self.event.tolerance, self.angle / self.event.angle_tolerance)

    @property
    def ok(self) -> bool:
        """Whether the grasp happens."""
        return self.use <= 1.0

    def summary(self) -> str:
        """Return gap and tolerances as text in one line."""
        event, distance, angle = self
        text = (
            f"{event.named}: the payload hangs on the others, {1e3 * distance:.3g} mm and"
            f" {1e3 * angle:.3g} mrad from where the tip looks for it; allowed are"
            f" {1e3 * event.tolerance:g} mm and {1e3 * event.angle_tolerance:g} mrad"
        )
        return text if self.ok else f"{text}: the grasp will not happen"


class GraspSag(NamedTuple):
    """Error to expect of a payload on the springs that hold it from a grasp event on.

    Attributes:
        event: release, hand-over or take-hold.
        distance: distance of P from the reference, m.
        angle: angle between them, rad.
    """

    event: GraspEvent
    distance: float
    angle: float

    def use(self, limits: TaskLimits) -> float:
        """Return the error over what a task allows, of distance or angle."""
        return max(self.distance / limits.position, self.angle / limits.orientation)

    def summary(self, limits: TaskLimits) -> str:
        """Return error and what a task allows as text in one line."""
        return (
            f"{self.event.named}: from then on the payload hangs {1e3 * self.distance:.3g} mm and"
            f" {1e3 * self.angle:.3g} mrad from its reference on the grasps that hold it; the task allows"
            f" {1e3 * limits.position:g} mm and {1e3 * limits.orientation:g} mrad"
        )


@typed
def regrasp_gaps(scenario: Scenario) -> tuple[RegraspGap, ...]:
    """Return the gaps to expect at the take-holds of a scenario, at rest on the reference.

    About P, with the weight w, the compliances C_i of grasps, load shares c_i at the start (matrices, where
    the virtual linkage splits the load), and the arms H that hold the payload alone, with shares c'_i then::

        tips     T_i = -C_i c_i w  on the task rows of a law that is zeroed at the grasp, else 0
        payload  delta = (sum_H C_i^-1)^-1 (w + sum_H C_i^-1 T_i),  or  sum_H c'_i (T_i + C_i c'_i w)
        gap      delta - T of the tip, at its grasp

    The second delta is that of laws that measure wrenches: their arms bear what the plan says. A grasp that
    takes hold as found has T_i = delta from then on: the payload hangs lower each time.
    A rigid grasp among those of H leaves delta = 0. What the law itself leaves of an error is not in it.

    Args:
        scenario: scenario with its events.
    """
    gaps = list[RegraspGap]()
    for event, T, delta, _ in _hangings(scenario):
        if isinstance(event, Regrasp):
            gap = delta - T
            distance = np.linalg.norm(gap[:3] + np.cross(gap[3:], scenario.cell.grasps[event.arm].xyz))
            gaps.append(RegraspGap(event, float(distance), float(np.linalg.norm(gap[3:]))))
    return tuple(gaps)


@typed
def grasp_sags(scenario: Scenario) -> tuple[GraspSag, ...]:
    """Return the delta of ``regrasp_gaps`` from each grasp event on.

    Args:
        scenario: scenario with its events.
    """
    return tuple(
        GraspSag(event, float(np.linalg.norm(delta[:3])), float(np.linalg.norm(delta[3:])))
        for event, _, _, delta in _hangings(scenario)
    )


def _hangings(scenario: Scenario) -> Iterator[tuple[GraspEvent, Array, Array, Array]]:
    """Yield each grasp event with T of its arm before it, and delta before it and after it."""
    cell, law = scenario.cell, scenario.controller
    C = np.array([cell.compliance(name) for name in cell.arms])
    shares, rests = _shares(scenario.grasp_plan_at(0.0)), dict[int, Array]()
    motion = scenario.payload_motion  # reads a table again
    is_controlled = np.isin(np.arange(6), cell.task_rows.indices)

    def at_rest(time: float) -> tuple[Array, Array]:
        """Return T of all arms, shape (m, 6), and delta, shape (6,)."""
        around, plan = scenario.surroundings_at(time), scenario.grasp_plan_at(time)
        holds, R = plan.holds, motion.at(time).X_WP_d[:3, :3]
        w = (weight_wrench(around.mass, around.gravity).reshape(2, 3) @ R).ravel()
        T = -law.near_rest.is_zeroed * is_controlled * (C @ (shares @ w)[..., None])[..., 0]
        for arm, rest in rests.items():
            T[arm] = rest
        if not (plan.borne and holds.any() and C[holds].any(axis=(1, 2)).all()):
            return T, np.zeros(6)
        if law.force_path.measures:
            stretched = (C[holds] @ (_shares(plan)[holds] @ w)[..., None])[..., 0]
            return T, np.einsum("m,mi->i", plan.shares[holds], T[holds] + stretched)
        K = np.linalg.inv(C[holds])
        return T, np.linalg.solve(K.sum(axis=0), w + np.einsum("mij,mj->i", K, T[holds]))

    for event in sorted(scenario.grasp_events, key=lambda event: event.time):
        arm, (T, before) = list(cell.arms).index(event.arm), at_rest(event.time - _BEFORE)
        if isinstance(event, Regrasp):
            rests.pop(arm, None)
            if event.rest == "found":
                rests[arm] = before
        yield event, T[arm], before, at_rest(event.end)[1]


def _shares(plan: GraspPlan) -> Array:
    """Return the parts of the load that arms bear, as matrices, shape (m, 6, 6)."""
    return plan.shares[:, None, None] * np.eye(6) if plan.linkage is None else plan.linkage
