"""Every command and every line of Python in the README works as it stands there."""

import ast
import functools
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import coop_pin
from coop_pin.cli import main

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
SHORT = ["--duration", "0.2", "--events", "[]", "--quiet"]
"""A run is cut short here unless the README says how long; nothing else about it is changed."""


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


@functools.cache
def commands():
    """The words of every command line, comments left out."""
    lines = "\n".join(blocks("sh")).splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def test_every_command_is_of_a_kind_that_is_tested_here():
    assert commands()
    for words in commands():
        assert words[0] == "coop-pin" or words[:1] == ["bash"], words


def test_tools_exist_and_are_sound_shell():
    scripts = [words[1] for words in commands() if words[0] == "bash"]
    assert "tools/run.sh" in scripts
    assert "tools/gate.sh" in scripts  # the gate is what runs this test
    for script in scripts:
        subprocess.run(["bash", "-n", str(REPOSITORY / script)], check=True)


def test_the_commands_work_one_after_the_other(tmp_path, monkeypatch, capsys):
    """In an empty folder, with a scenario of the reader's own beside them."""
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)  # no browser opens
    coop_pin.Scenario.load("adept-paper").save("mine.toml")
    for _, *words in (words for words in commands() if words[0] == "coop-pin"):
        short = [*words, *(SHORT if words[0] == "run" else [])]
        assert main(short) == 0, (words, capsys.readouterr().err)


def test_the_help_of_every_command_named_in_the_readme_is_there(capsys):
    for name in {words[1] for words in commands() if words[0] == "coop-pin"}:
        with pytest.raises(SystemExit) as ended:
            main([name, "--help"])
        assert ended.value.code == 0
        assert "usage" in capsys.readouterr().out


def test_python_in_the_readme_runs(tmp_path):
    """All blocks one after the other, as somebody who pastes them."""
    code = "\n".join(blocks("python"))
    assert ast.parse(code).body
    environment = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run.nc").is_file()


def test_every_folder_and_file_that_the_readme_links_to_exists():
    for target in re.findall(r"\]\((?!https?:)([^)#\s]+)", README):
        assert (REPOSITORY / target).exists(), target
