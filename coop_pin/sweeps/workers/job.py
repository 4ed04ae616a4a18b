"""Job of a sweep, one run as sent to a worker, and its record: values, text and numbers, never a model."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, NamedTuple, Self, TypeVar, cast

import numpy as np
from pydantic import AfterValidator, ConfigDict, TypeAdapter, ValidationError

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import CoopPinError, FieldError, FileReadError, RunTimeoutError, place_of
from coop_pin.base.schema.parts import Pattern
from coop_pin.base.schema.user_code import accept_code, load_function
from coop_pin.base.user_files import printable
from coop_pin.compiled.engine_choice import EngineChoice, plant_of
from coop_pin.compiled.engines import Way
from coop_pin.compiled.kind import pinocchio_reason
from coop_pin.control.hidden_state import leaks, of_all_runs, unrepeatable
from coop_pin.description.scenario import Scenario
from coop_pin.results.netcdf import to_netcdf
from coop_pin.results.run_result import RunResult
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.mujoco_plant import require_mujoco
from coop_pin.simulation.simulate import simulate
from coop_pin.sweeps.run_key import Code, require_unchanged

_MOST_METRICS, _LONGEST_NAME = 1000, 200
"""Bounds of what is taken over from others."""
_Text = Annotated[str, AfterValidator(printable)]
Read = TypeVar("Read")


def checksummed(content: bytes) -> bytes:
    """Return ``{"sha256": digest of the content, "content": ...}`` of JSON on one line, without its end."""
    return b'{"sha256": "%s", "content": %s}' % (hashlib.sha256(content).hexdigest().encode(), content)


_PREFIX_BYTES = len(checksummed(b"")) - 1
"""Length of a line before its content, bytes."""


def checked_content(line: bytes) -> bytes:
    """Return the JSON in a line written by ``checksummed``.

    Raises:
        FileReadError: the line is damaged, cut, or was written by something else.
    """
    content = line[_PREFIX_BYTES:-1]
    if checksummed(content) != line:
        raise FileReadError("it was not written by a sweep, or is damaged: its checksum does not match")
    return content


@dataclasses.dataclass(frozen=True)
class JobRecord:
    """Stored record of one run, finished or failed; what is read is validated, what is made here is not.

    Attributes:
        key: key of the run, see ``run_key``.
        changes: changes of the base scenario, by dotted path.
        metrics: metrics by name; empty if the run failed.
        failure: name of its error's class; empty if it finished.
        message: the error's message, after its place in the user's code if it is not coop_pin's own.
        failed_at_s: simulated time of the error if it has one, s.
        trace: last lines of the traceback of an error that is not coop_pin's own.
        engine: engine that simulated it: "pinocchio" or "compiled".
        family: digest of the family and the code of a run of a user's law in a batch; some of its runs are
            repeated singly.
        merged: whether it was taken over from another folder.
        wall_s: duration; like ``cpu_s`` apart from the metrics, because it differs from run to run.
        cpu_s: processor time.
    """

    __pydantic_config__ = ConfigDict(ser_json_inf_nan="strings")  # JSON has no infinity

    key: str
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)
    metrics: dict[str, float] = dataclasses.field(default_factory=dict)
    failure: _Text = ""
    message: _Text = ""
    failed_at_s: float | None = None
    trace: _Text = ""
    engine: _Text = "pinocchio"
    family: _Text = ""
    merged: bool = False
    wall_s: float = 0.0
    cpu_s: float = 0.0

    @classmethod
    def of_failure(cls, key: str, changes: Mapping[str, Any], error: BaseException) -> Self:
        """Return the record of a failed run: text, not the error's result up to then, which may be large."""
        is_own = isinstance(error, CoopPinError)
        foreign = error.__cause__ if is_own else error
        trace = "" if foreign is None else "".join(traceback.format_exception(foreign)[-4:])
        plain = (kind.__name__ for kind in (MemoryError, KeyboardInterrupt) if isinstance(foreign, kind))
        kind = next(plain, type(error).__name__)
        failed_at_s = getattr(error, "time", None) if is_own else None
        message = str(error) or kind
        if isinstance(error, Exception) and not is_own:  # of a user's metric or constructor, for example
            message = "at {}:{} in {}: {}".format(*place_of(error), message)
        return cls(key, dict(changes), {}, kind, printable(message), failed_at_s, printable(trace))

    def require_sound(self) -> None:
        """Refuse what no sweep writes: the record may be somebody else's.

        Raises:
            FieldError: it has neither metrics nor an error, too many, or names that are too long or no names.
        """
        names = [
            name for name in self.metrics if not name.isprintable() or not 0 < len(name) <= _LONGEST_NAME
        ]
        if names:
            shown = printable(names[0][:_LONGEST_NAME])
            form = f"a name has 1 to {_LONGEST_NAME} characters that can be printed"
            raise FieldError(f"has the metric {shown!r}; {form}", "a record")
        if bool(self.metrics) == bool(self.failure) or len(self.metrics) > _MOST_METRICS:
            counts = f"has {len(self.metrics)} metrics and the error {self.failure[:_LONGEST_NAME]!r}"
            raise FieldError(f"{counts}; a run has 1 to {_MOST_METRICS} metrics, or an error", "a record")
        if not f"_{self.failure}".isidentifier() or len(self.failure) > _LONGEST_NAME:
            shown = self.failure[:_LONGEST_NAME]
            raise FieldError(f"has the error {shown!r}, which is no name of a class", "a record")

    def to_line(self) -> bytes:
        """Return its line in the store."""
        return checksummed(_RECORD.serializer.to_json(self))

    @classmethod
    def from_line(cls, line: bytes) -> JobRecord:
        """Read a record.

        Raises:
            FileReadError: the line is damaged, or not a record.
        """
        return _read(_RECORD, line)


