"""Least distances of a run: from its recorded configurations, as further variables of its dataset."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.spatial import rotations
from coop_pin.feasibility.cell_distances import CellDistances
from coop_pin.feasibility.distances import Distances, measured
from coop_pin.model.cell_model import CellModel
from coop_pin.results.run_result import RunResult


@typed
def recorded_distances(result: RunResult) -> Distances:
    """Return the least distances between arms, payload and tables at every sample of a run.

    Args:
        result: the run.

    Raises:
        UrdfError, NameNotFoundError: an arm cannot be built.
    """
    scenario, data = result.scenario, result.data
    slots = CellModel(scenario.cell, scenario.plant.payload).arms
    arms = [[q[slot.q_slice] for slot in slots] for q in data["configuration"].values]
    turns = rotations(data["payload_quaternion"].values)
    payload = np.zeros((len(turns), 4, 4))
    payload[:, :3, :3], payload[:, :3, 3], payload[:, 3, 3] = turns, data["payload_position"].values, 1.0
    shared = list(data["shared_position"].values) if scenario.cell.driven else None
    links = None if scenario.cell.payload.links is None else list(data["payload_joint_position"].values)
    bodies, times = CellDistances(scenario.cell), data["time"].values
    return measured(scenario, bodies, times, arms, list(payload), shared, links)


@typed
def with_distances(result: RunResult) -> RunResult:
    """Return a run with ``least_distance``, ``nearest_points`` and ``nearest_bodies`` at every sample.

    Args:
        result: the run, which stays as it is.

    Raises:
        UrdfError, NameNotFoundError: an arm cannot be built.
    """
    along = recorded_distances(result)
    columns = {
        "least_distance": (("time",), along.least, {"units": "m"}),
        "nearest_points": (("time", "end", "position"), along.points, {"units": "m"}),
        "nearest_bodies": (("time", "end"), np.array(along.pairs, dtype=str), {}),
    }
    return RunResult(result.scenario, result.data.assign(columns))
