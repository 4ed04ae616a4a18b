"""Public interface: what ``import coop_pin as cp`` gives, and scenarios written with its classes."""

import importlib
import inspect
import operator
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import coop_pin as cp
from coop_pin.base.schema.base import Description

PACKAGE = Path(cp.__file__).parent
REPOSITORY = Path(__file__).resolve().parents[2]
NAMESPACES = {name: value for name in dir(cp) if inspect.ismodule(value := getattr(cp, name))}
INNER = {"base", "cli", "control", "description", "environment", "reference", "running", "simulation"}
INNER |= {"tracing"}
"""Packages whose public names are in ``cp`` or in a namespace."""


def run_python(code):
    """What a fresh process prints that runs some code."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def places():
    """Public places of every name, as ``motions.LineMotion``."""
    found = {name: [name] for name in (*cp.__all__, *NAMESPACES)}
    for space, module in NAMESPACES.items():
        for name in module.__all__:
            found.setdefault(name, []).append(f"{space}.{name}")
    return found


RESOLVES = """
import importlib, importlib.util, os, sys, types
import coop_pin as cp
assert not [name for name in sys.modules if name.startswith(("coop_pin.", "numpy"))]

import matplotlib, numpy, pinocchio, pydantic, scipy.spatial, xarray  # once for all children

def check(space):
    full = f"coop_pin.{space}"
    module = getattr(cp, space)
    assert module is importlib.import_module(full) is sys.modules[full] and space in dir(cp)
    assert module.__doc__ and set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        if importlib.util.find_spec(f"{full}.{name}"):
            importlib.import_module(f"{full}.{name}")  # a file of that name must not hide the name
        names = {}
        exec(f"from {full} import {name} as value", names)
        assert names["value"] is getattr(module, name)
        assert not isinstance(names["value"], types.ModuleType), name

