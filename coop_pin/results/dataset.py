"""Quantities of a run, declared in one table, and the labelled xarray Dataset that holds them.

``QUANTITIES`` gives every quantity its name, dimensions, unit, meaning and source. The recorder allocates its
arrays by the table and the dataset is labelled by it; snapshots, metrics and figures read what it computes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.spatial import internal_wrenches, rotate_vector6

Samples: TypeAlias = dict[str, NDArray[Any]]
"""Arrays by names of quantities, n samples along the first axis; ``load_share`` holds the c_i, shape (m,)."""

AXES = ["x", "y", "z", "rx", "ry", "rz"]


class Quantity(NamedTuple):
    """A quantity of a run.

    Attributes:
        name: of its samples, and of its variable in the dataset.
        dims: its dimensions after time, separated by blanks.
        unit: several where entries differ: of linear, then of angular ones.
        text: what it is; the variable's ``long_name``.
        source: computes it from the samples of quantities above it; None where it is recorded at every tick.
        fill: value where nothing is recorded, for example beyond the joints of an arm.
        stored: whether it is a variable of the dataset; the others serve to compute such variables.
    """

    name: str
    dims: str
    unit: str
    text: str
    source: Callable[[Samples], Array] | None = None
    fill: float | bool = np.nan
    stored: bool = True


def _quaternions(poses: Array) -> Array:
    return Rotation.from_matrix(poses[:, :3, :3]).as_quat()


def _pose_errors(X: Array, X_d: Array) -> Array:
    """Return ``[p - p_d, log(R R_d^T)]`` of every sample, shape (n, 6)."""
    rotation = Rotation.from_matrix(X[:, :3, :3] @ np.swapaxes(X_d[:, :3, :3], 1, 2)).as_rotvec()
    return np.concatenate((X[:, :3, 3] - X_d[:, :3, 3], rotation), axis=1)


def _axial_directions(tips: Array) -> Array:
    """Return unit vectors from each tip to the middle of the other tips, shape (n, m, 3); NaN for one arm."""
    if tips.shape[1] == 1:
        return np.full_like(tips, np.nan)
    others = (tips.sum(axis=1, keepdims=True) - tips) / (tips.shape[1] - 1)
    line = others - tips
    length = np.linalg.norm(line, axis=2, keepdims=True)
    return np.divide(line, length, out=np.full_like(line, np.nan), where=length > 0.0)


def _internal_parts(name: str, text: str, wrench: Callable[[Samples], Array]) -> tuple[Quantity, ...]:
    """Return axial force, shear force and moment of a wrench on each arm, such as ``internal_axial``.

    Rows that rigid bodies do not determine count as zero.

    Args:
        name: of the quantities, with {} for the part.
        text: what the wrench is.
        wrench: shape (n, m, 6).
    """

    def axial(s: Samples) -> Array:
        return np.einsum("nmi,nmi->nm", np.nan_to_num(wrench(s))[..., :3], s["axial_direction"])

    def shear(s: Samples) -> Array:
        across = np.nan_to_num(wrench(s))[..., :3] - axial(s)[..., None] * s["axial_direction"]
        return np.linalg.norm(across, axis=2)

    def moment(s: Samples) -> Array:
        return np.linalg.norm(np.nan_to_num(wrench(s))[..., 3:], axis=2)

    return (
        Quantity(name.format("axial"), "arm", "N", f"{text}: force along axial_direction", axial),
        Quantity(name.format("shear"), "arm", "N", f"{text}: force across axial_direction, norm", shear),
        Quantity(name.format("moment"), "arm", "N m", f"{text}: moment about P, norm", moment),
    )


# fmt: off
QUANTITIES = (
    Quantity("time", "", "s", "time of the tick; a coordinate of the dataset", stored=False),
    Quantity("payload_pose", "row column", "1, m", "X_WP", stored=False),
    Quantity("desired_pose", "row column", "1, m", "X_WP_d", stored=False),
    Quantity("desired_squeeze", "arm axis", "N, N m", "f_d_i in payload axes", stored=False),
    Quantity("configuration", "q", "rad or m", "configuration of the Pinocchio tree"),
    Quantity("velocity", "v", "rad/s or m/s", "velocity of the Pinocchio tree"),
    Quantity("payload_position", "position", "m", "position of P", lambda s: s["payload_pose"][:, :3, 3]),
    Quantity("payload_quaternion", "quaternion", "1", "orientation of P",
             lambda s: _quaternions(s["payload_pose"])),
    Quantity("payload_twist", "axis", "m/s, rad/s", "V_WP"),
    Quantity("desired_position", "position", "m", "desired position of P",
             lambda s: s["desired_pose"][:, :3, 3]),
    Quantity("desired_quaternion", "quaternion", "1", "desired orientation of P",
             lambda s: _quaternions(s["desired_pose"])),
    Quantity("desired_twist", "axis", "m/s, rad/s", "V_WP_d"),
    Quantity("pose_error", "axis", "m, rad", "actual minus desired pose",
             lambda s: _pose_errors(s["payload_pose"], s["desired_pose"])),
    Quantity("tip_position", "arm position", "m", "position of each tip"),
    Quantity("drive_velocity", "arm joint", "rad/s", "velocities of the drives"),
    Quantity("joint_position", "arm joint", "rad or m", "joint positions; continuous ones count full turns"),
    Quantity("joint_velocity", "arm joint", "rad/s or m/s", "joint velocities"),
    Quantity("torque", "arm joint", "N m", "drive torques that act at the tick"),
    Quantity("commanded_torque", "arm joint", "N m", "drive torques that the controller asked for"),
    Quantity("saturated", "arm joint", "1", "whether the torque was cut at its limit", fill=False),
    Quantity("interaction_wrench", "arm axis", "N, N m", "F_i on the arm by the payload, about P"),
    Quantity("internal_wrench", "arm axis", "N, N m", "f_i = F_i - c_i sum_j F_j",
             lambda s: internal_wrenches(s["interaction_wrench"], s["load_share"])),
    Quantity("desired_internal_wrench", "arm axis", "N, N m", "f_d_i turned by the payload",
             lambda s: rotate_vector6(s["payload_pose"][:, None, :3, :3], s["desired_squeeze"])),
    Quantity("axial_direction", "arm position", "1", "unit vector from tip to middle of the other tips",
             lambda s: _axial_directions(s["tip_position"])),
    *_internal_parts("internal_{}", "internal wrench", lambda s: s["internal_wrench"]),
    *_internal_parts("desired_internal_{}", "desired internal wrench",
                     lambda s: s["desired_internal_wrench"]),
    *_internal_parts("internal_{}_error", "error of the internal wrench",
                     lambda s: s["internal_wrench"] - s["desired_internal_wrench"]),
    Quantity("external_wrench", "axis", "N, N m", "on the payload, about P"),
    Quantity("closure_distance", "arm", "m", "closure error: distance from tip to grasp"),
    Quantity("closure_angle", "arm", "rad", "closure error: angle from tip to grasp"),
    Quantity("jacobian_condition", "arm", "1", "condition number of the payload Jacobian"),
    Quantity("kinetic_energy", "", "J", "of arms and payload"),
    Quantity("potential_energy", "", "J", "of arms and payload"),
    Quantity("work_actuation", "", "J", "done by the drives since the start"),
    Quantity("work_friction", "", "J", "done by joint friction since the start"),
    Quantity("work_external", "", "J", "done by external wrenches since the start"),
    Quantity("work_payload_change", "", "J", "energy added by payload changes since the start"),
)
# fmt: on

_FIXED_SIZES = {"axis": 6, "position": 3, "quaternion": 4, "row": 4, "column": 4}

LIMITS = {
    "position_lower": "rad or m",
    "position_upper": "rad or m",
    "velocity_limit": "rad/s or m/s",
    "torque_limit": "N m",
}
"""Units of the limits of joints and drives, which are variables of the dataset without time."""


def bytes_per_sample(sizes: Mapping[str, int]) -> int:
    """Return the memory that one sample takes in a finished run, bytes.

    Stored quantities count twice: their netCDF file is made in memory.

    Args:
        sizes: of the dimensions q, v, arm and joint.
    """
    sizes = {**_FIXED_SIZES, **sizes}
    return sum(
        8 * (1 + quantity.stored) * math.prod(sizes[dim] for dim in quantity.dims.split())
        for quantity in QUANTITIES
    )


def allocate(count: int, sizes: Mapping[str, int]) -> Samples:
    """Return empty samples of every recorded quantity.

    Args:
        count: of samples.
        sizes: of the dimensions q, v, arm and joint.
    """
    sizes = {**_FIXED_SIZES, **sizes}
    return {
        quantity.name: np.full((count, *(sizes[dim] for dim in quantity.dims.split())), quantity.fill)
        for quantity in QUANTITIES
        if quantity.source is None
    }


def computed(samples: Samples, load_shares: Array, names: Collection[str] | None = None) -> Samples:
    """Return samples with the computed quantities added.

    Args:
        samples: of every recorded quantity.
        load_shares: c_i, shape (m,).
        names: of the quantities to add, without those that need another; None for all.
    """
    values = samples | {"load_share": load_shares}
    for quantity in QUANTITIES:
        if quantity.source is not None and (names is None or quantity.name in names):
            values[quantity.name] = quantity.source(values)
    return values


def dataset(
    scenario: Scenario, samples: Samples, joints: Sequence[Sequence[str]], limits: Array
) -> xr.Dataset:
    """Return the labelled arrays of a run: every stored quantity, and the joint limits.

    Dimensions: time, arm, joint, axis (x, y, z, rx, ry, rz in world axes), position (x, y, z), quaternion
    (x, y, z, w).

    Args:
        scenario: what was run.
        samples: of every recorded quantity.
        joints: names of each arm's joints.
        limits: the four ``LIMITS`` of m arms with at most k joints, shape (4, m, k); NaN where there is none.
    """
    values = computed(samples, scenario.cell.shares)
    # All variables are gathered first: assigning one to a Dataset aligns the whole Dataset anew.
    variables: dict[str, tuple[Any, ...]] = {
        name: (("time", *dims.split()), values[name], {"units": unit, "long_name": text})
        for name, dims, unit, text, _, _, stored in QUANTITIES
        if stored
    }
    joint, k = ("arm", "joint"), samples["torque"].shape[2]
    for name, values_of_joints in zip(LIMITS, limits, strict=True):
        attributes = {"units": LIMITS[name], "long_name": "NaN where there is none"}
        variables[name] = (joint, values_of_joints, attributes)
    names = np.array([(*arm, *[""] * (k - len(arm))) for arm in joints])
    variables["joint_name"] = (joint, names, {"long_name": "empty beyond an arm's joints"})
    determined = np.isfinite(samples["interaction_wrench"]).all(axis=(0, 1))
    text = "rows of wrenches that rigid bodies determine; others are NaN"
    variables["wrench_is_determined"] = ("axis", determined, {"long_name": text})
    coordinates = {
        "time": ("time", samples["time"], {"units": "s"}),
        "arm": list(scenario.cell.arms),
        "joint": np.arange(1, k + 1),
        "axis": AXES,
        "position": AXES[:3],
        "quaternion": ["x", "y", "z", "w"],
    }
    return xr.Dataset(variables, coordinates, {"title": scenario.summary or scenario.name})
