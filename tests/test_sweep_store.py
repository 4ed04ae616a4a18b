"""Store of a sweep: records are complete or absent, damage is detected, one owner at a time, full disks."""

import errno
import multiprocessing
import os
import resource
import signal
import subprocess
import sys

import numpy as np
import pytest

from coop_pin.errors import DivergedError, FileReadError, FileWriteError, StoreLockedError
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.record import Failure, Record, from_checksummed_json, to_checksummed_json
from coop_pin.sweeps.store import FolderLock, SweepStore

KEY, OTHER = "ab" + 62 * "0", "cd" + 62 * "1"
NUMBERS = {"a": 1.0 / 3.0, "b": -5e-324, "c": float("inf"), "d": -float("inf"), "e": 1.7976931348623157e308}
RECORD = Record(KEY, '{"name": "a"}', NUMBERS, None, {"wall_s": 0.1, "cpu_s": 0.2})
FAILED = Record(
    OTHER,
    "",
    {},
    Failure("DivergedError", "it ran away: \u03b1 \u2192 \u221e", {"time": 0.5, "value": float("inf")}),
)


@pytest.fixture
def store(tmp_path):
    return SweepStore(tmp_path / "sweep")


# ---------------------------------------------------------------- records


@pytest.mark.parametrize("record", [RECORD, FAILED], ids=["finished", "failed"])
def test_a_record_reads_back_bit_for_bit(record):
    assert Record.from_bytes(record.to_bytes()) == record


def test_not_a_number_survives():
    assert np.isnan(Record.from_bytes(RECORD._replace(metrics={"a": float("nan")}).to_bytes()).metrics["a"])


@pytest.mark.parametrize("record", [RECORD, FAILED], ids=["finished", "failed"])
def test_any_flipped_bit_is_seen(record):
    data = record.to_bytes()
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        with pytest.raises(FileReadError):
            Record.from_bytes(bytes(damaged))


def test_any_cut_is_seen_and_so_are_other_files():
    data = RECORD.to_bytes()
    for end in range(len(data)):
        with pytest.raises(FileReadError):
            from_checksummed_json(data[:end])
    for foreign in (b"", b"{}", b"hello", 200 * b"\0", data + b"\n", to_checksummed_json({"key": KEY})):
        with pytest.raises(FileReadError):
            Record.from_bytes(foreign)


def test_a_failure_keeps_numbers_and_never_the_result():
    error = DivergedError(0.5, "speed", 1e4, 1e3)
    error.result = object()
    failure = Failure.of(error)
    assert failure.numbers == {"time": 0.5, "value": 1e4, "limit": 1e3}
    assert failure.kind == "DivergedError"
    assert failure.trace == ""
    assert "ZeroDivisionError" in Failure.of(ZeroDivisionError("x")).trace


# ---------------------------------------------------------------- the folder


def test_what_is_written_is_read_and_what_is_not_is_none(store):
    store.write(RECORD)
    store.write(FAILED)
    assert store.read(KEY) == RECORD
    assert store.read(OTHER) == FAILED
    assert store.read(64 * "e") is None


def test_a_damaged_record_is_moved_aside_and_kept_there(store):
    for count in range(2):
        store.write(RECORD)
        path = store.record_path(KEY)
        damaged = path.read_bytes().replace(b"0.333", b"0.334")
        path.write_bytes(damaged)
        with pytest.raises(FileReadError):
            store.read(KEY)
        assert store.read_or_quarantine(KEY) is None
        assert not path.exists()
        aside = sorted((store.folder / "quarantine").iterdir())
        assert len(aside) == count + 1
        assert aside[0].read_bytes() == damaged


def test_a_record_under_another_key_is_foreign(store):
    store.write(RECORD)
    path = store.record_path(OTHER)
    path.parent.mkdir(parents=True)
    path.write_bytes(RECORD.to_bytes())
    assert store.read_or_quarantine(OTHER) is None
    assert store.read(KEY) == RECORD


