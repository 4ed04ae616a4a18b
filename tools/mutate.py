"""Mutation run: small changes of the code, one at a time, that the tests must notice.

    python tools/mutate.py                            every mutant of the packages in TESTS
    python tools/mutate.py results chain/dynamics.py  those of a package or of a file
    python tools/mutate.py --sample 40 --seed 1       some of them
    python tools/mutate.py --planted --verbose        the faults of planted_faults.toml, and who notices them

Comparisons and arithmetic are swapped, numbers and booleans changed, conditions negated and terms dropped.
The tests are loaded once. One run of each tells which lines it executes; then every mutant gets a process in
which tests that execute its line run, the most promising first, until one fails or exceeds its time limit,
which is noticed too, and printed. A line that no test executes is not noticed. Mutants that change nothing
are listed with the reason in mutate_equivalent.toml and are not run. Exit code 1 if less than 95 % of the
others of a package are noticed.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import functools
import gc
import importlib
import itertools
import json
import os
import pickle
import random
import signal
import sys
import tempfile
import threading
import time
import tomllib
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Container, Iterable, Iterator
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any, NamedTuple

import pytest
from _pytest.runner import runtestprotocol
from _pytest.warnings import catch_warnings_for_item
from hypothesis import Phase, settings

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "coop_pin"
EQUIVALENT = Path(__file__).with_name("mutate_equivalent.toml")
PLANTED = Path(__file__).with_name("planted_faults.toml")
FLOOR = 0.95
TESTS = {
    "base": "internal_wrench_definitions payload_space",
    "compiled": "gravity_turn reference_plant sweep_batch traced_springs tracing",
    "chain": "reference_plant sizes traced_springs",
    "cli": "",
    "comparison": "benchmarks",
    "control": "interface sensing",
    "description": "armature contact_patches errors friction_grasps grasp_events gravity_turn known_before"
    " linked_payloads network new_cell pick_and_place rolling_bases servo shared_joints",
    "design": "friction_grasps joint_grasps linked_payloads tool_tips symmetric laws_on_linked_payloads",
    "environment": "stepping",
    "feasibility": "friction_margins suggestion",
    "figures": "comparison_figures sweep_figures",
    "grasps": "inverse_dynamics shared_joints",
    "identification": "",
    "logs": "",
    "model": "",
    "model_based": "batch_laws compare",
    "proof": "",
    "reference": "",
    "results": "internal_wrench_definitions user_files",
    "running": "",
    "simulation": "batch_sensing grasp_events reference_plant",
    "stability": "compliant_grasps network servo",
    "sweeps": "",
    "tracing": "batch batch_laws c_export sweep_batch",
    "viz": "",
    "zoo": "",
}
"""Test files that are run for each package besides those of its own folder."""
LONGEST = 20.0
"""Processor time of a test, with its lines counted, beyond which it is not used, s."""


class Mutant(NamedTuple):
    """One change of a file.

    Attributes:
        file: under coop_pin.
        lines: of what is changed.
        text: the first of these lines.
        old: text of what is changed.
        new: text of what it becomes.
        whole: the whole file without the change.
        span: where the change is in it.
        written: what stands there with it.
    """

    file: str
    lines: range
    text: str
    old: str
    new: str
    whole: bytes
    span: slice
    written: str

    @property
    def source(self) -> str:
        """The whole file with the change: thousands of mutants share the one without."""
        return (self.whole[: self.span.start] + self.written.encode() + self.whole[self.span.stop :]).decode()

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What mutate_equivalent.toml knows it by: no line number, which other changes would move."""
        return self.file, self.text, self.old, self.new

    @property
    def package(self) -> str:
        """First folder of the file."""
        return self.file.partition("/")[0]


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
    data, lines = text.encode(), text.splitlines()
    starts = [0, *itertools.accumulate(len(line) for line in data.splitlines(keepends=True))]
    for node in _sites(ast.parse(text)):
        place: Any = getattr(node, "test", node)
        for new in changes(node):
            old, becomes = ast.unparse(place), ast.unparse(new)
            first = starts[place.lineno - 1] + place.col_offset
            last = starts[place.end_lineno - 1] + place.end_col_offset
            numbers, line = range(place.lineno, place.end_lineno + 1), lines[place.lineno - 1].strip()
            yield Mutant(file, numbers, line, old, becomes, data, slice(first, last), f"({becomes})")


