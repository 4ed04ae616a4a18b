"""All closures of a tree, stacked: errors, Jacobian and drift at a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.closure import Closure
from coop_pin.chain.closure_kinematics import ClosureError, error_function
from coop_pin.model.pinocchio_model import frame_id


class ClosureState(NamedTuple):
    """The stacked closure errors at a state, r rows in all.

    Attributes:
        position: e, m and rad, shape (r,).
        velocity: e' = J v, m/s and rad/s, shape (r,).
        jacobian: J, shape (r, nv).
        drift: gamma with e'' = J a + gamma, shape (r,).
        wrench_map: maps multipliers lambda to the wrench on body a of each closure at a, in axes a, shape (closures, 6, r).
    """

    position: Array
    velocity: Array
    jacobian: Array
    drift: Array
    wrench_map: Array


class Gap(NamedTuple):
    """How far a closure stands open in its held rows.

    Attributes:
        distance: m.
        angle: rad.
    """

    distance: float
    angle: float


class Closures:
    """The closures of a tree.

    Attributes:
        closures: as given.
        rows: total number of rows r.
    """

    def __init__(self, model: pin.Model, closures: Sequence[Closure]) -> None:
        """Resolve every frame once.

        Raises:
            FrameNotFoundError: a frame does not exist.
        """
        self.closures = tuple(closures)
        self.frames = [(frame_id(model, c.frame_a), frame_id(model, c.frame_b)) for c in self.closures]
        self._errors = [error_function(c) for c in self.closures]
        self.sizes = [sum(c.mask) for c in self.closures]
        self.rows = sum(self.sizes)
        self._model, self._data = model, model.createData()

    def state(self, q: Array, v: Array) -> ClosureState:
        """Return errors, Jacobian and drift of all closures."""
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        position, drift = np.zeros(self.rows), np.zeros(self.rows)
        jacobian, wrench_map = np.zeros((self.rows, model.nv)), np.zeros((len(self.closures), 6, self.rows))
        first = 0
        for index, (frame_a, frame_b) in enumerate(self.frames):
            rows = slice(first, first := first + self.sizes[index])
            error = self._error(index, frame_a, frame_b)
            position[rows] = error.position
            wrench_map[index, :, rows] = error.A_a.T
            for A, frame in ((error.A_a, frame_a), (error.A_b, frame_b)):
                jacobian[rows] += A @ pin.getFrameJacobian(model, data, frame, pin.LOCAL)
                drift[rows] += A @ pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector
            drift[rows] += error.drift
        return ClosureState(position, jacobian @ v, jacobian, drift, wrench_map)

    def _error(self, index: int, frame_a: int, frame_b: int) -> ClosureError:
        X_ab = self._data.oMf[frame_a].actInv(self._data.oMf[frame_b])
        V_a = pin.getFrameVelocity(self._model, self._data, frame_a, pin.LOCAL)
        V_b = pin.getFrameVelocity(self._model, self._data, frame_b, pin.LOCAL)
        return self._errors[index](X_ab, V_a, V_b)

    def gaps(self, q: Array) -> list[Gap]:
        """Return how far each closure stands open at q."""
        pin.framesForwardKinematics(self._model, self._data, q)
        nothing = pin.Motion.Zero()
        gaps = []
        for index, (frame_a, frame_b) in enumerate(self.frames):
            X_ab = self._data.oMf[frame_a].actInv(self._data.oMf[frame_b])
            error = np.zeros(6)
            error[list(self.closures[index].mask)] = self._errors[index](X_ab, nothing, nothing).position
            gaps.append(Gap(float(np.sqrt(error[:3] @ error[:3])), float(np.sqrt(error[3:] @ error[3:]))))
        return gaps
