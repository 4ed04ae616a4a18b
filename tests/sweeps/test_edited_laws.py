"""Laws that are edited in a live process: no number of old code under a new key, and no silence."""

import contextlib
import importlib
import json
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import coop_pin as cp
from coop_pin.base.errors import CodeChangedError, ScenarioWarning
from coop_pin.sweeps.result import SweepResult

LAW = """
import numpy as np
import coop_pin as cp
{head}
class Push(cp.ArmController):
    def __init__(self, scenario, arm, scale=1.0, file=""):
        self.scale, self.file = scale, file
    def init(self, measurement, reference):
        return None
    def step(self, measurement, reference, state):
        {inside}
        return cp.ArmCommand(self.scale * {K} * np.ones(3), state)
"""
TARGET = "own_push:Push"
SHORT = {"duration": 0.05, "events": [], "controller": {"kind": "user", "target": TARGET}}
AXES = {"controller.options.scale": [1.0, 1.5]}
DATA = "from pathlib import Path\n"
WAYS = {
    "in place": {"own_push": ("K = {}", "", "K")},
    "undone": {"own_push": ("K = {}", "", "K")},
    "reload": {"own_push": ("K = {}", "", "K")},
    "forget": {"own_push": ("K = {}", "", "K")},
    "before the first run": {"own_push": ("K = {}", "", "K")},
    "new cell": {"own_push": ("K = {}", "", "K")},
    "helper": {"own_push": ("from own_help import K", "", "K"), "own_help": "K = {}"},
    "helper reloaded": {"own_push": ("from own_help import K", "", "K"), "own_help": "K = {}"},
    "both reloaded": {"own_push": ("from own_help import K", "", "K"), "own_help": "K = {}"},
    "module of a helper": {"own_push": ("import own_help", "", "own_help.K"), "own_help": "K = {}"},
    "helper in step": {"own_push": ("", "from own_help import K", "K"), "own_help": "K = {}"},
    "data": {"own_push": (DATA + "K = float(Path('own.txt').read_text())", "", "K"), "own.txt": "{}"},
    "data reloaded": {
        "own_push": (DATA + "K = float(Path('own.txt').read_text())", "", "K"),
        "own.txt": "{}",
    },
    "data in step": {"own_push": (DATA, "K = float(Path('own.txt').read_text())", "K"), "own.txt": "{}"},
    "data of an option": {
        "own_push": (DATA, "K = float(Path(self.file).read_text())", "K"),
        "own.txt": "{}",
    },
}
"""Ways to edit: the files, with the number at its place."""
RELOADED = {
    "reload": ["own_push"],
    "helper reloaded": ["own_help"],
    "both reloaded": ["own_help", "own_push"],
    "module of a helper": ["own_help"],
    "data reloaded": ["own_push"],
}
STALE = {
    "in place",
    "before the first run",
    "helper",
    "helper reloaded",
    "helper in step",
    "data",
    "data in step",
}
"""Ways after which the process may run old code: it must say so."""
CALLS = ["run", "here", "workers", "open", "compare"]


def write(way, number):
    for name, content in WAYS[way].items():
        if isinstance(content, str):
            text = content.format(number)
        else:
            head, inside, K = content
            text = LAW.format(head=head.format(number), inside=inside, K=K)
        path = name if "." in name else f"{name}.py"
        with open(path, "w") as file:  # noqa: PTH123
            file.write(text)
    if way == "new cell":
        exec(text, vars(sys.modules["__main__"]))


def call(what, out):
    """Return the torque by a call, N m: one, or those of the table and of the run that is opened."""
    here, two = (cp.Execution(workers=n, quiet=True) for n in (0, 2))

    def of_run(result):
        return float(result.data["commanded_torque"].values[0].max())

    def of_table(result):
        return float(result.values("torque_peak_Nm").values.ravel()[0])

    match what:
        case "run":
            return [of_run(cp.run("adept-paper", SHORT, warn=False))]
        case "here":
            return [of_table(cp.sweep("adept-paper", AXES, out=out, changes=SHORT, execution=here))]
        case "workers":
            return [of_table(cp.sweep("adept-paper", AXES, out=out, changes=SHORT, execution=two))]
        case "open":
            result = cp.sweep("adept-paper", AXES, out=out, changes=SHORT, execution=two)
            return [of_table(result), of_run(result.open(0))]
    own = {"mine": cp.UserController(**SHORT["controller"])}
    table = cp.compare("adept-paper", own, ["nominal"], out=out, duration=0.5, execution=here)
    return [of_run(table.open("adept-paper", "mine", "nominal"))]


