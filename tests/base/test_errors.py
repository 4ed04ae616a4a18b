"""Errors as values: they carry numbers, can be pickled, and derive from fitting built-in exceptions."""

import copy
import inspect
import pickle
import re
import subprocess
import sys
from pathlib import Path

import pytest

from coop_pin.base import errors

CLASSES = [
    thing for thing in vars(errors).values() if inspect.isclass(thing) and issubclass(thing, BaseException)
]
SAMPLES = {
    "tuple[int": (1, 2),
    "FieldError": [errors.FieldError("is 1", "a.b"), errors.UnknownFieldError("is 2", "c")],
    "Iterable[": ["one", "two"],
    "Sequence[": ["one", "two"],
    "Exception": ZeroDivisionError("division by zero"),
    "float": 0.25,
    "int": 2,
}


def sample(kind):
    """An error with a value of the right type for each parameter of its constructor."""
    if not inspect.isfunction(kind.__init__):
        return kind("a message")
    parameters = list(inspect.signature(kind.__init__).parameters.values())[1:]
    return kind(
        *(next((v for part, v in SAMPLES.items() if part in str(p.annotation)), "text") for p in parameters)
    )


def test_every_error_can_be_sent_between_processes():
    for kind in CLASSES:
        if issubclass(kind, Warning):
            continue
        error = sample(kind)
        error.result = "a result"
        for twin in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
            assert type(twin) is kind
            assert str(twin) == str(error) != ""
            assert {k: str(v) for k, v in vars(twin).items()} == {k: str(v) for k, v in vars(error).items()}


def test_a_field_error_keeps_its_type_and_refers_to_itself_wherever_it_goes():
    inner = errors.UrdfError("has 2 ends", "tip", ["one", "two"])
    outer = pickle.loads(pickle.dumps(inner.below("arms.left").below("cell")))
    assert (type(outer), outer.path, outer.names) == (errors.UrdfError, "cell.arms.left.tip", ("one", "two"))
    assert outer.problems == (outer,)
    assert str(outer) == "cell.arms.left.tip: has 2 ends"
    assert (inner.path, inner.problems) == ("tip", (inner,))


def test_several_mistakes_are_one_error_and_one_is_itself():
    problems = SAMPLES["FieldError"]
    both = errors.one_or_all(problems, "the file")
    assert (type(both), both.problems) == (errors.ScenarioError, tuple(problems))
    assert all(str(problem) in str(both) for problem in problems)
    assert errors.one_or_all(problems[1:], "the file") is problems[1]


def test_errors_are_caught_as_the_builtin_exceptions_that_fit_them():
    for builtin, kinds in {
        ValueError: (errors.ShapeError, errors.FieldError, errors.FileReadError, errors.UnreachablePoseError),
        KeyError: (errors.NameNotFoundError,),
        ImportError: (errors.MissingExtraError, errors.MissingPinocchioError),
        ArithmeticError: (errors.DivergedError, errors.SingularJacobianError, errors.MassMatrixError),
        OSError: (
            errors.FileWriteError,
            errors.PortTakenError,
            errors.WorkersLostError,
            errors.RunTimeoutError,
        ),
        KeyboardInterrupt: (errors.RunInterruptedError, errors.SweepInterruptedError),
    }.items():
        for kind in kinds:
            assert issubclass(kind, builtin)
    assert str(errors.NameNotFoundError("frame", "tipp", ["tip"], "the model")).startswith("no frame 'tipp'")
    assert not issubclass(errors.RunInterruptedError, Exception)


def test_an_optional_package_that_is_missing_names_its_extra():
    with (
        pytest.raises(
            errors.MissingExtraError, match=r"to test this, run: pip install 'coop-pin\[test\]'"
        ) as caught,
        errors.needs_extra("no-such", "test", "to test this"),
    ):
        import no_such_package  # noqa: F401
    assert (caught.value.package, caught.value.extra) == ("no-such", "test")
    with pytest.raises(ZeroDivisionError), errors.needs_extra("no-such", "test", "to test this"):
        1 / 0  # noqa: B018


def test_every_error_class_is_used():
    """No class without a place that raises it, or children that are raised."""
    files = [file for file in Path(errors.__file__).parents[1].rglob("*.py") if file.name != "errors.py"]
    text = "\n".join(file.read_text(encoding="utf-8") for file in files)
    unused = [
        kind.__name__
        for kind in CLASSES
        if not kind.__name__.startswith("_") and not re.search(rf"\b{kind.__name__}\b", text)
    ]
    assert unused == []


@pytest.mark.parametrize(
    ("known", "said"),
    [
        (["left", "right"], "did you mean 'left'?"),
        (["a", "b"], "known: 'a', 'b'"),
        ([f"n{k}" for k in range(20)], "and 8 more"),
    ],
)
def test_a_wrong_name_is_told_the_closest_ones_or_all(known, said):
    assert said in errors.suggestion("lefft", known)


@pytest.mark.parametrize("error", ["RunInterruptedError(1.0, None)", "SweepInterruptedError('out', 1, 2)"])
def test_a_script_ends_after_ctrl_c_with_the_message_alone_and_130(error):
    """The shell's code of the signal; other errors keep their traceback."""
    script = f"from coop_pin import errors\nraise errors.{error}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 130
    assert "interrupted" in done.stderr
    assert "Traceback" not in done.stderr
    caught = f"from coop_pin import errors\ntry: raise errors.{error}\nexcept KeyboardInterrupt: 1 / 0"
    done = subprocess.run([sys.executable, "-c", caught], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "Traceback" in done.stderr
