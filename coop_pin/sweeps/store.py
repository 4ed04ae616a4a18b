"""Store of a sweep: a folder with one file for each run, found by its key, and the lock of its writer."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import logging
import os
import re
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from coop_pin.errors import FileReadError, FileWriteError, ScenarioError, StoreLockedError
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.record import Record, from_checksummed_json, to_checksummed_json
from coop_pin.user_files import read_user_file


class FolderLock:
    """Lock of a folder, held while the ``with`` block runs.

    It is a kernel lock (flock), which ends with its process however that ends. The text in the file names the
    owner; text in a file that is not locked was left by a process that was killed.

    Attributes:
        killed_owner: the previous owner if it was killed, otherwise empty.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "lock"
        self._file: IO[str] | None = None
        self.killed_owner = ""

    def __enter__(self) -> Self:
        """Take the lock.

        Raises:
            StoreLockedError: another process holds it.
        """
        self._path.parent.mkdir(parents=True, exist_ok=True)
        file = self._path.open("a+", encoding="utf-8")
        file.seek(0)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = file.read().strip() or "another process"
            file.close()
            raise StoreLockedError(str(self._path.parent), owner) from None
        self.killed_owner = file.read().strip()
        self._file = file
        self._write(f"process {os.getpid()} on {socket.gethostname()}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._write("")
            # Closing unlocks. The file stays: removing it would let two owners lock two files.
            self._file.close()
            self._file = None

    def _write(self, text: str) -> None:
        """Write the owner's name; on a full disk the lock holds without it."""
        assert self._file is not None
        with contextlib.suppress(OSError):
            os.ftruncate(self._file.fileno(), 0)
            os.pwrite(self._file.fileno(), text.encode(), 0)


_MAX_BYTES = 2**32
"""Size limit of each file; one hour of two arms at 80 Hz has 0.4 GB."""
_LOG = logging.getLogger("coop_pin.sweeps")
_RECORD = re.compile(r"[0-9a-f]{64}\.json")
_RESULT = re.compile(r"[0-9a-f]{64}\.nc")
_PART = re.compile(r"\.[0-9a-f]{64}\.[0-9a-f]{32}\.(json|nc)")


class SweepStore:
    """Folder that stores the runs of a sweep.

    ``runs/ab/ab....json`` is the record of the run with that key, ``results/ab/ab....nc`` its full result if
    it was requested, ``quarantine/`` holds damaged and foreign files, ``plan.json`` the last plan.

    Attributes:
        folder: the folder.
        lock: held by the process that writes; readers do not need it.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.lock = FolderLock(self.folder)

    # ------------------------------------------------------------ runs

    def record_path(self, key: str) -> Path:
        """Return the file of a record."""
        return self.folder / "runs" / key[:2] / f"{key}.json"

    def result_path(self, key: str) -> Path:
        """Return the file of a full result."""
        return self.folder / "results" / key[:2] / f"{key}.nc"

    def read(self, key: str) -> Record | None:
        """Return the record of a run, or None if there is none.

        Raises:
            FileReadError: the file is damaged or foreign.
        """
        path = self.record_path(key)
        if not os.path.lexists(path):
            return None
        record = Record.from_bytes(read_user_file(path, limit=_MAX_BYTES, kind="a record of a run"))
        if record.key != key:
            raise FileReadError(f"{path} holds the record of another run")
        return record

    def read_or_quarantine(self, key: str, *, with_result: bool = False) -> Record | None:
        """Return the record of a run; damaged files are moved to ``quarantine/``, and the run is repeated.

        Args:
            key: of the run.
            with_result: whether the full result is needed as well.

        Returns:
            None if the record, or a needed result, is missing or damaged.
        """
        try:
            record = self.read(key)
        except FileReadError as error:
            self._quarantine(self.record_path(key))
            _LOG.warning("a run is repeated: %s; its file was moved to quarantine", error)
            return None
        if record is None or not with_result or record.failure is not None or self._has_result(record):
            return record
        self._quarantine(self.result_path(key))
        return None

    def write(self, record: Record, result: bytes | None = None) -> None:
        """Write a record, and first the full result that belongs to it.

        Raises:
            FileWriteError: the disk is full, or the folder cannot be written.
        """
        if result is not None:
            record = record._replace(result_digest=hashlib.sha256(result).hexdigest())
            self._write(self.result_path(record.key), result)
        self._write(self.record_path(record.key), record.to_bytes())

    def read_result(self, record: Record) -> RunResult | None:
        """Return the full result of a run if it is stored and undamaged."""
        return RunResult.load(self.result_path(record.key)) if self._has_result(record) else None

    def _has_result(self, record: Record) -> bool:
        try:
            data = read_user_file(self.result_path(record.key), limit=_MAX_BYTES, kind="a result")
        except FileReadError:
            return False
        return bool(record.result_digest) and hashlib.sha256(data).hexdigest() == record.result_digest

    # ------------------------------------------------------------ the plan and tables

    def write_plan(self, plan: SweepPlan) -> None:
        """Write the plan, so that the folder can be read on its own."""
        self._write(self.folder / "plan.json", to_checksummed_json(plan.model_dump(mode="json")))

    def read_plan(self) -> SweepPlan:
        """Return the last plan.

        Raises:
            FileReadError: the folder is not that of a sweep, or its plan is damaged.
        """
        path = self.folder / "plan.json"
        if not os.path.lexists(path):
            raise FileReadError(f"{self.folder} holds no sweep: there is no {path.name}")
        try:
            content = from_checksummed_json(read_user_file(path, limit=_MAX_BYTES, kind="a plan"))
            return SweepPlan(**content)
        except (FileReadError, ScenarioError) as error:
            raise FileReadError(
                f"{path} cannot be used ({error}); run the sweep's command again: finished runs are kept"
            ) from None

    def write_with(self, name: str, write: Callable[[Path], object]) -> None:
        """Write a file of the folder, complete or not at all.

        Raises:
            FileWriteError: the disk is full, or the folder cannot be written.
        """
        path = self.folder / name
        try:
            write_atomically(path, write)
        except OSError as error:
            raise FileWriteError(str(path), _reason(error)) from None
        except RuntimeError as error:  # HDF5 raises it when it closes a file on a full disk
            raise FileWriteError(str(path), str(error)) from None

    def _write(self, path: Path, data: bytes) -> None:
        self.write_with(str(path.relative_to(self.folder)), lambda part: part.write_bytes(data))

    # ------------------------------------------------------------ foreign files

    def clean_up(self) -> int:
        """Remove partial files and quarantine foreign ones; only for the owner of the lock.

        Returns:
            The number of files moved to ``quarantine/``.
        """
        moved = 0
        for file, known in self._files():
            if _PART.fullmatch(file.name):
                file.unlink()
            elif not known.fullmatch(file.name) or file.name[:2] != file.parent.name:
                moved += self._quarantine(file)
        return moved

    def _files(self) -> Iterator[tuple[Path, re.Pattern[str]]]:
        for name, known in (("runs", _RECORD), ("results", _RESULT)):
            for shard in sorted((self.folder / name).glob("*")):
                if shard.is_dir() and len(shard.name) == 2:
                    yield from ((file, known) for file in sorted(shard.iterdir()))
                else:
                    yield shard, known

    def _quarantine(self, file: Path) -> bool:
        """Move a file to ``quarantine/`` under a free name, and return whether there was one."""
        if not (file.exists() or file.is_symlink()):
            return False
        target, count = self.folder / "quarantine" / file.name, 1
        while target.exists():
            target, count = target.with_name(f"{file.stem}.{count}{file.suffix}"), count + 1
        try:
            target.parent.mkdir(exist_ok=True)
            file.rename(target)
        except OSError as error:
            raise FileWriteError(str(target), _reason(error)) from None
        return True


def _reason(error: OSError) -> str:
    texts = {
        errno.ENOSPC: "the disk is full",
        errno.EDQUOT: "the quota is used up",
        errno.EFBIG: "a file-size limit is reached",
    }
    return texts.get(error.errno or 0, os.strerror(error.errno) if error.errno else str(error))
