"""Measured orders of convergence on vectors and Lie groups, and the energy of undriven chains."""

import functools

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS, cell_and_start, random_velocity
from close import assert_close
from numpy.testing import assert_allclose

from coop_pin.chain.integrators import (
    INTEGRATORS,
    LieGroup,
    RungeKutta,
    SemiImplicitEuler,
    VectorRungeKutta,
    VectorSpace,
    configuration_space,
)
from coop_pin.description.plant import PlantOptions, Stabilisation
from coop_pin.grasps import CellChain

CASES = [(name, payload) for name in SCENARIOS for payload in ("welded", "free")]


@functools.cache
def moving(case):
    """A plant on its closures and in motion."""
    name, payload = case
    cell, start = cell_and_start(name)
    plant = CellChain(cell, PlantOptions(payload=payload, stabilisation=Stabilisation(frequency=5.0)))
    q = plant.configuration(start)
    v = random_velocity(plant.mechanism, q, 6)
    return plant, q, v / np.abs(v).max()


def smooth_forces(plant, q_0):
    """Channels: a motor torque that holds the weight and swings, smooth friction, a push on the payload."""
    model, data = plant.mechanism.model, plant.mechanism.model.createData()
    hold = pin.rnea(model, data, q_0, np.zeros(model.nv), np.zeros(model.nv))
    driven = np.zeros(model.nv)
    for place in plant.model.arms:
        driven[place.v_slice] = 1.0
    push = plant.cell.task_rows.expand(
        plant.cell.task_rows.select(np.array([6.0, -4.0, 3.0, 0.2, -0.1, 0.3]))
    )

    def rate(_t, q, v):
        forces = np.array(
            [driven * hold, -driven * (0.8 * v + 0.5 * np.tanh(v / 0.5)), plant.payload_jacobian(q).T @ push]
        )
        return plant.mechanism.solver.acceleration(q, v, forces.sum(axis=0)), forces @ v

    return rate


def advance(case, method, h, duration, project=False):
    plant, q, v = moving(case)
    integrator, rate = (
        INTEGRATORS[method](plant.mechanism.model),
        smooth_forces(plant, q),
    )
    work = np.zeros(3)
    for _ in range(round(duration / h)):
        q, v, done = integrator.step(rate, 0.0, q, v, h)
        work = work + done
        if project:
            q = plant.mechanism.project_configuration(q)
            v = plant.mechanism.project_velocity(q, v)
    return q, v, work


def errors(case, method, steps, duration, reference_step, project=False):
    """For each step size the error of q (on its group), of v and of the work of each channel."""
    model = moving(case)[0].mechanism.model
    q_true, v_true, work_true = advance(case, "rk4", reference_step, duration, project)
    found = []
    for h in steps:
        q, v, work = advance(case, method, h, duration, project)
        found.append(
            [
                np.linalg.norm(pin.difference(model, q_true, q)),
                np.linalg.norm(v - v_true),
                np.linalg.norm(work - work_true),
            ]
        )
    return np.array(found)


def orders(found):
    """Slopes over the whole ladder of halved steps."""
    return np.log2(found[0] / found[-1]) / (len(found) - 1)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_runge_kutta_is_of_order_four_in_state_and_in_work(case):
    found = errors(case, "rk4", (0.02, 0.01, 0.005), 0.2, 0.00125)
    assert found[-1].min() > 1e-13
    assert_allclose(orders(found), [4.0, 4.0, 4.0], rtol=0, atol=0.4)


@pytest.mark.parametrize("case", [("planar", "free"), ("spatial", "free")], ids=str)
def test_runge_kutta_keeps_its_order_with_projection_after_every_step(case):
    found = errors(case, "rk4", (0.01, 0.005, 0.0025), 0.2, 0.000625, project=True)
    assert_allclose(orders(found)[:2], [4.0, 4.0], rtol=0, atol=0.4)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_semi_implicit_euler_is_of_order_one_in_state_and_in_work(case):
    found = errors(case, "semi-implicit-euler", (0.0025, 0.00125), 0.1, 0.005)
    assert_allclose(orders(found), [1.0, 1.0, 1.0], rtol=0, atol=0.2)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_change_of_energy_is_the_work_of_the_forces(case):
    plant, q_0, v_0 = moving(case)
    before = plant.mechanism.energy(q_0, v_0).total
    closure_errors = []
    for h in (0.01, 0.005):
        q, v, work = advance(case, "rk4", h, 0.2)
        closure_errors.append(abs(plant.mechanism.energy(q, v).total - before - work.sum()))
        assert np.abs(work).max() > 0.01
    assert closure_errors[0] < 1e-3
    assert closure_errors[1] < closure_errors[0] / 8.0


