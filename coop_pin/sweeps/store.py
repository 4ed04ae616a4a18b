"""Store of a sweep: append-only segments of checksummed lines, one for each run, and one writer's lock."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import logging
import os
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from filelock import FileLock, Timeout

from coop_pin.errors import FileReadError, FileWriteError, ScenarioError, StoreLockedError
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.sweeps.job import Outcome, Record, from_checksummed_json, to_checksummed_json
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.user_files import read_user_file

_MAX_BYTES = 2**32
"""Size limit of each file; one hour of two arms at 80 Hz has 0.4 GB."""
_LOG = logging.getLogger("coop_pin.sweeps")
_PART = re.compile(r"\..*\.[0-9a-f]{32}(\.\w+)?")
"""Names of partial files that ``write_atomically`` leaves if it is killed."""
_SEGMENT_BYTES, _PLAN_BYTES = 1 << 26, 1 << 28
"""Size at which a segment is closed, and largest plan that is read."""


class SweepStore:
    """Folder that stores the runs of a sweep.

    ``runs/000001.jsonl`` and so on are segments, one for each session that computed something: lines of
    records between empty lines, so that a damaged byte costs one record even if it was the end of a line.
    ``results/ab/ab....nc`` is a full result if it was requested, ``quarantine/`` holds copies of damaged
    lines, ``plan.json`` the last plan.

    Attributes:
        folder: the folder.

    Raises:
        FileReadError: an older version wrote the folder, with one file for each run.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._places: dict[str, tuple[Path, int]] | None = None
        self._segment: Path | None = None
        if any(path.is_dir() for path in (self.folder / "runs").glob("??")):
            raise FileReadError(
                f"{folder} holds a sweep of an older version, one file for each run; it is left as it is:"
                " choose another folder, and the runs are computed again"
            )

    # ------------------------------------------------------------ one writer

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for writing; what a killed owner left behind is cleaned up and told.

        The lock is the kernel's, which ends with its process however that ends. The text in the file names
        the owner; text in a file that is not locked was left by a process that was killed.

        Raises:
            StoreLockedError: another process holds it.
            FileReadError: ``lock`` is not a regular file.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / "lock"
        if path.exists() and not path.is_file():
            raise FileReadError(f"{path} is not a regular file; remove it, or choose another folder")
        try:
            held = FileLock(path).acquire(blocking=False)
        except Timeout:
            raise StoreLockedError(str(self.folder), _owner(path) or "another process") from None
        with held:
            if killed := _owner(path):
                message = "the last sweep in %s (%s) was killed; its finished runs are kept"
                _LOG.warning(message, self.folder, killed)
            _write_owner(path, f"process {os.getpid()} on {socket.gethostname()}")
            try:
                self._clean_up()
                yield
            finally:
                _write_owner(path, "")

    def _clean_up(self) -> None:
        """Remove partial files, and copy damaged lines into ``quarantine/``."""
        for part in self.folder.rglob(".*"):
            if _PART.fullmatch(part.name):
                part.unlink()
        name = "quarantine/damaged.jsonl"
        aside = self.folder / name
        known = aside.read_bytes().split(b"\n") if aside.is_file() else []
        new = [line for line in self._index() if line not in known]
        if new:
            message = "%d damaged lines of %s are copied to %s; their runs are repeated"
            _LOG.warning(message, len(new), self.folder / "runs", aside)
            self._write(name, b"\n".join([*known, *new]))

    # ------------------------------------------------------------ runs

    def records(self) -> Iterator[Record]:
        """Yield all records in the order they were written; of several with one key the last is valid."""
        return (record for _, _, record in self._lines() if isinstance(record, Record))

    def _lines(self) -> Iterator[tuple[Path, int, Record | bytes]]:
        """Yield the segment, the offset and the record of every line, or its bytes if it is damaged."""
        for segment in sorted(path for path in (self.folder / "runs").glob("*.jsonl") if path.is_file()):
            offset = 0
            with segment.open("rb") as file:
                for line in file:
                    if content := line.strip():
                        yield segment, offset, _record(content)
                    offset += len(line)

    def _index(self) -> list[bytes]:
        """Note where the last record of each key is, and return the damaged lines."""
        damaged, self._places = [], {}
        for segment, offset, record in self._lines():
            if isinstance(record, Record):
                self._places[record.key] = segment, offset
            else:
                damaged.append(record)
        return damaged

    def read(self, key: str) -> Record | None:
        """Return the record of a run, or None if there is none that is whole."""
        if self._places is None:
            self._index()
        assert self._places is not None
        if key not in self._places:
            return None
        segment, offset = self._places[key]
        with segment.open("rb") as file:
            file.seek(offset)
            record = _record(file.readline().strip())
        return record if isinstance(record, Record) else None

    def append(self, outcomes: Sequence[Outcome]) -> None:
        """Store outcomes, first the full results that belong to them; one write and one sync for all.

        Raises:
            FileWriteError: the disk is full, or the folder cannot be written.
        """
        lines = []
        for record, result in outcomes:
            if result is not None:
                record = record._replace(result_digest=hashlib.sha256(result).hexdigest())
                self._write(str(self.result_path(record.key).relative_to(self.folder)), result)
            lines.append((record.key, b"\n%s\n" % record.to_line()))
        if not lines:
            return
        with _write_errors(self.folder / "runs"):
            segment = self._open_segment()
            with segment.open("ab", buffering=0) as file:
                offset = file.tell() + 1
                data = b"".join(line for _, line in lines)
                while data:
                    data = data[file.write(data) :]
                os.fsync(file.fileno())
        for key, line in lines:
            if self._places is not None:
                self._places[key] = segment, offset
            offset += len(line)

    def _open_segment(self) -> Path:
        """Return the segment of this session, or a new one if there is none or it is large.

        Two sessions that write at once, after the lock was removed by hand, do not share one.
        """
        if self._segment is None or self._segment.stat().st_size > _SEGMENT_BYTES:
            folder = self.folder / "runs"
            folder.mkdir(exist_ok=True, parents=True)
            last = max((int(path.stem) for path in folder.iterdir() if path.stem.isdecimal()), default=0)
            self._segment = folder / f"{last + 1:06}.jsonl"
            self._segment.open("xb").close()
        return self._segment

    # ------------------------------------------------------------ full results

    def result_path(self, key: str) -> Path:
        """Return the file of a full result."""
        return self.folder / "results" / key[:2] / f"{key}.nc"

    def has_result(self, record: Record) -> bool:
        """Return whether the full result of a run is stored and undamaged."""
        path = self.result_path(record.key)
        try:
            data = read_user_file(path, limit=_MAX_BYTES, kind="a result")
        except FileReadError:
            return False
        return bool(record.result_digest) and hashlib.sha256(data).hexdigest() == record.result_digest

    def read_result(self, record: Record) -> RunResult | None:
        """Return the full result of a run if it is stored and undamaged."""
        return RunResult.load(self.result_path(record.key)) if self.has_result(record) else None

    # ------------------------------------------------------------ the plan and tables

    def write_plan(self, plan: SweepPlan) -> None:
        """Write the plan, so that the folder can be read on its own."""
        self._write("plan.json", to_checksummed_json(plan.model_dump(mode="json")) + b"\n")

    def read_plan(self) -> SweepPlan:
        """Return the last plan.

        Raises:
            FileReadError: the folder is not that of a sweep, or its plan is damaged.
        """
        path = self.folder / "plan.json"
        if not path.exists():
            raise FileReadError(f"{self.folder} holds no sweep: there is no {path.name}")
        try:
            data = read_user_file(path, limit=_PLAN_BYTES, kind="the plan of a sweep")
            return SweepPlan(**from_checksummed_json(data.strip()))
        except (FileReadError, ScenarioError) as error:
            advice = "run the sweep's command again: finished runs are kept"
            raise FileReadError(f"{path} cannot be used ({error}); {advice}") from None

    def write_with(self, name: str, write: Callable[[Path], object]) -> None:
        """Write a file of the folder, complete or not at all.

        Raises:
            FileWriteError: the disk is full, or the folder cannot be written.
        """
        with _write_errors(self.folder / name):
            write_atomically(self.folder / name, write)

    def _write(self, name: str, data: bytes) -> None:
        self.write_with(name, lambda part: part.write_bytes(data))


def _record(line: bytes) -> Record | bytes:
    """Return the record of a line, or the line itself if it is damaged."""
    try:
        return Record.from_line(line)
    except FileReadError:
        return line


def _owner(path: Path) -> str:
    """Return the text in a lock file."""
    return path.read_text(errors="replace").strip() if path.is_file() else ""


def _write_owner(path: Path, text: str) -> None:
    """Write the owner's name; on a full disk the lock holds without it."""
    with contextlib.suppress(OSError):
        path.write_text(text)


_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the quota is used up",
    errno.EFBIG: "a file-size limit is reached",
}


@contextlib.contextmanager
def _write_errors(path: Path) -> Iterator[None]:
    """Raise one error for whatever hinders writing; HDF5 raises RuntimeError on a full disk."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = _REASONS.get(getattr(error, "errno", None) or 0) or getattr(error, "strerror", None)
        raise FileWriteError(str(path), reason or str(error)) from None
