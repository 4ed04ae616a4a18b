"""The compiler of numerical Python: tape, traced scalars and arrays, trees, kernels and machines.

``test_tracing_alone`` runs these tests on a copy of the package, too, where there is no coop_pin.
"""

import contextlib
import ctypes
import dataclasses
import inspect
import itertools
import math
import re
import shutil
import subprocess
import sys
import threading
from collections import deque
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy_machine import NumpyMachine

from coop_pin.tracing import elementary, traced_array
from coop_pin.tracing.evaluation import evaluate
from coop_pin.tracing.kernel import RECORD, Kernel, Layout, Program
from coop_pin.tracing.llvm_emitter import llvm_text
from coop_pin.tracing.llvm_machine import LlvmMachine
from coop_pin.tracing.tape import Tape, UntraceableError, operands
from coop_pin.tracing.traced_array import TracedMask, TracedScalar, inputs, parts, traced
from coop_pin.tracing.tree import SharedFunctions, leaves, rebuilt, structure

FOLDER = Path(inspect.getfile(Tape)).parent
README = (FOLDER / "README.md").read_text(encoding="utf-8")


def values_of(tape, numbers, arguments):
    """Values of traced numbers for values of the inputs of their tape."""
    return evaluate(tape, operands(tape, numbers), arguments)


# ---------------------------------------------------------------- traced scalars and arrays


def test_constants_fold_and_equal_operations_are_recorded_once():
    tape = Tape()
    x, y = inputs(tape), inputs(tape)
    assert 0.0 * x == 0.0
    assert (1.0 * x).index == (x + 0.0).index == (0.0 + x).index == x.index
    minus = -x
    assert (-minus).index == x.index
    assert x - x == 0.0
    assert (x * y).index == (y * x).index
    assert ((x + 2.0) * y).index == (y * (2.0 + x)).index
    assert elementary.exp(1.0) == math.e
    assert len(tape.live(operands(tape, [x * y + x * y]))) == 4


def test_numbers_are_not_taken_for_the_indices_of_operations():
    """The first input has index 0, which equals the constant 0.0 in Python."""
    tape = Tape()
    x, y = inputs(tape), inputs(tape)
    values = [x + 5.0, 5.0 + x, x - 5.0, x + y, y * 2.0, y + 1.0, x * 7.0, x / 3.0]
    assert values_of(tape, values, [10.0, 20.0]) == [15.0, 15.0, 5.0, 30.0, 40.0, 21.0, 70.0, 10.0 / 3.0]


@pytest.mark.parametrize(
    "branch",
    [
        lambda x: 1.0 if x > 0.0 else 2.0,
        math.exp,
        float,
        lambda x: np.linalg.eigvals(traced([[x, 1.0], [0.0, x]])),
        lambda x: np.arcsinh(traced([x])),
        lambda x: x**3,
        lambda x: x + "a",
        lambda x: x + inputs(Tape()),
    ],
)
def test_what_cannot_be_traced_is_refused(branch):
    with pytest.raises(UntraceableError):
        branch(inputs(Tape()))


SPECIAL = [-math.inf, -2.0, -0.5, 0.0, 0.5, 2.0, math.inf, math.nan]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    "function",
    [
        *(np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal),
        *(np.minimum, np.maximum, np.multiply, np.add, np.subtract, np.divide),
    ],
)
def test_pairs_with_nan_and_inf_are_those_of_numpy(function):
    """Also with a constant on either side, which may fold."""
    for a in SPECIAL:
        for b in SPECIAL:
            wanted = float(function(np.float64(a), np.float64(b)))
            tape = Tape()
            x, y = inputs(tape, 1), inputs(tape, 1)
            with tape.exact(True):
                found = [function(x, y)[0], function(x, b)[0], function(a, y)[0]]
            np.testing.assert_array_equal(values_of(tape, found, [a, b]), [wanted] * 3, err_msg=f"{a} {b}")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("function", [np.sign, np.absolute, np.exp, np.log, np.sqrt, np.tanh])
