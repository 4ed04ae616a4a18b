"""Loop of a run: the stages of its ticks on a plant, with commands of a controller or from outside."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import DivergedError, InvalidStateError, OutOfRangeError, ScenarioWarning
from coop_pin.control import CellCommand, CellController
from coop_pin.control.law_memory import LawMemory
from coop_pin.description.grasp_events import MissedGrasp
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.reference.pose_reference import PoseReference
from coop_pin.reference.squeeze import SqueezeReference
from coop_pin.simulation.devices.actuation import Actuation
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.devices.exchange import Exchange, heard
from coop_pin.simulation.devices.sensing import Sensing
from coop_pin.simulation.devices.shared_drive import SharedDrives, WheelDrives
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import SPEED_LIMIT, PlantMaker, require_closed
from coop_pin.simulation.recorder import Recorder
from coop_pin.simulation.run_state import RunState, copied
from coop_pin.simulation.tick import CellReference, References, SignalSource, TickInputs, TickSignals
from coop_pin.simulation.timeline import Timeline

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


class TickLoop:
    """Ticks of a scenario on a plant, stage by stage; see Simulation for its attributes."""

    def __init__(
        self,
        scenario: Scenario,
        controller: CellController | None = None,
        *,
        plant: PlantMaker = PinocchioPlant,
    ) -> None:
        """Start at t = 0, at rest.

        Args:
            scenario: Scenario to run.
            controller: Controller of the cell; it need not be the one that the scenario names. Without one,
                ``step`` is given commands from outside.
            plant: Maker of the plant, which computes the motion: a class of plants.

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
        self.chain = chain = CellChain(scenario.cell, scenario.plant)
        self.slots, q = chain.model.arms, start_configuration(chain, scenario)
        self.plant = plant(chain, scenario.plant, q)
        self.actuation = Actuation(scenario, self.plant, self.slots, chain.arms, chain.loads(q))
        drives = WheelDrives if chain.model.wheels else SharedDrives
        self.shared = drives.of(scenario, chain, q, chain.loads(q)) if chain.model.shared else None
        if controller is not None:
            self.actuation.require_taken(controller)
        holding, loads = (
            self.actuation.holding_commands,
            chain.loads if chain.patches.arms or scenario.cell.jointed or chain.joints else None,
        )
        self.sensing = Sensing(
            scenario,
            self.slots,
            chain.arms,
            holding_torques=holding,
            loads=loads,
            shared=chain.model.shared,
        )
        self.exchange = Exchange(scenario)
        self.motion: PoseReference = scenario.payload_motion  # reads a CSV table again
        self.squeeze: SqueezeReference = scenario.squeeze
        self._schedule()
        limits, determined = [arm.limits for arm in chain.arms], chain.rigid.determinate_rows(q)
        self.recorder = Recorder(scenario, self.plant, self.timeline, self.slots, limits, determined)
        self.missed: tuple[MissedGrasp, ...] = ()
        self._applied: Applied | None = None
        self._inputs: TickInputs | None = None
        self._signals = self.signals()
        self._returned: tuple[Scenario, int, TickSignals] | None = None
        self._replaced: tuple[str, ...] = ()
        self._maker, self._start = plant, self.state()

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a copy is made (``copy.deepcopy``, pickle): a new run in the same state."""
        make = partial(type(self), plant=self._maker)
        return make, (self._start.scenario, self.controller), self.state()

    def _schedule(self) -> None:
        """Lay out the times of the run, and its references."""
        scenario = self.scenario
        lost = [scenario.actuators_of(name).lost_at for name in scenario.cell.arms]
        instants = [time for time in lost if time is not None]
        clock, drives = scenario.clock, self.actuation.drives
        self.timeline = Timeline(clock, scenario.duration, scenario.events, instants, drives)
        self._references = References(scenario, self.timeline)

    @property
    def time(self) -> float:
        """Time of the next tick, s."""
        return self.timeline.time(self.ticks_done)

    @property
    def is_finished(self) -> bool:
        """Whether the last tick is done."""
        return self.ticks_done > self.timeline.ticks

    def signals(self, first: int = 0) -> Iterator[TickSignals]:
        """Return the signals of one tick after the other, from that with a number on."""
        return SignalSource(self.scenario, self.slots).rows(first)

    def _signals_again(self, first: int) -> Iterator[TickSignals]:
        """Yield what ``signals`` does, and keep the first: analyses return to one tick hundreds of times."""
        scenario = self.scenario
        if self._returned is None or self._returned[0] is not scenario or self._returned[1] != first:
            self._returned = scenario, first, next(self.signals(first))
        yield self._returned[2]
        yield from SignalSource(scenario, self.slots).rows(first + 1)

    # ------------------------------------------------------------ a tick

    def _observe(self) -> TickInputs:
        """Do the stages of the next tick before its command, once."""
        if self.is_finished:
            raise InvalidStateError(
                f"the simulation finished at t = {self.timeline.time(self.timeline.ticks):.6g} s;"
                " create a new Simulation, or give the scenario a longer duration"
            )
        if self._inputs is None:
            for kind, time, *_ in self.timeline.before_command(self.ticks_done):
                match kind:
                    case "measure":
                        self._inputs = self._measure(time)
                    case "happen":
                        self._happen(time)
        assert self._inputs is not None
        return self._inputs

    def _step(self, command: CellCommand) -> None:
        """Do the stages of a tick from its command on."""
        tick, actuation, plant, inputs = self.ticks_done, self.actuation, self.plant, self._observe()
        held: list[Array] = []
        for kind, time, length, due in self.timeline.from_command(tick):
            match kind:
                case "advance":
                    try:
                        plant.advance(time, length)
                    except (np.linalg.LinAlgError, OutOfRangeError) as error:
                        if getattr(error, "name", "q") not in ("q", "v"):
                            raise  # a wrench, say
                        raise DivergedError(time, "a state within a step", math.nan, SPEED_LIMIT) from error
                case "command":
                    self.controller_state = command.state
                    self._applied = applied = actuation.apply(time, command, inputs.signals.missed)
                    if self.shared is not None:
                        held = self.shared.force(time, plant.q, plant.v, inputs.target)
                    plant.drive([*applied.torques, *held])
                case "record":
                    sensors = self.sensing.sensors
                    self.recorder.record(time, inputs, applied, sensors.shares, sensors.loads)
                    self.ticks_done, self._inputs = tick + 1, None
                case "happen":
                    self._happen(time)
                case "sample":
                    plant.drive([*actuation.sample(due, time), *held])
                case "drive" | "release":
                    plant.drive([*actuation.torques(time, length), *held])
        if self.is_finished:
            self.recorder.observe()
        else:
            require_closed(plant, self.timeline.time(tick))

    def _measure(self, time: float) -> TickInputs:
        """Return what a controller gets at a time, without messages."""
        references, target, squeeze, plan = self._desired(time)
        if plan is not None:
            self.sensing.follow(plan)
        plant, signals = self.plant, next(self._signals)
        if self._applied is None:
            measured = self.sensing.start(plant.q, plant.v, references, signals.sensors)
        else:
            measured = self.sensing.measure(time, plant, self._applied, signals.sensors)
        for index, clock in self._references.clocks.items():
            measured[index] = measured[index]._replace(time=clock.reading(time))
        return TickInputs(measured, references, target, squeeze, signals)

    def _desired(self, time: float) -> CellReference:
        """Return what the cell is to do at a time."""
        return self._references.at(time, self.motion, self.squeeze, self.missed)

    def _heard(self, inputs: TickInputs, state: Any) -> TickInputs:
        """Return the inputs with the messages that controllers in a state exchange at this tick, once."""
        if self.exchange.network is None or inputs.measurements[0].messages is not None:
            return inputs
        exchange = partial(self.exchange.step, signals=inputs.signals.network)
        measured = heard(self.controller, inputs.measurements, inputs.references, state, exchange)
        return inputs._replace(measurements=measured)

    def _happen(self, time: float) -> None:
        """Put the plant into the surroundings that the events at a time make."""
        self.recorder.observe()  # in the surroundings until now
        after = self.timeline.just_after(time)
        self.plant.surround(self.scenario.surroundings_at(after))
        for event in self.scenario.events:
            if abs(event.instant - time) <= after - time:
                missed = event.act(self.plant, list(self.scenario.cell.arms))
                self.missed += () if missed is None else (missed,)

    # ------------------------------------------------------------ state

    def state(self) -> RunState:
        """Return the state of the run, from which ``restore`` makes it go on with the same bits."""
        return RunState(
            scenario=self.scenario,
            ticks_done=self.ticks_done,
            controller=self.controller,
            controller_state=copied(self.controller_state),
            law_memory=LawMemory.of(self.controller),
            motion=self.motion,
            squeeze=self.squeeze,
            missed=self.missed,
            replaced=self._replaced,
            inputs=self._inputs,
            applied=self._applied,
            plant=self.plant.state(),
            sensing=self.sensing.state,
            actuation=self.actuation.memory(),
            record=self.recorder.state(),
            network=self.exchange.state,
        )

    def restore(self, state: RunState) -> None:
        """Return to a state of this run, or of another that differs in events, seed or laws only.

        Attributes of a user's law come back, too; a ScenarioWarning names what cannot: files, generators, and
        what it has changed in its class or module.

        Raises:
            WrongTypeError: the state, or a field of it, is of another class.
            ArgumentError: the state is of a run with another cell, plant, clock, sensors or drives.
        """
        require_type("state", state, RunState)
        state.require_of(self._start.scenario)
        is_under_way = self.ticks_done > 0
        self.scenario, self.ticks_done = state.scenario, state.ticks_done
        self.controller, self.controller_state = state.controller, copied(state.controller_state)
        kept = state.law_memory.restore(self.controller) if state.law_memory else []
        if kept and is_under_way:
            text = f"not brought back to t = {self.time:g} s: {', '.join(kept)}; keep it in the law's state"
            warnings.warn(text, ScenarioWarning, stacklevel=3)
        self.motion, self.squeeze, self._replaced = state.motion, state.squeeze, state.replaced
        self._inputs, self._applied, self.missed = state.inputs, state.applied, state.missed
        self._schedule()
        self.plant.restore(state.plant)
        self.actuation.restore(state.actuation)
        self.sensing.state, self.exchange.state = state.sensing, state.network
        self._signals = self._signals_again(self.ticks_done + (self._inputs is not None))
        self.recorder.restore(state.record, self.scenario)

    __setstate__ = restore
