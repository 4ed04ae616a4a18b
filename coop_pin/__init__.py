"""coop_pin: two or more URDF arms that hold one object, on Pinocchio.

``import coop_pin as cp`` gives what most scripts need, and namespaces that are named after what they hold:
``cp.motions.LineMotion``, ``cp.events.WrenchPulse``, ``cp.stability.eigenvalues``. Each public name stands in
one place and is loaded on first use, so that ``import coop_pin`` is fast and ``coop_pin.control`` can be used
where Pinocchio is missing. A name that is not there is answered with where it is.

The tables below are the public interface. Namespaces that are packages list their names themselves.
"""

from __future__ import annotations

import functools
import importlib
import sys
from collections.abc import Callable, Mapping
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, NamedTuple

_PUBLIC = {
    "Actuators": "description.actuators",
    "Arm": "description.cell.arm",
    "ArmCommand": "control.controller",
    "ArmController": "control.controller",
    "ArmMeasurement": "control.measurement",
    "ArmReference": "control.measurement",
    "Cell": "description.cell.cell",
    "CellCommand": "control.controller",
    "CellController": "control.controller",
    "Clock": "description.plant",
    "ClosedChain": "chain.closed_chain",
    "Closure": "description.cell.closure",
    "CompliantGrasp": "description.cell.grasp",
    "CoopPinError": "base.errors",
    "Execution": "sweeps.workers.execution",
    "MobileBase": "description.cell.mobile_base",
    "Pad": "description.cell.contact",
    "PatchGrasp": "description.cell.contact",
    "Payload": "description.cell.payload",
    "Pose": "base.schema.pose",
    "RunResult": "results.run_result",
    "Scenario": "description.scenario",
    "Sensors": "description.sensors",
    "Simulation": "simulation.simulation",
    "SweepPlan": "sweeps.plan",
    "SweepResult": "sweeps.result",
    "Table": "description.cell.contact",
    "UserController": "description.controller",
    "blame": "identification.blame",
    "check": "running.check",
    "compare": "comparison.benchmark",
    "new_cell": "design.new_cell",
    "open_view": "viz.live.live_view",
    "run": "running.run_scenario",
    "scenario_names": "description.catalogue",
    "simulate": "simulation.simulate",
    "solve_ik": "model.inverse_kinematics",
    "suggest": "design.suggestion",
    "sweep": "sweeps.engine",
    "tune": "sweeps.optimisation",
}
"""Names of ``cp`` itself, and the file of each."""