def edited_process(way, what):
    """Print the torques of a call after an edit from 1 to 2 N m, or the error, and the warnings."""
    if way == "new cell":
        SHORT["controller"]["target"] = "__main__:Push"
    if way == "data of an option":
        SHORT["controller"]["options"] = {"file": "own.txt"}
    write(way, 1.0)
    if way == "before the first run":
        importlib.import_module("own_push")
    elif way != "new cell" or what in ("run", "compare"):
        call(what, what)
    write(way, 2.0)
    if way == "undone":
        write(way, 1.0)
    if way == "forget":
        del sys.modules["own_push"]
    for name in RELOADED.get(way, ()):
        importlib.reload(sys.modules[name])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            after = call(what, what)
        except cp.CoopPinError as error:
            after = type(error).__name__
    print(
        json.dumps([after, [each.category.__name__ for each in caught if each.category is ScenarioWarning]])
    )


@pytest.fixture
def process(tmp_path):
    """A function that runs ``edited_process`` in a new process in an empty folder."""

    def outcome(way, what):
        folders = [str(Path(__file__).parent), *sys.path, "."]
        code = f"import sys; sys.path[:0] = {folders!r}\nimport test_edited_laws\n"
        code += f"test_edited_laws.edited_process({way!r}, {what!r})\n"
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return outcome


SAMPLE = {("in place", "run"), ("helper", "here")}


@pytest.mark.parametrize(
    ("way", "what"),
    [
        pytest.param(way, what, marks=[] if (way, what) in SAMPLE else pytest.mark.slow)
        for way in WAYS
        for what in CALLS
    ],
)
def test_after_an_edit_numbers_are_those_of_the_code_that_ran(way, what, process):
    after, told = process(way, what)
    if way == "new cell" and what in ("here", "workers", "open"):
        assert after == "FieldError"
    elif way in STALE and what == "run":
        assert told
        assert after in ([1.0], [2.0])  # a file that is read in every step is new
    elif way in STALE and what != "workers":
        assert after == "CodeChangedError"
    else:
        assert {*after} == {1.0 if way == "undone" else 2.0}
        assert not told


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder on the Python path and the current one, whose modules are forgotten afterwards."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in ("own_push", "own_help"):
        sys.modules.pop(name, None)


@pytest.mark.usefixtures("place")
def test_a_finished_sweep_says_which_file_changed(caplog):
    write("helper", 1.0)
    here = cp.Execution(workers=0, quiet=True)
    result = cp.sweep("adept-paper", AXES, out="kept", changes=SHORT, execution=here)
    assert "own_help.py" not in SweepResult.load("kept").summary()
    assert result.open(0).data.sizes["time"] > 1
    write("helper", 2.0)
    loaded = SweepResult.load("kept")
    assert "own_help.py changed" in loaded.summary()
    assert "own_push.py changed" not in loaded.summary()
    assert "own_help.py changed" in caplog.text
    assert loaded.counts() == {"ok": 0, "failed": 0, "missing": 2}
    with pytest.raises(CodeChangedError) as caught:
        loaded.open(0)
    assert caught.value.files == ("own_help.py",)
    with pytest.warns(ScenarioWarning, match=r"own_help\.py"):
        assert result.open(0).data.sizes["time"] > 1  # its table and this process have the old code


@pytest.mark.gate
@pytest.mark.usefixtures("place")
def test_a_law_that_rewrites_its_data_is_told_and_refused_from_then_on(caplog):
    head, reads = WAYS["data in step"]["own_push"][:2]
    inside = f"{reads}; Path('own.txt').write_text(str(K + 1e-3))"
    Path("own_push.py").write_text(LAW.format(head=head, inside=inside, K="K"))
    Path("own.txt").write_text("1.0")
    with pytest.warns(ScenarioWarning, match=r"the file own\.txt"):
        cp.run("adept-paper", SHORT)
    with pytest.raises(CodeChangedError):
        call("here", "refused")
    importlib.reload(sys.modules["own_push"])
    with contextlib.suppress(CodeChangedError):
        call("here", "told")
    assert "the file own.txt" in caplog.text


@pytest.mark.usefixtures("place")
def test_a_check_finds_an_edit():
    write("in place", 1.0)
    scenario = cp.Scenario.load("adept-paper", SHORT)
    assert not [finding for finding in cp.check(scenario).entries if finding.kind == "user code"]
    cp.run(scenario, warn=False)
    write("in place", 2.0)
    (finding,) = (each for each in cp.check(scenario).entries if each.kind == "user code")
    assert (finding.place, finding.severity) == ("own_push.py", "warning")
    with pytest.warns(ScenarioWarning, match=r"own_push\.py"):
        result = cp.run(scenario, warn=False)
    assert [each.kind for each in result.findings.of("warning")] == ["user code"]
