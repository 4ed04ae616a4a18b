"""Measures of one run in the comparison, and the cost that the search of gains minimises."""

from __future__ import annotations

import functools
import math

import numpy as np

from coop_pin.base.arrays import Array, rms
from coop_pin.comparison.controllers import reach_of_any_law, t_lambda
from coop_pin.comparison.trials import friction_changes
from coop_pin.description.scenario import Scenario
from coop_pin.results.run_result import RunResult
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import loop_stability

_FROM = 0.4
"""Part of the run after which it is judged."""
MEASURES = {
    "tracking_rms_mm": "tracking error, rms (mm)",
    "turning_rms_mrad": "turning error, rms (mrad)",
    "axial_rms_N": "axial internal force, rms of its error (N)",
    "shear_rms_N": "shear internal force, rms of its error (N)",
    "moment_rms_Nm": "internal moment, rms of its error (N m)",
    "effort_rms_Nm": "effort: drive torques, rms (N m)",
    "chatter_rms_Nm": "chatter: changes of torque, rms (N m)",
}
"""Measures and their texts; with settling_time_s and the verdicts of every run they make the table."""
DROPPED = "dropped"
"""Whether patches lost the payload, beside the measures of a run: 1 or 0."""


def measures(result: RunResult) -> dict[str, float]:
    """Return the measures of a run, from 0.4 of its duration to its end, and whether it dropped the payload.

    Effort is the rms of all drive torques, chatter that of their changes from one record to the next. Events
    in the window count: what a push leaves is measured, too.
    """
    arrays = result.arrays  # to label them takes as long as a run in a batch
    judged = np.asarray(arrays["time"]) >= _FROM * result.scenario.duration - 1e-9
    names = ("pose_error", "torque", *(f"internal_{part}_error" for part in ("axial", "shear", "moment")))
    error, torque, *wrenches = (np.asarray(arrays[name])[judged] for name in names)
    internal = map(_rms, wrenches)
    distance, angle = (_rms(np.linalg.norm(part, axis=1)) for part in (error[:, :3], error[:, 3:]))
    values = (1e3 * distance, 1e3 * angle, *internal, _rms(torque), _rms(np.diff(torque, axis=0)))
    return dict(zip(MEASURES, values, strict=True)) | {DROPPED: float(math.isfinite(result.dropped_at))}


def tuning_cost(result: RunResult) -> dict[str, float]:
    """Return T lambda and damping of a run and its cost: tracking error, mm, and internal force, N, added."""
    values = measures(result)
    cost = values["tracking_rms_mm"] + math.hypot(values["axial_rms_N"], values["shear_rms_N"])
    scenario = result.scenario
    return {"cost": cost, "t_lambda": t_lambda(scenario), "damping": payload_damping(scenario)}


def payload_damping(scenario: Scenario) -> float:
    """Return the smallest damping ratio of the payload's modes with a law, at six poses along the motion.

    Modes of spare joints do not count; the gains that are searched do not hold those. Neither does sgn, which
    has no linear part; a law with a dead zone is judged beyond it. Friction is in neither plant nor model, so
    that a law that takes it out is not taken for one that drives. 1 for cells whose grasps give or that have
    tables, of which ``loop_stability`` knows no modes.
    """
    cell = scenario.cell
    if cell.compliant or cell.patches or cell.tables:
        return 1.0
    ideal = scenario.with_ideal_sensors.replace(events=(), seed=0)
    beyond = ideal.replace(controller=ideal.controller.beyond_dead_zone)
    return _payload_damping(beyond.override(friction_changes(beyond, 0.0)).model_dump_json())


@functools.lru_cache(maxsize=64)
def _payload_damping(text: str) -> float:
    """Return the smallest damping ratio of the payload's modes of a scenario as JSON."""
    scenario = Scenario.model_validate_json(text)
    simulation = Simulation(scenario, build_controller(scenario))
    return loop_stability(simulation, reach_of_any_law(scenario)).least_damped_payload.damping


def _rms(values: Array) -> float:
    """Return the rms of the entries that are numbers; joints that an arm does not have are none."""
    return float(rms(values[np.isfinite(values)]))