_NAMESPACES: dict[str, tuple[str, dict[str, str]]] = {
    "actuators": (
        "What the drives of an arm do beside the commands: parts of ``cp.Actuators`` and ``cp.Arm``.",
        {
            "description.actuators": "GravityCompensation",
            "description.cell.armature": "Rotors",
            "description.cell.differential_base": "DifferentialBase PlaceOnPayload Steering",
            "description.cell.end_stops": "EndStops",
            "description.cell.joint_friction": "JointFriction",
            "description.cell.shared_joint": "SharedJoint Stroke",
            "description.servo": "SERVOS Servo",
        },
    ),
    "carry": (
        "Carries planned along a line in least time, within the limits of drives, joints and grasps.",
        {
            "design.carry_plan": "CarryPlan plan_carry",
            "design.path_parameterization": "PathLimits fastest",
        },
    ),
    "errors": ("Exceptions and warnings; all exceptions are a ``cp.CoopPinError``.", {"base.errors": ""}),
    "events": (
        "Events of a scenario: changes of the payload, pushes, failures, and grasps that open and close.",
        {
            "description.arm_events": "LoseArm UserEvent",
            "description.events": "GravityTurn Partner PayloadChange WrenchPulse",
            "description.grasp_events": "HandOver PutDown Regrasp Release",
        },
    ),
    "export": ("The law of one arm as C99.", {"compiled.laws.c_export": "CLaw export_c"}),
    "findings": (
        "What ``cp.check`` knows of a scenario: findings with severity and remedy; distances of a run.",
        {
            "results.finding": "Finding Findings",
            "running.recorded_distances": "recorded_distances with_distances",
        },
    ),
    "gym": (
        "Environments of Gymnasium (extra ``gym``): a cell for agents, alone or as lanes of compiled code.",
        {
            "environment.cell_env": "CellEnv",
            "environment.task": "Task",
            "environment.vector_cell_env": "VectorCellEnv",
        },
    ),
    "laws": (
        "Control laws, their gains and controllers, switching functions, force paths, and bounds on gains.",
        {
            "control": "",
            "description.model_laws": "Adaptive AdaptiveGains ComputedTorque ComputedTorqueGains"
            " ModelFactors ObjectImpedance ObjectImpedanceGains TorqueQp",
            "simulation.build_controller": "build_controller",
        },
    ),
    "motions": (
        "Desired motions of the payload as functions of time.",
        {
            "reference.csv_motion": "CsvMotion",
            "reference.joint_motion": "JointMotion",
            "reference.lines": "LineMotion TimedLineMotion",
            "reference.motions": "CircleMotion ExponentialMotion HoldMotion SwingMotion TurnMotion",
            "reference.pose_reference": "ConsistencyGaps FunctionMotion PoseReference PoseTarget"
            " check_consistency",
            "reference.splines": "Waypoint WaypointsMotion",
        },
    ),
    "network": (
        "Messages between the arms: channels, clocks and graphs.",
        {
            "control.measurement": "SentIf",
            "description.network": "ArmClock Channel EdgeChannel GraphChange Network",
        },
    ),
    "numbers": (
        "Functions for laws that are compiled: they take numbers and what stands for them in traced code.",
        {"base.spatial.generic_numbers": "Traceable atan2 exp inverse sqrt where"},
    ),
    "plant": (
        "Options of the simulated plant: integration, payload, and stabilisation of the closures.",
        {"description.plant": "PlantOptions Stabilisation"},
    ),
    "sensors": (
        "Errors of what an arm measures: parts of ``cp.Sensors``, and of the arm's own kinematics.",
        {
            "description.cell.miscalibration": "Miscalibration",
            "description.sensors": "DifferencedVelocity Encoder IdealVelocity ObservedVelocity"
            " SharedJointSensor SlipSensor WrenchParts WristSensor",
        },
    ),
    "spatial": (
        "Poses, twists, wrenches, task rows, and definitions of the internal wrench.",
        {
            "base.spatial": "",
            "base.spatial.internal_wrench": "constraint_consistent_internal_wrenches determinate_grasp"
            " linkage_loads minimum_norm_internal_wrenches nonsqueezing_internal_wrenches"
            " symmetric_internal_wrenches virtual_linkage virtual_linkage_internal_wrenches",
        },
    ),
    "squeezes": (
        "Desired internal wrenches of the arms as functions of time.",
        {
            "reference.squeeze": "ConstantSqueeze FunctionSqueeze RampSqueeze SqueezeReference"
            " TipForceSqueeze TipWrenchSqueeze"
        },
    ),
    "urdf": ("Search and validation of URDF files.", {"description.urdf": ""}),
}
"""Namespaces that are no packages: text, and names by file; "" for all that the file or package lists."""

_PACKAGES = (
    *("chain", "comparison", "compiled", "design", "feasibility", "figures", "grasps", "identification"),
    *("logs", "model", "model_based", "proof", "results", "stability", "sweeps", "viz", "zoo"),
)
"""Packages that are namespaces."""
_MOVED = {
    "analysis": "cp.feasibility, cp.stability, cp.design, cp.carry and cp.proof",
    "batch": "cp.compiled and cp.export",
    "catalogue": "cp",
    "control": "cp and cp.laws",
    "description": "cp, cp.events, cp.sensors, cp.actuators, cp.network, cp.plant and cp.urdf",
    "engine_choice": "cp.compiled",
    "environment": "cp.gym",
    "reference": "cp.motions and cp.squeezes",
    "run_scenario": "cp and cp.laws",
    "schema": "coop_pin.base.schema",
    "simulation": "cp",
}
"""Old namespaces and packages, and where their public names are."""


