"""Labelled xarray Dataset of a run, its checksum, and its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from xarray.indexes import PandasIndex

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
    variables = {
        quantity.name: _variable(
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
        variables[name] = _variable(joint, values_of_joints, attributes)
    names = np.array([(*arm, *[""] * (k - len(arm))) for arm in joints])
    variables["joint_name"] = _variable(joint, names, {"long_name": "empty beyond an arm's joints"})
    determined = np.isfinite(samples["interaction_wrench"]).all(axis=(0, 1))
    text = "rows of wrenches that rigid bodies determine; others are NaN"
    variables["wrench_is_determined"] = _variable(("axis",), determined, {"long_name": text})
    labels: dict[str, NDArray[Any]] = {
        "time": samples["time"],
        "arm": np.array(list(scenario.cell.arms)),
        "joint": np.arange(1, k + 1),
        "axis": np.array(AXES),
        "position": np.array(AXES[:3]),
        "quaternion": np.array(("x", "y", "z", "w")),
    }
    coordinates = _coordinates(labels)
    coordinates["time"].attrs["units"] = "s"
    return xr.Dataset(variables, coordinates, {"title": scenario.summary or scenario.name})


def _variable(dims: tuple[str, ...], values: NDArray[Any], attributes: Mapping[str, str]) -> xr.Variable:
    """Return a variable that holds a numpy array as it is: to convert one, xarray imports dask, 0.3 s."""
    return xr.Variable(dims, values, attributes, fastpath=True)


def _coordinates(labels: Mapping[str, NDArray[Any]]) -> xr.Coordinates:
    """Return the coordinates of dimensions with labels, without dask as well."""
    indexes = {dim: PandasIndex(pd.Index(values), dim, values.dtype) for dim, values in labels.items()}
    variables = {dim: index.create_variables()[dim] for dim, index in indexes.items()}
    return xr.Coordinates(variables, indexes)
