"""Files of strangers: folders that are merged, tables of gains, and the cache of compiled code."""

import dataclasses
import json
import logging
import os
import re
import shutil
import stat
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import coop_pin as cp
from coop_pin.base import disk_cache
from coop_pin.base.errors import FileReadError
from coop_pin.base.user_files import printable
from coop_pin.comparison.controllers import stored_gains
from coop_pin.compiled.laws.c_export import export_c
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.job import JobRecord, checked_content, checksummed

GAIN = "controller.gains.sign_gain"
ESCAPES = "\x1b]0;pwned\x07\x1b[2J\u202egnp.exe\x9b31m"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
HERE = cp.Execution(workers=0, quiet=True)


def swept(folder, *merge, recompute=0):
    changes = {"duration": 0.02, "events": []}
    execution = dataclasses.replace(HERE, merge=merge, recompute=recompute)
    return cp.sweep(
        "adept-paper",
        {GAIN: [0.0, 0.1]},
        out=folder,
        changes=changes,
        engine="pinocchio",
        execution=execution,
    )


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    return swept(tmp_path_factory.mktemp("honest"))


@pytest.fixture
def theirs(honest, tmp_path):
    """Return a folder of somebody else with the runs of ``honest``."""
    return shutil.copytree(honest.store.folder, tmp_path / "theirs")


def segment_of(folder):
    (segment,) = (folder / "runs").iterdir()
    return segment


def forge(folder, change):
    """Change each record, as JSON, with the right checksum."""
    lines = filter(None, segment_of(folder).read_bytes().splitlines())
    contents = [json.loads(checked_content(line)) for line in lines]
    for content in contents:
        change(content)
    forged = [checksummed(json.dumps(content).encode()) for content in contents]
    segment_of(folder).write_bytes(b"".join(b"\n%s\n" % line for line in forged))


def metric(name):
    return lambda record: record["metrics"].update({name: 1.0})


def text(field, value, *, failed=True):
    def change(record):
        if failed:
            record["metrics"], record["failure"] = {}, "DivergedError"
        record[field] = value

    return change


REFUSED = {
    "a metric like a column": metric("status"),
    "a metric like another column": metric("merged"),
    "a metric like a varied field": metric(GAIN),
    "1001 metrics": lambda record: record["metrics"].update({f"m{i}": 0.0 for i in range(1001)}),
    "100 000 metrics": lambda record: record["metrics"].update({f"m{i}": 0.0 for i in range(100_000)}),
    "a metric with escapes": metric(ESCAPES),
    "a metric of two lines": metric("a\nb"),
    "a metric with a mark of direction": metric("\u202eba"),
    "a metric with a long name": metric("n" * 100_000),
    "a metric without a name": metric(""),
    "no metrics": lambda record: record["metrics"].clear(),
    "metrics and an error": text("failure", "DivergedError", failed=False),
    "a formula as the error": text("failure", "=cmd|'/c calc'!A1"),
    "an error with escapes": text("failure", "Error" + ESCAPES),
    "a long error": text("failure", "E" * 100_000),
}
"""Forged records: nothing of the folder is stored."""


def segment_with(content):
    return lambda folder: segment_of(folder).write_bytes(content)


def sparse(folder):
    with segment_of(folder).open("wb") as file:
        file.truncate(20 << 30)


def in_place(make):
    """Put something else in the place of the segment."""

    def change(folder):
        segment = segment_of(folder)
        segment.unlink()
        make(segment)

    return change


def forged(change):
    return lambda folder: forge(folder, change)


WITHOUT_EFFECT = {
    "a sparse segment of 20 GB": sparse,
    "a line of 17 MB": segment_with(b"x" * (17 << 20) + b"\n"),
    "a pipe": in_place(os.mkfifo),
    "a folder": in_place(os.mkdir),
    "an endless device": in_place(lambda path: path.symlink_to("/dev/zero")),
    "a link to itself": in_place(lambda path: path.symlink_to(path)),
    "zeros": segment_with(bytes(1 << 20)),
    "no UTF-8": segment_with(b"\xff\xfe\n" * 1000),
    "nesting": segment_with(checksummed(b"[" * 100_000) + b"\n"),
    "a wrong checksum": lambda folder: segment_with(
        segment_of(folder).read_bytes().replace(b"torque_peak", b"torque_pe4k")
    )(folder),
    "a metric that is a text": forged(lambda record: record["metrics"].update(a="x")),
    "an integer of 5000 digits": segment_with(checksummed(b'{"key": ' + b"9" * 5000 + b"}") + b"\n"),
}
"""Damaged folders: what is in them counts as missing."""

SHOWN = {
    "escapes in a message": text("message", ESCAPES),
    "a message of 12 MB": text("message", "m" * 12_000_000),
    "escapes in a trace": text("trace", ESCAPES),
    "escapes in an engine": text("engine", ESCAPES),
    "large changes": text("changes", {"x" * 1000: [0.0] * 100_000}),
    "escapes in changes": text("changes", {ESCAPES: ESCAPES}),
}
"""Records that may be true: taken over, bounded and fit to print."""


