"""Store of a sweep: records are complete or absent, damage is detected, one owner at a time, full disks."""

import errno
import os
import resource
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import coop_pin as cp
from coop_pin.base.errors import DivergedError, FileReadError, FileWriteError, StoreLockedError
from coop_pin.results.netcdf import to_netcdf
from coop_pin.sweeps.engine import sweep
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.job import JobRecord, Outcome, StoredRun, checked_content, checksummed

KEY, OTHER = "ab" + 62 * "0", "cd" + 62 * "1"
NUMBERS = {"a": 1.0 / 3.0, "b": -5e-324, "c": float("inf"), "d": -float("inf"), "e": 1.7976931348623157e308}
RECORD = JobRecord(KEY, {"name": "a"}, NUMBERS, wall_s=0.1, cpu_s=0.2)
FAILED = JobRecord(OTHER, {}, {}, "DivergedError", "it ran away: \u03b1 \u2192 \u221e", 0.5)


@pytest.fixture
def store(tmp_path):
    return SweepStore(tmp_path / "sweep")


# ---------------------------------------------------------------- records


@pytest.mark.parametrize("record", [RECORD, FAILED], ids=["finished", "failed"])
def test_a_record_reads_back_bit_for_bit(record):
    assert JobRecord.from_line(record.to_line()) == record


def test_not_a_number_survives():
    assert np.isnan(JobRecord.from_line(replace(RECORD, metrics={"a": float("nan")}).to_line()).metrics["a"])


@pytest.mark.parametrize("record", [RECORD, FAILED], ids=["finished", "failed"])
def test_any_flipped_bit_is_seen(record):
    data = record.to_line()
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        with pytest.raises(FileReadError):
            JobRecord.from_line(bytes(damaged))


@pytest.mark.parametrize("record", [RECORD, FAILED], ids=["finished", "failed"])
def test_what_tells_whether_a_run_is_known_is_read_as_the_record_is(record):
    data = record.to_line()
    assert StoredRun.from_line(data) == StoredRun(record.key, record.failure)
    for place in range(0, len(data), 7):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        with pytest.raises(FileReadError):
            StoredRun.from_line(bytes(damaged))
    for foreign in (
        b"",
        b"{}",
        data[:-1],
        checksummed(b'{"kay": "ab"}'),
        checksummed(b"{"),
        checksummed(b""),
    ):
        with pytest.raises(FileReadError):
            StoredRun.from_line(foreign)


def test_any_cut_is_seen_and_so_are_other_files():
    data = RECORD.to_line()
    for end in range(len(data)):
        with pytest.raises(FileReadError):
            checked_content(data[:end])
    for foreign in (
        b"",
        b"{}",
        b"hello",
        200 * b"\0",
        data + b"\n",
        checksummed(b'{"kay": "ab"}'),
        checksummed(b"[1]"),
        checksummed(b"{"),
    ):
        with pytest.raises(FileReadError):
            JobRecord.from_line(foreign)


def test_a_failure_keeps_numbers_and_never_the_result():
    error = DivergedError(0.5, "speed", 1e4, 1e3)
    error.result = object()
    record = JobRecord.of_failure(KEY, {}, error)
    assert record == JobRecord(KEY, {}, {}, "DivergedError", str(error), 0.5)
    assert "ZeroDivisionError" in JobRecord.of_failure(KEY, {}, ZeroDivisionError("x")).trace


# ---------------------------------------------------------------- the folder


def segments(store):
    return sorted((store.folder / "runs").iterdir())


def many(count):
    return [Outcome(JobRecord(f"{i:064x}", {"gain": i}, {"a": float(i)})) for i in range(count)]


def keys(store):
    return {record.key for record in SweepStore(store.folder).records()}


def test_what_is_written_is_read_and_what_is_not_is_none(store):
    store.append([Outcome(RECORD), Outcome(FAILED)])
    for reader in (store, SweepStore(store.folder)):
        with reader.locked():
            assert reader.known == {KEY: "", OTHER: "DivergedError"}
        assert list(reader.records()) == [RECORD, FAILED]


def test_of_two_records_of_a_run_the_last_is_valid_in_the_same_session_and_the_next(store):
    store.append([Outcome(replace(FAILED, key=KEY))])
    assert store.known == {KEY: "DivergedError"}
    store.append([Outcome(RECORD)])
    assert store.known == {KEY: ""}
    SweepStore(store.folder).append([Outcome(replace(RECORD, metrics={"a": 2.0}))])
    assert len(segments(store)) == 2
    later = SweepStore(store.folder)
    with later.locked():
        assert later.known == {KEY: ""}
    assert [record.metrics for record in later.records()][-1] == {"a": 2.0}


