"""Closed forms of mechanisms without drives: arch, four-bar, hanging chain, and the first mode of a beam."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from linked_cells import hanging_rope, linked
from scipy.optimize import brentq
from scipy.special import jn_zeros

import coop_pin as cp
from coop_pin.grasps import CellChain

G = 9.81
PINNED = (True, True, False, False, False, False)


def rods(lengths, mass: float, inertia: float | None = None) -> tuple[pin.Model, int, pin.SE3]:
    """Rods in the plane x, y that turn about z at their starts; gravity along -y."""
    model, parent, X = pin.Model(), 0, pin.SE3.Identity()
    model.gravity = pin.Motion(np.array((0.0, -G, 0.0)), np.zeros(3))
    for index, length in enumerate(lengths):
        parent = model.addJoint(parent, pin.JointModelRZ(), X, f"rod{index}")
        turn = mass * length**2 / 12.0 if inertia is None else inertia
        body = pin.Inertia(mass, np.array((length / 2.0, 0.0, 0.0)), np.diag((1e-6, turn, turn)))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        X = pin.SE3(np.eye(3), np.array((length, 0.0, 0.0)))
    return model, parent, X


def pinned(model: pin.Model, parent: int, X: pin.SE3, point) -> cp.ClosedChain:
    """The end of the last rod pinned to a point of the world; wrenches are on the world in its axes."""
    model.addFrame(pin.Frame("end", parent, 0, X, pin.FrameType.OP_FRAME))
    X_WC = pin.SE3(np.eye(3), np.array((*point, 0.0))).homogeneous
    return cp.ClosedChain(model, [cp.Closure("world", "end", PINNED, X_AC=X_WC)], formulation="kkt")


def test_three_hinge_arch_has_the_thrust_of_its_closed_form():
    """H = m g a / (2 h) of two rods of mass m that rise by h over a each."""
    a, h, m = 1.3, 0.4, 2.0
    chain = pinned(*rods([np.hypot(a, h)] * 2, m), (2.0 * a, 0.0))
    q = np.array((np.arctan2(h, a), -2.0 * np.arctan2(h, a)))
    motion = chain.forward_dynamics(q, 0.0 * q, 0.0 * q)
    H, V = np.abs(motion.closure_wrenches[0][:2])
    assert np.abs(motion.acceleration).max() < 1e-11
    assert H / (m * G * a / (2.0 * h)) == pytest.approx(1.0, abs=1e-12)
    assert V / (m * G) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("motors", [1, 2])
def test_four_bar_held_by_two_arms_rests_under_the_torque_of_virtual_work(motors):
    """Crank, coupler and rocker: with two motors each bears a part of it, by its own rate."""
    th, m, base = 1.1, 1.7, 1.0
    crank, coupler, rocker = 0.5, 0.9, 0.7
    d = base - crank * np.exp(1j * th)
    al = np.angle(d) + np.arccos((abs(d) ** 2 + coupler**2 - rocker**2) / (2.0 * abs(d) * coupler))
    be = np.angle(d - coupler * np.exp(1j * al))
    da = crank / coupler * np.sin(be - th) / np.sin(al - be)
    db = crank / rocker * np.sin(th - al) / np.sin(al - be)
    rise = crank / 2.0 * np.cos(th)
    rise += crank * np.cos(th) + coupler / 2.0 * np.cos(al) * da
    rise += crank * np.cos(th) + coupler * np.cos(al) * da + rocker / 2.0 * np.cos(be) * db
    q = np.array((th, al - th, be - al))
    chain = pinned(*rods((crank, coupler, rocker), m, 0.01), (base, 0.0))
    part = 1.0 if motors == 1 else 0.3  # the motor at the base of the rocker turns it against the coupler too
    tau = np.array((part * m * G * rise, 0.0, (1.0 - part) * m * G * rise / (db - da)))
    motion = chain.forward_dynamics(q, 0.0 * q, tau)
    assert np.abs(motion.acceleration).max() < 1e-12 * m * G / 0.01


def hanging(n: int, span: float = 1.4, length: float = 2.0, mass: float = 1.0):
    """Acceleration, relative errors of H and V, and of the sag against the catenary, of n links."""
    pitch, w = length / n, mass * G / n

    def slopes(H: float) -> np.ndarray:
        return np.arctan((np.arange(n) - (n - 1) / 2.0) * w / H)

    H = brentq(lambda H: pitch * np.cos(slopes(H)).sum() - span, 1e-6, 1e4, xtol=1e-15, rtol=1e-15)
    phi = slopes(H)
    q = np.diff(phi, prepend=0.0)
    chain = pinned(*rods([pitch] * n, mass / n), (span, 0.0))
    motion = chain.forward_dynamics(q, 0.0 * q, 0.0 * q)
    force = np.abs(motion.closure_wrenches[0][:2])
    a = brentq(lambda a: 2.0 * a * np.sinh(span / 2.0 / a) - length, 0.05, 50.0, xtol=1e-15, rtol=1e-15)
    sag = -np.cumsum(pitch * np.sin(phi))[n // 2 - 1]
    errors = force / (H, mass * G / 2.0) - 1.0
    return (
        np.abs(motion.acceleration).max(),
        np.abs(errors).max(),
        sag / (a * np.cosh(span / 2.0 / a) - a) - 1.0,
    )


def test_hanging_chain_of_64_links_has_the_forces_of_its_closed_form():
    acceleration, force, _ = hanging(64)
    assert acceleration < 1e-8
    assert force < 1e-12


def test_sag_of_a_hanging_chain_is_the_catenarys_with_order_two():
    errors = [abs(hanging(n)[2]) for n in (8, 16, 32)]
    assert np.allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.1)


def first_mode(links: int, ends: int, EI: float = 3.0, mass: float = 2.0, length: float = 1.5) -> float:
    """First circular frequency of Payload.beam, clamped at one end or both, over Euler's, minus 1."""
    payload = cp.Payload.beam(mass, length, EI, links=links, section=(1e-4, 0.05), axis="z")
    model = pin.buildModelFromXML(payload.links.text)
    model.gravity.linear = np.zeros(3)
    data, n = model.createData(), model.nv
    M = pin.crba(model, data, np.zeros(n))
    M, K, N = np.triu(M) + np.triu(M, 1).T, np.diag([payload.links.joint("hinge1").stiffness] * n), np.eye(n)
    if ends == 2:
        frame = model.getFrameId(f"rod{links - 1}")
        J = pin.computeFrameJacobian(model, data, np.zeros(n), frame, pin.LOCAL_WORLD_ALIGNED)
        N = np.linalg.svd(J[[1, 5]])[2][2:].T
    w = np.sqrt(np.linalg.eigvals(np.linalg.solve(N.T @ M @ N, N.T @ K @ N)).real.min())
    return w / ((1.8751040687, 4.7300407449)[ends - 1] ** 2 * np.sqrt(EI * length / mass / length**4)) - 1.0