def test_functions_of_nan_and_inf_are_those_of_numpy(function):
    tape = Tape()
    found = function(inputs(tape, 1))[0]
    for x in [*SPECIAL, -1e4, 1e4]:
        (value,) = values_of(tape, [found], [x])
        np.testing.assert_allclose(value, function(x), rtol=1e-15, err_msg=str(x))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_angles_of_infinite_and_undefined_points_are_those_of_numpy():
    tape = Tape()
    with tape.exact(True):
        found = elementary.atan2(inputs(tape), inputs(tape))
    for y, x in itertools.product([*SPECIAL, 1.0, -2.0], repeat=2):
        (value,) = values_of(tape, [found], [y, x])
        assert_allclose(value, np.arctan2(y, x), rtol=1e-15, err_msg=f"{y} {x}")


def any_doubles():
    """Doubles of all magnitudes, the largest, least, special and negative ones among them."""
    rng = np.random.default_rng(7)
    bits = rng.integers(2**64, size=2000, dtype=np.uint64).view(np.float64)
    edges = [0.0, -0.0, 5e-324, 1e-310, 2.2e-308, 1e-16, 701.0, 708.5, 720.0, 745.2, 746.1, 709.5, 709.79]
    edges += [800.0, 0.5, 1.5, 1e5, 1.1e5, 1e9, 2.0**51 - 0.5, 2.0**51 + 0.5, 2.0**52 + 1.0, 1e22, math.nan]
    shared = np.concatenate([edges, rng.normal(size=1000), 10.0 ** rng.uniform(-320, 308, 1000)])
    return np.concatenate([bits, shared, -shared, SPECIAL])


