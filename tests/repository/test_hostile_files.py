"""Damaged and hostile files, each read in a process of its own: a typed error or a sound result."""

import json
import os
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from hostile_files import ALLOWED, BYTES, TEXT

SCRIPT = Path(__file__).parents[1].joinpath("hostile_files.py")


def endings(seed, count):
    """How the reading of each file ends."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(SCRIPT.parents[1]), str(SCRIPT.parent)))}
    command = [sys.executable, SCRIPT, str(seed), "0", str(count)]
    child = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=environment)
    return [json.loads(line) for line in child.stdout.splitlines()]


def not_allowed(found):
    """Files whose reading ended otherwise than allowed; enough of the others are refused and read."""
    counts = Counter(file["end"] for file in found)
    others = [file for file in found if file["end"] not in ALLOWED]
    print(dict(counts), *others, sep="\n")
    assert counts["result"] > 0.15 * len(found)
    assert counts["refused"] > 0.3 * len(found)
    return others


@pytest.mark.parametrize("count", [5, pytest.param(25, marks=pytest.mark.slow)])
def test_hostile_files_end_in_typed_errors_or_sound_results(count):
    found = endings(2026, count)
    assert len(found) == count
    assert not_allowed(found) == []


@pytest.mark.slow
def test_six_hundred_hostile_files_end_in_typed_errors_or_sound_results():
    found = endings(11, 600)
    assert len(found) == 600
    assert not_allowed(found) == []


@pytest.mark.parametrize("damage", sorted({*BYTES, *TEXT}, key=lambda damage: damage.__name__))
def test_damage_is_seeded_and_changes_a_file(damage):
    data = b"mass = 2.5\nname = 'left'\n" * 40
    damaged = [damage(random.Random(seed), data) for seed in range(20)]
    assert damaged == [damage(random.Random(seed), data) for seed in range(20)]
    assert sum(one != data for one in damaged) > 15
