"""The plan of the house: who may import whom, and that controllers cannot see a model."""

import ast
import functools
import graphlib
import importlib
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin
from coop_pin.control import ArmMeasurement, CellController
from coop_pin.controller_factory import build_controller
from coop_pin.simulation import simulate

PACKAGE = Path(coop_pin.__file__).parent
REPOSITORY = Path(__file__).resolve().parents[1]

EVERYWHERE = {"errors", "lazy", "arrays", "spatial"}
BELOW_RUNS = {"description", "model", "chain", "control", "reference", "results", "simulation"}
BELOW_VIEWS = BELOW_RUNS | {"controllers", "runs"}

# DESIGN.md, section 2: room -> (rooms it may import besides EVERYWHERE, third parties besides numpy). Where
# the plan says otherwise:
# - runs and sweeps are the plan's run and sweep (functions have those names); output writes what a run
# leaves, for cli and notebooks;
# - integrators need nothing above chain and stand there, so that simulation needs no Pinocchio;
# - description (URDF origins), results and viz turn quaternions with scipy;
# - Pinocchio's picture of an arm is read in model, so that viz needs none;
# - viz runs: its panel holds a Simulation under the user's hand, and a view that opens before the run asks
# chain how the cell stands;
#   nothing below viz imports it, simulate takes any observer;
# - viz draws sweeps as it draws runs; sweeps never import viz, nor do their workers;
# - analysis walks arms with chain's tip search, which speaks Pinocchio's poses; nothing below it imports it;
# - a sweep's plan is a Description like a scenario, and its progress is shown on terminals;
# - description reads meshes of payloads with trimesh, which yourdfpy brings;
# - controllers asks an ArmModel for the number of joints that gains must fit.
ROOMS: dict[str, tuple[set[str], set[str]]] = {
    "errors": (set(), set()),
    "lazy": (set(), set()),
    "arrays": (set(), set()),
    "spatial": (set(), {"scipy"}),
    "reference": (set(), {"scipy"}),
    "control": ({"reference"}, {"scipy"}),
    "description": (
        {"control", "reference"},
        {"pydantic", "pydantic_core", "scipy", "tomli_w", "trimesh", "xacrodoc", "yourdfpy"},
    ),
    "model": ({"description"}, {"pinocchio"}),
    "chain": ({"description", "model"}, {"pinocchio", "scipy"}),
    "model_based": ({"control", "reference", "model", "chain"}, {"pinocchio", "scipy"}),
    "results": ({"description"}, {"xarray", "h5netcdf", "scipy"}),
    "simulation": ({"description", "model", "chain", "control", "reference", "results"}, set()),
    "controllers": ({"control", "model_based", "description", "model"}, set()),
    "runs": (BELOW_RUNS | {"controllers"}, set()),
    "analysis": (BELOW_VIEWS, {"pinocchio", "scipy", "xarray"}),
    "viz": (
        {"description", "model", "chain", "controllers", "results", "simulation", "sweeps"},
        {
            "imageio",
            "imageio_ffmpeg",
            "ipywidgets",
            "matplotlib",
            "meshcat",
            "playwright",
            "scipy",
            "tornado",
            "umsgpack",
            "viser",
            "xarray",
            "zmq",
        },
    ),
    "sweeps": (
        {"description", "results", "runs"},
        {"dask", "distributed", "optuna", "pydantic", "scipy", "tqdm", "xarray"},
    ),
    "output": ({"description", "results", "viz"}, set()),
    "report": ({"results", "viz", "analysis", "output"}, {"matplotlib"}),
    "cli": (BELOW_VIEWS | {"analysis", "viz", "sweeps", "report", "output"}, {"tyro", "tqdm", "pydantic"}),
    "__main__": ({"cli"}, set()),
}

# Distributions by the names they are imported under.
IMPORTED_AS = {
    "pin": "pinocchio",
    "tomli-w": "tomli_w",
    "example-robot-data": "example_robot_data",
    "h5netcdf": "h5netcdf",
    "imageio-ffmpeg": "imageio_ffmpeg",
}
COMES_WITH = {"pydantic_core": "pydantic", "tornado": "meshcat", "umsgpack": "meshcat", "zmq": "meshcat"}

FILES = sorted(PACKAGE.rglob("*.py"))


def room_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_name(name: str) -> str:
    """What "from coop_pin import name" loads: a room, or the module of a public name; the version stands in the package itself."""
    return f"coop_pin.{name}" if name in ROOMS else coop_pin._PUBLIC.get(name, "coop_pin")


def imported_modules(file: Path, inside_functions: bool = True) -> list[str]:
    """Every module a file imports, at its top or inside a function; a relative import counts as ``.``."""
    found: list[str] = []
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree) if inside_functions else tree.body:
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level:
            found.append(".")
        elif isinstance(node, ast.ImportFrom):
            found += (
                [imported_name(alias.name) for alias in node.names]
                if node.module == "coop_pin"
                else [str(node.module)]
            )
    return found


@functools.cache
def imports() -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """Rooms and third parties that each room imports."""
    rooms, third_parties = defaultdict(set), defaultdict(set)
    for file in FILES:
        for module in imported_modules(file):
            top, *rest = module.split(".")
            if top == "coop_pin":
                rooms[room_of(file)].add(rest[0] if rest else "coop_pin")
            elif top not in sys.stdlib_module_names:
                third_parties[room_of(file)].add(top)
    return {room: rooms[room] for room in {*ROOMS, *rooms}}, {
        room: third_parties[room] for room in {*ROOMS, *rooms}
    }


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_every_file_stands_in_a_room_of_the_plan_and_imports_by_full_name(file):
    assert room_of(file) in ROOMS or file == PACKAGE / "__init__.py"
    assert "." not in imported_modules(file)


