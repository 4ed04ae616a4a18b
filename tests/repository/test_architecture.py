"""The direction of imports between packages, and that controllers cannot reach a model."""

import ast
import collections
import functools
import graphlib
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from cells import SCENARIOS
from source_trees import SourceTrees, nodes

import coop_pin
from coop_pin.cli.parsing import COMMANDS
from coop_pin.control import ArmMeasurement, CellController
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulate import simulate

PACKAGE = Path(coop_pin.__file__).parent
REPOSITORY = Path(__file__).resolve().parents[2]

EVERYWHERE = {"base"}

# Package -> (packages it imports besides base, third parties besides numpy), lowest first. Why:
# - base has the frozen pydantic base of a scenario; it, reference and results use scipy's quaternions;
# - yourdfpy, whose XML reader is lxml, gives poses of links and bodies of payloads;
# - Pinocchio's geometry is read in model, so that viz needs no Pinocchio;
# - model solves inverse kinematics, which takes Pinocchio's poses;
# - tracing is a compiler of functions of arrays, knows no robot and imports not even base; llvmlite compiles;
# - grasps trace the wrenches of springs and patches, and compiled the laws and the plant of runs;
# - nothing imports model_based but by name: description has its laws, which load when they are built;
# - simulation builds controllers, and asks a model for the number of joints that gains must fit;
# - running finds what is doubtful before a run, and runs; design proposes what passes that;
# - viz runs simulations: its panel owns one, and a view that opens before the run asks for the start;
#   nothing below viz imports it, simulate takes any observer;
# - figures draw runs and sweeps; sweeps and their workers never import figures or viz;
# - sweeps look at a run's path before the first run, and show progress on terminals;
# - experiments of the zoo are written as users write them, by the public names of cp alone.
PACKAGES: dict[str, tuple[set[str], set[str]]] = {
    "base": (set(), {"pydantic", "pydantic_core", "scipy"}),
    "tracing": (set(), {"llvmlite"}),
    "reference": (set(), {"pydantic", "scipy"}),
    "control": (set(), {"pydantic"}),
    "description": (
        {"control", "reference"},
        {"lxml", "pydantic", "tomli_w", "trimesh", "xacrodoc", "yourdfpy"},
    ),
    "model": ({"description"}, {"collada", "mujoco", "pinocchio", "scipy", "trimesh"}),
    "chain": ({"description", "model", "tracing"}, {"pinocchio", "scipy"}),
    "results": ({"description"}, {"h5py", "pandas", "xarray"}),
    "grasps": ({"chain", "description", "model", "tracing"}, {"clarabel", "pinocchio", "scipy"}),
    "simulation": ({"chain", "control", "description", "grasps", "model", "reference", "results"}, set()),
    "model_based": ({"control", "description", "model"}, {"pinocchio", "proxsuite"}),
    "compiled": (
        {
            "chain",
            "control",
            "description",
            "grasps",
            "model",
            "reference",
            "results",
            "simulation",
            "tracing",
        },
        {"pinocchio"},
    ),
    "feasibility": (
        {"control", "description", "grasps", "model", "reference", "simulation"},
        {"pinocchio", "scipy"},
    ),
    "stability": (
        {"chain", "control", "description", "feasibility", "grasps", "model", "simulation"},
        {"pinocchio", "scipy"},
    ),
    "logs": (
        {"description", "model", "results"},
        {"mcap", "mcap_ros2", "pandas", "pinocchio", "pyarrow", "scipy"},
    ),
    "identification": (
        {"compiled", "description", "grasps", "logs", "model", "results", "simulation"},
        {"pinocchio", "scipy"},
    ),
    "running": (
        {"compiled", "control", "description", "feasibility", "model", "results", "simulation", "stability"},
        set(),
    ),
    "design": (
        {
            "control",
            "description",
            "feasibility",
            "grasps",
            "model",
            "reference",
            "results",
            "running",
            "simulation",
            "stability",
        },
        {"pinocchio", "scipy"},
    ),
    "proof": ({"control", "description", "model", "results", "simulation"}, {"pinocchio", "xarray"}),
    "environment": (
        {"compiled", "control", "description", "results", "simulation", "tracing"},
        {"gymnasium"},
    ),
    "sweeps": (
        {
            "compiled",
            "control",
            "description",
            "feasibility",
            "results",
            "running",
            "simulation",
            "stability",
        },
        {
            "distributed",
            "filelock",
            "optuna",
            "pandas",
            "pebble",
            "pydantic",
            "scipy",
            "tqdm",
            "xarray",
        },
    ),
    "comparison": (
        {
            "compiled",
            "control",
            "description",
            "design",
            "feasibility",
            "grasps",
            "model",
            "results",
            "simulation",
            "stability",
            "sweeps",
        },
        {"pandas", "xarray"},
    ),
    "figures": (
        {"comparison", "description", "identification", "results", "stability", "sweeps"},
        {"matplotlib", "xarray"},
    ),
    "viz": (
        {
            "comparison",
            "description",
            "figures",
            "grasps",
            "identification",
            "model",
            "reference",
            "results",
            "running",
            "simulation",
            "sweeps",
        },
        {
            "anywidget",
            "fast_simplification",
            "imageio_ffmpeg",
            "ipywidgets",
            "matplotlib",
            "playwright",
            "tornado",
            "traitlets",
            "xarray",
        },
    ),
    "zoo": ({"description"}, {"pinocchio", "pydantic", "scipy"}),
    "cli": (
        {
            "comparison",
            "compiled",
            "description",
            "design",
            "feasibility",
            "figures",
            "identification",
            "logs",
            "results",
            "running",
            "stability",
            "sweeps",
            "viz",
            "zoo",
        },
        {"pydantic", "tyro"},
    ),
    "__main__": ({"cli"}, set()),
}

