"""Job of a sweep, one run as sent to a worker, and its record: text and numbers, never a model."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import re
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, Self

from coop_pin.description.scenario import Scenario
from coop_pin.errors import CoopPinError, FileReadError, RunTimeoutError
from coop_pin.results import RunResult
from coop_pin.run_scenario import run
from coop_pin.schema.user_code import load_function
from coop_pin.sweeps.run_key import CodeDigest, require_unchanged

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
    try:
        content = json.loads(found[2])
    except (ValueError, RecursionError) as error:
        raise FileReadError(f"it is no JSON: {error}") from None
    if not isinstance(content, dict):
        raise FileReadError("it holds no table")
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
        try:
            if content["failure"] is not None:
                numbers = _read(content["failure"]["numbers"])
                content["failure"] = Failure(**content["failure"] | {"numbers": numbers})
            return cls(**content | {"metrics": _read(content["metrics"])})
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise FileReadError(f"it is not the record of a run: {error}") from None


def _written(numbers: Mapping[str, float]) -> dict[str, float | str]:
    """Return numbers for JSON, which has no infinity and no not-a-number: they become text."""
    return {name: value if math.isfinite(value) else str(value) for name, value in numbers.items()}


def _read(numbers: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items()}


class Job(NamedTuple):
    """One run to be computed.

    Attributes:
        key: what ``run_key`` returned.
        scenario: the resolved scenario as JSON.
        changes: what was changed in its base, for the record.
        metrics: the user's metrics, "module:function".
        time_limit_s: wall time after which the run is aborted, s.
        memory_limit: memory of a worker, bytes; 0 for no limit.
        keep: whether the full result is requested.
        code: digests of the user's code that the key covers.
    """

    key: str
    scenario: str
    changes: Mapping[str, Any] = {}
    metrics: tuple[str, ...] = ()
    time_limit_s: float = 600.0
    memory_limit: int = 0
    keep: bool = False
    code: tuple[CodeDigest, ...] = ()

    @property
    def hard_limit_s(self) -> float:
        """Wall time after which the worker of an unresponsive run is killed, s."""
        return self.time_limit_s + max(2.0, 0.5 * self.time_limit_s)


class Outcome(NamedTuple):
    """Outcome of a job.

    Attributes:
        record: record of the run.
        result: content of the netCDF file of the full result, if it was requested.
    """

    record: Record
    result: bytes | None = None


class _CtrlC(KeyboardInterrupt):
    """Ctrl-C of the person at the terminal, other than a KeyboardInterrupt that user code raises."""


@contextlib.contextmanager
def distinct_ctrl_c() -> Iterator[None]:
    """Tell Ctrl-C from a KeyboardInterrupt that user code raises, while the ``with`` block runs."""

    def interrupt(*_: object) -> NoReturn:
        raise _CtrlC

    with contextlib.ExitStack() as stack:
        if threading.current_thread() is threading.main_thread():  # Ctrl-C does not reach others
            stack.callback(signal.signal, signal.SIGINT, signal.signal(signal.SIGINT, interrupt))
        yield


def run_job(job: Job) -> Outcome:
    """Return the outcome of a job; any error of the run becomes part of its record.

    What user code prints goes to standard error.

    Raises:
        CodeChangedError: this process has loaded other code than the job's key covers.
        KeyboardInterrupt: Ctrl-C.
        OSError: the full result was requested and the temporary folder is full.
    """
    require_unchanged(job.code)
    wall, cpu = time.perf_counter(), time.process_time()
    metrics: dict[str, float] = {}
    failure: Failure | None = None
    try:
        with contextlib.redirect_stdout(sys.stderr):
            result = run(Scenario.model_validate_json(job.scenario), progress=_deadline(job.time_limit_s))
            metrics = _metrics(result, job.metrics)
    except KeyboardInterrupt as error:
        if isinstance(error, _CtrlC) or isinstance(error.__context__, _CtrlC):
            raise
        failure = Failure("KeyboardInterrupt", "user code raised KeyboardInterrupt", {})
    except BaseException as error:  # user code may raise anything, SystemExit as well: it is recorded
        failure = Failure.of(error)
        if MemoryError in (*type(error).__mro__, *type(error.__cause__).__mro__):  # it may be transient
            failure = failure._replace(kind="MemoryError")
    times = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    content = _netcdf(result) if job.keep and failure is None else None
    return Outcome(Record(job.key, job.changes, metrics, failure, times), content)


def _deadline(limit: float) -> Callable[[int, int], None]:
    """Return a progress callback that raises RunTimeoutError after a wall time, s."""
    end = time.perf_counter() + limit

    def check(_done: int, _total: int) -> None:
        if time.perf_counter() > end:
            raise RunTimeoutError(limit)

    return check


def _metrics(result: RunResult, user_metrics: tuple[str, ...]) -> dict[str, float]:
    """Return the metrics of a run, the user's last."""
    metrics = result.metrics()
    for name in user_metrics:
        metrics |= {metric: float(value) for metric, value in load_function(name, {})(result).items()}
    return metrics


def _netcdf(result: RunResult) -> bytes:
    """Return the file of a result: a worker elsewhere cannot write into the sweep's folder itself."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.nc"
        result.save(path)
        return path.read_bytes()
