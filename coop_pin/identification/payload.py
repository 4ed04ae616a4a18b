"""Payload and wrists: the payload, zeros of the wrists and weights of hands, from the sum of the wrenches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.identification.closure import ViewClosure
from coop_pin.identification.estimate import Fit, Parameter, Priors
from coop_pin.identification.filtering import Filtered, filter_error
from coop_pin.identification.views import FRAME_AXES
from coop_pin.logs.record import Record
from coop_pin.model.cell_arm import CellArm

_PAYLOAD = (
    ("mass", "", "kg"),
    *(("first moment", axis, "kg m") for axis in "xyz"),
    *(("inertia", axes, "kg m^2") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
)

HAND_AXES = ("mass", "moment x", "moment y", "moment z")
"""Parameters of a hand: its mass and its first moments in axes of the tip."""


def payload_fit(
    record: Record,
    scenario: Scenario,
    closure: ViewClosure,
    kinematics: Fit,
    samples: Mapping[str, Filtered],
    priors: Priors,
) -> Fit:
    """Return the estimate of the payload, of the wrists' zeros, and of hands whose weight is in a wrench.

    In payload axes about P, with the parameters pi of the body, the zeros w_i, hands h_i and the wrenches F_i
    that the wrists read, ``-sum_i X_i (F_i - w_i - G_i h_i) = Y(a - g, omega, omega') pi``. An interval in
    which the hands were free gives each ``w_i + G_i h_i`` by itself; else the sum of the forces says nothing
    of a squeeze of zeros that cancel.
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
    inertia = np.array(payload.inertia_matrix)
    mean = pin.Inertia(payload.mass, np.zeros(3), inertia).toDynamicParameters()
    parameters, sds = _unknowns(scenario, names, priors)
    count = len(parameters)  # beyond them what the kinematics leave open, in sds
    prior = np.array([*sds, *np.ones(len(kinematics.x))])
    first, late = samples[names[0]], kinematics.late
    X = [
        np.array(
            [pin.SE3(one).toDualActionMatrix() for one in closure.tip(name, first.time + late.get(name, 0.0))]
        )
        for name in names
    ]
    gravity = np.array(scenario.cell.gravity)
    Y = _regressors(arms[names[0]], first, gravity, closure.tip(names[0], first.time))
    wrenches = [samples[name].wrench - hand_weight(scenario, arms[name], samples[name].q) for name in names]
    total = -sum(np.einsum("nij,nj->ni", W, F) for W, F in zip(X, wrenches, strict=True))
    by_tilt = payload.mass * _by_tilt(closure, first.time, gravity)
    spread = kinematics.spread
    wrists = (-W for W in X)
    hands = (
        -X[names.index(name)] @ hand_columns(tip_rotations(arms[name], samples[name].q), gravity)
        for name in _stated_hands(scenario)
    )
    A = np.concatenate((Y, *wrists, *hands, by_tilt @ spread), axis=2)[:, rows]
    b = (total - Y @ mean - by_tilt @ kinematics.x)[:, rows]
    C = sum(W[0] @ np.diag(samples[name].noise ** 2) @ W[0].T for name, W in zip(names, X, strict=True))
    step = max(float(np.median(np.diff(record.arms[name].wrench_time))) for name in names)
    C = C + np.diag(filter_error(Y @ mean, first.time, step) ** 2)
    whiten = np.linalg.inv(np.linalg.cholesky(C[np.ix_(rows, rows)]))
    A, b = whiten @ A, b @ whiten.T
    normal, right = np.einsum("nij,nik->jk", A, A), np.einsum("nij,ni->j", A, b)
    for name in names:
        at = [k for k, one in enumerate(parameters) if one.arm == name]
        zero, weight, J = _free_hand(record, scenario, arms[name])
        normal[np.ix_(at, at)] += J[:, : len(at)].T @ (weight[:, None] * J[:, : len(at)])
        right[at] += J[:, : len(at)].T @ (weight * zero)
    H = np.linalg.inv(normal * np.outer(prior, prior) + np.eye(len(prior)))
    x = prior * (H @ (prior * right))
    residual = b - A @ x
    free = residual.size - np.trace(np.einsum("nij,nik->jk", A, A) * np.outer(prior, prior) @ H)
    chi = float(np.sqrt((residual**2).sum() / max(free, 1.0)))
    covariance = (max(chi, 1.0) ** 2 * H * np.outer(prior, prior))[:count, :count]
    return Fit(tuple(parameters), x[:count], covariance, prior[:count], chi)


def _unknowns(
    scenario: Scenario, names: Sequence[str], priors: Priors
) -> tuple[list[Parameter], list[float]]:
    """Return the parameters of payload, wrists and hands, and their standard deviations before the log."""
    payload = scenario.cell.payload
    largest = np.diag(payload.inertia_matrix).max()
    parameters = [Parameter("", *one) for one in _PAYLOAD]
    sds = [
        priors.mass * payload.mass,
        *[priors.centre * payload.mass] * 3,
        *[priors.inertia * largest] * 6,
        *[*np.repeat(priors.wrist, 3)] * len(names),
    ]
    for name in names:
        parameters += [
            Parameter(name, "wrist", axis, "N" if k < 3 else "N m") for k, axis in enumerate(FRAME_AXES)
        ]
    for name, hand in _stated_hands(scenario).items():
        units = ("kg", *("kg m",) * 3)
        parameters += [
            Parameter(name, "hand", axis, unit) for axis, unit in zip(HAND_AXES, units, strict=True)
        ]
        moments = np.hypot(priors.hand[1] * hand[0], priors.hand[0] * np.abs(hand[1:] / hand[0]))
        sds += [priors.hand[0], *moments]
    return parameters, sds


def _by_tilt(closure: ViewClosure, times: Array, gravity: Array) -> Array:
    """Return how the kinematic errors turn the weight of 1 kg in payload axes, shape (n, 6, p)."""
    R = closure.view(next(iter(closure.arms)), times).pose[:, :3, :3]
    force = np.swapaxes(R, 1, 2) @ pin.skew(gravity) @ closure.turns(times)
    return np.concatenate((force, np.zeros_like(force)), axis=1)


def _regressors(arm: CellArm, samples: Filtered, gravity: Array, tips: Array) -> Array:
    """Return Y with the wrench that moves a body about P, in payload axes, shape (n, 6, 10).

    Where a spring lets the tip be elsewhere than its grasp, the arm's axes of the payload are turned, and the
    payload is not moved as the tip is.

    Args:
        arm: the arm.
        samples: samples of the arm.
        gravity: m/s^2, world axes, shape (3,).
        tips: poses of the tip in the payload frame, shape (n, 4, 4).
    """
    model, Y = arm.kinematics.model, np.empty((len(samples.time), 6, 10))
    data, payload = model.createData(), model.getFrameId("payload")
    turns = tips[:, :3, :3] @ arm.X_PE[:3, :3].T
    gives = -samples.give @ pin.SE3(arm.X_PE).toActionMatrix().T
    rows = zip(samples.q, samples.v, samples.a, turns, gives, strict=True)
    for k, (angles, v, a, turn, give) in enumerate(rows):
        pin.forwardKinematics(model, data, arm.configuration(angles), v, a)
        R = pin.updateFramePlacement(model, data, payload).rotation
        V = pin.getFrameVelocity(model, data, payload, pin.LOCAL)
        A = pin.getFrameClassicalAcceleration(model, data, payload, pin.LOCAL)
        # the body's own frame at rest in translation: Pinocchio adds omega x v to the linear part
        Y[k] = pin.bodyRegressor(
            pin.Motion(np.zeros(3), turn @ V.angular),
            pin.Motion(turn @ (A.linear - R.T @ gravity) + give[:3], turn @ A.angular + give[3:]),
        )
    return Y


def tip_rotations(arm: CellArm, position: Array) -> Array:
    """Return the rotations of an arm's tip at joint positions, shape (n, 3, 3)."""
    return np.array([arm.tip_pose(arm.configuration(q))[:3, :3] for q in position])


def hand_columns(rotations: Array, gravity: Array) -> Array:
    """Return what a unit of each parameter of a hand weighs on its wrist, in axes of the tip, (n, 6, 4).

    Args:
        rotations: rotations of the tip, shape (n, 3, 3).
        gravity: m/s^2, world axes, shape (3,).
    """
    down = np.einsum("nji,j->ni", rotations, gravity)
    G = np.zeros((len(down), 6, 4))
    G[:, :3, 0] = down
    G[:, 3:, 1:] = np.cross(np.eye(3), down[:, None]).swapaxes(1, 2)
    return G


def _stated_hands(scenario: Scenario) -> dict[str, Array]:
    """Return mass and first moments of the hands whose weight is in the wrench of their wrist, by arm."""
    arms = {} if scenario.log is None else scenario.log.arms
    return {
        name: one.hand_mass * np.array((1.0, *one.hand_centre)) for name, one in arms.items() if one.hand_mass
    }


def hand_weight(scenario: Scenario, arm: CellArm, position: Array, fit: Fit | None = None) -> Array:
    """Return the weight of the hand behind a wrist in axes of the tip, stated or estimated, shape (n, 6)."""
    hand = _stated_hands(scenario).get(arm.name)
    if hand is None:
        return np.zeros((len(position), 6))
    if fit is not None:
        hand = hand + fit.x[fit.of(arm.name, "hand")]
    return np.asarray(hand_columns(tip_rotations(arm, position), np.array(scenario.cell.gravity)) @ hand)


def _free_hand(record: Record, scenario: Scenario, arm: CellArm) -> tuple[Array, Array, Array]:
    """Return what a wrist reads of free hands beyond their stated weight, what is known of it, and of what.

    Returns:
        Reading, 1 / sd^2 and the columns of zero and hand, shapes (6,), (6,) and (6, 10).
    """
    samples, J = record.arms[arm.name], np.eye(6, 10)
    wrench = samples.free_wrench(record.free)
    if record.free is None or len(wrench) < 2:
        return np.zeros(6), np.zeros(6), J
    at = samples.position[int(np.searchsorted(samples.time, sum(record.free) / 2.0))][None]
    J[:, 6:] = hand_columns(tip_rotations(arm, at), np.array(scenario.cell.gravity))[0]
    wrench = wrench - hand_weight(scenario, arm, at)
    return wrench.mean(axis=0), len(wrench) / np.maximum(wrench.var(axis=0), 1e-12), J
