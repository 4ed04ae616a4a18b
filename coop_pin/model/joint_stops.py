"""End stops of the joints of arms and payloads: one-sided springs and dampers in the plant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.linkage import Linkage
from coop_pin.model.cell_model import ArmPlace, CellModel
from coop_pin.model.joint_limits import PASSIVE, JointLimits, per_joint
from coop_pin.model.mechanism_model import LinkedPayload
from coop_pin.model.pinocchio_model import symmetric

_Numbers = NDArray[Any]
"""Floats or traced numbers."""
_FAR = 1e6
"""Limit in place of none, rad or m."""
_STUCK = 1e-9
"""Mobility of a joint that grasps hold still, 1/(kg m^2) or 1/kg."""
_SWING = 30.0
"""Rate of a joint of a payload on a stop whose stiffness is not stated, 1/s."""


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
        damping_ratio: that of the joint on its stop, one for all joints or shape (k,).
    """

    lower: _Numbers
    upper: _Numbers
    stiffness: _Numbers
    damping: _Numbers
    damping_ratio: _Numbers | float = 0.0

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
        return cls(lower, upper, stiffness, np.zeros(joints), arm.stops.damping_ratio)

    @classmethod
    def of_payload(cls, links: Linkage, linked: LinkedPayload) -> JointStops:
        """Return the stops of the joints of a payload without damping; continuous ones have none.

        Where k is not stated it is w^2 / W, with w = 30 rad/s and the mobility W of the joint in the payload
        that nobody holds, so that w is the most in any grasps at the start.
        """
        model, at, joints = linked.model, linked.v_slice, [links.joint(name) for name in linked.joint_names]
        q, first = pin.neutral(model), at.start - (6 if linked.root else 0)
        q[linked.q_slice] = linked.angles.configuration(linked.start)
        M = symmetric(pin.crba(model, model.createData(), q))[first : at.stop, first : at.stop]
        k = [
            _SWING**2 / W if joint.stop_stiffness is None else joint.stop_stiffness
            for joint, W in zip(joints, np.diag(np.linalg.inv(M))[-len(joints) :], strict=True)
        ]
        entries, limits = (
            linked.q_slice.start + linked.angles.entry,
            (model.lowerPositionLimit, model.upperPositionLimit),
        )
        lower, upper = (np.where(linked.angles.continuous, 0.0, limit[entries]) for limit in limits)
        ratios = np.array([joint.stop_damping_ratio for joint in joints])
        return cls(lower, upper, ~linked.angles.continuous * np.array(k), np.zeros(len(joints)), ratios)

    def damped(self, mobility: Array) -> JointStops:
        """Return the stops with the damping c = 2 ratio sqrt(k / W), W of each joint, shape (k,)."""
        W = np.maximum(mobility, _STUCK)
        return self._replace(damping=2.0 * self.damping_ratio * np.sqrt(self.stiffness / W))

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
    """End stops of the arms of a cell and of the joints of its payload, in the coordinates of its tree."""

    def __init__(self, cell: Cell, tree: CellModel) -> None:
        """Read the stops; raises as ``JointStops.of_arm``."""
        self._places: list[ArmPlace | LinkedPayload] = [*tree.arms]
        self._stops = [JointStops.of_arm(arm, name) for name, arm in cell.arms.items()]
        self._arms, self._nv = len(tree.arms), tree.model.nv
        if cell.payload.links is not None and tree.linked is not None:
            self._places.append(tree.linked)
            self._stops.append(JointStops.of_payload(cell.payload.links, tree.linked))

    def __bool__(self) -> bool:
        """Return whether there are stops."""
        return any(self._stops)

    def __iter__(self) -> Iterator[tuple[ArmPlace | LinkedPayload, JointStops]]:
        """Yield the stops of each arm that has any, and of the payload, and the place of their joints."""
        pairs = zip(self._places, self._stops, strict=True)
        yield from ((slot, stops) for slot, stops in pairs if stops is not None)

    @property
    def arms(self) -> list[JointStops | None]:
        """Stops of each arm; None where it has none."""
        return self._stops[: self._arms]

    def damp(self, mobility: Array) -> None:
        """Set the damping, by the mobility of each joint, shape (nv,)."""
        pairs = zip(self._places, self._stops, strict=True)
        self._stops = [stops and stops.damped(mobility[slot.v_slice]) for slot, stops in pairs]

    def rates(self, mobility: Array) -> Array:
        """Return sqrt(k W) of each joint on its stop, 1/s, shape (nv,)."""
        rates = np.zeros(self._nv)
        for slot, stops in self:
            rates[slot.v_slice] = np.sqrt(stops.stiffness * np.maximum(mobility[slot.v_slice], _STUCK))
        return rates

    def state(self, q: Array, v: Array) -> StopState:
        """Return the stops at a state of the tree; forces of shape (nv,)."""
        force, energy, power = np.zeros(self._nv), 0.0, 0.0
        for slot, state in zip(self._places, self._states(q, v), strict=True):
            if state is not None:
                force[slot.v_slice] = state.force
                energy, power = energy + float(state.energy), power + float(state.power)
        return StopState(force, energy, power)

    def quantities(self, q: Array, v: Array) -> dict[str, Any]:
        """Return what is observed of the stops at a state, by name; nothing where there are none."""
        if not self:
            return {}
        states = self._states(q, v)
        values = stop_quantities(
            states[: self._arms], [len(slot.angles.names) for slot in self._places[: self._arms]]
        )
        values["stop_energy"] = sum(state.energy for state in states if state is not None)
        return {name: np.asarray(value, dtype=float) for name, value in values.items()}

    def _states(self, q: Array, v: Array) -> list[StopState | None]:
        pairs = zip(self._places, self._stops, strict=True)
        return [stops and stops.state(at.angles.of(q[at.q_slice]), v[at.v_slice]) for at, stops in pairs]


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
