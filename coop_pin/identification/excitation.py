"""Excitation: what a log shows least of, by the force that it makes, and the motion that would show it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import pose_error
from coop_pin.identification.closure import ViewClosure
from coop_pin.identification.effects import Effects
from coop_pin.identification.estimate import Fit, Priors
from coop_pin.identification.views import FRAME_AXES
from coop_pin.logs.record import ArmRecord, Record

_SHIFT, _TURN = 0.1, 0.25
"""Amplitudes of the motions that are tried, m and rad; half of them where limits are in the way."""
_PERIOD, _KNOTS = 8.0, 13
"""Duration of one of them there and back, s, and its poses for inverse kinematics."""
_NEWTON = 4
"""Steps of inverse kinematics from one pose to the next."""


class Excitation(NamedTuple):
    """Motion that shows most of what a log leaves open, of shifts and turns along each axis.

    Attributes:
        least: names of the errors of which a combination is known least, by its force.
        axis: axis of the payload along or about which it moves.
        size: amplitude, m or rad.
        before: standard deviation of the force that all kinematic errors make, N.
        after: standard deviation with this motion as well, N.
        points: poses over time as a motion of waypoints takes them.
    """

    least: tuple[str, ...]
    axis: str
    size: float
    before: float
    after: float
    points: tuple[dict[str, object], ...]

    def __str__(self) -> str:
        """Return it as text."""
        kind, unit = ("turn", "rad about") if self.axis.startswith("r") else ("shift", "m along")
        return (
            f"least known: {' with '.join(self.least)};"
            f" a {kind} of +-{self.size:.3g} {unit} {self.axis[-1]}"
            f" of the payload would bring +-{1.96 * self.before:.2g} N of the views"
            f" to +-{1.96 * self.after:.2g} N"
        )

    def to_toml(self) -> str:
        """Return its points as tables of a scenario's motion of waypoints."""
        tables = ["\n".join(f"{key} = {value}" for key, value in point.items()) for point in self.points]
        return "\n".join(
            ["[motion]", 'kind = "waypoints"', *(f"\n[[motion.points]]\n{one}" for one in tables)]
        )


def best_excitation(closure: ViewClosure, fit: Fit, effects: Effects, priors: Priors) -> Excitation | None:
    """Return the motion after which the force of kinematic errors is known best; None if none is feasible.

    The covariance after a motion is ``(C^-1 + J^T W J)^-1``, with J and W along it.

    Args:
        closure: views of the arms in the log.
        fit: estimate of the kinematic errors.
        effects: forces of all parameters, those of the fit first.
        priors: knowledge before the log.
    """
    columns = effects.force[..., : len(fit.x)].reshape(-1, len(fit.x))
    gram = columns.T @ columns / (effects.force.shape[0] * effects.force.shape[1])
    values, vectors = np.linalg.eigh(fit.spread.T @ gram @ fit.spread)
    share = np.abs(fit.spread @ vectors[:, -1]) * np.sqrt(np.diag(gram))
    most = [k for k in np.argsort(-share)[:3] if share[k] > 0.5 * share.max()]
    least, before = tuple(str(fit.parameters[k]) for k in most), float(np.sqrt(values.sum()))
    scale, best = np.outer(fit.prior, fit.prior), None
    known = np.linalg.inv(fit.covariance / scale + 1e-9 * np.eye(len(fit.x)))
    for axis, size, points, record in _motions(closure):
        other = ViewClosure(record, closure.arms, priors, noise=closure.noise)
        at = {one: k for k, one in enumerate(other.parameters)}
        kept = [k for k, one in enumerate(fit.parameters) if one in at]
        of_other = [at[fit.parameters[k]] for k in kept]
        seen = known.copy()
        seen[np.ix_(kept, kept)] += other.information()[np.ix_(of_other, of_other)]
        after = float(np.sqrt(max((np.linalg.inv(seen) * scale * gram).sum(), 0.0)))
        if best is None or after < best.after:
            best = Excitation(least, axis, size, before, after, points)
    return best


def _motions(closure: ViewClosure) -> Iterator[tuple[str, float, tuple[dict[str, object], ...], Record]]:
    """Yield axis, size, points and record of shifts and turns about the first pose, within joint limits."""
    X_0 = pin.SE3(closure.view(next(iter(closure.arms)), closure.times[:1]).pose[0])
    phases = np.sin(np.linspace(0.0, 2.0 * np.pi, _KNOTS))
    times = np.linspace(0.0, _PERIOD, _KNOTS)
    for axis in closure.rows.indices:
        for part in (1.0, 0.5):
            size = part * (_SHIFT if axis < 3 else _TURN)
            steps = size * phases[:, None] * np.eye(6)[axis]
            poses = [X_0 * pin.SE3(pin.exp3(step[3:]), step[:3]) for step in steps]
            if (record := _record(closure, times, poses)) is None:
                continue
            points = tuple(
                {
                    "time": round(float(time), 3),
                    "xyz": pose.translation.round(4).tolist(),
                    "rpy": pin.rpy.matrixToRpy(pose.rotation).round(4).tolist(),
                }
                for time, pose in zip(times[::3], poses[::3], strict=True)
            )
            yield FRAME_AXES[axis], size, points, record
            break


def _record(closure: ViewClosure, times: Array, poses: list[pin.SE3]) -> Record | None:
    """Return what the arms would log along poses, at 50 Hz; None if one cannot follow within its limits."""
    grid, none, arms = np.arange(times[0], times[-1], 0.02), np.empty(0), {}
    rows = list(closure.rows.indices)
    for name, arm in closure.arms.items():
        q, positions = closure.joints(name, closure.times[:1])[0][0], []
        for pose in poses:
            for _ in range(_NEWTON):  # from the pose before
                at = arm.configuration(q)
                error = pose_error(arm.payload_pose(at), pose.homogeneous)[rows]
                q = q - np.linalg.pinv(arm.payload_jacobian(at)[rows]) @ error
            if np.abs(error).max() > 1e-3 or (q < arm.limits.lower).any() or (q > arm.limits.upper).any():
                return None
            positions.append(q)
        path = np.stack([np.interp(grid, times, one) for one in np.array(positions).T], axis=1)
        arms[name] = ArmRecord(grid, path, path, path, none, np.empty((0, 6)))
    return Record(arms, none, np.empty((0, 4, 4)))
