"""Kinematics of loop closures, of one and of all of a tree: errors, Jacobian and drift at a state."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import NameNotFoundError
from coop_pin.description.cell.closure import Closure, RowMask
from coop_pin.description.plant import Stabilisation
from coop_pin.model.pinocchio_model import frame_id, jacobian_matrix, joint_id


class ClosureKinematics(NamedTuple):
    """Error of a closure with k rows, and the coefficients of its second derivative.

    With the spatial accelerations a_a and a_b of its frames, e'' = A_a a_a + A_b a_b + drift.

    Attributes:
        position: e, m and rad, shape (k,).
        A_a: map of the acceleration a_a, shape (k, 6).
        A_b: map of the acceleration a_b, shape (k, 6).
        drift: part of e'' by the twists alone, shape (k,).
    """

    position: Array
    A_a: Array
    A_b: Array
    drift: Array


ErrorFunction = Callable[[pin.SE3, pin.Motion, pin.Motion], ClosureKinematics]


def error_function(closure: Closure) -> ErrorFunction:
    """Return the function (X_ab, V_a, V_b) -> ClosureKinematics of a closure."""
    mask = closure.mask
    if all(mask):
        return _weld
    if mask == (True, True, True, False, False, False):
        return _point
    return lambda X_ab, V_a, V_b: _masked(X_ab, V_a, V_b, mask)


def _weld(X_ab: pin.SE3, V_a: pin.Motion, V_b: pin.Motion) -> ClosureKinematics:
    """Return the kinematics of e = -log6(X_ab), e' = V_a - Ad(X_ab) V_b, as pinocchio.constraintDynamics."""
    V_b_in_a = X_ab.act(V_b)
    drift = (V_a - V_b_in_a).cross(V_b_in_a).vector
    return ClosureKinematics(-pin.log6(X_ab).vector, np.eye(6), -X_ab.toActionMatrix(), drift)


def _point(X_ab: pin.SE3, V_a: pin.Motion, V_b: pin.Motion) -> ClosureKinematics:
    """Return the kinematics of e = R_Wa^T (p_a - p_b).

    The derivatives are taken in the world, so that e decays along a straight line.
    """
    R_ab = X_ab.rotation
    A_a, A_b = np.zeros((3, 6)), np.zeros((3, 6))
    A_a[:, :3], A_b[:, :3] = np.eye(3), -R_ab
    drift = _cross(V_a.angular, V_a.linear) - R_ab @ _cross(V_b.angular, V_b.linear)
    return ClosureKinematics(-X_ab.translation, A_a, A_b, drift)


def _masked(X_ab: pin.SE3, V_a: pin.Motion, V_b: pin.Motion, mask: RowMask) -> ClosureKinematics:
    """Return the held rows of [p_a - p_b, rotation error], in the rotating axes of a."""
    R_ab, p_ab = X_ab.rotation, X_ab.translation
    w_a, w_b, v_b = V_a.angular, R_ab @ V_b.angular, R_ab @ V_b.linear
    rotation = _rotation_error(R_ab, w_b - w_a, mask[3:])
    A_a, A_b = np.eye(6), np.zeros((6, 6))
    A_a[:3, 3:], A_a[3:, 3:] = -pin.skew(p_ab), rotation.G
    A_b[:3, :3], A_b[3:, 3:] = -R_ab, -rotation.G @ R_ab
    p_ab_rate = v_b - V_a.linear - _cross(w_a, p_ab)
    linear = _cross(w_a, p_ab_rate) + _cross(w_a, v_b) - R_ab @ _cross(V_b.angular, V_b.linear)
    angular = rotation.G @ _cross(w_a, w_b) - rotation.G_rate @ (w_b - w_a)
    rows = np.array(mask)
    position = np.concatenate((-p_ab, rotation.position))
    return ClosureKinematics(position[rows], A_a[rows], A_b[rows], np.concatenate((linear, angular))[rows])


