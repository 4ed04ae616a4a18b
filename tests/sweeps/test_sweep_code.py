"""User code in the key of a run: an edit makes another key, and no process computes with stale code."""

import os
import subprocess
import sys

import pytest
from faulty import PUSH

import coop_pin as cp
from coop_pin.base.errors import CodeChangedError, UserCodeError
from coop_pin.base.source_code import code_digests, source_files
from coop_pin.sweeps import run_key as keys
from coop_pin.sweeps.engine import sweep
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import run_key
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.job import Job, run_job

SHORT = {"duration": 0.1, "events": []}
LAW = "from {gains} import TORQUE\n" + PUSH


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder on the Python path, whose modules are forgotten afterwards."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def stored(place):
    return len({record.key for record in SweepStore(place / "kept").records()})


def write(place, files):
    for name, text in files.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text)


def user(target):
    return {"controller": {"kind": "user", "target": target}}


def names(place, module):
    return [str(path.relative_to(place)) for path in source_files(module)]


# ---------------------------------------------------------------- which files


def test_a_module_brings_what_it_imports_from_beside_it_at_any_depth(place):
    write(
        place,
        {
            "own_a.py": "import own_b, numpy\n",
            "own_b.py": "def f():\n    from own_c import x\n",
            "own_c.py": "x = 1\n",
        },
    )
    write(place, {"own_d.py": "import own_a\n", "unused.py": ""})
    assert names(place, "own_a:f") == ["own_a.py", "own_b.py", "own_c.py"]
    assert names(place, "own_c") == ["own_c.py"]
    assert names(place, "nowhere:f") == names(place, ".:f") == []


def test_packages_relative_imports_and_cycles_are_followed(place):
    write(
        place,
        {
            "lab/__init__.py": "",
            "lab/laws/__init__.py": "from . import base\n",
            "lab/laws/base.py": "from ..gains import K\n",
        },
    )
    write(
        place,
        {
            "lab/gains.py": "from lab.laws import base\nK = 1\n",
            "lab/laws/late.py": "from .base import *\nfrom ..tools import t\n",
        },
    )
    write(place, {"lab/tools/__init__.py": "t = 1\n", "lab/unused.py": ""})
    whole = ["lab/__init__.py", "lab/gains.py", "lab/laws/__init__.py", "lab/laws/base.py"]
    assert names(place, "lab.laws.base:K") == whole
    assert names(place, "lab.laws.late:t") == sorted([*whole, "lab/laws/late.py", "lab/tools/__init__.py"])


def test_what_is_installed_and_coop_pin_itself_are_left_out(place):
    assert [path.name for path in source_files("statistics:mean")] == ["statistics.py"]
    write(place, {"own_e.py": "import coop_pin\nimport scipy\n"})
    assert names(place, "own_e") == ["own_e.py"]
    assert source_files("sys:exit") == ()


def test_packages_are_not_imported_to_find_their_files(place):
    write(place, {"broken/__init__.py": "1 / 0\n", "broken/law.py": ""})
    assert names(place, "broken.law:f") == ["broken/__init__.py", "broken/law.py"]
    assert names(place, "broken.none:f") == names(place, "broken.law.deeper:f") == []
    assert "broken" not in sys.modules


