"""Prescribed performance: pose and velocity errors stay in funnels, without model and force sensing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array
from coop_pin.control.interface import ArmCommand, ArmController, ArmMeasurement, ArmReference
from coop_pin.control.terms import gain_vector, spare_torque
from coop_pin.spatial.generic_numbers import exp

_EDGE = 0.99
"""Normalised errors beyond it count as it: a sampled error can jump over the pole of the logarithm at 1."""


class PrescribedPerformanceController(ArmController):
    """Model-free prescribed-performance law for one arm; decentralised, without force sensing.

    Verginis, Mastellaro and Dimarogonas (2018), "Robust cooperative manipulation without force/torque
    measurements: control design and experiments". Errors are about P in world axes, on task rows, each entry
    in a funnel of its own; c is the load share::

        rho(t) = (rho_0 - rho_inf) exp(-l (t - t_0)) + rho_inf
        xi     = error / rho,   eps = ln((1 + xi) / (1 - xi)),   r = 2 / (1 - xi^2)
        V_r    = -g_s r_s eps_s / rho_s              with error xtilde: the desired velocity
        tau    = -J^T [c g_v r_v eps_v / rho_v + f_d]                         with error V - V_r

    Near xi = 0 it is the payload-space PD law with gamma = 4 g_s / rho_s^2 and K = 4 g_v / rho_v^2, so that K
    over the narrowest funnel is bounded by the tick as there. Ours: f_d, fed forward; xi is cut at 0.99.
    """

    def __init__(
        self,
        scenario: Any,
        arm: str,
        *,
        pose_gain: ArrayLike = 1e-3,
        pose_funnel: ArrayLike = 0.2,
        pose_floor: ArrayLike = 0.02,
        velocity_gain: ArrayLike = 2.0,
        velocity_funnel: ArrayLike = 1.0,
        velocity_floor: ArrayLike = 0.2,
        funnel_rate: float = 1.0,
        spare_gains: tuple[float, float] = (40.0, 8.0),
    ) -> None:
        """Take rows and load share from the scenario; nothing else of it is used.

        Each gain is one number for all task rows or one for each.

        Args:
            scenario: what is run.
            arm: name.
            pose_gain: g_s, m^2/s or rad^2/s.
            pose_funnel: rho_0 of the pose, m or rad; larger than the error at the start.
            pose_floor: rho_inf of the pose, m or rad.
            velocity_gain: g_v, W.
            velocity_funnel: rho_0 of the velocity, m/s or rad/s.
            velocity_floor: rho_inf of the velocity, m/s or rad/s.
            funnel_rate: l, 1/s.
            spare_gains: stiffness, N m/rad, and damping, N m s/rad, of spare joints.

        Raises:
            ShapeError: a gain has a wrong number of entries.
        """
        cell = scenario.cell
        self._rows, k_0 = cell.task_rows, cell.task_rows.size
        self._load_share = cell.share(arm)
        self._g_s, self._g_v = (
            gain_vector("pose_gain", pose_gain, k_0),
            gain_vector("velocity_gain", velocity_gain, k_0),
        )
        self._pose_funnel = (
            gain_vector("pose_funnel", pose_funnel, k_0),
            gain_vector("pose_floor", pose_floor, k_0),
        )
        self._velocity_funnel = (
            gain_vector("velocity_funnel", velocity_funnel, k_0),
            gain_vector("velocity_floor", velocity_floor, k_0),
        )
        self._funnel_rate, self._spare_gains = float(funnel_rate), spare_gains

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> tuple[float, Array]:
        """Return t_0, s, and the drive angles there, rad, shape (k,)."""
        return measurement.time, measurement.q

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: tuple[float, Array]
    ) -> ArmCommand:
        """Return the drive torque of this tick, and the state unchanged.

        Raises:
            SingularJacobianError: the payload Jacobian of a redundant arm loses rank.
        """
        decay = exp(-self._funnel_rate * (measurement.time - state[0]))
        xtilde = self._rows.pose_error(measurement.payload_pose, reference.pose)
        V_r = -self._g_s * _push(xtilde, _width(self._pose_funnel, decay))
        push = self._g_v * _push(measurement.payload_twist - V_r, _width(self._velocity_funnel, decay))
        f_d = self._rows.turn(measurement.payload_pose, reference.internal_wrench)
        tau = spare_torque(measurement, state[1], self._spare_gains)
        return ArmCommand(tau - measurement.payload_jacobian.T.dot(self._load_share * push + f_d), state)


def _width(funnel: tuple[Array, Array], decay: float) -> Array:
    """Return rho(t), shape (k_0,)."""
    first, floor = funnel
    return (first - floor) * decay + floor


def _push(error: Array, rho: Array) -> Array:
    """Return r eps / rho of errors in their funnels, shape (k_0,)."""
    xi = np.minimum(np.maximum(error / rho, -_EDGE), _EDGE)
    return 2.0 / (1.0 - xi * xi) * np.log((1.0 + xi) / (1.0 - xi)) / rho
