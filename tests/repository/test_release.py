"""Releases: changelog, recipe for conda, parts and licences, Binder, a notebook without a clone."""

import functools
import http.server
import importlib.metadata
import json
import os
import re
import subprocess
import sys
import threading
import tomllib
import venv
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

import coop_pin as cp

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CONDA = {"pin": ["pinocchio"], "meshcat": ["meshcat-python"], "matplotlib": ["matplotlib-base"]}
CONDA |= {"h5netcdf": ["h5netcdf", "h5py"]}
"""Names in conda-forge, where they are not those of PyPI."""


def test_the_version_is_one_and_the_changelog_dates_it():
    assert PROJECT["version"] == cp.__version__
    citation = (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    changelog = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    (date,) = re.findall(r"^date-released: (.*)$", citation, re.MULTILINE)
    assert f"version: {cp.__version__}\n" in citation
    assert re.findall(r"^## \[(.*)\] - (.*)$", changelog, re.MULTILINE)[0] == (cp.__version__, date)


def test_the_recipe_for_conda_has_the_requirements_of_the_project():
    recipe = yaml.safe_load((REPOSITORY / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
    names = [Requirement(line).name for line in PROJECT["dependencies"]]
    expected = {"python", *(conda for name in names for conda in CONDA.get(name, [name]))}
    bounds = {entry.partition(" ")[0]: entry.partition(" ")[2] for entry in recipe["requirements"]["run"]}
    assert set(bounds) == expected
    assert bounds["python"] == PROJECT["requires-python"]
    for line in PROJECT["dependencies"]:
        requirement = Requirement(line)
        name = CONDA.get(requirement.name, [requirement.name])[0]
        assert {*bounds[name].split(",")} == {*str(requirement.specifier).split(",")}
    assert recipe["context"]["version"] == cp.__version__
    assert recipe["about"]["license"] == PROJECT["license"]
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {target}" for name, target in PROJECT["scripts"].items()
    ]


def test_the_parts_of_an_installation_have_versions_and_licences():
    command = [sys.executable, str(REPOSITORY / "tools" / "sbom.py")]
    tables = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2)]
    assert tables[0] == tables[1]
    words = [*command, "--cyclonedx", "--extra", "sweep"]
    document = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    assert (document["bomFormat"], document["specVersion"]) == ("CycloneDX", "1.6")
    assert document["metadata"]["component"]["version"] == cp.__version__
    parts = {part["name"]: part for part in document["components"]}
    assert {"pin", "numpy", "meshcat", "pydantic", "uplot", "distributed"} <= {*parts}
    assert "distributed" not in tables[0]
    assert parts["numpy"]["version"] == importlib.metadata.version("numpy")
    assert [name for name, part in parts.items() if not part["licenses"][0]["license"]] == []
    assert str(REPOSITORY) not in tables[0] + json.dumps(document)


@pytest.mark.parametrize("wheel", ["", "https://example.org/coop_pin-0.2.0-py3-none-any.whl"])
def test_binder_installs_the_clone_or_the_wheel_of_a_variable(wheel, tmp_path):
    """A python that prints its arguments stands for Binder's."""
    fake = tmp_path / "python"
    fake.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    fake.chmod(0o755)
    given = (
        os.environ
        | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
        | ({"COOP_PIN_WHEEL": wheel} if wheel else {})
    )
    script = REPOSITORY / "binder" / "postBuild"
    done = subprocess.run([script], cwd=REPOSITORY, env=given, capture_output=True, text=True, check=True)
    requirement = Requirement(done.stdout.splitlines()[-1])
    assert (requirement.name, requirement.extras) == ("coop-pin", {"notebook"})
    assert requirement.url == (wheel or f"file://{REPOSITORY}")


@pytest.mark.slow
def test_the_first_cells_of_the_notebook_install_from_the_address_of_a_wheel(tmp_path):
    """In an empty environment, without the clone; the wheel comes by HTTP, requirements from the index."""
    import nbformat

    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "wheel")]
    subprocess.run(command, cwd=REPOSITORY, check=True, capture_output=True)
    (wheel,) = (tmp_path / "wheel").iterdir()
    venv.create(tmp_path / "environment", with_pip=True)
    python = tmp_path / "environment" / "bin" / "python"
    given = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run = functools.partial(
        subprocess.run, cwd=tmp_path, env=given, check=True, stdout=subprocess.PIPE, text=True
    )
    run([python, "-m", "pip", "install", "-q", "ipykernel", "nbclient"])
    files = functools.partial(http.server.SimpleHTTPRequestHandler, directory=wheel.parent)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), files) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/{wheel.name}"
        notebook = nbformat.read(REPOSITORY / "notebooks" / "01_your_own_arms.ipynb", as_version=4)
        first, *others = (cell for cell in notebook.cells if cell.cell_type == "code")
        first.source = first.source.replace('WHEEL = ""', f'WHEEL = "{address}"')
        show = nbformat.v4.new_code_cell(
            "print(cp.__file__, cp.run('adept-paper', {'duration': 0.1, 'events': []}))"
        )
        notebook.cells = [first, others[0], show]
        nbformat.write(notebook, tmp_path / "01.ipynb")
        execute = "import nbclient, nbformat; n = nbformat.read('01.ipynb', 4); nbclient.execute(n); print(n)"
        said = run([python, "-c", execute]).stdout
        server.shutdown()
    assert str(tmp_path / "environment") in said
    assert str(REPOSITORY) not in said
