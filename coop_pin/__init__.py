"""coop_pin: two or more URDF arms that rigidly hold one object, on Pinocchio.

Everything public is listed here and loaded on first use, so that importing ``coop_pin.control`` never loads
Pinocchio.
"""

from __future__ import annotations

from typing import Any

from coop_pin.lazy import load_public

_PUBLIC = {
    "Arm": "coop_pin.description",
    "ArmController": "coop_pin.control",
    "ArmMeasurement": "coop_pin.control",
    "ArmModel": "coop_pin.model",
    "ArmReference": "coop_pin.control",
    "Cell": "coop_pin.description",
    "CellChain": "coop_pin.chain",
    "CellController": "coop_pin.control",
    "ChainDynamics": "coop_pin.chain",
    "ChainState": "coop_pin.chain",
    "CircleMotion": "coop_pin.reference",
    "Clock": "coop_pin.description",
    "ClosedChain": "coop_pin.chain",
    "Closure": "coop_pin.chain",
    "Command": "coop_pin.control",
    "CoopPinError": "coop_pin.errors",
    "CsvMotion": "coop_pin.reference",
    "Energy": "coop_pin.chain",
    "ExponentialMotion": "coop_pin.reference",
    "ClosureError": "coop_pin.chain",
    "HoldMotion": "coop_pin.reference",
    "JointFriction": "coop_pin.description",
    "LineMotion": "coop_pin.reference",
    "Snapshot": "coop_pin.results",
    "Payload": "coop_pin.description",
    "PayloadChange": "coop_pin.description",
    "PayloadSpace": "coop_pin.description",
    "PayloadSpaceController": "coop_pin.control",
    "PayloadSpaceGains": "coop_pin.description",
    "PlantOptions": "coop_pin.description",
    "Pose": "coop_pin.description",
    "PostureGains": "coop_pin.description",
    "RampSqueeze": "coop_pin.reference",
    "Reachability": "coop_pin.analysis",
    "RedundantSlidingMode": "coop_pin.description",
    "RedundantSlidingModeController": "coop_pin.control",
    "RunResult": "coop_pin.results",
    "Sample": "coop_pin.sweeps",
    "Scenario": "coop_pin.description",
    "Simulation": "coop_pin.simulation",
    "SlidingMode": "coop_pin.description",
    "SlidingModeController": "coop_pin.control",
    "SlidingModeGains": "coop_pin.description",
    "Span": "coop_pin.sweeps",
    "Stabilisation": "coop_pin.description",
    "ConstantSqueeze": "coop_pin.reference",
    "SweepPlan": "coop_pin.sweeps",
    "SweepResult": "coop_pin.sweeps",
    "SwingMotion": "coop_pin.reference",
    "Trajectory": "coop_pin.chain",
    "TurnMotion": "coop_pin.reference",
    "FunctionMotion": "coop_pin.reference",
    "FunctionSqueeze": "coop_pin.reference",
    "Waypoint": "coop_pin.reference",
    "WaypointsMotion": "coop_pin.reference",
    "WrenchPulse": "coop_pin.description",
    "cell_summary": "coop_pin.analysis",
    "solve_ik": "coop_pin.chain",
    "ik_branches": "coop_pin.chain",
    "grasps_from_configuration": "coop_pin.description",
    "linspace": "coop_pin.sweeps",
    "logspace": "coop_pin.sweeps",
    "reachability": "coop_pin.analysis",
    "run": "coop_pin.run_scenario",
    "scenario_names": "coop_pin.description",
    "simulate": "coop_pin.simulation",
    "sweep": "coop_pin.sweeps",
    "tune": "coop_pin.sweeps",
}

__all__ = sorted(_PUBLIC)
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Load a public name on first use."""
    return load_public(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
