"""Random calls of the public interface, in child processes: a typed error or a sound result."""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from hostile_calls import SOUND

SCRIPT = Path(__file__).with_name("hostile_calls.py")
BATCH, PATIENCE_S = 250, 600.0


def endings(seed, first, count):
    """How each call of a batch ends; a batch that a call ends is started again behind that call."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(SCRIPT.parents[1]), str(SCRIPT.parent)))}
    found, end = [], first + count
    while first < end:
        child = subprocess.run(
            [sys.executable, SCRIPT, str(seed), str(first), str(end - first)],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            env=environment,
        )
        said = [json.loads(line) for line in child.stdout.splitlines()]
        assert said, child.stderr
        found += [call for call in said if "end" in call]
        first = said[-1]["number"] + 1
        if "end" not in said[-1]:
            found.append({**said[-1], "end": f"exit code {child.returncode}", "text": child.stderr[-500:]})
    return found


def unsound(found):
    """Calls that ended otherwise than allowed; enough of the others are refused and give results."""
    counts = Counter(call["end"] for call in found)
    others = [call for call in found if call["end"] not in SOUND]
    print(dict(counts), *others, sep="\n")
    assert counts["result"] > 0.15 * len(found)
    assert counts["refused"] > 0.3 * len(found)
    return others


def test_fifty_random_calls_end_in_typed_errors_or_sound_results():
    assert unsound(endings(2026, 0, 50)) == []


@pytest.mark.slow
def test_five_thousand_random_calls_end_in_typed_errors_or_sound_results():
    found = [call for first in range(0, 5000, BATCH) for call in endings(11, first, BATCH)]
    assert len(found) == 5000
    assert unsound(found) == []
