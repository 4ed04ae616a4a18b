"""coop_pin: two or more URDF arms that hold one object, on Pinocchio.

What a user calls or writes is listed here and loaded on first use, so that ``import coop_pin`` is fast and
``coop_pin.control`` can be used where Pinocchio is missing. The packages are attributes as well:
``import coop_pin as cp`` gives ``cp.viz``, ``cp.analysis`` and so on; types that are only returned stay in
their packages (``cp.chain.Trajectory``).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

_PUBLIC = {
    "Admittance": "coop_pin.control",
    "AdmittanceGains": "coop_pin.control",
    "Actuators": "coop_pin.description",
    "Arm": "coop_pin.description",
    "ArmClock": "coop_pin.description",
    "ArmCommand": "coop_pin.control",
    "ArmController": "coop_pin.control",
    "ArmMeasurement": "coop_pin.control",
    "ArmModel": "coop_pin.model",
    "ArmReference": "coop_pin.control",
    "CarryPlan": "coop_pin.design",
    "Cell": "coop_pin.description",
    "CellArm": "coop_pin.model",
    "CellChain": "coop_pin.grasps",
    "CellCommand": "coop_pin.control",
    "CellController": "coop_pin.control",
    "CircleMotion": "coop_pin.reference",
    "Clock": "coop_pin.description",
    "ClosedChain": "coop_pin.chain",
    "Closure": "coop_pin.description",
    "CompliantGrasp": "coop_pin.description",
    "Pad": "coop_pin.description",
    "PatchGrasp": "coop_pin.description",
    "Table": "coop_pin.description",
    "ConsensusForcePath": "coop_pin.control",
    "ConstantSqueeze": "coop_pin.reference",
    "CoopPinError": "coop_pin.base.errors",
    "CsvMotion": "coop_pin.reference",
    "DifferencedVelocity": "coop_pin.description",
    "EdgeChannel": "coop_pin.description",
    "Encoder": "coop_pin.description",
    "Execution": "coop_pin.sweeps",
    "ExponentialMotion": "coop_pin.reference",
    "FeedForward": "coop_pin.control",
    "FunctionMotion": "coop_pin.reference",
    "FunctionSqueeze": "coop_pin.reference",
    "GraphChange": "coop_pin.description",
    "GravityCompensation": "coop_pin.description",
    "GravityTurn": "coop_pin.description",
    "HandOver": "coop_pin.description",
    "PutDown": "coop_pin.description",
    "Regrasp": "coop_pin.description",
    "Release": "coop_pin.description",
    "HoldMotion": "coop_pin.reference",
    "IdealVelocity": "coop_pin.description",
    "JointFriction": "coop_pin.description",
    "LoseArm": "coop_pin.description",
    "LateForcePath": "coop_pin.control",
    "LearnedForcePath": "coop_pin.control",
    "LineMotion": "coop_pin.reference",
    "LowPassForcePath": "coop_pin.control",
    "MeanPose": "coop_pin.control",
    "Message": "coop_pin.control",
    "MessageForcePath": "coop_pin.control",
    "Miscalibration": "coop_pin.description",
    "MobileBase": "coop_pin.description",
    "Network": "coop_pin.description",
    "NoForcePath": "coop_pin.control",
    "ObservedVelocity": "coop_pin.description",
    "Partner": "coop_pin.description",
    "Payload": "coop_pin.description",
    "PayloadChange": "coop_pin.description",
    "PayloadSpace": "coop_pin.control",
    "PayloadSpaceGains": "coop_pin.control",
    "PlantOptions": "coop_pin.description",
    "Pose": "coop_pin.description",
    "PostureGains": "coop_pin.control",
    "RampSqueeze": "coop_pin.reference",
    "RedundantSlidingMode": "coop_pin.control",
    "RunResult": "coop_pin.results",
    "Sample": "coop_pin.sweeps",
    "Saturation": "coop_pin.control",
    "Scenario": "coop_pin.description",
    "Sensors": "coop_pin.description",
    "SlipSensor": "coop_pin.description",
    "Servo": "coop_pin.description",
    "Sign": "coop_pin.control",
    "Simulation": "coop_pin.simulation",
    "SlidingMode": "coop_pin.control",
    "SlidingModeGains": "coop_pin.control",
    "Snapshot": "coop_pin.results",
    "Span": "coop_pin.sweeps",
    "Stabilisation": "coop_pin.description",
    "SweepPlan": "coop_pin.sweeps",
    "SweepResult": "coop_pin.sweeps",
    "SwingMotion": "coop_pin.reference",
    "Tanh": "coop_pin.control",
    "TimedLineMotion": "coop_pin.reference",
    "TipForceSqueeze": "coop_pin.reference",
    "TipWrenchSqueeze": "coop_pin.reference",
    "TrustThresholds": "coop_pin.description",
    "TurnMotion": "coop_pin.reference",
    "UserController": "coop_pin.description",
    "UserEvent": "coop_pin.description",
    "Waypoint": "coop_pin.reference",
    "WaypointsMotion": "coop_pin.reference",
    "WrenchParts": "coop_pin.description",
    "WrenchPulse": "coop_pin.description",
    "WristSensor": "coop_pin.description",
    "cell_summary": "coop_pin.feasibility",
    "compare": "coop_pin.comparison",
    "eigenvalues": "coop_pin.stability",
    "export_c": "coop_pin.compiled",
    "fewest_steps": "coop_pin.stability",
    "grasps_from_configuration": "coop_pin.description",
    "ik_branches": "coop_pin.model",
    "linspace": "coop_pin.sweeps",
    "logspace": "coop_pin.sweeps",
    "new_cell": "coop_pin.design",
    "open_view": "coop_pin.viz",
    "plan_carry": "coop_pin.design",
    "reachability": "coop_pin.feasibility",
    "root_locus": "coop_pin.stability",
    "run": "coop_pin.running",
    "sampled_stability": "coop_pin.stability",
    "scenario_names": "coop_pin.description",
    "simulate": "coop_pin.simulation",
    "simulate_batch": "coop_pin.compiled",
    "solve_ik": "coop_pin.model",
    "static_torques": "coop_pin.feasibility",
    "suggest": "coop_pin.design",
    "sweep": "coop_pin.sweeps",
    "tune": "coop_pin.sweeps",
}
_PACKAGES = {
    "base": "coop_pin.base",
    "chain": "coop_pin.chain",
    "comparison": "coop_pin.comparison",
    "compiled": "coop_pin.compiled",
    "control": "coop_pin.control",
    "description": "coop_pin.description",
    "design": "coop_pin.design",
    "environment": "coop_pin.environment",
    "feasibility": "coop_pin.feasibility",
    "figures": "coop_pin.figures",
    "grasps": "coop_pin.grasps",
    "model": "coop_pin.model",
    "model_based": "coop_pin.model_based",
    "proof": "coop_pin.proof",
    "reference": "coop_pin.reference",
    "results": "coop_pin.results",
    "running": "coop_pin.running",
    "simulation": "coop_pin.simulation",
    "stability": "coop_pin.stability",
    "sweeps": "coop_pin.sweeps",
    "tracing": "coop_pin.tracing",
    "viz": "coop_pin.viz",
    "errors": "coop_pin.base.errors",
    "schema": "coop_pin.base.schema",
    "spatial": "coop_pin.base.spatial",
}


def lazy_names(
    package: str, public: Mapping[str, str], packages: Mapping[str, str] = MappingProxyType({})
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package whose public names are loaded on first use.

    Args:
        package: full name of the package.
        public: public names and the module that defines each.
        packages: attributes that are modules, and the full name of each, loaded on first use.
    """

    def load(name: str) -> Any:
        if name in public:
            value = getattr(importlib.import_module(public[name]), name)
        elif name in packages:
            value = importlib.import_module(packages[name])
        else:
            hint = importlib.import_module(f"{__name__}.base.errors").suggestion(name, [*public, *packages])
            raise AttributeError(f"module {package!r} has no attribute {name!r}; {hint}")
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        special = (name for name in vars(sys.modules[package]) if name.startswith("__"))
        return sorted({*public, *packages, *special})

    return load, names


__all__ = sorted(_PUBLIC)
__version__ = "0.2.0"
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC, _PACKAGES)
