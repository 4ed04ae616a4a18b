"""Projection onto the closures: closed, smallest in kinetic energy, impossible ones refused."""

import functools

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS, cell_and_start
from close import assert_close
from linkages import four_bar
from numpy.testing import assert_allclose
from scipy.linalg import null_space

from coop_pin.base.errors import OpenClosureError, OutOfRangeError, ShapeError
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.projection import Projection
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.model.pinocchio_model import symmetric

CASES = [(name, payload) for name in SCENARIOS for payload in ("welded", "free")]


@functools.cache
def closed(case):
    name, payload = case
    cell, start = cell_and_start(name)
    plant = CellChain(cell, PlantOptions(payload=payload))
    return plant, plant.configuration(start)


def reachable(case, increment):
    """The increment without what a planar cell cannot undo: a free payload out of the plane."""
    if case == ("planar", "free"):
        increment = increment.copy()
        increment[[-4, -3, -2]] = 0.0
    return increment


def opened(case, gap, seed=0):
    plant, q = closed(case)
    model, rng = plant.mechanism.model, np.random.default_rng(seed)
    return plant, pin.integrate(model, q, reachable(case, gap * rng.uniform(-1.0, 1.0, model.nv)))


def mass_matrix(model, q):
    return symmetric(pin.crba(model, model.createData(), q))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_projected_configuration_lies_on_the_closures(case):
    for seed in range(4):
        plant, q_open = opened(case, 0.1, seed)
        assert max(max(gap) for gap in plant.closure_errors(q_open)) > 1e-2
        q = plant.mechanism.project_configuration(q_open)
        assert_close(plant.closure_errors(q), np.zeros((2, 2)), atol=1e-11)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_projecting_twice_changes_nothing(case):
    plant, q_open = opened(case, 0.1)
    q = plant.mechanism.project_configuration(q_open)
    assert_allclose(plant.mechanism.project_configuration(q), q, rtol=0, atol=1e-12)
    v = plant.mechanism.project_velocity(q, np.random.default_rng(2).normal(size=plant.mechanism.model.nv))
    assert_allclose(plant.mechanism.project_velocity(q, v), v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_small_correction_of_the_configuration_is_orthogonal_to_the_free_motions_in_the_mass_metric(case):
    """dq = -M^-1 J^T lambda to first order: its M-product with free motions is of second order."""
    shares = []
    for gap in (1e-3, 1e-4):
        plant, q_open = opened(case, gap)
        model = plant.mechanism.model
        q = plant.mechanism.project_configuration(q_open)
        step, M = pin.difference(model, q_open, q), mass_matrix(model, q)
        free = null_space(plant.mechanism.closures.state(q, np.zeros(model.nv)).jacobian, rcond=1e-8)
        shares.append(np.linalg.norm(free.T @ M @ step) / np.linalg.norm(M @ step))
    assert shares[0] < 1e-2
    assert_allclose(shares[0] / shares[1], 10.0, rtol=0.2)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_projected_velocity_keeps_the_closures_closed_and_the_correction_costs_the_least_energy(case):
    plant, q = closed(case)
    model, rng = plant.mechanism.model, np.random.default_rng(3)
    M = mass_matrix(model, q)
    jacobian = plant.mechanism.closures.state(q, np.zeros(model.nv)).jacobian
    free = null_space(jacobian, rcond=1e-8)
    for _ in range(4):
        v = rng.normal(size=model.nv)
        projected = plant.mechanism.project_velocity(q, v)
        assert_close(jacobian @ projected, np.zeros(len(jacobian)), atol=1e-12)
        assert_close(free.T @ M @ (projected - v), np.zeros(free.shape[1]), atol=1e-11)
        # The minimum itself: v* = N (N^T M N)^-1 N^T M v over the free motions N.
        assert_allclose(
            projected, free @ np.linalg.solve(free.T @ M @ free, free.T @ M @ v), rtol=1e-9, atol=1e-10
        )
        assert projected @ M @ projected <= v @ M @ v
        assert_allclose(
            v @ M @ v, projected @ M @ projected + (v - projected) @ M @ (v - projected), rtol=1e-11
        )


@pytest.mark.parametrize("case", CASES, ids=str)
def test_velocities_on_the_closures_survive_the_cut(case):
    """The rank tolerance must not take drift for a row: free motions equal the mobility."""
    plant, q = closed(case)
    model = plant.mechanism.model
    M = mass_matrix(model, q)
    columns = np.array([plant.mechanism.project_velocity(q, unit) for unit in np.eye(model.nv)]).T
    assert np.linalg.matrix_rank(columns, tol=1e-8) == (3 if case[0] == "planar" else 6)
    assert_close(columns @ columns, columns, atol=1e-11)
    assert_close(M @ columns, (M @ columns).T, atol=1e-10)


@pytest.mark.parametrize(
    "rows", ["planar", "axis", "point", (False, False, True, True, False, True)], ids=str
)
def test_every_kind_of_rows_can_be_projected_onto(rows):
    plant, _ = closed(("spatial", "free"))
    chain = ClosedChain(
        plant.mechanism.model,
        [Closure("left/grasp", "payload/left", rows), Closure("right/grasp", "payload/right", rows)],
    )
    for seed in range(3):
        _, q_open = opened(("spatial", "free"), 0.2, seed)
        q = chain.project_configuration(q_open)
        assert_close(
            chain.closures.state(q, np.zeros(chain.model.nv)).position,
            np.zeros(chain.closures.rows),
            atol=1e-11,
        )
        assert np.abs(plant.mechanism.closures.state(q, np.zeros(chain.model.nv)).position).max() > 1e-3


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_a_closure_that_cannot_close_is_named_with_its_gap(payload):
    """The right arm's tip held to a point 3 m beyond its base: 0.8 m of reach leave 2.2 m."""
    plant, q = closed(("planar", payload))
    model = plant.mechanism.model.copy()
    model.addFrame(
        pin.Frame("far", 0, 0, pin.SE3(np.eye(3), np.array([4.0, 0.0, 0.0])), pin.FrameType.OP_FRAME)
    )
    chain = ClosedChain(model, [Closure("right/grasp", "far", "point")])
    with pytest.raises(OpenClosureError) as error:
        chain.project_configuration(q)
    assert error.value.closure == "right/grasp - far"
    assert 2.2 - 1e-9 <= error.value.distance < 3.9
    assert error.value.angle == 0.0
    assert "right/grasp - far" in str(error.value)
    assert f"{error.value.distance:.3g} m" in str(error.value)


def test_an_open_state_is_refused_where_a_closed_one_is_required():
    plant, q_open = opened(("spatial", "free"), 0.1)
    widest = max(max(gap) for gap in plant.closure_errors(q_open))
    plant.mechanism.require_closed(q_open, allowed=1.001 * widest)
    with pytest.raises(OpenClosureError, match=r"left/grasp - payload/left|right/grasp - payload/right"):
        plant.mechanism.require_closed(q_open, allowed=0.999 * widest)


def test_a_nan_is_never_closed():
    plant, q = closed(("spatial", "welded"))
    with pytest.raises(OutOfRangeError, match=r"^q"):
        plant.mechanism.require_closed(np.full_like(q, np.nan), allowed=1.0)
    with pytest.raises(OutOfRangeError, match=r"^q"):
        plant.mechanism.project_configuration(np.full_like(q, np.nan))
    with pytest.raises(ShapeError, match=r"^q"):
        plant.mechanism.project_configuration(q[:-1])


# ---------------------------------------------------------------- number and length of the steps


class Looked:
    """The closures of a chain, and the configurations at which they are looked at."""

    def __init__(self, chain):
        self.of, self.seen = chain.closures, []
        self.projection = Projection(chain.model, self)

    def __getattr__(self, name):
        return getattr(self.of, name)

    def state(self, q, v):
        self.seen.append(q)
        return self.of.state(q, v)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_newton_steps_and_the_descent_converge_quadratically(case):
    plant, q_open = opened(case, 0.1)
    looked = Looked(plant.mechanism)
    seen, projection = looked.seen, looked.projection
    projected = projection.state(q_open, np.zeros(plant.mechanism.model.nv), 1e-9).q
    np.testing.assert_array_equal(projected, plant.mechanism.project_configuration(q_open))
    assert len(seen) <= 7
    for gap, most in ((0.1, 8), (0.8, 12)):
        _, q_open = opened(case, gap)
        seen.clear()
        near = projection.descend(q_open)
        assert len(seen) <= most
        seen.clear()
        assert projection.descend(near) is near
        assert len(seen) == 1


@pytest.mark.parametrize("loops", [1, 2])
@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-4])
def test_steps_end_where_rounding_stops_them(loops, angle):
    """In and near a singular pose rounding moves the configuration by more than what counts as at rest."""
    chain = four_bar.four_bars(loops)
    q, v = four_bar.start(chain, loops, angle=angle)
    looked = Looked(chain)
    for size in (1e-4, 1e-2):
        looked.seen.clear()
        projected = looked.projection.state(q + size * np.cos(np.arange(len(q))), v, 1e-6)
        assert len(looked.seen) <= 12
        assert max(max(error) for error in chain.closure_errors(projected.q)) < 1e-11


