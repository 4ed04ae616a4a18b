"""Desired payload motion from user-written functions of time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from pydantic import Field

from coop_pin.arrays import Array, as_array, as_pose, frozen
from coop_pin.reference.pose_reference import PoseReference, PoseTarget, pose_rates, rate_of
from coop_pin.schema.user_code import FunctionName, load_function

_STEP = 1e-3
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
            V_WP_d, A_WP_d = pose_rates(pose, time, _STEP)
        else:
            twist = self._function(self.twist, _as_vector6)
            V_WP_d, A_WP_d = twist(time), rate_of(twist, time, _STEP)
        if self.acceleration is not None:
            A_WP_d = self._function(self.acceleration, _as_vector6)(time)
        return PoseTarget(frozen(pose(time)), frozen(V_WP_d), frozen(A_WP_d))

    def _function(self, name: str, check: Callable[[str, Any], Array]) -> Callable[[float], Array]:
        """Return a user-written function whose values are checked."""
        function = load_function(name, self.options)
        return lambda time: check(f"{name} at t = {time:g} s", function(time))


def _as_vector6(name: str, value: Any) -> Array:
    return as_array(name, value, 6)
