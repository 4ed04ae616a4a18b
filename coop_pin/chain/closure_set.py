"""Stacked kinematics of all closures of a tree: closure errors, Jacobian and drift at a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import NameNotFoundError
from coop_pin.chain.closure import error_function
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import Stabilisation
from coop_pin.model.pinocchio_model import frame_id, jacobian_matrix

_UNIVERSE = 0


class ClosureFrame:
    """Closure frame C on a joint J of a tree.

    Attributes:
        named: index of the named frame to which C is attached.
        joint: index of the joint; zero is the world.
        X_JC: pose of C in the joint's frame.
    """

    def __init__(self, model: pin.Model, name: str, X_FC: ArrayLike | None) -> None:
        """Find the joint that carries a frame.

        Args:
            model: the tree.
            name: name of a frame F, or "world".
            X_FC: pose of C in F, shape (4, 4); identity when None.

        Raises:
            NameNotFoundError: the frame does not exist.
        """
        self.named = _frame_id(model, name)
        frame = model.frames[self.named]
        self.joint = int(frame.parentJoint)
        self.X_JC = frame.placement if X_FC is None else frame.placement * pin.SE3(np.asarray(X_FC))
        self._to_frame = self.X_JC.toActionMatrixInverse()

    def pose(self, data: pin.Data) -> pin.SE3:
        """Return X_WC."""
        return data.oMi[self.joint] * self.X_JC

    def twist(self, data: pin.Data) -> pin.Motion:
        """Return the twist of C in the world, in axes of C."""
        return self.X_JC.actInv(data.v[self.joint])

    def add_jacobian(self, A: Array, model: pin.Model, data: pin.Data, jacobian: Array, drift: Array) -> None:
        """Add A J_C to a Jacobian, shape (k, nv), and A a_C to a drift, shape (k,); zero for the world.

        J_C is the Jacobian of C and a_C its spatial acceleration, both in axes of C.
        """
        if self.joint == _UNIVERSE:
            return
        A = A.dot(self._to_frame)
        jacobian += A.dot(jacobian_matrix(pin.getJointJacobian(model, data, self.joint, pin.LOCAL)))
        drift += A.dot(data.a[self.joint].vector)


def _frame_id(model: pin.Model, name: str) -> int:
    """Return the index of a frame; "world" is the universe if no link has that name.

    Raises:
        NameNotFoundError: no frame has that name.
    """
    try:
        return frame_id(model, name)
    except NameNotFoundError:
        if name == "world":
            return _UNIVERSE
        raise


class ClosureState(NamedTuple):
    """Stacked closure errors of a state, with r rows, and their derivatives.

    Attributes:
        position: e, m and rad, shape (r,).
        velocity: e' = J v, m/s and rad/s, shape (r,).
        jacobian: J, shape (r, nv).
        drift: gamma with e'' = J a + gamma, shape (r,).
        wrench_map: maps multipliers lambda to the wrench on body a of each closure at a, in axes a, shape
            (closures, 6, r).
    """

    position: Array
    velocity: Array
    jacobian: Array
    drift: Array
    wrench_map: Array

    def stabilised(self, a: Array, gains: Stabilisation) -> Array:
        """Return J a + gamma + 2 zeta omega e' + omega^2 e, shape (r,): zero for a solution."""
        return gains.stabilised(self.jacobian @ a + self.drift, self.velocity, self.position)


class ClosureError(NamedTuple):
    """Closure error: distance and angle between the two frames of a closure in its held rows.

    Attributes:
        distance: m.
        angle: rad.
    """

    distance: float
    angle: float

    @classmethod
    def of(cls, X: pin.SE3) -> Self:
        """Return the error of all rows, of the pose of one frame in the other."""
        return cls(float(np.linalg.norm(X.translation)), float(np.linalg.norm(pin.log3(X.rotation))))


class ClosureSet:
    """Closures of a tree, stacked.

    Attributes:
        closures: closures in the order of the constructor.
        sides: frames a and b of each closure.
        rows: total number of rows r.
    """

    def __init__(self, model: pin.Model, closures: Sequence[Closure]) -> None:
        """Find the frames of all closures.

        Raises:
            NameNotFoundError: a frame does not exist.
        """
        require_type("model", model, pin.Model)
        require_type("closures", closures, Sequence)
        self.closures = tuple(closures)
        for index, closure in enumerate(self.closures):
            require_type(f"closures[{index}]", closure, Closure)
        self.sides = [
            (ClosureFrame(model, c.frame_a, c.X_AC), ClosureFrame(model, c.frame_b, c.X_BC))
            for c in self.closures
        ]
        self._errors = [error_function(c) for c in self.closures]
        self._sizes = [sum(c.mask) for c in self.closures]
        self.rows = sum(self._sizes)
        self._model, self._data = model, model.createData()
        self._still = np.zeros(model.nv)

    def state(self, q: Array, v: Array) -> ClosureState:
        """Return errors, Jacobian and drift of all closures."""
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q, v, self._still)
        pin.computeJointJacobians(model, data)
        position, drift = np.zeros(self.rows), np.zeros(self.rows)
        jacobian, wrench_map = np.zeros((self.rows, model.nv)), np.zeros((len(self.closures), 6, self.rows))
        first = 0
        for index, (a, b) in enumerate(self.sides):
            rows = slice(first, first := first + self._sizes[index])
            error = self._errors[index](a.pose(data).actInv(b.pose(data)), a.twist(data), b.twist(data))
            position[rows], drift[rows] = error.position, error.drift
            wrench_map[index, :, rows] = error.A_a.T
            a.add_jacobian(error.A_a, model, data, jacobian[rows], drift[rows])
            b.add_jacobian(error.A_b, model, data, jacobian[rows], drift[rows])
        return ClosureState(position, jacobian.dot(v), jacobian, drift, wrench_map)

    def closure_errors(self, q: Array) -> list[ClosureError]:
        """Return the closure error of each closure at q."""
        pin.forwardKinematics(self._model, self._data, q)
        still, closure_errors = pin.Motion.Zero(), []
        for index, (a, b) in enumerate(self.sides):
            X_ab = a.pose(self._data).actInv(b.pose(self._data))
            error = np.zeros(6)
            error[list(self.closures[index].mask)] = self._errors[index](X_ab, still, still).position
            closure_errors.append(
                ClosureError(float(np.sqrt(error[:3] @ error[:3])), float(np.sqrt(error[3:] @ error[3:])))
            )
        return closure_errors
