"""End stops of the joints of arms: one-sided springs and dampers in the plant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import PASSIVE, JointLimits, per_joint

_Numbers = NDArray[Any]
"""Floats or traced numbers."""
_FAR = 1e6
"""Limit in place of none, rad or m."""


class StopState(NamedTuple):
    """End stops at a state.

    Attributes:
        force: generalised force on the joints, N m or N, shape (k,).
        energy: energy in the springs, J.
        power: power of the dampers, W; not positive.
    """

    force: _Numbers
    energy: Any
    power: Any


class JointStops(NamedTuple):
    """Springs and dampers at the position limits of joints, see EndStops.

    Attributes:
        lower: smallest joint positions, rad or m, shape (k,).
        upper: largest joint positions, likewise.
        stiffness: k, N m/rad or N/m, shape (k,); zero for a joint without limits.
        damping: c, N m s/rad or N s/m, shape (k,).
    """

    lower: _Numbers
    upper: _Numbers
    stiffness: _Numbers
    damping: _Numbers

    @classmethod
    def of_arm(cls, arm: Arm, name: str) -> JointStops | None:
        """Return the stops of an arm without damping; None if it has none.

        Raises:
            FieldError: the stiffness has another size, or follows from no limit of a drive.
        """
        if arm.stops is None:
            return None
        limits, path = JointLimits(arm, name), f"cell.arms.{name}.stops.stiffness"
        has_stop = np.isfinite(limits.lower) & np.isfinite(limits.upper)
        joints = len(has_stop)
        if arm.stops.stiffness is None:
            drives = np.where(limits.torque > PASSIVE, limits.torque, np.inf)
            share = np.abs(arm.drive_matrix(joints).T)
            force = np.where(share > 0.0, share * np.where(share > 0.0, drives, 0.0), 0.0).sum(axis=1)
            if unknown := np.flatnonzero(has_stop & ~np.isfinite(force)).tolist():
                names = ", ".join(limits.joints.names[j] for j in unknown)
                raise FieldError(f"must be stated: the drives of {names} have no torque limit", path)
            stiffness = np.where(has_stop, force, 0.0) / arm.stops.give
        else:
            stiffness = has_stop * per_joint(np.array(arm.stops.stiffness), joints, path)
        lower, upper = (np.clip(limit, -_FAR, _FAR) for limit in (limits.lower, limits.upper))
        return cls(lower, upper, stiffness, np.zeros(joints))

    def damped(self, ratio: float, mobility: Array) -> JointStops:
        """Return the stops with the damping c = 2 ratio sqrt(k / W), W of each joint, shape (k,)."""
        return self._replace(damping=2.0 * ratio * np.sqrt(self.stiffness / mobility))

    def state(self, q: _Numbers, v: _Numbers) -> StopState:
        """Return forces, energy and power at joint positions and rates, floats or traced, shape (k,) each.

        With the depth d, positive beyond the upper limit and negative beyond the lower one::

            force = -max(k d + c v, 0) for d > 0,  -min(k d + c v, 0) for d < 0
            energy = sum k d^2 / 2,  power = sum (force + k d) v
        """
        depth = np.maximum(q - self.upper, 0.0) - np.maximum(self.lower - q, 0.0)
        pushed = self.stiffness * depth
        push = pushed + self.damping * v
        above, below = np.maximum(push, 0.0), np.minimum(push, 0.0)
        force = -np.where(depth > 0.0, above, np.where(depth < 0.0, below, 0.0))
        return StopState(force, 0.5 * (pushed @ depth), (force + pushed) @ v)


class CellStops:
    """End stops of the arms of a cell, in the coordinates of its tree.

    Attributes:
        arms: stops of each arm; None where it has none.
    """

    def __init__(self, cell: Cell, slots: Sequence[ArmPlace], nv: int) -> None:
        """Read the stops; raises as ``JointStops.of_arm``."""
        self._cell, self._slots, self._nv = cell, slots, nv
        self.arms = [JointStops.of_arm(arm, name) for name, arm in cell.arms.items()]

    def __bool__(self) -> bool:
        """Return whether an arm has stops."""
        return any(stops is not None for stops in self.arms)

    def damp(self, mobility: Array) -> None:
        """Set the damping, by the mobility of each joint, shape (nv,)."""
        for index, (stops, slot) in enumerate(zip(self.arms, self._slots, strict=True)):
            options = self._cell.arms[slot.name].stops
            if stops is not None and options is not None:
                self.arms[index] = stops.damped(options.damping_ratio, mobility[slot.v_slice])

    def rates(self, mobility: Array) -> Array:
        """Return sqrt(k W) of each joint on its stop, 1/s, shape (nv,)."""
        rates = np.zeros(self._nv)
        for stops, slot in zip(self.arms, self._slots, strict=True):
            if stops is not None:
                rates[slot.v_slice] = np.sqrt(stops.stiffness * mobility[slot.v_slice])
        return rates

    def state(self, q: Array, v: Array) -> StopState:
        """Return the stops at a state of the tree; forces of shape (nv,)."""
        force, energy, power = np.zeros(self._nv), 0.0, 0.0
        for arm, slot in zip(self._states(q, v), self._slots, strict=True):
            if arm is not None:
                force[slot.v_slice] = arm.force
                energy, power = energy + float(arm.energy), power + float(arm.power)
        return StopState(force, energy, power)

    def quantities(self, q: Array, v: Array) -> dict[str, Any]:
        """Return what is observed of the stops at a state, by name; nothing where no arm has any."""
        values = stop_quantities(self._states(q, v), [len(slot.drive) for slot in self._slots])
        return {name: np.asarray(value, dtype=float) for name, value in values.items()}

    def _states(self, q: Array, v: Array) -> list[StopState | None]:
        pairs = zip(self.arms, self._slots, strict=True)
        return [
            stops and stops.state(slot.angles.of(q[slot.q_slice]), v[slot.v_slice]) for stops, slot in pairs
        ]


def stop_quantities(states: Sequence[StopState | None], joints: Sequence[int]) -> dict[str, Any]:
    """Return what is observed of end stops by name, see Observation; nothing where no arm has any.

    Args:
        states: State of each arm's stops, of floats or traced numbers; None where it has none.
        joints: Number of joints of each arm.
    """
    stopped = {index: state for index, state in enumerate(states) if state is not None}
    if not stopped:
        return {}
    force: _Numbers = np.full((len(states), max(joints)), np.nan, dtype=object)
    for index, state in stopped.items():
        force[index, : joints[index]] = state.force
    return {"stop_force": force, "stop_energy": sum((state.energy for state in stopped.values()), 0.0)}
