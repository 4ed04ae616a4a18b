"""Model of a scenario for MuJoCo, as a file."""

from __future__ import annotations

from pathlib import Path

from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import FieldError
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.mujoco_plant import cell_mjcf, unlike_plant
from coop_pin.simulation.simulation import Simulation


def write_mjcf(scenario: Scenario, file: Path) -> None:
    """Write the cell of a scenario as MJCF, with its start as key frame "start" and its integration step.

    Drives, friction, springs between links of a payload, sensors and law are not in it. It is written without
    MuJoCo, and replaces a former file.

    Args:
        scenario: Scenario whose grasps do not give.
        file: File to write.

    Raises:
        FieldError: MuJoCo does not have a grasp, an arm or the payload as it is.
        CoopPinError: the scenario cannot start.
    """
    if text := unlike_plant(scenario.cell, scenario.plant):
        raise FieldError(f"is 'mjcf', which does not have this: {text}", "--to")
    simulation, clock = Simulation(scenario, build_controller(scenario)), scenario.clock
    step = clock.period / clock.steps_per_tick
    text = cell_mjcf(simulation.chain, scenario.plant, step, simulation.plant.q)
    write_atomically(file, lambda part: part.write_text(text, encoding="utf-8"))
