"""Identification of payload and grasps by least squares on twists, their derivatives and wrenches."""

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

GRASPS, MASS = "places of the grasps follow from twists", "mass and centre follow from wrenches"
INERTIA = "the inertia follows from wrenches"


def regression(data: Any, wrenches: str, samples: slice) -> tuple[Array, Array, Array]:
    """Return m, m c and I about the first grasp, and places of the grasps and of the centre from it."""

    def rate(x: Array) -> Array:
        return savgol_filter(x, 31, 3, deriv=1, delta=float(data.time[1] - data.time[0]), axis=0)

    tips, w, P = data.tip_position.values, data.payload_twist.values[:, 3:], data.payload_position.values
    F = data[wrenches].values.sum(axis=1)
    rows = [tips[:, k] - tips[:, 0] for k in range(tips.shape[1])] + [P - tips[:, 0]]
    v = rate(tips[:, 0])
    moment = F[:, 3:] + np.cross(rows[-1], F[:, :3])
    body = Rotation.from_quat(data.payload_quaternion.values[samples]).inv()
    world = [
        w,
        rate(v) + np.array([0.0, 0.0, 9.81]),
        rate(w),
        -F[:, :3],
        -moment,
        *(rate(row) for row in rows[1:-1]),
    ]
    w, a, alpha, f, m, *apart = (body.apply(x[samples]) for x in world)
    motions = zip(w, a, alpha, strict=True)
    Y = [pin.bodyRegressor(pin.Motion(0 * w, w), pin.Motion(a, alpha)) for w, a, alpha in motions]
    theta = np.linalg.lstsq(np.concatenate(Y), np.hstack([f, m]).ravel(), rcond=None)[0]
    spin = np.concatenate([pin.skew(one) for one in w])
    places = [np.linalg.lstsq(spin, one.ravel(), rcond=None)[0] for one in apart]
    true = [body.apply(row[samples]).mean(axis=0) for row in rows[1:]]
    return theta, np.array(places) - true[:-1], true[-1]


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Shake the plate, and fit exact wrenches and noisy ones, over ever more seconds."""
    duration, loose = (4.0, 5.0) if short else (10.0, 1.0)
    data = cp.run(cell.override({"duration": duration}), warn=False).data
    numbers, load, ends = [], cell.cell.payload, np.linspace(0.4, 1.0, 10) * (len(data.time) - 200)
    errors: dict[str, Any] = {"mass": [], "inertia": []}
    for label, end in [("exact", ends[-1]), *(("noisy", end) for end in ends)]:
        wrenches = "measured_wrench" if label == "noisy" else "interaction_wrench"
        theta, places, centre = regression(data, wrenches, slice(200, int(end)))
        body = pin.Inertia.FromDynamicParameters(theta)
        mass, off = 100 * abs(body.mass / load.mass - 1), 1e3 * float(np.linalg.norm(body.lever - centre))
        inertia = 100 * np.abs(np.diag(body.inertia) / np.array(load.inertia)[:3] - 1).max()
        if label == "noisy":
            errors = {"mass": [*errors["mass"], mass], "inertia": [*errors["inertia"], inertia]}
        if end == ends[-1]:
            worst = 1e6 * np.abs(places).max()
            numbers += [
                Measured(GRASPS, f"{label}: worst place of a grasp", worst, "um", most=100.0),
                Measured(MASS, f"{label}: mass off", mass, "%", most=1.0),
                Measured(MASS, f"{label}: centre off", off, "mm", most=loose),
                Measured(INERTIA, f"{label}: worst moment of inertia off", inertia, "%", most=loose * 5.0),
            ]
    seconds = (ends - 200) * float(data.time[1])
    return numbers, [Trace(f"{name}, wrists with noise", seconds, np.array(y)) for name, y in errors.items()]
