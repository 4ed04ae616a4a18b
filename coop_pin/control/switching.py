"""Switching functions of the sliding surface, eq. (18): the sign as printed, and two smooth ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from coop_pin.arrays import Array


class Switching(ABC):
    """A function of the surface s that is odd and stays within [-1, 1]."""

    @abstractmethod
    def __call__(self, surface: Array) -> Array:
        """Return the switching value of every entry."""


@dataclass(frozen=True)
class Sign(Switching):
    """sgn(s), with sgn(0) = 0."""

    def __call__(self, surface: Array) -> Array:
        """Return -1, 0 or 1."""
        return np.sign(surface)


@dataclass(frozen=True)
class Saturation(Switching):
    """s / width within the boundary layer, sgn(s) outside.

    Attributes:
        width: half width of the layer, in the unit of s.
    """

    width: float

    def __call__(self, surface: Array) -> Array:
        """Return s / width cut at -1 and 1."""
        return np.minimum(np.maximum(surface / self.width, -1.0), 1.0)


@dataclass(frozen=True)
class Tanh(Switching):
    """tanh(s / width).

    Attributes:
        width: in the unit of s.
    """

    width: float

    def __call__(self, surface: Array) -> Array:
        """Return tanh(s / width)."""
        return np.tanh(surface / self.width)