@pytest.mark.parametrize(("ends", "allowed"), [(1, 3e-3), (2, 1.5e-2)])
def test_first_mode_of_a_beam_of_rods_is_eulers_with_order_two(ends, allowed):
    assert abs(first_mode(16, ends)) < allowed
    errors = [first_mode(n, ends) for n in (9, 17, 33)]  # the distance of hinges halves
    assert np.allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.1)


@pytest.mark.gate
def test_a_beam_between_two_arms_has_the_first_mode_of_a_clamped_one():
    """What ``check`` looks at: the payload in still grasps at its ends, 33 rods, without gravity."""
    fields = {"mass": 2.0, "length": 0.4, "bending_stiffness": 20.0, "links": 33, "damping_time": 0.0}
    scenario = linked("two-pandas-box", "beam")
    cell = scenario.cell.model_dump() | {"payload": {"kind": "beam", "section": (0.1, 1e-3), **fields}}
    cell["grasps"]["right"]["link"], cell["gravity"] = "rod32", (0.0, 0.0, 0.0)
    chain = CellChain(cp.Cell(**cell), scenario.plant)
    poles, _ = chain.payload_modes(chain.configuration(scenario.start.matrix))
    exact = 4.7300407449**2 * np.sqrt(20.0 * 0.4 / 2.0 / 0.4**4)
    assert poles.imag[poles.imag > 0.0].min() / exact == pytest.approx(1.0, abs=3e-3)


def test_a_rope_that_hangs_from_a_hand_has_bessels_first_mode():
    """w = (j_01 / 2) (g / L)^(1/2), with L from the first hinge on: that of half a rod is at the hand."""
    scenario = hanging_rope()
    chain = CellChain(scenario.cell, scenario.plant)
    q = chain.configuration(scenario.start.matrix)
    assert np.abs(chain.joints.positions(q)).max() < 1e-9
    poles, _ = chain.payload_modes(q)
    exact = jn_zeros(0, 1)[0] / 2.0 * np.sqrt(G / (0.4 - 0.4 / 8 / 2))
    assert poles.imag[poles.imag > 0.0].min() / exact == pytest.approx(1.0, abs=3e-3)
