"""What coop_pin adds to the compiler: trees of its objects, its errors, and compiled code on disk."""

import os
import re
import subprocess
import sys
from pathlib import Path

import adversaries
import llvmlite.binding as llvm
import numpy as np
import pytest
from cells import SCENARIOS
from numpy.testing import assert_allclose, assert_array_equal
from test_tracing import small_program

from coop_pin import compiled
from coop_pin.base.disk_cache import DiskCache
from coop_pin.base.errors import CoopPinError, TracingError
from coop_pin.base.spatial import task_rows
from coop_pin.compiled import simulate_batch
from coop_pin.control import Saturation
from coop_pin.tracing.llvm_machine import LlvmMachine
from coop_pin.tracing.tree import leaves, rebuilt, structure

# ---------------------------------------------------------------- trees and errors


def test_descriptions_task_rows_and_controllers_are_trees():
    scenario = SCENARIOS["planar"]()
    law = adversaries.Spring(scenario, "left", gain=0.3)
    tree = {"switch": Saturation(width=0.1), "rows": task_rows("full"), "law": law}
    assert leaves(tree) == [0.1, 0.3]
    other = rebuilt(tree, iter([0.2, 0.4]))
    assert (other["switch"].width, other["law"].gain, law.gain) == (0.2, 0.4, 0.3)
    assert {name: type(part) for name, part in other.items()} == {
        name: type(part) for name, part in tree.items()
    }
    assert structure(other) == structure(tree) != structure(tree | {"rows": task_rows("planar")})


@pytest.mark.parametrize("target", ["OwnChance", "CaughtBranch", "CaughtFloat"])
def test_what_the_compiler_refuses_is_an_error_of_coop_pin(target):
    controller = {"kind": "user", "target": f"adversaries:{target}"}
    changes = {"duration": 0.1, "events": (), "beyond_bound": True, "controller": controller}
    with pytest.raises(TracingError) as caught:
        simulate_batch([SCENARIOS["planar"]().override(changes)])
    assert isinstance(caught.value, CoopPinError)
    assert isinstance(caught.value, ValueError)


# ---------------------------------------------------------------- compiled code on disk


def run_small_program():
    block = np.array([[1.0, 2.0, 3.0], [0.0, 1.0, -1.0]])
    machine = LlvmMachine(small_program(), cache=DiskCache())
    record = machine.run(block, np.array([[0.5]]), np.zeros((1, 0, 3)))
    assert_allclose(record[0], [[1.0, 2.5, 2.5], np.exp([0.0, 1.0, -1.0])], rtol=4e-16)


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """The folder and the file of the small program's code."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    run_small_program()
    (file,) = (tmp_path / "coop_pin" / "compiled").iterdir()
    return file


def test_compiled_code_is_kept(kept, monkeypatch):
    assert kept.stat().st_mode & 0o777 == 0o600
    assert kept.parent.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr("llvmlite.binding.TargetMachine.emit_object", None)
    run_small_program()


@pytest.mark.parametrize(
    "spoil",
    [
        lambda file: file.write_bytes(file.read_bytes()[:-100]),
        lambda file: file.write_bytes(b""),
        lambda file: file.write_bytes(file.read_bytes()[:-1] + b"?"),
        lambda file: file.chmod(0o660),  # others may have written it
        lambda file: (file.unlink(), file.mkdir()),
    ],
    ids=["truncated", "empty", "changed", "writable by a group", "a folder"],
)
def test_code_that_is_damaged_or_may_be_anothers_is_compiled_again(spoil, kept, monkeypatch):
    spoil(kept)
    compiled, emit = [], llvm.TargetMachine.emit_object
    monkeypatch.setattr(llvm.TargetMachine, "emit_object", lambda *args: compiled.append(args) or emit(*args))
    run_small_program()
    assert len(compiled) == 1
    run_small_program()
    assert len(compiled) == (2 if kept.is_dir() else 1)


def test_code_under_the_name_of_another_program_is_not_run(kept):
    program = small_program()
    program.kernels[0].write("x", [1.0, 2.0])
    other = LlvmMachine(program, cache=DiskCache()).run(
        np.zeros((2, 1)), np.array([[0.5]]), np.zeros((1, 0, 1))
    )
    (file,) = set(kept.parent.iterdir()) - {kept}
    kept.write_bytes(file.read_bytes())
    assert_array_equal(other[0], [[1.0], [2.0]])
    run_small_program()


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    run_small_program()


@pytest.mark.slow
def test_programs_that_are_compiled_at_the_same_time_keep_one_whole_file(kept):
    kept.unlink()
    script = "from test_tracing_in_coop_pin import run_small_program; run_small_program()"
    folders = os.pathsep.join((str(Path(__file__).parents[1]), *sys.path))
    started = [
        subprocess.Popen([sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": folders})
        for _ in range(3)
    ]
    assert [process.wait(timeout=120.0) for process in started] == [0, 0, 0]
    assert list(kept.parent.iterdir()) == [kept]


def test_the_compiler_is_loaded_when_it_is_needed():
    for file in Path(compiled.__file__).parent.rglob("*.py"):
        assert not re.search(r"^(import|from) llvmlite", file.read_text(encoding="utf-8"), re.MULTILINE)
