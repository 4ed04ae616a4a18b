"""Joint values by name: Pinocchio orders the entries of q and v its own way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, as_array
from coop_pin.errors import ArgumentError
from coop_pin.model.pinocchio_model import joint_id


def configuration_at(model: pin.Model, angles: Mapping[str, float]) -> Array:
    """Return the configuration with some joints at given angles and the others neutral, shape (nq,).

    Args:
        model: the tree.
        angles: rad, or m for a prismatic joint, by joint name.

    Raises:
        JointNotFoundError: a joint does not exist.
        ArgumentError: a joint has more than one angle.
    """
    u = velocity_at(model, angles)
    configuration: Array = pin.integrate(model, pin.neutral(model), u)
    return configuration


def velocity_at(model: pin.Model, rates: Mapping[str, float]) -> Array:
    """Return the velocity with some joints at given rates and the others at rest, shape (nv,).

    Args:
        model: the tree.
        rates: rad/s, or m/s for a prismatic joint, by joint name.

    Raises:
        JointNotFoundError: a joint does not exist.
        ArgumentError: a joint has more than one rate.
    """
    v = np.zeros(model.nv)
    for name, rate in rates.items():
        joint = model.joints[joint_id(model, name)]
        if joint.nv != 1:
            raise ArgumentError(f"joint {name!r} has {joint.nv} degrees of freedom; set its entries of q and v by hand")
        v[joint.idx_v] = as_array(name, rate)
    return v
