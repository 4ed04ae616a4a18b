"""Colours that warn: a link whose drive is at its torque limit, an arm that comes near a singular pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coop_pin.arrays import Array, Mask
from coop_pin.figures import palette

NEAR_SINGULAR = 100.0
"""From this condition number of its payload Jacobian on an arm counts as near a singular pose; healthy arms have 5 to 20."""

IS_PLAIN, IS_SINGULAR, IS_SATURATED = 0, 1, 2

COLOURS = (None, palette.rgb(palette.SINGULAR), palette.rgb(palette.SATURATED))
"""By code; None is the body's own colour."""

Codes = NDArray[np.int8]


def body_tints(bodies: Sequence[str], joints: Mapping[str, Sequence[str]], saturated: Mask, condition: Array) -> Codes:
    """Return the code of every body's colour: the whole arm for a singular pose, the link that a drive moves for its saturation.

    Args:
        bodies: ``<arm>/<joint>`` or ``<arm>/base``.
        joints: of each arm, in the order of its drives; the arms in the order of the arrays.
        saturated: shape (n, m, k).
        condition: of the payload Jacobians, shape (n, m).

    Returns:
        Codes, shape (n, bodies).
    """
    arms = list(joints)
    codes = np.full((len(condition), len(bodies)), IS_PLAIN, dtype=np.int8)
    for index, body in enumerate(bodies):
        name, _, joint = body.partition("/")
        arm = arms.index(name)
        codes[condition[:, arm] >= NEAR_SINGULAR, index] = IS_SINGULAR
        if joint in joints[name]:
            codes[saturated[:, arm, joints[name].index(joint)], index] = IS_SATURATED
    return codes


def tint_changes(time: Array, codes: Codes) -> list[list[float]]:
    """Return ``[time, body, code]`` of every change, in order of time; nothing for bodies that stay plain.

    Args:
        time: s, shape (n,).
        codes: shape (n, bodies).
    """
    before = np.concatenate((np.full((1, codes.shape[1]), IS_PLAIN, dtype=np.int8), codes[:-1]))
    return [[float(time[sample]), int(body), int(codes[sample, body])] for sample, body in np.argwhere(codes != before)]
