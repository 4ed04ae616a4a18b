"""Model-based laws: controllers with a model of arms and payload, exact or off by stated factors.

Open first: ``computed_torque`` (inverse dynamics with an integral of the internal force), ``arm_dynamics``
(the model that a controller has), ``torque_qp`` (torque limits and friction cones as a quadratic program).

``adaptive`` learns the model's parameters, ``object_impedance`` gives the payload a stated impedance. What a
scenario writes of them is in ``description/model_laws``; laws that need no model are in ``control``.

Imports ``base``, ``control``, ``description`` and ``model``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "AdaptiveController": "model_based.adaptive",
        "ArmDynamics": "model_based.arm_dynamics",
        "ArmTerms": "model_based.arm_dynamics",
        "ComputedTorqueController": "model_based.computed_torque",
        "ObjectImpedanceController": "model_based.object_impedance",
        "TorqueQpController": "model_based.torque_qp",
    },
)
