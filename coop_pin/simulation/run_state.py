"""State of a run, from which it goes on bit for bit."""

from __future__ import annotations

import copy
import functools
from types import UnionType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from coop_pin.base.arrays import Array, as_count, require_type
from coop_pin.base.errors import ArgumentError
from coop_pin.control import CellController
from coop_pin.control.law_memory import LawMemory
from coop_pin.description.grasp_events import MissedGrasp
from coop_pin.description.scenario import Scenario
from coop_pin.reference.pose_reference import PoseReference
from coop_pin.reference.squeeze import SqueezeReference
from coop_pin.simulation.devices.actuation import ActuationState
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.devices.network import NetworkState
from coop_pin.simulation.devices.sensing import SensingState
from coop_pin.simulation.plant import PlantState
from coop_pin.simulation.recorder import RecordState
from coop_pin.simulation.tick import TickInputs


class RunState(NamedTuple):
    """All that a run has become by a tick: values, which can be pickled if those of the controller can.

    It holds a copy of the record, 1 to 4 kB a tick. Random numbers are those of the scenario's seed, counted
    by ticks. Of a user's law it holds the attributes, too.

    Attributes:
        scenario: the scenario, with the events added and the seed.
        ticks_done: ticks recorded.
        controller: the controller.
        controller_state: state that it returned last.
        law_memory: attributes of a user's law; None of the package's laws.
        motion: the desired motion.
        squeeze: the desired internal wrenches.
        missed: grasps that did not happen.
        replaced: sentences for the result's summary on what was replaced.
        inputs: inputs of a tick that was observed and is not done yet.
        applied: torques of the last tick.
        plant: motion and held forces.
        sensing: memory of the sensors; None before the first tick.
        actuation: memory of the drives.
        record: samples so far.
        network: memory of the network; None before the first messages.
    """

    scenario: Scenario
    ticks_done: int
    controller: CellController
    controller_state: Any
    law_memory: LawMemory | None
    motion: PoseReference
    squeeze: SqueezeReference
    missed: tuple[MissedGrasp, ...]
    replaced: tuple[str, ...]
    inputs: TickInputs | None
    applied: Applied | None
    plant: PlantState
    sensing: SensingState | None
    actuation: ActuationState
    record: RecordState
    network: NetworkState | None

    def require_of(self, scenario: Scenario) -> None:
        """Refuse a state of a run that differs from a scenario in more than events, seed and laws.

        Raises:
            WrongTypeError: a field is of another class than it states.
            ArgumentError: the run does.
        """
        for field, kind in _kinds().items():
            require_type(f"state.{field}", getattr(self, field), *kind)
        if as_count("state.ticks_done", self.ticks_done) and self.sensing is None:
            raise ArgumentError(
                "the state is that of a run under way without its sensors; take one of state()"
            )
        mine = self.scenario
        for name, has, needed in (
            ("cell", mine.cell, scenario.cell),
            ("plant", mine.plant, scenario.plant),
            ("clock", (mine.clock, mine.duration), (scenario.clock, scenario.duration)),
            ("actuators", (mine.actuators, mine.arm_actuators), (scenario.actuators, scenario.arm_actuators)),
            ("sensors", (mine.sensors, mine.arm_sensors), (scenario.sensors, scenario.arm_sensors)),
            ("network", mine.network, scenario.network),
            ("force path", mine.controller.force_path, scenario.controller.force_path),
        ):
            if has != needed:
                raise ArgumentError(
                    f"the state is of a run with another {name}; make a Simulation of its scenario"
                )


@functools.cache
def _kinds() -> dict[str, tuple[type, ...]]:
    """Return the classes of the fields that state them, by name."""
    hints = get_type_hints(RunState)
    parts = {name: get_args(hint) if isinstance(hint, UnionType) else (hint,) for name, hint in hints.items()}
    kinds = {name: tuple(get_origin(part) or part for part in of) for name, of in parts.items()}
    return {name: of for name, of in kinds.items() if Any not in of}


def copied(state: Any) -> Any:
    """Return a copy of a law's state, as laws may change arrays in place; what cannot be copied, itself."""
    try:
        return _plain_copy(state, {})
    except TypeError:
        pass
    try:
        return copy.deepcopy(state)
    except Exception:  # of a user's class, such as one that holds a file
        return state


def _plain_copy(tree: Any, copies: dict[int, Array]) -> Any:
    """Return a copy of nested tuples of numbers and arrays; ``copy.deepcopy`` takes five times as long.

    Args:
        tree: the state of a law of the package, for example.
        copies: copies of arrays by the identity of these: what is one array stays one.

    Raises:
        TypeError: something else is in it.
    """
    kind = type(tree)
    if kind is np.ndarray and tree.dtype == np.float64:
        if id(tree) not in copies:
            copies[id(tree)] = tree.copy(order="K")
        return copies[id(tree)]
    if tree is None or kind in (float, int, bool, str, np.float64):
        return tree
    if kind is tuple:
        return tuple([_plain_copy(part, copies) for part in tree])
    if issubclass(kind, tuple) and hasattr(kind, "_make") and not hasattr(tree, "__dict__"):
        return kind._make([_plain_copy(part, copies) for part in tree])
    raise TypeError
