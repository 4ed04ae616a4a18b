"""Load and internal wrenches: the decomposition of interaction wrenches by load shares."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array, as_array
from coop_pin.errors import ShapeError


def load_wrenches(interaction: Array, load_shares: Array) -> Array:
    """Return the load wrench of each arm: delta_i = c_i sum_j F_j.

    Gueaieb et al. (2007), eqs. (10)-(12).

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, k).
        load_shares: c_i, summing to one, shape (m,).
    """
    load_shares = as_array("load_shares", load_shares, "m")
    if not isinstance(interaction, np.ndarray):
        interaction = as_array("interaction", interaction, "m", "k")
    if interaction.shape[-2:-1] != load_shares.shape:
        raise ShapeError("interaction", interaction.shape, ("...", load_shares.size, "k"))
    return load_shares[:, None] * interaction.sum(axis=-2, keepdims=True)


def internal_wrenches(interaction: Array, load_shares: Array) -> Array:
    """Return the internal wrench of each arm: f_i = F_i - c_i sum_j F_j, so that sum_i f_i = 0.

    Gueaieb et al. (2007), eqs. (7), (8), (12).

    Args:
        interaction: wrench on each arm by the payload, about P, in common axes, shape (..., m, k).
        load_shares: c_i, summing to one, shape (m,).
    """
    return interaction - load_wrenches(interaction, load_shares)
