"""The direction of imports between packages, and that controllers cannot reach a model."""

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
BELOW_RUNS = {"schema", "description", "model", "chain", "control", "reference", "results", "simulation"}
BELOW_VIEWS = BELOW_RUNS | {"controller_factory", "run_scenario"}

# Package -> (packages it may import besides EVERYWHERE, third parties besides numpy). Why:
# - schema is the frozen pydantic base of everything that stands in a scenario file;
# - schema (rotations), reference and results turn quaternions with scipy;
# - Pinocchio's geometry is read in model, so that viz needs no Pinocchio;
# - viz runs simulations: its panel owns one, and a view that opens before the run asks chain for the start;
#   nothing below viz imports it, simulate takes any observer;
# - figures draw runs and sweeps; sweeps and their workers never import figures or viz;
# - analysis uses chain's inverse kinematics, which takes Pinocchio's poses; nothing below imports analysis;
# - a sweep's plan is a Description like a scenario, and its progress is shown on terminals;
# - controller_factory asks an ArmModel for the number of joints that gains must fit.
PACKAGES: dict[str, tuple[set[str], set[str]]] = {
    "errors": (set(), set()),
    "lazy": (set(), set()),
    "arrays": (set(), set()),
    "spatial": (set(), {"scipy"}),
    "schema": ({"reference"}, {"pydantic", "pydantic_core"}),
    "reference": (set(), {"scipy"}),
    "control": (set(), {"scipy"}),
    "description": (
        {"schema", "control", "reference"},
        {"pydantic", "scipy", "tomli_w", "trimesh", "xacrodoc"},
    ),
    "model": ({"description"}, {"pinocchio"}),
    "chain": ({"description", "model"}, {"pinocchio", "scipy"}),
    "results": ({"description"}, {"xarray", "scipy"}),
    "simulation": ({"description", "model", "chain", "control", "reference", "results"}, set()),
    "controller_factory": ({"control", "description", "model"}, set()),
    "run_scenario": (BELOW_RUNS | {"controller_factory"}, set()),
    "analysis": (BELOW_VIEWS, {"pinocchio", "scipy"}),
    "figures": ({"description", "results", "sweeps"}, {"matplotlib", "xarray"}),
    "viz": (
        {"schema", "description", "model", "chain", "controller_factory", "results", "simulation", "figures"},
        {
            "imageio",
            "imageio_ffmpeg",
            "ipywidgets",
            "meshcat",
            "playwright",
            "scipy",
            "tornado",
            "umsgpack",
            "xarray",
        },
    ),
    "sweeps": (
        {"schema", "description", "results", "run_scenario"},
        {"dask", "distributed", "optuna", "pydantic", "scipy", "tqdm", "xarray"},
    ),
    "run_folder": ({"results", "figures", "viz"}, set()),
    "report": ({"results", "figures", "viz"}, {"matplotlib"}),
    "cli": (
        BELOW_VIEWS | {"analysis", "figures", "viz", "sweeps", "report", "run_folder"},
        {"tyro", "tqdm", "pydantic"},
    ),
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


def package_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_name(name: str) -> str:
    """Module that "from coop_pin import name" loads."""
    return f"coop_pin.{name}" if name in PACKAGES else coop_pin._PUBLIC.get(name, "coop_pin")


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
    """Rooms and third parties that each package imports."""
    packages, third_parties = defaultdict(set), defaultdict(set)
    for file in FILES:
        for module in imported_modules(file):
            top, *rest = module.split(".")
            if top == "coop_pin":
                packages[package_of(file)].add(rest[0] if rest else "coop_pin")
            elif top not in sys.stdlib_module_names:
                third_parties[package_of(file)].add(top)
    return {package: packages[package] for package in {*PACKAGES, *packages}}, {
        package: third_parties[package] for package in {*PACKAGES, *packages}
    }


def test_every_file_is_in_a_package_of_the_table_and_imports_by_full_name():
    unlisted = [
        file for file in FILES if package_of(file) not in PACKAGES and file != PACKAGE / "__init__.py"
    ]
    relative = [file for file in FILES if "." in imported_modules(file)]
    assert (unlisted, relative) == ([], [])


def test_only_the_version_is_read_from_the_package_itself():
    for file in FILES:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module == "coop_pin":
                assert {alias.name for alias in node.names} <= {"__version__", *PACKAGES, *coop_pin._PUBLIC}


def test_a_package_imports_exactly_what_the_table_allows():
    """No more, and no dead entries: what the table allows is used."""
    packages, third_parties = imports()
    beyond, unused = {}, {}
    for package, (allowed_packages, allowed_third_parties) in PACKAGES.items():
        used = (packages[package] - {package, "coop_pin"} - EVERYWHERE) | (third_parties[package] - {"numpy"})
        beyond[package] = used - allowed_packages - allowed_third_parties
        unused[package] = (allowed_packages | allowed_third_parties) - used - set(PACKAGES)
        unused[package] |= {name for name in allowed_packages if name not in PACKAGES}
    assert {package: names for package, names in beyond.items() if names} == {}
    assert {package: names for package, names in unused.items() if names} == {}


def test_errors_and_arrays_stand_on_nothing():
    packages, third_parties = imports()
    assert packages["errors"] <= {"errors"}
    assert packages["lazy"] == third_parties["errors"] == third_parties["lazy"] == set()
    assert packages["arrays"] == {"errors"}
    assert packages["spatial"] <= {"arrays", "errors", "spatial"}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """The nodes of one circle of a graph, or none."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


def test_there_are_no_cycles_between_packages_in_fact_or_in_the_plan():
    packages, _ = imports()
    in_fact = {
        package: needed - {package, "coop_pin"}
        for package, needed in packages.items()
        if package != "__init__"
    }
    in_plan = {package: needed - {"coop_pin"} for package, (needed, _) in PACKAGES.items()}
    assert circle(in_fact) == circle(in_plan) == []
    assert circle({"control": {"model"}, "model": {"control"}})


def modules_of(file: Path, names: dict[str, Path]) -> set[str]:
    """Modules of coop_pin that a file imports, inside functions too; names of a package count as their module."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = importlib.import_module(node.module) if node.module in names else None
            for alias in node.names:
                if f"{node.module}.{alias.name}" in names:
                    found.add(f"{node.module}.{alias.name}")
                elif package is not None:
                    found.add(getattr(getattr(package, alias.name), "__module__", node.module))
    return found & set(names)


def test_there_are_no_cycles_between_files():
    names = {
        ".".join(("coop_pin", *f.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): f
        for f in FILES
    }
    graph = {
        name: modules_of(file, names) - {name}
        for name, file in names.items()
        if file.name not in ("__init__.py", "__main__.py")
    }
    assert circle(graph) == []


def test_there_is_no_type_checking_escape():
    assert [file for file in FILES if "TYPE_CHECKING" in file.read_text(encoding="utf-8")] == []


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
    rows=rows, period=0.0125, pose_gain=2.0 * np.eye(3), sign_gain=0.2 * np.eye(3),
    damping_gain=np.diag([60.0, 60.0, 10.0]),
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
    load = "import sys, importlib\nsys.modules['pinocchio'] = None\n"
    load += f"for name in {modules}: importlib.import_module(name)\n"
    loaded = run_python(
        load + "print(*sorted(name for name in sys.modules if name.startswith('coop_pin.control.')))"
    ).split()
    assert loaded == modules


def test_importing_the_package_loads_nothing_until_a_name_is_used():
    code = "import sys, coop_pin; ours = [m for m in sys.modules if m.startswith('coop_pin.')]\n"
    code += "print('numpy' in sys.modules, ours); coop_pin.Scenario"
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
