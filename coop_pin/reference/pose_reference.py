"""Desired payload motion: target, base class, functions of time, their differences, consistency check."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from coop_pin.base.arrays import Array, as_array, as_pose, frozen, typed
from coop_pin.base.errors import OutOfRangeError
from coop_pin.base.schema.base import Description
from coop_pin.base.schema.user_code import FunctionName, load_function
from coop_pin.base.spatial import inverse_pose


class PoseTarget(NamedTuple):
    """Desired pose, twist and acceleration of the payload at one time; read-only arrays."""

    X_WP_d: Array
    """Desired pose of the payload frame P in the world W, m, shape (4, 4)."""

    V_WP_d: Array
    """Desired twist of P in world axes at the origin of P, linear first, m/s and rad/s, shape (6,)."""

    A_WP_d: Array
    """Time derivative of V_WP_d: acceleration of the origin of P and angular acceleration, m/s^2 and rad/s^2,
    shape (6,)."""


def retreated(target: PoseTarget, axis: Array, distance: Array) -> PoseTarget:
    """Return the target of a payload frame that is moved along an axis of the payload.

    With d = R axis: p + s d,  v + s' d + w x s d,  and the derivative of that.

    Args:
        target: Target of the payload.
        axis: Unit vector in payload axes, shape (3,).
        distance: s, m, and its two time derivatives, shape (3,).
    """
    (X, V, A), (s, s1, s2) = target, distance
    d, w = X[:3, :3] @ axis, V[3:]
    X, V, A = X.copy(), V.copy(), A.copy()
    turning = np.cross(w, d)
    X[:3, 3] += s * d
    V[:3] += s1 * d + s * turning
    A[:3] += s2 * d + 2.0 * s1 * turning + s * (np.cross(A[3:], d) + np.cross(w, turning))
    return PoseTarget(X, V, A)


def carried(target: PoseTarget, relative: PoseTarget, X_PE: Array) -> PoseTarget:
    """Return the target of a payload frame that a tip E carries, which is to move relative to the payload.

    With E at r of the payload, and its twist (u, o) and acceleration (b, c) there, all in payload axes::

        p + R r,   v + w x R r + R u,   w + R o,
        a + A x R r + w x (w x R r) + 2 w x R u + R b,   A + R c + w x R o

    and the frame X_PE^-1 in E moves with E.

    Args:
        target: Target of the payload.
        relative: Target of E in the payload frame.
        X_PE: Pose of E in the frame that it carries, shape (4, 4).
    """
    (X, V, A), (X_r, V_r, A_r) = target, relative
    R, w = X[:3, :3], V[3:]
    u, o, r = R @ V_r[:3], R @ V_r[3:], R @ X_r[:3, 3]
    omega, alpha = w + o, A[3:] + R @ A_r[3:] + np.cross(w, o)
    X_new = X @ X_r @ inverse_pose(X_PE)
    d = X_new[:3, 3] - X[:3, 3] - r
    v = V[:3] + np.cross(w, r) + u + np.cross(omega, d)
    a = A[:3] + np.cross(A[3:], r) + np.cross(w, np.cross(w, r)) + 2.0 * np.cross(w, u) + R @ A_r[:3]
    a = a + np.cross(alpha, d) + np.cross(omega, np.cross(omega, d))
    return make_target(X_new[:3, :3], X_new[:3, 3], v, omega, a, alpha)


class ForwardKinematics(Protocol):
    """Arms that hold a payload, as a cell has them."""

    def arm_joints(self) -> Mapping[str, Sequence[str]]:
        """Return the names of the moving joints of each arm."""
        ...

    def payload_poses(self, arm: str, angles: Array) -> Array:
        """Return X_WP by the kinematics of an arm, shape (n, 4, 4), at joint angles of shape (n, k)."""
        ...


class PoseReference(Description):
    """Desired payload motion, defined at every time; the pose is continuous and V_WP_d is its rate."""

    def on(self, cell: ForwardKinematics) -> Self:
        """Return the motion of the payload of a cell; tables are read again."""
        return self.replace()

    @abstractmethod
    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""

    @property
    def span(self) -> tuple[float, float]:
        """Times between which it may move, s; a motion that never ends has inf."""
        return 0.0, math.inf

    def slowed(self, factor: float) -> dict[str, Any]:
        """Return the fields of the same path in a multiple of the time; none of a table or a function.

        Args:
            factor: time from its start, over that of the motion.
        """
        return {}


_NO_VECTOR: Array = frozen(np.zeros(3))


def make_target(
    R: Array,
    p: Array,
    v: Array = _NO_VECTOR,
    omega: Array = _NO_VECTOR,
    a: Array = _NO_VECTOR,
    alpha: Array = _NO_VECTOR,
) -> PoseTarget:
    """Return the target of a motion given in parts, all in world axes.

    Args:
        R: rotation matrix of P in W, shape (3, 3).
        p: position of P, m, shape (3,).
        v: rate of p, m/s, shape (3,).
        omega: angular velocity, rad/s, shape (3,).
        a: rate of v, m/s^2, shape (3,).
        alpha: rate of omega, rad/s^2, shape (3,).
    """
    return target_of(R, p, np.concatenate((v, omega)), np.concatenate((a, alpha)))


def target_of(R: Array, p: Array, V_WP_d: Array, A_WP_d: Array) -> PoseTarget:
    """Return the target with a rotation matrix and a position of P in W; the rates become read-only."""
    X_WP_d = np.zeros((4, 4))
    X_WP_d[:3, :3] = R
    X_WP_d[:3, 3] = p
    X_WP_d[3, 3] = 1.0
    return PoseTarget(frozen(X_WP_d), frozen(V_WP_d), frozen(A_WP_d))


_OFFSETS = (-2.0, -1.0, 1.0, 2.0)
_FIRST: Array = np.array((1.0, -8.0, 8.0, -1.0)) / 12.0
_SECOND: Array = np.array((-1.0, 16.0, 16.0, -1.0)) / 12.0


def pose_rates(pose: Callable[[float], Array], time: float, step: float) -> tuple[Array, Array]:
    """Return twist and acceleration of a pose by central differences of fourth order, shapes (6,) and (6,).

    They are the first and second differences of ``d(t) = [p(t) - p(t_0), r(t)]``, ``r = log(R(t) R(t_0)^T)``.
    With the left Jacobian J, omega = J(r) rdot. At t_0, r = 0 and J = 1, and the derivative of J there adds
    rdot x rdot / 2 = 0: so omega = rdot and alpha = rddot.

    Args:
        pose: time in s -> pose, shape (4, 4).
        time: t_0, s.
        step: s.
    """
    from scipy.spatial.transform import Rotation  # slow to load

    X = pose(time)
    around = np.stack([pose(time + offset * step) for offset in _OFFSETS])
    turns = Rotation.from_matrix(around[:, :3, :3] @ X[:3, :3].T).as_rotvec()
    d = np.hstack((around[:, :3, 3] - X[:3, 3], np.reshape(turns, (-1, 3))))
    return _FIRST @ d / step, _SECOND @ d / step**2


def rate_of(function: Callable[[float], Array], time: float, step: float) -> Array:
    """Return the time derivative of a function by central differences of fourth order, of its own shape."""
    around = np.stack([function(time + offset * step) for offset in _OFFSETS])
    return np.tensordot(_FIRST, around, axes=1) / step


_FUNCTION_STEP = 1e-3
"""Step of the differences of a user-written function, s."""


class FunctionMotion(PoseReference):
    """X_WP_d(t) from a user-written function; twist and acceleration by central differences if not given.

    The differences take the functions at up to 2 ms before and after t, so the functions must be smooth and
    defined shortly before the start of the run. For time constants of about a second they are exact to 1e-11
    in the twist and 1e-9 in the acceleration. A given twist or acceleration is not compared with the pose
    during a run; ``check_consistency`` does that.

    Attributes:
        target: "module:function", called as ``function(time, **options)`` -> X_WP_d, shape (4, 4). In Python
            it may be given as the function itself.
        twist: function likewise -> V_WP_d, world axes, linear first, shape (6,).
        acceleration: function likewise -> A_WP_d, the derivative of V_WP_d, shape (6,).
        options: keyword arguments of all three.
    """

    kind: Literal["function"] = "function"
    target: FunctionName
    twist: FunctionName | None = None
    acceleration: FunctionName | None = None
    options: dict[str, Any] = Field(default_factory=dict)

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s.

        Raises:
            NameNotFoundError: a module or function does not exist.
            ShapeError, OutOfRangeError: a function returned something else; it is named.
        """
        pose = self._function(self.target, lambda name, value: as_pose(name, value))
        if self.twist is None:
            V_WP_d, A_WP_d = pose_rates(pose, time, _FUNCTION_STEP)
        else:
            twist = self._function(self.twist, _as_vector6)
            V_WP_d, A_WP_d = twist(time), rate_of(twist, time, _FUNCTION_STEP)
        if self.acceleration is not None:
            A_WP_d = self._function(self.acceleration, _as_vector6)(time)
        return PoseTarget(frozen(pose(time)), frozen(V_WP_d), frozen(A_WP_d))

    def _function(self, name: str, check: Callable[[str, Any], Array]) -> Callable[[float], Array]:
        """Return a user-written function whose values are checked."""
        function = load_function(name, self.options)
        return lambda time: check(f"{name} at t = {time:g} s", function(time))


