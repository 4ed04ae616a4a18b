"""Image and video export: frames against the result, refused arguments, failures; nothing is left over."""

import asyncio
import os
import re
import signal
import subprocess
import sys
import threading
import time
import uuid
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from browser import chromium
from cells import planar_scenario
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import BrowserError, FileWriteError, MissingExtraError, OutOfRangeError
from coop_pin.cli import main
from coop_pin.cli.exit_codes import FAILED
from coop_pin.viz import replay_html, save_image, save_video
from coop_pin.viz.browser import find_browser, offline_page
from coop_pin.viz.export import frame_times, page_images, run_in_thread

WIDTH, HEIGHT, RATE = 480, 320, 4.0


@pytest.fixture(scope="module")
def result():
    return cp.run(planar_scenario().replace(duration=1.0, events=()), warn=False)


@pytest.fixture
def browser():
    """Skips the test if there is no browser."""
    return chromium()


@pytest.fixture
def ffmpeg():
    """Path of the encoder; skips the test if there is none."""
    reason = "imageio-ffmpeg is not installed: pip install 'coop-pin[video]'"
    return pytest.importorskip("imageio_ffmpeg", reason=reason).get_ffmpeg_exe()


def frames_of(ffmpeg: str, path: Path) -> tuple[np.ndarray, str]:
    """All frames of a video, red, green, blue, and the decoder's description of its stream."""
    words = [ffmpeg, "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-fps_mode", "passthrough", "-"]
    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, check=True)
    stream = next(line for line in done.stderr.decode().splitlines() if "Video: " in line)
    return np.frombuffer(done.stdout, np.uint8).reshape(-1, HEIGHT, WIDTH, 3), stream


@pytest.fixture
def leaves_no_process(monkeypatch):
    """Fails if a process started in the test outlives it: all of them inherit a mark, orphans too."""
    mark = f"COOP_PIN_TEST={uuid.uuid4().hex}"
    monkeypatch.setenv(*mark.split("="))
    yield mark
    end = time.monotonic() + 60.0
    while marked(mark) and time.monotonic() < end:  # a browser's helpers end shortly after it
        time.sleep(0.05)
    assert marked(mark) == []


