"""Identification of payload and grasps by least squares on twists, their derivatives and wrenches."""

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

GRASPS, MASS = "transformations between the grasps follow", "mass and centre follow from wrenches"
INERTIA = "the inertia follows from wrenches"
EXACT, NOISY = ("joint_position", "interaction_wrench"), ("measured_drive_position", "measured_wrench")


def rate(x: Array, T: float) -> Array:
    """Return the derivative of a signal of period T, per second."""
    return np.asarray(savgol_filter(x, 125, 3, deriv=1, delta=T, axis=0))


def felt(cell: cp.Scenario, data: Any, arm: str, signals: tuple[str, str]) -> tuple[Array, ...]:
    """Return an arm's rotation into the world, and twist, force and moment on the payload in its axes."""
    T, one = cell.clock.period, data.sel(arm=arm)
    angles, F = (one[name].values for name in signals)
    X = cell.cell.arms[arm].tip_poses(angles)
    R, lever = X[:, :3, :3], (data.payload_position - one.tip_position).values  # a record has moments about P
    world = rate(X[:, :3, 3], T), -F[:, :3], -F[:, 3:] - np.cross(lever, F[:, :3])
    v, force, moment = (np.einsum("tji,tj->ti", R, x) for x in world)
    spin = np.einsum("tji,tjk->tik", R, rate(R, T))
    return R, np.hstack([v, spin[:, [2, 0, 1], [1, 2, 0]]]), force, moment


def estimates(cell: cp.Scenario, data: Any, signals: tuple[str, str], part: slice) -> tuple[Any, list[Array]]:
    """Return the load about the first grasp, and the pose of each other grasp to it."""
    (R, V, force, moment), *others = (felt(cell, data, arm, signals) for arm in cell.cell.arms)
    v, w, poses = V[part, :3], V[part, 3:], []
    skew = np.concatenate([pin.skew(one) for one in w])
    for _, V_i, f, m in others:
        turn = Rotation.align_vectors(w, V_i[part, 3:])[0]
        p = np.linalg.lstsq(skew, (turn.apply(V_i[part, :3]) - v).ravel(), rcond=None)[0]
        force, moment = force + turn.apply(f), moment + turn.apply(m) + np.cross(p, turn.apply(f))
        poses.append(pin.SE3(turn.as_matrix(), p).homogeneous)
    A = rate(V, cell.clock.period) + np.hstack([9.81 * R[:, 2], np.zeros_like(R[:, 2])])
    Y = [pin.bodyRegressor(pin.Motion(x), pin.Motion(a)) for x, a in zip(V[part], A[part], strict=True)]
    theta = np.linalg.lstsq(np.concatenate(Y), np.hstack([force, moment])[part].ravel(), rcond=None)[0]
    return pin.Inertia.FromDynamicParameters(theta), poses


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Shake the plate, and fit exact signals and noisy ones, over ever more seconds."""
    duration, loose = (4.0, 5.0) if short else (10.0, 1.0)
    data, load = cp.run(cell.override({"duration": duration}), warn=False).data, cell.cell.payload
    ends, fits, numbers = np.linspace(0.4, 1.0, 10) * (len(data.time) - 200), [], []
    first, *grasps = (grasp.matrix for grasp in cell.cell.grasps.values())
    true = first[:3, :3].T @ np.diag(load.inertia[:3]) @ first[:3, :3]
    for label, signals, end in [("exact", EXACT, ends[-1]), *(("noisy", NOISY, end) for end in ends)]:
        body, poses = estimates(cell, data, signals, slice(200, int(end)))
        gaps = np.array([np.linalg.inv(first @ X) @ X_PE for X, X_PE in zip(poses, grasps, strict=True)])
        distance = 1e3 * np.linalg.norm(gaps[:, :3, 3], axis=1).max()
        turn = np.degrees(Rotation.from_matrix(gaps[:, :3, :3]).magnitude().max())
        centre = 1e3 * float(np.linalg.norm(body.lever - np.linalg.inv(first)[:3, 3]))
        inertia = 100 * float(np.linalg.norm(body.inertia - true) / np.linalg.norm(true))
        fits.append((100 * abs(body.mass / load.mass - 1), inertia))
        if end == ends[-1]:
            numbers += [
                Measured(GRASPS, f"{label}: worst place of a grasp", distance, "mm", most=loose),
                Measured(GRASPS, f"{label}: worst turn of a grasp", turn, "deg", most=loose / 10),
                Measured(MASS, f"{label}: mass off", fits[-1][0], "%", most=loose),
                Measured(MASS, f"{label}: centre off", centre, "mm", most=loose),
                Measured(INERTIA, f"{label}: matrix off", inertia, "%", most=5.0 * loose),
            ]
    seconds, (mass, matrix) = (ends - 200) * cell.clock.period, np.array(fits[1:]).T
    return numbers, [Trace("mass, noisy", seconds, mass), Trace("inertia, noisy", seconds, matrix)]
