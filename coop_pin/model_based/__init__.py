"""Controllers that use a model of arms and payload, exact or off by stated factors."""

from coop_pin import lazy_names
from coop_pin.model_based.adaptive import AdaptiveController
from coop_pin.model_based.arm_dynamics import ArmDynamics, ArmTerms
from coop_pin.model_based.computed_torque import ComputedTorqueController
from coop_pin.model_based.object_impedance import ObjectImpedanceController
from coop_pin.model_based.torque_qp import TorqueQpController

__all__ = [
    "AdaptiveController",
    "ArmDynamics",
    "ArmTerms",
    "ComputedTorqueController",
    "ObjectImpedanceController",
    "TorqueQpController",
]
__getattr__, __dir__ = lazy_names(__name__)
