"""A motion written by the user as a function of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array, frozen
from coop_pin.reference.checks import as_pose, as_positive, keep
from coop_pin.reference.differences import acceleration_from, displacements, rate_of, twist_from
from coop_pin.reference.target import PoseReference, PoseTarget


@dataclass(frozen=True, eq=False)
class FromFunction(PoseReference):
    """X_WP_d(t) = pose_function(t); what is not given of twist and acceleration comes from central differences.

    The differences look ahead and back by 2 step, so the functions must be smooth and defined a little before the start of
    the run. Fourth order in step: at the default, motions with time constants about a second come out to 1e-11 in the twist
    and 1e-9 in the acceleration. A given twist or acceleration is taken on trust here; ``check_consistency`` tests it.

    Attributes:
        pose_function: time in s -> X_WP_d, shape (4, 4).
        twist_function: time in s -> V_WP_d, world axes, linear first, shape (6,).
        acceleration_function: time in s -> A_WP_d, the derivative of V_WP_d, shape (6,).
        step: of the differences, s, positive.

    Raises:
        NotPositiveError: step is zero or less. ``at`` raises ShapeError, NotFiniteError or NotAPoseError, naming the function.
    """

    pose_function: Callable[[float], ArrayLike]
    twist_function: Callable[[float], ArrayLike] | None = None
    acceleration_function: Callable[[float], ArrayLike] | None = None
    step: float = 1e-3

    def __post_init__(self) -> None:
        """Check the step."""
        keep(self, step=as_positive("step", self.step))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        X_WP_d = self._pose(time)
        if self.twist_function is None:
            displaced = displacements(self._pose, time, self.step)
            V_WP_d, A_WP_d = twist_from(displaced, self.step), acceleration_from(displaced, self.step)
        else:
            V_WP_d, A_WP_d = self._twist(time), rate_of(self._twist, time, self.step)
        if self.acceleration_function is not None:
            A_WP_d = as_array(f"acceleration_function({time})", self.acceleration_function(time), 6)
        return PoseTarget(frozen(X_WP_d), frozen(V_WP_d), frozen(A_WP_d))

    def _pose(self, time: float) -> Array:
        """Return the user's pose, checked."""
        return as_pose(f"pose_function({time})", self.pose_function(time))

    def _twist(self, time: float) -> Array:
        """Return the user's twist, checked."""
        assert self.twist_function is not None
        return as_array(f"twist_function({time})", self.twist_function(time), 6)
