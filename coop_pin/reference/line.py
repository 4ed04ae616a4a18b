"""From one pose to another along a straight line."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.errors import AmbiguousTurnError
from coop_pin.reference.axis_turn import axis_turn_terms, turned
from coop_pin.reference.checks import as_number, as_pose, as_positive, keep
from coop_pin.reference.target import PoseReference, PoseTarget, make_target
from coop_pin.reference.time_scaling import rest_to_rest

HALF_TURN_MARGIN = 1e-3
"""Turns closer than this to pi are refused, rad: round-off would choose the way round."""


@dataclass(frozen=True, eq=False)
class Line(PoseReference):
    """p = p_0 + s (p_1 - p_0), R = exp(s phi) R_0 with phi = log(R_1 R_0^T), s(t) the quintic from rest to rest.

    The pose rests at start before start_time and at goal afterwards; the orientation takes the geodesic, the shorter way.

    Attributes:
        start: X_WP_d before, shape (4, 4).
        goal: X_WP_d afterwards, shape (4, 4).
        duration: of the motion, s, positive.
        start_time: s.

    Raises:
        ShapeError, NotFiniteError, NotAPoseError: start or goal is not a pose.
        NotPositiveError: duration is zero or less.
        AmbiguousTurnError: start and goal are half a turn apart.
    """

    start: Array
    goal: Array
    duration: float
    start_time: float = 0.0
    _displacement: Array = field(init=False, repr=False)
    _turn: Array = field(init=False, repr=False)
    _angle: float = field(init=False, repr=False)
    _terms: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields and take the difference of the two poses."""
        start, goal = as_pose("start", self.start), as_pose("goal", self.goal)
        keep(self, start=start, goal=goal, duration=as_positive("duration", self.duration))
        R_0 = start[:3, :3]
        turn = Rotation.from_matrix(goal[:3, :3] @ R_0.T).as_rotvec()
        angle = float(np.linalg.norm(turn))
        if angle > math.pi - HALF_TURN_MARGIN:
            raise AmbiguousTurnError("start", "goal", 1, angle)
        axis = turn / angle if angle else turn
        keep(self, start_time=as_number("start_time", self.start_time), _displacement=goal[:3, 3] - start[:3, 3])
        keep(self, _turn=turn, _angle=angle, _terms=axis_turn_terms(axis, R_0))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        s = rest_to_rest(time, self.start_time, self.duration)
        d, phi = self._displacement, self._turn
        R, p = turned(self._terms, s.value * self._angle), self.start[:3, 3] + s.value * d
        return make_target(R, p, s.rate * d, s.rate * phi, s.acceleration * d, s.acceleration * phi)
