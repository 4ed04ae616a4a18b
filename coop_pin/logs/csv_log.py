"""CSV files of a log: a column "time", and columns TOPIC.FIELD.COMPONENT, such as /left/wrench.force.x."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import FileReadError
from coop_pin.logs.topics import FIELDS, Kind, Topic


def read_csv(file: Path, topics: Iterable[str], second: float = 1.0) -> dict[str, Topic]:
    """Return topics of a CSV file that has them.

    A cell may be empty where a topic has no sample at a time. A column TOPIC.stamp is the topic's own clock.

    Args:
        file: the file.
        topics: names of topics.
        second: unit of its times, s.

    Raises:
        FileReadError: it is no table of numbers, or has no column "time".
    """
    import pandas as pd  # slow to load

    try:
        table = pd.read_csv(file)
    except (ValueError, UnicodeDecodeError) as error:
        raise FileReadError(f"is no CSV file: {error}", str(file)) from None
    if "time" not in table:
        raise FileReadError(
            f"has no column 'time'; its first columns are {list(table.columns[:6])}", str(file)
        )
    values = table.apply(pd.to_numeric, errors="coerce")
    read = {}
    for name in topics:
        columns = {
            tuple(str(column).removeprefix(f"{name}.").partition(".")[::2]): values[column].to_numpy()
            for column in values
            if str(column).startswith(f"{name}.")
        }
        if columns:
            time = columns.pop(("stamp", ""), values["time"].to_numpy())
            read[name] = _topic(name, columns, second * time, file)
    return read


def _topic(name: str, columns: Mapping[tuple[str, ...], Array], time: Array, file: Path) -> Topic:
    """Return a topic of its columns by field and component."""
    fields = {field for field, _ in columns}
    states: Kind | None = "JointState" if "position" in fields else None
    kind = next((kind for kind in reversed(FIELDS) if [*FIELDS[kind]][-1] in fields), states)
    if kind is None:
        raise FileReadError(
            f"topic {name!r} has the fields {sorted(fields)}; it must have those of {FIELDS}", str(file)
        )
    if not len(time):
        raise FileReadError(f"topic {name!r} has no samples", str(file))
    first, *others = FIELDS[kind]
    named = next(field for field in (first, *others) if field in fields)
    topic = Topic(kind, time, {}, tuple(part for field, part in columns if field == named))
    needed = fields | {first} if kind == "JointState" else {first, *others}
    parts = {field: topic.components(field) for field in FIELDS[kind] if field in needed}
    try:
        read = {
            field: np.stack([columns[field, part] for part in of_field], axis=1)
            for field, of_field in parts.items()
        }
    except KeyError as missing:
        raise FileReadError(f"has no column {'.'.join((name, *missing.args[0]))}", str(file)) from None
    has = np.isfinite(read[first]).all(axis=1) & np.isfinite(time)
    joints = topic.joints if kind == "JointState" else ()
    return Topic(kind, time[has], {field: values[has] for field, values in read.items()}, joints)


def write_csv(topics: Mapping[str, Topic], file: Path) -> None:
    """Write topics; those with other stamps than the first share its rows by their number, with a stamp.

    Args:
        topics: topics by name.
        file: the file.
    """
    import pandas as pd  # slow to load

    longest = max(topics.values(), key=lambda topic: len(topic.time))
    columns = {"time": longest.time}
    for name, topic in topics.items():
        if not np.array_equal(topic.time, longest.time):
            columns[f"{name}.stamp"] = topic.time
        for field, values in topic.values.items():
            columns |= {
                f"{name}.{field}.{part}": values[:, k] for k, part in enumerate(topic.components(field))
            }
    table = pd.DataFrame({name: pd.Series(values) for name, values in columns.items()})
    write_atomically(file, lambda part: table.to_csv(part, index=False))
