"""The payload as a user says it: mass, inertia about its centre of mass, and a box to draw."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import field_validator

from coop_pin.arrays import Array
from coop_pin.description.base import Description, Positive, Vector3, Vector6
from coop_pin.errors import FieldError


class Payload(Description):
    """The held object; its frame P has its origin at the centre of mass.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about P, kg m^2.
        size: edges of the box that stands for it in pictures, m.
    """

    mass: Positive
    inertia: Vector6
    size: Vector3 = (0.1, 0.1, 0.1)

    @field_validator("inertia")
    @classmethod
    def _physical(cls, inertia: tuple[float, ...]) -> tuple[float, ...]:
        moments = np.linalg.eigvalsh(_matrix(inertia))
        if moments[0] <= 0.0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise FieldError(
                f"has principal moments {np.round(moments, 12).tolist()}; they must be positive and none may exceed the sum of the others"
            )
        return inertia

    @property
    def inertia_matrix(self) -> Array:
        """Inertia about P in the axes of P, kg m^2, shape (3, 3)."""
        return _matrix(self.inertia)

    @classmethod
    def box(cls, mass: float, size: tuple[float, float, float]) -> Self:
        """Return a homogeneous box with edges along the axes of P."""
        x, y, z = (edge * edge * mass / 12.0 for edge in size)
        return cls(mass=mass, inertia=(y + z, x + z, x + y, 0.0, 0.0, 0.0), size=size)

    @classmethod
    def bar(cls, mass: float, length: float, thickness: float = 0.03) -> Self:
        """Return a bar along x that turns about z like a thin rod: I_z = m d^2 / 12 (section 4.1 of the paper).

        Args:
            mass: m, kg.
            length: d, m.
            thickness: edge of its square section, m; counts in I_x only.
        """
        rod = mass * length**2 / 12.0
        return cls(mass=mass, inertia=(mass * thickness**2 / 6.0, rod, rod, 0.0, 0.0, 0.0), size=(length, thickness, thickness))

    def with_mass(self, mass: float) -> Self:
        """Return the same shape with another mass: the inertia scales along."""
        scale = mass / self.mass
        return self.replace(mass=mass, inertia=tuple(scale * entry for entry in self.inertia))


def _matrix(inertia: tuple[float, ...]) -> Array:
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
