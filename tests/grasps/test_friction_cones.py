"""Least squeeze within friction cones: closed forms, cutting planes, and what runs say of friction."""

import numpy as np
import pinocchio as pin
import pytest
from cells import catalogue_cell, random_velocity
from chain_cells import cell_of, random_tau
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import ArgumentError
from coop_pin.grasps import CellChain, friction_cones
from coop_pin.results.friction import friction_use

MU, RADIUS = 0.6, 0.04
CELLS = ["planar", "spatial", "planar-three", "kinova-pair", "three-ur5-plate", "three-ur5-far"]


def pressed(cell):
    """The cell with round pads that press along the axis of each grasp nearest to P."""
    pads = {}
    for name in cell.arms:
        X = cell.grasps[name].matrix
        way = -X[:3, :3].T @ X[:3, 3]
        k = int(np.abs(way).argmax())
        pads[name] = cp.Pad(mu=MU, radius=RADIUS, press=("" if way[k] > 0.0 else "-") + "xyz"[k])
    return cell.replace(pads=pads)


def plant_of(name):
    cell, start = cell_of(name)
    plant = CellChain(pressed(cell))
    q = plant.configuration(start)
    return plant, q, np.zeros(plant.mechanism.model.nv)


def test_two_palms_need_the_weight_over_twice_the_friction():
    plant, q, still = plant_of("kinova-pair")
    squeeze = plant.least_squeeze(q, still, still)
    weight = plant.cell.payload.mass * np.linalg.norm(plant.cell.gravity)
    assert_allclose(squeeze.normal, weight / (2.0 * MU), rtol=1e-9)
    assert_allclose(squeeze.internal.sum(axis=0), 0.0, atol=1e-9)


def test_planar_palms_bear_the_moment_of_their_shares_of_the_weight():
    """Half of the weight at P bends a pad at the distance d: N r >= W d / 2."""
    plant, q, still = plant_of("planar")
    payload, d = plant.cell.payload, abs(plant.cell.grasps["left"].xyz[0])
    weight = payload.mass * np.linalg.norm(plant.cell.gravity)
    bending = 0.5 * weight * d / (2.0 / 3.0 * RADIUS)
    assert_allclose(plant.least_squeeze(q, still, still).normal, max(bending, weight / (2.0 * MU)), rtol=1e-9)


def dual_bound(cost, cones, x):
    """A lower bound of the cost by weak duality, and what is left of its equation.

    With |u_i| <= l_i and sum_i S_i^T u_i + l_i n_i = cost, no x inside the cones costs less than
    - sum_i u_i . s_i + l_i n_0i. On a path of barriers u = -k side / f and l = k axis / f.
    """
    side, axis = cones.S @ x + cones.s, cones.n @ x + cones.n_0
    f = axis**2 - (side**2).sum(axis=1)
    u, lengths = -side / f[:, None], axis / f
    made = np.einsum("cki,ck->i", cones.S, u) + lengths @ cones.n
    k = (cost @ cost) / (made @ cost)
    assert (np.linalg.norm(u, axis=1) <= lengths).all()
    return -k * ((u * cones.s).sum() + lengths @ cones.n_0), k * made - cost


@pytest.mark.parametrize("name", CELLS)
def test_no_squeeze_is_less(name, monkeypatch):
    programs = []
    monkeypatch.setattr(
        friction_cones,
        "_least",
        lambda *program, least=friction_cones._least: programs.append(program) or least(*program),
    )
    plant, q, still = plant_of(name)
    v = 0.3 * random_velocity(plant.mechanism, q, 4)
    a = plant.mechanism.forward_dynamics(q, v, random_tau(plant.mechanism)).acceleration
    for state in ((still, still), (v, a)):
        plant.least_squeeze(q, *state)
        cost, cones = programs[-1]
        found, _ = friction_cones._least(cost, cones)
        with monkeypatch.context() as farther:
            farther.setattr(friction_cones, "_GAP", 1e-5)  # nearer to the cones, f is rounding
            x, _ = friction_cones._least(cost, cones)
        least, left = dual_bound(cost, cones, x)
        assert_allclose(left, 0.0, atol=1e-3 * np.abs(cost).max())
        assert_allclose((cost @ x, cost @ found), least, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("name", CELLS)
def test_the_torques_of_the_least_squeeze_use_all_friction_and_no_more(name):
    """Through forward dynamics and what a run says of friction; rows that no torque moves are the load's."""
    plant, q, _ = plant_of(name)
    chain, cell = plant.mechanism, plant.cell
    v = 0.3 * random_velocity(chain, q, 4)
    a = chain.forward_dynamics(q, v, random_tau(chain)).acceleration
    v, a = np.array([0.0 * v, v]), np.array([0.0 * a, a])
    q = np.array([q, q])
    squeeze = plant.least_squeeze(q, v, a)
    torque = plant.inverse_dynamics(q, v, a, internal=squeeze.internal).torque
    for k in range(2):
        again = chain.forward_dynamics(q[k], v[k], torque[k]).acceleration
        assert_allclose(again, a[k], rtol=0, atol=1e-9 * (1.0 + np.abs(a).max()))
    F = np.array([plant.inverse_dynamics(*state).interaction_wrench for state in zip(q, v, a, strict=True)])
    load = cell.shares[:, None] * F.sum(axis=1)[:, None, :]
    quaternion = [pin.Quaternion(plant.payload_pose(each)[:3, :3]).coeffs() for each in q]
    data = {
        "time": np.arange(2.0),
        "interaction_wrench": load + squeeze.internal,
        "payload_quaternion": np.array(quaternion),
    }
    use = friction_use(data, cell)
    assert_allclose(use.normal, squeeze.normal, rtol=1e-9, atol=1e-9)
    assert use.used.max() < 1.0 + 1e-6


def test_what_friction_cannot_hold_is_told():
    cell, start = catalogue_cell("two-pandas-box")  # grasped from above
    pads = {name: cp.Pad(mu=MU, radius=RADIUS) for name in cell.arms}
    plant = CellChain(cell.replace(pads=pads))
    q, still = plant.configuration(start), np.zeros(14)
    with pytest.raises(ArgumentError, match="holds no such motion"):
        plant.least_squeeze(q, still, still)
