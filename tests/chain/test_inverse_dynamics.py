"""Inverse dynamics, minimal coordinates and derivatives of closed chains, against forward dynamics."""

import numpy as np
import pinocchio as pin
import pytest
from cells import (
    CATALOGUE_CELLS,
    FAR_CELLS,
    kkt_of,
    random_velocity,
)
from chain_cells import cell_of, random_tau
from linkages import bennett, four_bar, robot, sarrus
from numpy.testing import assert_allclose

from coop_pin.base.errors import ArgumentError, NameNotFoundError, ShapeError
from coop_pin.base.spatial import internal_wrenches
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.compiled.plant.cell_numbers import CellNumbers
from coop_pin.compiled.plant.plant_code import PlantCode
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.tracing import evaluation
from coop_pin.tracing.tree import leaves

CELLS = ["planar", "spatial", "planar-three", *CATALOGUE_CELLS, *FAR_CELLS]
LINKAGES = {"bennett-point": ("point",), "bennett-full": ("full",), "sarrus": ()}


def plant_of(name, **options):
    cell, start = cell_of(name)
    plant = CellChain(cell, PlantOptions(**options))
    q = plant.configuration(start)
    return plant, q, random_velocity(plant.mechanism, q, 3)


def linkage(name):
    if name == "sarrus":
        chain, q = sarrus()
        q = chain.assemble(q).q
        return chain, q, random_velocity(chain, q, 3)
    chain, (q, v) = bennett(*LINKAGES[name])
    return chain, q, v


def any_chain(name):
    if name in LINKAGES:
        return linkage(name)
    plant, q, v = plant_of(name)
    return plant.mechanism, q, v


@pytest.mark.parametrize("name", [*CELLS, *LINKAGES])
def test_inverse_dynamics_of_forward_dynamics_returns_the_torques(name):
    chain, q, v = any_chain(name)
    tau = random_tau(chain)
    forward = chain.forward_dynamics(q, v, tau)
    inverse = chain.inverse_dynamics(q, v, forward.acceleration, closure_wrenches=forward.closure_wrenches)
    assert_allclose(inverse.torque, tau, rtol=0, atol=1e-9 * np.abs(tau).max())