@dataclasses.dataclass(frozen=True)
class StoredRun:
    """Key and failure of a stored run: the part of its record that a resumed sweep reads.

    Attributes:
        key: key of the run.
        failure: name of its error's class; empty if it finished.
    """

    key: str
    failure: str = ""

    @classmethod
    def from_line(cls, line: bytes) -> StoredRun:
        """Read it from the line of a record, whose other parts are not looked at.

        Raises:
            FileReadError: the line is damaged, or has no key.
        """
        return _read(_STORED, line)


_RECORD, _STORED = TypeAdapter(JobRecord), TypeAdapter(StoredRun)


def _read(adapter: TypeAdapter[Read], line: bytes) -> Read:
    content, validator = checked_content(line), adapter.validator  # the adapter itself takes 1 us more
    try:
        record: Read = validator.validate_json(content)
    except ValidationError as error:
        reason = "it is not the record of a run, or one of another version"
        raise FileReadError(f"{reason}: {error}") from None
    return record


class Job(NamedTuple):
    """One run to be computed.

    Attributes:
        key: key of the run, see ``run_key``.
        example: the resolved scenario; with a pattern that of another run. Jobs that are sent together
            send what they share once.
        changes: changes of its base scenario, for the record.
        metrics: the user's metrics, "module:function".
        time_limit_s: wall time after which the run is aborted, s.
        memory_limit: memory of a worker, bytes; 0 for no limit.
        keep: whether the full result is requested.
        code: digests of the user's code that the key covers.
        way: form of the computation: "lanes", together with others if it can be; "plant", on a compiled plant
            if there can be one.
        pattern: pattern of the scenario, if others differ from it in plain numbers.
        numbers: numbers of the run in the pattern.
    """

    key: str
    example: Scenario
    changes: Mapping[str, Any] = {}
    metrics: tuple[str, ...] = ()
    time_limit_s: float = 600.0
    memory_limit: int = 0
    keep: bool = False
    code: Code = ()
    way: Way = "pinocchio"
    pattern: Pattern | None = None
    numbers: tuple[float, ...] = ()

    @property
    def scenario(self) -> Scenario:
        """The resolved scenario."""
        return self.example if self.pattern is None else cast(Scenario, self.pattern.filled(self.numbers))