class _RotationError(NamedTuple):
    """Rotation rows of a closure: e' = -G Omega, with Omega the angular velocity of b in a, in axes of a."""

    position: Array
    G: Array
    G_rate: Array


def _rotation_error(R_ab: Array, Omega: Array, held: tuple[bool, ...]) -> _RotationError:
    """Return the rotation error for the number of held rotations; the log would depend on the free angles.

    With k the only axis that is free or held, u its unit vector, z = R_ab u and c = u . z:

    - two held, a hinge: e = z x u, the misalignment of the axes; G = c I - z u^T.
    - one held, as by a universal joint: e = -(twist of R_ab about u); row k of G is (u + z)^T / (1 + c).
    - three held: e = -log(R_ab) and G = I, its derivative at small errors, as for a weld.
    """
    if sum(held) not in (1, 2):
        return _RotationError(-pin.log3(R_ab), np.eye(3), np.zeros((3, 3)))
    k = held.index(sum(held) == 1)
    u, z, c = np.eye(3)[k], R_ab[:, k], R_ab[k, k]
    z_rate = _cross(Omega, z)
    if sum(held) == 2:
        return _RotationError(
            _cross(z, u), c * np.eye(3) - np.outer(z, u), z_rate[k] * np.eye(3) - np.outer(z_rate, u)
        )
    i, j = (k + 1) % 3, (k + 2) % 3
    twist = math.atan2(R_ab[j, i] - R_ab[i, j], R_ab[i, i] + R_ab[j, j])
    n = (u + z) / (1.0 + c)
    return _RotationError(-twist * u, np.outer(u, n), np.outer(u, (z_rate - n * z_rate[k]) / (1.0 + c)))


def _cross(a: Array, b: Array) -> Array:
    """Return a x b; np.cross takes twenty times as long."""
    return pin.skew(a).dot(b)


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
        try:
            self.named = frame_id(model, name)
        except NameNotFoundError:
            if name != "world":  # the universe, if no link has that name
                raise
            self.named = _UNIVERSE
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


class Rolling(NamedTuple):
    """Wheels on an axle that roll without sliding sideways: -sin(theta) x' + cos(theta) y' = 0.

    The row binds velocities alone: it has no error of position that a stabilisation could reduce.

    Attributes:
        x: name of a prismatic joint of the tree along the x axis of the ground.
        y: name of one along its y axis.
        yaw: name of the revolute joint on them, whose axis is through the middle of the axle.
    """

    x: str
    y: str
    yaw: str

    def indices(self, model: pin.Model) -> tuple[int, int, int, int]:
        """Return the entries of v of the three joints, and the entry of q of yaw.

        Raises:
            NameNotFoundError: a joint does not exist.
        """
        x, y, yaw = (joint_id(model, name) for name in self)
        return int(model.idx_vs[x]), int(model.idx_vs[y]), int(model.idx_vs[yaw]), int(model.idx_qs[yaw])


class ClosureState(NamedTuple):
    """Stacked closure errors of a state, with r rows, and their derivatives.

    Rows of wheels come last: their e is zero, and e' is the speed at which they slide sideways.

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
        rolling: wheels that roll.
        rows: total number of rows r.
    """

    def __init__(
        self, model: pin.Model, closures: Sequence[Closure], rolling: Sequence[Rolling] = ()
    ) -> None:
        """Find the frames of all closures, and the joints of all wheels.

        Raises:
            NameNotFoundError: a frame or a joint does not exist.
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
        self.rolling, self._wheels = tuple(rolling), [each.indices(model) for each in rolling]
        self.rows = sum(self._sizes) + len(self._wheels)
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
        for row, (x, y, yaw, theta) in enumerate(self._wheels, first):
            sine, cosine = math.sin(q[theta]), math.cos(q[theta])
            jacobian[row, x], jacobian[row, y] = -sine, cosine
            drift[row] = -v[yaw] * (cosine * v[x] + sine * v[y])
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
