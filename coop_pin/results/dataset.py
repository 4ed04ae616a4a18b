"""Labelled xarray Dataset of a run, its checksum, and its file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from xarray.indexes import PandasIndex

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError, suggestion
from coop_pin.base.spatial import internal_wrenches
from coop_pin.base.spatial.grasp_rows import transmits
from coop_pin.base.spatial.internal_wrench import (
    constraint_consistent_internal_wrenches,
    determinate_grasp,
    minimum_norm_internal_wrenches,
    nonsqueezing_internal_wrenches,
    symmetric_internal_wrenches,
    virtual_linkage_internal_wrenches,
)
from coop_pin.description.cell.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.results.energies import WORK_OF_GRASPS
from coop_pin.results.quantities import quantities
from coop_pin.results.quantity import Samples, computed

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

    Args:
        scenario: Scenario that was run.
        samples: Samples of every recorded quantity.
        joints: names of each arm's joints.
        limits: the four ``LIMITS`` of m arms with at most k joints, shape (4, m, k); NaN where there is none.
    """
    values = computed(quantities(scenario), samples, scenario.cell.shares)
    return labelled(scenario, values | without_time(scenario, joints, limits))


def without_time(scenario: Scenario, joints: Sequence[Sequence[str]], limits: Array) -> Samples:
    """Return names and limits of arms and joints by name; arguments as of dataset."""
    k = limits.shape[2]
    names = np.array([(*arm, *[""] * (k - len(arm))) for arm in joints])
    return dict(zip(LIMITS, limits, strict=True)) | {
        "arm": np.array(list(scenario.cell.arms)),
        "joint_name": names,
    }


def labelled(scenario: Scenario, values: Samples) -> xr.Dataset:
    """Return the arrays of a run with dimensions, units and texts.

    Dimensions: time, arm, joint, axis (x, y, z, rx, ry, rz in world axes), position (x, y, z), quaternion
    (x, y, z, w), patch (arms with patches, then tables).

    Args:
        scenario: Scenario that was run.
        values: Samples of all quantities, and what ``without_time`` returns.
    """
    # All variables are gathered first: assigning one to a Dataset aligns the whole Dataset anew.
    variables = {
        quantity.name: _variable(
            ("time", *quantity.dims.split()),
            values[quantity.name],
            {"units": quantity.unit, "long_name": quantity.text},
        )
        for quantity in quantities(scenario, {*WORK_OF_GRASPS} & {*values})
        if quantity.stored
    }
    joint, k = ("arm", "joint"), values["torque"].shape[2]
    for name, unit in LIMITS.items():
        attributes = {"units": unit, "long_name": "NaN where there is none"}
        variables[name] = _variable(joint, values[name], attributes)
    text = "empty beyond an arm's joints"
    variables["joint_name"] = _variable(joint, values["joint_name"], {"long_name": text})
    determined = np.asarray(np.isfinite(values["interaction_wrench"]).all(axis=(0, 1)))
    text = "rows of wrenches that rigid bodies determine; others are NaN"
    variables["wrench_is_determined"] = _variable(("axis",), determined, {"long_name": text})
    labels: dict[str, NDArray[Any]] = {
        "time": values["time"],
        "arm": values["arm"],
        "joint": np.arange(1, k + 1),
        "axis": np.array(AXES),
        "position": np.array(AXES[:3]),
        "quaternion": np.array(("x", "y", "z", "w")),
    }
    if scenario.cell.has_contacts:
        labels["patch"] = np.array([*scenario.cell.patches, *scenario.cell.tables])
    if joints := scenario.cell.driven:
        labels["shared"] = np.array(joints)
    if wheels := scenario.cell.wheels:
        labels["base"] = np.array([*wheels])
    if (links := scenario.cell.payload.links) is not None:
        labels["payload_joint"] = np.array(list(links.start))
    coordinates = _coordinates(labels)
    coordinates["time"].attrs["units"] = "s"
    return xr.Dataset(variables, coordinates, {"title": scenario.caption or scenario.name})


