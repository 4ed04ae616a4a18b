"""What following the reference asks of one arm: reach, distance to singular poses, to joint limits and to the fastest it may turn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from coop_pin.arrays import Array
from coop_pin.control.terms import CONDITION_LIMIT
from coop_pin.errors import UnreachablePoseError


class Unreachable(NamedTuple):
    """The arm cannot follow.

    Attributes:
        time: when it first cannot, s.
        gap_time: when it is farthest away, s.
        gap_m: the least distance between tip and grasp it can keep then.
        gap_rad: the angle left between them at that distance.
        other_branch: the arm could hold the payload there, but not on the branch it came on; then the gap is
            that of its branch.
    """

    time: float
    gap_time: float
    gap_m: float
    gap_rad: float
    other_branch: bool


class NearlySingular(NamedTuple):
    """Where the arm comes closest to a singular pose.

    Attributes:
        time: s.
        sigma_min: smallest singular value of its payload Jacobian; 0 where the path leads through a singular
            pose.
        condition: largest over smallest singular value.
    """

    time: float
    sigma_min: float
    condition: float


class JointLimitMargin(NamedTuple):
    """A joint near or at a position limit.

    Attributes:
        joint: its name.
        time: s.
        value: where it stands, rad or m.
        lower: its limits.
        upper: likewise.
        unit: "rad" or "m".
    """

    joint: str
    time: float
    value: float
    lower: float
    upper: float
    unit: str

    @property
    def margin(self) -> float:
        """Way left to the nearer limit, rad or m; negative beyond it."""
        return min(self.value - self.lower, self.upper - self.value)


class FastestJoint(NamedTuple):
    """The joint that comes closest to its velocity limit, or exceeds it most.

    Attributes:
        joint: its name.
        time: s.
        speed: rad/s or m/s.
        limit: of its speed.
        unit: "rad/s" or "m/s".
    """

    joint: str
    time: float
    speed: float
    limit: float
    unit: str


@dataclass(frozen=True, eq=False)
class ArmReach:
    """One arm along the reference.

    Attributes:
        arm: its name.
        times: of the poses, s, shape (n,). The first ones, at t = 0, lead from the scenario's start to the
            reference.
        q: angles that hold the payload there, shape (n, nq); where the arm cannot follow, those that come
            nearest.
        sigma_min: smallest singular value of the payload Jacobian in task rows and drive coordinates, shape
            (n,).
        condition: its condition number, shape (n,).
        refusal: the arm cannot even hold the start; then the arrays are empty and nothing else is known.
        loss: the arm cannot follow.
        singular: where it comes closest to a singular pose.
        crossing: the first joint that leaves its position limits.
        closest: the joint with the smallest margin to a position limit; None when no joint has one.
        fastest: None when no joint has a velocity limit.
    """

    arm: str
    times: Array
    q: Array
    sigma_min: Array
    condition: Array
    refusal: UnreachablePoseError | None = None
    loss: Unreachable | None = None
    singular: NearlySingular | None = None
    crossing: JointLimitMargin | None = None
    closest: JointLimitMargin | None = None
    fastest: FastestJoint | None = None

    @property
    def ok(self) -> bool:
        """Whether the arm can follow within its position and velocity limits and away from singular poses."""
        return not any(self.problems())

    def problems(self) -> Iterator[str]:
        """Yield what is wrong, one sentence each."""
        if self.refusal is not None:
            yield f"cannot hold the start: {self.refusal}"
        if self.loss is not None:
            loss = self.loss
            yield (
                f"cannot follow from t = {loss.time:.4g} s on:"
                f" at t = {loss.gap_time:.4g} s it misses its grasp by {loss.gap_m:.3g} m and {loss.gap_rad:.3g} rad"
                + (" on this branch; another could hold it: change the posture" if loss.other_branch else "")
            )
        if self.singular is not None and not self.singular.condition < CONDITION_LIMIT:
            yield f"is singular at t = {self.singular.time:.4g} s: no law can follow through that pose"
        if self.crossing is not None:
            at = self.crossing
            yield f"{at.joint} leaves its limits {at.lower:.4g} to {at.upper:.4g} {at.unit} at t = {at.time:.4g} s"
        if self.fastest is not None and self.fastest.speed > self.fastest.limit:
            fast = self.fastest
            yield f"{fast.joint} must move at {fast.speed:.3g} {fast.unit} at t = {fast.time:.4g} s; its limit is {fast.limit:.3g}"

    def numbers(self) -> Iterator[str]:
        """Yield how close the arm comes to what it must not reach, one line each."""
        if self.singular is not None:
            near = self.singular
            yield f"closest to singular: sigma_min {near.sigma_min:.3g}, condition {near.condition:.3g} at t = {near.time:.4g} s"
        if self.closest is not None:
            at = self.closest
            yield f"smallest limit margin: {at.joint}, {at.margin:.3g} {at.unit} at t = {at.time:.4g} s (stands at {at.value:.4g})"
        if self.fastest is not None:
            fast = self.fastest
            yield f"fastest joint: {fast.joint}, {fast.speed:.3g} of {fast.limit:.3g} {fast.unit} at t = {fast.time:.4g} s"