# Distributions by the names they are imported under, and what another distribution brings along.
IMPORTED_AS = {
    "pin": "pinocchio",
    "tomli-w": "tomli_w",
    "imageio-ffmpeg": "imageio_ffmpeg",
    "fast-simplification": "fast_simplification",
    "pycollada": "collada",
    "mcap-ros2-support": "mcap_ros2",
}
COMES_WITH = {
    "h5py": "h5netcdf",
    "pandas": "xarray",
    "pydantic_core": "pydantic",
    "tornado": "meshcat",
    "umsgpack": "meshcat",
    "zmq": "meshcat",
}

FROM_THE_TOP = {"__version__", "lazy_names"}
"""The only names that a package may take from ``coop_pin`` itself, which loads nothing."""

COPIED = "tracing"
"""The package that works as a copy of its folder elsewhere: it imports its own files by relative names."""

TREES = SourceTrees(sorted(PACKAGE.rglob("*.py")))
MODULES = {
    ".".join(("coop_pin", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): file
    for file in TREES
}


def package_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def module_of(node: ast.ImportFrom, file: Path) -> str:
    """Full name of the module from which a statement of a file imports."""
    folder = ("coop_pin", *file.relative_to(PACKAGE).parts[: -node.level]) if node.level else ()
    return ".".join((*folder, *filter(None, [node.module])))


@functools.cache
def imports_of(file: Path) -> list[tuple[str, list[str]]]:
    """Module and names of every import of a file, inside functions and by ``import_module`` too."""
    found: list[tuple[str, list[str]]] = []
    for node in nodes(TREES[file]):
        if isinstance(node, ast.Import):
            found += [(alias.name, []) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names, module = [alias.name for alias in node.names], module_of(node, file)
            if module == "coop_pin":
                found += [(f"coop_pin.{name}", []) for name in names if name in PACKAGES]
                names = [name for name in names if name not in PACKAGES]
            found.append((module, names))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "importlib.import_module":
            found += [(str(given.value), []) for given in node.args if isinstance(given, ast.Constant)]
    return found


@functools.cache
def imports() -> dict[str, set[str]]:
    """Packages of coop_pin and third parties that each package imports."""
    found: dict[str, set[str]] = {package: set() for package in PACKAGES}
    for file in TREES:
        for module, _ in imports_of(file):
            top, *rest = module.split(".")
            if top == "coop_pin":
                found[package_of(file)] |= set(rest[:1])
            elif top not in sys.stdlib_module_names:
                found[package_of(file)].add(top)
    return {package: names - {package} for package, names in found.items()}


def test_files_are_in_a_package_of_the_table_and_import_by_full_name_without_escapes():
    offenders = [
        f"{file.relative_to(PACKAGE)}: {module} {names}"
        for file in TREES
        for module, names in imports_of(file)
        if module == "coop_pin" and not set(names) <= FROM_THE_TOP
    ]
    assert offenders == []
    entries = [(file, node) for file, tree in TREES.items() for node in nodes(tree)]
    relative = {(package_of(file), node.level) for file, node in entries if getattr(node, "level", 0)}
    assert relative == {(COPIED, 1)}
    assert {package_of(file) for file in TREES} == {*PACKAGES, "__init__"}


def test_only_experiments_of_the_zoo_import_the_package_as_its_users_do():
    """Their imports are then all of cp, and nothing but the command imports them."""
    whole = {
        file.relative_to(PACKAGE).as_posix()
        for file, tree in TREES.items()
        for node in nodes(tree)
        if isinstance(node, ast.Import) and "coop_pin" in [alias.name for alias in node.names]
    }
    users = {file.relative_to(PACKAGE).as_posix() for file in PACKAGE.glob("zoo/*/experiment.py")}
    assert users == whole
    assert {package for package, (others, _) in PACKAGES.items() if "zoo" in others} == {"cli"}


def test_only_libraries_that_are_slow_to_load_are_imported_for_types_alone():
    """An import of the package itself would hide a cycle."""
    for_types = {
        f"{file.relative_to(PACKAGE)}: {ast.unparse(statement)}"
        for file, tree in TREES.items()
        for block in nodes(tree)
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
        for statement in block.body
        if isinstance(statement, ast.Import | ast.ImportFrom)
    }
    assert for_types == {
        "results/run_result.py: import pandas as pd",
        "results/run_result.py: import xarray as xr",
    }


def test_a_package_imports_exactly_what_the_table_allows():
    """No more, and no dead entries."""
    beyond, unused = {}, {}
    for package, (packages, third_parties) in PACKAGES.items():
        used, allowed = imports()[package] - EVERYWHERE - {"numpy"}, packages | third_parties
        beyond[package], unused[package] = used - allowed, allowed - used
    assert {package: names for package, names in beyond.items() if names} == {}
    assert {package: names for package, names in unused.items() if names} == {}
    assert imports()[COPIED] == {"numpy", "llvmlite"}


BASE = {
    "errors": set(),
    "arrays": {"errors", "memory"},
    "memory": {"errors"},
    "atomic_write": {"errors"},
    "spatial": {"arrays", "errors"},
}
"""What the lowest files of base import of it."""


@pytest.mark.parametrize("name", BASE)
def test_the_lowest_files_stand_on_nothing(name):
    files = [file for file in TREES if file.relative_to(PACKAGE).with_suffix("").parts[:2] == ("base", name)]
    used = {module.split(".")[2] for file in files for module in modules_imported_by(file)}
    assert files
    assert used - {name} <= BASE[name]


def cycle(graph: dict[str, set[str]]) -> list[str]:
    """The nodes of one cycle of a graph, or none."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


def modules_imported_by(file: Path) -> set[str]:
    """Modules of coop_pin that a file imports; a name of a package counts as the module that defines it."""
    found = set()
    for module, names in imports_of(file):
        found.add(module if not names else "")
        for name in names if module in MODULES else []:
            inner = f"{module}.{name}"
            owner = None if inner in MODULES else getattr(importlib.import_module(module), name)
            found.add(inner if owner is None else getattr(owner, "__module__", module))
    return found & set(MODULES)


def test_there_are_no_cycles_between_packages_or_files():
    """Imports inside functions included."""
    assert cycle(imports()) == []
    assert cycle({package: packages for package, (packages, _) in PACKAGES.items()}) == []
    files = {name: file for name, file in MODULES.items() if not file.name.startswith("__")}
    assert cycle({name: modules_imported_by(file) - {name} for name, file in files.items()}) == []
    assert cycle({"control": {"model"}, "model": {"control"}})


@pytest.mark.parametrize("package", ["compiled", "tracing"])
def test_a_package_of_many_stages_says_in_which_order_its_files_are_read(package):
    """Each file is named before those that import it."""
    _, text = ast.get_docstring(TREES[PACKAGE / package / "__init__.py"]).split("build on each")
    places = {
        file.stem: re.search(rf"\b{file.stem}\b", text).start()
        for file in (PACKAGE / package).rglob("*.py")
        if file.stem != "__init__"
    }
    later = [
        (importer, imported)
        for importer in places
        for module in modules_imported_by(*(PACKAGE / package).rglob(f"{importer}.py"))
        if module.startswith(f"coop_pin.{package}.")
        and (imported := module.rpartition(".")[2]) in places
        and places[imported] > places[importer]
    ]
    assert later == []


FOLDERS = sorted(file.parent.relative_to(PACKAGE).as_posix() for file in PACKAGE.rglob("__init__.py"))
READ_FIRST = [folder for folder in FOLDERS if not re.match(r"\.|control|tracing", folder)]
"""Folders whose docstrings a newcomer reads first."""


@pytest.mark.parametrize("folder", READ_FIRST)
def test_a_package_says_what_to_open_first_and_what_it_imports(folder):
    """Files that are named exist, and imports are those of the table."""
    text = ast.get_docstring(TREES[PACKAGE / folder / "__init__.py"])
    (first,) = re.findall(r"Open first: (.*?)\n\n", text, re.DOTALL)
    assert len(re.findall(r"``[\w/.]+``", first)) >= 3
    known = {file.stem for file in TREES} | {Path(name).name for name in FOLDERS}
    known |= {*dir(coop_pin), *COMMANDS, "cp", "fields", "init", "step", "module", "web", "scenarios"}
    known |= {name for space in dir(coop_pin) for name in getattr(getattr(coop_pin, space), "__all__", ())}
    named = {name.rpartition("/")[2] for name in re.findall(r"``([a-z][a-z0-9_/]+)``", text)}
    assert named - known == set() or folder == "description/urdf"  # which names its findings
    if folder in PACKAGES:
        imported = set(re.findall(r"``(\w+)``", text.rpartition("\n\nImports ")[2]))
        assert imported == (PACKAGES[folder][0] | EVERYWHERE) - {folder}


def test_a_folder_has_at_most_16_files_beside_its_docstring():
    folders = {path.parent for path in PACKAGE.rglob("*.py")}
    counts = {str(folder): len([*folder.glob("[!_]*.py")]) for folder in folders}
    assert {folder: count for folder, count in counts.items() if count > 16} == {}


def test_no_class_name_stands_twice_in_the_package():
    files = collections.defaultdict(list)
    for file, tree in TREES.items():
        for node in nodes(tree):
            if isinstance(node, ast.ClassDef):
                files[node.name].append(str(file.relative_to(PACKAGE)))
    assert {name: names for name, names in files.items() if len(names) > 1} == {}


def test_every_third_party_is_a_declared_dependency():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    declared = {
        re.match(r"[\w-]+", entry)[0] for entries in (project["dependencies"], *extras) for entry in entries
    }
    importable = {IMPORTED_AS.get(name, name) for name in declared}
    third_parties = set().union(*imports().values()) - set(PACKAGES)
    assert {COMES_WITH.get(module, module) for module in third_parties} - importable == set()


# ---------------------------------------------------------------- what a controller can see

BLIND_LAW = """
import dataclasses, sys
sys.modules["pinocchio"] = None  # importing it raises from here on
import numpy as np
import coop_pin
from coop_pin.control import (
    ArmMeasurement, ArmReference, ControlledArm, PayloadSpaceController, PayloadSpaceGains, Posture,
    RedundantSlidingModeController, Saturation, Sign, SlidingModeController, SlidingModeGains,
    ZeroedController,
)
from coop_pin.control import Admittance
from coop_pin.control.laws.anchored_integral import AnchoredIntegral
from coop_pin.control.laws.leader_follower import LeaderFollower
from coop_pin.control.laws.payload_space import PayloadSpace
from coop_pin.control.laws.prescribed_performance import PrescribedPerformance
from coop_pin.control.laws.sliding_mode import RedundantSlidingMode, SlidingMode
from coop_pin.base.spatial import make_pose, task_rows
from coop_pin.control.terms import GainAxes

rows = task_rows("planar")
arm = ControlledArm("left", True, rows, 0.0125, 0.5, 3, np.zeros(3), np.zeros(3), np.eye(4), 0)
gains = SlidingModeGains(
    pose_gain=2.0, sign_gain=0.2, damping_gain=(60.0, 60.0, 10.0), force_gain=0.5, transient_rate=5.0
)
law = SlidingModeController(arm, gains.sized(3, 3), Sign())
J = np.array([[-0.4, -0.3, 0.1], [0.5, 0.2, -0.1], [0.0, 1.0, 1.0]])
v = np.array([0.1, -0.2, 0.3])
reference = ArmReference(make_pose((0.5, 0.1, 0.0)), np.zeros(3), np.zeros(3), np.array([-10.0, 0.0, 0.0]))
state = None
for k in range(3):
    pose, f = make_pose((0.6, 0.1, 0.0)), np.array([-9.0, 0.1, 0.0])
    measurement = ArmMeasurement(0.0125 * k, np.zeros(3), v, pose, J @ v, J, f, np.zeros(3, bool))
    state = law.init(measurement, reference) if state is None else state
    torque, state = law.step(measurement, reference, state)
assert np.isfinite(torque).all() and np.abs(torque).max() > 1.0 and np.abs(state.sign_integral).max() > 0.0
stiff = PayloadSpaceGains(
    pose_gain=2.0, sliding_gain=(800.0, 800.0, 40.0), sign_gain=0.25, transient_rate=5.0
)
integral = AnchoredIntegral(stiff.anchor_gain, 0.2)
anchored = PayloadSpaceController(arm, stiff.sized(3, 3), Saturation(), integral, GainAxes(rows))
zeroed = ZeroedController(anchored, rows, make_pose((0.6, 0.1, 0.0)))
first = measurement._replace(time=0.0, internal_wrench_age=0.0, holding_torque=np.array([1.0, 2.0, 3.0]))
state = zeroed.init(first, reference)
for k in range(3):
    torque, state = zeroed.step(first._replace(time=0.0125 * k), reference, state)
assert np.isfinite(torque).all() and np.abs(state.law.integral.value).max() > 0.0
own = dataclasses.replace(anchored, payload_weight=np.ones(3))
for measured in (first._replace(internal_wrench=None, interaction_wrench=f, interaction_wrench_age=0.0),
                 first._replace(internal_wrench=None)):  # by the own wrist, and by nothing
    torque, state = own.step(measured, reference, own.init(measured, reference))
    assert np.isfinite(torque).all()
wide, posture = gains.replace(damping_gain=60.0).sized(3, 4), Posture(np.zeros(4), np.ones(4), np.ones(4))
redundant = RedundantSlidingModeController(arm._replace(drives=4), wide, Sign(), posture)
J4, v4 = np.column_stack((J, J[:, 0] + 0.3)), np.append(v, 0.1)
spare = measurement._replace(q=np.zeros(4), v=v4, payload_twist=J4 @ v4, payload_jacobian=J4,
                             saturated=np.zeros(4, bool))
torque, state = redundant.step(spare, reference, redundant.init(spare, reference))
assert torque.shape == (4,) and np.isfinite(torque).all()
wrist = measurement._replace(interaction_wrench=f, interaction_wrench_age=0.0)
printed = {"pose_gain": 2.0, "sign_gain": 0.2, "damping_gain": 20.0, "transient_rate": 5.0}
space = {"pose_gain": 2.0, "sign_gain": 0.2, "sliding_gain": 500.0, "transient_rate": 5.0}
weight = {"payload_weight": 0.0}  # which else is that of the scenario
for law in (SlidingMode(gains=printed), RedundantSlidingMode(gains=printed), PrescribedPerformance(),
            PayloadSpace(gains=space, payload_mass=1.0, zero_at_grasp=True), LeaderFollower(gains=weight),
            Admittance(gains=weight, zero_at_grasp=True),
            Admittance(gains=weight, command="position", follows="leader")):
    for seen in (wrist, wrist._replace(**spare._asdict() | {"interaction_wrench": f})):
        k = len(seen.q)
        if law.kind == "sliding-mode" and k > 3:
            continue
        # All that they may know.
        arms = [ControlledArm(name, place == 0, rows, 0.0125, 0.5, k, np.zeros(k), np.zeros(3), np.eye(4), 0)
                for place, name in enumerate(("left", "right"))]
        blind = law.build(None, arms)
        torques, _ = blind.step([seen] * 2, [reference] * 2, blind.init([seen] * 2, [reference] * 2))
        for torque in torques:
            assert torque.shape == seen.q.shape and np.isfinite(torque).all()
from coop_pin.control import CellTiming, MeanPose, Message

class Ring:  # all that a law by messages reads of its scenario
    edges_at = staticmethod(lambda time, arms: {(arms[0], arms[1]), (arms[1], arms[0])})
    slowest_of = staticmethod(lambda arms: 0)
    longest_silence_of = staticmethod(lambda arms, clock: 0.0)

class Told:
    network, timing, beyond_bound, clock = Ring, CellTiming(("left", "right"), 3, 0.0125), False, None
    class cell:
        arms = ("left", "right")

def by_messages(law):
    Told.controller = law
    arms = [ControlledArm(name, name == "left", rows, 0.0125, 0.5, 3, np.zeros(3), np.zeros(3), np.eye(4), 0)
            for name in ("left", "right")]
    telling = law.build(Told, arms)
    said = dict(zip(("left", "right"), telling.messages([wrist] * 2, [reference] * 2, None)))
    assert all(len(numbers) > 1 for numbers in said.values())
    heard = [wrist._replace(messages={one: Message(numbers, 0.0) for one, numbers in said.items()})] * 2
    state = telling.init(heard, [reference] * 2)
    torques, state = telling.step(heard, [reference] * 2, state)
    again = telling.messages([wrist] * 2, [reference] * 2, state)
    assert list(map(len, again)) == list(map(len, said.values()))
    assert all(np.isfinite(torque).all() for torque in torques)

wrist = measurement._replace(interaction_wrench=f, interaction_wrench_age=0.0, internal_wrench=None)
BY_MESSAGES = [
    MeanPose(gains=space), MeanPose(gains=space, averaging="consensus"),
    Admittance(gains=weight),
]
for told in ("messages", "consensus", "learned-load"):
    BY_MESSAGES.append(PayloadSpace(gains=space, force_path={"kind": told}))
for law in BY_MESSAGES:
    by_messages(law)
seen = sorted({name.split(".")[1] for name in sys.modules if name.startswith("coop_pin.")})
print(" ".join(seen))
"""


def run_python(code: str) -> str:
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


def test_control_imports_and_steps_where_importing_pinocchio_raises():
    seen = set(run_python(BLIND_LAW).split())
    assert seen <= {"base", "control", "reference"}
    assert "control" in seen


def test_every_module_of_control_is_importable_without_pinocchio():
    modules = sorted(name for name in MODULES if name.startswith("coop_pin.control."))
    load = "import sys, importlib\nsys.modules['pinocchio'] = None\n"
    load += f"for name in {modules}: importlib.import_module(name)\n"
    loaded = run_python(
        load + "print(*sorted(name for name in sys.modules if name.startswith('coop_pin.control.')))"
    ).split()
    assert loaded == modules


class Spy(CellController):
    """Hands everything on and keeps what it saw."""

    def __init__(self, controller):
        self.controller, self.seen = controller, []

    def init(self, measurements, references):
        return self.controller.init(measurements, references)

    def step(self, measurements, references, state):
        self.seen += [*measurements, *references]
        return self.controller.step(measurements, references, state)


@pytest.mark.parametrize("path", ["none", "late"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_controller_sees_arrays_and_floats_and_cannot_write_to_them(name, path):
    scenario = (
        SCENARIOS[name]().replace(events=(), duration=0.1).override({"controller.force_path": {"kind": path}})
    )
    spy = Spy(build_controller(scenario))
    simulate(scenario, spy)
    k_0, joints = scenario.cell.task_rows.size, 3 if name == "planar" else 6
    shapes = {
        "q": (joints,),
        "v": (joints,),
        "payload_pose": (4, 4),
        "payload_twist": (k_0,),
        "payload_jacobian": (k_0, joints),
    }
    assert len(spy.seen) > 4 * round(0.1 * scenario.clock.rate_hz)
    for seen in spy.seen:
        measured = seen._asdict()
        if isinstance(seen, ArmMeasurement):
            for number in ("time", "internal_wrench_age", "interaction_wrench_age"):
                assert type(measured.pop(number)) is float
            assert (measured["internal_wrench"] is None) == (path == "none")
            assert (measured["holding_torque"] is None) == (seen.time > 0.0)
            assert measured["interaction_wrench"] is None
            measured = {field: value for field, value in measured.items() if value is not None}
            for field, shape in shapes.items():
                assert measured[field].shape == shape
        else:
            assert measured.pop("load_share") is None  # without grasp events
        for field, value in measured.items():
            assert type(value) is np.ndarray, field
            assert value.dtype == (np.bool_ if field == "saturated" else np.float64)
            assert not value.flags.writeable, field
            assert value.base is None or not value.base.flags.writeable, field


# ---------------------------------------------------------------- what tests know of the package

MOST_PRIVATE, MOST_PATCHED = 29, 40
"""Most uses of private names of the package, and most replacements of parts of it, in all tests."""

PROTOCOLS = {"_fields", "_replace", "_asdict", "_make", "_repr_html_", "_repr_mimebundle_"}
"""Names with an underscore that Python and Jupyter offer to all."""
SETTERS = {"setattr", "delattr", "setitem", "object"}
"""Functions of pytest's monkeypatch and of unittest.mock that replace."""
SCRIPTS = {"bench", "benchmark", "draw", "live"}
"""What tests call the modules of benchmarks and studies."""
TESTS = SourceTrees(file for file in sorted((REPOSITORY / "tests").rglob("*.py")) if file != Path(__file__))


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__") and name not in {"_", *PROTOCOLS}


@functools.cache
def given_names(tree: ast.AST) -> set[str]:
    """The names of functions, classes, variables and attributes that a file gives."""
    return {
        node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else node.name
        for node in nodes(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        or (isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store))
    }


def replaced_by(call: ast.Call) -> list[ast.expr]:
    """What a call replaces, and the name of the attribute; nothing if it replaces nothing.

    ``monkeypatch.setattr(...)``, the same through ``functools.partial``, and ``mock.patch(...)``.
    """
    for at, function in enumerate((call.func, *call.args[:1])):
        if isinstance(function, ast.Attribute) and (
            function.attr in SETTERS or (function.attr == "patch" and ast.unparse(function) == "mock.patch")
        ):
            return call.args[at : at + 2]
    return []


@functools.cache
def imported(tree: ast.AST, *, ours: bool) -> set[str]:
    """The names that a file imports of the package, or of others."""
    names = set()
    for node in nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            for alias in node.names:
                module = node.module if isinstance(node, ast.ImportFrom) else alias.name
                if (str(module).partition(".")[0] == "coop_pin") == ours:
                    names.add(alias.asname or alias.name.partition(".")[0])
    return names


def private_uses(tree: ast.Module, private: set[str]) -> list[str]:
    """Attributes, imports, overrides and replaced names that only the package gives."""
    of_package = imported(tree, ours=True)
    overriding = [
        node
        for node in nodes(tree)
        if isinstance(node, ast.ClassDef)
        and any(ast.unparse(base).partition(".")[0] in of_package for base in node.bases)
    ]
    overrides = [
        method.name for kind in overriding for method in kind.body if isinstance(method, ast.FunctionDef)
    ]
    found = [name for name in overrides if name in private]
    foreign = private - (given_names(tree) - set(overrides))
    for node in nodes(tree):
        if isinstance(node, ast.Attribute) and node.attr in foreign:
            found.append(node.attr)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("coop_pin"):
            found += [alias.name for alias in node.names if is_private(alias.name)]
        elif isinstance(node, ast.Call):
            texts = [each.value for each in replaced_by(node) if isinstance(each, ast.Constant)]
            found += [str(text) for text in texts if str(text).rpartition(".")[2] in private]
    return found


def patched_parts(tree: ast.Module) -> list[str]:
    """What a file replaces, but for parts of other libraries and of scripts."""
    others, found = imported(tree, ours=False) | SCRIPTS, []
    for node in nodes(tree):
        if isinstance(node, ast.Call) and (replaced := replaced_by(node)):
            if isinstance(replaced[0], ast.Constant):
                is_ours = str(replaced[0].value).startswith("coop_pin")
            else:
                is_ours = re.split(r"[.(\[]", ast.unparse(replaced[0]))[0] not in others
            found += [ast.unparse(replaced[0])] * is_ours
    return found


def by_file(found: dict[Path, list[str]]) -> str:
    """The files with the most, and what they have."""
    lines = sorted(found.items(), key=lambda item: -len(item[1]))
    return "\n".join(f"{len(names)} {file.name}: {', '.join(names)}" for file, names in lines if names)


def test_tests_use_few_private_names_of_the_package_and_replace_few_of_its_parts():
    """Each ties a test to how the package is written. A fixture that several tests share counts once."""
    private = {name for tree in TREES.values() for name in given_names(tree) if is_private(name)}
    texts = {file: file.read_text(encoding="utf-8") for file in TESTS}
    uses = {
        file: private_uses(TESTS[file], private)
        for file, text in texts.items()
        if private & {*re.findall(r"\b_\w+", text)}
    }
    parts = {file: patched_parts(TESTS[file]) for file, text in texts.items() if "patch" in text}
    assert sum(map(len, uses.values())) <= MOST_PRIVATE, by_file(uses)
    assert sum(map(len, parts.values())) <= MOST_PATCHED, by_file(parts)


@pytest.mark.parametrize(
    ("text", "private", "patched"),
    [
        ("from coop_pin.chain import projection\nprojection._STEPS", ["_STEPS"], []),
        ("from coop_pin.chain.projection import _STEPS", ["_STEPS"], []),
        ("class Own:\n    def _STEPS(self): self._STEPS()", [], []),
        ("import coop_pin as cp\nclass Own(cp.Sweep):\n    def _STEPS(self): pass", ["_STEPS"], []),
        ("monkeypatch.setattr('coop_pin.a._STEPS', 1)", ["coop_pin.a._STEPS"], ["'coop_pin.a._STEPS'"]),
        ("patch = partial(monkeypatch.setattr, chain.solver, 'solve')", [], ["chain.solver"]),
        ("import os\nmonkeypatch.setattr(os, 'fsync', None)", [], []),
        ("with mock.patch('coop_pin.a.b'): pass", [], ["'coop_pin.a.b'"]),
    ],
)
def test_private_uses_and_replacements_are_counted(text, private, patched):
    tree = ast.parse(text)
    assert private_uses(tree, {"_STEPS"}) == private
    assert patched_parts(tree) == patched


def test_tests_import_one_another_only_within_their_folder():
    """What tests of several packages share is in modules beside the folders."""
    for file, tree in TESTS.items():
        for node in nodes(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("test_"):
                assert (file.parent / f"{node.module}.py").is_file(), (file.name, node.module)
