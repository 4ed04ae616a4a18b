"""Every notebook runs from top to bottom, has no outputs in the repository, and is the same as its .py twin."""

import ast
import importlib
from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbformat import v4

import coop_pin as cp

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
MOST_CELLS = 25
SHORT = {
    "01_paper": "seconds = 5.0",
    "03_your_own_arm": "seconds = 0.5",
    "04_sweeps": "gains, poles, force_gains = 2, 2, 4",
}
"""The short mode: what the cell of a notebook that is tagged "parameters" says instead; the others are short as they are."""


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def path(request):
    return request.param


def test_there_are_notebooks():
    assert NOTEBOOKS


def run(notebook, folder):
    """Execute a notebook from top to bottom in a folder of its own; the first cell that fails raises."""
    NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": folder}}
    ).execute()


def assert_it_runs_and_shows_its_replay(notebook, folder):
    run(notebook, folder)
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    shown = [output.data for output in outputs if "data" in output]
    assert any("<iframe" in data.get("text/html", "") for data in shown)
    assert any("image/png" in data for data in shown)


def in_short(path):
    """The notebook with the parameters of its short mode, which are those that it has."""
    notebook = nbformat.read(path, as_version=4)
    tagged = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", [])]
    assert len(tagged) == (path.stem in SHORT)
    for cell in tagged:
        assert cell.source.split(" = ")[0] == SHORT[path.stem].split(" = ")[0]
        cell.source = SHORT[path.stem]
    return notebook


def test_a_notebook_runs_in_its_short_mode_and_shows_its_replay(path, tmp_path):
    assert_it_runs_and_shows_its_replay(in_short(path), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SHORT))
def test_a_notebook_runs_at_its_full_length(name, tmp_path):
    assert_it_runs_and_shows_its_replay(
        nbformat.read(NOTEBOOKS[0].with_name(f"{name}.ipynb"), as_version=4), tmp_path
    )


@pytest.mark.parametrize("last", ["1 / 0", "assert 1 == 2", "import coop_pin as cp\ncp.run('adept-papr')"])
def test_a_notebook_that_fails_is_caught(last, tmp_path):
    """Or the tests above would prove nothing."""
    notebook = v4.new_notebook(
        cells=[
            v4.new_code_cell("print('so far')"),
            v4.new_code_cell(last),
            v4.new_code_cell("print('not reached')"),
        ]
    )
    with pytest.raises(CellExecutionError):
        run(notebook, tmp_path)
    assert notebook.cells[0].outputs[0].text == "so far\n"
    assert notebook.cells[2].execution_count is None


def test_a_notebook_opens_with_what_is_seen_and_ends_with_what_to_try(path):
    cells = nbformat.read(path, as_version=4).cells
    assert cells[0].source.startswith("# ")
    assert " you " in cells[0].source.lower().replace("\n", " ")
    assert cells[-1].source.startswith("## Try\n")


def test_a_notebook_uses_the_public_api_only(path):
    """Names without underscores, out of coop_pin and its rooms."""
    code = "\n".join(
        cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"
    )
    tree = ast.parse("\n".join(line for line in code.splitlines() if not line.startswith("%")))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("coop_pin"):
            assert node.module.count(".") <= 1
            room = importlib.import_module(node.module)
            assert {alias.name for alias in node.names} <= {*room.__all__, "figures"}
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_")
            assert not (isinstance(node.value, ast.Name) and node.value.id == "cp") or node.attr in cp.__all__


def test_a_notebook_is_short_and_has_no_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    assert len(notebook.cells) <= MOST_CELLS
    assert all(
        not cell.outputs and cell.execution_count is None
        for cell in notebook.cells
        if cell.cell_type == "code"
    )


def test_a_notebook_is_the_same_as_its_twin(path):
    notebook, twin = nbformat.read(path, as_version=4), jupytext.read(path.with_suffix(".py"))
    assert [(cell.cell_type, cell.source) for cell in notebook.cells] == [
        (cell.cell_type, cell.source) for cell in twin.cells
    ]