def test_steps_at_a_lower_rank_are_followed_by_one_at_the_full_rank():
    """The first step leaves one row out; that it is short says nothing about that row."""
    plant, q = closed(("spatial", "welded"))
    model = plant.mechanism.model
    looked = Looked(plant.mechanism)
    svd = looked.projection.svd(q, plant.mechanism.closures.state(q, np.zeros(model.nv)))
    off = pin.integrate(model, q, 1e-5 * svd.solve_LT(svd.right[:, -1]))
    projected = looked.projection.state(off, np.zeros(model.nv), 1e-9, svd.rank - 1)
    assert projected.rank == svd.rank
    assert len(looked.seen) <= 6
    assert_close(plant.closure_errors(projected.q), np.zeros((2, 2)), atol=1e-12)


def test_a_descent_moves_no_joint_by_more_than_half_a_radian_at_once_and_ends_at_the_least_error():
    plant, q = closed(("planar", "welded"))
    model = plant.mechanism.model.copy()
    model.addFrame(
        pin.Frame("far", 0, 0, pin.SE3(np.eye(3), np.array([4.0, 0.0, 0.0])), pin.FrameType.OP_FRAME)
    )
    chain = ClosedChain(model, [Closure("right/grasp", "far", "point")])
    looked = Looked(chain)
    seen, projection = looked.seen, looked.projection
    nearest = projection.descend(q)
    assert len(seen) < 150
    first = np.abs(seen[1] - seen[0]).max()
    assert_close(first, 0.5, atol=1e-12)
    error = chain.closures.state(nearest, np.zeros(model.nv))
    assert_close(error.jacobian.T @ error.position, np.zeros(model.nv), atol=1e-5)
    seen.clear()
    projection.descend(nearest)
    assert len(seen) <= 30
