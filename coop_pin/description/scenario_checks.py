"""Checks of a scenario across its fields: parts against the run, the plant, and messages of wrenches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import check_arm_names, unknown_arms
from coop_pin.control import CellTiming
from coop_pin.control.bounds import ForcePath, SampledWrist
from coop_pin.description.cell.cell import Cell
from coop_pin.description.controller import Controller
from coop_pin.description.grasp_events import GraspEvent, sequence_problems
from coop_pin.description.log_table import LogTable
from coop_pin.description.network import Network
from coop_pin.description.plant import Clock, PlantOptions
from coop_pin.description.sensors import WristSensor
from coop_pin.reference.squeeze import SqueezeReference

_OF_THE_RUN = ("duration", "cell", "clock")
"""Fields against which others are checked."""


def check_arms(value: Mapping[str, Any] | LogTable | SqueezeReference, cell: Cell) -> None:
    """Refuse a field that does not name the arms of the cell, or asks joints for what they do not transmit.

    Args:
        value: a table by arm, the topics of a log, or a squeeze.
        cell: the cell.

    Raises:
        FieldError: with the arm.
    """
    match value:
        case LogTable():
            check_arm_names(value.arms, cell.arms, "arms")
            check_arm_names(value.shares or value.arms, cell.arms, "shares")
        case SqueezeReference():
            value.check_arms(cell.grasps)
            if cell.jointed:
                cell.require_transmitted(value.at(0.0, cell.grasps))
        case _:
            check_arm_names(value, cell.arms)


def controller_problems(controller: Controller, earlier: Mapping[str, Any]) -> list[FieldError]:
    """Return what is wrong with a controller for the arms of the cell, unless gains may be beyond bounds.

    Args:
        controller: the controller.
        earlier: fields that are validated; without a cell, nothing is checked.
    """
    if "cell" not in earlier or earlier.get("beyond_bound"):
        return []
    cell = earlier["cell"]
    if cell.driven and {"model", "regressor"} & {*controller.needs}:
        moved = f"computes with models of arms that do not move, and the cell has {[*cell.driven]}"
        return [FieldError(f"is {controller.kind!r}, which {moved}; choose 'payload-space'", "kind")]
    return list(controller.problems(CellTiming(list(cell.arms), cell.task_rows.size)))


def part_problems(name: str, value: Any, earlier: Mapping[str, Any]) -> list[FieldError]:
    """Return what is wrong with the times and arms of a field's parts.

    Args:
        name: name of the field.
        value: part of it, a table of parts by arm, several parts in a tuple, or None.
        earlier: fields that are validated; what has mistakes is not there, and nothing is checked by it.
    """
    run = {field: earlier[field] for field in _OF_THE_RUN if field in earlier}
    problems = list[FieldError]()
    if isinstance(value, dict) and "cell" in run:
        problems += unknown_arms(value, run["cell"].arms)
    for path, part in _parts(value).items():
        problems += [problem.below(path) for problem in part.timing_problems(run)]
    if name == "events" and "cell" in run and not problems:
        problems += sequence_problems(run["cell"], value)
    return problems


def _parts(value: Any) -> dict[str, Any]:
    """Return the values of a field by their path within it."""
    if value is None:
        return {}
    if isinstance(value, tuple):
        return {str(index): part for index, part in enumerate(value)}
    return value if isinstance(value, dict) else {"": value}


def check_plant(cell: Cell, plant: PlantOptions, events: Sequence[GraspEvent]) -> None:
    """Refuse a plant that cannot integrate the grasps of a cell, or cannot open and close them.

    Raises:
        FieldError: the integrator has no known stable step, or the payload is welded.
    """
    if cell.has_force_elements and plant.integrator != "rk4":
        detail = f"is {plant.integrator!r}; compliant grasps, patches and tables need 'rk4', whose"
        detail += " stable step is known"
        raise FieldError(detail, "plant.integrator")
    rigid = [event.arm for event in events if event.arm not in cell.unclosed]
    if rigid and plant.payload != "free":
        detail = f"is {plant.payload!r}; the rigid grasp of {rigid[0]!r} opens or closes, and the"
        raise FieldError(f"{detail} payload must be 'free' for it: a weld does not open", "plant.payload")


def needs_messages(path: ForcePath) -> bool:
    """Whether a force path forms internal wrenches by messages between the arms."""
    return path.measures and not path.by_sensors


def check_force_path(
    path: ForcePath,
    clock: Clock,
    duration: float,
    wrists: Mapping[str, WristSensor | None],
    network: Network | None,
) -> None:
    """Refuse a force path that is later than the run is long, or whose internal wrenches no message brings.

    Args:
        path: force path.
        clock: control rate.
        duration: duration of the run, s.
        wrists: wrist sensor of each arm, or None.
        network: network between the arms.

    Raises:
        FieldError: the delay is too long, or network, wrist sensors or edges are missing.
    """
    for late in clock.late(path.delay, duration, "controller.force_path.delay"):
        raise late
    arms, missing = list(wrists), ""
    if not needs_messages(path):
        return
    if network is None:
        missing = "the scenario has no network; give it one"
    elif without := [arm for arm in arms if wrists[arm] is None]:
        missing = f"the arms {without} have no wrist sensor; give every arm one: sensors.wrist"
    elif path.hears_all and len(network.edges_at(0.0, arms)) < len(arms) * (len(arms) - 1):
        missing = "some arms do not hear all others; network.graph must be 'all'"
    if missing:
        raise FieldError(f"is {path.kind!r}, but {missing}", "controller.force_path.kind")


def sampled_wrists(
    wrists: Mapping[str, WristSensor | None], clock: Clock, network: Network | None
) -> list[SampledWrist]:
    """Return delay and sampling of the wrist sensors, ticks, with that of messages.

    Args:
        wrists: wrist sensor of each arm, or None.
        clock: control rate.
        network: network by which the wrenches reach the arms; None if they need none.
    """
    late, every = 0, 1
    if network is not None:
        late, every = network.slowest_of(list(wrists)), clock.ticks_between(network.rate_hz)
    return [
        SampledWrist(wrist.delay + late, max(every, clock.ticks_between(wrist.rate_hz)))
        for wrist in wrists.values()
        if wrist is not None
    ]
