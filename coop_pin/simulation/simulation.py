"""Simulation of a scenario with a controller, one tick at a time.

A tick measures, steps the controller, applies the torques and integrates the plant to the next tick, with the
torques held (zero-order hold). ``observe`` and ``step`` are its two halves, for a controller outside; a
``RunState`` is all that a run needs to go on bit for bit.
"""

from __future__ import annotations

import math

import numpy as np

from coop_pin.base.arrays import as_number, require_type
from coop_pin.base.errors import (
    ArgumentError,
    CommandError,
    CoopPinError,
    DivergedError,
    FieldError,
    OutOfRangeError,
    ShapeError,
    is_users,
)
from coop_pin.control import ArmReference, CellCommand, CellController
from coop_pin.control.controller import require_command
from coop_pin.description.events import PayloadEvent
from coop_pin.description.grasp_events import Event
from coop_pin.reference.squeeze import SqueezeReference
from coop_pin.results.run_result import RunResult
from coop_pin.results.snapshot import Snapshot
from coop_pin.simulation.devices.exchange import Traffic
from coop_pin.simulation.loop import TickLoop
from coop_pin.simulation.tick import TickInputs


class Simulation(TickLoop):
    """A run, tick by tick. A controller, motion or squeeze that is replaced acts from the next tick on.

    Attributes:
        scenario: the scenario, with the events added since the start.
        controller: controller of the cell, from measurements only.
        controller_state: returned by its last step.
        ticks_done: ticks recorded so far.
        timeline: the times of ticks and events, and the order of the stages of its ticks.
        chain: the cell's closed chain, on which its start is found and a plant may move.
        slots: positions of the arms in q and v.
        plant: the cell in motion; mutable, see its module.
        sensing: sensors of the arms.
        actuation: drives of the arms.
        exchange: messages between the arms.
        motion: the desired motion.
        squeeze: the desired internal wrenches.
        recorder: samples recorded so far.
        missed: grasps that did not happen.
    """

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
            command = self.controller.step(measurements, references, self.controller_state)
            require_command(self.time, self.controller.step, command, CellCommand)
            try:
                self._step(command)
            except DivergedError as error:
                if math.isnan(error.value):
                    self._require_numbers(command)
                raise
            except (ArgumentError, ShapeError) as error:
                self._blame(error)
                raise

    def _blame(self, error: CoopPinError) -> None:
        """Tell a command that cannot be read with the place of the user's law.

        Raises:
            CommandError: the law of the arm that the error names is the user's.
        """
        steps = {repr(slot.name): self.controller.step_of(slot.name) for slot in self.slots}
        step = next((step for name, step in steps.items() if f"arm {name}" in str(error)), None)
        if step is not None and is_users(step):
            problem = f"what cannot be commanded: {error}".rstrip(".")
            raise CommandError(self.time, step, problem, "give one real number for each drive") from error

    def _require_numbers(self, command: CellCommand) -> None:
        """Refuse NaN by a user's law.

        Raises:
            CommandError: a value for an arm is NaN.
        """
        for slot, values in zip(self.slots, command.values, strict=True):
            step, nan = self.controller.step_of(slot.name), np.isnan(np.asarray(values, dtype=float))
            if nan.any() and is_users(step):
                problem = f"NaN for drive {int(nan.argmax())} of arm {slot.name!r}"
                remedy = "look for 0 / 0, inf - inf, or the root or logarithm of a negative number in it"
                raise CommandError(self.time, step, problem, remedy)

    def observe(self) -> TickInputs:
        """Return what a controller gets at the next tick; again before ``step``, the same.

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
            self._observe()
            if not any(text.startswith("commanded") for text in self._replaced):
                self._replaced += (f"commanded from outside from t = {self.time:g} s on",)
            self._step(command)

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
        """Return the state of the run at its last recorded tick.

        Raises:
            InvalidStateError: no tick is done yet.
        """
        return self.recorder.snapshot()

    def result(self) -> RunResult:
        """Return the result up to the last recorded tick.

        Its scenario holds the events that were added, so that it can be run again. A run with a replaced
        controller or squeeze cannot: the summary says when that was.

        Raises:
            InvalidStateError: no tick is done yet.
        """
        summary = "; ".join((self.scenario.summary, *self._replaced)).removeprefix("; ")
        scenario = self.scenario.replace(summary=summary) if self._replaced else self.scenario
        result = self.recorder.result(scenario)
        remarks = [*map(str, self.missed), *self.plant.remarks()]
        if self.controller_state is not None:
            pose = self.motion.at(result.end).X_WP_d
            remarks += self.controller.remarks(pose, self.controller_state)
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
            references, target, *_ = self._desired(time)
        if not all(np.isfinite(part).all() for part in target):
            raise OutOfRangeError("time", time, "a time at which the motion is finite")
        return references
