"""Public interface: what ``import coop_pin as cp`` gives, and scenarios written with its classes."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import coop_pin as cp

PACKAGE = Path(cp.__file__).parent
REPOSITORY = Path(__file__).resolve().parents[2]

RESOLVES = """
import importlib.util, os, sys, types
import coop_pin as cp
assert not [name for name in sys.modules if name.startswith(("coop_pin.", "numpy"))]

import matplotlib, numpy, pinocchio, pydantic, scipy.spatial, xarray  # once for all children

def check(package):
    full = f"coop_pin.{package}"
    module = getattr(cp, package)
    assert module is importlib.import_module(full) and package in dir(cp)
    for name in getattr(module, "__all__", ()):
        if hasattr(module, "__path__") and importlib.util.find_spec(f"{full}.{name}"):
            importlib.import_module(f"{full}.{name}")  # a file of that name must not hide the name
        assert not isinstance(getattr(module, name), types.ModuleType), name
    for name, defined_in in cp._PUBLIC.items():
        if defined_in == full:
            assert getattr(cp, name) is getattr(module, name), name

children = {}
for package in cp._PACKAGES:
    child = os.fork()
    if not child:
        try:
            check(package)
        except BaseException as error:
            print(f"{package}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    children[child] = package
failed = [package for child, package in children.items() if os.waitpid(child, 0)[1]]
print("failed:", *failed)
"""


def test_every_package_and_name_resolves_after_importing_nothing_but_coop_pin():
    """Each package in a process of its own."""
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", RESOLVES],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout == "failed:\n", done.stdout + done.stderr


def test_the_packages_are_those_that_exist_but_the_command_line_and_an_extra():
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")} | {"errors"}
    assert packages - {"cli", "environment"} == set(cp._PACKAGES)  # the latter needs an extra


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
            or issubclass(value, cp.base.schema.base.Description)
            or any(isinstance(member, classmethod) for member in vars(value).values())
        ):
            written.add(name)
    assert sorted((returned & set(cp.__all__)) - taken - written) == []


def test_names_are_listed_and_wrong_ones_are_attribute_errors():
    assert {*cp.__all__, *cp._PACKAGES} <= set(dir(cp))
    assert cp.__version__
    for module in (cp, cp.viz, cp.sweeps):
        with pytest.raises(AttributeError, match="no_such_name"):
            module.no_such_name  # noqa: B018


def written_in_python(**fields):
    """A scenario of two planar Adept arms in which every part is an object of a class in ``cp``."""
    adept = {
        "urdf": "adept_3dof",
        "tip": "tip",
        "friction": cp.JointFriction(viscous=1.3, coulomb=0.01, coulomb_velocity=0.05),
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
        "controller": cp.SlidingMode(gains=GAINS, switching=cp.Saturation(width=0.01)),
        "motion": cp.HoldMotion(pose=start),
        "squeeze": cp.RampSqueeze(
            goal={"left": (-10.0, 0, 0, 0, 0, 0), "right": (10.0, 0, 0, 0, 0, 0)}, duration=0.1
        ),
        "events": (
            cp.PayloadChange(time=0.02, mass=5.6),
            cp.WrenchPulse(time=0.02, duration=0.02, wrench=(5.0, 0, 0, 0, 0, 0)),
        ),
        "plant": cp.PlantOptions(stabilisation=cp.Stabilisation(frequency=20.0)),
        "clock": cp.Clock(rate_hz=100.0, steps_per_tick=2),
        "start": start,
        "duration": 0.05,
    }
    return cp.Scenario(**given | fields)


GAINS = cp.SlidingModeGains(
    pose_gain=2.0, sign_gain=0.2, damping_gain=(60.0, 60.0, 10.0), force_gain=0.0, transient_rate=5.0
)
TASK_GAINS = cp.PayloadSpaceGains(
    pose_gain=2.0, sign_gain=0.0, sliding_gain=(200.0, 200.0, 10.0), force_gain=0.5, transient_rate=5.0
)
CONTROLLERS = [
    cp.SlidingMode(gains=GAINS, switching=cp.Saturation(width=0.01)),
    cp.SlidingMode(gains=GAINS.replace(force_gain=0.5), switching=cp.Sign(), force_path=cp.LateForcePath()),
    cp.RedundantSlidingMode(
        gains=GAINS,
        posture=cp.PostureGains(),
        switching=cp.Tanh(width=0.01),
        force_path=cp.LowPassForcePath(pole=0.9),
    ),
    cp.PayloadSpace(gains=TASK_GAINS, force_path=cp.LateForcePath()),
    cp.PayloadSpace(gains=TASK_GAINS.replace(force_gain=0.0), force_path=cp.NoForcePath()),
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