def marked(mark: str) -> list[str]:
    """Names of other living processes with a mark in their environment."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if int(process.name) != os.getpid() and mark.encode() in (process / "environ").read_bytes():
                found.append((process / "comm").read_text().strip())
        except OSError:  # it has ended, or belongs to another user
            continue
    return found


@pytest.mark.usefixtures("browser", "leaves_no_process")
@pytest.mark.gate
def test_a_video_shows_the_run_at_the_times_of_its_frames(result, ffmpeg, tmp_path):
    save_video(result, tmp_path / "run.mp4", frames_per_second=RATE, width=WIDTH, height=HEIGHT)
    frames, stream = frames_of(ffmpeg, tmp_path / "run.mp4")
    assert len(frames) == len(frame_times(result.end, RATE)) == 5
    assert re.search(rf"h264.*, {WIDTH}x{HEIGHT}[, ].* {RATE:g} fps", stream)

    save_image(result, tmp_path / "half.png", time=0.5, width=WIDTH, height=HEIGHT)
    half = np.round(255.0 * matplotlib.image.imread(tmp_path / "half.png")[..., :3])
    off = [np.abs(half - frame).mean() for frame in frames]
    assert np.argmin(off) == 2  # t = k / 4 Hz
    assert off[2] < 3.0  # the encoder's loss
    assert half.std() > 20.0
    assert len(np.unique(half.reshape(-1, 3), axis=0)) > 500  # neither blank nor a background alone
    assert sorted(path.name for path in tmp_path.iterdir()) == ["half.png", "run.mp4"]


@pytest.mark.usefixtures("browser")
@pytest.mark.gate
def test_runs_side_by_side_are_one_sheet_of_pdf_with_text_as_text(result, tmp_path):
    save_image(result, tmp_path / "both.pdf", result, names=["one", "other"], width=800, height=500)
    content = (tmp_path / "both.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", content)) == 1
    assert re.search(rb"/MediaBox\s*\[0 0 (599|600)(\.\d+)? 37[45]", content)  # 800 x 500 pixels in points
    assert b"/Type0" in content  # fonts, with the letters that a search finds
    assert b"/ToUnicode" in content


@pytest.mark.gate
@pytest.mark.usefixtures("browser")
def test_images_can_be_made_in_a_notebook_and_are_reproducible(result, tmp_path):
    async def cell() -> None:  # a notebook's cells run inside an event loop
        save_image(result, tmp_path / "loop.png", width=WIDTH, height=HEIGHT)

    asyncio.run(cell())
    save_image(result, tmp_path / "again.png", time=result.end, width=WIDTH, height=HEIGHT)
    assert (tmp_path / "loop.png").read_bytes() == (tmp_path / "again.png").read_bytes()


def test_view_writes_an_image_and_opens_nothing(result, tmp_path, monkeypatch, capsys):
    """test_readme.py has the same command with a browser that draws."""
    drawn = []

    def page_images(_page, times, width, height, _take):
        drawn.append((list(times), width, height))
        yield b"\x89PNG"

    monkeypatch.setattr("coop_pin.viz.export.page_images", page_images)
    monkeypatch.setenv("DISPLAY", ":0")  # does not exist
    monkeypatch.setattr("webbrowser.open", lambda _: pytest.fail("a browser was opened"))
    result.save(tmp_path / "result.nc")
    assert main(["view", str(tmp_path), "--image", str(tmp_path / "end.png"), "--time", "0.2"]) == 0
    assert capsys.readouterr().out.strip() == str((tmp_path / "end.png").resolve())
    assert (tmp_path / "end.png").read_bytes() == b"\x89PNG"
    assert drawn == [([0.2], 1400, 900)]


def test_view_compares_two_runs_and_refuses_what_is_none(result, tmp_path, monkeypatch, capsys):
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        result.save(tmp_path / name / "result.nc")
    monkeypatch.setattr("webbrowser.open", lambda _: pytest.fail("a browser was opened"))
    assert main(["view", str(tmp_path / "first"), str(tmp_path / "second"), "--no-open"]) == 0
    page = tmp_path / "first" / "against-second.html"
    assert capsys.readouterr().out.strip() == str(page.resolve())
    assert page.read_text(encoding="utf-8") == replay_html(result, result, names=["first", "second"])
    assert main(["view", str(tmp_path / "first"), str(tmp_path / "third"), "--no-open"]) == 2
    assert "third" in capsys.readouterr().err


def test_frame_times_are_on_the_clock_of_the_run():
    assert_allclose(frame_times(1.0, 30.0), np.arange(31) / 30.0, rtol=0, atol=0)
    assert_allclose(frame_times(0.99, 10.0), np.arange(10) / 10.0, rtol=0, atol=0)
    assert_allclose(
        frame_times(0.3, 10.0), np.arange(4) / 10.0, rtol=0, atol=0
    )  # 0.3 * 10 is 2.9999999999999996
    assert_allclose(frame_times(20.0, 80.0)[-1], 20.0, rtol=0, atol=0)


@pytest.mark.parametrize("time", [-0.1, 1.1, np.nan])
def test_times_outside_the_run_are_refused(result, tmp_path, time):
    with pytest.raises(OutOfRangeError) as caught:
        save_image(result, tmp_path / "no.png", time=time)
    assert caught.value.name == "time"


@pytest.mark.parametrize(
    ("save", "name", "value"),
    [
        (save_image, "width", 10),
        (save_video, "height", 321),  # odd
        (save_video, "frames_per_second", 0.0),
        (save_video, "frames_per_second", np.inf),
    ],
)
def test_invalid_sizes_and_rates_are_refused(result, tmp_path, save, name, value):
    with pytest.raises(OutOfRangeError) as caught:
        save(result, tmp_path / "no.mp4", **{name: value})
    assert (caught.value.name, caught.value.value) == (name, value)
    assert list(tmp_path.iterdir()) == []


def test_the_error_of_a_missing_package_names_its_extra(result, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "playwright", None)
    with pytest.raises(MissingExtraError) as caught:
        save_image(result, tmp_path / "no.png")
    assert (caught.value.package, caught.value.extra) == ("playwright", "video")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtraError) as caught:
        save_video(result, tmp_path / "no.mp4")
    assert (caught.value.package, caught.value.extra) == ("imageio-ffmpeg", "video")


def test_a_missing_browser_is_an_error_and_old_files_stay(result, tmp_path, monkeypatch, capsys):
    pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install 'coop-pin[video]'"
    )
    monkeypatch.setenv("CHROMIUM", str(tmp_path / "nowhere"))
    (tmp_path / "old.png").write_bytes(b"old")
    with pytest.raises(BrowserError, match=r"looked for CHROMIUM=.*nowhere.*playwright install chromium"):
        save_image(result, tmp_path / "old.png")
    result.save(tmp_path / "run.nc")
    assert main(["view", str(tmp_path / "run.nc"), "--image", str(tmp_path / "old.png")]) == 2
    assert "playwright install chromium" in capsys.readouterr().err
    assert (tmp_path / "old.png").read_bytes() == b"old"


def test_search_order_of_browsers(tmp_path, monkeypatch):
    for name in ("own", "named", "chromium"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CHROMIUM", str(tmp_path / "named"))
    assert find_browser(tmp_path / "own") == str(tmp_path / "named")
    monkeypatch.delenv("CHROMIUM")
    assert find_browser(tmp_path / "own") == str(tmp_path / "own")
    assert find_browser(tmp_path / "missing") == str(tmp_path / "chromium")


def test_a_program_that_is_no_browser_is_an_error(tmp_path, monkeypatch):
    pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install 'coop-pin[video]'"
    )
    (tmp_path / "no-browser").write_text("#!/bin/sh\nexit 3\n")
    (tmp_path / "no-browser").chmod(0o755)
    monkeypatch.setenv("CHROMIUM", str(tmp_path / "no-browser"))
    with pytest.raises(BrowserError, match="no-browser"), offline_page(WIDTH, HEIGHT):
        pass


@pytest.mark.usefixtures("browser", "leaves_no_process")
def test_an_incomplete_video_is_an_error_and_the_old_one_stays(result, ffmpeg, tmp_path, monkeypatch, capfd):
    full = tmp_path / "encoder-with-a-full-disk"
    full.write_text(f"#!/bin/bash\ntrap '' XFSZ\nulimit -f 8\nexec '{ffmpeg}' \"$@\"\n")
    full.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(full))
    (tmp_path / "run.mp4").write_bytes(b"old")
    with pytest.raises(FileWriteError, match=r"run\.mp4") as caught:
        save_video(result, tmp_path / "run.mp4", frames_per_second=RATE, width=WIDTH, height=HEIGHT)
    assert "of 5 frames" in str(caught.value)
    assert "File too large" in capfd.readouterr().err
    assert (tmp_path / "run.mp4").read_bytes() == b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == [full.name, "run.mp4"]


def test_an_incomplete_video_ends_the_command_with_an_error(result, tmp_path, monkeypatch, capsys):
    def fail(_result, path: Path, **_options) -> None:
        raise FileWriteError(str(path), f"the encoder wrote {3} of {31} frames (its message is above)")

    result.save(tmp_path / "run.nc")
    monkeypatch.setattr("coop_pin.viz.save_video", fail)
    assert main(["view", str(tmp_path / "run.nc"), "--video", str(tmp_path / "run.mp4")]) == FAILED
    assert "3 of 31 frames" in capsys.readouterr().err


@pytest.mark.gate
@pytest.mark.usefixtures("browser")
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are listed in /proc")
def test_images_that_are_not_consumed_leave_no_browser(result, leaves_no_process):
    images = page_images(replay_html(result), [0.0, 0.5, 1.0], WIDTH, HEIGHT)
    assert next(images).startswith(b"\x89PNG")
    assert any("chrom" in name for name in marked(leaves_no_process))
    images.close()


@pytest.mark.usefixtures("browser", "leaves_no_process")
def test_an_error_of_the_page_is_raised():
    with pytest.raises(BrowserError, match="out of paint"), offline_page(WIDTH, HEIGHT) as page:
        page.set_content("<script>throw new Error('out of paint')</script>")


def test_ctrl_c_stops_the_thread_that_draws():
    stopped = []

    def draw(stop: threading.Event) -> None:
        stop.wait(0.5)  # until the main thread waits
        os.kill(os.getpid(), signal.SIGINT)
        stopped.append(stop.wait(60))

    with pytest.raises(KeyboardInterrupt):
        run_in_thread(draw)
    assert stopped == [True]
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("coop_pin export")]


def test_view_refuses_a_time_without_an_image(tmp_path, capsys):
    for words in ([], ["--video", str(tmp_path / "all.mp4")]):
        assert main(["view", str(tmp_path), "--time", "0.2", *words]) == 2
        assert "--time" in capsys.readouterr().err
