"""Frames of a cell in motion: payload, tips and grasps, with what follows of their motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, frozen
from coop_pin.chain.closure_set import ClosureError
from coop_pin.model.cell_model import CellModel
from coop_pin.model.pinocchio_model import frame_id, jacobian_matrix, kinetic_energy, momentum_rate

_CLOSED_BY_TREE = ClosureError(0.0, 0.0)

_NO_RATES: Array = frozen(np.empty(0))


class GraspFrames:
    """Frames of payload, tips and grasps at the last state, as references into Pinocchio's data.

    They follow ``move``; indexing Pinocchio's vector of frames would take longer than moving them all.

    Attributes:
        payload: X_WP.
        tips: X_WE of each arm.
        grasps: pose of each nominal grasp in the world.
        welded: indices of the arms whose grasp is a weld of the tree.
        velocity: v of the last motion, shape (nv,); empty where it had none.
        acceleration: a of it, likewise.
    """

    def __init__(self, tree: CellModel) -> None:
        self._tree, self._model, self._data = tree, tree.model, tree.model.createData()
        frames = self._data.oMf
        self.payload: pin.SE3 = frames[tree.payload_frame]
        self.tips: list[pin.SE3] = [frames[arm.tip] for arm in tree.arms]
        self.grasps: list[pin.SE3] = [
            frames[frame_id(tree.model, f"payload/{arm.name}")] for arm in tree.arms
        ]
        self.velocity = self.acceleration = _NO_RATES
        self._has_rotors = bool(self._model.armature.any())
        self.welded = [number for number, arm in enumerate(tree.arms) if arm.name in tree.closed_by_tree]

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a copy is made, whose frames refer to data of its own."""
        return GraspFrames, (self._tree,)

    def move(self, q: Array, *rates: Array) -> None:
        """Move the frames to a configuration, with v, or v and a."""
        pin.forwardKinematics(self._model, self._data, q, *rates)
        pin.updateFramePlacements(self._model, self._data)
        self.velocity, self.acceleration = (*rates, _NO_RATES, _NO_RATES)[:2]

    def payload_jacobian(self, q: Array) -> Array:
        """Return J_WP with V_WP = J_WP v, shape (6, nv)."""
        payload = self._tree.payload_frame
        return jacobian_matrix(
            pin.computeFrameJacobian(self._model, self._data, q, payload, pin.LOCAL_WORLD_ALIGNED)
        )

    def payload_twist(self) -> Array:
        """Return V_WP of the last motion, shape (6,)."""
        payload = self._tree.payload_frame
        return pin.getFrameVelocity(self._model, self._data, payload, pin.LOCAL_WORLD_ALIGNED).vector

    def tip_positions(self) -> Array:
        """Return the position of every tip in the world, m, shape (m, 3)."""
        return np.array([X_WE.translation for X_WE in self.tips])

    def closure_errors(self, closed: Mapping[int, pin.SE3 | None]) -> list[ClosureError]:
        """Return the closure error between tip and grasp of each arm, zero where the tree closes it.

        Args:
            closed: Pose of the tip in its nominal grasp by arms with a closure, as of RigidGrasps.
        """
        closure_errors = [_CLOSED_BY_TREE] * len(self.tips)
        for index, X_GE in closed.items():
            grasp = self.grasps[index] if X_GE is None else self.grasps[index] * X_GE
            error = pin.log6(self.tips[index].actInv(grasp)).vector.tolist()
            closure_errors[index] = ClosureError(math.hypot(*error[:3]), math.hypot(*error[3:]))
        return closure_errors

    def payload_balance(self) -> Array:
        """Return M_0 xddot + Q_0 xdot + W_0 of eq. (5): the resultant wrench on the payload in its axes.

        The frames must have moved with v and a.
        """
        model, data, frame = self._model, self._data, self._tree.payload_frame
        V = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
        A = pin.getFrameAcceleration(model, data, frame, pin.LOCAL) - self.payload.actInv(model.gravity)
        return momentum_rate(self._tree.payload_inertia, V, A)

    def energies(self) -> tuple[float, float]:
        """Return kinetic and potential energy of arms and payload at the last motion, J."""
        kinetic = kinetic_energy(self._model, self._data, self.velocity, has_rotors=self._has_rotors)
        return kinetic, pin.computePotentialEnergy(self._model, self._data)
