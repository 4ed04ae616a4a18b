"""Gap between a tip that comes back and its grasp: the payload hangs on the springs of the others then."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import weight_wrench
from coop_pin.description.cell.grasp_plan import GraspPlan
from coop_pin.description.events import of_kind
from coop_pin.description.grasp_events import Regrasp
from coop_pin.description.scenario import Scenario

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


@typed
def regrasp_gaps(scenario: Scenario) -> tuple[RegraspGap, ...]:
    """Return the gaps to expect at the take-holds of a scenario, at rest on the reference.

    About P, with the weight w, the compliances C_i of grasps, load shares c_i at the start (matrices, where
    the virtual linkage splits the load), and the arms H that hold the payload alone, with shares c'_i then::

        tips     T_i = -C_i c_i w  where the law is zeroed at the grasp, else 0
        payload  delta = (sum_H C_i^-1)^-1 (w + sum_H C_i^-1 T_i),  or  sum_H c'_i (T_i + C_i c'_i w)
        gap      delta - T of the tip, at its grasp

    The second delta is that of laws that measure wrenches: their arms bear what the plan says.
    A rigid grasp among those of H leaves delta = 0. What the law itself leaves of an error is not in it.

    Args:
        scenario: scenario with its events.
    """
    cell = scenario.cell
    C = np.array([cell.compliance(name) for name in cell.arms])
    shares = _shares(scenario.grasp_plan_at(0.0))
    motion = scenario.payload_motion  # reads a table again
    is_zeroed = scenario.controller.near_rest.is_zeroed
    gaps = list[RegraspGap]()
    for event in of_kind(scenario.events, Regrasp):
        time = event.time - _BEFORE
        R = motion.at(time).X_WP_d[:3, :3]
        around, plan = scenario.surroundings_at(time), scenario.grasp_plan_at(time)
        holds, borne = plan.holds, _shares(plan)[plan.holds]
        w = (weight_wrench(around.mass, around.gravity).reshape(2, 3) @ R).ravel()
        T = -is_zeroed * (C @ (shares @ w)[..., None])[..., 0]
        delta = np.zeros(6)
        if holds.any() and C[holds].any(axis=(1, 2)).all():
            K = np.linalg.inv(C[holds])
            delta = np.linalg.solve(K.sum(axis=0), w + np.einsum("mij,mj->i", K, T[holds]))
            if scenario.controller.force_path.measures:
                stretched = (C[holds] @ (borne @ w)[..., None])[..., 0]
                delta = np.einsum("m,mi->i", plan.shares[holds], T[holds] + stretched)
        gap = delta - T[list(cell.arms).index(event.arm)]
        distance = np.linalg.norm(gap[:3] + np.cross(gap[3:], cell.grasps[event.arm].xyz))
        gaps.append(RegraspGap(event, float(distance), float(np.linalg.norm(gap[3:]))))
    return tuple(gaps)


def _shares(plan: GraspPlan) -> Array:
    """Return the parts of the load that arms bear, as matrices, shape (m, 6, 6)."""
    return plan.shares[:, None, None] * np.eye(6) if plan.linkage is None else plan.linkage
