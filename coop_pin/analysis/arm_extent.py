"""How far an arm reaches."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from coop_pin.arrays import Array
from coop_pin.description.arm import Arm
from coop_pin.model.arm_alone import arm_alone
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.joint_limits import joint_limits
from coop_pin.model.pinocchio_model import frame_id

_SEEDS = 8


def arm_extent(arm: Arm) -> float:
    """Return the greatest distance found between the first joint and the tip within the joint limits, m.

    Quasi-Newton ascent from eight configurations, the same at every call: a lower bound that is attained.

    Raises:
        UrdfNotFoundError, UrdfError, FrameNotFoundError: the arm cannot be built.
    """
    model, limits = arm_alone(arm), joint_limits(arm)
    data, tip, angles = model.createData(), frame_id(model, arm.tip), JointAngles(model)
    origin = np.array(model.jointPlacements[1].translation)

    def nearness(q: Array) -> tuple[float, Array]:
        """Return minus the distance and its gradient."""
        J = pin.computeFrameJacobian(model, data, angles.configuration(q), tip, pin.LOCAL_WORLD_ALIGNED)
        arm_vector = pin.updateFramePlacement(model, data, tip).translation - origin
        distance = float(np.linalg.norm(arm_vector))
        return -distance, -(arm_vector @ J[:3]) / max(distance, 1e-12)

    lower, upper = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    rng, bounds = np.random.default_rng(0), list(zip(lower, upper, strict=True))
    tries = [minimize(nearness, rng.uniform(lower, upper), jac=True, bounds=bounds, method="L-BFGS-B") for _ in range(_SEEDS)]
    return -min(float(found.fun) for found in tries)
