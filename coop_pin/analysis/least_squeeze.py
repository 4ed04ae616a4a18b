"""Least squeeze with which patches or pads carry the payload along the desired motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.description.contact import Pad
from coop_pin.description.scenario import Scenario
from coop_pin.spatial import rotate_vector6, shift_wrench
from coop_pin.spatial.internal_wrench import linkage_loads

_POSES = 401


class LeastSqueeze(NamedTuple):
    """Normal force that friction needs at a patch or pad, where it exceeds the stated one by most.

    Attributes:
        force: least normal force besides that of the load, N.
        stated: normal force of the desired squeeze then, N.
        arm: name of the arm.
        time: time of the motion, s.
        by_moment: whether it is the moment about an axis in the plane that asks for it, not friction.
    """

    force: float
    stated: float
    arm: str
    time: float
    by_moment: bool

    @property
    def ok(self) -> bool:
        """Whether the stated squeeze carries the payload."""
        return self.stated > self.force

    def summary(self) -> str:
        """Return the forces as one line."""
        why = "the moment on the patch" if self.by_moment else "friction"
        text = (
            f"least squeeze for {why} {self.force:.3g} N, at arm {self.arm!r} at {self.time:.3g} s;"
            f" stated are {self.stated:.3g} N"
        )
        return text if self.ok else f"! {text}: the payload would slip; squeeze more, or move slower"


def least_squeeze(scenario: Scenario) -> LeastSqueeze | None:
    """Return the least squeeze of the cell's patches and pads along the motion; None without any.

    With the load (f, N_0, m) that the motion puts on a patch of torsion radius r, by the split of the law,
    slip asks for N >= sqrt(f . f + (m / r)^2) / mu (the ellipsoid), and the moment m_t about axes in the
    plane for N >= |m_t / l| with the levers l of the pad; N_0 counts. Friction of arms, errors of the law
    and events are not in it.

    Args:
        scenario: Scenario with motion and squeeze.
    """
    cell = scenario.cell
    if not cell.padded:
        return None
    worst: LeastSqueeze | None = None
    motion, L = scenario.motion.replace(), _loads(scenario)
    for time in np.linspace(0.0, scenario.duration, _POSES).tolist():
        target, squeeze = motion.at(time), scenario.squeeze.at(time, cell.grasps)
        resultant = _resultant(cell, target.X_WP_d[:3, :3], target.V_WP_d, target.A_WP_d)
        for index, name in enumerate(cell.arms):
            if name not in cell.padded:
                continue
            pad: Pad = cell.patches.get(name) or cell.pads[name]
            load, stated = (_in_plane(cell, name, pad, F) for F in (L[index] @ resultant, squeeze[index]))
            slip = np.hypot(np.linalg.norm(load[:2]), load[5] / pad.torsion_radius) / pad.mu
            tilt = float(np.linalg.norm(load[3:5] / pad.levers))
            force = max(float(slip), tilt) - float(load[2])
            least = LeastSqueeze(force, float(stated[2]), name, time, tilt > slip)
            if worst is None or least.stated - least.force < worst.stated - worst.force:
                worst = least
    return worst


def _loads(scenario: Scenario) -> Array:
    """Return L_i with the load L_i sum_j F_j of each arm by the split of the law, shape (m, 6, 6)."""
    cell = scenario.cell
    if scenario.controller.force_path.split == "shares":
        return cell.shares[:, None, None] * np.eye(6)
    return linkage_loads(np.array([grasp.matrix[:3, 3] for grasp in cell.grasps.values()]))


def _resultant(cell: Cell, R: Array, V: Array, A: Array) -> Array:
    """Return the wrench that the moving payload puts on the arms about P in payload axes, shape (6,)."""
    payload, inertia = cell.payload, cell.payload.inertia_matrix
    omega, alpha = R.T @ V[3:], R.T @ A[3:]
    force = payload.mass * (R.T @ (np.array(cell.gravity) - A[:3]))
    return np.concatenate((force, -inertia @ alpha - np.cross(omega, inertia @ omega)))


def _in_plane(cell: Cell, name: str, pad: Pad, F: Array) -> Array:
    """Return a wrench about P in payload axes about the middle of a pad in axes of its plane."""
    X = cell.grasps[name].matrix
    return rotate_vector6((X[:3, :3] @ pad.plane[:3, :3]).T, shift_wrench(F, -X[:3, 3]))
