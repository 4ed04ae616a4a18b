"""Least squeeze within friction cones: closed forms, cutting planes, and what runs say of friction."""

import numpy as np
import pinocchio as pin
import pytest
from cells import catalogue_cell, random_velocity
from chain_cells import cell_of, random_tau
from numpy.testing import assert_allclose
from scipy.optimize import linprog

import coop_pin as cp
from coop_pin.base.errors import ArgumentError
from coop_pin.grasps import CellChain
from coop_pin.results.friction import friction_use

QUICK = ["planar", "spatial", "three-ur5-plate"]
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
    squeeze = plant.friction_squeeze(q, still, still)
    weight = plant.cell.payload.mass * np.linalg.norm(plant.cell.gravity)
    assert_allclose(squeeze.normal, weight / (2.0 * MU), rtol=1e-9)
    assert_allclose(squeeze.internal.sum(axis=0), 0.0, atol=1e-9)


def test_planar_palms_bear_the_moment_of_their_shares_of_the_weight():
    """Half of the weight at P bends a pad at the distance d: N r >= W d / 2."""
    plant, q, still = plant_of("planar")
    payload, d = plant.cell.payload, abs(plant.cell.grasps["left"].xyz[0])
    weight = payload.mass * np.linalg.norm(plant.cell.gravity)
    bending = 0.5 * weight * d / (2.0 / 3.0 * RADIUS)
    assert_allclose(
        plant.friction_squeeze(q, still, still).normal, max(bending, weight / (2.0 * MU)), rtol=1e-9
    )


def least_by_planes(plant, q, v, a):
    """The least sum of N_i, from below: planes around the cones, each cut where the solution is outside.

    x are wrenches f_i about P in world axes that sum to zero, in rows that are determinate, and frictions of
    the points of every pad.
    """
    cell, X_WP = plant.cell, plant.payload_pose(q)
    rows = np.flatnonzero(plant.rigid.determinate_rows(q))
    resultant = plant.inverse_dynamics(q, v, a).interaction_wrench.sum(axis=0)
    arms, m, k = list(cell.arms), len(cell.arms), [len(cell.pads[name].points) for name in cell.arms]
    first = np.cumsum([len(rows) * m, *(2 * n for n in k)])
    equal, right, cones, cost, constant = [], [], [], np.zeros(first[-1]), 0.0
    for row in range(len(rows)):
        equal.append(np.zeros(first[-1]))
        equal[-1][row : len(rows) * m : len(rows)] = 1.0
        right.append(0.0)
    for i, name in enumerate(arms):
        pad, X = cell.pads[name], pin.SE3(X_WP @ cell.grasps[name].matrix @ cell.pads[name].plane)
        about_P = pin.SE3(X.rotation, X.translation - X_WP[:3, 3])
        to_pad = np.array([about_P.actInv(pin.Force(unit)).vector for unit in np.eye(6)]).T
        load, of_f = to_pad @ (cell.shares[i] * resultant), np.zeros((6, first[-1]))
        of_f[:, len(rows) * i : len(rows) * (i + 1)] = to_pad[:, rows]
        taus = np.zeros((k[i], 2, first[-1]))
        taus[:, 0, first[i] : first[i + 1] : 2] = taus[:, 1, first[i] + 1 : first[i + 1] : 2] = np.eye(k[i])
        (x, y, _), by_taus = pad.points.T, taus.sum(axis=0)
        turning = x @ taus[:, 1] - y @ taus[:, 0]
        equal += [*(by_taus - of_f[:2]), turning - of_f[5]]
        right += [*load[:2], load[5]]
        cones += [(tau, np.zeros(2), of_f[2] * pad.mu / k[i], load[2] * pad.mu / k[i]) for tau in taus]
        cones.append((of_f[3:5] / pad.levers[:, None], load[3:5] / pad.levers, of_f[2], load[2]))
        cost += of_f[2]
        constant += load[2]
    turns = np.linspace(0.0, 2.0 * np.pi, 9)[:-1]
    cuts = [(u, cone) for cone in cones for u in np.stack((np.cos(turns), np.sin(turns)), axis=1)]
    for _ in range(60):
        planes = [(u @ S - n, n_0 - u @ s) for u, (S, s, n, n_0) in cuts]
        found = linprog(cost, *zip(*planes, strict=True), np.array(equal), right, bounds=(None, None))
        sides = [S @ found.x + s for S, s, _, _ in cones]
        sizes = [float(np.linalg.norm(side)) for side in sides]
        beyond = [size - n @ found.x - n_0 for size, (_, _, n, n_0) in zip(sizes, cones, strict=True)]
        if max(beyond) < 1e-7 * found.fun:
            break
        cuts += [(sides[i] / sizes[i], cones[i]) for i in range(len(cones)) if beyond[i] > 0.0]
    return found.fun + constant


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in CELLS]
)
def test_no_squeeze_is_less(name):
    plant, q, still = plant_of(name)
    v = 0.3 * random_velocity(plant.mechanism, q, 4)
    a = plant.mechanism.forward_dynamics(q, v, random_tau(plant.mechanism)).acceleration
    for state in ((still, still), (v, a)):
        normal = plant.friction_squeeze(q, *state).normal.sum()
        assert_allclose(normal, least_by_planes(plant, q, *state), rtol=1e-6)


@pytest.mark.parametrize("name", CELLS)
def test_the_torques_of_the_least_squeeze_use_all_friction_and_no_more(name):
    """Through forward dynamics and what a run says of friction; rows that no torque moves are the load's."""
    plant, q, _ = plant_of(name)
    chain, cell = plant.mechanism, plant.cell
    v = 0.3 * random_velocity(chain, q, 4)
    a = chain.forward_dynamics(q, v, random_tau(chain)).acceleration
    v, a = np.array([0.0 * v, v]), np.array([0.0 * a, a])
    q = np.array([q, q])
    squeeze = plant.friction_squeeze(q, v, a)
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
    half = 0.5 * cell.payload.mass * np.linalg.norm(cell.gravity)  # that each pad would have to pull
    with pytest.raises(ArgumentError, match=f"holds no such motion.* lacks {half:.3g} N"):
        plant.friction_squeeze(q, still, still)
