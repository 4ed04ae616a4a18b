"""The choice of a controller: its name, gains, switching function and force path."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from coop_pin.arrays import Array
from coop_pin.control.bounds import force_gain_bound
from coop_pin.description.base import Description, Matrix, NotNegative, Positive, Vector
from coop_pin.errors import FieldError, FieldShapeError, SignGainError

Gain = float | Vector | Matrix
"""A gain matrix: a number times the identity, a diagonal, or rows."""


class Sign(Description):
    """sgn(s), as printed; sgn(0) = 0."""

    kind: Literal["sign"] = "sign"


class Saturation(Description):
    """s / width, cut at -1 and 1: a boundary layer.

    Attributes:
        width: half width of the layer, in the unit of the surface (rad/s).
    """

    kind: Literal["saturation"] = "saturation"
    width: Positive = 0.01


class Tanh(Description):
    """tanh(s / width).

    Attributes:
        width: in the unit of the surface (rad/s).
    """

    kind: Literal["tanh"] = "tanh"
    width: Positive = 0.01


Switching = Annotated[Sign | Saturation | Tanh, Field(discriminator="kind")]


class NoForcePath(Description):
    """No internal wrench is measured: K_f must be zero, and the law is truly decentralised."""

    kind: Literal["none"] = "none"

    @property
    def force_gain_bound(self) -> float:
        """The force gain must stay below this: there is nothing to feed back."""
        return 0.0


class LateForcePath(Description):
    """The internal wrench of one tick before: f_m[k] = f(t_k^-), f_m[0] = f_d."""

    kind: Literal["late"] = "late"

    @property
    def pole(self) -> float:
        """The filter's p: 0."""
        return 0.0

    @property
    def force_gain_bound(self) -> float:
        """The force gain must stay below (1 + p) / (1 - p) = 1."""
        return force_gain_bound(self.pole)


class LowPassForcePath(Description):
    """A discrete low-pass: f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d.

    Attributes:
        pole: p, in [0, 1).
    """

    kind: Literal["low-pass"] = "low-pass"
    pole: float = Field(default=0.9, ge=0.0, lt=1.0)

    @property
    def force_gain_bound(self) -> float:
        """The force gain must stay below (1 + p) / (1 - p)."""
        return force_gain_bound(self.pole)


ForcePath = Annotated[NoForcePath | LateForcePath | LowPassForcePath, Field(discriminator="kind")]


class SlidingModeGains(Description):
    """Gains of law (23) for one arm.

    Attributes:
        pose_gain: gamma, on the k_0 task rows, 1/s.
        sign_gain: alpha, on the joints, rad/s^2; diagonal.
        damping_gain: K_d, on the joints, N m s/rad.
        force_gain: K_f, no unit.
        transient_rate: kappa of eq. (20), 1/s.
    """

    pose_gain: Gain
    sign_gain: Gain
    damping_gain: Gain
    force_gain: NotNegative = 0.0
    transient_rate: Positive

    @field_validator("sign_gain")
    @classmethod
    def _diagonal(cls, alpha: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
        rows = np.array(alpha)
        if rows.ndim == 2 and (rows.shape[0] != rows.shape[1] or np.any(rows != np.diag(np.diag(rows)))):
            raise SignGainError(f"is {rows.tolist()}; alpha must be diagonal, otherwise s^T alpha sgn(s) has no sign")
        if np.min(rows) < 0.0:
            raise SignGainError(f"is {rows.tolist()}; alpha must not be negative")
        return alpha

    @field_validator("pose_gain", "damping_gain")
    @classmethod
    def _positive_definite(cls, gain: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
        rows = np.array(gain, dtype=float)
        if rows.ndim == 2 and rows.shape[0] != rows.shape[1]:
            raise FieldShapeError(f"has shape {rows.shape}; a gain matrix is square")
        smallest = float(np.linalg.eigvalsh((rows + rows.T) / 2)[0]) if rows.ndim == 2 else float(np.min(rows))
        if smallest <= 0.0:
            raise FieldError(f"is {rows.tolist()}; it must be positive definite (smallest eigenvalue {smallest:g})")
        return gain


class SlidingMode(Description):
    """The decentralised sliding-mode law, Gueaieb et al. (2007), eq. (23).

    Attributes:
        gains: for every arm.
        arm_gains: gains of single arms, in place of ``gains``.
        switching: the switching function in eq. (18).
        force_path: how the internal wrench reaches the law.
    """

    kind: Literal["sliding-mode"] = "sliding-mode"
    gains: SlidingModeGains
    arm_gains: dict[str, SlidingModeGains] = Field(default_factory=dict)
    switching: Switching = Sign()
    force_path: ForcePath = NoForcePath()

    def gains_of(self, arm: str) -> SlidingModeGains:
        """Return the gains of one arm."""
        return self.arm_gains.get(arm, self.gains)


class UserController(Description):
    """A controller of the user's own.

    Attributes:
        target: "module:Class"; it is called with the scenario, the arm's name and the options.
        options: handed to it.
        force_path: how the internal wrench reaches it.
    """

    kind: Literal["user"] = "user"
    target: str
    options: dict[str, Any] = Field(default_factory=dict)
    force_path: ForcePath = NoForcePath()

    @model_validator(mode="after")
    def _has_colon(self) -> Self:
        module, colon, name = self.target.partition(":")
        if not (module and colon and name):
            raise FieldError(f"is {self.target!r}; it must read 'module:Class'", "target")
        return self


Controller = Annotated[SlidingMode | UserController, Field(discriminator="kind")]


def gain_matrix(gain: float | tuple[Any, ...], size: int, name: str) -> Array:
    """Return a gain as a (size, size) matrix.

    Raises:
        FieldShapeError: its number of entries does not fit.
    """
    rows = np.array(gain, dtype=float)
    if rows.ndim and len(rows) != size:
        raise FieldShapeError(f"has {len(rows)} entries; it must be a number or have {size}", name)
    return rows * np.eye(size) if rows.ndim < 2 else rows
