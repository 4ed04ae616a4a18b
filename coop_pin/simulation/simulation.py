"""A run under way, one tick at a time: measure, decide, hold, move; the controller is handed in, never looked up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from coop_pin.arrays import Array, frozen
from coop_pin.chain.cell_chain import CellChain
from coop_pin.control.interface import ArmMeasurement, ArmReference, CellController
from coop_pin.description.events import Event
from coop_pin.description.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.errors import DivergedError, EventTimeError, RunFinishedError
from coop_pin.model.joint_limits import joint_limits
from coop_pin.reference import PoseReference, PoseTarget, SqueezeReference
from coop_pin.results import RunResult, Snapshot
from coop_pin.simulation.actuation import Actuation
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.recorder import Recorder
from coop_pin.simulation.sensing import ArmSensor, ForceSensor
from coop_pin.simulation.timeline import Timeline

_SPEED_LIMIT = 1e3
_CLOSURE_ERROR_LIMIT = 1e-2
_TORQUE_LIMIT = 1e7
_OPEN_START = 1e-6


def _start(chain: CellChain, scenario: Scenario) -> Array:
    """Return the configuration at t = 0: found for the starting pose, or as stated, on the closures or projected onto them."""
    X_WP = scenario.start.matrix
    if not scenario.start_angles:
        return chain.configuration(X_WP)
    q = chain.posed_configuration(scenario.start_angles, X_WP)
    if not scenario.project_start:
        chain.require_held(q, X_WP, _OPEN_START)
    return chain.chain.project_configuration(q)


class Simulation:
    """A run under way. What is replaced between two ticks acts from the next tick on.

    Attributes:
        scenario: what is run, with the events that were added on the way.
        controller: who decides; it sees measurements only.
        ticks_done: ticks recorded so far.
        timeline: the times of ticks and events.
        chain: the cell as a closed chain, with the payload as it is now.
        payload: the payload as it is now.
        plant: the chain in motion: q, v and what drives them between two ticks.
        limits: the joint limits of each arm.
        actuation: what the motors make of commanded torques.
        saturated: which drives were at their limit in the last tick.
        sensors: what each arm measures of itself.
        force_sensor: what the force path lets through of the internal wrenches.
        motion: the desired motion; its successor acts from the next tick on.
        squeeze: the desired internal wrenches, likewise.
        recorder: what was recorded so far.
        state: the controller's memory.
    """

    def __init__(self, scenario: Scenario, controller: CellController) -> None:
        """Stand at t = 0, at rest.

        Args:
            scenario: what to run.
            controller: who decides.

        Raises:
            UnreachablePoseError: the start is out of an arm's reach.
            OpenClosureError: the stated starting angles leave a grasp open, with the gap.
        """
        self.scenario, self.controller = scenario, controller
        self.timeline = Timeline(scenario.clock, scenario.duration, scenario.events)
        self.chain = CellChain(scenario.cell, scenario.plant)
        self.payload: Payload = scenario.cell.payload
        self.plant = Plant(self.chain, scenario.plant, _start(self.chain, scenario))
        self.limits = [joint_limits(arm, name) for name, arm in scenario.cell.arms.items()]
        self.actuation = Actuation(scenario.cell, self.limits)
        self.saturated = self.actuation.idle
        self.sensors = [ArmSensor(scenario.cell, place) for place in self.chain.tree.arms]
        self.force_sensor = ForceSensor(scenario.cell, scenario.controller.force_path)
        self.motion: PoseReference = scenario.motion.replace()  # reads a CSV table anew
        self.squeeze: SqueezeReference = scenario.squeeze
        self.recorder = Recorder(scenario, self.plant, self.timeline, self.limits)
        self.state: Any = None
        self.ticks_done = 0
        self._replaced: list[str] = []

    @property
    def time(self) -> float:
        """Time of the next tick, s."""
        return self.timeline.time(self.ticks_done)

    @property
    def is_finished(self) -> bool:
        """Whether the run has come to its end."""
        return self.ticks_done > self.timeline.ticks

    def tick(self) -> None:
        """Do the next tick: measure, let events happen, decide, record, and move on to the tick after it.

        Raises:
            RunFinishedError: the run has come to its end.
            SingularArmError: an arm became singular.
            DivergedError: the motion left the range of finite, closed motion.
        """
        if self.is_finished:
            raise RunFinishedError(self.timeline.time(self.timeline.ticks))
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # what runs away is refused with its time, not warned of
            self._tick(self.ticks_done)

    def moment(self) -> Snapshot:
        """Return the run at its last recorded tick; there must be one."""
        return self.recorder.moment()

    def result(self) -> RunResult:
        """Return the result up to the last recorded tick; there must be one.

        Its scenario holds the events that were added, so it can be run again; where controller or squeeze
        were replaced, the summary says when, and it cannot.
        """
        if not self._replaced:
            return self.recorder.result(self.scenario)
        summary = "; ".join((self.scenario.summary, *self._replaced)).removeprefix("; ")
        return self.recorder.result(self.scenario.replace(summary=summary))

    def add_event(self, event: Event) -> None:
        """Let something happen to the payload, at the next tick or later.

        Raises:
            EventTimeError: it starts before the next tick, or ends after the run.
        """
        if event.time < self.time:
            raise EventTimeError(
                f"starts at t = {event.time:g} s, but the run has reached {self.time:g} s", "event.time"
            )
        self.scenario = self.scenario.replace(events=(*self.scenario.events, event))
        self.timeline = Timeline(self.scenario.clock, self.scenario.duration, self.scenario.events)

    def replace_controller(self, controller: CellController) -> None:
        """Hand over to another controller of the same kind, for example one with other gains; it takes over the state."""
        self.controller = controller
        self._replaced.append(f"controller replaced at t = {self.time:g} s")

    def replace_squeeze(self, squeeze: SqueezeReference) -> None:
        """Ask for other internal wrenches.

        Raises:
            SqueezeError: it does not name the arms of the cell.
        """
        self.squeeze = self.scenario.replace(squeeze=squeeze).squeeze
        self._replaced.append(f"squeeze replaced at t = {self.time:g} s")

    def _tick(self, tick: int) -> None:
        time = self.timeline.time(tick)
        target, squeeze = self.motion.at(time), self.squeeze.at(time, self.scenario.cell.arms)
        references = self._references(target, squeeze)
        measurements = self._measure(tick, time, references)
        self._happen(time)
        if self.state is None:
            self.state = self.controller.init(measurements, references)
        answer, self.state = self.controller.step(measurements, references, self.state)
        commanded = self.actuation.commands(answer)
        self._require_finite(time, commanded)
        applied = self.actuation.apply(commanded)
        self.plant.hold(applied.torques)
        self.saturated = applied.saturated
        self.recorder.record(tick, time, measurements, commanded, applied, target, squeeze)
        self.ticks_done = tick + 1
        if tick < self.timeline.ticks:
            self._move(tick)

    def _references(self, target: PoseTarget, squeeze: Array) -> list[ArmReference]:
        rows = self.scenario.cell.task_rows
        twist, acceleration = frozen(rows.select(target.V_WP_d)), frozen(rows.select(target.A_WP_d))
        return [
            ArmReference(target.X_WP_d, twist, acceleration, frozen(rows.select(wrench)))
            for wrench in squeeze
        ]

    def _measure(self, tick: int, time: float, references: Sequence[ArmReference]) -> list[ArmMeasurement]:
        wrenches: Sequence[Array | None] = [None] * len(self.sensors)
        if self.force_sensor.is_needed and tick > 0:
            wrenches = self.force_sensor.measure(self.plant.interaction_wrenches())
        measurements = [
            sensor.measure(time, self.plant.q, self.plant.v, wrench, saturated)
            for sensor, wrench, saturated in zip(self.sensors, wrenches, self.saturated, strict=True)
        ]
        if not self.force_sensor.is_needed or tick > 0:
            return measurements
        rows = self.scenario.cell.task_rows
        desired = [
            rows.turn(m.payload_pose, r.internal_wrench)
            for m, r in zip(measurements, references, strict=True)
        ]
        started = self.force_sensor.start(desired)
        return [m._replace(internal_wrench=wrench) for m, wrench in zip(measurements, started, strict=True)]

    def _happen(self, time: float) -> None:
        """Let the events of this instant happen."""
        for change in self.timeline.changes_at(time):
            before = self.chain.chain.energy(self.plant.q, self.plant.v).total
            self.payload = change.apply(self.payload)
            self.chain.set_payload(self.payload)
            self.recorder.payload_energy += self.chain.chain.energy(self.plant.q, self.plant.v).total - before
        if self.timeline.happens_at(time):
            self.plant.push(self.timeline.push_at(time))

    def _move(self, tick: int) -> None:
        for index, step in enumerate(self.timeline.steps(tick)):
            if index > 0:
                self._happen(step.start)
            self.plant.advance(step.length)
        self._require_closed(self.timeline.time(tick))

    def _require_finite(self, time: float, torques: Sequence[Array]) -> None:
        for name, torque in zip(self.scenario.cell.arms, torques, strict=True):
            largest = float(np.abs(torque).max())
            if not largest < _TORQUE_LIMIT:
                raise DivergedError(time, f"torque of arm {name!r}, N m,", largest, _TORQUE_LIMIT)

    def _require_closed(self, time: float) -> None:
        """Refuse a state that ran away; ``not <`` also catches NaN."""
        speed = float(np.abs(self.plant.v).max())
        if not speed < _SPEED_LIMIT:
            raise DivergedError(time, "joint speed, rad/s,", speed, _SPEED_LIMIT)
        gap = max(max(gap) for gap in self.chain.closure_errors(self.plant.q))
        if not gap < _CLOSURE_ERROR_LIMIT:
            raise DivergedError(time, "closure error, m or rad,", gap, _CLOSURE_ERROR_LIMIT)