@pytest.mark.parametrize("project", [False, True], ids=["stabilised", "projected"])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_an_undriven_chain_keeps_its_energy_and_its_closures(case, project):
    plant, q, v = moving(case)
    integrator, none = INTEGRATORS["rk4"](plant.mechanism.model), np.zeros(0)
    energy = plant.mechanism.energy(q, v).total
    assert plant.mechanism.energy(q, v).kinetic > 0.05
    for _ in range(200):
        q, v, _ = integrator.step(
            lambda _t, q, v: (plant.mechanism.solver.acceleration(q, v, np.zeros(len(v))), none),
            0.0,
            q,
            v,
            1e-3,
        )
        if project:
            q = plant.mechanism.project_configuration(q)
            v = plant.mechanism.project_velocity(q, v)
    assert_allclose(plant.mechanism.energy(q, v).total, energy, rtol=0, atol=1e-8)
    assert_allclose(plant.closure_errors(q), np.zeros((2, 2)), rtol=0, atol=1e-12 if project else 1e-9)
    assert np.abs(pin.difference(plant.mechanism.model, moving(case)[1], q)).max() > 0.02


@pytest.mark.parametrize("method", INTEGRATORS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_two_integrations_give_the_same_bits(case, method):
    first, second = (advance(case, method, 0.01, 0.05) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert_allclose(one, other, rtol=0, atol=0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_short_form_for_vectors_is_the_same_method(name):
    plant, q, v = moving((name, "welded"))
    smooth = smooth_forces(plant, q)

    def rate(t, q, v):
        acceleration, powers = smooth(t, q, v)
        return acceleration + np.cos(60.0 * t), powers

    long, short = (
        RungeKutta(VectorSpace()).step(rate, 0.7, q, v, 0.01),
        VectorRungeKutta().step(rate, 0.7, q, v, 0.01),
    )
    for one, other in zip(short, long, strict=True):
        assert_allclose(one, other, rtol=1e-12, atol=1e-13)
    assert type(INTEGRATORS["rk4"](plant.mechanism.model)) is VectorRungeKutta


@pytest.mark.parametrize("method", INTEGRATORS)
def test_a_step_leaves_the_state_it_started_from_alone(method):
    plant, q, v = moving(("planar", "welded"))
    kept = q.copy(), v.copy()
    step = INTEGRATORS[method](plant.mechanism.model).step(smooth_forces(plant, q), 0.0, q, v, 0.01)
    first = [field.copy() for field in step]
    INTEGRATORS[method](plant.mechanism.model).step(smooth_forces(plant, q), 0.01, step.q, step.v, 0.01)
    assert_allclose([q, v], kept, rtol=0, atol=0)
    for field, copy in zip(step, first, strict=True):
        assert_allclose(field, copy, rtol=0, atol=0)


def test_a_free_flyer_that_ignores_dexp_would_be_of_second_order():
    """The Munthe-Kaas correction is what the order hangs on: without it the same body loses it."""
    model, tumbling = spinning_body()
    v_0 = np.array([0.3, -0.2, 0.5, 2.0, -3.0, 1.5])

    class Naive(LieGroup):
        def increment_rate(self, q, u, v):
            return v

    measured = {}
    for space in (LieGroup(model), Naive(model)):
        integrator = RungeKutta(space)

        def end(h, integrator=integrator):
            q, v = pin.neutral(model), v_0
            for _ in range(round(0.4 / h)):
                q, v, _ = integrator.step(tumbling, 0.0, q, v, h)
            return q

        truth, ends = end(0.4 / 1024), [end(0.4 / n) for n in (16, 32)]
        found = [np.linalg.norm(pin.difference(model, truth, q)) for q in ends]
        measured[type(space)] = np.log2(found[0] / found[1])
    assert_close(measured[LieGroup], 4.0, atol=0.4)
    assert_close(measured[Naive], 2.0, atol=0.4)


def spinning_body():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(
        joint, pin.Inertia(2.0, np.array([0.1, -0.05, 0.2]), np.diag([0.3, 0.5, 0.7])), pin.SE3.Identity()
    )
    data, none = model.createData(), np.zeros(0)
    return model, lambda _t, q, v: (pin.aba(model, data, q, v, np.zeros(6)), none)


def test_a_free_bodys_momentum_is_conserved_but_for_its_weight():
    """A free body: v_c changes by g t and the angular momentum about the centre of mass is constant."""
    model, tumbling = spinning_body()
    data, integrator = model.createData(), RungeKutta(configuration_space(model))
    q, v = pin.neutral(model), np.array([0.3, -0.2, 0.5, 2.0, -3.0, 1.5])

    def momentum(q, v):
        return pin.computeCentroidalMomentum(model, data, q, v).vector.copy()

    before = momentum(q, v)
    for _ in range(200):
        q, v, _ = integrator.step(tumbling, 0.0, q, v, 2e-3)
    expected = before + np.array([0.0, 0.0, -9.81 * 2.0 * 0.4, 0.0, 0.0, 0.0])
    assert_allclose(momentum(q, v), expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    "joint",
    [
        pin.JointModelFreeFlyer,
        pin.JointModelPlanar,
        pin.JointModelSpherical,
        pin.JointModelRUBZ,
        pin.JointModelRZ,
    ],
)
def test_the_increment_rate_is_the_derivative_of_the_increment(joint):
    """q_0 + u(t) moves with v when u' = dexp_u^-1 v: checked by finite differences on every kind of joint."""
    model = pin.Model()
    model.addJoint(0, joint(), pin.SE3.Identity(), "joint")
    space, rng, h = configuration_space(model), np.random.default_rng(1), 1e-6
    assert isinstance(space, VectorSpace if model.nq == model.nv else LieGroup)
    q = space.step(pin.neutral(model), rng.normal(size=model.nv))
    u, v = 0.8 * rng.normal(size=model.nv), rng.normal(size=model.nv)
    rate = space.increment_rate(q, u, v)
    moved = pin.difference(model, space.step(q, u - h * rate), space.step(q, u + h * rate)) / (2 * h)
    assert_allclose(moved, v, rtol=0, atol=1e-8)


@pytest.mark.parametrize("size", [1e-6, 1e-4, 1e-3])
def test_the_increment_rate_of_a_free_flyer_is_right_at_small_increments(size):
    """The series of Bernoulli numbers as the oracle: Pinocchio's derivative misses it by 1e-8 at 1e-4."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "joint")
    rng = np.random.default_rng(2)
    u, v = size * rng.normal(size=6), rng.normal(size=6)
    A = pin.Motion(u).action
    expected = v + A @ v / 2.0 + A @ A @ v / 12.0 - A @ A @ A @ A @ v / 720.0
    rate = configuration_space(model).increment_rate(pin.neutral(model), u, v)
    assert_allclose(rate, expected, rtol=0, atol=1e-12)


def test_semi_implicit_euler_moves_with_the_new_velocity():
    """Semi-implicit Euler keeps a nearby energy of an oscillator; explicit Euler gains energy."""
    integrator, h = SemiImplicitEuler(VectorSpace()), 0.05
    q, v, _ = integrator.step(lambda _t, q, v: (-q, v * 0.0 - 2.0), 0.0, np.array([1.0]), np.array([0.0]), h)
    assert_allclose([q[0], v[0]], [1.0 - h * h, -h], rtol=1e-15)
    for _ in range(2000):
        q, v, work = integrator.step(lambda _t, q, v: (-q, v * 0.0 - 2.0), 0.0, q, v, h)
    assert_close((q**2 + v**2)[0], 1.0, atol=0.06)
    assert_allclose(work, [-2.0 * h], rtol=1e-15)
