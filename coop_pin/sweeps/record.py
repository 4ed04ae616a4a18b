"""What is kept of one run."""

from __future__ import annotations

import hashlib
import json
import math
import traceback
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

from coop_pin.errors import CoopPinError, FileReadError

_HEAD, _MIDDLE, _TAIL = b'{"content": ', b', "sha256": "', b'"}\n'
_DIGEST = 64


def to_checksummed_json(content: Mapping[str, Any]) -> bytes:
    """Return ``{"content": ..., "sha256": digest of the content's bytes}`` as JSON."""
    body = json.dumps(content, allow_nan=False).encode()
    return _HEAD + body + _MIDDLE + hashlib.sha256(body).hexdigest().encode() + _TAIL


def from_checksummed_json(data: bytes) -> dict[str, Any]:
    """Return the content.

    Raises:
        FileReadError: a bit of it is not as it was written, or it was not written by to_checksummed_json.
    """
    end = len(data) - len(_TAIL) - _DIGEST - len(_MIDDLE)
    if end < len(_HEAD) or not (
        data.startswith(_HEAD) and data[end : end + len(_MIDDLE)] == _MIDDLE and data.endswith(_TAIL)
    ):
        raise FileReadError("the file was not written by a sweep, or is cut off")
    body, digest = data[len(_HEAD) : end], data[end + len(_MIDDLE) : -len(_TAIL)]
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise FileReadError("the file is damaged: its checksum does not fit its content")
    content = json.loads(body)
    if not isinstance(content, dict):
        raise FileReadError("the file was not written by a sweep")
    return content


_FORMAT = 1


class Failure(NamedTuple):
    """Why a run failed.

    Attributes:
        kind: name of the error's class.
        message: what it said.
        numbers: what it carried, by name.
        trace: where an error that is not coop_pin's own was raised.
    """

    kind: str
    message: str
    numbers: dict[str, float]
    trace: str = ""

    @classmethod
    def of(cls, error: Exception) -> Self:
        """Return what is kept of an error: text and numbers, never the result up to then, which may be large."""
        carried = {name: value for name, value in error.__dict__.items() if isinstance(value, int | float)}
        foreign = error.__cause__ if isinstance(error, CoopPinError) else error
        trace = "" if foreign is None else "".join(traceback.format_exception(foreign)[-4:])
        return cls(type(error).__name__, str(error) or type(error).__name__, carried, trace)


class Record(NamedTuple):
    """What is kept of one run, finished or failed.

    Attributes:
        key: of what determines the run.
        scenario: the resolved scenario as JSON; empty if the changes made none.
        metrics: the judgements of the run by name; empty if it failed.
        failure: why it failed.
        times: wall_s and cpu_s it took; they differ from run to run and stand in no table of metrics.
        result_digest: of the file of the full result; empty if none is kept.
    """

    key: str
    scenario: str
    metrics: dict[str, float]
    failure: Failure | None = None
    times: Mapping[str, float] = {}
    result_digest: str = ""

    def to_bytes(self) -> bytes:
        """Return the content of its file."""
        content = self._asdict() | {
            "format": _FORMAT,
            "metrics": _written(self.metrics),
            "times": dict(self.times),
        }
        if self.failure is not None:
            content["failure"] = self.failure._asdict() | {"numbers": _written(self.failure.numbers)}
        return to_checksummed_json(content)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read a record.

        Raises:
            FileReadError: it is damaged, or not a record.
        """
        content = from_checksummed_json(data)
        if content.pop("format", None) != _FORMAT or set(content) != set(cls._fields):
            raise FileReadError("the file is no record of a run, or one of another version")
        failure = content["failure"]
        if failure is not None:
            failure = Failure(**failure | {"numbers": _read(failure["numbers"])})
        return cls(**content | {"metrics": _read(content["metrics"]), "failure": failure})


def flat(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Return metrics as plain numbers; an entry i of a list is named ``name.i``."""
    numbers: dict[str, float] = {}
    for name, value in metrics.items():
        entries = (
            {f"{name}.{i}": entry for i, entry in enumerate(value)}
            if isinstance(value, list | tuple)
            else {name: value}
        )
        numbers |= {key: float(entry) for key, entry in entries.items()}
    return numbers


def _written(numbers: Mapping[str, float]) -> dict[str, float | str]:
    """JSON has no infinity and no not-a-number: they become text."""
    return {name: value if math.isfinite(value) else str(value) for name, value in numbers.items()}


def _read(numbers: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items()}
