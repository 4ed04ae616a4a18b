"""Random calls of the public interface, in child processes: a typed error or a sound result."""

import inspect
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hostile_calls import SOUND

from coop_pin import comparison, compiled, design, feasibility, figures, proof, stability, viz
from coop_pin.base.arrays import typed
from coop_pin.base.errors import WrongTypeError

SCRIPT = Path(__file__).parents[1].joinpath("hostile_calls.py")
BATCH, PATIENCE_S = 250, 600.0
BARE_PART = 0.01
"""Largest part of calls that may end in a bare exception, from inside of collections."""


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


@pytest.mark.parametrize(
    "package", [feasibility, stability, design, proof, compiled, comparison, figures, viz]
)
def test_functions_whose_arguments_are_typed_know_their_classes(package):
    """Classes that are imported for type checkers only would not be found when a function is called."""
    functions = [getattr(package, name) for name in package.__all__]
    typed_ones = [function for function in functions if hasattr(function, "__wrapped__")]
    assert typed_ones
    for function in typed_ones:
        arguments = inspect.signature(function).parameters.values()
        first, *_ = names = [each.name for each in arguments if each.kind is not each.VAR_POSITIONAL]
        with pytest.raises(WrongTypeError, match=first):
            function(**dict.fromkeys(names, object()))


def test_stated_classes_take_numbers_of_numpy_and_members_of_unions():
    @typed
    def f(
        number: float, count: int = 0, *, text: str | None = None, anything: object = None
    ) -> tuple[object, ...]:
        return number, count, text, anything

    assert f(1, np.int64(2), text=None, anything=f) == (1, 2, None, f)
    for wrong in ({"number": "1"}, {"number": 1.0, "count": 2.0}, {"number": 1.0, "text": 3}):
        with pytest.raises(WrongTypeError):
            f(**wrong)
    with pytest.raises(TypeError):
        f()


@pytest.mark.parametrize("count", [5, pytest.param(25, marks=pytest.mark.slow)])
def test_random_calls_end_in_typed_errors_or_sound_results(count):
    assert unsound(endings(2026, 0, count)) == []


@pytest.mark.slow
def test_five_thousand_random_calls_end_in_typed_errors_or_sound_results():
    """Of which at most one per cent are exceptions of a traced mass, a machine or an entry of a list."""
    found = [call for first in range(0, 5000, BATCH) for call in endings(11, first, BATCH)]
    assert len(found) == 5000
    others = unsound(found)
    assert {call["end"] for call in others} <= {"bare"}
    assert len(others) <= BARE_PART * len(found)
