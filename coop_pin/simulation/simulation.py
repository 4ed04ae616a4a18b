"""Simulation of a scenario with a controller, one tick at a time.

A tick measures, steps the controller, applies the torques and integrates the plant to the next tick, with the
torques held (zero-order hold).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from coop_pin.arrays import Array, as_number, frozen, require_type
from coop_pin.chain.cell_chain import CellChain
from coop_pin.control.interface import ArmReference, CellController
from coop_pin.description.events import Event, PayloadEvent
from coop_pin.description.scenario import Scenario
from coop_pin.errors import DivergedError, FieldError, InvalidStateError, OutOfRangeError
from coop_pin.model.joint_limits import JointLimits
from coop_pin.reference import PoseReference, PoseTarget, SqueezeReference
from coop_pin.results import RunResult, Snapshot
from coop_pin.simulation.actuation import Actuation
from coop_pin.simulation.drives import Applied
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.recorder import Recorder
from coop_pin.simulation.sensing import Sensing
from coop_pin.simulation.timeline import Timeline

# A run beyond these has diverged: joint speed, rad/s; closure error, m or rad.
SPEED_LIMIT = 1e3
CLOSURE_ERROR_LIMIT = 1e-2
_OPEN_START = 1e-6
"""Stated starting angles may leave a closure error of this, m or rad; the rest is projected out."""


def _start(chain: CellChain, scenario: Scenario) -> Array:
    """Return the configuration at t = 0 by inverse kinematics, or from the stated angles.

    Raises:
        UnreachablePoseError: the starting pose is out of an arm's reach.
        OpenClosureError: the stated angles leave a grasp open.
    """
    X_WP = scenario.start.matrix
    if not scenario.start_angles:
        return chain.configuration(X_WP)
    q = chain.posed_configuration(scenario.start_angles, X_WP)
    if not scenario.project_start:
        chain.require_held(q, X_WP, _OPEN_START)
    return chain.settled(q)


class Simulation:
    """A run, tick by tick. A controller, motion or squeeze that is replaced acts from the next tick on.

    Attributes:
        scenario: the scenario, with the events added since the start.
        controller: controller of the cell, from measurements only.
        controller_state: returned by its last step.
        ticks_done: ticks recorded so far.
        timeline: the times of ticks and events.
        plant: the closed chain in motion; mutable, see its module.
        sensing: sensors of the arms.
        actuation: drives of the arms.
        motion: the desired motion.
        squeeze: the desired internal wrenches.
        recorder: samples recorded so far.
    """

    def __init__(self, scenario: Scenario, controller: CellController, *, plant: type[Plant] = Plant) -> None:
        """Start at t = 0, at rest.

        Args:
            scenario: Scenario to run.
            controller: Controller of the cell; it need not be the one that the scenario names.
            plant: Class that computes the motion.

        Raises:
            UnreachablePoseError: the start is out of an arm's reach.
            OpenClosureError: the stated starting angles leave a grasp open, with the closure error.
        """
        require_type("scenario", scenario, Scenario)
        require_type("controller", controller, CellController)
        self.scenario, self.controller = scenario, controller
        self.controller_state: Any = None
        self.ticks_done = 0
        self.timeline = self._timeline()
        chain = CellChain(scenario.cell, scenario.plant)
        self.plant = plant(chain, scenario.plant, _start(chain, scenario))
        limits = [JointLimits(arm, name) for name, arm in scenario.cell.arms.items()]
        self.actuation = Actuation(scenario, self.plant, limits)
        self.sensing = Sensing(scenario, chain.model.arms, holding_torques=self.actuation.holding_commands)
        self.motion: PoseReference = scenario.motion.replace()  # reads a CSV table again
        self.squeeze: SqueezeReference = scenario.squeeze
        self.recorder = Recorder(scenario, self.plant, self.timeline, limits)
        self._grasps, self._rows = scenario.cell.grasps, scenario.cell.task_rows
        self._applied: Applied | None = None
        self._replaced: list[str] = []

    @property
    def time(self) -> float:
        """Time of the next tick, s."""
        return self.timeline.time(self.ticks_done)

    @property
    def is_finished(self) -> bool:
        """Whether the last tick is done."""
        return self.ticks_done > self.timeline.ticks

    def tick(self) -> None:
        """Do the next tick: measure, apply events, step the controller, record, integrate over the period.

        Raises:
            InvalidStateError: the last tick is done.
            ShapeError: the controller returned torques of a wrong shape.
            SingularJacobianError: an arm became singular.
            DivergedError: the motion left the range of finite, closed motion.
        """
        if self.is_finished:
            raise InvalidStateError(
                f"the simulation finished at t = {self.timeline.time(self.timeline.ticks):.6g} s;"
                " create a new Simulation, or give the scenario a longer duration"
            )
        # A diverging run is refused with its time, not warned of.
        with np.errstate(over="ignore", invalid="ignore"):
            self._tick(self.ticks_done)

    def snapshot(self) -> Snapshot:
        """Return the state of the run at its last recorded tick; there must be one."""
        return self.recorder.snapshot()

    def result(self) -> RunResult:
        """Return the result up to the last recorded tick; there must be one.

        Its scenario holds the events that were added, so that it can be run again. A run with a replaced
        controller or squeeze cannot: the summary says when that was.
        """
        if not self._replaced:
            return self.recorder.result(self.scenario)
        summary = "; ".join((self.scenario.summary, *self._replaced)).removeprefix("; ")
        return self.recorder.result(self.scenario.replace(summary=summary))

    def add_event(self, event: Event) -> None:
        """Add an event, at the next tick or later.

        Raises:
            FieldError: it starts before the next tick, or ends after the run.
        """
        require_type("event", event, PayloadEvent)
        if event.time < self.time:
            raise FieldError(
                f"starts at t = {event.time:g} s, but the run has reached {self.time:g} s", "event.time"
            )
        self.scenario = self.scenario.replace(events=(*self.scenario.events, event))
        self.timeline = self._timeline()

    def replace_controller(self, controller: CellController) -> None:
        """Replace the controller by one with the same kind of state, for example with other gains.

        It takes over the state.
        """
        require_type("controller", controller, CellController)
        self.controller = controller
        self._replaced.append(f"controller replaced at t = {self.time:g} s")

    def replace_squeeze(self, squeeze: SqueezeReference) -> None:
        """Replace the desired internal wrenches.

        Raises:
            FieldError: it does not name the arms of the cell.
        """
        self.squeeze = self.scenario.replace(squeeze=squeeze).squeeze
        self._replaced.append(f"squeeze replaced at t = {self.time:g} s")

    def references(self, time: float) -> list[ArmReference]:
        """Return the reference of each arm at a time, s.

        Raises:
            OutOfRangeError: the motion is not finite at that time.
        """
        time = as_number("time", time)
        with np.errstate(over="ignore", invalid="ignore"):
            target = self.motion.at(time)
        if not all(np.isfinite(part).all() for part in target):
            raise OutOfRangeError("time", time, "a time at which the motion is finite")
        return self._references(target, self.squeeze.at(time, self._grasps))

    def _tick(self, tick: int) -> None:
        time = self.timeline.time(tick)
        target, squeeze = self.motion.at(time), self.squeeze.at(time, self._grasps)
        references = self._references(target, squeeze)
        if self._applied is None:
            measurements = self.sensing.start(self.plant.q, self.plant.v, references)
            self._apply_events(time)
            self.controller_state = self.controller.init(measurements, references)
        else:
            measurements = self.sensing.measure(
                time, self.plant, self._applied.saturated, self._applied.reported
            )
            self._apply_events(time)
        command = self.controller.step(measurements, references, self.controller_state)
        self.controller_state = command.state
        self._applied = self.actuation.apply(time, command, self.plant.q)
        self.plant.drive(self._applied.torques)
        self.recorder.record(tick, time, measurements, self._applied, target, squeeze)
        self.ticks_done = tick + 1
        if tick < self.timeline.ticks:
            self._advance(tick)
        else:
            self.recorder.observe()

    def _timeline(self) -> Timeline:
        scenario = self.scenario
        lost = [scenario.actuators_of(name).lost_at for name in scenario.cell.arms]
        instants = [time for time in lost if time is not None]
        return Timeline(scenario.clock, scenario.duration, scenario.events, instants)

    def _references(self, target: PoseTarget, squeeze: Array) -> list[ArmReference]:
        rows = self._rows
        twist, acceleration = frozen(rows.select(target.V_WP_d)), frozen(rows.select(target.A_WP_d))
        return [
            ArmReference(target.X_WP_d, twist, acceleration, frozen(rows.select(wrench)))
            for wrench in squeeze
        ]

    def _apply_events(self, time: float) -> None:
        """Put the plant into the surroundings that the events at this time make."""
        if self.timeline.happens_at(time):
            self.recorder.observe()  # in the surroundings until now
            self.plant.surround(self.scenario.surroundings_at(self.timeline.just_after(time)))

    def _advance(self, tick: int) -> None:
        """Integrate the plant to the next tick, event times included."""
        actuation, is_held = self.actuation, self.actuation.is_held
        for index, step in enumerate(self.timeline.steps(tick)):
            if index > 0:
                self._apply_events(step.start)
            if not is_held:
                self.plant.drive(actuation.torques(step.start, step.length))
            self.plant.advance(step.start, step.length)
        if not is_held:
            self.plant.drive(actuation.torques(self.timeline.time(tick + 1)))
        self._require_closed(self.timeline.time(tick))

    def _require_closed(self, time: float) -> None:
        """Refuse a state that diverged; ``not <`` also catches NaN."""
        v = self.plant.v
        if not v.dot(v) < SPEED_LIMIT**2 and not (speed := float(np.abs(v).max())) < SPEED_LIMIT:
            raise DivergedError(time, "joint speed, rad/s,", speed, SPEED_LIMIT)
        closure_error = max(max(error) for error in self.plant.closure_errors())
        if not closure_error < CLOSURE_ERROR_LIMIT:
            raise DivergedError(time, "closure error, m or rad,", closure_error, CLOSURE_ERROR_LIMIT)