class Outcome(NamedTuple):
    """Outcome of a job.

    Attributes:
        record: record of the run.
        result: content of the netCDF file of the full result, if it was requested.
        line: line of the record in the store; empty if its worker has left it to the store.
        remarks: sentences on what the run has left to the next ones of its process, or had of the machine.
    """

    record: JobRecord
    result: bytes | None = None
    line: bytes = b""
    remarks: Sequence[str] = ()


class CtrlC(KeyboardInterrupt):
    """Ctrl-C of the person at the terminal, other than a KeyboardInterrupt that user code raises."""


def run_job(job: Job) -> Outcome:
    """Return the outcome of a job by itself; any error of the run becomes part of its record.

    What user code prints goes to standard error.

    Raises:
        CodeChangedError: this process has loaded other code than the job's key covers.
        KeyboardInterrupt: Ctrl-C.
    """
    require_unchanged(job.code)
    code = tuple(name for name, _ in job.code)
    accept_code(code)  # which whoever sent the job has looked at
    before = of_all_runs(code)

    def compute() -> RunResult:
        scenario, progress = separate(job.scenario), deadline(job.time_limit_s)
        engine = EngineChoice(job.way).engine
        if engine == "compiled" and pinocchio_reason(scenario):
            engine = "pinocchio"
        if engine == "mujoco":
            require_mujoco(scenario.cell, scenario.plant, scenario.events)
        return simulate(scenario, build_controller(scenario), progress=progress, plant=plant_of(engine))

    outcome = outcome_of(job, compute)
    require_unchanged(job.code)  # as it was loaded now
    return outcome._replace(remarks=[*leaks(before, code), *unrepeatable(code)])


def separate(scenario: Scenario) -> Scenario:
    """Return a scenario with options of its own, lists and tables that the user's code may change."""
    return Scenario.model_validate_json(scenario.model_dump_json()) if has_options(scenario) else scenario


def has_options(scenario: Scenario) -> bool:
    """Return whether the user's code may change parts of a scenario."""
    return any(vars(part).get("options") for part in (scenario.controller, scenario.motion, scenario.squeeze))


def outcome_of(
    job: Job, compute: Callable[[], RunResult], known: Mapping[str, float] | None = None
) -> Outcome:
    """Return the outcome of a job whose result is computed by a function, with its metrics if known."""
    content, start = None, times()
    try:
        with contextlib.redirect_stdout(sys.stderr):
            result = compute()
            metrics = result.metrics() if known is None else dict(known)
            for name in job.metrics:  # the user's last
                for key, value in load_function(name, {})(result).items():
                    require_type("name of a metric", key, str)
                    metrics[key] = float(value)
        record = JobRecord(job.key, dict(job.changes), metrics, engine=result.engine)
    except BaseException as error:  # user code may raise anything, SystemExit as well: it is recorded
        if CtrlC in (type(error), type(error.__context__)):
            raise
        record = JobRecord.of_failure(job.key, job.changes, error)
    wall_s, cpu_s = (times() - start).tolist()
    if job.keep and not record.failure:
        content = bytes(to_netcdf(result.data, result.scenario.to_toml()))
    return Outcome(dataclasses.replace(record, wall_s=wall_s, cpu_s=cpu_s), content)


def times() -> Array:
    """Return wall and processor time, s, shape (2,); their differences are durations."""
    return np.array([time.perf_counter(), time.process_time()])


def deadline(limit: float) -> Callable[[int, int], None]:
    """Return a progress callback that raises RunTimeoutError after a wall time, s."""
    end = time.perf_counter() + limit

    def check(_done: int, _total: int) -> None:
        if time.perf_counter() > end:
            raise RunTimeoutError(limit)

    return check
