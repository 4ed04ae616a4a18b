"""Closed chains that cannot be closed, solved or moved."""

from __future__ import annotations

from typing import Any

from coop_pin.errors.root import CoopPinError


class UnreachablePoseError(CoopPinError, ValueError):
    """An arm cannot hold the payload at a pose.

    Attributes:
        arm: the arm.
        gap_m: the least distance found between its tip and its grasp.
        gap_rad: the angle that is left between them at that distance.
    """

    def __init__(self, arm: str, gap_m: float, gap_rad: float, detail: str = "") -> None:
        self.arm, self.gap_m, self.gap_rad = arm, gap_m, gap_rad
        super().__init__(
            f"arm {arm!r} misses its grasp by {gap_m:.3g} m and {gap_rad:.3g} rad at the best joint angles found;"
            f" move the payload pose, the base or the grasp{detail}"
        )


class JointLimitError(UnreachablePoseError):
    """An arm could hold the payload at a pose, but only beyond its joint limits.

    Attributes:
        joint: the joint that stands farthest beyond its limits at the best angles that hold the payload.
        value: where it stands there, rad or m.
        lower: its limits.
        upper: likewise.
    """

    def __init__(self, arm: str, gap_m: float, gap_rad: float, joint: str, value: float, lower: float, upper: float) -> None:
        self.joint, self.value, self.lower, self.upper = joint, value, lower, upper
        detail = f". Only joint limits prevent it: {joint!r} would stand at {value:.4g} (allowed {lower:.4g} to {upper:.4g})"
        super().__init__(arm, gap_m, gap_rad, detail)


class OpenClosureError(CoopPinError, ValueError):
    """Closures stand open where they must be closed.

    Attributes:
        closure: the closure.
        gap_m: distance across it.
        gap_rad: angle across it.
    """

    def __init__(self, closure: str, gap_m: float, gap_rad: float, allowed: float) -> None:
        self.closure, self.gap_m, self.gap_rad = closure, gap_m, gap_rad
        super().__init__(
            f"closure {closure!r} is open by {gap_m:.3g} m and {gap_rad:.3g} rad (allowed {allowed:.3g});"
            " project the state onto the closures first, or correct the starting angles"
        )


class ConstraintSolveError(CoopPinError, ArithmeticError):
    """The constrained dynamics left a residual: J a + gamma is not zero.

    Attributes:
        residual: its largest entry, m/s^2 or rad/s^2.
        allowed: the largest accepted.
    """

    def __init__(self, residual: float, allowed: float) -> None:
        self.residual, self.allowed = residual, allowed
        super().__init__(
            f"the constraint solver left a residual of {residual:.3g} (allowed {allowed:.3g});"
            " the state is far off the closures or the closures contradict each other; check grasps and starting angles, or lower the gains"
        )


class MassMatrixError(CoopPinError, ArithmeticError):
    """A mass matrix is not positive definite: something moves without mass.

    Attributes:
        smallest: its smallest eigenvalue.
    """

    def __init__(self, smallest: float) -> None:
        self.smallest = smallest
        super().__init__(
            f"the mass matrix has an eigenvalue {smallest:.3g}; it must be greater than zero:"
            " give every moving link, or what is fixed to it, a mass and an inertia"
        )


class IntegrationError(CoopPinError, ArithmeticError):
    """A motion could not be followed to its end; what was computed up to then is kept.

    Attributes:
        time: time of the last good state, s.
        step: the time step, s.
        result: the Trajectory up to then.
    """

    def __init__(self, time: float, step: float, why: str, result: Any) -> None:
        self.time, self.step, self.result = time, step, result
        super().__init__(
            f"the motion broke down after t = {time:.6g} s: {why}; take a step smaller than {step:.3g} s; the motion up to then is kept"
        )


class SingularJacobianError(CoopPinError, ArithmeticError):
    """A payload Jacobian is singular (Assumption 2 of the paper fails).

    Attributes:
        condition: its condition number.
        time: time, s.
        limit: the greatest that is allowed.
    """

    def __init__(self, condition: float, time: float, limit: float, owner: str = "the arm") -> None:
        self.condition, self.time, self.limit = condition, time, limit
        super().__init__(
            f"{owner} is singular at t = {time:.6g} s: condition number {condition:.3g} of its payload Jacobian"
            f" (allowed {limit:.3g}); keep the motion away from stretched or folded arms"
        )


class SingularArmError(SingularJacobianError):
    """An arm of the cell reached a singular pose.

    Attributes:
        arm: the arm.
        condition: condition number of its payload Jacobian.
        time: time, s.
    """

    def __init__(self, arm: str, condition: float, time: float, limit: float) -> None:
        self.arm = arm
        super().__init__(condition, time, limit, owner=f"arm {arm!r}")
