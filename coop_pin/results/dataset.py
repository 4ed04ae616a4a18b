"""Labelled xarray Dataset of a run, its checksum, and its file."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.errors import FileReadError
from coop_pin.results.quantities import Samples, computed, quantities
from coop_pin.user_files import read_user_file

_MAX_BYTES = 2**32
"""Size limit of a result; one hour of two arms at 80 Hz has 0.4 GB."""
_SLACK_BYTES = 2**20

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


def content_digest(data: xr.Dataset) -> str:
    """Return the SHA-256 of all names, dimensions, types, values and attributes of a dataset."""
    digest = hashlib.sha256(_attributes(data.attrs))
    for name in sorted(map(str, data.variables)):
        variable = data.variables[name]
        values = np.ascontiguousarray(variable.values)
        is_text = values.dtype.kind in "OUT"
        kind = "text" if is_text else values.dtype.newbyteorder("=").str
        digest.update(json.dumps([name, variable.dims, values.shape, kind]).encode())
        digest.update(_attributes(variable.attrs))
        digest.update(json.dumps(values.astype(str).tolist()).encode() if is_text else values.tobytes())
    return digest.hexdigest()


def _attributes(attributes: Mapping[Hashable, Any]) -> bytes:
    texts = {str(name): str(np.asarray(value).tolist()) for name, value in attributes.items()}
    return json.dumps(texts, sort_keys=True).encode()


def read_dataset(path: Path) -> tuple[xr.Dataset, str]:
    """Return the arrays of a file and the text of its scenario if both are those that were saved."""
    content = read_user_file(path, limit=_MAX_BYTES, kind="a result")
    try:
        with xr.open_dataset(io.BytesIO(content), engine="h5netcdf") as file:
            # Results are not compressed: only a foreign file unpacks to more than it has.
            size = file.nbytes
            data = file.load() if size <= 4 * len(content) + _SLACK_BYTES else xr.Dataset()
    # The errors of xarray, h5netcdf and h5py have no common base class.
    except Exception as error:
        raise FileReadError(
            f"{path} cannot be read as netCDF ({error}); it is damaged, or is not the result.nc of a run"
        ) from None
    text = data.attrs.get("coop_pin_scenario")
    if not isinstance(text, str):
        raise FileReadError(f"{path} holds no coop_pin scenario; it was not written by coop_pin")
    digest = data.attrs.pop("coop_pin_sha256", "missing")
    if digest != content_digest(data):
        raise FileReadError(
            f"{path} is damaged, changed or of another version of coop_pin: its checksum is {digest}; run its"
            " scenario again"
        )
    del data.attrs["coop_pin_scenario"]
    return data, text