def test_only_the_version_is_read_from_the_package_itself():
    for file in FILES:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module == "coop_pin":
                assert {alias.name for alias in node.names} <= {"__version__", *ROOMS, *coop_pin._PUBLIC}


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_the_plan_allows(room):
    rooms, third_parties = imports()
    allowed_rooms, allowed_third_parties = ROOMS[room]
    assert rooms[room] - {room, "coop_pin"} - EVERYWHERE - allowed_rooms == set()
    assert third_parties[room] - {"numpy"} - allowed_third_parties == set()


def test_errors_and_arrays_stand_on_nothing():
    rooms, third_parties = imports()
    assert rooms["errors"] <= {"errors"}
    assert rooms["lazy"] == third_parties["errors"] == third_parties["lazy"] == set()
    assert rooms["arrays"] == {"errors"}
    assert rooms["spatial"] <= {"arrays", "errors", "spatial"}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """The nodes of one circle of a graph, or none."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


def test_there_are_no_cycles_between_rooms_in_fact_or_in_the_plan():
    rooms, _ = imports()
    in_fact = {room: needed - {room, "coop_pin"} for room, needed in rooms.items() if room != "__init__"}
    in_plan = {room: needed - {"coop_pin"} for room, (needed, _) in ROOMS.items()}
    assert circle(in_fact) == circle(in_plan) == []
    assert circle({"control": {"model"}, "model": {"control"}})


def test_there_are_no_cycles_between_files():
    """A cycle inside a room would load by luck of order."""
    names = {
        ".".join(("coop_pin", *f.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): f
        for f in FILES
    }
    graph = {
        name: {
            module
            for module in imported_modules(file, inside_functions=False)
            if module in names and module != name
        }
        for name, file in names.items()
        if file.name != "__init__.py"
    }
    assert circle(graph) == []


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_there_is_no_type_checking_escape(file):
    names = {
        node.id
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Name)
    }
    attributes = {
        node.attr
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
    }
    assert "TYPE_CHECKING" not in names | attributes


def test_every_third_party_is_a_declared_dependency():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = project["dependencies"] + [
        entry for extra in project["optional-dependencies"].values() for entry in extra
    ]
    names = {
        requirement.split("=")[0].split(">")[0].split("<")[0].split("[")[0].strip()
        for requirement in declared
    }
    importable = {IMPORTED_AS.get(name, name) for name in names}
    _, third_parties = imports()
    used = {COMES_WITH.get(module, module) for modules in third_parties.values() for module in modules}
    assert used - importable == set()


# ---------------------------------------------------------------- what a controller can see

BLIND_LAW = """
import sys
sys.modules["pinocchio"] = None  # importing it raises from here on
import numpy as np
import coop_pin
from coop_pin.control import ArmMeasurement, ArmReference, Sign, SlidingModeController
from coop_pin.spatial import make_pose, task_rows

rows = task_rows("planar")
law = SlidingModeController(
    rows=rows, period=0.0125, pose_gain=2.0 * np.eye(3), sign_gain=0.2 * np.eye(3), damping_gain=np.diag([60.0, 60.0, 10.0]),
    force_gain=0.5, transient_rate=5.0, switching=Sign(),
)
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
    assert seen <= {"control", "spatial", "arrays", "errors", "lazy", "reference"}
    assert "control" in seen


def test_every_module_of_control_is_importable_without_pinocchio():
    modules = sorted(
        f"coop_pin.control.{file.stem}"
        for file in (PACKAGE / "control").glob("*.py")
        if file.stem != "__init__"
    )
    load = f"import sys, importlib\nsys.modules['pinocchio'] = None\nfor name in {modules}: importlib.import_module(name)\n"
    loaded = run_python(
        load + "print(*sorted(name for name in sys.modules if name.startswith('coop_pin.control.')))"
    ).split()
    assert loaded == modules


def test_importing_the_package_loads_nothing_until_a_name_is_used():
    code = "import sys, coop_pin; print('numpy' in sys.modules, [m for m in sys.modules if m.startswith('coop_pin.')]); coop_pin.Scenario"
    assert run_python(code + "; print('pinocchio' in sys.modules)").split("\n")[:2] == [
        "False ['coop_pin.lazy']",
        "False",
    ]


def test_every_public_name_exists_and_a_wrong_one_is_an_attribute_error():
    for name in coop_pin.__all__:
        assert getattr(coop_pin, name) is getattr(importlib.import_module(coop_pin._PUBLIC[name]), name)
    assert set(coop_pin.__all__) <= set(dir(coop_pin))
    with pytest.raises(AttributeError, match="no_such_name"):
        coop_pin.no_such_name  # noqa: B018


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
            assert type(measured.pop("time")) is float
            assert (measured["internal_wrench"] is None) == (path == "none")
            if path == "none":
                del measured["internal_wrench"]
            for field, shape in shapes.items():
                assert measured[field].shape == shape
        for field, value in measured.items():
            assert type(value) is np.ndarray, field
            assert value.dtype == (np.bool_ if field == "saturated" else np.float64)
            assert not value.flags.writeable, field
            assert value.base is None or not value.base.flags.writeable, field
