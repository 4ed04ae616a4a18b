"""Least squeeze with which patches or pads carry the payload along a motion, and one with a margin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, typed
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.spatial import rotate_vector6
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import Pad
from coop_pin.description.events import Surroundings
from coop_pin.description.scenario import Scenario
from coop_pin.model.pinocchio_model import momentum_rate
from coop_pin.reference.squeeze import TipForceSqueeze

_POSES, _FEWER = 401, 101
MARGIN = 1.5
"""Proposed squeeze over the least one: where a payload of unknown weight left a table, the law asked for 1.09
times what its motion does."""
_MOST, _CLOSE = 1e4, 1e-3
"""Normal force from which on no squeeze carries the payload, N; error of the proposed one."""


class LeastSqueeze(NamedTuple):
    """Normal force that friction needs at a patch or pad, where it is the largest part of the stated one.

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

    @property
    def use(self) -> float:
        """Least part of the stated one, of which friction needs 1 at the onset of slip; inf if none is."""
        if self.force <= 0.0:
            return 0.0
        return self.force / self.stated if self.stated > 0.0 else np.inf

    def summary(self) -> str:
        """Return the forces as one line."""
        why = "the moment on the patch" if self.by_moment else "friction"
        text = (
            f"least squeeze for {why} {self.force:.3g} N, at arm {self.arm!r} at {self.time:.3g} s;"
            f" stated are {self.stated:.3g} N"
        )
        return text if self.ok else f"{text}: the payload would slip; squeeze more, or move slower"


@typed
def least_squeeze(scenario: Scenario, *, poses: int = _POSES) -> LeastSqueeze | None:
    """Return the least squeeze of the cell's patches and pads along the motion; None without any.

    With the load (f, N_0, m) that the motion puts on a patch, and the part (f_d, N_d, m_d) of the squeeze, by
    the law's split and the plan of grasps, mu N must be the friction that (f + f_d, m + m_d) needs by
    ``spatial.limit_surface``, pressed as by the stated squeeze. The moment m_t of both in the plane asks for
    ``N >= |m_t / l|`` with the levers l of the pad; N_0 counts, and N_d is what is stated. Changes of payload
    and gravity, and pushes, are in it; friction of arms, partners and errors of the law are not. A table
    bears nothing before a put-down begins, and all after it.

    Args:
        scenario: Scenario with motion and squeeze.
        poses: Number of poses looked at along the motion.
    """
    cell, motion, pads = scenario.cell, scenario.payload_motion, scenario.cell.padded
    if not pads:
        return None
    loads = {name: list[tuple[float, Array, Array]]() for name in pads}
    for time in np.linspace(0.0, scenario.duration, poses).tolist():
        target, plan = motion.at(time), scenario.grasp_plan_at(time)
        if plan.borne == 0.0:
            break
        load = _resultant(scenario.surroundings_at(time), target.X_WP_d[:3, :3], target.V_WP_d, target.A_WP_d)
        linkage = plan.carried_linkage
        parts = plan.carried[:, None, None] * np.eye(6) if linkage is None else linkage
        squeeze = plan.squeeze(scenario.squeeze.at(time, cell.grasps))
        for index, name in enumerate(cell.arms):
            if name in pads and plan.loads[index] > 0.0:
                loads[name].append((time, parts[index] @ load, squeeze[index]))
    candidates = [
        _least(cell, name, pads[name], *zip(*rows, strict=True)) for name, rows in loads.items() if rows
    ]
    return max(candidates, key=lambda least: least.use, default=None)


def with_enough_squeeze(scenario: Scenario) -> tuple[Scenario, tuple[str, ...]]:
    """Return a scenario of patches with at least 1.5 times the least squeeze, and a sentence if it is raised.

    The stated squeeze is scaled; without one the tips press along the lines between them.

    Raises:
        InfeasibleMotionError: cause "friction": no multiple carries the payload, or it is a function.
    """
    squeeze = scenario.squeeze
    if not scenario.squeeze_wrenches.any():
        scenario = scenario.replace(squeeze=TipForceSqueeze(force=1.0))
    while True:
        least = least_squeeze(scenario, poses=_FEWER)
        if least is None or MARGIN * least.use <= 1.0 + _CLOSE:
            break
        if least.stated <= 0.0 or least.stated > _MOST:
            why = f"no multiple of the squeeze holds the patch of arm {least.arm!r} at {least.time:.3g} s"
            raise InfeasibleMotionError("friction", f"{why}: press across it, or raise mu")
        scenario = scenario.replace(squeeze=scenario.squeeze.scaled(MARGIN * least.use))
    if least is None or scenario.squeeze == squeeze:
        return scenario, ()
    text = f"squeeze RAISED to {least.stated:.3g} N at arm {least.arm!r}, {MARGIN:g} times the least squeeze"
    return scenario, (text,)


def _least(
    cell: Cell, arm: str, pad: Pad, times: Sequence[float], load: Sequence[Array], squeeze: Sequence[Array]
) -> LeastSqueeze:
    """Return the least normal force of an arm's pad where it is the largest part of the stated one.

    Args:
        cell: Description.
        arm: Name of the arm.
        pad: Patch or pad of the arm.
        times: Times, s.
        load: Load of the arm at each, about P in payload axes.
        squeeze: Wrench of the squeeze, likewise.
    """
    borne, pressed = (pad.in_plane(np.array(F), cell.grasps[arm].matrix) for F in (load, squeeze))
    F = borne + pressed
    slip = pad.needed_friction(F) / pad.mu
    tilt = np.linalg.norm(F[:, 3:5] / pad.levers, axis=1)
    numbers = zip(np.maximum(slip, tilt) - borne[:, 2], pressed[:, 2], times, tilt > slip, strict=True)
    candidates = [
        LeastSqueeze(float(f), float(stated), arm, time, bool(tips)) for f, stated, time, tips in numbers
    ]
    return max(candidates, key=lambda least: least.use)


def _resultant(surroundings: Surroundings, R: Array, V: Array, A: Array) -> Array:
    """Return the wrench that the moving payload puts on the arms about P in payload axes, shape (6,)."""
    inertia = pin.Inertia(surroundings.mass, np.zeros(3), surroundings.inertia)
    turning = pin.Motion(np.zeros(3), R.T @ V[3:])  # P is at rest in a frame that moves with it
    change = pin.Motion(R.T @ (A[:3] - surroundings.gravity), R.T @ A[3:])
    return rotate_vector6(R.T, surroundings.push) - momentum_rate(inertia, turning, change)
