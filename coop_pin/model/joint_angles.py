"""Joint angles of an arm and their entries in q: Pinocchio stores cosine and sine of a continuous joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array

_TURN = 2.0 * np.pi


class JointAngles:
    """Conversion between the joint angles of an arm, rad (m for a prismatic joint), and its entries of q.

    Attributes:
        names: joint names.
        units: "rad" or "m" for each joint.
        entry: index of each joint's first entry in the arm's part of q, shape (k,).
        is_vector: whether q consists of the angles themselves.
        continuous: mask of the continuous joints, shape (k,).
        revolute: mask of the revolute joints, shape (k,).
    """

    def __init__(self, model: pin.Model, joints: Sequence[int] = ()) -> None:
        """Read the joints of an arm.

        Args:
            model: model of the arm, or of a tree that contains it.
            joints: indices of its joints; all of the model when omitted.
        """
        joints = joints or range(1, model.njoints)
        self.names = tuple(str(model.names[joint]) for joint in joints)
        self.continuous = np.array([model.nqs[joint] == 2 for joint in joints])
        self.entry = np.cumsum(1 + self.continuous) - 1 - self.continuous
        kinds = [str(model.joints[joint].shortname()) for joint in joints]
        self.revolute = np.array([kind.startswith("JointModelR") for kind in kinds]) & ~self.continuous
        self.units = tuple(np.where(self.revolute | self.continuous, "rad", "m").tolist())
        self.is_vector = not self.continuous.any()
        self._nq = len(joints) + int(self.continuous.sum())

    def of(self, q: Array) -> Array:
        """Return the angles of configurations, those of continuous joints between -pi and pi.

        Args:
            q: the arm's entries, shape (..., nq).

        Returns:
            Shape (..., k).
        """
        angles: Array = q[..., self.entry]
        if not self.is_vector:
            cosines = self.entry[self.continuous]
            angles[..., self.continuous] = np.arctan2(q[..., cosines + 1], q[..., cosines])
        return angles

    def near(self, q: Array, reference: Array) -> Array:
        """Return the angles of q, of continuous joints within half a turn of a reference, shape (k,)."""
        angles = self.of(q)
        return np.where(self.continuous, reference + (angles - reference + np.pi) % _TURN - np.pi, angles)

    def along(self, q: Array, reference: Array) -> Array:
        """Return the angles of successive configurations with continuous joints unwrapped, shape (n, k).

        Args:
            q: the arm's entries, shape (n, nq).
            reference: the first sample lies within half a turn of it, shape (k,).
        """
        angles = self.of(q)
        if not self.is_vector:
            turning = np.concatenate((reference[None], angles))[:, self.continuous]
            angles[:, self.continuous] = np.unwrap(turning, axis=0)[1:]
        return angles

    def configuration(self, angles: Array) -> Array:
        """Return the arm's entries of q, shape (..., nq), at given angles, shape (..., k)."""
        q = np.zeros((*angles.shape[:-1], self._nq))
        q[..., self.entry] = angles
        cosines, turning = self.entry[self.continuous], angles[..., self.continuous]
        q[..., cosines], q[..., cosines + 1] = np.cos(turning), np.sin(turning)
        return q
