"""Gains as a user says them: a number, a diagonal, or rows."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator

from coop_pin.arrays import Array
from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, NotNegative, NumberVectorOrMatrix, Positive, Vector

Gain = NumberVectorOrMatrix
"""A gain matrix: a number times the identity, a diagonal, or rows."""


def _diagonal(alpha: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    rows = np.array(alpha)
    if rows.ndim == 2 and (rows.shape[0] != rows.shape[1] or np.any(rows != np.diag(np.diag(rows)))):
        raise FieldError(
            f"is {rows.tolist()}; alpha must be diagonal, otherwise s^T alpha sgn(s) has no sign"
        )
    if np.min(rows) < 0.0:
        raise FieldError(f"is {rows.tolist()}; alpha must not be negative")
    return alpha


def _positive_definite(gain: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    rows = np.array(gain, dtype=float)
    if rows.ndim == 2 and rows.shape[0] != rows.shape[1]:
        raise FieldError(f"has shape {rows.shape}; a gain matrix is square")
    if rows.ndim < 2:
        if np.min(rows) <= 0.0:
            raise FieldError(
                f"is {rows.tolist()}; it must be positive" + (" in every entry" if rows.ndim else "")
            )
        return gain
    smallest = float(np.linalg.eigvalsh((rows + rows.T) / 2)[0])
    if smallest <= 0.0:
        raise FieldError(
            f"is {rows.tolist()}; it must be positive definite (smallest eigenvalue {smallest:g})"
        )
    return gain


PositiveGain = Annotated[Gain, AfterValidator(_positive_definite)]
SignGain = Annotated[Gain, AfterValidator(_diagonal)]


class Gains(Description):
    """Gains that every law here has.

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
        sliding_gain: K_x, on the task rows: three for the position, N s/m, then three for the orientation, N
            m s/rad.
    """

    sliding_gain: PositiveGain


class PostureGains(Description):
    """What the spare joints of redundant arms do: a spring towards the arm's posture, and a damper, in the null space.

    Attributes:
        stiffness: N m/rad, one value for all joints or one for each.
        damping: N m s/rad, likewise.
    """

    stiffness: NotNegative | Vector = 40.0
    damping: NotNegative | Vector = 8.0


def gain_matrix(gain: float | tuple[Any, ...], size: int, name: str) -> Array:
    """Return a gain as a (size, size) matrix.

    Raises:
        FieldError: its number of entries does not fit.
    """
    rows = np.array(gain, dtype=float)
    if rows.ndim and len(rows) != size:
        raise FieldError(f"has {len(rows)} entries; it must be a number or have {size}", name)
    return rows * np.eye(size) if rows.ndim < 2 else rows
