"""Record of one run, finished or failed, and its format: a line of JSON with a checksum."""

from __future__ import annotations

import hashlib
import json
import math
import re
import traceback
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

from coop_pin.errors import CoopPinError, FileReadError

_LINE = re.compile(rb'\{"sha256": "([0-9a-f]{64})", "content": (.*)\}')


def to_checksummed_json(content: Mapping[str, Any]) -> bytes:
    """Return ``{"sha256": digest of the content's bytes, "content": ...}`` as one line, without its end."""
    body = json.dumps(content, allow_nan=False, default=str).encode()
    return b'{"sha256": "%s", "content": %s}' % (hashlib.sha256(body).hexdigest().encode(), body)


def from_checksummed_json(line: bytes) -> dict[str, Any]:
    """Return the content of a line written by ``to_checksummed_json``.

    Raises:
        FileReadError: the line is damaged, cut, or was written by something else.
    """
    found = _LINE.fullmatch(line)
    if found is None or hashlib.sha256(found[2]).hexdigest().encode() != found[1]:
        raise FileReadError("it was not written by a sweep, or is damaged: its checksum does not match")
    content: dict[str, Any] = json.loads(found[2])
    return content


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
    def of(cls, error: BaseException) -> Self:
        """Return text and numbers of an error; not its result up to then, which may be large."""
        numbers = {name: value for name, value in error.__dict__.items() if isinstance(value, int | float)}
        foreign = error.__cause__ if isinstance(error, CoopPinError) else error
        trace = "" if foreign is None else "".join(traceback.format_exception(foreign)[-4:])
        return cls(type(error).__name__, str(error) or type(error).__name__, numbers, trace)


class Record(NamedTuple):
    """Stored record of one run, finished or failed.

    Attributes:
        key: what ``run_key`` returned.
        changes: what was changed in the base scenario, by dotted path.
        metrics: metrics by name; empty if the run failed.
        failure: its error if it failed.
        times: wall_s and cpu_s; apart from the metrics, because they differ from run to run.
        result_digest: SHA-256 of the file of the full result; empty if none is stored.
    """

    key: str
    changes: Mapping[str, Any]
    metrics: dict[str, float]
    failure: Failure | None = None
    times: Mapping[str, float] = {}
    result_digest: str = ""

    def to_line(self) -> bytes:
        """Return its line in the store."""
        content = self._asdict() | {"metrics": _written(self.metrics)}
        if self.failure is not None:
            content["failure"] = self.failure._asdict() | {"numbers": _written(self.failure.numbers)}
        return to_checksummed_json(content)

    @classmethod
    def from_line(cls, line: bytes) -> Self:
        """Read a record.

        Raises:
            FileReadError: the line is damaged, or not a record.
        """
        content = from_checksummed_json(line)
        if set(content) != set(cls._fields):
            raise FileReadError("it is not the record of a run, or one of another version")
        if content["failure"] is not None:
            numbers = _read(content["failure"]["numbers"])
            content["failure"] = Failure(**content["failure"] | {"numbers": numbers})
        return cls(**content | {"metrics": _read(content["metrics"])})


def _written(numbers: Mapping[str, float]) -> dict[str, float | str]:
    """Return numbers for JSON, which has no infinity and no not-a-number: they become text."""
    return {name: value if math.isfinite(value) else str(value) for name, value in numbers.items()}


def _read(numbers: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items()}
