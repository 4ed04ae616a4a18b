"""A frame of a closure: where it sits on its joint, and how it moves."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array
from coop_pin.errors import FrameNotFoundError
from coop_pin.model.pinocchio_model import frame_id

_UNIVERSE = 0


class ClosureFrame:
    """A frame C on a joint J of a tree.

    Attributes:
        named: index of the frame that it was named by.
        joint: index of the joint; zero is the world.
        X_JC: pose of the frame in the joint.
    """

    def __init__(self, model: pin.Model, name: str, X: ArrayLike | None) -> None:
        """Resolve a frame.

        Args:
            model: the tree.
            name: of a frame, or "world".
            X: pose of C in it, shape (4, 4); the frame itself when None.

        Raises:
            FrameNotFoundError: the frame does not exist.
        """
        self.named = _frame_id(model, name)
        frame = model.frames[self.named]
        self.joint = int(frame.parentJoint)
        self.X_JC = frame.placement if X is None else frame.placement * pin.SE3(np.asarray(X))
        self._to_frame = self.X_JC.toActionMatrixInverse()

    def pose(self, data: pin.Data) -> pin.SE3:
        """Return the pose of C in the world."""
        return data.oMi[self.joint] * self.X_JC

    def twist(self, data: pin.Data) -> pin.Motion:
        """Return the twist of C in its own axes."""
        return self.X_JC.actInv(data.v[self.joint])

    def add_motion(self, A: Array, model: pin.Model, data: pin.Data, jacobian: Array, drift: Array) -> None:
        """Add A J_C to a Jacobian, shape (k, nv), and A a_C to a drift, shape (k,); the world adds nothing.

        J_C is the Jacobian of C and a_C its spatial acceleration, both in its own axes.
        """
        if self.joint == _UNIVERSE:
            return
        A = A.dot(self._to_frame)
        jacobian += A.dot(pin.getJointJacobian(model, data, self.joint, pin.LOCAL))
        drift += A.dot(data.a[self.joint].vector)


def _frame_id(model: pin.Model, name: str) -> int:
    """Return the index of a frame; "world" is the universe where no link has that name.

    Raises:
        FrameNotFoundError: no frame has that name.
    """
    try:
        return frame_id(model, name)
    except FrameNotFoundError:
        if name == "world":
            return _UNIVERSE
        raise