def test_a_kept_result_must_be_whole(store):
    store.write(RECORD, b"netcdf")
    record = store.read_or_quarantine(KEY, with_result=True)
    assert record is not None
    store.result_path(KEY).write_bytes(b"netcdg")
    assert store.read_or_quarantine(KEY, with_result=True) is None
    assert store.read_or_quarantine(KEY) == record
    assert [file.suffix for file in (store.folder / "quarantine").iterdir()] == [".nc"]


def test_clean_up_removes_parts_moves_foreign_files_and_touches_no_record(store):
    store.write(RECORD, b"netcdf")
    part = store.record_path(KEY).with_name(f".{KEY}.{32 * 'a'}.json")
    part.write_bytes(b"half")
    foreign = [
        store.record_path(KEY).with_name("notes.txt"),
        store.folder / "runs" / "readme",
        store.folder / "runs" / "ab" / f"{OTHER}.json",
    ]
    for file in foreign:
        file.write_text("mine")
    assert store.clean_up() == len(foreign)
    assert not part.exists()
    assert not any(file.exists() for file in foreign)
    assert len(list((store.folder / "quarantine").iterdir())) == len(foreign)
    assert store.read_or_quarantine(KEY, with_result=True) is not None
    assert store.clean_up() == 0


def test_the_plan_is_kept_and_its_damage_seen(store):
    with pytest.raises(FileReadError, match="holds no sweep"):
        store.read_plan()
    plan = SweepPlan(base="adept-paper", axes={"controller.gains.sign_gain": [0.0, 0.1]})
    store.write_plan(plan)
    assert store.read_plan() == plan
    path = store.folder / "plan.json"
    path.write_bytes(path.read_bytes().replace(b"0.1", b"0.7", 1))
    with pytest.raises(FileReadError, match="run the sweep's command again"):
        store.read_plan()


# ---------------------------------------------------------------- full disks


def test_a_full_disk_is_a_typed_error_and_costs_nothing_written_before(store, monkeypatch):
    store.write(RECORD)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", full)
        for record in (FAILED, RECORD._replace(metrics={"a": 2.0})):
            with pytest.raises(FileWriteError, match="the disk is full"):
                store.write(record)
    assert store.read(KEY) == RECORD
    assert store.read(OTHER) is None
    assert [file.name for file in store.folder.rglob("*") if file.is_file()] == [f"{KEY}.json"]


def _write_big(folder, queue):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
    try:
        SweepStore(folder).write(RECORD, 10000 * b"x")
    except FileWriteError as error:
        queue.put(str(error))


def test_a_real_file_size_limit_leaves_no_half_file(store):
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    process = context.Process(target=_write_big, args=(store.folder, queue))
    process.start()
    assert "file-size limit" in queue.get(timeout=60)
    process.join()
    assert [file for file in store.folder.rglob("*") if file.is_file()] == []


# ---------------------------------------------------------------- one owner


def test_a_second_owner_is_refused_and_told_who_the_first_is(tmp_path):
    with FolderLock(tmp_path) as lock:
        assert lock.killed_owner == ""
        with pytest.raises(StoreLockedError, match=f"process {os.getpid()} on ") as refused:
            FolderLock(tmp_path).__enter__()
        assert str(os.getpid()) in refused.value.owner
    with FolderLock(tmp_path) as lock:
        assert lock.killed_owner == ""


HOLD = """
import sys, time
from pathlib import Path
from coop_pin.sweeps.store import FolderLock
with FolderLock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_the_lock_of_a_killed_owner_is_stale_and_said_to_be(tmp_path):
    owner = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE)
    assert owner.stdout.readline() == b"held\n"
    with pytest.raises(StoreLockedError, match=str(owner.pid)):
        FolderLock(tmp_path).__enter__()
    owner.kill()
    owner.wait()
    owner.stdout.close()
    with FolderLock(tmp_path) as lock:
        assert f"process {owner.pid} " in lock.killed_owner + " "
