"""Gains of the laws as a scenario states them: a number, a diagonal, or rows of a matrix."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator

from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, NotNegative, NumberVectorOrMatrix, Positive, Vector

Gain = NumberVectorOrMatrix
"""A gain matrix: a number times the identity, a diagonal, or rows."""


def _diagonal(alpha: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    """Refuse an alpha that is not diagonal or has a negative entry."""
    rows = np.array(alpha)
    if rows.ndim == 2 and not np.array_equal(rows, np.diag(np.diag(rows))):
        raise FieldError(
            f"is {rows.tolist()}; alpha must be diagonal, otherwise s^T alpha sgn(s) has no sign"
        )
    if np.min(rows) < 0.0:
        raise FieldError(f"is {rows.tolist()}; alpha must not be negative")
    return alpha


def _positive_definite(gain: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    """Refuse a gain that is not positive, or a matrix whose symmetric part is not positive definite."""
    rows = np.array(gain, dtype=float)
    if rows.ndim == 2 and rows.shape[0] != rows.shape[1]:
        raise FieldError(f"has shape {rows.shape}; a gain matrix is square")
    smallest = float(np.linalg.eigvalsh((rows + rows.T) / 2)[0]) if rows.ndim == 2 else float(np.min(rows))
    if smallest <= 0.0:
        wanted = (
            "positive",
            "positive in every entry",
            f"positive definite (smallest eigenvalue {smallest:g})",
        )
        raise FieldError(f"is {rows.tolist()}; it must be {wanted[rows.ndim]}")
    return gain


PositiveGain = Annotated[Gain, AfterValidator(_positive_definite)]
SignGain = Annotated[Gain, AfterValidator(_diagonal)]


class Gains(Description):
    """Gains common to the laws.

    Attributes:
        pose_gain: gamma, how fast pose errors decay, 1/s; one for all task rows (6, or 3 for a planar cell)
            or one for each.
        sign_gain: alpha, on the integral of the error's sign; diagonal. On the joints, rad/s^2, or on the
            task rows, m/s^2 and rad/s^2: see the law.
        force_gain: K_f, how strongly the measured internal wrench is fed back; no unit.
        transient_rate: kappa of eq. (20), how fast the sliding surface that starts at the first error decays,
            1/s.
    """

    pose_gain: PositiveGain
    sign_gain: SignGain
    force_gain: NotNegative = 0.0
    transient_rate: Positive


class SlidingModeGains(Gains):
    """Gains of law (23) for one arm.

    Attributes:
        damping_gain: K_d, on the joints, N m s/rad; one for all or one for each.
    """

    damping_gain: PositiveGain


class PayloadSpaceGains(Gains):
    """Gains of the payload-space law.

    Attributes:
        sliding_gain: K_x, on the task rows: three for the position, N s/m, then three for the orientation,
            N m s/rad.
    """

    sliding_gain: PositiveGain


class PostureGains(Description):
    """Null-space spring towards the arm's posture, and damper, of the spare joints of redundant arms.

    Attributes:
        stiffness: N m/rad, one value for all joints or one for each.
        damping: N m s/rad, likewise.
    """

    stiffness: NotNegative | Vector = 40.0
    damping: NotNegative | Vector = 8.0