class _Absence(NamedTuple):
    """Message of what a module does not have, with where it is; made when it is read, as few are."""

    package: str
    name: str

    def __str__(self) -> str:
        return f"module {self.package!r} has no attribute {self.name!r}{_hint(*self)}"


def lazy_names(
    package: str, public: Mapping[str, str]
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__all__``, ``__getattr__`` and ``__dir__`` of a namespace whose names are loaded on first use.

    Args:
        package: full name of the namespace.
        public: public names, and the file of each under coop_pin.
    """
    spaces = {*_NAMESPACES, *_PACKAGES} if package == __name__ else set[str]()

    def load(name: str) -> Any:
        if name in public:
            value = getattr(importlib.import_module(f"{__name__}.{public[name]}"), name)
        elif name in spaces:
            value = importlib.import_module(f"{__name__}.{name}")
        else:
            raise AttributeError(_Absence(package, name))
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        special = (name for name in vars(sys.modules[package]) if name.startswith("__"))
        return sorted({*public, *spaces, *special})

    return sorted(public), load, names


def _listed(file: str) -> list[str]:
    """Return the names that a package lists, or the classes of a file, without loading it."""
    import ast
    from pathlib import Path

    path = Path(__file__).parent.joinpath(*file.split("."))
    tree = ast.parse((path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text("utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and "__all__" in ast.unparse(node.targets[0]):
            names = node.value.args[1] if isinstance(node.value, ast.Call) else node.value
            return [*ast.literal_eval(names)]
    return [node.name for node in tree.body if isinstance(node, ast.ClassDef) and node.name[0] != "_"]


@functools.cache
def _names_of(namespace: str) -> dict[str, str]:
    """Return the names of a namespace, and the file that each is taken of."""
    files = _NAMESPACES[namespace][1] if namespace in _NAMESPACES else {namespace: ""}
    listed = {file: names.split() or _listed(file) for file, names in files.items()}
    return {name: file for file, names in listed.items() for name in names if name not in _PUBLIC}


def _hint(package: str, name: str) -> str:
    """Return where a name is that a package does not have, or which names are near it; "" for neither."""
    import difflib

    if package == __name__ and name in _MOVED:
        return f"; its public names are in {_MOVED[name]}"
    spaces = sorted({*_NAMESPACES, *_PACKAGES})
    places = {one: f"cp.{space}.{one}" for space in spaces for one in _names_of(space)}
    places |= {one: f"cp.{one}" for one in (*_PUBLIC, *spaces)}
    here = package.replace(__name__, "cp", 1)
    if name in places:
        return "" if places[name] == f"{here}.{name}" else f"; it is {places[name]}"
    known = [one for one in places if here == "cp" or places[one] == f"{here}.{one}"]
    longer = sorted((one for one in known if name.lower() in one.lower() and name[2:]), key=len)
    near = [places[one] for one in longer[:3] or difflib.get_close_matches(name, known)]
    return f"; did you mean {' or '.join(near)}?" if near and name[0] != "_" else ""


class _Namespaces:
    """Finder and loader of the namespaces that are no packages; it answers imports of what is not there."""

    @staticmethod
    def find_spec(name: str, *_search: object) -> ModuleSpec | None:
        package, _, last = name.rpartition(".")
        if package == __name__ and last in _NAMESPACES:
            loader: Any = _Namespaces
            return ModuleSpec(name, loader, origin=__name__, is_package=True)
        if package.partition(".")[0] == __name__ and (hint := _hint(package, last)):
            raise ModuleNotFoundError(f"no {last!r} in {package!r}{hint}")
        return None

    @staticmethod
    def create_module(spec: ModuleSpec) -> None:
        """Leave it to Python to make an empty module."""

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        name = module.__name__.rpartition(".")[2]
        listed, load, names = lazy_names(module.__name__, _names_of(name))
        text = _NAMESPACES[name][0]
        vars(module).update(__doc__=text, __all__=listed, __getattr__=load, __dir__=names)


__version__ = "0.2.0"
__all__, __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
sys.meta_path.append(_Namespaces)
