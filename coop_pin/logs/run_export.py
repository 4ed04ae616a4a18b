"""MCAP file of a run: what ROS and Foxglove show of it, with the internal wrench of every arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, typed
from coop_pin.logs.mcap_log import write_mcap
from coop_pin.logs.record import Record, at_tip, poses_of
from coop_pin.logs.topics import Topic
from coop_pin.model.cell_model import CellModel
from coop_pin.results.run_result import RunResult


@typed
def write_run(result: RunResult, file: str | Path) -> None:
    """Write joint states, wrenches, the internal wrench in axes of P, desired pose and TF of a run as MCAP.

    Args:
        result: run, finished or not.
        file: the file.

    Raises:
        MissingExtraError: the extra 'logs' is not installed.
    """
    data, scenario = result.data, result.scenario
    topics = Record.of_run(result).topics(scenario)
    time, X_WP = data.time.values, poses_of(data.payload_position.values, data.payload_quaternion.values)
    frames = {"payload": (time, X_WP)} | {name: (time, X) for name, X in _tips(result).items()}
    for name in scenario.cell.arms:
        internal = at_tip(np.nan_to_num(data.internal_wrench.sel(arm=name).values), X_WP, np.eye(4))
        values = {"force": internal[:, :3], "torque": internal[:, 3:]}
        topics[f"/{name}/internal_wrench"] = Topic("WrenchStamped", time, values, frame="payload")
    write_mcap(topics, Path(file), frames=frames)


def _tips(result: RunResult) -> dict[str, Array]:
    """Return poses of the tips by the joints of a run, wherever grasps let them be, shape (n, 4, 4) each."""
    tree, q = CellModel(result.scenario.cell, result.scenario.plant.payload), result.data.configuration.values
    data, tips = tree.model.createData(), {f"{arm.name}/tip": np.empty((len(q), 4, 4)) for arm in tree.arms}
    for k, configuration in enumerate(q):
        pin.framesForwardKinematics(tree.model, data, configuration)
        for arm, poses in zip(tree.arms, tips.values(), strict=True):
            poses[k] = data.oMf[arm.tip].homogeneous
    return tips
