"""LeRobot episodes of runs (extra ``lerobot``), in the layout of its version 3: parquet tables and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import ArgumentError, needs_extra
from coop_pin.results.friction import friction_use
from coop_pin.results.run_result import RunResult

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FIRST = _FILE.format(chunk_index=0, file_index=0)
_FILES = (
    "data/chunk_index",
    "data/file_index",
    "meta/episodes/chunk_index",
    "meta/episodes/file_index",
)
"""Places of an episode, all in the first file."""
_INDICES = ("frame_index", "episode_index", "index", "task_index")


class _Episode(NamedTuple):
    """A run as an episode.

    Attributes:
        task: text of what is done.
        rate: rate of its samples, Hz.
        features: shape and names of each feature.
        values: values of each feature, shape (n, k).
        time: time from 0, s, shape (n,).
    """

    task: str
    rate: int
    features: dict[str, Any]
    values: dict[str, Array]
    time: Array


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
        import pandas as pd  # slow to load
        import pyarrow as pa
        from pyarrow import parquet
    episodes = _episodes(results)
    ends = np.cumsum([episode.time.size for episode in episodes])
    tasks = {task: index for index, task in enumerate(dict.fromkeys(episode.task for episode in episodes))}
    columns = _columns(episodes, tasks)
    of_tasks = pd.DataFrame({"task_index": [*tasks.values()]}, index=pd.Index([*tasks], name="task"))
    tables = {
        f"data/{_FIRST}": pa.table({name: _column(pa, values) for name, values in columns.items()}),
        f"meta/episodes/{_FIRST}": pa.Table.from_pylist(_places(episodes, ends)),
        "meta/tasks.parquet": pa.Table.from_pandas(of_tasks),
    }
    texts = {
        "info.json": _info(episodes, int(ends[-1]), len(tasks)),
        "stats.json": {name: _statistics(values) for name, values in columns.items()},
    }
    root = Path(folder)
    for name, table in tables.items():
        write_atomically(root / name, lambda part, table=table: parquet.write_table(table, part))  # type: ignore[misc]
    for name, content in texts.items():
        text = json.dumps(content, indent=1)
        write_atomically(root / "meta" / name, lambda part, text=text: part.write_text(text, "utf-8"))  # type: ignore[misc]
    return int(ends[-1])


def _episodes(results: Iterable[RunResult]) -> list[_Episode]:
    """Return runs as episodes, or refuse those that differ from the first one."""
    episodes = list[_Episode]()
    for number, result in enumerate(results):
        named, time = _features(result), result.data.time.values
        episode = _Episode(
            task=result.scenario.summary or result.scenario.name,
            rate=round(1.0 / float(np.median(np.diff(time)))),
            features={
                name: {"dtype": "float32", "shape": [len(names)], "names": names}
                for name, (names, _) in named.items()
            },
            values={name: values.astype(np.float32) for name, (_, values) in named.items()},
            time=(time - time[0]).astype(np.float32),
        )
        first = episodes[0] if episodes else episode
        if (episode.features, episode.rate) != (first.features, first.rate):
            raise ArgumentError(
                f"run {number} differs from the first one in its features or its rate, {episode.rate} Hz"
            )
        episodes.append(episode)
    if not episodes:
        raise ArgumentError("there is no run; an episode is one")
    return episodes


def _columns(episodes: Sequence[_Episode], tasks: Mapping[str, int]) -> dict[str, Array]:
    """Return the frames of all episodes: features, times and indices."""
    lengths = [episode.time.size for episode in episodes]
    features = {
        name: np.concatenate([episode.values[name] for episode in episodes]) for name in episodes[0].values
    }
    return features | {
        "timestamp": np.concatenate([episode.time for episode in episodes]),
        "frame_index": np.concatenate([np.arange(length) for length in lengths]),
        "episode_index": np.repeat(np.arange(len(episodes)), lengths),
        "index": np.arange(sum(lengths)),
        "task_index": np.repeat([tasks[episode.task] for episode in episodes], lengths),
    }


def _places(episodes: Sequence[_Episode], ends: Array) -> list[dict[str, Any]]:
    """Return where the frames of each episode stand."""
    return [
        {
            "episode_index": number,
            "tasks": [episode.task],
            "length": episode.time.size,
            "dataset_from_index": int(end) - episode.time.size,
            "dataset_to_index": int(end),
            **dict.fromkeys(_FILES, 0),
        }
        for number, (episode, end) in enumerate(zip(episodes, ends, strict=True))
    ]


def _info(episodes: Sequence[_Episode], frames: int, tasks: int) -> dict[str, Any]:
    """Return what a reader of the data set needs to know."""
    scalars = {name: {"dtype": "int64", "shape": [1], "names": None} for name in _INDICES}
    return {
        "codebase_version": "v3.0",
        "robot_type": "coop_pin",
        "total_episodes": len(episodes),
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": episodes[0].rate,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": f"data/{_FILE}",
        "video_path": None,
        "features": episodes[0].features
        | {"timestamp": {"dtype": "float32", "shape": [1], "names": None}}
        | scalars,
    }


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
