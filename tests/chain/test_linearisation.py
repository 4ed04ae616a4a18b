"""Linear models of closed chains: closed forms, the nonlinear motion, sampling, equilibria."""

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from cells import kkt_of
from chain_cells import random_tau
from linkages import bar, four_bar, robot
from numpy.testing import assert_allclose
from test_inverse_dynamics import CELLS, any_chain, linkage, plant_of

from coop_pin.base.errors import ArgumentError, OutOfRangeError
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.description.cell.closure import Closure

PENDULUM = """<robot name="pendulum"><link name="ground"/><link name="bob"><inertial>
<origin xyz="0.7 0 0"/><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="hinge" type="continuous"><parent link="ground"/><child link="bob"/>
<axis xyz="0 1 0"/></joint></robot>"""

SWING = np.array((1.0, -1.0, 1.0, -1.0, 1.0))


def test_a_pendulum_swings_at_its_closed_form():
    chain = ClosedChain.from_urdf(PENDULUM)
    q = chain.equilibrium(chain.configuration({"hinge": 1.2}))
    assert_allclose(chain.frame_pose(q, "bob")[:3, 0], (0.0, 0.0, -1.0), atol=1e-12)
    model = chain.linearise(q, [0.0], [0.0])
    rate = np.sqrt(2.0 * 9.81 * 0.7 / (0.1 + 2.0 * 0.7**2))
    assert_allclose(model.A, ((0.0, 1.0), (-(rate**2), 0.0)), rtol=0, atol=1e-8)
    sampled = model.sampled(0.01)
    assert_allclose(np.abs(np.linalg.eigvals(sampled.A)), 1.0, rtol=1e-9)
    assert_allclose(sampled.A[0, 0], np.cos(0.01 * rate), rtol=1e-9)
    assert sampled.period == 0.01


@pytest.mark.parametrize("name", ["planar", "spatial", "two-pandas-box"])
def test_the_linear_model_follows_pinocchios_derivatives(name):
    """A second formulation at rest: A_21 = S a_q N, B_2 = S a_tau, by analytic derivatives."""
    plant, q, _ = plant_of(name)
    chain = plant.mechanism
    still, tau = np.zeros(chain.model.nv), random_tau(chain)
    model, d = chain.linearise(q, still, tau), len(chain.minimal_coordinates(q).indices)
    indices, N = chain.minimal_coordinates(q)
    partial = chain.derivatives(q, still, tau)
    scale = np.abs(model.A).max()
    assert_allclose(model.A[d:, :d], (partial.acceleration_q @ N)[indices], rtol=0, atol=1e-7 * scale)
    assert_allclose(model.A[d:, d:], (partial.acceleration_v @ N)[indices], rtol=0, atol=1e-7 * scale)
    assert_allclose(model.B[d:], partial.acceleration_tau[indices], rtol=0, atol=1e-7 * np.abs(model.B).max())
    J = plant.payload_jacobian(q) @ N
    C = plant.linearise(q, still, tau).C
    assert_allclose(C, scipy.linalg.block_diag(J, J), rtol=0, atol=1e-8)


ROWS = [
    "full",
    "point",
    "planar",
    "axis",
    (True, False, False, False, False, False),
    (False, True, True, False, True, False),
]
"""Rows of a closure: all names, and two of six booleans."""


def closed_arm(rows):
    """An arm of seven skew hinges whose end is held to the world where it is."""
    rng, bars, parent = np.random.default_rng(2), [], "ground"
    for k in range(7):
        turn = rng.uniform(-1.5, 1.5, size=3)
        bars.append(bar(f"link{k}", parent, (0.4 if k else 0.0, 0.0, 0.0), turn, length=0.4))
        parent = f"link{k}"
    open_chain = ClosedChain.from_urdf(robot(*bars))
    q = rng.uniform(-1.0, 1.0, size=7)
    end = open_chain.frame_pose(q, parent)
    return ClosedChain.from_urdf(robot(*bars), [Closure(parent, "world", rows, X_BC=end)]), q


@pytest.mark.parametrize("name", [*CELLS, "bennett-point", "sarrus", *ROWS], ids=str)
def test_small_motions_end_where_the_linear_model_says(name):
    """The deviation of two neighbouring motions over 20 ms, by Runge-Kutta 4, at rest under held torques."""
    chain, q = closed_arm(name) if name in ROWS else any_chain(name)[:2]
    still = np.zeros(chain.model.nv)
    tau = chain.inverse_dynamics(q, still, still).torque
    model = chain.linearise(q, still, tau)
    indices, N = chain.minimal_coordinates(q, model.joints)
    rng = np.random.default_rng(6)
    u = 1e-3 * rng.normal(size=chain.model.nv)
    rates = 1e-4 * rng.normal(size=len(indices))

    def end(sign):
        def held(_time, _q, _v):
            return tau + sign * u

        motion = chain.integrate(q, sign * N @ rates, duration=0.02, step=1e-3, torque=held)
        return np.concatenate((pin.difference(chain.model, q, motion.q[-1])[indices], motion.v[-1][indices]))

    sampled = model.sampled(0.02)
    deviation = sampled.A @ np.concatenate((0.0 * rates, rates)) + sampled.B @ u
    assert_allclose(0.5 * (end(1.0) - end(-1.0)), deviation, rtol=0, atol=1e-6 * np.abs(deviation).max())


@pytest.mark.parametrize("name", ["planar", "spatial", "bennett-point"])
def test_formulations_have_one_linear_model(name):
    chain, q, v = any_chain(name)
    tau = random_tau(chain)
    one, other = chain.linearise(q, v, tau), kkt_of(chain).linearise(q, v, tau)
    for a, b in zip(one[:3], other[:3], strict=True):
        assert_allclose(a, b, rtol=0, atol=1e-6 * np.abs(b).max())


def test_four_bars_stand_and_hang_at_the_rate_of_their_closed_form():
    loops = 2
    chain = four_bar.four_bars(loops)
    rate = np.sqrt(four_bar.GRAVITY * ((loops + 1) / 2 + loops) / ((loops + 1) / 3 + loops))
    still = np.zeros(chain.model.nv)
    standing = four_bar.start(chain, loops)[0]
    for guess, eigenvalues in (
        (standing + 0.2 * SWING, (-rate, rate)),
        (standing + 2.9 * SWING, (-1j * rate, 1j * rate)),
    ):
        rest = chain.equilibrium(guess)
        found = np.linalg.eigvals(chain.linearise(rest, still, still).A)
        assert_allclose(np.sort_complex(found), eigenvalues, rtol=0, atol=1e-8)


def test_held_torques_keep_a_cell_in_equilibrium():
    plant, q, _ = plant_of("spatial")
    chain, still = plant.mechanism, np.zeros(12)
    tau = plant.inverse_dynamics(q, still, still).torque
    assert_allclose(chain.equilibrium(q, tau), q, rtol=0, atol=1e-9)


def test_singular_states_and_bad_numbers_are_told():
    chain, q, _ = linkage("sarrus")
    with pytest.raises(ArgumentError, match="singular"):
        chain.equilibrium(q)
    model = chain.linearise(q, np.zeros(5), np.zeros(5))
    with pytest.raises(OutOfRangeError):
        model.sampled(0.0)
