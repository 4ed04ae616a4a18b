"""Object impedance: the payload answers external wrenches like a mass with spring and damper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand, CellController, ControlledArm
from coop_pin.control.terms import InternalForceIntegral
from coop_pin.description.model_laws import ObjectImpedance
from coop_pin.description.scenario import Scenario
from coop_pin.model_based.arm_dynamics import ArmDynamics
from coop_pin.model_based.computed_torque import ComputedTorqueState, acceleration_torque


class ObjectImpedanceState(NamedTuple):
    """Memory of the law.

    Attributes:
        arms: State of each arm, as of computed torque.
        accelerations: Accelerations commanded at the last tick, one of each arm, shape (k_0,); none before
            the first.
    """

    arms: tuple[ComputedTorqueState, ...]
    accelerations: tuple[Array, ...]


class ObjectImpedanceController(CellController):
    """Object impedance control with the external wrench estimated from all wrists.

    Schneider and Cannon (1992), "Object impedance control for cooperative manipulation: theory and
    experimental results"; internal wrench by an integral where it is measured (Caccavale, Chiacchio, Marino
    and Villani (2008), "Six-DOF impedance control of dual-arm cooperative manipulators", give it an impedance
    of its own). Wrenches and twists are about P in world axes, on task rows::

        E[k]  = M_0 a[k-1] + Q_0 V + W_0 + sum_i F_i[k]      external wrench; 0 without a wrist on every arm
        a[k]  = A_d + M_d^-1 (E - D xtildedot - K xtilde)
        F     = f_d + Z - c (M_0 a + Q_0 V + W_0 - E)
        tau   = M a_q + h - J^T F                                    as computed torque

    so that M_d xtilde'' + D xtilde' + K xtilde = F_ext. E converges to it by the factor M_0 A^-1 < 1 in each
    tick, with A = M_0 + sum (J M^-1 J^T)^-1, because E uses the acceleration that was commanded. What changes
    within a tick, friction above all, counts as external: a small M_d makes that unstable.
    """

    def __init__(self, law: ObjectImpedance, scenario: Scenario, arms: Sequence[ControlledArm]) -> None:
        """Build the models of the arms.

        Args:
            law: The law, its gains with k_0 entries.
            scenario: Scenario to run.
            arms: The arms.

        Raises:
            CoopPinError: the model cannot be built.
        """
        self._gains, self._rows, self._shares = law.gains, arms[0].rows, [arm.load_share for arm in arms]
        self._dynamics = [ArmDynamics(scenario, arm.name, law.model) for arm in arms]
        self._force = InternalForceIntegral(self._rows, law.gains.anchor_gain)

    def init(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> ObjectImpedanceState:
        """Return the state at t_0."""
        arms = (ComputedTorqueState(self._force.start(), measured.q) for measured in measurements)
        return ObjectImpedanceState(tuple(arms), ())

    def step(
        self,
        measurements: Sequence[ArmMeasurement],
        references: Sequence[ArmReference],
        state: ObjectImpedanceState,
    ) -> CellCommand:
        """Return the drive torques of this tick and the state of the next.

        Raises:
            SingularJacobianError: a payload Jacobian loses rank.
        """
        wrenches = [m.interaction_wrench for m in measurements if m.interaction_wrench is not None]
        measured = len(wrenches) == len(measurements) and bool(state.accelerations)
        total = np.sum(wrenches, axis=0) if measured else np.zeros(self._rows.size)
        gains, torques, arms, accelerations = self._gains, [], [], []
        for index, (m, reference) in enumerate(zip(measurements, references, strict=True)):
            dynamics = self._dynamics[index]
            M_0, bias = dynamics.payload_inertia(m.payload_pose), dynamics.payload_bias(m)
            E = M_0 @ state.accelerations[index] + bias + total if measured else total
            xtilde = self._rows.pose_error(m.payload_pose, reference.pose)
            spring = gains.damping * (m.payload_twist - reference.twist) + gains.stiffness * xtilde
            a = reference.acceleration + (E - spring) / gains.inertia
            f_r, force = self._force.step(m, reference, state.arms[index].force)
            F = f_r - self._shares[index] * (M_0 @ a + bias - E)
            start = state.arms[index].start
            along, rest = acceleration_torque(dynamics, m, start, gains.spare_gains)
            torques.append(along @ a + rest - m.payload_jacobian.T @ F)
            arms.append(ComputedTorqueState(force, start))
            accelerations.append(a)
        return CellCommand(torques, ObjectImpedanceState(tuple(arms), tuple(accelerations)))
