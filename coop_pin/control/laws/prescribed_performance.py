"""Prescribed performance: pose and velocity errors stay in funnels, without model and force sensing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.schema.base import Interval, NotNegative
from coop_pin.base.spatial.generic_numbers import exp
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.control.bounds import SampledLoop
from coop_pin.control.controller import ArmCommand, ArmController
from coop_pin.control.gains import Gains, PositiveRow
from coop_pin.control.law import DecentralisedLaw, LawController
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.steady_state import NearRest, SteadyDirection
from coop_pin.control.terms import spare_torque

_SMALL_PART = 1e-3
"""Part of a funnel in which its gain counts as constant."""
_EDGE = 0.99
"""Normalised errors beyond it count as it: a sampled error can jump over the pole of the logarithm at 1."""


class PrescribedPerformanceGains(Gains):
    """Gains of the prescribed-performance law; one number for all task rows, or one for each.

    Attributes:
        pose_gain: g_s, m^2/s or rad^2/s.
        pose_funnel: rho_0 of the pose, m or rad; larger than the error at the start.
        pose_floor: rho_inf of the pose, m or rad.
        velocity_gain: g_v, W.
        velocity_funnel: rho_0 of the velocity, m/s or rad/s.
        velocity_floor: rho_inf of the velocity, m/s or rad/s.
        funnel_rate: l, 1/s.
        spare_gains: Stiffness, N m/rad, and damping, N m s/rad, of spare joints.
    """

    on_rows: ClassVar[tuple[str, ...]] = (
        "pose_gain",
        "pose_funnel",
        "pose_floor",
        "velocity_gain",
        "velocity_funnel",
        "velocity_floor",
    )

    pose_gain: PositiveRow = 1e-3
    pose_funnel: PositiveRow = 0.2
    pose_floor: PositiveRow = 0.02
    velocity_gain: PositiveRow = 2.0
    velocity_funnel: PositiveRow = 1.0
    velocity_floor: PositiveRow = 0.2
    funnel_rate: NotNegative = 1.0
    spare_gains: Interval = (40.0, 8.0)


@dataclass(frozen=True, eq=False)
class PrescribedPerformanceController(LawController[PrescribedPerformanceGains]):
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
        gains, rows = self.gains, self.arm.rows
        decay = exp(-gains.funnel_rate * (measurement.time - state[0]))
        xtilde = rows.pose_error(measurement.payload_pose, reference.pose)
        V_r = -gains.pose_gain * _push(xtilde, _width(gains.pose_funnel, gains.pose_floor, decay))
        rho = _width(gains.velocity_funnel, gains.velocity_floor, decay)
        push = gains.velocity_gain * _push(measurement.payload_twist - V_r, rho)
        f_d = rows.turn(measurement.payload_pose, reference.internal_wrench)
        tau = spare_torque(measurement, state[1], gains.spare_gains)
        return ArmCommand(tau - measurement.payload_jacobian.T.dot(self.arm.load_share * push + f_d), state)


def _width(first: Array, floor: Array, decay: float) -> Array:
    """Return rho(t), shape (k_0,)."""
    return (first - floor) * decay + floor


def _push(error: Array, rho: Array) -> Array:
    """Return r eps / rho of errors in their funnels, shape (k_0,)."""
    xi = np.minimum(np.maximum(error / rho, -_EDGE), _EDGE)
    return 2.0 / (1.0 - xi * xi) * np.log((1.0 + xi) / (1.0 - xi)) / rho


class PrescribedPerformance(DecentralisedLaw[PrescribedPerformanceGains]):
    """The model-free prescribed-performance law: PrescribedPerformanceController."""

    spare_spring: ClassVar[str] = "controller.gains.spare_gains"

    kind: Literal["prescribed-performance"] = "prescribed-performance"
    gains: PrescribedPerformanceGains = PrescribedPerformanceGains()

    @property
    def near_rest(self) -> NearRest:
        """Model near rest, linear in a small part of the narrowest velocity funnel."""
        return super().near_rest._replace(linear_speed=_SMALL_PART * float(np.min(self.gains.velocity_floor)))

    def controller_of(
        self, arm: ControlledArm, gains: PrescribedPerformanceGains, scenario: Any
    ) -> ArmController:
        """Return the law of one arm."""
        return PrescribedPerformanceController(arm, gains)

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return the spring of two funnels at their floors in each linear task row."""
        gains = self.gains.sized(rows.size, 0)

        def spring(row: int, x: float) -> float:
            V_r = gains.pose_gain * _push(np.full(rows.size, x), gains.pose_floor)
            return float((gains.velocity_gain * _push(V_r, gains.velocity_floor))[row])

        return [SteadyDirection(partial(spring, row)) for row in np.flatnonzero(rows.are_linear).tolist()]