def files() -> dict[str, Path]:
    """Return the files of the packages by their names under coop_pin."""
    paths = (path for package in TESTS for path in sorted((PACKAGE / package).rglob("*.py")))
    return {str(path.relative_to(PACKAGE)): path for path in paths}


def all_mutants(under: Iterable[str] = ("",)) -> list[Mutant]:
    """Return every mutant of the packages, or of those packages and files whose names begin so."""
    chosen = {file: path for file, path in files().items() if file.startswith(tuple(under))}
    return [mutant for file, path in chosen.items() for mutant in mutants(file, path.read_text())]


def planted() -> list[Mutant]:
    """Return the faults of planted_faults.toml, each with what is wrong as its text.

    Raises:
        ValueError: what a fault changes does not stand once in its file.
    """
    found = []
    for fault in tomllib.loads(PLANTED.read_text())["fault"]:
        file, what, old, new = (fault[field] for field in ("file", "what", "old", "new"))
        before, *after = (PACKAGE / file).read_text().split(old)
        if len(after) != 1:
            raise ValueError(f"{old!r} stands {len(after)} times in {file}")
        first = before.count("\n") + 1
        lines = range(first, first + old.count("\n") + 1)
        start = len(before.encode())
        span = slice(start, start + len(old.encode()))
        found.append(Mutant(file, lines, what, old, new, (before + old + after[0]).encode(), span, new))
    return found


def equivalent() -> set[tuple[str, ...]]:
    """Return the keys of the mutants that were judged to change nothing."""
    groups = tomllib.loads(EQUIVALENT.read_text())["equivalent"]
    return {tuple(row) for group in groups for row in group["mutants"]}


# ---------------------------------------------------------------- children


def in_children(
    tasks: Iterable[Any], work: Callable[[Any], Any], limit: Callable[[Any], float], workers: int
) -> Iterator[tuple[Any, Any]]:
    """Yield each task and what its work returns in a child process.

    None stands for a crash, or for more processor time than its limit, s (or twenty times that on the clock).
    """
    running: dict[int, Any] = {}
    with tempfile.TemporaryDirectory() as folder:

        def ended() -> tuple[Any, Any]:
            pid = 0
            while pid not in running:
                pid, _ = os.wait()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)  # what the tests of the child started
            answer = Path(folder, str(pid))
            return running.pop(pid), pickle.loads(answer.read_bytes()) if answer.exists() else None

        for task in tasks:
            if len(running) == workers:
                yield ended()
            pid = os.fork()
            if pid == 0:
                _work_as_a_child(lambda task=task: work(task), limit(task), Path(folder))
            running[pid] = task
        while running:
            yield ended()


def _work_as_a_child(work: Callable[[], Any], limit: float, folder: Path) -> None:
    try:
        os.setsid()
        signal.setitimer(signal.ITIMER_PROF, limit)
        signal.setitimer(signal.ITIMER_REAL, 20.0 * limit)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        answer = pickle.dumps(work())
        (folder / "answer").with_suffix(f".{os.getpid()}").write_bytes(answer)
        (folder / "answer").with_suffix(f".{os.getpid()}").rename(folder / str(os.getpid()))
    finally:
        os._exit(0)


@contextlib.contextmanager
def executed_lines(among: Container[str] | None = None) -> Iterator[set[tuple[str, Any]]]:
    """Collect the lines and functions of files that are executed: file and number, file and name.

    Args:
        among: the files by their names under coop_pin; all of the packages when omitted.
    """
    lines: set[tuple[str, Any]] = set()
    names = {str(path): file for file, path in files().items() if among is None or file in among}
    calls: Counter[CodeType] = Counter()

    def line(frame: FrameType, _event: str, _argument: object) -> Any:
        lines.add((names[frame.f_code.co_filename], frame.f_lineno))
        return line

    def call(frame: FrameType, _event: str, _argument: object) -> Any:
        if frame.f_code.co_filename not in names:
            return None
        calls[frame.f_code] += 1
        lines.add((names[frame.f_code.co_filename], _name(frame.f_code)))
        return line if calls[frame.f_code] <= 100 else None  # by then, nearly all that it does was seen

    threading.settrace(call)
    sys.settrace(call)
    try:
        yield lines
    finally:
        sys.settrace(None)
        threading.settrace(None)


def _name(code: CodeType) -> tuple[str, int]:
    return code.co_qualname, code.co_firstlineno


