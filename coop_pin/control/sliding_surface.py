"""Laws with a sliding surface: their common gains, and the switching function of their integral."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Generic, TypeVar

from coop_pin.control.gains import Gains, PositiveGain, SignGain
from coop_pin.control.law import DecentralisedLaw
from coop_pin.control.switching import Sign, Switching
from coop_pin.schema.base import NotNegative, Positive


class SurfaceGains(Gains):
    """Gains common to the laws with a sliding surface.

    Attributes:
        pose_gain: gamma, how fast pose errors decay, 1/s; one for all task rows (6, or 3 for a planar cell)
            or one for each.
        sign_gain: alpha, on the integral of the error's sign; diagonal. On the joints, rad/s^2, or on the
            task rows, m/s^2 and rad/s^2: see the law.
        force_gain: K_f, how strongly the measured internal wrench is fed back; no unit.
        transient_rate: kappa of eq. (20), how fast the sliding surface that starts at the first error decays,
            1/s.
    """

    are_matrices: ClassVar[bool] = True

    pose_gain: PositiveGain
    sign_gain: SignGain
    force_gain: NotNegative = 0.0
    transient_rate: Positive


G = TypeVar("G", bound=SurfaceGains)


class SurfaceLaw(DecentralisedLaw[G], Generic[G]):
    """Fields common to the laws with a sliding surface.

    Attributes:
        switching: Switching function of the integral, eq. (18).
    """

    equal_gains: ClassVar[Mapping[str, str]] = {
        "pose_gain": "Theorem 2 needs one gamma",
        "force_gain": "Theorem 2 needs one K_f",
    }

    switching: Switching = Sign()

    @property
    def needs(self) -> tuple[str, ...]:
        """What the law uses besides kinematics: the internal wrench if K_f is not zero."""
        return self.measured(["internal wrench"] if self.gains.force_gain > 0.0 else [])

    @property
    def has_linear_integral(self) -> bool:
        """Whether the switching function is smooth at 0."""
        return self.switching.is_smooth