def as_table(data: xr.Dataset) -> pd.DataFrame:
    """Return the samples of a run as a table: a row for each time, a column for each entry of a quantity.

    Names are ``quantity.arm.joint [unit]``, the joints by their names; the limits of joints are left out.

    Args:
        data: data of a run.
    """
    columns = dict[str, NDArray[Any]]()
    for name, variable in data.data_vars.items():
        if variable.dims[:1] != ("time",):
            continue
        dims, units = variable.dims[1:], variable.attrs["units"].split(", ")
        for entry in np.ndindex(variable.shape[1:]):
            at = dict(zip(dims, entry, strict=True))
            labels = {str(dim): str(data[dim].values[index]) for dim, index in at.items()}
            if "joint" in at:
                labels["joint"] = str(data["joint_name"].values[at["arm"], at["joint"]])
            if all(labels.values()):  # a joint that an arm does not have has no name
                unit = units[-1 if at.get("axis", 0) >= len(AXES) // 2 else 0]
                columns[f"{'.'.join([str(name), *labels.values()])} [{unit}]"] = variable.values[:, *entry]
    return pd.DataFrame(columns, pd.Index(data["time"].values, name="time [s]"))


def _variable(dims: tuple[str, ...], values: NDArray[Any], attributes: Mapping[str, str]) -> xr.Variable:
    """Return a variable that holds a numpy array as it is: to convert one, xarray imports dask, 0.3 s."""
    return xr.Variable(dims, values, attributes, fastpath=True)


class _Names(pd.Index):  # type: ignore[misc]
    """Index of names, such as those of the arms, that tells which there are."""

    def get_loc(self, key: Any) -> Any:
        """Return the place of a name.

        Raises:
            ArgumentError: there is none; no KeyError, in whose place xarray would raise one of its own.
        """
        try:
            return super().get_loc(key)
        except KeyError:
            names = self.tolist()
            raise ArgumentError(f"no {key!r} in the result; {suggestion(str(key), names)}") from None


def with_names(data: xr.Dataset) -> xr.Dataset:
    """Return a dataset that was read, with the indexes of names of a new one."""
    names = {str(dim): data[dim].values for dim in data.dims if data[dim].dtype.kind in "OU"}
    return data.assign_coords(_coordinates(names))


def _index(values: NDArray[Any]) -> pd.Index[Any]:
    """Return the index of labels: times and numbers, or names, which pyarrow would turn into its strings."""
    if values.dtype.kind not in "OU":
        return pd.Index(values)
    return _Names._simple_new(pd.Index(values, dtype=object)._values)


def _coordinates(labels: Mapping[str, NDArray[Any]]) -> xr.Coordinates:
    """Return the coordinates of dimensions with labels, without dask as well."""
    indexes = {dim: PandasIndex(_index(values), dim, values.dtype) for dim, values in labels.items()}
    return xr.Coordinates({dim: index.create_variables()[dim] for dim, index in indexes.items()}, indexes)


def internal_wrench_definitions(data: xr.Dataset, cell: Cell) -> xr.Dataset:
    """Return the internal wrench by every definition of the literature, about P in world axes.

    Rows that rigid bodies do not determine count as zero, and the tips then lie in the plane of the others.
    The virtual bodies of the constraint-consistent definition share the payload's mass, and the third of the
    trace of its inertia, by the load shares. Beside joints a definition whose load a grasp does not transmit
    is NaN, with its ``reason``, and ``transmitted`` is the split within what all grasps do.

    Args:
        data: data of a run.
        cell: cell of the run.

    Raises:
        ArgumentError: an arm has a tool.
    """
    if cell.tools:
        raise ArgumentError(
            f"definitions are of arms that all hold, and the tips of {[*cell.tools]} are tools"
        )
    r = data["tip_position"].values - data["payload_position"].values[:, None]
    is_determined, c = data["wrench_is_determined"].values, cell.shares
    F, r = determinate_grasp(data["interaction_wrench"].values, r)
    masses, inertias = c * cell.payload.mass, c * float(np.trace(cell.payload.inertia_matrix)) / 3.0
    definitions: dict[str, Callable[[Array, Array], Array]] = {
        "load_shares": lambda F, _: internal_wrenches(F, c),
        "minimum_norm": minimum_norm_internal_wrenches,
        "nonsqueezing": nonsqueezing_internal_wrenches,
        "virtual_linkage": virtual_linkage_internal_wrenches,
        "constraint_consistent": lambda F, r: constraint_consistent_internal_wrenches(F, r, masses, inertias),
    }
    if F.shape[1] == 2:
        definitions["symmetric"] = lambda F, _: symmetric_internal_wrenches(F)
    dims, labelled = data["interaction_wrench"].dims, dict[str, Any]()
    for name, definition in definitions.items():
        arms = _not_transmitting(definition, cell)
        values = np.full(F.shape, np.nan) if arms else definition(F, r)
        reason = (
            {"reason": f"the grasps of {arms} do not transmit the load that it gives them"} if arms else {}
        )
        labelled[name] = (dims, np.where(is_determined, values, np.nan), reason)
    if cell.splits_load:
        labelled["transmitted"] = (dims, data["internal_wrench"].values)
    return type(data)(labelled, {dim: data[dim] for dim in dims}, {"units": "N, N m"})


def _not_transmitting(definition: Callable[[Array, Array], Array], cell: Cell) -> list[str]:
    """Return the arms whose grasps do not transmit the load part of a definition; none without joints.

    The load parts depend on the resultant alone: those of a unit of each task row are looked at.
    """
    if not cell.jointed:
        return []
    rows, m = list(cell.task_rows.indices), len(cell.arms)
    F = np.tile(np.eye(6)[rows][:, None] / m, (1, m, 1))
    tips = np.array([grasp.xyz for grasp in cell.grasps.values()])
    tips[:, [row for row in range(3) if row not in rows]] = 0.0
    loads = (F - definition(F, np.broadcast_to(tips, (len(rows), m, 3))))[..., rows]
    return [
        name
        for index, (name, B) in enumerate(zip(cell.arms, cell.transmitted(), strict=True))
        if not transmits(B, loads[:, index].T)
    ]
