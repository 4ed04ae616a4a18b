"""Sensing of a run: sensors of all arms, kinematics of the arms by Pinocchio, slip of patches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask, frozen
from coop_pin.control.measurement import ArmMeasurement, ArmReference
from coop_pin.description.cell.grasp_plan import GraspPlan
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import SlipSensor
from coop_pin.model.arm_model import PayloadKinematics
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.cell_model import ArmPlace, SharedPlace
from coop_pin.model.joint_limits import per_joint
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.devices.sensors import SensorState, Truth, View, cell_sensors, sensors_path
from coop_pin.simulation.devices.shared_drive import SharedReading, SharedSensors
from coop_pin.simulation.devices.signals import CellSignals
from coop_pin.simulation.plant import Plant

_NONE = np.empty(0)
"""Of the wrenches, where nothing senses them."""


class SlipSensors(NamedTuple):
    """Slip sensors of all patches: ``s[k] = slip(t_{k-D}) + noise``, of which the largest is measured.

    The memory are the readings, newest first.

    Attributes:
        delay: D, ticks, shape (p,).
    """

    delay: Array

    @classmethod
    def of(cls, scenario: Scenario) -> SlipSensors:
        """Return the sensors of the arms with patches."""
        sensors = [scenario.sensors_of(name).slip or SlipSensor() for name in scenario.cell.patches]
        return cls(np.array([one.delay for one in sensors], dtype=int))

    def start(self) -> Array:
        """Return the memory before the first reading: nothing has slid, shape (d, p)."""
        return np.zeros((int(self.delay.max(initial=0)) + 1, len(self.delay)))

    def step(self, memory: Array, slips: Array, noise: Array, holds: Mask) -> tuple[float, Array]:
        """Return the largest reading of patches whose arms hold, m, and the memory.

        Args:
            memory: Readings before.
            slips: Slip of each patch, m, shape (p,).
            noise: Noise of each sensor, m, shape (p,).
            holds: Arms that hold, shape (p,).
        """
        memory = np.vstack((slips + noise, memory[:-1]))
        readings = memory[self.delay, np.arange(len(slips))]
        return float(readings[holds].max(initial=0.0)), memory


class SensingState(NamedTuple):
    """Memory of the sensors of a cell, and of the turns of its joints.

    Attributes:
        angles: joint angles of each arm at the last tick, shape (k,) each.
        sensors: memory of the sensors.
        slips: memory of the sensors of slip, shape (d, p).
        shared: memory of the sensors of shared joints, shape (d, 2, n); empty without any.
    """

    angles: Sequence[Array]
    sensors: SensorState
    slips: Array
    shared: Array = _NONE


class Sensing:
    """Sensors of all arms in a run, with the kinematics of the arms by Pinocchio.

    Attributes:
        sensors: the sensors.
        state: memory of the sensors; None before the first tick.
        holding_factors: holding torques of each arm's drives as measured over the true ones, shape (k,) each.
    """

    def __init__(
        self,
        scenario: Scenario,
        slots: Sequence[ArmPlace],
        arms: Sequence[CellArm],
        *,
        holding_torques: Callable[[Array], Sequence[Array]],
        loads: Callable[[Array], Array] | None = None,
        shared: Sequence[SharedPlace] = (),
    ) -> None:
        """Start without a measurement.

        Args:
            scenario: Cell, sensors and force path.
            slots: Positions of the arms in q and v.
            arms: Models of the arms.
            holding_torques: Torques of the drives of each arm at rest, as a function of the cell's
                configuration.
            loads: Wrenches on the arms at rest likewise, shape (m, 6); load shares of the weight when None.
            shared: Positions of the shared joints in q and v.

        Raises:
            FieldError: a row of values for each joint has another size.
        """
        self._slots, self._arms = slots, arms
        self._holding_torques, self._loads = holding_torques, loads
        self._turning = [(i, slot) for i, slot in enumerate(slots) if not slot.angles.is_vector]
        self._kinematics, self.holding_factors = [arm.kinematics for arm in arms], []
        for slot in slots:
            k = len(slot.drive)
            error = np.array(scenario.sensors_of(slot.name).holding_torque_error)
            path = f"{sensors_path(scenario, slot.name)}.holding_torque_error"
            self.holding_factors.append(1.0 + per_joint(error, k, path))
        self.sensors = cell_sensors(scenario, slots)
        self._holds, self._slips = np.ones(len(slots), dtype=bool), SlipSensors.of(scenario)
        self._patched = [index for index, slot in enumerate(slots) if slot.name in scenario.cell.patches]
        self._payload, self._start = scenario.cell.surroundings, scenario.start.matrix
        self._shared = SharedSensors.of(scenario, shared)
        self._told: Sequence[SharedReading | None] = [None] * len(slots)
        self.state: SensingState | None = None

    def follow(self, plan: GraspPlan) -> None:
        """Split the wrenches by a plan from now on, and heed the slip of the arms that hold."""
        self.sensors = self.sensors._replace(shares=plan.carried, loads=plan.carried_linkage)
        self._holds = plan.holds

    def start(
        self, q: Array, v: Array, references: Sequence[ArmReference], signals: CellSignals
    ) -> list[ArmMeasurement]:
        """Return the measurements at t = 0, with f_m[0] = f_d if the force path measures at all.

        They alone hold the holding torques. At rest, each arm carries its load share of the payload's weight,
        ``F_i = c_i [m_0 g, 0]``, without internal wrench; on patches, what presses them.
        """
        applied, payload = Applied.at_rest([len(slot.drive) for slot in self._slots]), self._payload
        loads = self.sensors.at_rest(payload.mass, payload.gravity) if self._loads is None else self._loads(q)
        R_WP = _NONE
        if self.sensors.wrists:
            R_WP = self._arms[0].payload_pose(q[self._slots[0].q_slice])[:3, :3]
        if self.sensors.has_joints:  # whose turns the first arm does not see
            R_WP = self._start[:3, :3]
        truth, view = self._truth(0.0, q, v, signals, applied, loads, R_WP), partial(self._view, q)
        memory = self._tell(None, q, v)
        sensors = self.sensors.start(truth, view, references)
        measured = self._step(sensors, truth, view, self._slips.start(), memory)
        return [
            reading._replace(holding_torque=frozen(torque * factor))
            for reading, torque, factor in zip(
                measured, self._holding_torques(q), self.holding_factors, strict=True
            )
        ]

    def measure(
        self, time: float, plant: Plant, applied: Applied, signals: CellSignals
    ) -> list[ArmMeasurement]:
        """Return the measurements of a later tick, after the torques of the tick before."""
        q = plant.q
        wrenches = plant.interaction_wrenches() if self.sensors.needs_wrenches else _NONE
        R_WP = plant.payload_pose()[:3, :3] if self.sensors.needs_pose else _NONE
        assert self.state is not None  # start() came first
        truth = self._truth(time, q, plant.v, signals, applied, wrenches, R_WP)
        slips, slip = self.state.slips, None
        if self._patched:
            holds = self._holds[self._patched]
            slip, slips = self._slips.step(slips, plant.slips(), signals.slip_noise, holds)
        memory = self._tell(self.state.shared, q, plant.v)
        measured = self._step(self.state.sensors, truth, partial(self._view, q), slips, memory)
        return measured if slip is None else [reading._replace(slip=slip) for reading in measured]

    def _step(
        self, state: SensorState, truth: Truth, view: View, slips: Array, shared: Array
    ) -> list[ArmMeasurement]:
        measured, state = self.sensors.step(state, truth, view)
        self.state = SensingState(truth.angles, state, slips, shared)
        if self._shared is None:
            return measured
        return [
            reading
            if told is None
            else reading._replace(
                shared_position=told.position,
                shared_velocity=told.velocity,
                carried_twist=frozen(reading.payload_twist - reading.payload_jacobian.dot(reading.v)),
            )
            for reading, told in zip(measured, self._told, strict=True)
        ]

    def _tell(self, memory: Array | None, q: Array, v: Array) -> Array:
        """Tell the arms of the shared joints under them; return the memory of the sensors, at first None."""
        if self._shared is None:
            return _NONE
        self._told, memory = self._shared.step(self._shared.start() if memory is None else memory, q, v)
        return memory

    def _truth(self, time: float, q: Array, v: Array, *others: Any) -> Truth:
        """Return what the sensors sense.

        Encoders count turns: the angle of a continuous joint starts within half a turn of the posture and
        never jumps.

        Args:
            time: Time of the tick, s.
            q: Configuration of the cell, shape (nq,).
            v: Velocity of the cell, shape (nv,).
            others: Fields of Truth after the rates.
        """
        angles, rates = [q[slot.q_slice] for slot in self._slots], [v[slot.v_slice] for slot in self._slots]
        for index, slot in self._turning:
            last = slot.posture if self.state is None else self.state.angles[index]
            angles[index] = slot.angles.near(angles[index], last)
        return Truth(time, angles, rates, *others)

    def _view(self, q: Array, index: int, angles: Array | None) -> PayloadKinematics:
        slot, told = self._slots[index], self._told[index]
        view = self._kinematics[index].view(
            q[slot.q_slice] if angles is None else slot.angles.configuration(angles)
        )
        return view if told is None or self._shared is None else self._shared.carried(index, view, told)