def _as_vector6(name: str, value: Any) -> Array:
    return as_array(name, value, 6)


_STEP = 1e-6
"""Step of the differences, s: short, because the jerk may jump between segments."""
_SMALLEST_SCALE = 0.1
"""Scale of slower motions, SI: below it the round-off of the differences would exceed what is allowed."""


class ConsistencyGaps(NamedTuple):
    """Largest differences between a reference and the central differences of it."""

    twist: float
    """Between V_WP_d and the differences of X_WP_d, largest entry, m/s or rad/s."""

    acceleration: float
    """Between A_WP_d and the differences of V_WP_d, largest entry, m/s^2 or rad/s^2."""


@typed
def check_consistency(
    reference: PoseReference, times: ArrayLike, *, allowed: float = 1e-3
) -> ConsistencyGaps:
    """Compare a reference's twist and acceleration with central differences at given times.

    Linear and angular parts are compared apart; each may be off by a fraction of its largest norm.

    Args:
        reference: motion, also a user-written one.
        times: s, shape (n,).
        allowed: largest accepted gap as a fraction of the largest norm over the times.

    Returns:
        The largest gaps, if all are accepted.

    Raises:
        ShapeError, OutOfRangeError: a target is not what PoseTarget says.
        OutOfRangeError: a gap is too large; it names the part and the time.
    """
    instants = as_array("times", times, "n").tolist()
    targets = [reference.at(time) for time in instants]
    for time, target in zip(instants, targets, strict=True):
        as_pose(f"X_WP_d({time})", target.X_WP_d)
        as_array(f"V_WP_d({time})", target.V_WP_d, 6)
        as_array(f"A_WP_d({time})", target.A_WP_d, 6)
    pose_rate = [pose_rates(lambda t: reference.at(t).X_WP_d, time, _STEP)[0] for time in instants]
    twist_rate = [rate_of(lambda t: reference.at(t).V_WP_d, time, _STEP) for time in instants]
    twists, accelerations = [target.V_WP_d for target in targets], [target.A_WP_d for target in targets]
    return ConsistencyGaps(
        _largest_gap("V_WP_d", instants, twists, pose_rate, allowed),
        _largest_gap("A_WP_d", instants, accelerations, twist_rate, allowed),
    )


def _largest_gap(
    name: str, times: Sequence[float], values: Sequence[Array], differences: Sequence[Array], allowed: float
) -> float:
    """Return the largest entry of values - differences, n arrays of shape (6,) each, if both halves pass."""
    expected = np.reshape(differences, (-1, 6))
    gaps = np.reshape(values, (-1, 6)) - expected
    for part, half in (("linear", slice(0, 3)), ("angular", slice(3, 6))):
        norms = np.linalg.norm(gaps[:, half], axis=1)
        limit = allowed * max(
            _SMALLEST_SCALE, float(np.linalg.norm(expected[:, half], axis=1).max(initial=0.0))
        )
        if norms.max(initial=0.0) > limit:
            worst = int(norms.argmax())
            gap = f"difference of the {part} part of {name} from central differences at {times[worst]:.6g} s"
            advice = "check its axes (world), order (linear first) and signs, or leave it out"
            raise OutOfRangeError(f"the {gap}", float(norms[worst]), f"at most {limit:.3g}: {advice}")
    return float(np.abs(gaps).max(initial=0.0))
