"""Record of one run, finished or failed, and its file format: JSON with a checksum."""

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
    """Return the content of a file written by ``to_checksummed_json``.

    Raises:
        FileReadError: the file is damaged, or was written by something else.
    """
    end = len(data) - len(_TAIL) - _DIGEST - len(_MIDDLE)
    framed = data.startswith(_HEAD) and data[end : end + len(_MIDDLE)] == _MIDDLE and data.endswith(_TAIL)
    if end < len(_HEAD) or not framed:
        raise FileReadError("the file was not written by a sweep, or is truncated")
    body, digest = data[len(_HEAD) : end], data[end + len(_MIDDLE) : -len(_TAIL)]
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise FileReadError("the file is damaged: its checksum does not match its content")
    try:
        content = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise FileReadError(f"the file is no JSON: {error}") from None
    if not isinstance(content, dict):
        raise FileReadError("the file holds no table")
    return content


_FORMAT = 1


class Failure(NamedTuple):
    """Error of a failed run.

    Attributes:
        kind: name of the error's class.
        message: its message.
        numbers: its numeric attributes, by name.
        trace: last lines of the traceback of an error that is not coop_pin's own.
    """

    kind: str
    message: str
    numbers: dict[str, float]
    trace: str = ""

    @classmethod
    def of(cls, error: Exception) -> Self:
        """Return text and numbers of an error; not its result up to then, which may be large."""
        numbers = {name: value for name, value in error.__dict__.items() if isinstance(value, int | float)}
        foreign = error.__cause__ if isinstance(error, CoopPinError) else error
        trace = "" if foreign is None else "".join(traceback.format_exception(foreign)[-4:])
        return cls(type(error).__name__, str(error) or type(error).__name__, numbers, trace)


class Record(NamedTuple):
    """Stored record of one run, finished or failed.

    Attributes:
        key: what ``run_key`` returned.
        scenario: the resolved scenario as JSON; empty if the changed scenario had mistakes.
        metrics: metrics by name; empty if the run failed.
        failure: its error if it failed.
        times: wall_s and cpu_s; apart from the metrics, because they differ from run to run.
        result_digest: SHA-256 of the file of the full result; empty if none is stored.
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
            FileReadError: the file is damaged, or not a record.
        """
        content = from_checksummed_json(data)
        if content.pop("format", None) != _FORMAT or set(content) != set(cls._fields):
            raise FileReadError("the file is not a record of a run, or one of another version")
        try:
            failure = content["failure"]
            if failure is not None:
                failure = Failure(**failure | {"numbers": _read(failure["numbers"])})
            return cls(**content | {"metrics": _read(content["metrics"]), "failure": failure})
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise FileReadError(f"the file is not a record of a run: {error}") from None


def _written(numbers: Mapping[str, float]) -> dict[str, float | str]:
    """Return numbers for JSON, which has no infinity and no not-a-number: they become text."""
    return {name: value if math.isfinite(value) else str(value) for name, value in numbers.items()}


def _read(numbers: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items()}