def codes(mutant: Mutant) -> dict[CodeType, CodeType]:
    """Return the code of the module, of its classes and of its functions, before and after the change."""
    path = str(PACKAGE / mutant.file)
    return dict(_pairs(_compiled(Path(path).read_text(), path), _compiled(mutant.source, path)))


@functools.lru_cache(maxsize=8)
def _compiled(text: str, path: str) -> CodeType:
    with warnings.catch_warnings(
        action="ignore", category=SyntaxWarning
    ):  # (1.0)[0] is one, and pytest raises
        return compile(text, path, "exec")


def _pairs(old: CodeType, new: CodeType) -> Iterator[tuple[CodeType, CodeType]]:
    yield old, new
    parts = ([part for part in code.co_consts if isinstance(part, CodeType)] for code in (old, new))
    for before, after in zip(*parts, strict=False):  # a term with a lambda may be the one dropped
        yield from _pairs(before, after)


def _own(code: CodeType) -> tuple[object, ...]:
    constants = [repr(value) for value in code.co_consts if not isinstance(value, CodeType)]
    return code.co_code, code.co_names, code.co_varnames, code.co_freevars, constants


def changed_names(mutant: Mutant) -> set[tuple[str, int]]:
    """Return name and first line of what changes itself, and not only in what it contains."""
    return {_name(before) for before, after in codes(mutant).items() if _own(before) != _own(after)}


def change_functions(mutant: Mutant, functions: list[FunctionType]) -> bool:
    """Give the loaded functions that a mutant changes their new code; False if that is impossible."""
    path, after = str(PACKAGE / mutant.file), codes(mutant)
    fitting = [one for one in functions if one.__code__.co_filename == path and one.__code__ in after]
    changed = {_outermost(name) for name, _ in changed_names(mutant)}
    if changed - {_outermost(function.__code__.co_qualname) for function in fitting}:
        return False
    try:
        for function in fitting:
            function.__code__ = after[function.__code__]
    except ValueError:  # it has other variables of its surroundings now
        return False
    return True


def _outermost(name: str) -> str:
    return name.partition(".<locals>")[0]


def load_changed(mutant: Mutant) -> None:
    """Forget the loaded package and its tests; load them with a mutant from now on."""
    tests = str(REPOSITORY / "tests") + os.sep
    for name, module in list(sys.modules.items()):
        is_test = (getattr(module, "__file__", None) or "").startswith(tests)
        if is_test or name.partition(".")[0] == "coop_pin":  # namespaces too, which have no file
            del sys.modules[name]
    unchanged = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, fullname: str) -> CodeType | None:
        if loader.path == str(PACKAGE / mutant.file):
            return _compiled(mutant.source, loader.path)
        return unchanged(loader, fullname)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]


# ---------------------------------------------------------------- the run, inside of pytest


def first_failure(items: list[pytest.Item], following: pytest.Item | None = None) -> str:
    """Return the name of the first test that fails, or ""; shared fixtures last for the test that follows."""
    for item, next_item in zip(items, [*items[1:], following], strict=False):
        with catch_warnings_for_item(item.config, item.ihook, "runtest", item, record=False):
            reports = runtestprotocol(item, log=False, nextitem=next_item)
        if any(report.failed for report in reports):
            return item.nodeid
    return ""


def _file(name: str) -> str:
    return name.partition("::")[0]


