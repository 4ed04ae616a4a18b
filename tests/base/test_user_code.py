"""Code that a scenario names: what may be named, and that nothing else is imported."""

import os
import sys
import sysconfig
from pathlib import Path

import pytest

import coop_pin as cp
from coop_pin.base.errors import CodeRefusedError, NameNotFoundError
from coop_pin.base.schema.user_code import ALLOWED, code_named, load_class, load_function, require_allowed

LAW = """
import os
import posixpath
from pathlib import Path
from pydoc import pipepager
Path("imported").touch()
class Law:
    def step(self): ...
class Late(Path): ...
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Name of a module in a folder of its own, which is the working folder and on the path."""
    name = f"mine_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(LAW)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(ALLOWED, raising=False)
    yield name
    sys.modules.pop(name, None)


def test_a_module_below_the_working_folder_is_loaded(mine):
    assert load_class(f"{mine}:Law").__name__ == "Law"
    assert load_function(f"{mine}:Law.step", {}).__qualname__ == "Law.step"


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(
    "name", ["pydoc:pipepager", "subprocess:call", "os:system", "tyro:cli", "builtins:exec", "posix:system"]
)
def test_the_standard_library_and_installed_packages_are_refused_by_name(name):
    with pytest.raises(CodeRefusedError) as caught:
        load_function(name, {})
    assert caught.value.name == name
    assert isinstance(caught.value, PermissionError)


@pytest.mark.parametrize("path", ["os.system", "posixpath.os.system", "pipepager", "__builtins__.exec"])
def test_what_a_users_module_imports_of_others_is_refused(mine, path):
    with pytest.raises((CodeRefusedError, NameNotFoundError)):
        load_function(f"{mine}:{path}", {})
    with pytest.raises(CodeRefusedError):
        load_function(f"{mine}:os.system", {})


def test_nothing_is_imported_of_a_module_elsewhere_before_it_is_listed(mine, tmp_path_factory, monkeypatch):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    with pytest.raises(CodeRefusedError, match=mine):
        load_class(f"{mine}:Law")
    assert mine not in sys.modules
    assert not Path("imported").exists()
    monkeypatch.setenv(ALLOWED, f"other, {mine}")
    assert load_class(f"{mine}:Law").__name__ == "Law"


def test_a_module_that_the_user_has_imported_may_be_named_from_any_folder(
    mine, tmp_path_factory, monkeypatch
):
    __import__(mine)
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert load_class(f"{mine}:Law").__name__ == "Law"


def test_installed_packages_below_the_working_folder_are_refused(monkeypatch):
    monkeypatch.chdir(Path(sysconfig.get_path("purelib")).parent)
    with pytest.raises(CodeRefusedError):
        require_allowed(["tyro:cli"])


@pytest.mark.usefixtures("mine")
def test_a_link_below_the_working_folder_to_a_file_elsewhere_is_refused(tmp_path):
    (tmp_path / "linked_away.py").symlink_to(Path(sysconfig.get_path("stdlib")) / "this.py")
    with pytest.raises(CodeRefusedError):
        require_allowed(["linked_away:f"])


@pytest.mark.usefixtures("mine")
def test_an_object_that_a_script_passes_may_be_used_wherever_it_is_defined():
    motion = cp.motions.FunctionMotion(target=os.path.join)
    assert load_function(motion.target, {}) is os.path.join
    with pytest.raises(CodeRefusedError):
        load_function(f"{motion.target.partition(':')[0]}:dirname", {})


@pytest.mark.usefixtures("mine")
def test_a_module_that_is_not_there_is_told_as_such():
    with pytest.raises(NameNotFoundError):
        load_class("no_such_module:Law")


def test_a_class_of_another_process_is_told_with_what_to_do():
    with pytest.raises(NameNotFoundError, match="put it into a module"):
        load_class("__main__:NowhereDefined")


def test_all_code_that_a_scenario_and_a_plan_name_is_listed():
    motion = {"kind": "function", "target": "a:pose", "twist": "b:twist"}
    changes = {
        "motion": motion,
        "squeeze": {"kind": "function", "target": "c:press"},
        "controller": {"kind": "user", "target": "d:Law"},
        "events": [{"kind": "user", "time": 1.0, "target": "e:act"}],
    }
    names = {
        "controller.target": "d:Law",
        "motion.target": "a:pose",
        "motion.twist": "b:twist",
        "squeeze.target": "c:press",
        "events.0.target": "e:act",
    }
    for scenario in ("adept-paper", "two-pandas-box"):
        assert dict(code_named(cp.Scenario.load(scenario, changes))) == names
        assert not dict(code_named(cp.Scenario.load(scenario)))
    plan = cp.SweepPlan(
        base="adept-paper",
        cases={"plain": {}, "own": {"motion": motion}},
        axes={"squeeze": [{"kind": "constant"}, {"kind": "function", "target": "f:press"}]},
        metrics=("g:metric",),
    )
    assert {name for _, name in plan.code_named()} == {"a:pose", "b:twist", "f:press", "g:metric"}
