"""Law of a cell near rest at a pose: its torques by configuration, velocity and its own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.schema.pose import Pose
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.network import heard
from coop_pin.simulation.devices.sensing import Sensing
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.tick import SignalSource


class RestingLaw:
    """Law of a simulation that begins at rest on the reference at a configuration.

    Sensors are ideal, measured internal wrenches are as desired, torque limits play no part, and messages
    arrive at once. Where the law is zeroed at the grasp, the pose is that of the grasp.

    Attributes:
        references: references at rest at the pose.
        at_rest: measurements there.
        state: state of the law, which begins there from the torques that hold the cell.
    """

    def __init__(self, simulation: Simulation, q: Array, time: float, law_time: float | None = None) -> None:
        """Begin the law.

        Args:
            simulation: Simulation that has not begun.
            q: Configuration of the chain at the pose.
            time: Time of the references, s.
            law_time: Time of the measurements, s; that of the references when omitted.

        Raises:
            SingularJacobianError: an arm is singular there.
        """
        chain, scenario = simulation.chain, simulation.scenario
        self._simulation, self._time = simulation, time if law_time is None else law_time
        self._rest, X_WP = np.zeros(chain.mechanism.model.nv), chain.payload_pose(q)
        holding = simulation.actuation.holding_commands(q)
        ideal = scenario.with_ideal_sensors
        self._sensing = Sensing(ideal, simulation.slots, chain.arms, holding_torques=lambda _q: holding)
        self._signals = next(SignalSource(ideal, simulation.slots).rows()).sensors
        self._law, is_zeroed = simulation.controller, scenario.controller.near_rest.is_zeroed
        if is_zeroed:  # at this pose, not where the start is
            self._law = build_controller(scenario.replace(start=Pose.from_matrix(X_WP)))
        first = self._sensing.start(q, self._rest, simulation.references(time), self._signals)
        self.references = [
            reference._replace(pose=X_WP if is_zeroed else one.payload_pose, twist=0.0 * reference.twist)
            for reference, one in zip(simulation.references(time), first, strict=True)
        ]
        first = heard(self._law, first, self.references, None, simulation.exchange.at_once)
        self.state = self._law.init(first, self.references)
        self.at_rest = self.measured(q)

    def measured(self, q: Array) -> list[ArmMeasurement]:
        """Return the measurements at rest at a configuration; what was asked for a tick ago has acted."""
        measured = self._sensing.start(q, self._rest, self.references, self._signals)
        return [arm._replace(time=self._time, reported_torque=None) for arm in measured]

    def moving(self, v: Array) -> list[ArmMeasurement]:
        """Return the measurements at the pose at a velocity, shape (nv,)."""
        slots = self._simulation.slots
        rates = [frozen(slot.drive.dot(v[slot.v_slice])) for slot in slots]
        return [
            arm._replace(v=rate, payload_twist=frozen(arm.payload_jacobian.dot(rate)))
            for arm, rate in zip(self.at_rest, rates, strict=True)
        ]

    def step(
        self, measured: Sequence[ArmMeasurement], state: Any, spoken: Sequence[ArmMeasurement] | None = None
    ) -> tuple[Array, Any]:
        """Return the generalised force of the law, shape (nv,), and its next state.

        Args:
            measured: Measurements of the arms.
            state: State of the law.
            spoken: Measurements that the messages are made of; ``measured`` when omitted.
        """
        simulation, spoken = self._simulation, measured if spoken is None else spoken
        messages = heard(self._law, spoken, self.references, state, simulation.exchange.at_once)
        measured = [
            arm._replace(messages=each.messages) for arm, each in zip(measured, messages, strict=True)
        ]
        command = self._law.step(measured, self.references, state)
        torques = simulation.actuation.torques_of(command)
        return simulation.chain.transmission.torque(torques), command.state