def test_a_module_run_with_python_m_brings_its_package(place):
    says = "from coop_pin.base.source_code import source_files\n"
    says += "print(*(path.name for path in source_files('__main__:f')))\n"
    write(
        place,
        {"lab/__init__.py": "", "lab/study.py": f"from lab.gains import K\nfrom . import tools\n{says}"},
    )
    write(place, {"lab/gains.py": "K = 1\n", "lab/tools.py": ""})
    done = subprocess.run(
        [sys.executable, "-m", "lab.study"],
        cwd=place,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.split() == ["__init__.py", "gains.py", "study.py", "tools.py"]


def test_a_module_that_python_cannot_read_is_a_file_whose_edit_is_seen(place):
    write(place, {"own_f.py": "def (:\n", "own_g.py": "import own_f\n"})
    assert names(place, "own_f") == ["own_f.py"]
    assert names(place, "own_g") == ["own_f.py", "own_g.py"]
    write(place, {"own_f.py": ""})
    assert names(place, "own_g") == ["own_f.py", "own_g.py"]


def test_folders_without_init_are_packages_and_modules_hide_them(place):
    write(place, {"own_lab/laws.py": "from own_lab.gains import K\nfrom . import tools\n"})
    write(place, {"own_lab/gains.py": "K = 1\n", "own_lab/tools.py": "import own_h\n"})
    write(place, {"own_h.py": "", "own_h/notes.txt": ""})
    assert names(place, "own_lab.laws:K") == [
        "own_h.py", "own_lab/gains.py", "own_lab/laws.py", "own_lab/tools.py",
    ]  # fmt: skip


# ---------------------------------------------------------------- keys


@pytest.mark.parametrize("edited", ["own_law.py", "own_gains.py"])
def test_an_edit_makes_another_key_and_undoing_it_the_same(place, edited):
    write(place, {"own_law.py": LAW.format(gains="own_gains"), "own_gains.py": "TORQUE = 0.0\n"})
    scenario = cp.Scenario.load("adept-paper", SHORT | user("own_law:Push"))
    before, text = run_key(scenario), (place / edited).read_text()
    (place / edited).write_text(text + "# better\n")
    assert run_key(scenario) != before
    (place / edited).write_text(text)
    assert run_key(scenario) == before


@pytest.mark.parametrize("field", ["target", "twist", "acceleration"])
def test_every_function_of_a_motion_and_every_metric_is_in_the_key(place, field):
    write(place, {"own_pose.py": "def f(t): ...\n", "own_other.py": "def f(t): ...\n"})
    motion = {"kind": "function", "target": "own_pose:f", field: "own_other:f"}
    scenario = cp.Scenario.load("adept-paper", SHORT | {"motion": motion})
    plain = cp.Scenario.load("adept-paper")
    before = run_key(scenario), run_key(plain, ("own_other:f",)), run_key(plain)
    write(place, {"own_other.py": "def f(t): return 1\n"})
    after = run_key(scenario), run_key(plain, ("own_other:f",)), run_key(plain)
    assert [a == b for a, b in zip(before, after, strict=True)] == [False, False, True]


# ---------------------------------------------------------------- sweeps

SWEEP = """
import coop_pin as cp
short = {"duration": 0.1, "events": [], "controller": {"kind": "user", "target": "own_law:Push"}}
result = cp.sweep("adept-paper", out="kept", changes=short, execution=cp.Execution(WORKERS, quiet=True))
print(repr(result.values("torque_peak_Nm").item()))
"""


@pytest.mark.parametrize(
    "workers", [pytest.param(0, marks=pytest.mark.gate), pytest.param(1, marks=pytest.mark.slow)]
)
def test_whoever_edits_a_controller_and_resumes_gets_the_new_one_and_keeps_the_old(place, workers):
    write(place, {"own_law.py": LAW.format(gains="own_gains")})
    code = SWEEP.replace("WORKERS", str(workers))
    seen = []
    for torque in (1.0, 2.0, 1.0):
        write(place, {"own_gains.py": f"TORQUE = {torque}\n"})
        command = [sys.executable, "-c", code]
        seen.append(
            float(
                subprocess.run(
                    command, cwd=place, capture_output=True, text=True, check=True, timeout=120
                ).stdout
            )
        )
        assert stored(place) == len(set(seen))
    assert seen == [1.0, 2.0, 1.0]


def test_a_process_that_loaded_the_old_code_does_not_compute_what_is_kept_as_the_new_code_s(place):
    write(place, {"own_old.py": LAW.format(gains="own_older"), "own_older.py": "TORQUE = 1.0\n"})
    plan = SweepPlan(base="adept-paper", changes=SHORT | user("own_old:Push"))
    assert (
        sweep(plan, out=place / "kept", execution=cp.Execution(workers=0, quiet=True)).values(
            "torque_peak_Nm"
        )
        == 1.0
    )
    write(place, {"own_older.py": "TORQUE = 2.0\n", "own_newer.py": "from own_old import Push\n"})
    for name in ("own_old:Push", "own_newer:Push"):
        with pytest.raises(CodeChangedError, match=name):
            sweep(
                plan.replace(changes=SHORT | user(name)),
                out=place / "kept",
                execution=cp.Execution(workers=0, quiet=True),
            )
    assert stored(place) == 1
    assert (
        sweep(plan, out=place / "kept", execution=cp.Execution(workers=1, quiet=True)).values(
            "torque_peak_Nm"
        )
        == 2.0
    )  # its process is new


def test_an_edit_between_two_readings_does_not_put_old_code_under_the_new_key(place, monkeypatch):
    write(place, {"own_race.py": LAW.format(gains="own_racing"), "own_racing.py": "TORQUE = 1.0\n"})
    plan = SweepPlan(base="adept-paper", changes=SHORT | user("own_race:Push"))
    sweep(plan, out=place / "kept", execution=cp.Execution(workers=0, quiet=True))

    def edited_meanwhile(*read):
        code = code_digests(*read)
        write(place, {"own_racing.py": "TORQUE = 2.0\n"})
        return code

    monkeypatch.setattr(keys, "code_digests", edited_meanwhile)
    assert (
        sweep(plan, out=place / "kept", execution=cp.Execution(workers=0, quiet=True)).values(
            "torque_peak_Nm"
        )
        == 1.0
    )
    assert SweepResult.load(place / "kept").counts() == {"ok": 0, "failed": 0, "missing": 1}
    assert stored(place) == 1


def test_a_worker_with_another_version_refuses_the_job(place):
    write(place, {"own_version.py": LAW.format(gains="own_gain"), "own_gain.py": "TORQUE = 1.0\n"})
    scenario = cp.Scenario.load("adept-paper", SHORT | user("own_version:Push"))
    with pytest.raises(CodeChangedError) as caught:
        run_job(Job("key", scenario, code=(("own_version:Push", ("other",)),)))
    assert caught.value.name == "own_version:Push"


NOTEBOOK = """
import coop_pin as cp
def mine(result):
    return {"mine": 1.0}
try:
    short = {"duration": 0.1, "events": []}
    here = cp.Execution(workers=0, quiet=True)
    cp.sweep("adept-paper", out="kept", execution=here, changes=short, metrics=(mine,))
except cp.CoopPinError as error:
    print(type(error).__name__, error)
"""


@pytest.mark.gate
def test_code_that_stands_in_no_file_is_refused_because_its_edits_cannot_be_seen(place):
    done = subprocess.run(
        [sys.executable, "-c", NOTEBOOK], cwd=place, capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.startswith("FieldError")
    assert "'__main__:mine', which has no file" in done.stdout
    (place / "script.py").write_text(NOTEBOOK + "print('ok')\n")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "script.py"],
        cwd=place,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        env=environment,
    )
    assert done.stdout == "ok\n"


