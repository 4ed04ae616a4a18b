"""One run as it travels to a worker and back: text and numbers, never a model."""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import dask
from distributed import get_worker

from coop_pin.description.scenario import Scenario
from coop_pin.errors import RunTimeoutError
from coop_pin.results import RunResult
from coop_pin.run_scenario import run
from coop_pin.schema.user_code import load_function
from coop_pin.sweeps.record import Failure, Record, flat
from coop_pin.sweeps.run_key import UserCode, require_loaded


class Job(NamedTuple):
    """A run to be done.

    Attributes:
        key: of what determines it.
        scenario: the resolved scenario as JSON.
        metrics: the user's own metrics, "module:function".
        time_limit_s: wall time after which it is given up, s.
        keep: whether the full result is wanted.
        code: the user's own code that its key stands for.
    """

    key: str
    scenario: str
    metrics: tuple[str, ...] = ()
    time_limit_s: float = 600.0
    keep: bool = False
    code: tuple[UserCode, ...] = ()

    @property
    def hard_limit_s(self) -> float:
        """Wall time after which a run that does not even answer is ended together with its worker, s."""
        return self.time_limit_s + max(2.0, 0.5 * self.time_limit_s)


class Outcome(NamedTuple):
    """A run done.

    Attributes:
        record: what is kept of it.
        result: content of the netCDF file of the full result, if it was wanted.
    """

    record: Record
    result: bytes | None = None


class Deadline:
    """A progress callback that gives a run up when its wall time is used up."""

    def __init__(self, limit: float) -> None:
        self._limit, self._end = limit, time.perf_counter() + limit

    def __call__(self, done: int, total: int) -> None:
        """Look at the clock.

        Raises:
            RunTimeoutError: the time is used up.
        """
        if time.perf_counter() > self._end:
            raise RunTimeoutError(self._limit)


def run_job(job: Job) -> Outcome:
    """Run a job; whatever the run raises becomes part of the record.

    Raises:
        CodeChangedError: this process runs other code than the job's key stands for.
        OSError: the full result was asked for and the temporary folder is full.
    """
    require_loaded(job.code)
    wall, cpu = time.perf_counter(), time.process_time()
    metrics: dict[str, float] = {}
    result: RunResult | None = None
    failure: Failure | None = None
    try:
        result = run(Scenario.model_validate_json(job.scenario), progress=Deadline(job.time_limit_s))
        metrics = _judged(result, job.metrics)
    except Exception as error:  # the run's own code may raise anything; it is reported in the record
        failure = Failure.of(error)
    times = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    content = _content(result) if job.keep and result is not None and failure is None else None
    return Outcome(Record(job.key, job.scenario, metrics, failure, times), content)


def _judged(result: RunResult, users: tuple[str, ...]) -> dict[str, float]:
    """Return the metrics of a run, the user's own after ours."""
    metrics: dict[str, Any] = dict(result.metrics())
    for name in users:
        function: Callable[[RunResult], Mapping[str, float]] = load_function(name, {})
        metrics |= function(result)
    return flat(metrics)


def _content(result: RunResult) -> bytes:
    """Return what RunResult.save writes; a worker on another machine cannot write into the sweep's folder itself."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.nc"
        result.save(path)
        return path.read_bytes()


BEGUN = "coop-pin-begun"
"""The topic under which the start of a suspect is reported."""
_SENDING_S = 0.1


def run_jobs(jobs: list[Job]) -> list[Outcome]:
    """Run jobs one after the other in a worker's process, which is ended if one of them hangs.

    The guard is a thread of the interpreter's own (faulthandler), which needs no lock that a hanging run
    could hold.
    """
    outcomes = []
    with dask.config.set(
        scheduler="synchronous"
    ):  # xarray would ask the cluster for a lock before it writes a result
        for job in jobs:
            with _guarded(job.hard_limit_s):
                outcomes.append(run_job(job))
    return outcomes


def run_isolated(job: Job, ticket: str) -> list[Outcome]:
    """Run a job whose worker died before; its beginning is reported first, so that a hang can be told from a crash.

    Args:
        job: the job.
        ticket: what is reported.
    """
    get_worker().log_event(BEGUN, ticket)
    time.sleep(_SENDING_S)
    return run_jobs([job])


@contextlib.contextmanager
def _guarded(limit: float) -> Iterator[None]:
    faulthandler.dump_traceback_later(limit, exit=True, file=_nowhere())
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


@functools.cache
def _nowhere() -> TextIO:
    return Path(os.devnull).open("w", encoding="utf-8")