children = {}
spaces = [name for name in dir(cp) if name not in cp.__all__ and not name.startswith("__")]
for space in (*spaces[::{every}], ""):
    child = os.fork()
    if not child:
        try:
            check(space) if space else [getattr(cp, name) for name in cp.__all__]
        except BaseException as error:
            print(f"{space}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    children[child] = space
print("failed:", *[space for child, space in children.items() if os.waitpid(child, 0)[1]])
"""


@pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.slow)])
def test_every_namespace_and_name_resolves_after_importing_nothing_but_coop_pin(every):
    """Each namespace in a process of its own."""
    assert run_python(RESOLVES.replace("{every}", str(every))) == "failed:\n"


def test_cp_has_forty_names_at_most_and_every_package_has_a_place():
    assert 30 <= len(cp.__all__) <= 40
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert packages - set(NAMESPACES) == INNER
    assert all(module.__name__ == f"coop_pin.{space}" for space, module in NAMESPACES.items())


def test_each_public_name_stands_in_one_place():
    assert {name: found for name, found in places().items() if len(found) > 1} == {}
    values = {name: operator.attrgetter(place)(cp) for name, (place, *_) in places().items()}
    doubled = [
        (space, name)
        for space, module in NAMESPACES.items()
        for name, value in values.items()
        if name not in module.__all__ and vars(module).get(name) is value
    ]
    assert doubled == []
    assert len(values) > 280


def test_every_exception_is_public():
    errors = inspect.getmembers(importlib.import_module("coop_pin.base.errors"), inspect.isclass)
    public = {name for name, kind in errors if issubclass(kind, BaseException) and name[0] != "_"}
    assert public - {"CoopPinError"} == set(cp.errors.__all__)


OLD = {
    "LineMotion": "cp.motions.LineMotion",
    "RampSqueeze": "cp.squeezes.RampSqueeze",
    "WrenchPulse": "cp.events.WrenchPulse",
    "Encoder": "cp.sensors.Encoder",
    "SlidingMode": "cp.laws.SlidingMode",
    "reachability": "cp.feasibility.reachability",
    "eigenvalues": "cp.stability.eigenvalues",
    "plan_carry": "cp.carry.plan_carry",
    "TuneResult": "cp.sweeps.TuneResult",
    "analysis": "cp.stability",
    "batch": "cp.compiled",
    "catalogue": "cp",
    "run_scenario": "cp and cp.laws",
    "LineMoton": "cp.motions.LineMotion",
    "motion": "cp.motions",
    "Ramp": "cp.squeezes.RampSqueeze",
}
"""Wrong names, old ones first, and where the right one is."""


@pytest.mark.parametrize("name", OLD)
def test_a_wrong_or_old_name_is_answered_with_where_it_is(name):
    with pytest.raises(AttributeError, match=re.escape(OLD[name])):
        getattr(cp, name)
    for code in (f"from coop_pin import {name}", f"import coop_pin.{name}"):
        with pytest.raises(ImportError, match=re.escape(OLD[name])):
            exec(code, {})
    assert not hasattr(cp, name)


@pytest.mark.parametrize(
    ("module", "name", "place"),
    [
        ("motions", "RampSqueeze", "cp.squeezes.RampSqueeze"),
        ("chain", "CellChain", "cp.grasps.CellChain"),
        ("results", "RunResult", "cp.RunResult"),
        ("sweeps", "sweep", "cp.sweep"),
        ("errors", "CoopPinError", "cp.CoopPinError"),
        ("errors", "FieldEror", "cp.errors.FieldError"),
        ("stability", "eigenvalue", "cp.stability.eigenvalues"),
        ("description", "Encoder", "cp.sensors.Encoder"),
    ],
)
def test_a_name_in_the_wrong_namespace_is_answered_with_the_right_one(module, name, place):
    with pytest.raises(ImportError, match=re.escape(place)):
        exec(f"from coop_pin.{module} import {name}", {})
    if module not in INNER:
        with pytest.raises(AttributeError, match=re.escape(place)):
            getattr(NAMESPACES[module], name)


@pytest.mark.parametrize("module", ["no_such_module", "chain.no_such_module", "motions.LineMotion", "_x"])
def test_a_module_that_nobody_could_mean_is_not_found_as_usual(module):
    with pytest.raises(ModuleNotFoundError) as caught:
        importlib.import_module(f"coop_pin.{module}")
    assert caught.value.name == f"coop_pin.{module}"


BLIND = """
import sys
sys.modules["pinocchio"] = None  # importing it raises from here on
import coop_pin as cp
import coop_pin.control
for space in ("actuators", "errors", "events", "laws", "motions", "network", "numbers", "plant", "sensors",
              "spatial", "squeezes", "urdf"):
    module = getattr(cp, space)
    for name in module.__all__:
        if name != "build_controller":
            getattr(module, name)
for name in ("Cell", "CoopPinError", "PatchGrasp", "Scenario", "scenario_names"):
    getattr(cp, name)
print(cp.Scenario.load("adept-paper").name)
"""


def test_what_a_user_writes_needs_no_pinocchio():
    assert run_python(BLIND) == "adept-paper\n"


def callables_of(name):
    """A public function, or the public methods and the constructor of a public class."""
    value = getattr(cp, name)
    if inspect.isfunction(value):
        yield value
    for method, member in vars(value).items() if inspect.isclass(value) else ():
        function = getattr(member, "fget", getattr(member, "__func__", member))
        if inspect.isfunction(function) and (method == "__init__" or not method.startswith("_")):
            yield function


def test_a_class_that_is_only_returned_stays_in_its_package():
    """Users annotate or subclass what they take or return themselves, and load results of earlier runs."""
    returned, taken = set(), set()
    for name in cp.__all__:
        is_interface = inspect.isabstract(getattr(cp, name))
        for function in callables_of(name):
            texts = {argument: str(text) for argument, text in function.__annotations__.items()}
            answer = set(re.findall(r"\w+", texts.pop("return", "")))
            (taken if is_interface else returned).update(answer)
            taken.update(*(re.findall(r"\w+", text) for text in texts.values()))
    written = {"Snapshot"}  # of observers, which are any function
    for name in cp.__all__:
        value = getattr(cp, name)
        if inspect.isclass(value) and (
            inspect.isabstract(value)
            or issubclass(value, Description)
            or any(isinstance(member, classmethod) for member in vars(value).values())
        ):
            written.add(name)
    assert sorted((returned & set(cp.__all__)) - taken - written) == []


def test_names_are_listed_and_wrong_ones_are_attribute_errors():
    assert {*cp.__all__, *NAMESPACES} <= set(dir(cp))
    assert cp.__version__
    for module in (cp, cp.viz, cp.sweeps, cp.motions, cp.chain):
        with pytest.raises(AttributeError, match="no_such_name"):
            module.no_such_name  # noqa: B018


def written_in_python(**fields):
    """A scenario of two planar Adept arms in which every part is an object of a class in ``cp``."""
    adept = {
        "urdf": "adept_3dof",
        "tip": "tip",
        "friction": cp.actuators.JointFriction(viscous=1.3, coulomb=0.01, coulomb_velocity=0.05),
    }
    start = cp.Pose(xyz=(0.6, 0.146, 0.0), rpy=(0.0, 0.0, 0.947))
    given = {
        "name": "written-in-python",
        "cell": cp.Cell(
            arms={
                "left": cp.Arm(posture=(1.2, -1.6, 1.8), **adept),
                "right": cp.Arm(base=cp.Pose(xyz=(1.0, 0.0, 0.0)), posture=(1.6, 2.0, -2.7), **adept),
            },
            payload=cp.Payload.box(mass=11.2, size=(0.24, 0.03, 0.03)),
            grasps={"left": cp.Pose(xyz=(-0.12, 0.0, 0.0)), "right": cp.Pose(xyz=(0.12, 0.0, 0.0))},
            rows="planar",
        ),
        "controller": cp.laws.SlidingMode(gains=GAINS, switching=cp.laws.Saturation(width=0.01)),
        "motion": cp.motions.HoldMotion(pose=start),
        "squeeze": cp.squeezes.RampSqueeze(
            goal={"left": (-10.0, 0, 0, 0, 0, 0), "right": (10.0, 0, 0, 0, 0, 0)}, duration=0.1
        ),
        "events": (
            cp.events.PayloadChange(time=0.02, mass=5.6),
            cp.events.WrenchPulse(time=0.02, duration=0.02, wrench=(5.0, 0, 0, 0, 0, 0)),
        ),
        "plant": cp.plant.PlantOptions(stabilisation=cp.plant.Stabilisation(frequency=20.0)),
        "clock": cp.Clock(rate_hz=100.0, steps_per_tick=2),
        "start": start,
        "duration": 0.05,
    }
    return cp.Scenario(**given | fields)


GAINS = cp.laws.SlidingModeGains(
    pose_gain=2.0, sign_gain=0.2, damping_gain=(60.0, 60.0, 10.0), force_gain=0.0, transient_rate=5.0
)
TASK_GAINS = cp.laws.PayloadSpaceGains(
    pose_gain=2.0, sign_gain=0.0, sliding_gain=(200.0, 200.0, 10.0), force_gain=0.5, transient_rate=5.0
)
CONTROLLERS = [
    cp.laws.SlidingMode(gains=GAINS, switching=cp.laws.Saturation(width=0.01)),
    cp.laws.SlidingMode(
        gains=GAINS.replace(force_gain=0.5), switching=cp.laws.Sign(), force_path=cp.laws.LateForcePath()
    ),
    cp.laws.RedundantSlidingMode(
        gains=GAINS,
        posture=cp.laws.PostureGains(),
        switching=cp.laws.Tanh(width=0.01),
        force_path=cp.laws.LowPassForcePath(pole=0.9),
    ),
    cp.laws.PayloadSpace(gains=TASK_GAINS, force_path=cp.laws.LateForcePath()),
    cp.laws.PayloadSpace(gains=TASK_GAINS.replace(force_gain=0.0), force_path=cp.laws.NoForcePath()),
]


@pytest.mark.parametrize("controller", CONTROLLERS, ids=lambda controller: controller.kind)
def test_a_scenario_written_in_python_is_that_of_its_file_and_runs(controller):
    scenario = written_in_python(controller=controller)
    assert scenario.controller is controller or scenario.controller == controller
    assert cp.Scenario.from_toml(scenario.to_toml()) == scenario
    result = cp.run(scenario)
    assert isinstance(result, cp.RunResult)
    assert np.isfinite(result.data["velocity"]).all()


class Still(cp.ArmController):
    """A user's controller: damping in the joints, no state."""

    def __init__(self, scenario, arm, damping=5.0):
        self.damping = damping

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        return cp.ArmCommand(-self.damping * measurement.v, state)


def test_a_users_controller_is_an_object_too():
    controller = cp.UserController(target="test_interface:Still", options={"damping": 20.0})
    assert cp.run(written_in_python(controller=controller)).end == pytest.approx(0.05)


def test_grasps_of_a_class_need_no_kind():
    soft = cp.CompliantGrasp(xyz=(-0.1, 0.0, 0.0), stiffness="soft")
    palm = cp.PatchGrasp(xyz=(0.1, 0.0, 0.0), mu=0.5, radius=0.02, face=(0.1, 0.1))
    cell = written_in_python().cell
    given = cell.replace(grasps={"left": soft, "right": palm}).model_dump()
    tables = {"left": given["grasps"]["left"], "right": given["grasps"]["right"]}
    assert [table["kind"] for table in tables.values()] == ["compliant", "patch"]
    assert cell.replace(grasps=tables).grasps == {"left": soft, "right": palm}


def test_no_file_shows_an_internal_default_of_pydantic():
    folders = ("coop_pin", "docs", "examples", "notebooks", "studies", "tests", "tools")
    files = [file for folder in folders for file in (REPOSITORY / folder).rglob("*.*")]
    texts = {".ipynb", ".md", ".py", ".toml"}
    shown = ("Pydantic" + "Undefined").encode()
    assert [file for file in files if file.suffix in texts and shown in file.read_bytes()] == []
    assert len(files) > 500
