"""Mutation run: small changes of the code, one at a time, that the tests of the changed file must notice.

    python tools/mutate.py                       every mutant of control, chain, results and spatial: hours
    python tools/mutate.py --sample 40 --seed 1  some of them
    python tools/mutate.py --package results     those of one package

Comparisons and arithmetic are swapped, numbers and booleans changed, conditions negated and terms dropped, in
a copy of the repository. Exit code 1 if the tests notice less than 95 % of the mutants of a package.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

REPOSITORY = Path(__file__).resolve().parents[1]
FLOOR = 0.95
_COPIED = ("coop_pin", "urdf", "tests", "examples", "tools", "docs", "pyproject.toml")
TESTS = {
    "control": "test_sliding_mode test_payload_space test_redundant_sliding_mode test_interface",
    "chain": "test_closures test_projection test_closed_chain test_cell_chain "
    "test_invariants test_mechanisms",
    "chain/ik_solver.py": "test_inverse_kinematics test_branches test_reachability",
    "chain/inverse_kinematics.py": "test_inverse_kinematics test_branches",
    "chain/integrators.py": "test_integrators test_invariants test_simulation",
    "chain/trajectory.py": "test_mechanisms test_integrators",
    "results": "test_metrics test_results test_simulation",
    "results/atomic_write.py": "test_sweep_store test_simulation",
    "results/snapshot.py": "test_live_view test_live_run",
    "spatial": "test_spatial test_cell_chain test_sliding_mode",
}
"""Test files of a package, or of a single file of it."""


class Mutant(NamedTuple):
    """One change of a file.

    Attributes:
        file: under coop_pin.
        line: of the change.
        old: text of what is changed.
        new: text of what it becomes.
        source: the whole file with the change.
    """

    file: str
    line: int
    old: str
    new: str
    source: str


_SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.MatMult: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what a node may be replaced by."""
    match node:
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            yield ast.Constant(value + 1 if isinstance(value, int) else 2.0 * value + (value == 0.0))
        case ast.BinOp(left, op, right) if type(op) in _SWAPS:
            yield ast.BinOp(left, _swapped(op), right)
            yield left
            if isinstance(op, ast.Add | ast.Mult | ast.MatMult):
                yield right
        case ast.BoolOp(op, values):
            yield ast.BoolOp(_swapped(op), values)
            for index in range(len(values)):
                rest = values[:index] + values[index + 1 :]
                yield rest[0] if len(rest) == 1 else ast.BoolOp(op, rest)
        case ast.Compare(left, [op], right) if type(op) in _SWAPS:
            yield ast.Compare(left, [_swapped(op)], right)
        case ast.UnaryOp(ast.USub() | ast.Not() | ast.Invert(), operand):
            yield operand
        case ast.If(test) | ast.While(test) | ast.IfExp(test):
            yield ast.UnaryOp(ast.Not(), test)


def _swapped(op: ast.AST) -> Any:
    return _SWAPS[type(op)]()


_NOT_CHANGED = {"annotation", "returns", "type_params", "decorator_list"}


def _sites(node: ast.AST) -> Iterator[ast.AST]:
    """Yield every node that may be changed: none in errors, annotations and zip's strict."""
    for field, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else (value,):
            if field not in _NOT_CHANGED and isinstance(child, ast.AST) and not _is_left_alone(child):
                yield child
                yield from _sites(child)


def _is_left_alone(node: ast.AST) -> bool:
    strict = isinstance(node, ast.keyword) and node.arg == "strict"
    return strict or isinstance(node, ast.Raise | ast.JoinedStr)


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """Yield every mutant of a file.

    Args:
        file: its name.
        text: its source.
    """
    data = text.encode()
    starts = [0, *itertools.accumulate(len(line) for line in data.splitlines(keepends=True))]
    for node in _sites(ast.parse(text)):
        place: Any = getattr(node, "test", node)
        for new in changes(node):
            old, becomes = ast.unparse(place), ast.unparse(new)
            first = starts[place.lineno - 1] + place.col_offset
            last = starts[place.end_lineno - 1] + place.end_col_offset
            source = data[:first] + f"({becomes})".encode() + data[last:]
            yield Mutant(file, place.lineno, old, becomes, source.decode())


def all_mutants() -> list[Mutant]:
    """Return every mutant of the packages in TESTS."""
    package = REPOSITORY / "coop_pin"
    folders = sorted({key.partition("/")[0] for key in TESTS})
    files = [path for folder in folders for path in sorted((package / folder).rglob("*.py"))]
    return [mutant for path in files for mutant in mutants(str(path.relative_to(package)), path.read_text())]


def tests_of(file: str) -> list[str]:
    """Return the test files of a file of the package."""
    names = TESTS.get(file) or TESTS[file.partition("/")[0]]
    return [f"tests/{name}.py" for name in names.split()]


def is_noticed(folder: Path, tests: list[str], limit: float | None = None) -> bool:
    """Return whether tests fail in a copy of the repository; running into the time limit counts, s."""
    environment = os.environ | {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


def _copied(folder: Path) -> None:
    for name in _COPIED:
        source = REPOSITORY / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)


def main(arguments: list[str] | None = None) -> int:
    """Run the mutants, print the ones alive and the score of each package, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    packages = sorted({key.partition("/")[0] for key in TESTS})
    parser.add_argument("--package", action="append", choices=packages, help="all when omitted")
    parser.add_argument("--sample", type=int, help="number of mutants; all when omitted")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    given = parser.parse_args(arguments)
    wanted = given.package or packages
    chosen = [mutant for mutant in all_mutants() if mutant.file.partition("/")[0] in wanted]
    if given.sample is not None:
        chosen = random.Random(given.seed).sample(chosen, min(given.sample, len(chosen)))
    noticed: dict[str, list[bool]] = defaultdict(list)
    limits: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        _copied(folder)
        for mutant in chosen:
            tests = tests_of(mutant.file)
            if (key := " ".join(tests)) not in limits:
                start = time.monotonic()
                if is_noticed(folder, tests):
                    raise SystemExit(f"{key} fail without any change")
                limits[key] = 60.0 + 4.0 * (time.monotonic() - start)
            path = folder / "coop_pin" / mutant.file
            before = path.read_text()
            path.write_text(mutant.source)
            seen = is_noticed(folder, tests, limits[key])
            path.write_text(before)
            noticed[mutant.file.partition("/")[0]].append(seen)
            if not seen:
                print(f"alive: {mutant.file}:{mutant.line}: {mutant.old} -> {mutant.new}", flush=True)
    for package, found in sorted(noticed.items()):
        print(f"{package}: {sum(found)} of {len(found)} noticed, {sum(found) / len(found):.1%}")
    return int(any(sum(found) < FLOOR * len(found) for found in noticed.values()))


if __name__ == "__main__":
    sys.exit(main())
