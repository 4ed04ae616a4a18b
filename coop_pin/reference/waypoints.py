"""Through given poses at given times."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array, as_array
from coop_pin.reference.checks import as_pose, keep
from coop_pin.reference.splines import PoseSpline
from coop_pin.reference.target import PoseReference, PoseTarget


@dataclass(frozen=True, eq=False)
class Waypoints(PoseReference):
    """A smooth path through poses at their times, at rest before the first and after the last.

    The path does not stop at the poses between; see PoseSpline for how it is made. To stop at a pose, give it twice, or
    chain Line motions. Times that are spaced very unevenly make the path swing out between its poses.

    Attributes:
        times: s, strictly increasing, shape (n,), n >= 2.
        poses: X_WP_d at these times, shape (n, 4, 4).

    Raises:
        ShapeError, NotFiniteError: a field has another shape or holds a NaN.
        NotAPoseError: one of the poses is not a pose.
        NotIncreasingError: times do not increase strictly.
        AmbiguousTurnError: neighbouring orientations are about half a turn apart.
    """

    times: Array
    poses: Array
    _spline: PoseSpline = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the poses and fit the spline."""
        times = as_array("times", self.times, "n")
        poses = as_array("poses", self.poses, len(times), 4, 4)
        for index, pose in enumerate(poses):
            as_pose(f"poses[{index}]", pose)
        quaternions = np.reshape(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), (-1, 4))
        keep(self, times=times, poses=poses, _spline=PoseSpline(times, poses[:, :3, 3], quaternions))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        return self._spline.at(time)