ONE_ARGUMENT = {
    **{function.__name__: function for function in (np.sin, np.cos, np.tanh, np.exp, np.expm1, np.log)},
    **{function.__name__: function for function in (np.sqrt, np.sign, np.rint, np.square, np.absolute)},
    "choice by a number": lambda x: np.where(x, 1.0, 0.0),
    "quotient of a small power of two": lambda x: x / 2.0**-1030,
    "sign of a zero": lambda x: np.arctan2(x, -1.0),
    "sign of another zero": lambda x: np.arctan2(1.0, 1.0 / (-x)),
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", ONE_ARGUMENT)
def test_functions_of_any_double_are_those_of_numpy_or_make_exact_code_invalid(name):
    tape, function, x = Tape(), ONE_ARGUMENT[name], any_doubles()
    with tape.exact(True):
        (value,) = function(inputs(tape, 1))
    found, *guards = np.broadcast_arrays(*values_of(tape, [value, *tape.guards], [x]), x)[:-1]
    is_valid = np.all([np.ones(len(x)), *guards], axis=0)
    allowed = 1e-15 if name in ("sin", "cos") else 0.0
    assert_allclose(
        found[is_valid], function(x)[is_valid], rtol=2e-12 if name == "tanh" else 3e-15, atol=allowed
    )
    assert is_valid.mean() > 0.45
    assert is_valid[np.abs(x) <= 700.0].all() or name == "log"
    inexact = Tape()
    function(inputs(inexact, 1))
    assert not inexact.guards


def test_exact_code_of_an_inverse_is_valid_for_well_conditioned_matrices():
    tape = Tape()
    with tape.exact(True):
        np.linalg.inv(inputs(tape, 2, 2))
    for smallest, is_valid in ((1.0, True), (1.01e-6, True), (0.99e-6, False), (0.0, False)):
        with np.errstate(all="ignore"):
            guards = values_of(tape, tape.guards, [1.0, 0.0, 0.0, smallest])
        assert all(guard == 1.0 for guard in guards) == is_valid


def test_exact_code_that_asks_numpy_to_raise_is_refused():
    tape = Tape()
    x = inputs(tape, 2)
    with np.errstate(divide="raise"), tape.exact(True), pytest.raises(UntraceableError, match="errstate"):
        1.0 / x
    assert tape.refusals
    with np.errstate(divide="raise"):
        assert type((1.0 / x)[0]) is TracedScalar


def test_differences_and_products_fold_where_diverged_runs_are_refused_anyway():
    tape = Tape()
    (x,) = inputs(tape, 1)
    assert 0.0 * x == x - x == 0.0
    with tape.exact(True):
        assert [type(each) for each in (0.0 * x, x - x, 0.0 / x)] == [TracedScalar] * 3


def test_truth_values_are_no_numbers():
    tape = Tape()
    x, y = inputs(tape, 2), inputs(tape, 2)
    truths = [x > y, (x > 0.0) & (y > 0.0), (x > 0.0) | (y > 0.0), ~(x > 0.0), (x > y) * (y > 0.0)]
    assert all(type(truth[0]) is TracedMask for truth in truths)
    assert type((2.0 * (x > y))[0]) is type((1.0 - (x > y))[0]) is TracedScalar
    found = [values_of(tape, truth, [-1.0, 3.0, 1.0, 2.0]) for truth in truths]
    assert found == [[0, 1], [0, 1], [1, 1], [1, 0], [0, 1]]
    for refused in (
        lambda: (x > y) + (x > 0.0),
        lambda: (x > y) - (x > 0.0),
        lambda: -(x > y),
        lambda: ~(x[0] > 0.0),
        lambda: ~x,
        lambda: x & y,
        lambda: np.sum(x > y),
    ):
        with pytest.raises(UntraceableError):
            refused()


def test_sums_and_products_of_arrays_are_those_of_numpy():
    tape, values = Tape(), [2.0, 3.0, 7.0]
    x = inputs(tape, 3)
    found = [x.sum(), np.sum(x), np.add.reduce(x), np.multiply.reduce(x), x @ x, np.any(x > 5.0) * 1.0]
    assert values_of(tape, found, values) == [12.0, 12.0, 12.0, 42.0, 62.0, 1.0]


def test_parts_have_their_sizes():
    tape = Tape()
    x = inputs(tape, 6)
    assert [[entry.index for entry in part] for part in parts(x, (1, 2, 3))] == [[0], [1, 2], [3, 4, 5]]


def test_quotients_by_constants_have_the_bits_of_python():
    tape, x = Tape(), np.random.default_rng(9).normal(size=200)
    divisors = [3.0, -8.0, 0.125, 0.7, 2.0**-1022, 2.0**1023]
    for divisor, found in zip(
        divisors, values_of(tape, [inputs(tape) / d for d in divisors], [x] * 6), strict=True
    ):
        assert_array_equal(found, x / divisor)


def test_truth_values_in_a_state_stay_truth_values():
    tape = Tape()
    state = {"late": inputs(tape, 2) > 0.0, "count": inputs(tape)}
    again = rebuilt(state, iter(inputs(tape, 3)))
    assert [type(each) for each in (*again["late"], again["count"])] == [TracedMask] * 2 + [TracedScalar]
    assert structure(again) == structure(state) != structure({**state, "late": inputs(tape, 2)})


@pytest.mark.parametrize(
    "caught",
    [
        bool,
        float,
        round,
        hash,
        lambda x: x.item(),
        lambda x: np.cbrt(x),
        lambda x: x**3,
        lambda x: np.round(x, 1),
    ],
)
def test_a_refusal_that_is_caught_stays_on_the_tape(caught):
    tape = Tape()
    x = inputs(tape)
    with contextlib.suppress(Exception):
        caught(x)
    assert tape.refusals


@pytest.mark.parametrize(
    ("name", "low", "high", "allowed"),
    [
        ("sin", -50.0, 50.0, 4e-16),
        ("cos", -50.0, 50.0, 4e-16),
        ("tanh", -20.0, 20.0, 4e-16),
        ("exp", -30.0, 30.0, 5e-16),
        ("sqrt", 0.0, 9.0, 0.0),
    ],
)
def test_elementary_functions_are_accurate(name, low, high, allowed):
    tape = Tape()
    x = np.random.default_rng(1).uniform(low, high, 20_000)
    (found,) = values_of(tape, [getattr(elementary, name)(inputs(tape))], [x])
    wanted = getattr(np, name)(x)
    scale = wanted if name == "exp" else np.ones_like(wanted)
    assert np.abs((found - wanted) / scale).max() <= allowed


def test_the_arc_tangent_is_accurate_in_all_quadrants():
    tape, rng = Tape(), np.random.default_rng(2)
    y, x = rng.normal(size=(2, 20_000)) * 10.0 ** rng.uniform(-6, 6, (2, 20_000))
    (found,) = values_of(tape, [elementary.atan2(inputs(tape), inputs(tape))], [y, x])
    assert np.abs(found - np.arctan2(y, x)).max() < 1e-15


def test_logarithm_and_exponential_less_one_are_accurate_over_all_magnitudes():
    tape, rng = Tape(), np.random.default_rng(6)
    x = rng.normal(size=2000) * 10.0 ** rng.uniform(-12, 2, 2000)
    y = 10.0 ** rng.uniform(-300, 300, 2000)
    outputs = [elementary.expm1(inputs(tape)), elementary.log(inputs(tape))]
    with np.errstate(all="ignore"):  # in branches that are not selected
        less_one, logarithm = values_of(tape, outputs, [x, y])
        assert np.isnan(values_of(tape, outputs[1:], [x, -y])).all()
    assert_allclose(less_one, np.expm1(x), rtol=2e-15)
    assert_allclose(logarithm, np.log(y), rtol=1e-15)


def test_the_inverse_pivots():
    tape, rng = Tape(), np.random.default_rng(3)
    A = rng.normal(size=(6, 6, 500))
    A[0, 0] = 0.0  # elimination without pivots would divide by zero
    entries = inputs(tape, 6, 6)
    inverse = np.array(values_of(tape, list(np.linalg.inv(entries).flat), list(A.reshape(36, -1))))
    wanted = np.linalg.inv(np.moveaxis(A, 2, 0))
    error = np.abs(np.moveaxis(inverse.reshape(6, 6, -1), 2, 0) - wanted)
    condition = np.linalg.cond(np.moveaxis(A, 2, 0))
    assert (error.max(axis=(1, 2)) / (condition * np.abs(wanted).max(axis=(1, 2)))).max() < 1e-15


# ---------------------------------------------------------------- trees


class Pair(NamedTuple):
    """A state."""

    first: object
    second: object


@dataclasses.dataclass(frozen=True)
class Gains:
    """Gains of a law."""

    stiffness: object
    name: str = "spring"


class Filter:
    """A class that is a tree by a method of its own."""

    def __init__(self, **attributes):
        vars(self).update(attributes)

    def __tree__(self):
        return vars(self), lambda attributes: Filter(**attributes)


class Switch(Filter):
    """A class of which one attribute is constant."""

    def __tree__(self):
        return {"width": self.width}, lambda parts: Switch(**parts, name=self.name)


class Ordinary:
    """A class that is no tree."""

    def __init__(self):
        self.gain = 1.0


NESTED = {
    "pair": Pair(1.0, np.arange(4.0).reshape(2, 2)),
    "gains": Gains([2, np.float64(3.0)]),
    "switch": Switch(width=0.1, name="soft"),
    "view": MappingProxyType({"x": 5.0}),
    "others": (None, True, "text", np.array([True, False]), slice(0, 3)),
}


def test_trees_are_read_rebuilt_and_compared_leaf_by_leaf():
    law = Filter(tree=NESTED, inner=Filter(gain=7.0))
    numbers = leaves(law)
    assert numbers == [1.0, 0.0, 1.0, 2.0, 3.0, 2, 3.0, 0.1, 5.0, 7.0]
    twice = rebuilt(law, iter([2.0 * number for number in numbers]))
    assert leaves(twice) == [2.0 * number for number in numbers]
    assert leaves(law) == numbers  # which is as it was
    assert (type(twice), type(twice.inner), twice.tree["switch"].name) == (Filter, Filter, "soft")
    assert [type(part) for part in twice.tree.values()] == [type(part) for part in NESTED.values()]
    assert structure(twice) == structure(law)
    assert hash(structure(law)) == hash(structure(twice))
    for name, value in (
        ("pair", Pair(1.0, np.zeros(4))),
        ("others", (None,)),
        ("gains", Gains(1.0, "damper")),
    ):
        assert structure(Filter(tree=NESTED | {name: value}, inner=law.inner)) != structure(law)


@pytest.mark.parametrize(
    "value",
    [
        np.tanh,
        lambda x: x,
        partial(max, 1.0),
        Ordinary(),
        Filter,
        math,
        object(),
        iter([1.0]),
        deque([1.0]),
        {1.0},
        1j,
        np.complex128(1j),
        threading.Lock(),
        np.random.default_rng(0),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_tree_is_refused_by_the_names_of_attribute_and_class(value):
    law = Filter(gain=1.0, noise=value)
    for read in (leaves, structure, lambda tree: rebuilt(tree, iter([1.0]))):
        with pytest.raises(UntraceableError, match=rf"{type(value).__name__}.*'noise'.*test_tracing\.Filter"):
            read(law)
    with pytest.raises(UntraceableError, match="0 of list"):
        leaves(Filter(noises=[value]))
    with pytest.raises(UntraceableError, match=type(value).__name__):
        leaves(value)


def test_what_is_made_anew_at_each_reading_is_not_taken_for_what_was_there_before():
    class Halves:
        def __init__(self, width):
            self.width = width

        def __tree__(self):
            halves = {} if self.width < 0.1 else {side: Halves(0.5 * self.width + side) for side in (0, 0.01)}
            return {"width": self.width, **halves}, lambda parts: Halves(parts["width"])

    def widths(tree):
        parts = list(tree.__tree__()[0].values())
        return parts[:1] + [width for part in parts[1:] for width in widths(part)]

    assert leaves(Halves(1.0)) == widths(Halves(1.0))


def test_functions_of_equal_structure_and_numbers_are_traced_once():
    functions, tape, calls = SharedFunctions(), Tape(), []

    def stretched(gains, x):
        calls.append(gains)
        return {"sum": gains.stiffness * x[0] + x[1], "constant": 2.0 * gains.stiffness}

    x, stiffness = inputs(tape, 2), inputs(tape)
    results = [functions.call(tape, stretched, Gains(gain), x) for gain in (3.0, 3.0 + 1e-15, 4.0)]
    results.append(functions.call(tape, stretched, Gains(stiffness), x))  # a traced constant is an argument
    assert len(calls) == 3
    assert [result["constant"] for result in results[:3]] == [6.0, 6.0, 8.0]
    outputs = [*(result["sum"] for result in results), results[3]["constant"]]
    assert values_of(tape, outputs, [10.0, 1.0, 5.0]) == [31.0, 31.0, 41.0, 51.0, 10.0]


# ---------------------------------------------------------------- programs and machines


def small_program():
    lanes, uniforms = Layout(), Layout()
    lanes.add(x=(2,))
    uniforms.add(h=())
    kernel = Kernel("advance", lanes, uniforms)
    x = kernel.read("x")
    kernel.write("x", [x[0] + kernel.uniform("h") * x[1], np.exp(x[1])])
    return Program([kernel], lanes, 2, 0, np.array([(0, 0), (RECORD, 0)]))


def test_a_field_that_is_there_already_or_of_another_size_is_refused_by_name():
    lanes = Layout()
    lanes.add(x=(2, 3))
    kernel = Kernel("advance", lanes, Layout())
    for call in (
        lambda: lanes.add(x=()),
        lambda: kernel.write("x", np.zeros(5)),
        lambda: lanes.filled("x", 1),
    ):
        with pytest.raises(ValueError, match="'x'"):
            call()
    assert lanes.filled("x", 6) == list(range(6))


def test_a_program_needs_as_many_rows_as_its_instructions_name():
    program = Program((), Layout(), 0, 0, np.array([(0, 7), (RECORD, 2)]))
    assert (program.rows(RECORD), program.rows(0), program.rows(1)) == (3, 8, 0)


def test_the_bits_of_a_small_program_do_not_depend_on_the_vector_width():
    block = np.vstack((np.arange(11.0), 0.3 * np.arange(11.0)))
    machines = [
        NumpyMachine(small_program()),
        *(LlvmMachine(small_program(), width) for width in (1, 2, 4, 8)),
    ]
    given = np.array([[0.1]]), np.zeros((1, 0, 11))
    records = [machine.run(block.copy(), *given) for machine in machines]
    for record in records:
        assert_array_equal(record, records[0])


def test_a_text_for_other_lanes_is_refused_before_it_writes_beyond_its_memory():
    """Programs of which only the text is kept have no kernels."""
    written = small_program()._replace(text=llvm_text(small_program(), 2), width=2, kernels=())
    assert LlvmMachine(written, 2).width == 2
    with pytest.raises(ValueError, match=r"2.*4"):
        LlvmMachine(written, 4)


@pytest.mark.parametrize("machine", [NumpyMachine, LlvmMachine])
def test_a_record_is_written_into_the_memory_that_its_owner_gives(machine):
    """Whatever is in it; without it the record is in new memory, and an earlier one stays."""
    machine, block = machine(small_program()), np.vstack((np.arange(11.0), 0.3 * np.arange(11.0)))
    arguments = np.array([[0.1]]), np.zeros((1, 0, 11))
    first, second = (machine.run(block.copy(), *arguments) for _ in range(2))
    assert not np.shares_memory(first, second)
    out = np.full(machine.record_size(11) + 5, np.nan)
    third = machine.run(block.copy(), *arguments, out=out)
    assert np.shares_memory(third, out)
    assert_array_equal(third, first)
    for wrong in (
        out[: machine.record_size(11) - 1],
        out.astype(np.float32),
        np.repeat(out, 2)[::2],
        out[None],
    ):
        with pytest.raises(ValueError, match="out"):
            machine.run(block.copy(), *arguments, out=wrong)
    assert_array_equal(third, first)


def test_compiled_code_is_taken_from_a_cache(monkeypatch):
    block, cache = np.array([[1.0, 2.0, 3.0], [0.0, 1.0, -1.0]]), {}
    for code in ([], [None]):  # compiled, then kept
        record = LlvmMachine(small_program(), cache=cache).run(
            block.copy(), np.array([[0.5]]), np.zeros((1, 0, 3))
        )
        assert_allclose(record[0], [[1.0, 2.5, 2.5], np.exp([0.0, 1.0, -1.0])], rtol=4e-16)
        assert len(cache) == 1, code
        monkeypatch.setattr("llvmlite.binding.TargetMachine.emit_object", None)
    with pytest.raises(TypeError):
        LlvmMachine(small_program(), width=1, cache=cache)  # other code


def test_the_compiler_is_loaded_when_it_is_needed():
    names = [f"{Tape.__module__.rpartition('.')[0]}.{file.stem}" for file in FOLDER.glob("*.py")]
    load = (
        f"import importlib, sys; sys.path[:] = {sys.path}\nfor name in {names}: importlib.import_module(name)"
    )
    subprocess.run([sys.executable, "-c", f"{load}\nassert 'llvmlite' not in sys.modules"], check=True)


# ---------------------------------------------------------------- README


def test_the_readme_names_every_function_of_numpy_that_is_known():
    known = {*traced_array.UFUNCS, *traced_array.FUNCTIONS, *traced_array.REARRANGING, *traced_array.INEXACT}
    _, table = README.split("| functions of numpy |")
    names = re.findall(r"`([\w.]+)`", table[: table.index("\n\n")])
    assert sorted(name.rpartition(".")[2] for name in names) == sorted(
        {function.__name__ for function in known} | {"matmul"}
    )


@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")
def test_the_example_of_the_readme_gives_the_same_bits_by_vectors_and_by_c(tmp_path, capsys):
    (code,) = re.findall(r"^```python\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
    found = {}
    exec(code, found)
    (tmp_path / "step.c").write_text(capsys.readouterr().out, encoding="utf-8")
    command = ["cc", "-std=c99", "-O2", "-shared", "-fPIC", "step.c", "-o", "step.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    step = ctypes.CDLL(str(tmp_path / "step.so")).step
    step.argtypes, step.restype = (ctypes.POINTER(ctypes.c_double), ctypes.c_double), None
    runs = np.random.default_rng(0).normal(size=(2, 5000))
    for index in (0, 1, 4999):
        x = (ctypes.c_double * 2)(*runs[:, index])
        for _ in range(1000):
            step(x, 1e-3)
        assert_array_equal(found["runs"][:, index], list(x))
    assert np.abs(found["runs"]).max() < 100.0
