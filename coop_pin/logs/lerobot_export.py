"""LeRobot episodes of runs (extra ``lerobot``), in the layout of its version 3: parquet tables and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import ArgumentError, needs_extra
from coop_pin.results.friction import friction_use
from coop_pin.results.run_result import RunResult

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FIRST = _FILE.format(chunk_index=0, file_index=0)
_INDICES = ("frame_index", "episode_index", "index", "task_index")


@typed
def write_episodes(results: Iterable[RunResult], folder: str | Path) -> int:
    """Write runs as episodes of one data set, and return its number of frames.

    State is position and velocity of the joints, action the commanded torques; internal wrench, load share
    and, where arms have pads, slip margin are features of their own. Joints beyond an arm's count as zero.

    Args:
        results: runs of the same arms with the same times of ticks.
        folder: folder of the data set; files in it are replaced.

    Raises:
        ArgumentError: there is no run, or runs differ in their features or in the rate of their samples.
        MissingExtraError: the extra 'lerobot' is not installed.
    """
    with needs_extra("pyarrow", "lerobot", "to write LeRobot episodes"):
        import pyarrow as pa
        from pyarrow import parquet
    root, tables, episodes, tasks = (
        Path(folder),
        list[dict[str, Array]](),
        list[dict[str, Any]](),
        dict[str, int](),
    )
    features: dict[str, Any] = {}
    rate, total = 0, 0
    for number, result in enumerate(results):
        named = _features(result)
        shapes = {
            name: {"dtype": "float32", "shape": [len(names)], "names": names}
            for name, (names, _) in named.items()
        }
        time = result.data.time.values
        own_rate = round(1.0 / float(np.median(np.diff(time))))
        if features and (shapes != features or own_rate != rate):
            raise ArgumentError(
                f"run {number} differs from the first one in its features or its rate, {own_rate} Hz"
            )
        features, rate, n = shapes, own_rate, len(time)
        task = result.scenario.summary or result.scenario.name
        index = {
            "timestamp": (time - time[0]).astype(np.float32),
            "frame_index": np.arange(n),
            "episode_index": np.full(n, number),
            "index": total + np.arange(n),
            "task_index": np.full(n, tasks.setdefault(task, len(tasks))),
        }
        tables.append({name: values.astype(np.float32) for name, (_, values) in named.items()} | index)
        places = {
            "data/chunk_index": 0,
            "data/file_index": 0,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        span = {"dataset_from_index": total, "dataset_to_index": total + n}
        episodes.append({"episode_index": number, "tasks": [task], "length": n, **span, **places})
        total += n
    if not tables:
        raise ArgumentError("there is no run; an episode is one")
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    frames = pa.table({name: _column(pa, values) for name, values in columns.items()})
    scalars = {name: {"dtype": "int64", "shape": [1], "names": None} for name in _INDICES}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "coop_pin",
        "total_episodes": len(episodes),
        "total_frames": total,
        "total_tasks": len(tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": f"data/{_FILE}",
        "video_path": None,
        "features": features | {"timestamp": {"dtype": "float32", "shape": [1], "names": None}} | scalars,
    }
    of_tasks = pa.table({"task_index": [*tasks.values()], "task": [*tasks]})
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": [], "pandas_version": "2.0.0"}
    of_tasks = of_tasks.replace_schema_metadata({"pandas": json.dumps(pandas)})
    for name, table in {
        f"data/{_FIRST}": frames,
        f"meta/episodes/{_FIRST}": pa.Table.from_pylist(episodes),
        "meta/tasks.parquet": of_tasks,
    }.items():
        write_atomically(root / name, lambda part, table=table: parquet.write_table(table, part))  # type: ignore[misc]
    for name, content in {
        "info.json": info,
        "stats.json": {k: _statistics(v) for k, v in columns.items()},
    }.items():
        text = json.dumps(content, indent=1)
        write_atomically(root / "meta" / name, lambda part, text=text: part.write_text(text, "utf-8"))  # type: ignore[misc]
    return total


def _features(result: RunResult) -> dict[str, tuple[list[str], Array]]:
    """Return names and values of the features of a run, shape (n, k) each."""
    data, cell = result.data, result.scenario.cell
    arms, n = [*cell.arms], data.time.size
    joints = [
        f"{arm}/{joint}"
        for arm, names in zip(arms, data.joint_name.values, strict=True)
        for joint in names
        if joint
    ]
    has_joint = data.joint_name.values != ""

    def of_joints(name: str) -> Array:
        return np.nan_to_num(data[name].values[:, has_joint])

    axes = [f"{arm}/{axis}" for arm in arms for axis in data.axis.values]
    share = data["load_share"].values if "load_share" in data else np.tile(cell.shares, (n, 1))
    both = np.hstack((of_joints("joint_position"), of_joints("joint_velocity")))
    internal = np.nan_to_num(data.internal_wrench.values).reshape(n, -1)
    features = {
        "observation.state": (
            [f"{joint}.{part}" for part in ("position", "velocity") for joint in joints],
            both,
        ),
        "action": (joints, of_joints("commanded_torque")),
        "observation.internal_wrench": (axes, internal),
        "observation.load_share": (arms, share),
    }
    if cell.padded:
        use = friction_use(result.arrays, cell)
        features["observation.slip_margin"] = ([*use.arms], np.nan_to_num(1.0 - use.used, neginf=-1.0))
    return features


def _column(pa: Any, values: Array) -> Any:
    """Return a column: numbers, or rows of them."""
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _statistics(values: Array) -> dict[str, list[float]]:
    """Return the statistics of a feature that training normalises with."""
    rows = values.reshape(len(values), -1)
    names = ("mean", "std", "min", "max")
    by_name = {name: getattr(rows, name)(axis=0).astype(float).tolist() for name in names}
    return by_name | {"count": [len(rows)]}
