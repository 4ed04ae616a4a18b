"""Distributions: contents of the sdist and of the wheel built from it, installation, constraints."""

import configparser
import importlib.metadata
import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from email import message_from_string
from pathlib import Path

import pytest
from built_once import built_once

import coop_pin
from coop_pin.description.catalogue import scenario_names

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NEVER_INSIDE = {
    "out",
    ".venv",
    ".git",
    "__pycache__",
    ".hypothesis",
    ".pytest_cache",
    ".mypy_cache",
    ".ruff_cache",
}


def run(*command, cwd, **environment):
    """What a command prints; PYTHONPATH is not handed on, so that nothing is found but what is installed."""
    given = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | environment
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=given, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def only_entry(folder):
    (entry,) = folder.iterdir()
    return entry


def build_all(folder):
    """Build the sdist, from it the wheel, and an environment with it and this one's dependencies only."""
    for name in ("sdist", "unpacked", "wheel"):
        (folder / name).mkdir()
    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder / "sdist", cwd=REPOSITORY)
    with tarfile.open(only_entry(folder / "sdist")) as packed:
        packed.extractall(folder / "unpacked", filter="data")
    unpacked = only_entry(folder / "unpacked")
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder / "wheel", cwd=unpacked)
    venv.create(folder / "environment", with_pip=False, symlinks=True)
    python = folder / "environment" / "bin" / "python"
    site = Path(
        run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip()
    )
    # Folders named in a .pth file are searched, but their own .pth files, an editable coop_pin among them,
    # are not read.
    (site / "dependencies.pth").write_text(
        "\n".join(entry for entry in sys.path if entry.endswith(("site-packages", "dist-packages")))
    )
    command = [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", "--no-index"]
    run(*command, only_entry(folder / "wheel"), cwd=folder)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    pytest.importorskip("hatchling", reason="hatchling is not installed (extra 'test')")
    return built_once(tmp_path_factory, "distributions", build_all)


@pytest.fixture
def sdist(built):
    """The unpacked sdist."""
    return only_entry(built / "unpacked")


@pytest.fixture
def wheel(built):
    """The wheel that the sdist builds."""
    return only_entry(built / "wheel")


@pytest.fixture
def installed(built):
    """The Python of the environment in which the wheel is installed."""
    return built / "environment" / "bin" / "python"


def files_of(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def wheel_files(wheel):
    with zipfile.ZipFile(wheel) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


# ---------------------------------------------------------------- contents


@pytest.mark.gate
def test_the_wheel_holds_the_package_its_data_and_the_robots_and_nothing_else(wheel):
    names = set(wheel_files(wheel))
    info = f"coop_pin-{coop_pin.__version__}.dist-info"
    package = {
        str(path.relative_to(REPOSITORY))
        for path in (REPOSITORY / "coop_pin").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    robots = {f"coop_pin/urdf/{path.name}" for path in (REPOSITORY / "urdf").iterdir()}
    about = {
        f"{info}/{name}" for name in ("METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE")
    }
    assert names == package | robots | about
    assert {
        "coop_pin/py.typed",
        "coop_pin/urdf/adept_3dof.urdf",
        "coop_pin/viz/web/player.js",
        "coop_pin/viz/web/uplot/uPlot.iife.min.js",
        "coop_pin/viz/web/report.html",
    } <= names
    assert {f"coop_pin/description/scenarios/{name}.toml" for name in scenario_names()} <= names


@pytest.mark.gate
def test_the_wheel_is_for_any_platform_and_says_what_pyproject_says(wheel):
    assert wheel.name == f"coop_pin-{coop_pin.__version__}-py3-none-any.whl"
    files = {
        name.partition(".dist-info/")[2]: data.decode()
        for name, data in wheel_files(wheel).items()
        if ".dist-info/" in name
    }
    told = message_from_string(files["METADATA"])
    assert (told["Name"], told["Version"], told["License-Expression"]) == (
        PROJECT["name"],
        PROJECT["version"],
        PROJECT["license"],
    )
    assert set(told["Requires-Python"].split(",")) == set(PROJECT["requires-python"].split(","))
    assert set(told.get_all("Provides-Extra")) == set(PROJECT["optional-dependencies"])
    scripts = configparser.ConfigParser()
    scripts.read_string(files["entry_points.txt"])
    assert dict(scripts["console_scripts"]) == PROJECT["scripts"]


@pytest.mark.gate
def test_the_sdist_holds_every_file_of_the_repository_and_nothing_that_was_made(sdist):
    names = set(files_of(sdist))
    assert sdist.name == f"coop_pin-{coop_pin.__version__}"
    if (REPOSITORY / ".git").exists():
        trusted = f"safe.directory={REPOSITORY}"  # on CI machines the clone is often somebody else's
        listed = run("git", "-c", trusted, "ls-files", "-z", cwd=REPOSITORY).split("\0")
        assert {name for name in listed if name and (REPOSITORY / name).exists()} - names == set()
    files = [
        "README.md",
        "LICENSE",
        "CHANGELOG.md",
        "CITATION.cff",
        "constraints.txt",
        "pyproject.toml",
        "PKG-INFO",
    ]
    folders = ["coop_pin", "urdf", "tests", "tools", "benchmarks", "examples", "notebooks", "docs", "studies"]
    assert {*files, *folders} <= {*names, *(name.partition("/")[0] for name in names)}
    assert not [
        name for name in names if NEVER_INSIDE & set(Path(name).parts) or name.startswith("docs/notebooks/")
    ]


@pytest.mark.gate
def test_no_file_names_a_folder_of_the_machine_it_was_built_on(sdist, wheel):
    places = [
        f"{place}/".encode() for place in {REPOSITORY, Path.home(), Path(sys.prefix)} if str(place) != "/"
    ]
    for name, data in {**files_of(sdist), **wheel_files(wheel)}.items():
        assert not [place for place in places if re.search(rb"(?<![\w.])" + re.escape(place), data)], name


@pytest.mark.gate
def test_the_tests_can_be_collected_from_the_sdist(sdist, tmp_path):
    """Files that tests read as they are loaded are there, and the package beside them is what they test."""
    options = [
        "-m",
        "pytest",
        "--collect-only",
        "-q",
        "-p",
        "no:cacheprovider",
        "tests/repository/test_docs.py",
        "tests/repository/test_examples.py",
    ]
    shown = run(sys.executable, *options, cwd=sdist, PYTHONPATH=str(sdist), PYTHONDONTWRITEBYTECODE="1")
    assert "error" not in shown.splitlines()[-1]
    code = "import coop_pin; print(coop_pin.__file__)"
    place = run(sys.executable, "-c", code, cwd=tmp_path, PYTHONPATH=str(sdist))
    assert Path(place.strip()).is_relative_to(sdist)


# ---------------------------------------------------------------- installed


PLACES = """
import importlib.metadata, importlib.util, json, sys
import coop_pin
from coop_pin.description.urdf.find import bundled_urdf_folder
installed = importlib.metadata.distribution("coop-pin").locate_file("")
places = [coop_pin.__file__, bundled_urdf_folder(), installed]
print(json.dumps([[*map(str, places)], sys.path, importlib.util.find_spec("test_wheel") is None]))
"""


@pytest.mark.gate
def test_the_installed_package_works_without_the_repository(installed, tmp_path):
    """A newcomer's first commands in an empty folder; package, pages and robots come from the wheel."""

    def command(words):
        return run(installed.parent / "coop-pin", *words.split(), cwd=tmp_path)

    places, path, hides_tests = json.loads(run(installed, "-c", PLACES, cwd=tmp_path))
    assert [place for place in places if not Path(place).is_relative_to(installed.parents[1])] == []
    assert str(REPOSITORY) not in path
    assert hides_tests
    assert command("--version") == f"coop-pin {coop_pin.__version__}\n"
    listed = command("list")
    assert [name for name in scenario_names() if name not in listed] == []
    out = command("run adept-paper --duration 3 --events [] --report --out run")
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics
    assert [name for name in metrics if name not in out and name != "reasons"] == []
    written = {path.name: path.stat().st_size for path in (tmp_path / "run").iterdir()}
    assert {"replay.html", "report.html", "result.nc", "scenario.toml", "figure2.png", "errors.png"} <= {
        *written
    }
    assert min(written["replay.html"], written["report.html"]) > 500_000  # the viewer is inside
    assert "left" in command("check adept-paper --poses 41")
    assert "replay.html" in command("view run --no-open")
    assert "panda" in run(installed, "-m", "coop_pin", "show", "two-pandas-box", cwd=tmp_path)


# ---------------------------------------------------------------- constraints


def required_names(requirement_lines, extras, seen):
    """The distributions that requirements bring along here, by normalised name."""
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    for line in requirement_lines:
        requirement = Requirement(line)
        if requirement.marker and not any(
            requirement.marker.evaluate({"extra": extra}) for extra in extras or {""}
        ):
            continue
        name, wanted = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if (name, wanted) in seen:
            continue
        seen.add((name, wanted))
        try:
            lines = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue  # an extra that is not installed here
        required_names(lines, wanted, seen)
    return {name for name, _ in seen}


def test_the_constraints_name_everything_that_the_gate_installs():
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    lines = [
        line
        for line in (REPOSITORY / "constraints.txt").read_text().splitlines()
        if line and not line.startswith("#")
    ]
    pinned = [Requirement(line) for line in lines]
    assert all(str(pin.specifier).startswith("==") for pin in pinned)
    extras = PROJECT["optional-dependencies"]
    wanted = [*PROJECT["dependencies"], *extras["test"], *extras["docs"], *extras["bench"]]
    assert required_names(wanted, set(), set()) - {canonicalize_name(pin.name) for pin in pinned} == set()
