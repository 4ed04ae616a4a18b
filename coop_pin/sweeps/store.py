"""Store of a sweep: append-only segments of checksummed lines, one for each run, and one writer's lock."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import logging
import os
import re
import socket
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, TypeVar

from filelock import FileLock, Timeout

from coop_pin import __version__
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import (
    CoopPinError,
    FieldError,
    FileReadError,
    FileWriteError,
    ScenarioError,
    StoreLockedError,
)
from coop_pin.base.source_code import named_digests
from coop_pin.base.user_files import read_user_file
from coop_pin.results.run_result import RunResult
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.workers.job import JobRecord, Outcome, StoredRun, checked_content, checksummed

_LOG = logging.getLogger("coop_pin.sweeps")
Read = TypeVar("Read")
_PART = re.compile(r"\..*\.[0-9a-f]{32}(\.\w+)?")
"""Names of partial files that ``write_atomically`` leaves if it is killed."""
TRANSIENT = ("RunTimeoutError", "WorkerDiedError", "MemoryError")
"""Failures that may not occur again."""
_PLAN_BYTES = 1 << 28
"""Largest plan that is read."""
_LINE_BYTES = 1 << 24
"""Largest record that is read; what follows a longer one in its segment is not."""


class SweepStore:
    """Folder that stores the runs of a sweep.

    ``runs/000001.jsonl`` and so on are segments, one for each session that computed something: lines of
    records between empty lines, so that a damaged byte costs one record even if it was the end of a line.
    ``results/ab/ab....nc`` is a full result if it was requested, ``quarantine/`` holds copies of damaged
    lines, ``plan.json`` the last plan.

    Attributes:
        folder: the folder.
        known: kind of the failure of every stored run, "" if it finished, by key; while the folder is locked.

    Raises:
        FileReadError: an older version wrote the folder, with one file for each run.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.known: dict[str, str] = {}
        if any(path.is_dir() for path in (self.folder / "runs").glob("??")):
            detail = "holds a sweep of an older version, one file for each run, and is left as it is"
            raise FileReadError(
                f"{folder} {detail}; repeat it: coop-pin sweep PLAN.toml --out ANOTHER_FOLDER"
            )

    # ------------------------------------------------------------ one writer

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for writing; what a killed owner left behind is cleaned up and logged.

        The lock is the kernel's, which ends with its process however that ends. The text in the file names
        the owner; text in a file that is not locked was left by a process that was killed.

        Raises:
            StoreLockedError: another process holds it.
            FileWriteError: the folder cannot be written.
            FileReadError: ``lock`` is not a regular file.
        """
        path = self.folder / "lock"
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise FileReadError(f"{path} is not a regular file; remove it, or choose another folder")
        with _write_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                held = FileLock(path).acquire(blocking=False)
            except Timeout:
                raise StoreLockedError(str(self.folder), _text(path) or "another process") from None
        with held:
            if killed := _text(path):
                message = "the last sweep in %s (%s) was killed; its finished runs are kept"
                _LOG.warning(message, self.folder, killed)
            with contextlib.suppress(OSError):  # on a full disk the lock holds without its owner's name
                path.write_text(f"process {os.getpid()} on {socket.gethostname()}")
            try:
                self._clean_up()
                yield
            finally:
                with contextlib.suppress(OSError):
                    path.write_text("")

    def _clean_up(self) -> None:
        """Remove partial files, note what is stored, and copy damaged lines into ``quarantine/``."""
        for part in self.folder.rglob(".*"):
            if _PART.fullmatch(part.name) and not part.is_dir():
                part.unlink()
        damaged: list[bytes] = []
        self.known = {run.key: run.failure for run in self._read(StoredRun.from_line, damaged)}
        content = b"".join(line + b"\n" for line in damaged)
        aside = self.folder / "quarantine" / f"{hashlib.sha256(content).hexdigest()[:16]}.jsonl"
        if damaged and not aside.exists():
            message = "%d damaged lines of %s are copied to %s; their runs are repeated"
            _LOG.warning(message, len(damaged), self.folder / "runs", aside)
            self.write_with(aside, lambda part: part.write_bytes(content))

    # ------------------------------------------------------------ runs

    def records(self, damaged: list[bytes] | None = None) -> Iterator[JobRecord]:
        """Yield all records in the order they were written; of several with one key the last is valid.

        Args:
            damaged: takes the lines that are no records.
        """
        return self._read(JobRecord.from_line, damaged)

    def _read(self, read: Callable[[bytes], Read], damaged: list[bytes] | None) -> Iterator[Read]:
        """Yield what a function reads of each line."""
        for segment in self.segments():
            with segment.open("rb") as file:
                for line in filter(None, map(bytes.strip, _lines(file))):
                    try:
                        part = read(line)
                    except FileReadError:
                        if damaged is not None:
                            damaged.append(line)
                    else:
                        yield part

    def segments(self) -> list[Path]:
        """Return the segments in the order they were begun."""
        return sorted(path for path in (self.folder / "runs").glob("*.jsonl") if path.is_file())

    def families(self) -> dict[str, str]:
        """Return the families of runs of users' laws in batches, by key."""
        last = {record.key: record.family for record in self.records()}
        return {key: family for key, family in last.items() if family}

    def read_records(self, keys: Collection[str]) -> dict[str, JobRecord]:
        """Return the records of some runs by key."""
        return {record.key: record for record in self.records() if record.key in keys}

    def append(self, outcomes: Sequence[Outcome]) -> None:
        """Store outcomes, first the full results that belong to them; one write and one sync for all.

        Raises:
            FileWriteError: the disk is full, or the folder cannot be written.
        """
        for record, result, *_ in outcomes:
            if result is not None:
                self.write_with(
                    self._result_path(record.key), functools.partial(Path.write_bytes, data=result)
                )
        data = b"".join(b"\n%s\n" % (line or record.to_line()) for record, _, line, _ in outcomes)
        with _write_errors(self.folder / "runs"):
            if data:
                with self._segment.open("ab", buffering=0) as file:
                    while data:
                        data = data[file.write(data) :]
                    os.fsync(file.fileno())
        self.known |= {outcome.record.key: outcome.record.failure for outcome in outcomes}

    def missing_of(self, other: SweepStore, keys: Collection[str]) -> dict[str, JobRecord]:
        """Return what another folder has of some runs and this one does not, by key; say how many there are.

        Damaged lines there count as missing. Failures that may not occur again are left out, and so are
        changes, which the plan has, and full results.

        Raises:
            FileReadError: the other folder is not that of a sweep, or has a record that no sweep writes.
        """
        if not (other.folder / "runs").is_dir():
            raise FileReadError(f"{other.folder} holds no sweep: there is no folder 'runs' in it")
        damaged, missing, records, count = list[bytes](), {*keys} - {*self.known}, dict[str, JobRecord](), 0
        for record in other.records(damaged):
            count += 1
            if record.key in missing and record.failure not in TRANSIENT:
                try:
                    record.require_sound()
                except FieldError as error:
                    raise FileReadError(f"cannot be merged: {error}", str(other.folder)) from None
                records[record.key] = dataclasses.replace(record, changes={}, merged=True)
        message = "%d runs are taken from the %d of %s; the others are known here or not in this plan"
        _LOG.warning(message, len(records), count, other.folder)
        if damaged:
            _LOG.warning("%d damaged lines of %s are left out", len(damaged), other.folder)
        return records

    @functools.cached_property
    def _segment(self) -> Path:
        """New segment: two sessions that write after the lock was removed by hand do not share one."""
        folder = self.folder / "runs"
        folder.mkdir(exist_ok=True, parents=True)
        last = max((int(path.stem) for path in folder.iterdir() if path.stem.isdecimal()), default=0)
        segment = folder / f"{last + 1:06}.jsonl"
        segment.touch(exist_ok=False)
        return segment

    def _result_path(self, key: str) -> Path:
        return self.folder / "results" / key[:2] / f"{key}.nc"

    def read_result(self, key: str) -> RunResult | None:
        """Return the full result of a run if it is stored and undamaged."""
        with contextlib.suppress(FileReadError):
            return RunResult.load(self._result_path(key))
        return None

    # ------------------------------------------------------------ the plan and tables

    def write_plan(self, plan: SweepPlan) -> None:
        """Write the plan, so that the folder can be read on its own."""
        content = f'{{"coop_pin":"{__version__}",{plan.model_dump_json()[1:]}'
        self.write_changed(self.folder / "plan.json", checksummed(content.encode()) + b"\n")

    def read_plan(self) -> SweepPlan:
        """Return the last plan.

        Raises:
            FileReadError: the folder is not that of a sweep of this version, or its plan is damaged.
        """
        path = self.folder / "plan.json"
        if not path.exists():
            raise FileReadError(f"{self.folder} holds no sweep: there is no {path.name}")
        try:
            data = read_user_file(path, limit=_PLAN_BYTES, kind="the plan of a sweep")
            fields = json.loads(checked_content(data.strip()))
            version = fields.pop("coop_pin", "before 0.2.0")
            plan = SweepPlan(**fields) if version == __version__ else None
        except (FileReadError, ScenarioError, ValueError, TypeError, AttributeError, RecursionError) as error:
            advice = "run the sweep's command again: finished runs are kept"
            raise FileReadError(f"{path} cannot be used ({error}); {advice}") from None
        if plan is None:
            command = (
                f"coop-pin sweep PLAN.toml --out {self.folder}, or cp.sweep(plan, out={str(self.folder)!r})"
            )
            raise FileReadError(f"{path} is of coop_pin {version}; repeat it with {__version__}: {command}")
        return plan

    def write_code(self, names: Iterable[str]) -> None:
        """Write the digests of the user's files, so that an edit after the runs can be named."""
        content = json.dumps({name: named_digests(name) for name in sorted(names)}).encode()
        self.write_changed(self.folder / "code.json", checksummed(content) + b"\n")

    def edited(self) -> list[str]:
        """Return the user's files that are not as they were when the last runs were computed."""
        try:
            data = read_user_file(self.folder / "code.json", limit=_PLAN_BYTES, kind="digests of code")
            stored = json.loads(checked_content(data.strip()))
        except (FileReadError, ValueError):  # a sweep without code of the user, or a damaged file
            return []
        pairs = (({*map(tuple, files)}, {*named_digests(name)}) for name, files in stored.items())
        return sorted({file for old, new in pairs for file, _ in old ^ new})

    def write_changed(self, path: Path, content: bytes) -> None:
        """Write a file of the folder if its content changes; raises as write_with."""
        with _write_errors(path):
            if not path.is_file() or path.read_bytes() != content:
                write_atomically(path, lambda part: part.write_bytes(content))

    def write_with(self, path: Path, write: Callable[[Path], object]) -> None:
        """Write a file of the folder, complete or not at all.

        Raises:
            FileWriteError: the disk is full, or the folder cannot be written.
        """
        with _write_errors(path):
            write_atomically(path, write)


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a segment up to one that is too long, of which the first bytes come last."""
    while line := file.readline(_LINE_BYTES):
        yield line
        if len(line) == _LINE_BYTES:
            return


def _text(path: Path) -> str:
    """Return the text in a lock file, which names its owner."""
    return path.read_text(errors="replace").strip() if path.is_file() else ""


@contextlib.contextmanager
def _write_errors(path: Path) -> Iterator[None]:
    """Raise one error for whatever hinders writing; HDF5 raises RuntimeError on a full disk."""
    try:
        yield
    except CoopPinError:
        raise
    except (OSError, RuntimeError) as error:
        raise FileWriteError(str(path), getattr(error, "strerror", None) or str(error)) from None
