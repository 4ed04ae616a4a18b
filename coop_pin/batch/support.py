"""Which scenarios can run in a batch, and why others cannot."""

from __future__ import annotations

from coop_pin.batch.cell_dynamics import CellModel
from coop_pin.chain.cell_chain import CellChain
from coop_pin.description.controller import UserController
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError


def support(scenario: Scenario) -> str | None:
    """Return None if a scenario can run in a batch, otherwise the reason why it cannot.

    Raises:
        CoopPinError: the scenario's cell cannot be built.
    """
    plant, controller = scenario.plant, scenario.controller
    if isinstance(controller, UserController):
        return f"its controller {controller.target!r} is not one of coop_pin's laws"
    if plant.payload != "welded":
        return "its plant has a free payload; the traced one has it welded to the first arm"
    if plant.integrator != "rk4" or plant.project != "start":
        chosen = f"integrator {plant.integrator!r} and project {plant.project!r}"
        return f"its plant has {chosen}; the traced one has 'rk4' and 'start'"
    try:
        CellModel.from_chain(CellChain(scenario.cell, plant))
    except TracingError as error:
        return str(error)
    return None