def test_a_hundred_thousand_runs_make_few_files_and_one_sync_a_batch(store, monkeypatch):
    synced, original = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: synced.append(fd) or original(fd))
    runs = many(2000)
    for start in range(0, len(runs), 100):
        store.append(runs[start : start + 100])
    assert len(synced) == 20
    assert len(segments(store)) == 1
    assert len(keys(store)) == len(runs)


def test_a_flipped_bit_costs_at_most_the_run_that_it_hits(store):
    """Within a record, at its ends, and between two."""
    runs = many(3)
    store.append(runs)
    (segment,) = segments(store)
    whole, known = segment.read_bytes(), {outcome.record.key for outcome in runs}
    ends = [place for place, sign in enumerate(whole) if sign in b"\n{}"]
    for place in sorted({*range(0, len(whole), 11), *ends}):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (place % 8)
        segment.write_bytes(damaged)
        kept = keys(store)
        assert len(kept) >= len(known) - 1
        assert kept <= known


def test_a_cut_segment_costs_the_run_that_was_being_written_and_later_ones_are_added_behind_it(store):
    runs = many(4)
    store.append(runs[:3])
    (segment,) = segments(store)
    whole = segment.read_bytes()
    for end in range(0, len(whole), 17):
        segment.write_bytes(whole[:end])
        assert len(keys(store)) == whole[: end + 1].count(b"}}\n")
    segment.write_bytes(whole[:-5])
    with SweepStore(store.folder).locked():
        pass
    later = SweepStore(store.folder)
    later.append(runs[3:])
    assert keys(store) == {runs[i].record.key for i in (0, 1, 3)}


def test_damaged_lines_are_set_aside_once_and_stay_where_they_are(store, caplog):
    store.append(many(5))
    (segment,) = segments(store)
    damaged = segment.read_bytes().replace(b'"a":3.0', b'"a":3.5')
    segment.write_bytes(damaged)
    for _ in range(2):
        with SweepStore(store.folder).locked():
            pass
        assert segment.read_bytes() == damaged
        (aside,) = (store.folder / "quarantine").iterdir()
        (line,) = aside.read_bytes().splitlines()
        assert b'"a":3.5' in line
    assert sum("1 damaged line" in message for message in caplog.messages) == 1
    assert len(keys(store)) == 4


def test_two_writers_at_once_after_the_lock_was_removed_by_hand_lose_nothing(store):
    runs, other = many(40), SweepStore(store.folder)
    with store.locked():
        (store.folder / "lock").unlink()
        with other.locked():
            for i in range(0, 40, 4):
                store.append(runs[i : i + 2])
                other.append(runs[i + 2 : i + 4])
    assert len(segments(store)) == 2
    assert keys(store) == {outcome.record.key for outcome in runs}


