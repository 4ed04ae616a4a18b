"""A cell as a user says it: arms, one payload, where each arm grips it, and how the load is shared."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from coop_pin.arrays import Array
from coop_pin.description.arm import Arm
from coop_pin.description.base import Description, Vector3
from coop_pin.description.payload import Payload
from coop_pin.description.pose import Pose
from coop_pin.errors import FieldError, LoadShareError, suggestion
from coop_pin.spatial.task_rows import RowsName, TaskRows, task_rows


class Cell(Description):
    """Two or more arms that rigidly hold one payload.

    Attributes:
        arms: the arms by name; their order is the order of arrays.
        payload: the held object.
        grasps: for each arm the pose X_PE of its tip in the payload frame.
        rows: the task rows: "full", or "planar" for arms that move in the world's x-y plane.
        gravity: m/s^2, in world axes.
        load_shares: c_i for each arm, summing to one; equal when omitted.
    """

    arms: dict[str, Arm] = Field(min_length=1)
    payload: Payload
    grasps: dict[str, Pose]
    rows: RowsName = "full"
    gravity: Vector3 = (0.0, 0.0, -9.81)
    load_shares: dict[str, float] | None = None

    @field_validator("arms")
    @classmethod
    def _named(cls, arms: dict[str, Arm]) -> dict[str, Arm]:
        for name in arms:
            if "/" in name or "." in name or not name:
                raise FieldError(f"arm name {name!r} must not be empty or hold '/' or '.'")
        return arms

    @field_validator("grasps")
    @classmethod
    def _one_grasp_each(cls, grasps: dict[str, Pose], earlier: ValidationInfo) -> dict[str, Pose]:
        check_arm_names(grasps, earlier.data.get("arms"))
        return grasps

    @field_validator("load_shares")
    @classmethod
    def _shares_sum_to_one(cls, shares: dict[str, float] | None, earlier: ValidationInfo) -> dict[str, float] | None:
        if shares is None:
            return None
        check_arm_names(shares, earlier.data.get("arms"), LoadShareError)
        total = sum(shares.values())
        if abs(total - 1.0) > 1e-9:
            raise LoadShareError(f"{shares} sum to {total:.9g}; load shares must sum to 1 (eq. (11))")
        return shares

    @property
    def task_rows(self) -> TaskRows:
        """The k_0 rows the cell works on."""
        return task_rows(self.rows)

    @property
    def shares(self) -> Array:
        """Load shares c_i in the order of the arms, shape (m,)."""
        if self.load_shares is None:
            return np.full(len(self.arms), 1.0 / len(self.arms))
        return np.array([self.load_shares[name] for name in self.arms])


def check_arm_names(given: Iterable[str], arms: Iterable[str] | None, error: type[FieldError] = FieldError) -> None:
    """Refuse a table by arm that misses an arm or names one that does not exist; without arms (they have mistakes) say nothing."""
    if arms is None:
        return
    given, arms = list(given), list(arms)
    for name in given:
        if name not in arms:
            raise error(f"names arm {name!r}, which the cell does not have; {suggestion(name, arms)}")
    missing = [name for name in arms if name not in given]
    if missing:
        raise error(f"has no entry for {missing}; every arm needs one")
