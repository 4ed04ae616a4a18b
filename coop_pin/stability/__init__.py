"""Stability: whether a law holds at its control rate: sampled loops, eigenvalues, steps, errors at rest.

Open first: ``sampled_stability`` (T lambda of the damping under zero-order hold), ``closed_loop``
(eigenvalues of the loop with plant, sensors and drives, root locus), ``steady_errors`` (under a bias),
``forecast`` (errors while moving and at rest, by ``motion_loop``), ``regrasp`` (gap when a tip comes back).

- ``loop_stability`` (all gains along the motion), ``grasp_stability`` (grasps that give),
  ``admittance_stability`` (servos); ``sampled_motion`` is the loop that they share.
- ``tick_map``, ``modes``: parts of them.
- Integration: ``step_size`` (fewest steps by measured error), ``step_stability`` (friction, springs, stops).

Imports ``base``, ``chain``, ``control``, ``description``, ``feasibility``, ``grasps``, ``model`` and
``simulation``.
"""

import coop_pin.model  # noqa: F401  first: raises a helpful error if Pinocchio is missing
from coop_pin import lazy_names
from coop_pin.stability.admittance_stability import AdmittanceStability, admittance_stability
from coop_pin.stability.closed_loop import ClosedLoop, RootLocus, eigenvalues, root_locus
from coop_pin.stability.forecast import Errors, Forecast, forecast
from coop_pin.stability.grasp_stability import GraspStability, grasp_stability
from coop_pin.stability.loop_stability import LoopStability, loop_stability
from coop_pin.stability.modes import Mode
from coop_pin.stability.regrasp import RegraspGap, regrasp_gaps
from coop_pin.stability.sampled_motion import SampledMotion, sampled_motion
from coop_pin.stability.sampled_stability import (
    SampledStability,
    motion_stability,
    sampled_stability,
    start_stability,
)
from coop_pin.stability.steady_errors import SteadyErrors, anchor_biases, steady_errors
from coop_pin.stability.step_size import StepSize, fewest_steps
from coop_pin.stability.step_stability import StepStability, step_stability

__all__ = [
    "AdmittanceStability",
    "ClosedLoop",
    "Errors",
    "Forecast",
    "GraspStability",
    "LoopStability",
    "Mode",
    "RegraspGap",
    "RootLocus",
    "SampledMotion",
    "SampledStability",
    "SteadyErrors",
    "StepSize",
    "StepStability",
    "admittance_stability",
    "anchor_biases",
    "eigenvalues",
    "fewest_steps",
    "forecast",
    "grasp_stability",
    "loop_stability",
    "motion_stability",
    "regrasp_gaps",
    "root_locus",
    "sampled_motion",
    "sampled_stability",
    "start_stability",
    "steady_errors",
    "step_stability",
]
_, __getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(__all__, ""))
