"""Simulation of a scenario with a controller, one tick at a time.

A tick measures, steps the controller, applies the torques and integrates the plant to the next tick, with the
torques held (zero-order hold). ``observe`` and ``step`` are its two halves, for a controller outside; a
``RunState`` is all that a run needs to go on bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, as_number, frozen, require_type
from coop_pin.base.errors import DivergedError, FieldError, InvalidStateError, OutOfRangeError
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.control import ArmReference, CellCommand, CellController
from coop_pin.description.cell.grasp_plan import GraspPlan
from coop_pin.description.events import PayloadEvent
from coop_pin.description.grasp_events import Event
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.reference.pose_reference import PoseReference, PoseTarget, retreated
from coop_pin.reference.squeeze import SqueezeReference
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Snapshot
from coop_pin.simulation.devices.actuation import Actuation
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.devices.network import Exchange, Traffic, heard
from coop_pin.simulation.devices.sensing import Sensing
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.recorder import Recorder
from coop_pin.simulation.run_state import RunState
from coop_pin.simulation.tick import SignalSource, TickInputs, TickSignals
from coop_pin.simulation.timeline import Timeline

# A run beyond these has diverged: joint speed, rad/s; closure error, m or rad.
SPEED_LIMIT = 1e3
CLOSURE_ERROR_LIMIT = 1e-2
_OPEN_START = 1e-6
"""Stated starting angles may leave a closure error of this, m or rad; the rest is projected out."""


def start_configuration(chain: CellChain, scenario: Scenario) -> Array:
    """Return the configuration at t = 0 by inverse kinematics, or from the stated angles.

    Raises:
        UnreachablePoseError: the starting pose is out of an arm's reach.
        OpenClosureError: the stated angles leave a grasp open.
    """
    X_WP = scenario.start.matrix
    if not scenario.start_angles:
        return chain.configuration(X_WP, scenario.squeeze_wrenches)
    q = chain.posed_configuration(scenario.start_angles, X_WP)
    if not scenario.project_start:
        chain.require_held(q, X_WP, _OPEN_START)
    return chain.settled(q, scenario.squeeze_wrenches)


class _NoController(CellController):
    """Stands for the controller of a simulation that is commanded from outside."""

    def init(self, *_: Any) -> Any:
        raise InvalidStateError("the simulation has no controller; call step(command), or give it one")

    def step(self, *_: Any) -> Any:
        return self.init()


def arm_references(rows: TaskRows, target: PoseTarget, squeeze: Iterable[Array]) -> list[ArmReference]:
    """Return the reference of each arm.

    Args:
        rows: Task rows of the cell.
        target: Desired motion of the payload.
        squeeze: Desired internal wrench of each arm about P in payload axes, shape (6,) each.
    """
    X, V, A = target
    pose, twist, acceleration = frozen(X), frozen(rows.select(V)), frozen(rows.select(A))
    return [ArmReference(pose, twist, acceleration, frozen(rows.select(wrench))) for wrench in squeeze]


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
        exchange: messages between the arms.
        motion: the desired motion.
        squeeze: the desired internal wrenches.
        recorder: samples recorded so far.
    """

    def __init__(
        self, scenario: Scenario, controller: CellController | None = None, *, plant: type[Plant] = Plant
    ) -> None:
        """Start at t = 0, at rest.

        Args:
            scenario: Scenario to run.
            controller: Controller of the cell; it need not be the one that the scenario names. Without one,
                ``step`` is given commands from outside.
            plant: Class that computes the motion.

        Raises:
            UnreachablePoseError: the start is out of an arm's reach.
            OpenClosureError: the stated starting angles leave a grasp open, with the closure error.
            FieldError: an arm does not take what the controller commands.
        """
        require_type("scenario", scenario, Scenario)
        require_type("controller", controller, CellController, type(None))
        self.scenario, self.controller = scenario, controller or _NoController()
        self.controller_state: Any = None
        self.ticks_done = 0
        self._schedule()
        chain = CellChain(scenario.cell, scenario.plant)
        self.plant = plant(chain, scenario.plant, start_configuration(chain, scenario))
        self.actuation = Actuation(scenario, self.plant)
        if controller is not None:
            self.actuation.require_taken(controller)
        holding, loads = self.actuation.holding_commands, chain.loads if chain.patches.arms else None
        self.sensing = Sensing(scenario, chain, holding_torques=holding, loads=loads)
        self.exchange = Exchange(scenario)
        self.motion: PoseReference = scenario.motion.replace()  # reads a CSV table again
        self.squeeze: SqueezeReference = scenario.squeeze
        self.recorder = Recorder(scenario, self.plant, self.timeline)
        self._grasps, self._rows = scenario.cell.grasps, scenario.cell.task_rows
        self._applied: Applied | None = None
        self._inputs: TickInputs | None = None
        self._replaced: tuple[str, ...] = ()
        self._signals = self.signals()
        self._start = self.state()

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a copy is made (``copy.deepcopy``, pickle): a new simulation in the same state."""
        return _restored, (self._start.scenario, self.controller, type(self.plant), self.state())

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
            InvalidStateError: the last tick is done, or there is no controller.
            ShapeError: the controller returned torques of a wrong shape.
            SingularJacobianError: an arm became singular.
            DivergedError: the motion left the range of finite, closed motion.
        """
        # A diverging run is refused with its time, not warned of.
        with np.errstate(over="ignore", invalid="ignore"):
            inputs = self._observe()
            if self.ticks_done == 0:
                measurements, references, *_ = self._heard(inputs, None)
                self.controller_state = self.controller.init(measurements, references)
                self.exchange.state = None  # all is said again
            self._inputs = inputs = self._heard(inputs, self.controller_state)
            measurements, references, *_ = inputs
            self._step(inputs, self.controller.step(measurements, references, self.controller_state))

    def observe(self) -> TickInputs:
        """Return what a controller gets at the next tick; asked again before ``step``, the same.

        Raises:
            InvalidStateError: the last tick is done.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._observe()

    def step(self, command: CellCommand) -> None:
        """Do the next tick with a command from outside, in place of the controller's.

        Args:
            command: Values for all arms until the next tick; ``controller_state`` becomes its state.

        Raises:
            InvalidStateError: the last tick is done.
            ArgumentError: an arm is not commanded what it takes.
            ShapeError: not one value for each drive of each arm.
            DivergedError: a command or the motion left the range of finite, closed motion.
        """
        require_type("command", command, CellCommand)
        with np.errstate(over="ignore", invalid="ignore"):
            inputs, since = self._observe(), f"commanded from outside from t = {self.time:g} s on"
            if not any(text.startswith("commanded") for text in self._replaced):
                self._replaced += (since,)
            self._step(inputs, command)

    def state(self) -> RunState:
        """Return the state of the run, from which ``restore`` makes it go on with the same bits."""
        return RunState(
            self.scenario,
            self.ticks_done,
            self.controller,
            self.controller_state,
            self.motion,
            self.squeeze,
            self._replaced,
            self._inputs,
            self._applied,
            self.plant.state(),
            self.sensing.state,
            self.actuation.memory(),
            self.recorder.state(),
            self.exchange.state,
        )

    def restore(self, state: RunState) -> None:
        """Return to a state of this run, or of another that differs in events, seed or laws only.

        Raises:
            ArgumentError: the state is of a run with another cell, plant, clock, sensors or drives.
        """
        require_type("state", state, RunState)
        state.require_of(self._start.scenario)
        self.scenario, self.ticks_done, self.controller, self.controller_state = state[:4]
        self.motion, self.squeeze, self._replaced, self._inputs, self._applied = state[4:9]
        self._schedule()
        self.plant.restore(state.plant)
        self.actuation.restore(state.actuation)
        self.sensing.state, self.exchange.state = state.sensing, state.network
        self._signals = self.signals(self.ticks_done + (self._inputs is not None))
        self.recorder.restore(state.record, self.scenario)

    def signals(self, first: int = 0) -> Iterator[TickSignals]:
        """Return the signals of one tick after the other, from that with a number on."""
        return SignalSource(self.scenario, self.plant.chain.model.arms).rows(first)

    def reset(self, seed: int | None = None) -> TickInputs:
        """Return to the start and observe the first tick.

        Args:
            seed: Seed of the random numbers from now on; that of the start when None.
        """
        state = self._start
        if seed is not None:
            state = state._replace(scenario=state.scenario.replace(seed=seed))
        self.restore(state)
        return self.observe()

    def traffic(self) -> Traffic:
        """Return what the controller's arms tell each other in a tick, as counted at the next one."""
        inputs = self.observe()
        messages = self.controller.messages(inputs.measurements, inputs.references, self.controller_state)
        return self.exchange.traffic(messages)

    def snapshot(self) -> Snapshot:
        """Return the state of the run at its last recorded tick; there must be one."""
        return self.recorder.snapshot()

    def result(self) -> RunResult:
        """Return the result up to the last recorded tick; there must be one.

        Its scenario holds the events that were added, so that it can be run again. A run with a replaced
        controller or squeeze cannot: the summary says when that was.
        """
        summary = "; ".join((self.scenario.summary, *self._replaced)).removeprefix("; ")
        scenario = self.scenario.replace(summary=summary) if self._replaced else self.scenario
        result = self.recorder.result(scenario)
        if self.controller_state is not None:
            pose = self.motion.at(result.end).X_WP_d
            remarks = [*map(str, self.plant.missed), *self.controller.remarks(pose, self.controller_state)]
            if remarks:
                result.data.attrs[RunResult.REMARKS] = "\n".join(remarks)
        return result

    def add_event(self, event: Event) -> None:
        """Add an event, at the next tick or later.

        Raises:
            FieldError: it starts before the next tick, ends after the run, or is the failure of an arm, whose
                drives are those of the scenario.
        """
        require_type("event", event, PayloadEvent)
        if event.is_foreseen:
            raise FieldError(f"is {event.kind!r}; state it in the scenario", "event.kind")
        earliest = self.timeline.time(self.ticks_done + (self._inputs is not None))
        if event.time < earliest:
            raise FieldError(
                f"starts at t = {event.time:g} s, but the run has reached {earliest:g} s", "event.time"
            )
        self.scenario = self.recorder.scenario = self.scenario.replace(events=(*self.scenario.events, event))
        self._schedule()

    def replace_controller(self, controller: CellController) -> None:
        """Replace the controller by one with the same kind of state, for example with other gains.

        It takes over the state.

        Raises:
            FieldError: an arm does not take what it commands.
        """
        require_type("controller", controller, CellController)
        self.actuation.require_taken(controller)
        self.controller = controller
        self._replaced += (f"controller replaced at t = {self.time:g} s",)

    def replace_squeeze(self, squeeze: SqueezeReference) -> None:
        """Replace the desired internal wrenches.

        Raises:
            FieldError: it does not name the arms of the cell.
        """
        self.squeeze = self.scenario.replace(squeeze=squeeze).squeeze
        self._replaced += (f"squeeze replaced at t = {self.time:g} s",)

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
        return self._by_clocks(time, self._references(target, *self._planned(time)))

    def _observe(self) -> TickInputs:
        """Measure and apply the events of the next tick, once."""
        if self.is_finished:
            raise InvalidStateError(
                f"the simulation finished at t = {self.timeline.time(self.timeline.ticks):.6g} s;"
                " create a new Simulation, or give the scenario a longer duration"
            )
        if self._inputs is None:
            time = self.time
            target, (squeeze, plan) = self.motion.at(time), self._planned(time)
            references = self._by_clocks(time, self._references(target, squeeze, plan))
            if plan is not None:
                self.sensing.follow(plan)
            plant, signals = self.plant, next(self._signals)
            if self._applied is None:
                measurements = self.sensing.start(plant.q, plant.v, references, signals.sensors)
            else:
                measurements = self.sensing.measure(time, plant, self._applied, signals.sensors)
            for index, clock in self._clocks.items():
                measurements[index] = measurements[index]._replace(time=clock.reading(time))
            self._apply_events(time)
            self._inputs = TickInputs(measurements, references, target, squeeze, signals)
        return self._inputs

    def _heard(self, inputs: TickInputs, state: Any) -> TickInputs:
        """Return the inputs with the messages that controllers in a state exchange at this tick, once."""
        if self.exchange.network is None or inputs.measurements[0].messages is not None:
            return inputs
        exchange = partial(self.exchange.step, signals=inputs.signals.network)
        measured = heard(self.controller, inputs.measurements, inputs.references, state, exchange)
        return inputs._replace(measurements=measured)

    def _step(self, inputs: TickInputs, command: CellCommand) -> None:
        """Apply a command, record the tick and integrate to the next."""
        tick, time = self.ticks_done, self.time
        self.controller_state = command.state
        self._applied = self.actuation.apply(time, command, inputs.signals.missed)
        self.plant.drive(self._applied.torques)
        self.recorder.record(time, inputs, self._applied, self.sensing.sensors.shares)
        self.ticks_done, self._inputs = tick + 1, None
        if tick < self.timeline.ticks:
            self._advance(tick)
        else:
            self.recorder.observe()

    def _schedule(self) -> None:
        """Lay out the times of the run, and what of them a tick asks for."""
        scenario = self.scenario
        lost = [scenario.actuators_of(name).lost_at for name in scenario.cell.arms]
        instants = [time for time in lost if time is not None]
        self.timeline = Timeline(scenario.clock, scenario.duration, scenario.events, instants)
        self._clocks, self._has_plan = scenario.clocks, scenario.has_grasp_plan

    def _planned(self, time: float) -> tuple[Array, GraspPlan | None]:
        """Return desired internal wrenches and the plan of the grasps at a time, if grasps have events."""
        squeeze = self.squeeze.at(time, self._grasps)
        if not self._has_plan:
            return squeeze, None
        missed = [missed.event for missed in self.plant.missed]
        plan = self.scenario.grasp_plan_at(self.timeline.just_after(time), missed)
        return plan.squeeze(squeeze), plan

    def _references(
        self, target: PoseTarget, squeeze: Array, plan: GraspPlan | None = None
    ) -> list[ArmReference]:
        """Return the references of all arms; by a plan, of arms that bear other shares or retreat."""
        rows = self._rows
        if plan is None:
            return arm_references(rows, target, squeeze)
        arms, references = zip(self._grasps, plan.carried.tolist(), plan.retreats, strict=True), []
        for index, (name, share, retreat) in enumerate(arms):
            moved = retreated(target, self.scenario.cell.way_out(name), retreat)
            (reference,) = arm_references(rows, moved, squeeze[index : index + 1])
            references.append(reference._replace(load_share=share))
        return references

    def _by_clocks(self, time: float, references: list[ArmReference]) -> list[ArmReference]:
        """Return references with those of arms whose clocks are off at what these show."""
        for index, clock in self._clocks.items():
            shown = clock.reading(time)
            references[index] = self._references(self.motion.at(shown), *self._planned(shown))[index]
        return references

    def _apply_events(self, time: float) -> None:
        """Put the plant into the surroundings that the events at this time make."""
        if self.timeline.happens_at(time):
            self.recorder.observe()  # in the surroundings until now
            after = self.timeline.just_after(time)
            self.plant.surround(self.scenario.surroundings_at(after))
            for event in self.scenario.events:
                if abs(event.instant - time) <= after - time:
                    event.act(self.plant, list(self.scenario.cell.arms))

    def _advance(self, tick: int) -> None:
        """Integrate the plant to the next tick, event times included."""
        actuation, is_held = self.actuation, self.actuation.is_held
        for index, step in enumerate(self.timeline.steps(tick)):
            if index > 0:
                self._apply_events(step.start)
                if actuation.has_servos:
                    self._sample(tick, step.start)
            if not is_held:
                self.plant.drive(actuation.torques(step.start, step.length))
            self.plant.advance(step.start, step.length)
        if not is_held:
            self.plant.drive(actuation.torques(self.timeline.time(tick + 1)))
        self._require_closed(self.timeline.time(tick))

    def _sample(self, tick: int, time: float) -> None:
        """Let the servos sample that are due at a time within a tick."""
        share = (time - self.timeline.time(tick)) / self.timeline.period
        if (torques := self.actuation.sample(share, time)) is not None:
            self.plant.drive(torques)

    def _require_closed(self, time: float) -> None:
        """Refuse a state that diverged; ``not <`` also catches NaN."""
        v = self.plant.v
        if not v.dot(v) < SPEED_LIMIT**2 and not (speed := float(np.abs(v).max())) < SPEED_LIMIT:
            raise DivergedError(time, "joint speed, rad/s,", speed, SPEED_LIMIT)
        closure_error = max(max(error) for error in self.plant.closure_errors())
        if not closure_error < CLOSURE_ERROR_LIMIT:
            raise DivergedError(time, "closure error, m or rad,", closure_error, CLOSURE_ERROR_LIMIT)


def _restored(
    scenario: Scenario, controller: CellController, plant: type[Plant], state: RunState
) -> Simulation:
    """Return a simulation in a state."""
    simulation = Simulation(scenario, controller, plant=plant)
    simulation.restore(state)
    return simulation
