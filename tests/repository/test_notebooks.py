"""Every notebook runs from top to bottom, has no outputs in the repository, and equals its .py twin.

nbformat and nbclient take seconds to import: the tests that use them do.
"""

import ast
import asyncio
import importlib
from pathlib import Path

import pytest

import coop_pin as cp

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
MOST_CELLS = 25
SHORT = {
    "01_paper": "seconds = 5.0",
    "03_your_own_arm": "seconds = 0.5",
    "04_sweeps": "gains, poles, force_gains, workers = 2, 2, 4, 0",
    "06_internal_force": "seconds = 4.5",
    "07_compare": "seconds = 1.0",
    "08_grasps": "seconds = 0.8",
}
"""Short mode: the source of the cell tagged "parameters"; notebooks not listed here are short already."""


@pytest.fixture(scope="module")
def kernel():
    """A kernel that runs one notebook after the other: to start it takes as long as to run a short one."""
    from jupyter_client import AsyncKernelManager

    manager = AsyncKernelManager(kernel_name="python3")
    yield manager
    asyncio.run(manager.shutdown_kernel(now=True))


AFRESH = """
%reset -f
import os
from matplotlib import pyplot
pyplot.close("all")
os.chdir({folder!r})
"""


def run(notebook, folder, kernel=None):
    """Execute a notebook from top to bottom in a folder of its own; the first cell that fails raises.

    A kernel that is given forgets all names first; without one, a new kernel is started and ended.
    """
    from nbclient import NotebookClient
    from nbformat import v4

    if kernel is None:
        NotebookClient(notebook, timeout=300, resources={"metadata": {"path": folder}}).execute()
        return
    afresh = v4.new_notebook(cells=[v4.new_code_cell(AFRESH.format(folder=str(folder)))])
    for each in (afresh, notebook):
        client = NotebookClient(each, km=kernel, timeout=300)
        try:
            client.execute()
        finally:
            client.kc.stop_channels()


def assert_it_runs_and_shows_its_replay(notebook, folder, kernel=None):
    run(notebook, folder, kernel)
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    shown = [output.data for output in outputs if "data" in output]
    assert any("<iframe" in data.get("text/html", "") for data in shown)
    assert any("image/png" in data for data in shown)


def in_short(path):
    """The notebook with the parameters of its short mode, which are those that it has."""
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    tagged = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", [])]
    assert len(tagged) == (path.stem in SHORT)
    for cell in tagged:
        assert cell.source.split(" = ")[0] == SHORT[path.stem].split(" = ")[0]
        cell.source = SHORT[path.stem]
    return notebook


QUICK = "02_closing_the_chain"
"""The notebook that runs in the default tier, too."""


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.gate] * (path.stem != QUICK), id=path.stem) for path in NOTEBOOKS],
)
def test_a_notebook_runs_in_its_short_mode_and_shows_its_replay(path, tmp_path, kernel):
    assert_it_runs_and_shows_its_replay(in_short(path), tmp_path, kernel)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SHORT))
def test_a_notebook_runs_at_its_full_length(name, tmp_path):
    import nbformat

    assert_it_runs_and_shows_its_replay(
        nbformat.read(NOTEBOOKS[0].with_name(f"{name}.ipynb"), as_version=4), tmp_path
    )


def test_a_notebook_that_fails_is_caught(tmp_path, kernel):
    """Without this the tests above would prove nothing."""
    from nbclient.exceptions import CellExecutionError
    from nbformat import v4

    cells = [v4.new_code_cell(code) for code in ("print('so far')", "assert 1 == 2", "print('not reached')")]
    notebook = v4.new_notebook(cells=cells)
    with pytest.raises(CellExecutionError):
        run(notebook, tmp_path, kernel)
    assert notebook.cells[0].outputs[0].text == "so far\n"
    assert notebook.cells[2].execution_count is None


def private_or_missing_names(code):
    """Names with underscores, and names that coop_pin and its packages do not export."""
    tree = ast.parse("\n".join(line for line in code.splitlines() if not line.startswith("%")))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("coop_pin"):
            module = importlib.import_module(node.module)
            exported = {*getattr(module, "__all__", ()), *(dir(cp) if module is cp else ())}
            yield from ({alias.name for alias in node.names} - exported)
        if isinstance(node, ast.Attribute) and node.attr.startswith("_"):
            yield node.attr
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "cp" and node.attr not in dir(cp):
            yield node.attr


def test_notebooks_are_short_without_outputs_the_same_as_their_twins_and_use_the_public_api():
    import jupytext
    import nbformat

    assert NOTEBOOKS
    for path in NOTEBOOKS:
        notebook, twin = nbformat.read(path, as_version=4), jupytext.read(path.with_suffix(".py"))
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        assert len(notebook.cells) <= MOST_CELLS, path
        assert [cell for cell in code if cell.outputs or cell.execution_count] == [], path
        assert [(cell.cell_type, cell.source) for cell in notebook.cells] == [
            (cell.cell_type, cell.source) for cell in twin.cells
        ], path
        assert notebook.cells[0].source.startswith("# "), path
        assert notebook.cells[-1].source.startswith("## Try\n"), path
        assert [*private_or_missing_names("\n".join(cell.source for cell in code))] == [], path
