"""Rotor inertia of the drives of an arm, as its joints feel it (armature)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Tag

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Magnitude, NumberOrVector


class Rotors(Description):
    """Rotors behind gears. With the ratio N, a rotor turns N times as fast as its joint.

        M_jj = (M of the links)_jj + N_j^2 I_j

    The rotor's own part of gyroscopic and Coriolis torques, which is smaller by N, is left out.

    Attributes:
        inertia: moment of inertia of a rotor about its own axis, kg m^2; one value for the arm's joints, or
            one for each joint.
        gear_ratio: angle of the rotor by that of its joint, or by the travel of a prismatic one, rad/m; one
            value for the arm's joints, or one for each joint.
    """

    inertia: Magnitude
    gear_ratio: NumberOrVector


def _form(value: Any) -> str:
    return "rotors" if isinstance(value, Mapping | Rotors) else "armature"


Armature = Annotated[
    Annotated[Rotors, Tag("rotors")] | Annotated[Magnitude, Tag("armature")], Discriminator(_form)
]
"""Inertia that the joints feel, or rotors behind gears."""


def reflected(armature: Rotors | float | tuple[float, ...], joints: int, base_joints: int) -> Array:
    """Return the inertia that rotors add to the diagonal of the mass matrix, shape (joints,).

    Args:
        armature: Field of an arm.
        joints: Number of the arm's joints.
        base_joints: Number of those of its mobile base, which a single value does not mean.

    Raises:
        FieldError: there are more or fewer values than joints.
    """
    if isinstance(armature, Rotors):
        ratio = _by_joint(armature.gear_ratio, joints, base_joints, "armature.gear_ratio")
        return ratio**2 * _by_joint(armature.inertia, joints, base_joints, "armature.inertia")
    return _by_joint(armature, joints, base_joints, "armature")


def _by_joint(value: float | tuple[float, ...], joints: int, base_joints: int, field: str) -> Array:
    if not isinstance(value, tuple):
        return np.where(np.arange(joints) < base_joints, 0.0, value)
    if len(value) != joints:
        raise FieldError(f"has {len(value)} entries; the arm has {joints} joints", field)
    return np.array(value)
