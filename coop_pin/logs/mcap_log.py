"""MCAP files of a log (extra ``logs``): JSON and ROS 2 CDR messages, read and written without ROS."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import ArgumentError, FileReadError, needs_extra
from coop_pin.base.spatial import quaternions
from coop_pin.logs.topics import FIELDS, Kind, Topic

_HEADER = "std_msgs/Header header\n"
_VECTOR = "float64 x\nfloat64 y\nfloat64 z"
_LINE = "\n" + "=" * 80 + "\n"
_COMMON = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Vector3": _VECTOR,
    "geometry_msgs/Point": _VECTOR,
    "geometry_msgs/Quaternion": _VECTOR + "\nfloat64 w",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": _HEADER + "string child_frame_id\ngeometry_msgs/Transform transform",
}
"""Definitions of the messages inside others, by the standard of ROS 2."""
_DEFINITIONS = {
    "sensor_msgs/msg/JointState": _HEADER
    + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    "geometry_msgs/msg/WrenchStamped": _HEADER + "geometry_msgs/Wrench wrench",
    "geometry_msgs/msg/PoseStamped": _HEADER + "geometry_msgs/Pose pose",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
_INSIDE = {"WrenchStamped": "wrench", "PoseStamped": "pose"}
"""Field of a message that has its values."""
_TYPES = {name.rpartition("/")[2]: name for name in _DEFINITIONS}


def read_mcap(file: Path, topics: Iterable[str]) -> dict[str, Topic]:
    """Return topics of an MCAP file that has them, in the order of their stamps in the file.

    Args:
        file: the file.
        topics: names of topics.

    Raises:
        FileReadError: it is no MCAP file, or a topic has messages of another kind or encoding.
        MissingExtraError: the extra 'logs' is not installed.
    """
    with needs_extra("mcap-ros2-support", "logs", "to read MCAP files"):
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    messages: dict[str, list[bytes]] = {}
    kinds: dict[str, tuple[Any, Any]] = {}
    try:
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages([*topics]):
                kinds[channel.topic] = schema, channel
                messages.setdefault(channel.topic, []).append(message.data)
    except (McapError, EOFError, struct.error) as error:
        raise FileReadError(f"is no whole MCAP file: {error}", str(file)) from None
    return {name: _topic(*kinds[name], each, file) for name, each in messages.items()}


def _topic(schema: Any, channel: Any, messages: list[bytes], file: Path) -> Topic:
    """Return a topic of its messages."""
    from mcap_ros2.decoder import DecoderFactory  # slow to load

    name = (schema.name if schema else "").rpartition("/")[2].rpartition(".")[2]
    kind = next((kind for kind in FIELDS if kind == name), None)
    if kind is None:
        detail = f"topic {channel.topic!r} has messages {name!r}; they must be {', '.join(FIELDS)}"
        raise FileReadError(detail, str(file))
    if channel.message_encoding == "json":
        return _of_messages(kind, [json.loads(data, object_hook=_Fields) for data in messages])
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    if decode is None:
        detail = f"topic {channel.topic!r} is encoded as {channel.message_encoding!r}; it must be cdr or json"
        raise FileReadError(detail, str(file))
    return _of_equal(kind, decode(messages[0]), messages) or _of_messages(kind, [*map(decode, messages)])


def _of_equal(kind: Kind, first: Any, messages: list[bytes]) -> Topic | None:
    """Return a topic of CDR messages that differ in their numbers alone; None where more differs."""
    known, table = _of_messages(kind, [first]), np.frombuffer(b"".join(messages), dtype=np.uint8)
    if table.size != len(messages[0]) * len(messages):
        return None
    table = table.reshape(len(messages), -1)
    places = _places(known, first)
    stamps, is_same = np.ascontiguousarray(table[:, 4:12]).view("<u4"), np.ones(table.shape[1], dtype=bool)
    for part in (slice(4, 12), *places.values()):
        is_same[part] = False
    if messages[0][1] != 1 or (table[:, is_same] != table[0, is_same]).any():  # 1: little-endian
        return None
    time = stamps[:, 0].astype(np.int32) + 1e-9 * stamps[:, 1]
    values = {field: np.ascontiguousarray(table[:, part]).view("<f8") for field, part in places.items()}
    return known._replace(time=time, values=values)


def _places(known: Topic, first: Any) -> dict[str, slice]:
    """Return the bytes of the numbers in a CDR message: strings and counts are aligned to 4, numbers to 8."""

    def after(at: int, *texts: str) -> int:
        for text in texts:
            at = -(-at // 4) * 4 + 4 + len(text.encode()) + 1
        return at

    at, places, is_counted = after(8, first.header.frame_id), {}, known.kind == "JointState"
    if is_counted:
        at = after(-(-at // 4) * 4 + 4, *known.joints)
    for field in FIELDS[known.kind]:
        at = -(-at // 4) * 4 + 4 if is_counted else at
        if field in known.values:
            at = -(-at // 8) * 8
            places[field] = slice(4 + at, 4 + at + 8 * known.values[field].shape[1])
            at += 8 * known.values[field].shape[1]
    return places


class _Fields(dict[str, Any]):
    """Message whose fields are attributes."""

    __getattr__ = dict.__getitem__


def _of_messages(kind: Kind, messages: list[Any]) -> Topic:
    """Return a topic of its messages."""
    stamps = [message.header.stamp for message in messages]
    time = np.array([stamp.sec for stamp in stamps]) + 1e-9 * np.array([stamp.nanosec for stamp in stamps])
    if kind == "JointState":
        names = tuple(messages[0].name)
        read = {field: [getattr(message, field) for message in messages] for field in FIELDS[kind]}
        of_all = {
            field: values for field, values in read.items() if all(len(x) == len(names) for x in values)
        }
        values = {field: np.array(each, dtype=float) for field, each in of_all.items()}
        return Topic(kind, time, values, names)
    inside = [getattr(message, _INSIDE[kind]) for message in messages]
    values = {
        field: np.array([[getattr(getattr(part, field), axis) for axis in axes] for part in inside])
        for field, axes in FIELDS[kind].items()
    }
    return Topic(kind, time, values)


def write_mcap(
    topics: Mapping[str, Topic], file: Path, *, frames: Mapping[str, tuple[Array, Array]] | None = None
) -> None:
    """Write topics as ROS 2 messages in CDR, and frames as TF.

    Args:
        topics: topics by name.
        file: the file.
        frames: stamps and poses in the world of frames by name, shapes (n,) and (n, 4, 4).

    Raises:
        ArgumentError: stamps are negative, which MCAP does not have.
        MissingExtraError: the extra 'logs' is not installed.
    """
    if (first := min(float(topic.time.min()) for topic in topics.values())) < 0.0:
        raise ArgumentError(f"stamps begin at {first:.3g} s; those of MCAP are not negative")
    write_atomically(file, lambda part: _write(part, topics, frames or {}))


def _write(file: Path, topics: Mapping[str, Topic], frames: Mapping[str, tuple[Array, Array]]) -> None:
    with needs_extra("mcap-ros2-support", "logs", "to write MCAP files"):
        import mcap_ros2.writer as ros2
    entries = [
        (float(time), _TYPES[topic.kind], name, _message(topic, k))
        for name, topic in topics.items()
        for k, time in enumerate(topic.time)
    ]
    for name, (stamps, poses) in frames.items():
        entries += [
            (float(time), _TYPES["TFMessage"], "/tf", {"transforms": [_transform(name, time, X)]})
            for time, X in zip(stamps, poses, strict=True)
        ]
    with file.open("wb") as stream:
        writer: Any = ros2.Writer(stream)
        schemas = {
            name: writer.register_msgdef(name, _text(name)) for name in {entry[1] for entry in entries}
        }
        for time, kind, name, message in sorted(entries, key=lambda entry: entry[0]):
            at = round(time * 1e9)
            writer.write_message(name, schemas[kind], message, log_time=at, publish_time=at)
        writer.finish()


def _text(name: str) -> str:
    """Return the definition of a message with all inside it."""
    inside = "".join(f"{_LINE}MSG: {one}\n{text}" for one, text in _COMMON.items())
    return _DEFINITIONS[name] + inside


def _header(time: float, frame: str) -> dict[str, Any]:
    seconds, nanoseconds = divmod(round(float(time) * 1e9), 10**9)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def _message(topic: Topic, k: int) -> dict[str, Any]:
    """Return a sample as a message."""
    header = {"header": _header(topic.time[k], topic.frame)}
    values = {field: each[k].tolist() for field, each in topic.values.items()}
    if topic.kind == "JointState":
        return (
            header
            | {"name": [*topic.joints]}
            | {field: values.get(field, []) for field in FIELDS["JointState"]}
        )
    inside = {
        field: dict(zip(FIELDS[topic.kind][field], each, strict=True)) for field, each in values.items()
    }
    return header | {_INSIDE[topic.kind]: inside}


def _transform(name: str, time: float, X: Array) -> dict[str, Any]:
    translation, rotation = (
        dict(zip(axes, each.tolist(), strict=False))
        for axes, each in (("xyz", X[:3, 3]), ("xyzw", quaternions(X[None, :3, :3])[0]))
    )
    transform = {"translation": translation, "rotation": rotation}
    return {"header": _header(time, "world"), "child_frame_id": name, "transform": transform}
