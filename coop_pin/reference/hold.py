"""Stand still."""

from __future__ import annotations

from dataclasses import dataclass, field

from coop_pin.arrays import Array
from coop_pin.reference.checks import as_pose, keep
from coop_pin.reference.target import PoseReference, PoseTarget, make_target


@dataclass(frozen=True, eq=False)
class Hold(PoseReference):
    """X_WP_d = pose at all times.

    Attributes:
        pose: desired pose of P in W, shape (4, 4).

    Raises:
        ShapeError, NotFiniteError, NotAPoseError: pose is not a pose.
    """

    pose: Array
    _target: PoseTarget = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the pose and make the one target."""
        pose = as_pose("pose", self.pose)
        keep(self, pose=pose, _target=make_target(pose[:3, :3], pose[:3, 3]))

    def at(self, time: float) -> PoseTarget:
        """Return the target, the same object at every time."""
        return self._target
