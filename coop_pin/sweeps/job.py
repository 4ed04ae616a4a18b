"""Job of a sweep: one run as sent to a worker, and its outcome; text and numbers, never a model."""

from __future__ import annotations

import contextlib
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from coop_pin.description.scenario import Scenario
from coop_pin.errors import RunTimeoutError
from coop_pin.results import RunResult
from coop_pin.run_scenario import run
from coop_pin.schema.user_code import load_function
from coop_pin.sweeps.record import Failure, Record
from coop_pin.sweeps.run_key import CodeDigest, require_unchanged


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

    if threading.current_thread() is not threading.main_thread():  # Ctrl-C does not reach other threads
        yield
        return
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


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
