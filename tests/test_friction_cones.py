"""Least squeeze within friction cones: closed forms, cutting planes, and what runs say of friction."""

import numpy as np
import pinocchio as pin
import pytest
import scipy.optimize
from cells import catalogue_cell, random_velocity
from numpy.testing import assert_allclose
from test_inverse_dynamics import cell_of, random_tau

import coop_pin as cp
from coop_pin.chain import CellChain, friction_cones
from coop_pin.errors import ArgumentError
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


def cutting_planes(cost, cones):
    """A lower bound by linear programs: a plane for every cone that the last solution is outside of."""
    rows, ends, x = [], [], np.zeros(len(cost))

    def cut(i, direction):
        rows.append(direction @ cones.S[i] - cones.n[i])
        ends.append(cones.n_0[i] - direction @ cones.s[i])

    for i in range(len(cones.n)):
        for direction in (*np.eye(6), *-np.eye(6)):
            cut(i, direction)
    tight = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    for _ in range(50):
        x = scipy.optimize.linprog(cost, np.array(rows), np.array(ends), bounds=(None, None), options=tight).x
        side = cones.S @ x + cones.s
        length = np.linalg.norm(side, axis=1)
        outside = np.flatnonzero(length - cones.n @ x - cones.n_0 > 1e-7)
        if not outside.size:
            break
        for i in outside:
            cut(i, side[i] / length[i])
    return cost @ x


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
        x, _ = friction_cones._least(cost, cones)
        assert_allclose(cost @ x, cutting_planes(cost, cones), rtol=1e-6)


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
    assert np.hypot(use.force, use.torsion).max() < 1.0 + 1e-7  # the ellipsoid
    assert use.used.max() < 1.09  # the limit surface of nine points is up to 8 % inside


def test_what_friction_cannot_hold_is_told():
    cell, start = catalogue_cell("two-pandas-box")  # grasped from above
    pads = {name: cp.Pad(mu=MU, radius=RADIUS) for name in cell.arms}
    plant = CellChain(cell.replace(pads=pads))
    q, still = plant.configuration(start), np.zeros(14)
    with pytest.raises(ArgumentError, match="holds no such motion"):
        plant.least_squeeze(q, still, still)