def test_a_kept_result_must_be_whole(store):
    result = cp.run("adept-paper", {"duration": 0.05, "events": []}, warn=False)
    content = bytes(to_netcdf(result.data, result.scenario.to_toml()))
    store.append([Outcome(RECORD, content)])
    assert store.read_result(KEY).data.identical(result.data)
    assert store.read_result(OTHER) is None
    (path,) = store.folder.rglob("*.nc")
    for damaged in (
        content[: len(content) // 2],
        content[:-99] + bytes([content[-99] ^ 1]) + content[-98:],
        b"",
    ):
        path.write_bytes(damaged)
        assert store.read_result(KEY) is None
    assert list(store.records()) == [RECORD]


def test_partial_files_of_a_killed_owner_are_removed_and_foreign_files_left_alone(store):
    store.append([Outcome(RECORD, b"netcdf")])
    (result,) = store.folder.rglob("*.nc")
    part = result.with_name(f".{KEY}.{32 * 'a'}.nc")
    foreign = [store.folder / "runs" / "notes.txt", store.folder / ".hidden", store.folder / "results" / "me"]
    for file in (part, *foreign):
        file.write_bytes(b"half")
    with store.locked():
        assert not part.exists()
    assert all(file.exists() for file in (*foreign, result))


def test_pipes_and_devices_in_the_folder_hang_nothing(store):
    store.append([Outcome(RECORD)])
    for name in ("runs/000000.jsonl", "runs/000002.jsonl", "quarantine/pipe", "table.csv"):
        (store.folder / name).parent.mkdir(exist_ok=True)
        os.mkfifo(store.folder / name)
    (store.folder / "runs" / "000003.jsonl").symlink_to("/dev/zero")
    later = SweepStore(store.folder)
    with later.locked():
        later.append([Outcome(FAILED)])
    assert keys(store) == {KEY, OTHER}
    assert segments(store)[-1].name == "000004.jsonl"
    os.mkfifo(store.folder / "plan.json")
    with pytest.raises(FileReadError, match="no regular file"):
        store.read_plan()
    (store.folder / "lock").unlink()
    os.mkfifo(store.folder / "lock")
    with pytest.raises(FileReadError, match="not a regular file"), store.locked():
        pass


def test_a_folder_of_an_older_version_is_refused_with_words_and_left_alone(store):
    old = store.folder / "runs" / "ab" / f"{KEY}.json"
    old.parent.mkdir(parents=True)
    old.write_text("{}")
    for use in (
        SweepStore,
        SweepResult.load,
        lambda folder: sweep("adept-paper", out=folder, execution=cp.Execution(workers=0)),
    ):
        with pytest.raises(FileReadError, match="older version"):
            use(store.folder)
    assert [path for path in store.folder.rglob("*") if path.is_file()] == [old]


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
    store.append([Outcome(RECORD)])

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", full)
        for record in (FAILED, replace(RECORD, metrics={"a": 2.0})):
            with pytest.raises(FileWriteError, match="No space left"):
                store.append([Outcome(record, b"netcdf")])
    assert store.known == {KEY: ""}
    assert [file.name for file in store.folder.rglob("*") if file.is_file()] == ["000001.jsonl"]


def test_a_real_file_size_limit_leaves_whole_records_and_no_half_file(store):
    assert signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        store.append(many(5))
        for runs in ([Outcome(RECORD, 10000 * b"x")], many(60)):
            with pytest.raises(FileWriteError, match="File too large"):
                store.append(runs)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert {file.name for file in store.folder.rglob("*") if file.is_file()} == {"000001.jsonl"}
    assert {f"{i:064x}" for i in range(5)} <= keys(store) <= {f"{i:064x}" for i in range(60)}


# ---------------------------------------------------------------- one owner


def test_a_second_owner_is_refused_and_told_who_the_first_is(store, caplog):
    for _ in range(2):
        with store.locked():
            with pytest.raises(StoreLockedError, match=f"process {os.getpid()} on ") as refused:
                SweepStore(store.folder).locked().__enter__()
            assert str(os.getpid()) in refused.value.owner
    assert (store.folder / "lock").read_text() == ""
    assert not caplog.messages


HOLD = """
import sys, time
from coop_pin.sweeps.store import SweepStore
with SweepStore(sys.argv[1]).locked():
    print("held", flush=True)
    time.sleep(600)
"""


def test_the_lock_of_a_killed_owner_is_stale_and_said_to_be(store, caplog):
    owner = subprocess.Popen([sys.executable, "-c", HOLD, str(store.folder)], stdout=subprocess.PIPE)
    assert owner.stdout.readline() == b"held\n"
    with pytest.raises(StoreLockedError, match=str(owner.pid)), store.locked():
        pass
    owner.kill()
    owner.wait()
    owner.stdout.close()
    with store.locked():
        (message,) = caplog.messages
    assert f"process {owner.pid} " in message


# ---------------------------------------------------------------- records of other folders


def test_records_of_another_folder_are_taken_by_key_but_for_damaged_and_passing_ones(store, tmp_path):
    third = "ef" + 62 * "2"
    late = replace(FAILED, key=third, failure="RunTimeoutError")
    mine, theirs = replace(RECORD, metrics={"a": 2.0}), SweepStore(tmp_path / "theirs")
    with theirs.locked():
        theirs.append([Outcome(RECORD), Outcome(FAILED), Outcome(late)])
    with store.locked():
        store.append([Outcome(mine)])
        store.append(list(map(Outcome, store.missing_of(theirs, [KEY, OTHER, third]).values())))
        assert set(store.known) == {KEY, OTHER}
    assert list(store.records()) == [mine, replace(FAILED, changes={}, merged=True)]

    segment = next((theirs.folder / "runs").iterdir())
    segment.write_bytes(segment.read_bytes().replace(b"it ran away", b"it ran awry"))
    empty = SweepStore(tmp_path / "empty")
    with empty.locked():
        assert set(empty.missing_of(theirs, [KEY, OTHER])) == {KEY}
    with store.locked(), pytest.raises(FileReadError):
        store.missing_of(SweepStore(tmp_path / "nowhere"), [KEY])