class Chosen:
    """Pytest plugin: of the tests collected, those chosen run in their order."""

    def __init__(self, names: list[str]) -> None:
        self.names = names
        self.failure = "not collected"

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run them in place of all."""
        items = {item.nodeid: item for item in session.items}
        if all(name in items for name in self.names):
            self.failure = first_failure([items[name] for name in self.names])
        return True


class MutationRun:
    """Pytest plugin: tests run for each mutant in place of once."""

    def __init__(self, chosen: list[Mutant], budget: float, workers: int, verbose: bool) -> None:
        self.chosen, self.budget, self.workers, self.verbose = chosen, budget, workers, verbose
        self.files = {mutant.file for mutant in chosen}
        self.alive: list[Mutant] = []
        self.at_import: set[tuple[str, Any]] = set()
        self.seconds: dict[str, float] = {}
        self.lines: dict[str, set[tuple[str, Any]]] = {}
        self.items: dict[str, pytest.Item] = {}
        self.functions: list[FunctionType] = []
        self.noticed: dict[str, Counter[str]] = defaultdict(Counter)
        self.current: set[tuple[str, Any]] = set()
        self.shared: set[tuple[str, Any]] = set()

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Measure the tests, then run them for each mutant."""
        sys.settrace(None)
        self.items = {item.nodeid: item for item in session.items}
        gc.unfreeze()  # what conftest.py has frozen is not listed
        self.functions = [one for one in gc.get_objects() if isinstance(one, FunctionType)]
        gc.freeze()  # children share this memory
        start = time.monotonic()
        test_files = dict.fromkeys(_file(name) for name in self.items)
        for file, found in in_children(test_files, self._measured, lambda _: 600.0, self.workers):
            if found is None:
                raise pytest.UsageError(f"{file} does not end without any change")
            for name, (passed, seconds, lines) in found.items():
                if passed and seconds < LONGEST:
                    self.seconds[name], self.lines[name] = seconds, lines
                else:
                    print(f"not used, {seconds:.1f} s, {passed=}: {name}", flush=True)
        print(f"{len(self.lines)} tests measured in {time.monotonic() - start:.0f} s", flush=True)
        tasks = ((mutant, self.tests_of(mutant)) for mutant in self.chosen)
        for (mutant, names), failure in in_children(tasks, self._failure, self._limit, self.workers):
            if failure:
                self.noticed[mutant.file][failure] += 1
                if self.verbose:
                    key = json.dumps(mutant.key, ensure_ascii=False)
                    print("noticed, line", mutant.lines[0], key, "by", failure, flush=True)
            else:
                unfinished = failure is None and names
                how = "not ended" if unfinished else "alive"
                self.alive += [] if unfinished else [mutant]
                print(f"{how}, line", mutant.lines[0], json.dumps(mutant.key, ensure_ascii=False), flush=True)
        return True

    def _measured(self, file: str) -> dict[str, tuple[bool, float, set[tuple[str, Any]]]]:
        """Return of each test of a file whether it passes, its time, s, and what it executes.

        What a fixture of several tests executes counts for all that follow.
        """
        found = {}
        items = [item for name, item in self.items.items() if _file(name) == file]
        for item, following in zip(items, [*items[1:], None], strict=True):
            start = time.process_time()
            with executed_lines(self.files) as self.current:
                passed = not first_failure([item], following)
            found[item.nodeid] = passed, time.process_time() - start, self.current | self.shared
        return found

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Iterator[None]:
        """Keep what fixtures of several tests execute."""
        before = set(self.current)
        result = yield
        if fixturedef.scope != "function":
            self.shared |= self.current - before
        return result

    def is_loaded(self, mutant: Mutant) -> bool:
        """Return whether the change acts as its file is imported."""
        return any((mutant.file, name) in self.at_import for name in changed_names(mutant))

    def tests_of(self, mutant: Mutant) -> list[str]:
        """Return the tests for a mutant, as many as the budget allows, file by file.

        Those that execute it; if it acts at import, those that execute or import something of its file. First
        those that noticed the most mutants of this file for their time so far, then the shortest.
        """
        noticed, seconds = self.noticed[mutant.file], self.seconds
        place = {(mutant.file, line) for line in mutant.lines}
        is_loaded = self.is_loaded(mutant)
        names = [
            name
            for name, lines in self.lines.items()
            if (self._touches(name, mutant.file) if is_loaded else lines & place)
        ]
        names.sort(key=lambda name: (-noticed[name] / (seconds[name] + 0.01), seconds[name]))
        total = itertools.accumulate(seconds[name] for name in names)
        names = [
            name for name, spent in zip(names, total, strict=True) if spent <= self.budget or name == names[0]
        ]
        first: dict[str, int] = {}
        for rank, name in enumerate(names):
            first.setdefault(_file(name), rank)
        order = {name: index for index, name in enumerate(self.items)}
        return sorted(names, key=lambda name: (first[_file(name)], order[name]))

    def _touches(self, name: str, file: str) -> bool:
        """Return whether a test executes a line of a file, or its own file has something of that one."""
        module = sys.modules["coop_pin." + file.removesuffix(".py").replace("/", ".")]
        made_here = [
            value
            for name, value in vars(module).items()
            if not name.startswith("__") and getattr(value, "__module__", module.__name__) == module.__name__
        ]
        own = {id(module)} | {
            id(value) for value in made_here if not isinstance(value, bool | int | ModuleType | None)
        }
        known = vars(self.items[name].module).values()  # type: ignore[attr-defined]
        return any(id(value) in own for value in known) or any(place == file for place, _ in self.lines[name])

    def _limit(self, task: tuple[Mutant, list[str]]) -> float:
        return 10.0 + 5.0 * sum(self.seconds[name] for name in task[1])

    def _failure(self, task: tuple[Mutant, list[str]]) -> str:
        mutant, names = task
        if not self.is_loaded(mutant) and change_functions(mutant, self.functions):
            return first_failure([self.items[name] for name in names])
        load_changed(mutant)
        chosen = Chosen(names)
        run_pytest(sorted({_file(name) for name in names}), chosen)
        return chosen.failure