def require_clean(folder, *texts):
    for path in folder.rglob("*"):
        if path.suffix in {".csv", ".json", ".jsonl", ".html"}:
            content = path.read_bytes().decode()
            assert not CONTROL.search(content.replace("\\r", ""))
            assert "\\u001b" not in content
            assert len(content) < 100_000
    for said in texts:
        assert not CONTROL.search(said)


@pytest.mark.parametrize("kind", REFUSED)
def test_a_folder_with_a_forged_record_is_refused_and_leaves_nothing(honest, theirs, tmp_path, kind):
    forge(theirs, REFUSED[kind])
    with pytest.raises(FileReadError) as caught:
        swept(tmp_path / "mine", theirs)
    assert caught.value.path == str(theirs)
    assert len(str(caught.value)) < 2000
    require_clean(tmp_path / "mine", str(caught.value))
    assert not list(SweepStore(tmp_path / "mine").records())
    assert swept(tmp_path / "mine").data.equals(honest.data)


@pytest.mark.parametrize("kind", WITHOUT_EFFECT)
def test_what_is_no_record_of_others_counts_as_missing(honest, theirs, tmp_path, kind):
    WITHOUT_EFFECT[kind](theirs)
    assert swept(tmp_path / "mine", theirs).data.equals(honest.data)


@pytest.mark.parametrize("kind", SHOWN)
def test_texts_of_others_are_bounded_and_cannot_steer_a_terminal(theirs, tmp_path, kind, caplog):
    forge(theirs, SHOWN[kind])
    with caplog.at_level(logging.WARNING):
        result = swept(tmp_path / "mine", theirs)
    assert result.table["merged"].tolist() == [1.0, 1.0]
    result.write_html(tmp_path / "mine" / "page.html")
    require_clean(tmp_path / "mine", result.summary(), *caplog.messages)
    assert all(not record.changes for record in result.store.records())


def test_a_sample_of_the_runs_of_others_is_repeated_before_any_is_stored(honest, theirs, tmp_path):
    merged = swept(tmp_path / "mine", theirs, recompute=5)
    assert merged.table["merged"].tolist() == [1.0, 1.0]
    assert merged.data.drop_vars("merged").equals(honest.data.drop_vars("merged"))

    forge(theirs, lambda record: record["metrics"].update(torque_peak_Nm=1.0))
    assert swept(tmp_path / "trusting", theirs).table["torque_peak_Nm"].tolist() == [1.0, 1.0]
    for is_left_out in (False, True):
        if is_left_out:
            forge(theirs, lambda record: record["metrics"].pop("torque_peak_Nm"))
        with pytest.raises(FileReadError, match="torque_peak_Nm"):
            swept(tmp_path / "careful", theirs, recompute=1)
        assert not list(SweepStore(tmp_path / "careful").records())


def test_a_run_whose_scenario_has_mistakes_is_merged_and_not_repeated(tmp_path):
    plan = {"axes": {"cell.payload.mass": [5.0, -1.0]}, "changes": {"duration": 0.02, "events": []}}
    theirs = cp.sweep("adept-paper", **plan, out=tmp_path / "theirs", execution=HERE)
    careful = dataclasses.replace(HERE, merge=(theirs.store.folder,), recompute=2)
    mine = cp.sweep("adept-paper", **plan, out=tmp_path / "mine", execution=careful)
    assert mine.counts() == theirs.counts() == {"ok": 1, "failed": 1, "missing": 0}
    assert mine.table["merged"].tolist() == [1.0, 1.0]


def test_the_order_of_control_characters_is_not_lost():
    assert printable("a\tb\nc: 0.1 \u00b5m") == "a\tb\nc: 0.1 \u00b5m"
    assert printable("a\x1b[2J\r\u202e\ud800") == "a\\x1b[2J\\r\\u202e\\ud800"
    assert len(printable("x" * 10**6)) < 10_100


def test_records_of_runs_of_before_are_not_merged_ones():
    line = JobRecord("ab" * 32, metrics={"a": 1.0}).to_line()
    content = json.loads(checked_content(line))
    del content["merged"]
    assert not JobRecord.from_line(checksummed(json.dumps(content).encode())).merged


def test_a_long_line_in_a_table_of_gains_is_refused_with_its_number(tmp_path):
    path = tmp_path / "gains.csv"
    path.write_text("scenario,controller,field,value\n" + "x" * 200_000 + "\n")
    with pytest.raises(FileReadError) as caught:
        stored_gains("adept-paper", path)
    assert (caught.value.path, caught.value.line) == (str(path), 2)
    assert len(str(caught.value)) < 500


