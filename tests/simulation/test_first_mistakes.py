"""The commonest slips in a first law, motion or callback: the user's file, line and function are named."""

import inspect

import mistaken_laws
import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import CommandError, FieldError, UserCodeError


def mistaken(cell, law, engine="pinocchio"):
    """The error of a run with a mistaken law."""
    changes = {
        "duration": 0.1, "events": [], "sensors": {},
        "controller": {"kind": "user", "target": f"mistaken_laws:{law}"},
    }  # fmt: skip
    with pytest.raises(cp.CoopPinError) as caught:
        cp.run(SCENARIOS[cell]().override(changes), engine=engine, warn=False)
    return caught.value


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize(
    ("law", "problem"),
    [
        ("ReturnsTorques", "ndarray"),
        ("ReturnsTuple", "tuple"),
        ("ReturnsNothing", "nothing"),
        ("CellTorques", "list"),
        ("ReturnsNan", "NaN for drive 1 of arm 'left'"),
        ("CellNan", "NaN for drive 0 of arm 'left'"),
    ],
)
def test_a_law_that_returns_no_command_is_named_with_its_place(cell, engine, law, problem):
    error = mistaken(cell, law, engine)
    step = getattr(mistaken_laws, law).step
    assert isinstance(error, CommandError)
    assert (error.function, error.line) == (f"{law}.step", inspect.getsourcelines(step)[1])
    assert error.file.endswith("mistaken_laws.py")
    assert problem in error.problem
    assert error.time == (0.0 if "Nan" not in law or law == "CellNan" else pytest.approx(0.03, abs=0.013))


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize("law", ["Raises", "Exits"])
def test_a_law_that_raises_or_ends_the_program_is_named_with_its_line(cell, engine, law):
    error = mistaken(cell, law, engine)
    lines, first = inspect.getsourcelines(getattr(mistaken_laws, law).step)
    assert isinstance(error, UserCodeError)
    assert (error.function, error.line) == (f"{law}.step", first + len(lines) - 1)
    assert error.cause.startswith({"Raises": "AttributeError", "Exits": "SystemExit: 3"}[law])
    assert ("is kept" in str(error)) == (error.result is not None) == (error.time > 0.0)


@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize(
    ("law", "problem"),
    [
        ("ComplexTorques", "complex128"),
        ("TruthValues", "bool"),
        ("NoNumbers", "<U4"),
        ("WithGradient", "detach()"),
        ("OneTorque", "shape (1,)"),
    ],
)
def test_torques_that_are_not_one_real_number_for_each_drive_are_named_with_their_place(cell, law, problem):
    error, step = mistaken(cell, law), getattr(mistaken_laws, law).step
    assert isinstance(error, CommandError)
    assert (error.function, error.line) == (f"{law}.step", inspect.getsourcelines(step)[1])
    assert error.file.endswith("mistaken_laws.py")
    assert problem in str(error)
    assert "one real number for each drive" in str(error)


@pytest.mark.parametrize("law", ["NoInit", "NoState"])
def test_a_class_without_the_methods_of_a_law_is_refused_before_the_run(law):
    error = mistaken("planar", law)
    assert isinstance(error, FieldError)
    assert error.path == "controller.target"
    assert {"NoInit": "def init(self, measurement, reference)", "NoState": "def step("}[law] in str(error)


@pytest.mark.parametrize("called", ["view", "progress"])
def test_a_callback_that_raises_is_named(called):
    def careless(*_):
        raise ValueError("a mistake")

    with pytest.raises(UserCodeError) as caught:
        cp.run(
            "adept-paper",
            {"duration": 0.1, "events": []},
            warn=False,
            realtime_rate=np.inf,
            **{called: careless},
        )
    assert caught.value.function.endswith("careless")
    assert caught.value.file.endswith("test_first_mistakes.py")
