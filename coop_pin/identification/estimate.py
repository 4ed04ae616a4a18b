"""Estimates from a log: parameters, their priors, and the fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array

_WRITTEN = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "s": (1e3, "ms"), "1": (1e2, "% of its length")}
"""Units in which values are written, by that of the value."""


class Priors(NamedTuple):
    """Standard deviations of what is known before a log is read; they decide where it says nothing.

    Attributes:
        tip: position and rotation of a tip, m and rad.
        base: position and rotation of a base, m and rad.
        joint: offset of a joint, rad or m.
        link: relative error of a link's length. No residual shows 0.02 % of a link.
        clock: offset of a clock against that of the first arm, s.
        wrist: zero of a wrist's force and moment, N and N m.
        hand: mass and centre of a hand whose weight is in the wrench of its wrist, kg and m.
        mass: relative error of the payload's mass.
        centre: error of its centre, m.
        inertia: relative error of its inertia.
        forecast: relative error of a forecast of newtons against a run; of what was seen, 0.1 in 95 %.
    """

    tip: tuple[float, float] = (5e-4, 5e-4)
    base: tuple[float, float] = (1e-3, 1e-3)
    joint: float = 5e-4
    link: float = 2e-4
    clock: float = 1e-2
    wrist: tuple[float, float] = (2.0, 0.2)
    hand: tuple[float, float] = (0.05, 1e-2)
    mass: float = 0.1
    centre: float = 1e-2
    inertia: float = 0.3
    forecast: float = 0.05


class Parameter(NamedTuple):
    """Number that is estimated from a log.

    Attributes:
        arm: name of the arm; empty for the payload.
        part: "tip", "base", "joint", "link", "clock", "wrist", "hand" or a part of the payload.
        axis: axis, or name of the joint.
        unit: unit of its value.
    """

    arm: str
    part: str
    axis: str
    unit: str

    def __str__(self) -> str:
        """Return its name as text."""
        return " ".join(filter(None, self[:3]))

    @property
    def written(self) -> tuple[float, str]:
        """Unit in which its values are written, in units of its own, and the name of that unit."""
        return _WRITTEN.get(self.unit, (1.0, self.unit))

    def valued(self, value: float) -> str:
        """Return a value of it as text: "+1.32 N"."""
        factor, unit = self.written
        return f"{factor * value:+.3g} {unit}" if unit else f"{value:.3g}"


class Fit(NamedTuple):
    """Gaussian estimate of parameters.

    Attributes:
        parameters: names of what was fitted.
        x: estimates, shape (n,).
        covariance: covariance of the estimates, shape (n, n).
        prior: standard deviations before, shape (n,).
        chi: root mean square of the whitened residual; 1 if noise and prior explain it.
    """

    parameters: tuple[Parameter, ...]
    x: Array
    covariance: Array
    prior: Array
    chi: float

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def spread(self) -> Array:
        """Independent errors of unit variance that make the covariance: L with L L^T, shape (n, n)."""
        values, vectors = np.linalg.eigh(self.covariance / np.outer(self.prior, self.prior))
        return np.asarray(self.prior[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))

    @property
    def seen(self) -> Array:
        """1 - posterior / prior variance: 0 where the log says nothing, shape (n,)."""
        return 1.0 - np.diag(self.covariance) / self.prior**2

    @property
    def late(self) -> dict[str, float]:
        """Delays of the clocks of arms, s."""
        values = zip(self.parameters, self.x.tolist(), strict=True)
        return {one.arm: value for one, value in values if one.part == "clock"}

    def of(self, arm: str, part: str) -> list[int]:
        """Return the indices of the parameters of a part of an arm."""
        return [i for i, one in enumerate(self.parameters) if (one.arm, one.part) == (arm, part)]
