"""Payload and wrists: mass, centre and inertia, and the zeros of the wrists, from the sum of the wrenches."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.identification.closure import Fit, Parameter, Priors, ViewClosure
from coop_pin.identification.filtering import Filtered, filter_error
from coop_pin.identification.views import FRAME_AXES
from coop_pin.logs.record import Record
from coop_pin.model.cell_arm import CellArm

_PAYLOAD = (
    ("mass", "", "kg"),
    *(("first moment", axis, "kg m") for axis in "xyz"),
    *(("inertia", axes, "kg m^2") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
)


def payload_fit(
    record: Record,
    scenario: Scenario,
    closure: ViewClosure,
    kinematics: Fit,
    samples: Mapping[str, Filtered],
    priors: Priors,
) -> Fit:
    """Return the estimate of the payload and of the wrists' zeros.

    In payload axes about P, with the parameters pi of the body, the zeros w_i and the wrenches F_i that the
    wrists read, ``-sum_i X_i (F_i - w_i) = Y(a - g, omega, omega') pi``. An interval in which the hands were
    free gives each w_i by itself; else the sum of the forces says nothing of a squeeze of zeros that cancel.
    A view that is tilted by an angle theta has the weight off by ``m R^T (g x theta)``: what the kinematics
    leave open of it is marginalised.

    Args:
        record: record of the arms.
        scenario: cell with payload and gravity.
        closure: views of the arms.
        kinematics: estimate of their errors.
        samples: filtered samples of all arms.
        priors: knowledge before the log.
    """
    arms, payload = closure.arms, scenario.cell.payload
    names = [*arms]
    rows = list(scenario.cell.task_rows.indices)
    parameters = [Parameter("", *one) for one in _PAYLOAD]
    for name in names:
        parameters += [
            Parameter(name, "wrist", axis, "N" if k < 3 else "N m") for k, axis in enumerate(FRAME_AXES)
        ]
    inertia = np.diag(payload.inertia_matrix)
    mean = pin.Inertia(payload.mass, np.zeros(3), np.array(payload.inertia_matrix)).toDynamicParameters()
    sds = [
        priors.mass * payload.mass,
        *[priors.centre * payload.mass] * 3,
        *[priors.inertia * inertia.max()] * 6,
    ]
    count = len(parameters)  # beyond them what the kinematics leave open, in sds
    prior = np.array([*sds, *[*np.repeat(priors.wrist, 3)] * len(names), *np.ones(len(kinematics.x))])
    first, X = samples[names[0]], [pin.SE3(arm.X_PE).toDualActionMatrix() for arm in arms.values()]
    Y = _regressors(arms[names[0]], first, np.array(scenario.cell.gravity))
    wrenches = [samples[name].wrench - hand_weight(scenario, arms[name], samples[name].q) for name in names]
    total = -sum((W @ F.T).T for W, F in zip(X, wrenches, strict=True))
    by_tilt = payload.mass * _by_tilt(closure, first.time, np.array(scenario.cell.gravity))
    spread = kinematics.spread
    wrists = (np.broadcast_to(-W, (len(Y), 6, 6)) for W in X)
    A = np.concatenate((Y, *wrists, by_tilt @ spread), axis=2)[:, rows]
    b = (total - Y @ mean - by_tilt @ kinematics.x)[:, rows]
    C = sum(W @ np.diag(samples[name].noise ** 2) @ W.T for name, W in zip(names, X, strict=True))
    step = max(float(np.median(np.diff(record.arms[name].wrench_time))) for name in names)
    C = C + np.diag(filter_error(Y @ mean, first.time, step) ** 2)
    whiten = np.linalg.inv(np.linalg.cholesky(C[np.ix_(rows, rows)]))
    A, b = whiten @ A, b @ whiten.T
    normal, right = np.einsum("nij,nik->jk", A, A), np.einsum("nij,ni->j", A, b)
    for k, name in enumerate(names):
        at = slice(10 + 6 * k, 16 + 6 * k)
        zero, weight = _free_hand(record, scenario, arms[name], name)
        normal[at, at] += np.diag(weight)
        right[at] += weight * zero
    H = np.linalg.inv(normal * np.outer(prior, prior) + np.eye(len(prior)))
    x = prior * (H @ (prior * right))
    residual = b - A @ x
    free = residual.size - np.trace(np.einsum("nij,nik->jk", A, A) * np.outer(prior, prior) @ H)
    chi = float(np.sqrt((residual**2).sum() / max(free, 1.0)))
    covariance = (max(chi, 1.0) ** 2 * H * np.outer(prior, prior))[:count, :count]
    return Fit(tuple(parameters), x[:count], covariance, prior[:count], chi, residual)


def _by_tilt(closure: ViewClosure, times: Array, gravity: Array) -> Array:
    """Return how the kinematic errors turn the weight of 1 kg in payload axes, shape (n, 6, p)."""
    R = closure.view(next(iter(closure.arms)), times).pose[:, :3, :3]
    force = np.swapaxes(R, 1, 2) @ pin.skew(gravity) @ closure.turns(times)
    return np.concatenate((force, np.zeros_like(force)), axis=1)


def _regressors(arm: CellArm, samples: Filtered, gravity: Array) -> Array:
    """Return Y with the wrench that moves a body about P, in payload axes, shape (n, 6, 10)."""
    model, Y = arm.kinematics.model, np.empty((len(samples.time), 6, 10))
    data, payload = model.createData(), model.getFrameId("payload")
    for k, (angles, v, a) in enumerate(zip(samples.q, samples.v, samples.a, strict=True)):
        pin.forwardKinematics(model, data, arm.configuration(angles), v, a)
        R = pin.updateFramePlacement(model, data, payload).rotation
        V = pin.getFrameVelocity(model, data, payload, pin.LOCAL)
        A = pin.getFrameClassicalAcceleration(model, data, payload, pin.LOCAL)
        # the body's own frame at rest in translation: Pinocchio adds omega x v to the linear part
        Y[k] = pin.bodyRegressor(
            pin.Motion(np.zeros(3), V.angular), pin.Motion(A.linear - R.T @ gravity, A.angular)
        )
    return Y


def hand_weight(scenario: Scenario, arm: CellArm, position: Array) -> Array:
    """Return the weight of the hand behind a wrist in axes of the tip, shape (n, 6)."""
    stated = None if scenario.log is None else scenario.log.arms[arm.name]
    if stated is None or not stated.hand_mass:
        return np.zeros((len(position), 6))
    R = np.array([arm.tip_pose(arm.configuration(q))[:3, :3] for q in position])
    # the wrench on the arm by what hangs on the sensor
    force = stated.hand_mass * np.einsum("nji,j->ni", R, np.array(scenario.cell.gravity))
    return np.hstack((force, np.cross(np.array(stated.hand_centre), force)))


def _free_hand(record: Record, scenario: Scenario, arm: CellArm, name: str) -> tuple[Array, Array]:
    """Return the zero of a wrist while the hands were free, and its weight 1 / sd^2, shapes (6,)."""
    samples = record.arms[name]
    if record.free is None:
        return np.zeros(6), np.zeros(6)
    start, end = record.free
    is_free = (samples.wrench_time >= start) & (samples.wrench_time < end)
    if is_free.sum() < 2:
        return np.zeros(6), np.zeros(6)
    middle = int(np.searchsorted(samples.time, (start + end) / 2.0))
    wrench = samples.wrench[is_free] - hand_weight(scenario, arm, samples.position[middle][None])
    variance = np.maximum(wrench.var(axis=0), 1e-12) / is_free.sum()
    return wrench.mean(axis=0), 1.0 / variance
