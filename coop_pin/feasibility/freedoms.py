"""Freedoms of the payload that arms and grasps leave, against those that its motion asks for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import inverse_pose, rotate_vector6
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain

_BEYOND, _LEVER, _TWISTS = 1e-6, 0.1, 101
"""Part that counts as zero, lever of rotations, m, and number of twists, of the freedoms of the payload."""
_AT_REST = 1e-9
"""Speed of a motion at rest, by rounding of its spline, m/s."""
_APART = 1e-3
"""Distance or angle from which on a motion begins elsewhere than the run, m or rad."""


class Freedoms(NamedTuple):
    """Freedoms of the payload that arms and grasps leave at the start, and those that a motion asks for.

    Attributes:
        left: independent motions of the payload in the task rows.
        rows: number of task rows.
        asked: independent twists of the motion.
        beyond: largest part of a twist of the motion that is not among those left.
    """

    left: int
    rows: int
    asked: int
    beyond: float

    @property
    def ok(self) -> bool:
        """Whether the motion is among those left."""
        return self.beyond < _BEYOND

    def summary(self) -> str:
        """Return the freedoms as text, in one line."""
        text = f"arms and grasps leave the payload {self.left} of {self.rows} freedoms at the start"
        text += f", and the motion asks for {self.asked}"
        if self.ok:
            return f"{text}, which are among them"
        return f"{text}, of which {self.beyond:.2g} is not among them: choose another motion, or other grasps"


@typed
def freedoms(scenario: Scenario) -> Freedoms:
    """Return the freedoms that arms and grasps leave the payload, against those of the motion.

    Twists of the motion are looked at from its beginning to its end, about P in payload axes, with the
    closures of the start; a rotation over 0.1 m counts as much as a position. Of a payload with a base, whose
    freedom is one screw, the way from the start to that beginning counts as a twist, too.
    """
    chain, motion, rows = (
        CellChain(scenario.cell, scenario.plant),
        scenario.payload_motion,
        scenario.cell.task_rows,
    )
    stated, X_WP = scenario.start_angles, scenario.start.matrix
    q = chain.posed_configuration(stated, X_WP) if stated else chain.configuration(X_WP)
    closures = chain.mechanism.closures.state(q, np.zeros(chain.mechanism.model.nv)).jacobian
    _, sizes, V = np.linalg.svd(closures)
    N = V[int((sizes > _BEYOND * sizes[0]).sum()) :].T
    scale = np.where(rows.are_linear, 1.0, _LEVER)
    moves = np.linalg.svd((rows.select(chain.payload_jacobian(q)) @ N) * scale[:, None])
    left = int((moves[1] > _BEYOND * moves[1].max(initial=_LEVER)).sum())  # of none, too
    targets = [motion.at(time) for time in np.linspace(0.0, scenario.duration, _TWISTS).tolist()]
    turned = [rotate_vector6(X_WP[:3, :3] @ at.X_WP_d[:3, :3].T, at.V_WP_d) for at in targets]
    links = scenario.cell.payload.links
    if links is not None and links.base is not None:
        turned += [way for way in [_way(X_WP, targets[0].X_WP_d)] if np.abs(way).max() > _APART]
    twists = np.array([rows.select(V) * scale for V in turned])
    size = max(float(np.linalg.norm(twists, axis=1).max()), _AT_REST)
    outside = twists - twists @ moves[0][:, :left] @ moves[0][:, :left].T
    asked = int((np.linalg.svd(twists, compute_uv=False) > _BEYOND * size).sum())
    return Freedoms(left, rows.size, asked, float(np.linalg.norm(outside, axis=1).max()) / size)


def _way(X_WP: Array, X_WP_d: Array) -> Array:
    """Return the twist about P in world axes that leads from one pose to another in 1 s, shape (6,)."""
    X = pin.log6(pin.SE3(inverse_pose(X_WP) @ X_WP_d)).vector
    return rotate_vector6(X_WP[:3, :3], X)