@pytest.mark.parametrize("name", LINKAGES)
def test_closure_wrenches_of_linkages_return_through_forward_dynamics(name):
    """By both solvers, whose least multipliers are the same; with redundant rows, too."""
    proximal, q, v = linkage(name)
    chains, found = (proximal, kkt_of(proximal)), []
    for chain in chains:
        forward = chain.forward_dynamics(q, v, random_tau(chain))
        expected = forward.closure_wrenches
        torque = chain.inverse_dynamics(q, v, forward.acceleration, closure_wrenches=expected).torque
        again = chain.forward_dynamics(q, v, torque).closure_wrenches
        assert_allclose(again, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
        found.append(expected)
    assert_allclose(*found, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("name", [*CELLS, *LINKAGES])
def test_least_torques_cause_the_same_motion_and_no_others_are_smaller(name):
    chain, q, v = any_chain(name)
    forward = chain.forward_dynamics(q, v, random_tau(chain))
    least = chain.inverse_dynamics(q, v, forward.acceleration).torque
    again = chain.forward_dynamics(q, v, least).acceleration
    assert_allclose(again, forward.acceleration, rtol=0, atol=1e-10 * (1.0 + np.abs(again).max()))
    J = chain.constraint_jacobian(q)
    # Every other torque of the motion differs by J^T lambda; the least is orthogonal to all of them.
    assert_allclose(J @ least, 0.0, atol=1e-8)


@pytest.mark.parametrize("name", ["planar", "three-ur5-plate", "bennett-point", "sarrus"])
def test_arrays_of_states_have_the_torques_of_each(name):
    chain, q, v = any_chain(name)
    v = np.array([v, 0.0 * v, -0.5 * v])
    q = np.array([q, q, chain.project_configuration(pin.integrate(chain.model, q, 0.05 * v[0]))])
    v[2] = chain.project_velocity(q[2], v[2])
    a = np.array(
        [chain.forward_dynamics(*state, random_tau(chain)).acceleration for state in zip(q, v, strict=True)]
    )
    applied = np.linspace(0.0, 1.0, chain.model.nv)
    together = chain.inverse_dynamics(q, v, a, applied=applied)
    for k, state in enumerate(zip(q, v, a, strict=True)):
        for part, whole in zip(chain.inverse_dynamics(*state, applied=applied), together, strict=True):
            assert np.array_equal(part, whole[k])


@pytest.mark.parametrize("name", ["planar", "spatial", "kinova-pair"])
def test_torques_of_a_cell_overcome_friction_push_and_squeeze_at_many_states(name):
    plant, q, v = plant_of(name)
    rng, chain, m = np.random.default_rng(8), plant.mechanism, len(plant.model.arms)
    v = np.array([v, 0.3 * v])
    q = np.array([q, q])
    a = np.array(
        [chain.forward_dynamics(*state, random_tau(chain)).acceleration for state in zip(q, v, strict=True)]
    )
    rows = np.zeros(6)
    rows[list(plant.cell.task_rows.indices)] = 1.0
    internal = internal_wrenches(10.0 * rows * rng.normal(size=(2, m, 6)), plant.cell.shares)
    push = rows * rng.normal(size=6)
    both = plant.inverse_dynamics(q, v, a, internal=internal, push=push, friction=plant.friction(v))
    one = plant.inverse_dynamics(q[0], v[0], a[0], internal=internal[0], push=push)
    assert_allclose(one.torque - plant.friction(v[0]), both.torque[0], rtol=0, atol=1e-12)
    for k in range(2):
        body = PinocchioPlant(plant, PlantOptions(), q[k])
        body.surround(plant.cell.surroundings._replace(push=push))
        body.restore(body.state()._replace(v=v[k], force=both.torque[k]))
        again = chain.forward_dynamics(q[k], v[k], body.generalised_force()).acceleration
        assert_allclose(again, a[k], rtol=0, atol=1e-10 * (1.0 + np.abs(a).max()))
        F = body.interaction_wrenches()
        assert_allclose(
            internal_wrenches(F, plant.cell.shares) * rows, internal[k], rtol=0, atol=1e-9 * np.abs(F).max()
        )


def test_states_of_less_rank_are_told_and_have_finite_torques():
    """Two parallelograms, upright and flat: there they may also fold, and a row is lost for each."""
    chain, ranks = four_bar.four_bars(2), []
    for angle in (np.pi / 2, 0.0):
        q, v = four_bar.start(chain, 2, angle)
        for rate in (v, 0.0 * v):
            forward = chain.forward_dynamics(q, rate, random_tau(chain))
            inverse = chain.inverse_dynamics(q, rate, forward.acceleration)
            again = chain.forward_dynamics(q, rate, inverse.torque).acceleration
            scale = np.abs(forward.acceleration).max()
            assert_allclose(again, forward.acceleration, rtol=0, atol=1e-9 * scale)
            assert inverse.rank == forward.rank
        ranks.append(inverse.rank)
    assert ranks == [4, 2]


@pytest.mark.parametrize("payload", ["welded", "free"])
@pytest.mark.parametrize("name", CELLS)
def test_a_wanted_internal_wrench_returns_through_forward_dynamics(name, payload):
    plant, q, v = plant_of(name, payload=payload)
    rng, chain = np.random.default_rng(8), plant.mechanism
    a = chain.forward_dynamics(q, v, random_tau(chain)).acceleration
    rows = np.zeros(6)
    rows[list(plant.cell.task_rows.indices)] = 1.0
    shares = np.array([arm.share for arm in plant.model.arms])
    internal = internal_wrenches(10.0 * rows * rng.normal(size=(len(shares), 6)), shares)
    push = rows * rng.normal(size=6)
    solution = plant.inverse_dynamics(q, v, a, internal=internal, push=push)
    tau = solution.torque + plant.payload_jacobian(q).T @ push
    again = chain.forward_dynamics(q, v, tau).acceleration
    assert_allclose(again, a, rtol=0, atol=1e-10 * (1.0 + np.abs(a).max()))
    F = plant.interaction_wrenches(q, v, tau, push)
    assert_allclose(F * rows, solution.interaction_wrench * rows, rtol=0, atol=1e-7)
    assert_allclose(
        internal_wrenches(F, shares) * rows,
        internal,
        rtol=0,
        atol=1e-9 * np.abs(solution.interaction_wrench).max(),
    )


@pytest.mark.parametrize("name", ["planar", "spatial", "three-ur5-plate"])
def test_a_free_payload_has_no_motor(name):
    plant, q, v = plant_of(name, payload="free")
    a = plant.mechanism.forward_dynamics(q, v, random_tau(plant.mechanism)).acceleration
    torque = plant.inverse_dynamics(q, v, a).torque
    assert not torque[-6:].any()
    again = plant.mechanism.forward_dynamics(q, v, torque).acceleration
    assert_allclose(again, a, rtol=0, atol=1e-9 * (1.0 + np.abs(a).max()))


@pytest.mark.parametrize("name", [*CELLS, *LINKAGES])
def test_reduced_dynamics_give_energy_and_accelerations(name):
    chain, q, v = any_chain(name)
    tau, reduced = random_tau(chain), chain.reduced_dynamics(q, v)
    indices, N = reduced.coordinates
    assert_allclose(chain.constraint_jacobian(q) @ N, 0.0, atol=1e-12)
    assert_allclose(N @ v[indices], v, rtol=0, atol=1e-11)
    assert_allclose(
        0.5 * v[indices] @ reduced.mass_matrix @ v[indices], chain.energy(q, v).kinetic, rtol=1e-11
    )
    M = pin.crba(chain.model, chain.model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    assert_allclose(
        reduced.mass_matrix, N.T @ M @ N, rtol=0, atol=1e-11 * np.abs(M).max() * np.abs(N).max() ** 2
    )
    rates = np.linalg.solve(reduced.mass_matrix, N.T @ tau - reduced.bias)
    a = chain.forward_dynamics(q, v, tau).acceleration
    assert_allclose(rates, a[indices], rtol=0, atol=1e-9 * (1.0 + np.abs(a).max()))


@pytest.mark.parametrize("name", ["spatial", "three-ur5-plate", "kinova-pair", "planar"])
def test_effective_inertia_is_that_of_a_push(name):
    plant, q, _ = plant_of(name)
    chain, still = plant.mechanism, np.zeros(plant.mechanism.model.nv)
    rows = list(plant.cell.task_rows.indices)
    inertia = plant.effective_inertia(q)
    J = plant.payload_jacobian(q)
    at_rest = chain.forward_dynamics(q, still, still).acceleration
    push = np.zeros(6)
    push[rows] = np.random.default_rng(2).normal(size=len(rows))
    pushed = chain.forward_dynamics(q, still, J.T @ push).acceleration
    assert_allclose(inertia @ (J @ (pushed - at_rest))[rows], push[rows], rtol=0, atol=1e-9)


def central_differences(function, size, step=1e-4):
    units = np.eye(size)
    stencil = ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))
    return np.stack([sum(w * function(k * step * e) for k, w in stencil) / step for e in units], axis=-1)


@pytest.mark.parametrize("off", [0.0, 1e-3])
@pytest.mark.parametrize("name", ["planar", "spatial", "two-pandas-box", "three-ur5-plate"])
def test_derivatives_equal_central_differences_of_the_kkt_solver(name, off):
    plant, q, v = plant_of(name)
    chain = plant.mechanism
    chain.open_allowed = 0.1
    kkt = kkt_of(chain).solver
    q = pin.integrate(chain.model, q, off * np.random.default_rng(4).normal(size=chain.model.nv))
    tau = random_tau(chain)
    found = chain.derivatives(q, v, tau)

    def dynamics(q, v, tau):
        a = kkt.acceleration(q, v, tau)
        return np.concatenate((a, kkt.wrenches().ravel()))

    nv = chain.model.nv
    differences = (
        central_differences(lambda d: dynamics(pin.integrate(chain.model, q, d), v, tau), nv),
        central_differences(lambda d: dynamics(q, v + d, tau), nv),
        central_differences(lambda d: dynamics(q, v, tau + d), nv),
    )
    for a, wrench, expected in zip(found[:3], found[3:], differences, strict=True):
        assert_allclose(a, expected[:nv], rtol=0, atol=1e-6 * np.abs(expected[:nv]).max())
        expected = expected[nv:].reshape(wrench.shape)
        assert_allclose(wrench, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


ROUNDER = 1.5 * 2.0**52
"""A sum with it is rounded to a whole number."""


def _of_complex(monkeypatch):
    """Let numpy evaluate traced code at complex numbers: real parts decide, whole numbers are real."""

    def rounding(operation):
        return lambda a, b: np.real(operation(a, b)) if ROUNDER in (abs(a), abs(b)) else operation(a, b)

    def comparing(operation):
        return lambda a, b: 1.0 * operation(np.real(a), np.real(b))

    operations = {
        "add": rounding(np.add),
        "sub": rounding(np.subtract),
        "less": comparing(np.less),
        "less_equal": comparing(np.less_equal),
        "abs": lambda x: x * np.sign(np.real(x)),
    }
    for name, operation in operations.items():
        monkeypatch.setitem(evaluation._OPERATIONS, name, operation)


@pytest.mark.parametrize("name", ["planar", "spatial", "two-pandas-box", "three-ur5-plate"])
def test_derivatives_are_those_of_complex_steps_through_the_dynamics_of_batches(name, monkeypatch):
    """Im f(x + i h) / h of the compiled plant's formulas, along a random direction on the closures."""
    cell, start = cell_of(name)
    cell = cell.replace(arms={arm: each.replace(friction="none") for arm, each in cell.arms.items()})
    plant = CellChain(cell)
    chain, q = plant.mechanism, plant.configuration(start)
    v, tau, nv = random_velocity(chain, q, 3), random_tau(chain), chain.model.nv
    code = PlantCode(CellNumbers.from_chain(plant))
    kernel, slots = code.program.kernels[1], code.lanes.slots
    _of_complex(monkeypatch)

    def acceleration(q, v, tau):
        block = np.zeros(code.lanes.size, dtype=complex)
        arguments = {"q": q, "v": v, "force": tau, "surroundings": leaves(cell.surroundings)}
        for argument, value in arguments.items():
            block[slots(argument).ravel()] = value
        written, outputs = zip(*kernel.writes, strict=True)
        block[[*written]] = evaluation.evaluate(
            kernel.tape, outputs, [block[slot] for _, slot in kernel.reads]
        )
        return block[slots("rates")][:nv]

    rng, J = np.random.default_rng(7), chain.constraint_jacobian
    N = chain.minimal_coordinates(q).null_space
    dq, dtau = N @ rng.normal(size=N.shape[1]), rng.normal(size=nv)
    dJ = central_differences(lambda s: J(pin.integrate(chain.model, q, s[0] * dq)), 1)[..., 0]
    dv = N @ rng.normal(size=N.shape[1]) - np.linalg.pinv(J(q)) @ (dJ @ v)
    h = 1e-30
    expected = acceleration(q + 1j * h * dq, v + 1j * h * dv, tau + 1j * h * dtau).imag / h
    found = chain.derivatives(q, v, tau)
    change = found.acceleration_q @ dq + found.acceleration_v @ dv + found.acceleration_tau @ dtau
    assert_allclose(change, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("name", LINKAGES)
def test_derivatives_are_refused_where_pinocchios_are_wrong(name):
    chain, q, v = linkage(name)
    with pytest.raises(ArgumentError, match="use linearise"):
        chain.derivatives(q, v, np.zeros(chain.model.nv))


def test_motors_at_some_joints_cause_the_motion_alone():
    chain, q, v = linkage("bennett-point")
    a = chain.forward_dynamics(q, v, random_tau(chain)).acceleration
    torque = chain.inverse_dynamics(q, v, a, motors=["two_pin"]).torque
    assert torque[0] == torque[2] == 0.0
    again = chain.forward_dynamics(q, v, torque).acceleration
    assert_allclose(again, a, rtol=0, atol=1e-10 * (1.0 + np.abs(a).max()))


def test_stated_independent_joints_are_taken():
    chain, q, _ = linkage("bennett-point")
    for name in ("one_pin", "two_pin", "three_pin"):
        indices, N = chain.minimal_coordinates(q, [name])
        assert [chain.model.names[int(index) + 1] for index in indices] == [name]
        assert N[indices[0], 0] == 1.0


def test_bad_arguments_are_told():
    chain, q, v = linkage("bennett-point")
    still = np.zeros(chain.model.nv)
    with pytest.raises(ArgumentError, match="opens the closures"):
        chain.inverse_dynamics(q, v, np.array((1.0, -1.0, 1.0)))
    a = chain.forward_dynamics(q, v, still).acceleration
    with pytest.raises(ArgumentError, match="no wrench of this kind"):
        chain.inverse_dynamics(q, v, a, closure_wrenches=[[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    with pytest.raises(NameNotFoundError):
        chain.minimal_coordinates(q, ["four_pin"])
    with pytest.raises(ArgumentError, match="1 degrees of freedom"):
        chain.minimal_coordinates(q, ["one_pin", "two_pin"])
    plant, q, v = plant_of("spatial")
    a = plant.mechanism.forward_dynamics(q, v, np.zeros(12)).acceleration
    with pytest.raises(ArgumentError, match="add up to"):
        plant.inverse_dynamics(q, v, a, internal=np.ones((2, 6)))
    with pytest.raises(ShapeError):
        plant.inverse_dynamics(q, v, a, internal=np.ones((3, 6)))
    with pytest.raises(ShapeError):
        plant.inverse_dynamics([q, q], [v, v], [a, a, a])
    with pytest.raises(ShapeError):
        plant.inverse_dynamics(q, v, [a, a])
    with pytest.raises(ArgumentError, match="no states"):
        plant.inverse_dynamics(np.zeros((0, len(q))), v, a)
    with pytest.raises(ArgumentError, match="no pad"):
        plant.friction_squeeze(q, v, a)


def test_motors_that_cannot_cause_a_motion_are_told():
    chain = ClosedChain.from_urdf(
        robot(
            '<link name="bead"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
            ' iyz="0"/></inertial></link><joint name="slide" type="prismatic"><parent link="ground"/><child'
            ' link="bead"/><axis xyz="1 0 0"/><limit lower="-9" upper="9" effort="0" velocity="0"/></joint>',
            '<link name="tip"/>',
            '<joint name="end" type="fixed"><parent link="bead"/><child link="tip"/></joint>',
        ),
        [Closure("tip", "world", (False, True, False, False, False, False))],
    )
    with pytest.raises(ArgumentError, match="cannot cause this motion"):
        chain.inverse_dynamics([0.0], [0.0], [1.0], motors=[])
