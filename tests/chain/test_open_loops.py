"""Dynamics at configurations whose loop is open: refused with the number, or allowed as stated."""

import numpy as np
import pinocchio as pin
import pytest
from cells import cell_and_start
from linkages import bar, robot

from coop_pin.base.errors import OpenClosureError
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain


def parallelogram():
    """A four-bar of 1 m rods of 1 kg, gravity along -y, and its joints at a crank of 60 degrees."""
    rods = (
        bar("crank", "ground", (0, 0, 0)),
        bar("coupler", "crank", (1, 0, 0)),
        bar("rocker", "ground", (1, 0, 0)),
    )
    ends = '<link name="A"/><joint name="a" type="fixed"><parent link="coupler"/><child link="A"/>{0}</joint>'
    ends += '<link name="B"/><joint name="b" type="fixed"><parent link="rocker"/><child link="B"/>{0}</joint>'
    chain = ClosedChain.from_urdf(
        robot(*rods, ends.format('<origin xyz="1 0 0"/>')),
        [Closure("A", "B", "point")],
        gravity=(0.0, -9.81, 0.0),
    )
    angle = np.pi / 3
    angles = {"crank_pin": angle, "coupler_pin": -angle, "rocker_pin": angle}
    return chain, angles


def test_a_hand_typed_configuration_is_refused_with_its_opening():
    """2 g cos 60 degrees by virtual work: the closed mechanism needs 9.81 N m; an open one had 12.20."""
    chain, angles = parallelogram()
    q, rest = chain.configuration(angles), np.zeros(3)
    torque = chain.inverse_dynamics(q, rest, rest, motors=["crank_pin"]).torque
    np.testing.assert_allclose(np.abs(torque).max(), 9.81, rtol=1e-9)
    opened = chain.configuration(angles | {"coupler_pin": 0.5 - np.pi / 3})
    with pytest.raises(OpenClosureError) as caught:
        chain.inverse_dynamics(opened, rest, rest, motors=["crank_pin"])
    assert caught.value.distance == pytest.approx(2.0 * np.sin(0.25), rel=1e-9)
    assert "assemble" in str(caught.value)
    closed = chain.assemble(opened).q  # what the message says
    assert np.isfinite(chain.inverse_dynamics(closed, rest, rest, motors=["crank_pin"]).torque).all()


def mechanism_of(name):
    if name == "parallelogram":
        chain, angles = parallelogram()
        return chain, chain.configuration(angles)
    cell, start = cell_and_start(name)
    plant = CellChain(cell, PlantOptions(payload="free"))
    return plant.mechanism, plant.configuration(start)


@pytest.mark.parametrize("name", ["parallelogram", "planar", "spatial"])
def test_every_method_with_dynamics_refuses_an_open_loop_and_none_that_closes_it(name):
    chain, q = mechanism_of(name)
    rest = np.zeros(chain.model.nv)
    rates = np.zeros(chain.model.nv)
    rates[1] = 0.5
    opened = pin.integrate(chain.model, q, rates)
    methods = {
        "forward_dynamics": lambda q: chain.forward_dynamics(q, rest, rest),
        "inverse_dynamics": lambda q: chain.inverse_dynamics(q, rest, rest),
        "derivatives": lambda q: chain.derivatives(q, rest, rest),
        "reduced_dynamics": lambda q: chain.reduced_dynamics(q, rest),
        "minimal_coordinates": chain.minimal_coordinates,
        "linearise": lambda q: chain.linearise(q, rest, rest),
        "integrate": lambda q: chain.integrate(q, rest, duration=0.01, step=1e-3),
    }
    for method in methods.values():
        with pytest.raises(OpenClosureError) as caught:
            method(opened)
        assert max(caught.value.distance, caught.value.angle) > 1e-2
    assert chain.forward_dynamics(chain.assemble(opened).q, rest, rest).residual < 1e-6
    assert chain.project_velocity(opened, rest).shape == rest.shape
    assert chain.closure_errors(opened)
    chain.open_allowed = 10.0
    assert chain.forward_dynamics(opened, rest, rest).acceleration.shape == rest.shape


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_wrenches_of_a_cell_refuse_an_open_loop(name):
    cell, start = cell_and_start(name)
    plant = CellChain(cell)
    q, rest = plant.configuration(start), np.zeros(plant.mechanism.model.nv)
    assert plant.interaction_wrenches(q, rest, rest).shape == (2, 6)
    with pytest.raises(OpenClosureError):
        plant.interaction_wrenches(pin.integrate(plant.mechanism.model, q, rest + 0.01), rest, rest)
