"""Without a suitable Pinocchio, the first package that needs it says why and what to install."""

import os
import pickle
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from coop_pin.base.errors import MissingPinocchioError
from coop_pin.model import OLDEST, TOO_NEW, import_pinocchio

REPOSITORY = Path(__file__).resolve().parents[2]
REQUIREMENTS = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "dependencies"
]
MODULES = [
    "model",
    "chain",
    "grasps",
    "feasibility",
    "stability",
    "design",
    "simulation",
    "simulation.build_controller",
    "viz.replay",
    "chain.kkt_solver",
    "feasibility.path_following",
]


def told_by(folder, source, *statements):
    """What each statement raises in a fresh process where ``pinocchio`` is a package of this source."""
    (folder / "pinocchio").mkdir()
    (folder / "pinocchio" / "__init__.py").write_text(source)
    code = "\n".join(
        f"try:\n    {statement}\nexcept Exception as error:\n    print(type(error).__name__, '|', error)"
        for statement in statements
    )
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_real_one_passes():
    assert import_pinocchio() is sys.modules["pinocchio"]


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (
            "raise ModuleNotFoundError(\"No module named 'pinocchio'\", name='pinocchio')",
            "Pinocchio is not installed.",
        ),
        (
            "raise ImportError('libpinocchio_default.so: cannot open')",
            "Pinocchio does not load: libpinocchio_default.so: cannot open.",
        ),
        (
            "__version__ = '0.1'",
            "is not Pinocchio; rename or remove it"
            " (on PyPI a plugin for nose has that name: pip uninstall pinocchio).",
        ),
        (
            "__version__ = '3.9.0'\ndef buildModelFromXML(text): ...",
            "Pinocchio 3.9.0 is installed; coop_pin needs 4.1 or later, before 5.",
        ),
        (
            "__version__ = '5.0.0'\ndef buildModelFromXML(text): ...",
            "Pinocchio 5.0.0 is installed; coop_pin needs 4.1 or later, before 5.",
        ),
        (
            "__version__ = '4'\ndef buildModelFromXML(text): ...",
            "Pinocchio 4 is installed; coop_pin needs 4.1 or later, before 5.",
        ),
    ],
    ids=["absent", "broken", "nose plugin", "too old", "too new", "short version"],
)
def test_whatever_is_asked_for_first_says_what_is_there_and_what_to_install(source, said, tmp_path):
    lines = told_by(
        tmp_path,
        source,
        *(f"import coop_pin.{module}" for module in MODULES),
        "import coop_pin; coop_pin.run('adept-paper')",
    )
    (line,) = set(lines)
    assert len(lines) == len(MODULES) + 1
    kind, _, message = line.partition(" | ")
    assert kind == "MissingPinocchioError"
    assert said in message
    for command in ("pip install 'pin>=4.1,<5'", "conda install -c conda-forge 'pinocchio>=4.1,<5'"):
        assert command in message


def test_the_command_line_says_so_without_a_traceback_and_what_needs_no_pinocchio_works(tmp_path):
    absent = "import sys; sys.modules['pinocchio'] = None; from coop_pin.cli import main"
    for words, code in (
        (["list"], 0),
        (["fields", "adept-paper"], 0),
        (["run", "adept-paper"], 2),
        (["check", "adept-paper"], 2),
    ):
        done = subprocess.run(
            [sys.executable, "-c", f"{absent}; sys.exit(main({words}))"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == code, done.stderr
        assert (
            not done.stderr
            if code == 0
            else re.fullmatch(r"coop-pin: Pinocchio is not installed\. .*\n", done.stderr)
        )


def test_the_versions_it_names_are_those_that_the_package_requires():
    (required,) = (requirement for requirement in REQUIREMENTS if re.match(r"pin\b", requirement))
    versions = required.removeprefix("pin").partition(";")[0].strip()
    oldest, too_new = (".".join(map(str, version)) for version in (OLDEST, TOO_NEW))
    assert versions == f">={oldest},<{too_new}"
    message = str(MissingPinocchioError("Nothing is there"))
    assert f"'pin{versions}'" in message
    assert f"'pinocchio{versions}'" in message


def test_the_error_can_be_caught_as_an_import_error_and_sent_between_processes():
    error = MissingPinocchioError("Nothing is there")
    assert isinstance(error, ImportError)
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.reason) == (str(error), "Nothing is there")
