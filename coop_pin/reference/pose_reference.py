"""Is a reference's twist the derivative of its pose, and its acceleration that of its twist?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.errors import InconsistentReferenceError
from coop_pin.reference.checks import as_pose
from coop_pin.reference.differences import displacements, rate_of, twist_from
from coop_pin.reference.target import PoseReference

STEP = 1e-6
"""Of the differences, s: short, because the jerk may jump where two segments meet and first differences suffice."""
SMALLEST_SCALE = 0.1
"""Motions slower than this are compared as if they were this fast, SI: below it differences see their own round-off."""


class ConsistencyGaps(NamedTuple):
    """The largest disagreements found."""

    twist: float
    """Between V_WP_d and the differences of X_WP_d, largest entry, m/s or rad/s."""

    acceleration: float
    """Between A_WP_d and the differences of V_WP_d, largest entry, m/s^2 or rad/s^2."""


def check_consistency(reference: PoseReference, times: ArrayLike, allowed: float = 1e-3) -> ConsistencyGaps:
    """Compare a reference's twist and acceleration with central differences at given times.

    Linear and angular parts are compared apart, each with what is allowed of its largest norm over the times.

    Args:
        reference: any reference, the user's own included.
        times: where to look, s, shape (n,).
        allowed: largest accepted gap as a fraction of the largest value.

    Returns:
        the largest gaps, where all are accepted.

    Raises:
        ShapeError, NotFiniteError, NotAPoseError: a target is not what PoseTarget says.
        InconsistentReferenceError: a gap is too large; it names the part, the time and the gap.
    """
    instants = as_array("times", times, "n").tolist()
    for time in instants:
        _check_target(reference, time)
    twists = np.array([reference.at(time).V_WP_d for time in instants])
    accelerations = np.array([reference.at(time).A_WP_d for time in instants])
    pose_rates = np.array([twist_from(displacements(lambda t: reference.at(t).X_WP_d, time, STEP), STEP) for time in instants])
    twist_rates = np.array([rate_of(lambda t: reference.at(t).V_WP_d, time, STEP) for time in instants])
    return ConsistencyGaps(
        _largest_gap("V_WP_d", instants, twists, pose_rates, allowed),
        _largest_gap("A_WP_d", instants, accelerations, twist_rates, allowed),
    )


def _check_target(reference: PoseReference, time: float) -> None:
    """Refuse a target of wrong shape, not finite, or not a pose."""
    target = reference.at(time)
    as_pose(f"X_WP_d({time})", target.X_WP_d)
    as_array(f"V_WP_d({time})", target.V_WP_d, 6)
    as_array(f"A_WP_d({time})", target.A_WP_d, 6)


def _largest_gap(name: str, times: Sequence[float], given: Array, differences: Array, allowed: float) -> float:
    """Return the largest entry of given - differences, both of shape (n, 6), once each half is accepted."""
    for part, half in (("linear", slice(0, 3)), ("angular", slice(3, 6))):
        gaps = np.linalg.norm(given[:, half] - differences[:, half], axis=1)
        scale = max(SMALLEST_SCALE, float(np.linalg.norm(differences[:, half], axis=1).max(initial=0.0)))
        if gaps.max(initial=0.0) > allowed * scale:
            worst = int(gaps.argmax())
            raise InconsistentReferenceError(f"{part} part of {name}", times[worst], float(gaps[worst]), allowed * scale)
    return float(np.abs(given - differences).max(initial=0.0))
