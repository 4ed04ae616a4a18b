"""Samples of a run as an xarray Dataset: named axes, units as attributes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array, Mask
from coop_pin.description.scenario import Scenario
from coop_pin.results.metrics import LimitTable
from coop_pin.spatial import internal_wrenches, rotate_vector6


class RunSamples(NamedTuple):
    """Samples of a run at its n ticks; m arms, at most k joints each. Torques and wrenches hold from the tick on.

    Attributes:
        time: s, shape (n,).
        configuration: q of the tree, shape (n, nq).
        velocity: v of the tree, shape (n, nv).
        payload_pose: X_WP, shape (n, 4, 4).
        payload_twist: V_WP, shape (n, 6).
        desired_pose: X_WP_d, shape (n, 4, 4).
        desired_twist: V_WP_d, shape (n, 6).
        desired_squeeze: f_d in payload axes, shape (n, m, 6).
        tip_position: m, shape (n, m, 3).
        drive_velocity: rad/s, shape (n, m, k); NaN beyond an arm's joints.
        torque: drive torques as applied, N m, shape (n, m, k); NaN beyond an arm's joints.
        commanded_torque: drive torques before saturation, likewise.
        saturated: whether a torque was cut at its limit, shape (n, m, k).
        joint_position: joint angles, rad or m, shape (n, m, k); NaN beyond an arm's joints.
        joint_velocity: joint rates, likewise.
        interaction_wrench: on each arm by the payload, about P in world axes; NaN in rows that rigid bodies
            do not determine, shape (n, m, 6).
        external_wrench: on the payload, about P in world axes, shape (n, 6).
        closure_error: distance and angle of each grasp, m and rad, shape (n, m, 2).
        jacobian_condition: of each payload Jacobian, shape (n, m).
        energy: kinetic and potential, J, shape (n, 2).
        work: of actuation, friction, external wrenches and payload changes so far, J, shape (n, 4).
    """

    time: Array
    configuration: Array
    velocity: Array
    payload_pose: Array
    payload_twist: Array
    desired_pose: Array
    desired_twist: Array
    desired_squeeze: Array
    tip_position: Array
    drive_velocity: Array
    torque: Array
    commanded_torque: Array
    saturated: Mask
    joint_position: Array
    joint_velocity: Array
    interaction_wrench: Array
    external_wrench: Array
    closure_error: Array
    jacobian_condition: Array
    energy: Array
    work: Array

    def first(self, count: int) -> RunSamples:
        """Return the first samples alone."""
        return RunSamples(**{name: array[:count] for name, array in self._asdict().items()})


AXES = ["x", "y", "z", "rx", "ry", "rz"]
_POSITION = AXES[:3]


def dataset(scenario: Scenario, samples: RunSamples, limits: LimitTable) -> xr.Dataset:
    """Return the labelled arrays of a run, errors, internal wrenches and joint limits included.

    Dimensions: time, arm, joint, axis (x, y, z, rx, ry, rz in world axes), position (x, y, z), quaternion (x,
    y, z, w).
    """
    internal = internal_wrenches(samples.interaction_wrench, scenario.cell.shares)
    desired_internal = rotate_vector6(samples.payload_pose[:, None, :3, :3], samples.desired_squeeze)
    variables: dict[
        str, tuple[Any, ...]
    ] = {}  # gathered first: every later assignment would align the whole dataset anew
    for name, dims, values, unit, text in (
        ("configuration", "q", samples.configuration, "rad or m", "configuration of the Pinocchio tree"),
        ("velocity", "v", samples.velocity, "rad/s or m/s", "velocity of the Pinocchio tree"),
        ("payload_position", "position", samples.payload_pose[:, :3, 3], "m", "position of P"),
        ("payload_quaternion", "quaternion", _quaternions(samples.payload_pose), "1", "orientation of P"),
        ("payload_twist", "axis", samples.payload_twist, "m/s, rad/s", "V_WP"),
        ("desired_position", "position", samples.desired_pose[:, :3, 3], "m", "desired position of P"),
        (
            "desired_quaternion",
            "quaternion",
            _quaternions(samples.desired_pose),
            "1",
            "desired orientation of P",
        ),
        ("desired_twist", "axis", samples.desired_twist, "m/s, rad/s", "V_WP_d"),
        ("pose_error", "axis", _pose_errors(samples), "m, rad", "actual minus desired pose"),
        ("tip_position", "arm position", samples.tip_position, "m", "position of each tip"),
        ("drive_velocity", "arm joint", samples.drive_velocity, "rad/s", "drive rates"),
        (
            "joint_position",
            "arm joint",
            samples.joint_position,
            "rad or m",
            "joint angles; continuous joints count on over full turns",
        ),
        ("joint_velocity", "arm joint", samples.joint_velocity, "rad/s or m/s", "joint rates"),
        ("torque", "arm joint", samples.torque, "N m", "drive torques applied from the tick on"),
        ("commanded_torque", "arm joint", samples.commanded_torque, "N m", "drive torques before saturation"),
        ("saturated", "arm joint", samples.saturated, "1", "whether the torque was cut at its limit"),
        (
            "interaction_wrench",
            "arm axis",
            samples.interaction_wrench,
            "N, N m",
            "on the arm by the payload, about P",
        ),
        ("internal_wrench", "arm axis", internal, "N, N m", "f_i = F_i - c_i sum_j F_j"),
        ("desired_internal_wrench", "arm axis", desired_internal, "N, N m", "f_d_i turned by the payload"),
        ("external_wrench", "axis", samples.external_wrench, "N, N m", "on the payload, about P"),
        ("closure_distance", "arm", samples.closure_error[..., 0], "m", "tip to grasp"),
        ("closure_angle", "arm", samples.closure_error[..., 1], "rad", "tip to grasp"),
        (
            "jacobian_condition",
            "arm",
            samples.jacobian_condition,
            "1",
            "condition number of the payload Jacobian",
        ),
        ("kinetic_energy", "", samples.energy[:, 0], "J", "of arms and payload"),
        ("potential_energy", "", samples.energy[:, 1], "J", "of arms and payload"),
        ("work_actuation", "", samples.work[:, 0], "J", "done by the drives since the start"),
        ("work_friction", "", samples.work[:, 1], "J", "done by joint friction since the start"),
        ("work_external", "", samples.work[:, 2], "J", "done by external wrenches since the start"),
        ("work_payload_change", "", samples.work[:, 3], "J", "energy brought or taken by payload changes"),
    ):
        variables[name] = (("time", *dims.split()), values, {"units": unit, "long_name": text})
    for name, values, unit in (
        ("position_lower", limits.position_lower, "rad or m"),
        ("position_upper", limits.position_upper, "rad or m"),
        ("velocity_limit", limits.velocity_limit, "rad/s or m/s"),
        ("torque_limit", limits.torque_limit, "N m"),
    ):
        variables[name] = (("arm", "joint"), values, {"units": unit, "long_name": "NaN where there is none"})
    names = [(*joints, *[""] * (samples.torque.shape[2] - len(joints))) for joints in limits.joints]
    variables["joint_name"] = (
        ("arm", "joint"),
        np.array(names),
        {"long_name": "empty beyond an arm's joints"},
    )
    determined = np.isfinite(samples.interaction_wrench).all(axis=(0, 1))
    variables["wrench_is_determined"] = (
        "axis",
        determined,
        {"long_name": "rows of wrenches that rigid bodies determine; others are NaN"},
    )
    attributes = {"title": scenario.summary or scenario.name}
    return xr.Dataset(variables, coords=_coordinates(scenario, samples), attrs=attributes)


def _coordinates(scenario: Scenario, samples: RunSamples) -> dict[str, object]:
    joints = samples.torque.shape[2]
    return {
        "time": ("time", samples.time, {"units": "s"}),
        "arm": list(scenario.cell.arms),
        "joint": np.arange(1, joints + 1),
        "axis": AXES,
        "position": _POSITION,
        "quaternion": ["x", "y", "z", "w"],
    }


def _quaternions(poses: Array) -> Array:
    return Rotation.from_matrix(poses[:, :3, :3]).as_quat()


def _pose_errors(samples: RunSamples) -> Array:
    """Return ``[p - p_d, log(R R_d^T)]`` of every sample, shape (n, 6)."""
    R, R_d = samples.payload_pose[:, :3, :3], samples.desired_pose[:, :3, :3]
    rotation = Rotation.from_matrix(R @ np.swapaxes(R_d, 1, 2)).as_rotvec()
    return np.concatenate((samples.payload_pose[:, :3, 3] - samples.desired_pose[:, :3, 3], rotation), axis=1)
