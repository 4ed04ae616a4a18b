"""A plant is an interface: sensors, drives, events, recorder, metrics and stepping ask its members alone."""

import numpy as np
import pytest
from test_stepping import EVERYTHING, disturbed, finished, short, stepped

import coop_pin as cp
from coop_pin.compiled.plant.compiled_plant import CompiledPlant
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import Plant

MEMBERS = {name for name in vars(Plant) if not name.startswith("_")}


class MembersAlone:
    """A plant with the members of ``Plant``, and nothing else."""

    def __init__(self, *start):
        self._inner = PinocchioPlant(*start)

    def __getattr__(self, name):
        if name not in MEMBERS:
            raise AttributeError(name)
        return getattr(self._inner, name)


def test_both_plants_have_every_member_and_share_no_method():
    plants = [stepped(short("planar", 0.1), 0, plant).plant for plant in (PinocchioPlant, CompiledPlant)]
    assert all({*dir(plant)} >= MEMBERS for plant in plants)
    assert PinocchioPlant not in CompiledPlant.__mro__
    assert len(MEMBERS) <= 21


@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param(lambda: short("planar", 0.2).override(EVERYTHING), id="planar, all sensors and drives"),
        pytest.param(
            lambda: short("spatial", 0.2).override(EVERYTHING), id="spatial, all sensors and drives"
        ),
        *(
            pytest.param(lambda name=name: disturbed(name), id=name)
            for name in ("human-partner", "pick-carry-place")
        ),
    ],
)
def test_a_run_asks_the_members_alone(scenario):
    scenario = scenario()
    expected = finished(stepped(scenario, 0))
    run = stepped(scenario, 3, MembersAlone)
    state = run.state()
    assert finished(run).identical(expected)
    run.restore(state)
    assert finished(run).identical(expected)
    result = cp.simulate(scenario, build_controller(scenario), plant=MembersAlone)
    assert result.data.identical(expected)
    np.testing.assert_equal(result.metrics(), cp.RunResult(scenario, expected).metrics())
