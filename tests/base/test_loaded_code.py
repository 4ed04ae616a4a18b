"""Edits of a user's modules in a live process: what was loaded is known, whichever way it was loaded."""

import importlib
import subprocess
import sys

import pytest

from coop_pin.base.loaded_code import edited_files, loaded_digests
from coop_pin.base.source_code import code_digests, source_files


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder on the Python path and the current one, whose modules are forgotten afterwards."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def write(place, **files):
    for name, text in files.items():
        (place / name.replace("__", ".")).write_text(text)


def edited(name):
    return [path.name for path in edited_files(name)]


def test_an_edit_is_seen_until_a_reload_or_until_it_is_undone(place):
    write(place, own_m__py="K = 1\n")
    before = code_digests("own_m:K")
    assert loaded_digests("own_m:K") == before  # not loaded yet
    module = importlib.import_module("own_m")
    write(place, own_m__py="K = 2\n")  # of equal length, within the same second
    assert edited("own_m:K") == ["own_m.py"]
    assert loaded_digests("own_m:K") == before != code_digests("own_m:K")
    write(place, own_m__py="K = 1\n")
    assert edited("own_m:K") == []
    write(place, own_m__py="K = 2\n")
    assert importlib.reload(module).K == 2
    assert edited("own_m:K") == []
    write(place, own_m__py="K = (\n")
    assert edited("own_m:K") == ["own_m.py"]


def test_a_module_that_is_forgotten_will_be_loaded_anew(place):
    write(place, own_m__py="K = 1\n")
    importlib.import_module("own_m")
    write(place, own_m__py="K = 2\n")
    del sys.modules["own_m"]
    assert edited("own_m:K") == []
    assert importlib.import_module("own_m").K == 2


@pytest.mark.parametrize(
    ("law", "is_held"),
    [
        ("from own_h import K\n", True),
        ("from own_h import *\n", True),
        ("import own_h\nK = own_h.K\n", True),
        ("import own_h\nclass A(own_h.B): ...\n", True),
        ("import own_h\ndef f(k=own_h.K): ...\n", True),
        ("import own_h\ndef f(): return own_h.K\n", False),
        ("def f():\n    from own_h import K\n", False),
        ("def f():\n    import own_h\n    return own_h.K\n", False),
    ],
)
def test_a_reload_of_a_helper_alone_is_enough_where_nothing_of_it_is_held(place, law, is_held):
    write(place, own_m__py=law, own_h__py="K = 1\nclass B: ...\n")
    module, helper = importlib.import_module("own_m"), importlib.import_module("own_h")
    write(place, own_h__py="K = 2\nclass B: ...\n")
    assert edited("own_m:f") == ["own_h.py"]
    importlib.reload(helper)
    assert edited("own_m:f") == (["own_m.py"] if is_held else [])
    importlib.reload(module)
    assert edited("own_m:f") == []


def test_reloads_in_the_wrong_order_are_seen(place):
    write(place, own_m__py="from own_h import K\n", own_h__py="from own_g import K\n", own_g__py="K = 1\n")
    module = importlib.import_module("own_m")
    write(place, own_g__py="K = 22\n")
    importlib.reload(importlib.import_module("own_g"))
    importlib.reload(module)
    assert module.K == 1
    assert edited("own_m:K") == ["own_h.py"]
    importlib.reload(importlib.import_module("own_h"))
    assert edited("own_m:K") == ["own_m.py"]
    assert importlib.reload(module).K == 22
    assert edited("own_m:K") == []


def test_modules_of_packages_that_are_named_relative_are_followed(place):
    (place / "own_lab").mkdir()
    for name, text in (("__init__", ""), ("law", "from .gains import K\n"), ("gains", "K = 1\n")):
        (place / "own_lab" / f"{name}.py").write_text(text)
    module = importlib.import_module("own_lab.law")
    (place / "own_lab" / "gains.py").write_text("K = 22\n")
    assert edited("own_lab.law:K") == ["gains.py"]
    importlib.reload(importlib.import_module("own_lab.gains"))
    assert edited("own_lab.law:K") == ["law.py"]
    importlib.reload(module)
    assert edited("own_lab.law:K") == []


def test_data_that_code_names_and_does_not_write_belong_to_it(place):
    write(place, own_m__py="from pathlib import Path\nG = Path('own.csv').read_text()\n", own__csv="1")
    write(place, own_l__py="def f():\n    open('own.log', 'a').write('x')\n", own__log="")
    write(place, own_r__py="def f():\n    t = open('own.log').read()\n    open('own.log', 'w').write(t)\n")
    assert [path.name for path in source_files("own_r:f")] == ["own.log", "own_r.py"]
    (place / "tables").mkdir()
    (place / "tables" / "own.npz").write_text("")
    write(place, own_t__py="from pathlib import Path\nP = Path(__file__).parent / 'tables' / 'own.npz'\n")
    assert [path.name for path in source_files("own_t:P")] == ["own_t.py", "own.npz"]
    assert [path.name for path in source_files("own_m:G")] == ["own.csv", "own_m.py"]
    assert [path.name for path in source_files("own_l:f")] == ["own_l.py"]
    module = importlib.import_module("own_m")
    write(place, own__csv="2")
    assert edited("own_m:G") == ["own.csv"]
    importlib.reload(module)
    assert edited("own_m:G") == []


NOTEBOOK = """
import coop_pin, own_m
from own_m import K
from pathlib import Path
from coop_pin.base.loaded_code import edited_files
print([path.name for path in edited_files("__main__:Law")])
Path("own_m.py").write_text("K = 22")
print([path.name for path in edited_files("__main__:Law")])
"""


def test_of_code_in_a_notebook_all_that_is_loaded_counts(place):
    write(place, own_m__py="K = 1\n")
    done = subprocess.run(
        [sys.executable, "-c", NOTEBOOK], cwd=place, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.split("\n")[:2] == ["[]", "['own_m.py']"]