def run_pytest(files: Iterable[str], plugin: object) -> None:
    """Run pytest in this process with a plugin: the default tests and those of the gate."""
    quiet = ["-q", "-m", "not slow", "-p", "no:cacheprovider", "-p", "no:xdist"]
    pytest.main([*quiet, "-W", "ignore::pytest.PytestAssertRewriteWarning", *files], plugins=[plugin])


def _test_files(names: Iterable[str], packages: Iterable[str]) -> list[str]:
    """Return the test files of these names, or, without any, those that judge packages."""
    files = {file.stem: str(file) for file in Path("tests").rglob("test_*.py")}
    if names:
        return sorted(files[f"test_{name}"] for name in set(names))
    others = {files[f"test_{name}"] for package in packages for name in TESTS[package].split()}
    return sorted(
        others.union(str(file) for one in packages for file in Path("tests", one).glob("test_*.py"))
    )


def measured_run(chosen: list[Mutant], tests: str, budget: float, workers: int, verbose: bool) -> MutationRun:
    """Return a finished mutation run, with the tests of the packages, or with others."""
    run = MutationRun(chosen, budget, workers, verbose)
    os.chdir(REPOSITORY)
    os.environ |= {"PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    sys.path.insert(0, str(REPOSITORY))
    importlib.import_module("dask.array")  # xarray would load it in every child
    profile = settings(derandomize=True, database=None, phases=[Phase.explicit, Phase.generate])
    settings.register_profile("mutate", profile)  # no search for a simpler example once one fails
    settings.load_profile("mutate")
    with executed_lines(run.files) as run.at_import:
        for file in run.files:
            importlib.import_module("coop_pin." + file.removesuffix(".py").replace("/", "."))
        run_pytest(_test_files(tests.split(), {mutant.package for mutant in chosen}), run)
    return run


def main(arguments: list[str] | None = None) -> int:
    """Run the mutants, print the ones alive and the score of each package, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument(
        "under", nargs="*", default=[""], help="packages or files of coop_pin; all when omitted"
    )
    parser.add_argument("--sample", type=int, help="number of mutants; all when omitted")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--workers", type=int, default=1, help="mutants at a time")
    parser.add_argument("--budget", type=float, default=60.0, help="longest time of the tests of a mutant, s")
    parser.add_argument(
        "--tests", default="", help="test files in place of those of the packages, in one text"
    )
    parser.add_argument("--planted", action="store_true", help="the faults of planted_faults.toml")
    parser.add_argument("--verbose", action="store_true", help="name the test that notices each mutant, too")
    given = parser.parse_args(arguments)
    under, left_out = tuple(given.under), equivalent()
    among = planted() if given.planted else all_mutants(under)
    chosen = [mutant for mutant in among if mutant.file.startswith(under)]
    if given.sample is not None:
        chosen = random.Random(given.seed).sample(chosen, min(given.sample, len(chosen)))
    start = time.monotonic()
    different = [one for one in chosen if one.key not in left_out]
    run = measured_run(different, given.tests, given.budget, given.workers, given.verbose)
    alive, ran = Counter(one.package for one in run.alive), Counter(one.package for one in run.chosen)
    for package, total in sorted(Counter(one.package for one in chosen).items()):
        noticed, others = ran[package] - alive[package], ran[package]
        print(
            f"{package}: {total} mutants, {total - others} equivalent, {noticed} of the others noticed",
            end="",
        )
        print(f", {noticed / max(others, 1):.1%}")
    print(f"{time.monotonic() - start:.0f} s")
    return int(any(alive[package] > (1.0 - FLOOR) * ran[package] for package in ran))


if __name__ == "__main__":
    sys.exit(main())
