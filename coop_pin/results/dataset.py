"""Labelled xarray Dataset of a run, its checksum, and its file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.results.quantities import Samples, computed, quantities

AXES = ["x", "y", "z", "rx", "ry", "rz"]


LIMITS = {
    "position_lower": "rad or m",
    "position_upper": "rad or m",
    "velocity_limit": "rad/s or m/s",
    "torque_limit": "N m",
}
"""Units of the limits of joints and drives, which are variables of the dataset without time."""


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
    table = quantities(scenario)
    values = computed(table, samples, scenario.cell.shares)
    # All variables are gathered first: assigning one to a Dataset aligns the whole Dataset anew.
    variables: dict[str, tuple[Any, ...]] = {
        quantity.name: (
            ("time", *quantity.dims.split()),
            values[quantity.name],
            {"units": quantity.unit, "long_name": quantity.text},
        )
        for quantity in table
        if quantity.stored
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