def test_a_folder_like_a_partial_file_and_a_lock_that_is_a_link_are_left_alone(tmp_path):
    strange = tmp_path / "mine" / f".x.{32 * 'a'}"
    strange.mkdir(parents=True)
    swept(tmp_path / "mine")
    assert strange.is_dir()
    target = tmp_path / "target"
    target.write_text("mine")
    (tmp_path / "mine" / "lock").unlink()
    (tmp_path / "mine" / "lock").symlink_to(target)
    with pytest.raises(FileReadError):
        swept(tmp_path / "mine")
    assert target.read_text() == "mine"


# ---------------------------------------------------------------- compiled code

KEY, CODE = bytes(range(32)), b"code" * 100


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "coop_pin" / "compiled"


@pytest.mark.parametrize("caches", ["", "caches", "./x"])
def test_a_relative_folder_of_caches_is_not_followed_and_no_home_keeps_nothing(caches, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", caches)
    monkeypatch.setenv("HOME", "")
    disk_cache.keep(KEY, CODE)
    assert disk_cache.kept(KEY) is None
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    disk_cache.keep(KEY, CODE)
    assert disk_cache.kept(KEY) == CODE
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


def test_a_user_without_a_home_is_no_error(monkeypatch):
    def nobody(*_arguments):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(Path, "home", nobody)
    disk_cache.keep(KEY, CODE)
    assert disk_cache.kept(KEY) is None


@pytest.mark.parametrize("kind", ["pipe", "folder", "sparse", "cut", "others", "link to a device"])
def test_what_is_no_compiled_code_of_this_user_is_neither_run_nor_waited_for(cache, kind):
    disk_cache.keep(KEY, CODE)
    path = cache / f"{KEY.hex()}.o"
    if kind in {"pipe", "folder", "link to a device"}:
        path.unlink()
        {"pipe": os.mkfifo, "folder": os.mkdir}.get(kind, lambda place: place.symlink_to("/dev/zero"))(path)
    elif kind == "sparse":
        os.truncate(path, 2 << 30)
    elif kind == "cut":
        path.write_bytes(path.read_bytes()[:-1])
    else:
        path.chmod(0o666)
    assert disk_cache.kept(KEY) is None


def test_the_code_used_last_is_kept_and_what_killed_processes_left_is_not(cache, monkeypatch):
    monkeypatch.setattr(disk_cache, "_ALL", 3 * (len(CODE) + 32))
    cache.mkdir(parents=True)
    left, under_way = (cache / f".x.{i * 32}.o" for i in "ab")
    for part in (left, under_way):
        part.write_bytes(b"part")
    os.utime(left, (1.0, 1.0))
    keys = [bytes([i]) * 32 for i in range(5)]
    now = time.time() - 100.0
    for i, key in enumerate(keys[:3]):
        disk_cache.keep(key, CODE)
        os.utime(cache / f"{key.hex()}.o", (now + i, now + i))
    assert disk_cache.kept(keys[0]) == CODE  # used now
    for key in keys[3:]:
        disk_cache.keep(key, CODE)
    assert [disk_cache.kept(key) is not None for key in keys] == [True, False, False, True, True]
    assert (left.exists(), under_way.exists()) == (False, True)
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in cache.glob("[0-9]*.o"))


# ---------------------------------------------------------------- C


def test_arms_that_differ_in_signs_alone_have_files_of_their_own(tmp_path):
    arms = {"left": "a b", "right": "a_b"}
    scenario = cp.Scenario.load("adept-paper").replace(duration=0.1, events=())
    text = scenario.to_toml()
    for old, new in arms.items():
        text = re.sub(rf"\b{old}\b", f'"{new}"', text.replace(f'"{old}"', old))
    renamed = tmp_path / "cell.toml"
    renamed.write_text(text)
    laws = [export_c(cp.Scenario.load(renamed), arm, tmp_path / "c", ticks=2) for arm in arms.values()]
    assert len({law.source for law in laws}) == 2
    assert len(list((tmp_path / "c").iterdir())) == 6
    assert np.all([re.search(r"int a_b_[0-9a-f]{8}_step\(", law.header.read_text()) for law in laws])


def test_a_page_of_a_comparison_has_a_filter_for_merged_cells(tmp_path):
    words = "adept-anchored", ["anchored"], ["nominal"]
    for name, merge in (("first", ()), ("second", (tmp_path / "first",))):
        execution = dataclasses.replace(HERE, merge=merge)
        cp.compare(*words, out=tmp_path / name, duration=0.05, execution=execution)
    pages = [(tmp_path / name / "comparison.html").read_text() for name in ("first", "second")]
    filters = [json.loads(re.search(r'"filters":(\{.*?\}),"notes"', page)[1]) for page in pages]
    assert [list(each) for each in filters] == [["information"], ["information", "merged"]]
    assert pd.read_csv(tmp_path / "second" / "comparison.csv")["merged"].tolist() == [1]
