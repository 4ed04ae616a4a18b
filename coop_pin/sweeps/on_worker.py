"""What a worker does with jobs, and how it ends when one of them hangs."""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import dask
from distributed import get_worker

from coop_pin.sweeps.job import Job, Outcome, run_job

BEGUN = "coop-pin-begun"
"""The topic under which the start of a suspect is reported."""
_SENDING_S = 0.1


def run_jobs(jobs: list[Job]) -> list[Outcome]:
    """Run jobs one after the other in a worker's process, which is ended if one of them hangs.

    The guard is a thread of the interpreter's own (faulthandler), which needs no lock that a hanging run could hold.
    """
    outcomes = []
    with dask.config.set(scheduler="synchronous"):  # xarray would ask the cluster for a lock before it writes a result
        for job in jobs:
            with _guarded(job.hard_limit_s):
                outcomes.append(run_job(job))
    return outcomes


def run_suspect(job: Job, ticket: str) -> list[Outcome]:
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
