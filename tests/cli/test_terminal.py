"""Terminal: width of lines, and what is told while a command takes its time."""

from __future__ import annotations

import contextlib
import io
import os
import pty
import subprocess
import sys
import time

import pytest

from coop_pin.cli import main, terminal
from coop_pin.description.catalogue import scenario_names

QUICK = {"show": ("adept-paper", "three-ur5-handover"), "check": ("adept-paper",), "suggest": ()}
"""Cells that are looked at in the default tier, too, by the command."""


def too_long(text: str) -> list[str]:
    """Lines beyond 80 columns that could be broken: all but single words, as a path."""
    return [line for line in text.splitlines() if len(line) > 80 and " " in line.strip()]


@pytest.mark.parametrize(
    "words",
    [
        ("list",),
        ("show", "ur5"),
        *[
            pytest.param((command, name), marks=[pytest.mark.slow] * (name not in QUICK[command]))
            for command in QUICK
            for name in scenario_names()
        ],
    ],
    ids=" ".join,
)
def test_lines_fit_a_terminal_of_80_columns(words, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    main(words)
    said = capsys.readouterr()
    assert said.out
    assert too_long(said.out) == []
    assert said.err == ""


@pytest.mark.parametrize(("width", "columns"), [("40", 80), ("80", 80), ("91", 91), ("300", 99)])
def test_lines_are_as_wide_as_the_terminal_within_limits(width, columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", width)
    terminal.print_wrapped("word " * 60)
    lines = capsys.readouterr().out.splitlines()
    assert columns - 5 < max(map(len, lines)) <= columns


def test_a_branch_of_a_tree_goes_on_below_itself(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    terminal.print_wrapped(f"│  ├─ {'word ' * 20}")
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("│  ├─ word")
    assert second.startswith("│  │      word")


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        return True


def test_what_takes_its_time_is_told_on_a_terminal_and_taken_back(monkeypatch):
    screens = [(Screen(), False, True), (Screen(), True, False), (io.StringIO(), False, False)]
    with contextlib.ExitStack() as stack:
        working = []
        for screen, quiet, _ in screens:
            monkeypatch.setattr(sys, "stderr", screen)
            working.append(stack.enter_context(terminal.Working("first", quiet=quiet)))
        time.sleep(1.5)
        working[0].tell("second")
        time.sleep(1.2)
    for screen, _, tells in screens:
        written = screen.getvalue()
        assert ("coop-pin: first, 1 s" in written, "coop-pin: second, 2 s" in written) == (tells, tells)
        assert written.endswith("\x1b[K") == tells


@pytest.mark.parametrize("stream", [Screen, io.StringIO])
def test_an_error_is_wrapped_on_a_terminal_and_one_line_elsewhere(stream, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys, "stderr", written := stream())
    assert main(["run", "nothing"]) == 2
    assert (len(written.getvalue().splitlines()) > 1) == written.isatty()
    assert (too_long(written.getvalue()) == []) == written.isatty()


def test_nothing_is_told_of_what_is_over_at_once(monkeypatch):
    monkeypatch.setattr(sys, "stderr", screen := Screen())
    with terminal.Working("a moment"):
        pass
    assert screen.getvalue() == "\x1b[K"


@pytest.mark.slow
def test_a_command_tells_on_a_terminal_and_nothing_into_a_pipe():
    command = [sys.executable, "-m", "coop_pin", "suggest", "two-pandas-box"]
    main_end, other_end = pty.openpty()
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=other_end, check=True)
    os.close(other_end)
    told = os.read(main_end, 65536).decode()
    os.close(main_end)
    assert "looking for rate, gains" in told
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
