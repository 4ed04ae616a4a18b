"""Cells of real robot files, as ``coop-pin new`` writes them: made or refused, run, and how well they do.

python tools/real_files.py FILES OUT             # all rows of real_files.tsv
python tools/real_files.py FILES OUT yumi movo   # some of them

FILES has ``pip/``, where packages were installed with ``pip install --no-deps --target``, and
``git/OWNER/NAME/`` with the files of public repositories. Rows whose robots are plain names are of
example-robot-data. A row whose first command is refused has the remedy that the refusal named, as further
options or as edits, ``EDIT ;; EDIT``, of the file, ``PATTERN => TEXT``, of one that it includes, ``PATH:
PATTERN => TEXT``, or of its name, ``NAME => NAME``; they are executed, and count only if the cell then keeps
its task.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.cli import main as main_of_cli

_LOADED = cp.Simulation, cp.new_cell, cp.check
"""What every command needs."""

TABLE = Path(__file__).with_suffix(".tsv")
RESULTS = TABLE.with_name("real_files_results.tsv")
_COLUMNS = ("name", "traits", "outcome", "refused", "remedy", "motion", "mm", "N")
_COMMAND = ("robots", "options")
_LIMIT, _REST = 1200, 1.0
"""Longest time of a command, s; time that a run goes on after the motion, s."""


def command(*words: str) -> tuple[int, str]:
    """Return exit code and text of a command of coop-pin, in a process that has it loaded already."""
    with tempfile.TemporaryFile("w+") as said:
        if not (child := os.fork()):
            for stream in (sys.stdout, sys.stderr):
                os.dup2(said.fileno(), stream.fileno())
            signal.alarm(_LIMIT)
            code = main_of_cli([*words])
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        _, status = os.waitpid(child, 0)
        said.seek(0)
        return status, said.read()


def words(text: str, files: Path) -> list[str]:
    """Return words, of which those that are paths stand in the folder of files."""
    return [str(files / word) if word.startswith(("pip/", "git/")) else word for word in text.split()]


def made(robots: list[str], options: list[str], scenario: Path, files: Path) -> str:
    """Write the cell of robots; return why it is refused, or nothing."""
    scenario.unlink(missing_ok=True)
    code, said = command("new", str(scenario), "--arms", *robots, *options)
    scenario.with_suffix(".new.txt").write_text(said)
    reason = said.rpartition("coop-pin: ")[2].replace(f"{files}/", "")
    return "" if code == 0 else " ".join(reason.split())[:400]


@contextlib.contextmanager
def edited(robots: list[str], edits: str, files: Path) -> Iterator[list[str]]:
    """Yield the robots of a row with the edits of its remedy, which are undone at the end."""
    originals, first = dict[Path, str](), Path((*robots, "")[0])
    try:
        for edit in filter(None, edits.split(" ;; ")):
            pattern, _, text = edit.partition(" => ")
            included, _, part = pattern.partition(": ")
            file = files / included if part else first
            if pattern == first.name:
                first = Path(shutil.copy(first, first.with_name(text)))
            else:
                before = file.read_text()
                originals.setdefault(file, before)
                file.write_text(re.sub(part or pattern, text, before))
        yield [str(first)] * len(robots) if edits else robots
    finally:
        for file, original in originals.items():
            file.write_text(original)


def outcome(row: dict[str, str], files: Path, out: Path) -> dict[str, str]:
    """Return the row of results of a robot."""
    scenario, robots, options = out / f"{row['name']}.toml", *(words(row[key], files) for key in _COMMAND)
    result = dict.fromkeys(_COLUMNS, "") | {"name": row["name"], "traits": row["traits"]}
    if not (refusal := made(robots, options, scenario, files)):
        return result | _run(scenario, out / row["name"])
    result |= {"outcome": "refused", "refused": refusal, "remedy": row["remedy"] or row["edit"]}
    if not result["remedy"]:
        return result
    with edited(robots, row["edit"], files) as robots:
        if refusal := made(robots, [*options, *words(row["remedy"], files)], scenario, files):
            return result | {"refused": refusal}
        return result | _run(scenario, out / row["name"])


def _run(scenario: Path, folder: Path) -> dict[str, str]:
    """Return outcome, motion and errors of the run of a scenario."""
    motion = cp.Scenario.load(scenario).motion
    end = getattr(motion, "start_time", 0.0) + getattr(motion, "duration", 0.0) + _REST
    run = ("run", str(scenario), "--no-replay", "--no-figures", "--out", str(folder))
    _, said = command(*run, "--duration", str(end))
    scenario.with_suffix(".run.txt").write_text(said)
    if not (folder / "metrics.json").is_file():
        return {"outcome": "no run", "refused": " ".join(said.split())[-400:]}
    metrics = json.loads((folder / "metrics.json").read_text())
    numbers = (("mm", 1e3, "position_error_max_m"), ("N", 1.0, "internal_force_error_max_N"))
    errors = {name: f"{scale * (metrics[key] or 0.0):.2g}" for name, scale, key in numbers}
    task = metrics["task"] if metrics["simulation_sound"] else "not sound"
    return errors | {"outcome": task, "motion": _way(motion)}


def _way(motion: Any) -> str:
    """Return kind and size of the motion that ``new`` wrote."""
    if motion.kind != "line":
        return str(motion.kind)
    way = np.linalg.norm(np.subtract(motion.goal.xyz, motion.start.xyz))
    turn = np.linalg.norm(motion.goal.rpy)
    return f"line of {way:.2f} m, {turn:.2f} rad in {motion.duration:g} s"


def main() -> None:
    """Fill the rows of the results that are asked for, one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("files", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with TABLE.open() as table:
        rows = list(csv.DictReader(table, delimiter="\t"))
    known = {}
    if RESULTS.exists():
        with RESULTS.open() as table:
            known = {row["name"]: row for row in csv.DictReader(table, delimiter="\t")}
    for row in rows:
        if not arguments.names or row["name"] in arguments.names:
            known[row["name"]] = outcome(row, arguments.files.resolve(), arguments.out.resolve())
            print(*(known[row["name"]][name] for name in _COLUMNS), sep=" | ", flush=True)
            with RESULTS.open("w") as table:
                writer = csv.DictWriter(table, _COLUMNS, delimiter="\t", lineterminator="\n")
                writer.writeheader()
                writer.writerows(known[each["name"]] for each in rows if each["name"] in known)


if __name__ == "__main__":
    main()
