"""The desired internal wrenches: how the arms shall squeeze the payload."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array, frozen
from coop_pin.reference.motions import rest_to_rest
from coop_pin.reference.pose_reference import as_number, as_positive, keep


class SqueezeReference(ABC):
    """The desired internal wrench f_d_i of each arm, Gueaieb et al. (2007), eq. (23).

    Rows in the order of the cell's arms; on the arm by the payload, about P, in PAYLOAD axes, linear first.
    They must sum to zero over the arms: the scenario checks that, not the reference.
    """

    @abstractmethod
    def at(self, time: float) -> Array:
        """Return f_d at a time in s, N and N m, read-only, shape (m, 6)."""


@dataclass(frozen=True, eq=False)
class ConstantSqueeze(SqueezeReference):
    """f_d = wrenches at all times.

    Attributes:
        wrenches: N and N m, shape (m, 6).

    Raises:
        ShapeError, OutOfRangeError: wrenches has another shape or holds a NaN.
    """

    wrenches: Array

    def __post_init__(self) -> None:
        """Check the wrenches."""
        keep(self, wrenches=as_array("wrenches", self.wrenches, "m", 6))

    def at(self, time: float) -> Array:
        """Return the wrenches, the same array at every time."""
        return self.wrenches


@dataclass(frozen=True, eq=False)
class RampedSqueeze(SqueezeReference):
    """f_d = start + s (goal - start), s(t) the quintic from rest to rest.

    Attributes:
        start: before start_time, N and N m, shape (m, 6).
        goal: afterwards, shape (m, 6).
        duration: of the ramp, s, positive.
        start_time: s.

    Raises:
        ShapeError, OutOfRangeError: a field has another shape or holds a NaN.
        OutOfRangeError: duration is zero or less.
    """

    start: Array
    goal: Array
    duration: float
    start_time: float = 0.0

    def __post_init__(self) -> None:
        """Check the fields."""
        start = as_array("start", self.start, "m", 6)
        keep(self, start=start, goal=as_array("goal", self.goal, len(start), 6))
        keep(
            self,
            duration=as_positive("duration", self.duration),
            start_time=as_number("start_time", self.start_time),
        )

    def at(self, time: float) -> Array:
        """Return f_d at a time in s, shape (m, 6)."""
        s = rest_to_rest(time, self.start_time, self.duration).value
        return frozen((1.0 - s) * self.start + s * self.goal)


@dataclass(frozen=True, eq=False)
class SqueezeFromFunction(SqueezeReference):
    """f_d(t) = function(t), written by the user.

    Attributes:
        function: time in s -> f_d, N and N m, shape (m, 6), the same m at all times.
    """

    function: Callable[[float], ArrayLike]

    def at(self, time: float) -> Array:
        """Return f_d at a time in s, shape (m, 6).

        Raises:
            ShapeError, OutOfRangeError: the function returns another shape or a NaN.
        """
        return frozen(as_array(f"function({time})", self.function(time), "m", 6))
