"""Control: laws that have measurements of the arms and no model of the robot.

A controller is a pure function of a measurement, a reference and a state; it returns a command and the next
state. The simulation, batches and exported C code run the same function. Open first:

- ``measurement.py``: what a law has: measurement, reference, messages, numbers of arm and cell;
- ``controller.py``: commands, and the controllers of one arm and of all arms;
- ``laws/sliding_mode.py``: a law, equation first; ``law.py`` is the base of laws as a scenario states them.

``force_paths`` are the ways of a measured internal wrench, ``law_wrapper.py`` is a law around a law
(calibration, consensus), ``bounds.py`` has the gains at which sampled feedback is unstable.
``hidden_state.py`` and ``law_memory.py`` are about what a user's law keeps besides its state. The package
imports ``base`` alone, neither Pinocchio nor a model.
"""

from coop_pin.control.bounds import CellTiming, anchor_gain_bound, force_gain_bound
from coop_pin.control.consensus import consensus_bound
from coop_pin.control.controller import (
    ArmCommand,
    ArmController,
    CellCommand,
    CellController,
    DecentralisedController,
)
from coop_pin.control.force_paths.averaged_wrench import (
    AveragedWrench,
    ConsensusForcePath,
    averaged_loop_radius,
    estimator_radius,
)
from coop_pin.control.force_paths.exchanged_wrench import ExchangedWrench, MessageForcePath
from coop_pin.control.force_paths.force_path import LateForcePath, LowPassForcePath, NoForcePath
from coop_pin.control.force_paths.learned_load import LearnedForcePath, LearnedLoad
from coop_pin.control.law import DecentralisedLaw, Law
from coop_pin.control.law_wrapper import ZeroedController
from coop_pin.control.laws.admittance import (
    Admittance,
    AdmittanceController,
    AdmittanceGains,
    FollowingController,
)
from coop_pin.control.laws.bounded_anchor import AnchorState, BoundedAnchor
from coop_pin.control.laws.feed_forward import FeedForward, FeedForwardController
from coop_pin.control.laws.leader_follower import (
    LeaderFollower,
    LeaderFollowerController,
    LeaderFollowerGains,
)
from coop_pin.control.laws.mean_pose import (
    AgreedIntegral,
    ConsensusPose,
    MeanPose,
    MeanPoseByMessages,
    MeanPoseController,
)
from coop_pin.control.laws.payload_space import PayloadSpace
from coop_pin.control.laws.payload_space_controller import (
    PayloadSpaceController,
    PayloadSpaceGains,
    PayloadSpaceState,
)
from coop_pin.control.laws.prescribed_performance import (
    PrescribedPerformance,
    PrescribedPerformanceController,
    PrescribedPerformanceGains,
)
from coop_pin.control.laws.sliding_mode import (
    RedundantSlidingMode,
    RedundantSlidingModeController,
    SlidingMode,
    SlidingModeController,
    SlidingModeGains,
    SlidingModeState,
)
from coop_pin.control.laws.sliding_surface import Saturation, Sign, Switching, Tanh
from coop_pin.control.laws.symmetric import Symmetric, SymmetricController
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm, Message
from coop_pin.control.terms import Posture, PostureGains

__all__ = [
    "Admittance",
    "AdmittanceController",
    "AdmittanceGains",
    "AgreedIntegral",
    "AnchorState",
    "ArmCommand",
    "ArmController",
    "ArmMeasurement",
    "ArmReference",
    "AveragedWrench",
    "BoundedAnchor",
    "CellCommand",
    "CellController",
    "CellTiming",
    "ConsensusForcePath",
    "ConsensusPose",
    "ControlledArm",
    "DecentralisedController",
    "DecentralisedLaw",
    "ExchangedWrench",
    "FeedForward",
    "FeedForwardController",
    "FollowingController",
    "LateForcePath",
    "Law",
    "LeaderFollower",
    "LeaderFollowerController",
    "LeaderFollowerGains",
    "LearnedForcePath",
    "LearnedLoad",
    "LowPassForcePath",
    "MeanPose",
    "MeanPoseByMessages",
    "MeanPoseController",
    "Message",
    "MessageForcePath",
    "NoForcePath",
    "PayloadSpace",
    "PayloadSpaceController",
    "PayloadSpaceGains",
    "PayloadSpaceState",
    "Posture",
    "PostureGains",
    "PrescribedPerformance",
    "PrescribedPerformanceController",
    "PrescribedPerformanceGains",
    "RedundantSlidingMode",
    "RedundantSlidingModeController",
    "Saturation",
    "Sign",
    "SlidingMode",
    "SlidingModeController",
    "SlidingModeGains",
    "SlidingModeState",
    "Switching",
    "Symmetric",
    "SymmetricController",
    "Tanh",
    "ZeroedController",
    "anchor_gain_bound",
    "averaged_loop_radius",
    "consensus_bound",
    "estimator_radius",
    "force_gain_bound",
]