# ---------------------------------------------------------------- where it failed

FAILING = """
import json
import numpy as np
import coop_pin as cp

class Law(cp.CellController):
    def __init__(self, scenario, at):
        self.at = at
        if at == "constructor":
            raise KeyError("constructor")  # constructor

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        if self.at == "library":
            np.linalg.inv(np.zeros((2, 2)))  # library
        if self.at == "compiled":
            np.random.default_rng(0).integers(0)  # compiled
        if self.at == "standard":
            [json.loads(text) for text in ["{"]]  # standard
        return cp.CellCommand([np.zeros(3) for _ in measurements], state)

def metric(result):
    return {"never": 1 / 0}  # metric
"""
KINDS = {
    "library": ("step", "UserCodeError"),
    "compiled": ("step", "UserCodeError"),
    "standard": ("<listcomp>", "UserCodeError"),
    "constructor": ("__init__", "KeyError"),
    "metric": ("metric", "ZeroDivisionError"),
}


def test_failures_name_file_and_line_of_the_users_code_in_any_process(place, monkeypatch):
    """Under the current folder the file is relative to it; otherwise there is no path in a table."""
    write(place, {"own_laws/__init__.py": "", "own_laws/failing.py": FAILING})
    monkeypatch.chdir(place)
    named = {at: user("own_laws.failing:Law")["controller"] | {"options": {"at": at}} for at in KINDS}
    cases = {"law": {at: {"controller": controller} for at, controller in named.items()}}
    plan = SweepPlan(base="adept-paper", changes=SHORT, cases=cases, metrics=("own_laws.failing:metric",))
    found = sweep(plan, out=place / "here", execution=cp.Execution(quiet=True, workers=0)).table
    lines = [next(n for n, line in enumerate(FAILING.splitlines(), 1) if f"# {at}" in line) for at in KINDS]
    for message, line, (at, (function, kind)) in zip(found["message"], lines, KINDS.items(), strict=True):
        assert f"at own_laws/failing.py:{line}" in message, at
        assert function in message, at
        assert found.loc[found["law"] == at, "failure"].item() == kind
    there = sweep(plan, out=place / "there", execution=cp.Execution(quiet=True, workers=1)).table
    assert there["message"].tolist() == found["message"].tolist()

    monkeypatch.chdir(place / "here")
    with pytest.raises(UserCodeError) as caught:
        cp.run("adept-paper", SHORT | cases["law"]["library"], warn=False)
    assert (caught.value.file, caught.value.line) == ("failing.py", lines[0])
    assert str(place) not in str(caught.value)
