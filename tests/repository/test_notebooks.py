"""Every notebook runs from top to bottom, is stored with light outputs alike, and equals its .py twin.

nbformat and nbclient take seconds to import: the tests that use them do.
"""

import ast
import asyncio
import importlib
import sys
from pathlib import Path

import pytest

import coop_pin as cp

REPOSITORY = Path(__file__).parents[2]
NOTEBOOKS = sorted((REPOSITORY / "notebooks").glob("*.ipynb"))
MOST_CELLS, MOST_NOTEBOOKS = 25, 10
SHORT = {
    "01_your_own_arms": "seconds = 0.5",
    "02_paper": "seconds = 5.0",
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


def outputs_of(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def tool():
    """The command that stores the notebooks."""
    sys.path.insert(0, str(REPOSITORY / "tools"))
    import notebooks

    return notebooks


def assert_it_runs_and_shows_what_is_stored(notebook, folder, kernel=None):
    """Of each cell the kinds of outputs are those that it is stored with: views, figures, tables, texts."""
    kinds = tool().kinds
    stored = [kinds(cell) for cell in notebook.cells if cell.cell_type == "code"]
    run(notebook, folder, kernel)
    assert [output for output in outputs_of(notebook) if output.get("name") == "stderr"] == []
    assert [kinds(cell) for cell in notebook.cells if cell.cell_type == "code"] == stored


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


@pytest.mark.gate
@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem) for path in NOTEBOOKS])
def test_a_notebook_runs_in_its_short_mode_and_shows_what_is_stored(path, tmp_path, kernel):
    assert_it_runs_and_shows_what_is_stored(in_short(path), tmp_path, kernel)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SHORT))
def test_a_notebook_runs_at_its_full_length(name, tmp_path):
    import nbformat

    assert_it_runs_and_shows_what_is_stored(
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


def test_notebooks_are_few_short_the_same_as_their_twins_and_use_the_public_api():
    import jupytext
    import nbformat

    assert 0 < len(NOTEBOOKS) <= MOST_NOTEBOOKS
    for path in NOTEBOOKS:
        notebook, twin = nbformat.read(path, as_version=4), jupytext.read(path.with_suffix(".py"))
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        assert len(notebook.cells) <= MOST_CELLS, path
        assert [(cell.cell_type, cell.source) for cell in notebook.cells] == [
            (cell.cell_type, cell.source) for cell in twin.cells
        ], path
        assert notebook.cells[0].source.startswith("# "), path
        assert notebook.cells[-1].source.startswith("## Try\n"), path
        assert [*private_or_missing_names("\n".join(cell.source for cell in code))] == [], path


def test_notebooks_are_stored_with_what_they_show_and_are_light():
    """Run afresh by ``python tools/notebooks.py``; a still picture stands for each 3-D view."""
    import nbformat

    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        assert [cell.execution_count for cell in code] == [*range(1, len(code) + 1)], path
        kinds = [kind for cell in code for kind in tool().kinds(cell)]
        assert {"view", "figure"} <= {*kinds}, path
        assert "error" not in kinds, path
        assert path.stat().st_size <= tool().MOST_BYTES, path
        stills = [output for output in outputs_of(notebook) if tool().kind(output) == ""]
        assert len(stills) == kinds.count("view"), path
        assert "<iframe" not in path.read_text(encoding="utf-8"), path
        for cell in code:
            tool().refuse(cell, (str(REPOSITORY), str(Path.home()), "/tmp/"))


def test_an_output_that_tells_of_the_machine_is_refused(tmp_path):
    from nbformat import v4

    for text in (f"{tmp_path}/out", "<Arm object at 0x7f3c2a10>", "done in 3.2 s of wall time"):
        cell = v4.new_code_cell("1", outputs=[v4.new_output("stream", text=text)])
        with pytest.raises(ValueError, match="an output has"):
            tool().refuse(cell, (str(tmp_path),))
    tool().refuse(v4.new_code_cell("1", outputs=[v4.new_output("stream", text="3.2 s")]), (str(tmp_path),))
