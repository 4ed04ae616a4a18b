"""Constrained forward dynamics: two formulations, ABA, and the decay of opened closures."""

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS, cell_and_start, kkt_of, random_velocity
from close import assert_close
from linkages import bar, four_bar, robot
from numpy.testing import assert_allclose

from coop_pin.base.errors import (
    ArgumentError,
    ConstraintSolveError,
    NotEnoughMemoryError,
    OpenClosureError,
    OutOfRangeError,
    ShapeError,
)
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closed_kinematics import OPEN_ALLOWED
from coop_pin.chain.integrators import RungeKutta, configuration_space
from coop_pin.chain.kkt_solver import KKTSolver, constraint_svd
from coop_pin.chain.proximal_solver import ProximalSolver
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import PlantOptions, Stabilisation
from coop_pin.grasps import CellChain
from coop_pin.model import ArmModel, CellArm
from coop_pin.model.inverse_kinematics import solve_ik
from coop_pin.model.pinocchio_model import symmetric

RANKS = {("planar", "welded"): 3, ("planar", "free"): 9, ("spatial", "welded"): 6, ("spatial", "free"): 12}
CASES = list(RANKS)


def chain_of(case, **options):
    name, payload = case
    cell, start = cell_and_start(name)
    plant = CellChain(cell, PlantOptions(payload=payload, **options))
    plant.mechanism.open_allowed = np.inf  # many tests look at the stabilisation, off the closures
    return plant, plant.configuration(start)


def states(chain, q_closed, gap):
    """States off the closures by about gap, with a velocity error, in directions it can move."""
    rng = np.random.default_rng(17)
    for _ in range(4):
        v = rng.normal(size=chain.model.nv)
        q = pin.integrate(chain.model, q_closed, gap * rng.uniform(-1.0, 1.0, chain.model.nv))
        yield q, v, 10.0 * rng.normal(size=chain.model.nv)


def held_in_plane(case, q, v):
    """Keep a free payload of the planar cell in its plane: no arm could follow it out of the plane."""
    if case == ("planar", "free"):
        q, v = q.copy(), v.copy()
        q[-5:-2] = 0.0  # z of the position, x and y of the quaternion
        q[-2:] /= np.linalg.norm(q[-2:])
        v[[-4, -3, -2]] = 0.0
    return q, v


@pytest.mark.parametrize("gap", [0.0, 0.03])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_constraint_dynamics_and_the_kkt_solver_agree_on_and_off_the_closures(case, gap):
    plant, q_closed = chain_of(case)
    chain, rows = plant.mechanism, list(plant.cell.task_rows.indices)
    oracle = kkt_of(chain)
    for q, v, tau in states(chain, q_closed, gap):
        q, v = held_in_plane(case, q, v)
        if gap == 0.0:
            v = chain.project_velocity(q, v)
        first, second = chain.forward_dynamics(q, v, tau), oracle.forward_dynamics(q, v, tau)
        scale = 1.0 + np.abs(first.acceleration).max()
        assert_allclose(first.acceleration, second.acceleration, rtol=0, atol=1e-9 * scale)
        force = 1.0 + np.abs(first.closure_wrenches).max()
        assert_allclose(
            first.closure_wrenches[:, rows], second.closure_wrenches[:, rows], rtol=0, atol=1e-9 * force
        )
        assert first.rank == second.rank == RANKS[case]
        assert max(first.residual, second.residual) < 1e-9 * scale


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_solution_satisfies_the_equations_of_motion_and_the_stabilised_closures(case):
    """M a + h = tau + J^T lambda and J a + gamma + 2 zeta omega e' + omega^2 e = 0, both written out here."""
    gains = Stabilisation(frequency=7.0, damping_ratio=0.4)
    plant, q_closed = chain_of(case, stabilisation=gains)
    chain, data = plant.mechanism, plant.mechanism.model.createData()
    for q, v, tau in states(chain, q_closed, 0.02):
        q, v = held_in_plane(case, q, v)
        answer, now = chain.forward_dynamics(q, v, tau), chain.closures.state(q, v)
        force = pin.rnea(chain.model, data, q, v, answer.acceleration) - tau
        for closure, wrench in zip(chain.closures.closures, answer.closure_wrenches, strict=True):
            a, b = (chain.model.getFrameId(frame) for frame in (closure.frame_a, closure.frame_b))
            J_a, J_b = (pin.computeFrameJacobian(chain.model, data, q, frame, pin.LOCAL) for frame in (a, b))
            pin.framesForwardKinematics(chain.model, data, q)
            force -= (J_a - data.oMf[a].actInv(data.oMf[b]).toActionMatrix() @ J_b).T @ wrench
        assert_allclose(
            force, np.zeros(chain.model.nv), rtol=0, atol=1e-8 * (1.0 + np.abs(answer.closure_wrenches).max())
        )
        left = (
            now.jacobian @ answer.acceleration
            + now.drift
            + 2.0 * 0.4 * 7.0 * now.velocity
            + 49.0 * now.position
        )
        assert_allclose(
            left, np.zeros_like(left), rtol=0, atol=1e-9 * (1.0 + np.abs(answer.acceleration).max())
        )


@pytest.mark.parametrize("name", SCENARIOS)
def test_point_closures_agree_between_the_formulations_off_the_closure(name):
    cell, start = cell_and_start(name)
    tree = CellChain(cell, PlantOptions(payload="welded"))
    closures = [Closure("right/grasp", "payload/right", "point")]
    chain = ClosedChain(tree.mechanism.model, closures, open_allowed=1.0)
    oracle, q_closed = kkt_of(chain), tree.configuration(start)
    for q, v, tau in states(chain, q_closed, 0.03):
        first, second = chain.forward_dynamics(q, v, tau), oracle.forward_dynamics(q, v, tau)
        assert_allclose(
            first.acceleration,
            second.acceleration,
            rtol=1e-9,
            atol=1e-9 * (1.0 + np.abs(first.acceleration).max()),
        )
        planar = slice(0, 2) if name == "planar" else slice(0, 6)
        assert_allclose(
            first.closure_wrenches[:, planar], second.closure_wrenches[:, planar], rtol=1e-9, atol=1e-8
        )
        assert first.rank == second.rank == (2 if name == "planar" else 3)


def test_planar_rows_do_in_the_plane_what_full_rows_do():
    plant, q_closed = chain_of(("planar", "welded"))
    planar = ClosedChain(
        plant.mechanism.model,
        [Closure("right/grasp", "payload/right", "planar")],
        stabilisation=plant.mechanism.stabilisation,
    )
    for q, v, tau in states(plant.mechanism, q_closed, 0.0):
        v = plant.mechanism.project_velocity(q, v)
        full, few = plant.mechanism.forward_dynamics(q, v, tau), planar.forward_dynamics(q, v, tau)
        assert_allclose(few.acceleration, full.acceleration, rtol=1e-9, atol=1e-9)
        assert_allclose(
            few.closure_wrenches[0, [0, 1, 5]], full.closure_wrenches[0, [0, 1, 5]], rtol=1e-9, atol=1e-8
        )
        assert few.rank == 3


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_tree_without_closures_moves_as_aba_says(case):
    plant, q_closed = chain_of(case)
    model = plant.mechanism.model
    chain = ClosedChain(model, [])
    for solver in (chain, kkt_of(chain)):
        for q, v, tau in states(chain, q_closed, 0.5):
            answer = solver.forward_dynamics(q, v, tau)
            assert_allclose(
                answer.acceleration, pin.aba(model, model.createData(), q, v, tau), rtol=1e-9, atol=1e-8
            )
            assert answer.closure_wrenches.shape == (0, 6)
            assert (answer.rank, answer.residual) == (0, 0.0)
        assert_allclose(chain.project_configuration(q_closed), q_closed, rtol=0, atol=0)


@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_two_calls_give_the_same_bits_whatever_came_between(case, formulation):
    plant, q_closed = chain_of(case, formulation=formulation)
    (q, v, tau), (q_2, v_2, tau_2), *_ = states(plant.mechanism, q_closed, 0.01)
    q, v = held_in_plane(case, q, v)
    q_2, v_2 = held_in_plane(case, q_2, v_2)
    first = plant.mechanism.forward_dynamics(q, v, tau)
    kept = [np.array(field) for field in first]
    plant.mechanism.forward_dynamics(q_2, v_2, tau_2)
    again, fresh = (
        plant.mechanism.forward_dynamics(q, v, tau),
        chain_of(case, formulation=formulation)[0].mechanism.forward_dynamics(q, v, tau),
    )
    for field, copy, second, third in zip(first, kept, again, fresh, strict=True):
        assert_allclose(field, copy, rtol=0, atol=0)
        assert_allclose(second, copy, rtol=0, atol=0)
        assert_allclose(third, copy, rtol=0, atol=0)


# ---------------------------------------------------------------- opened closures


def opened_by_a_decimetre(plant, name):
    """The second arm holds the payload 0.1 m beside where it is."""
    cell, start = cell_and_start(name)
    beside = start.copy()
    beside[:3, 3] += (-0.06, 0.08, 0.0) if name == "planar" else (0.06, 0.0, -0.08)
    poses = dict(zip(cell.arms, (start, beside), strict=True))
    angles = [solve_ik(CellArm(cell, arm), X, posture=cell.arms[arm].posture) for arm, X in poses.items()]
    return plant.model.configuration(angles, start)


def gap_at(t, e_0, omega, zeta):
    """e'' + 2 zeta omega e' + omega^2 e = 0 from e_0 at rest."""
    if zeta == 1.0:
        return e_0 * (1.0 + omega * t) * np.exp(-omega * t)
    damped = omega * np.sqrt(1.0 - zeta**2)
    return e_0 * np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))


@pytest.mark.parametrize("zeta", [1.0, 0.3])
@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_closure_opened_by_a_decimetre_recovers_at_the_baumgarte_rate(case, formulation, zeta):
    name, _ = case
    omega, h, steps = 12.0, 2e-3, 150
    plant, _ = chain_of(
        case, formulation=formulation, stabilisation=Stabilisation(frequency=omega, damping_ratio=zeta)
    )
    model = plant.mechanism.model
    q, v = opened_by_a_decimetre(plant, name), np.zeros(model.nv)
    integrator = RungeKutta(configuration_space(model))

    def unforced(_t, q, v):
        return plant.mechanism.solver.acceleration(q, v, np.zeros(model.nv)), np.zeros(0)

    measured = [plant.closure_errors(q)]
    for _ in range(steps):
        q, v, _ = integrator.step(unforced, 0.0, q, v, h)
        measured.append(plant.closure_errors(q))
    expected = np.abs(gap_at(h * np.arange(steps + 1), 0.1, omega, zeta))
    assert_allclose([closure_errors[1].distance for closure_errors in measured], expected, rtol=0, atol=1e-6)
    assert_allclose(
        [closure_errors[1].angle for closure_errors in measured], np.zeros(steps + 1), rtol=0, atol=1e-6
    )
    assert_allclose(
        [closure_errors[0] for closure_errors in measured], np.zeros((steps + 1, 2)), rtol=0, atol=1e-6
    )


def test_a_ball_joint_opened_by_a_decimetre_recovers_at_the_baumgarte_rate_too():
    cell, _ = cell_and_start("spatial")
    plant, omega, h, steps = CellChain(cell), 12.0, 2e-3, 150
    chain = ClosedChain(
        plant.mechanism.model,
        [Closure("right/grasp", "payload/right", "point")],
        stabilisation=Stabilisation(frequency=omega),
    )
    integrator = RungeKutta(configuration_space(chain.model))
    for solver in (chain.solver, kkt_of(chain).solver):
        q, v = opened_by_a_decimetre(plant, "spatial"), np.zeros(chain.model.nv)
        measured = [chain.closure_errors(q)[0].distance]
        for _ in range(steps):
            q, v, _ = integrator.step(
                lambda _t, q, v, s=solver: (s.acceleration(q, v, np.zeros(len(v))), np.zeros(0)), 0.0, q, v, h
            )
            measured.append(chain.closure_errors(q)[0].distance)
        assert_allclose(measured, gap_at(h * np.arange(steps + 1), 0.1, omega, 1.0), rtol=0, atol=1e-6)


# ---------------------------------------------------------------- a body cut and welded again


def cut_arm(arm, link, hinge):
    """The arm with one link cut off, and the closure that holds it again.

    The part beyond hangs on a free-flyer. With a hinge the cut goes through the joint that carries the link
    (an "axis" closure takes its place); otherwise through the link's body, 0.4 of which stays with the arm (a
    "full" closure).
    """
    model, tree = arm.model, pin.Model()
    tree.gravity = model.gravity
    new = {0: 0}
    for joint in range(1, model.njoints):
        inertia, parent = model.inertias[joint], model.parents[joint]
        if joint == link and not hinge:
            new[joint] = tree.addJoint(
                new[parent], model.joints[joint], model.jointPlacements[joint], f"stump {joint}"
            )
            tree.appendBodyToJoint(
                new[joint],
                pin.Inertia(0.4 * inertia.mass, inertia.lever, 0.4 * inertia.inertia),
                pin.SE3.Identity(),
            )
            inertia = pin.Inertia(0.6 * inertia.mass, inertia.lever, 0.6 * inertia.inertia)
        if joint == link:
            stump = (new[parent], model.jointPlacements[joint]) if hinge else (new[joint], pin.SE3.Identity())
            new[joint] = tree.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "cut")
            cut = new[joint]
        else:
            new[joint] = tree.addJoint(
                new[parent], model.joints[joint], model.jointPlacements[joint], f"joint {joint}"
            )
        tree.appendBodyToJoint(new[joint], inertia, pin.SE3.Identity())
    axis = {"X": (0.0, np.pi / 2, 0.0), "Y": (-np.pi / 2, 0.0, 0.0), "Z": (0.0, 0.0, 0.0)}[
        model.joints[link].shortname()[-1]
    ]
    z_along_axis = pin.SE3(pin.rpy.rpyToMatrix(*axis), np.zeros(3))
    for name, (parent, placement) in {"stump": stump, "part": (cut, pin.SE3.Identity())}.items():
        tree.addFrame(pin.Frame(name, parent, 0, placement * z_along_axis, pin.FrameType.OP_FRAME))
    chain = ClosedChain(tree, [Closure("stump", "part", "axis" if hinge else "full")])
    return chain, cut


def cut_state(arm, chain, cut, link, hinge, q, v):
    """The state of the cut tree at which every body moves as in the uncut one."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q, v)
    at = chain.model.idx_vs[cut]
    pose, twist = pin.SE3ToXYZQUAT(data.oMi[link]), data.v[link].vector
    keep = slice(at + 1, None) if hinge else slice(at, None)
    q_cut = np.concatenate((q[:at], pose, q[keep]))
    return q_cut, np.concatenate((v[:at], twist, v[keep]))


def end_motion(model, joint, q, v):
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    return np.concatenate((data.oMi[joint].homogeneous.ravel(), data.v[joint].vector))


@pytest.mark.parametrize("hinge", [False, True], ids=["welded", "hinged"])
@pytest.mark.parametrize("link", ["last", "middle"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_cut_and_closed_arm_moves_as_the_uncut_one(name, link, hinge):
    cell, _ = cell_and_start(name)
    gravity = (0.0, -9.81, 0.0) if name == "planar" else (0.0, 0.0, -9.81)
    arm = ArmModel(cell.arms["right"], cell.grasps["right"].matrix, gravity)
    link = arm.model.njoints - 1 if link == "last" else 2
    chain, cut = cut_arm(arm, link, hinge)
    uncut = ClosedChain(arm.model, [])
    rng = np.random.default_rng(4)
    q, v = np.array(cell.arms["right"].posture), 0.5 * rng.normal(size=arm.nv)
    q_cut, v_cut = cut_state(arm, chain, cut, link, hinge, q, v)
    energy = uncut.energy(q, v).total
    assert_allclose(chain.energy(q_cut, v_cut), uncut.energy(q, v), rtol=1e-12)
    whole, parts = RungeKutta(configuration_space(arm.model)), RungeKutta(configuration_space(chain.model))
    none = np.zeros(0)
    for step in range(400):
        q, v, _ = whole.step(
            lambda _t, q, v: (uncut.solver.acceleration(q, v, np.zeros(len(v))), none), 0.0, q, v, 2.5e-4
        )
        q_cut, v_cut, _ = parts.step(
            lambda _t, q, v: (chain.solver.acceleration(q, v, np.zeros(len(v))), none),
            0.0,
            q_cut,
            v_cut,
            2.5e-4,
        )
        if step % 40 == 39:
            expected = end_motion(arm.model, arm.model.njoints - 1, q, v)
            assert_allclose(
                end_motion(chain.model, chain.model.njoints - 1, q_cut, v_cut), expected, rtol=0, atol=1e-10
            )
            assert_allclose(chain.energy(q_cut, v_cut), uncut.energy(q, v), rtol=0, atol=1e-9)
            assert_allclose(uncut.energy(q, v).total, energy, rtol=0, atol=1e-8)
    assert np.abs(q - np.array(cell.arms["right"].posture)).max() > 0.02


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize("case", CASES, ids=str)
def test_bad_states_are_named(case):
    plant, q = chain_of(case)
    model = plant.mechanism.model
    v, tau = np.zeros(model.nv), np.zeros(model.nv)
    for name, arguments in {"q": (q[:-1], v, tau), "v": (q, v[:-1], tau), "tau": (q, v, tau[:-1])}.items():
        with pytest.raises(ShapeError, match=f"^{name} has shape"):
            plant.mechanism.forward_dynamics(*arguments)
    with pytest.raises(OutOfRangeError, match=r"^tau\[0\] is nan"):
        plant.mechanism.forward_dynamics(q, v, np.full(model.nv, np.nan))


def test_formulations_have_their_solvers_and_anything_else_is_refused():
    plant, _ = chain_of(("planar", "welded"))
    model, closures = plant.mechanism.model, plant.mechanism.closures.closures
    kinds = {name: type(ClosedChain(model, closures, formulation=name).solver) for name in ("auto", "kkt")}
    assert kinds == {"auto": ProximalSolver, "kkt": KKTSolver}
    with pytest.raises(ArgumentError):
        ClosedChain(model, closures, formulation=np.array(["kkt", "auto"]))


def test_rows_that_the_proximal_solver_can_express():
    kinds = {
        rows: ProximalSolver.can_solve([Closure("a", "b"), Closure("a", "b", rows)])
        for rows in ("full", "point", "planar", "axis", (False, False, False, True, True, True))
    }
    assert [rows for rows, can in kinds.items() if can] == ["full", "point"]
    assert ProximalSolver.can_solve([])


def test_the_kkt_solver_has_no_wrenches_before_its_first_solution():
    chain = kkt_of(chain_of(("planar", "welded"))[0].mechanism)
    assert chain.solver.wrenches().tolist() == [[0.0] * 6]


def test_the_rank_counts_singular_values_beyond_a_part_of_the_largest():
    for scale in (1e-7, 1.0, 1e7):
        for smallest, rank in ((2e-5, 3), (0.5e-5, 2)):
            svd = constraint_svd(np.eye(4), scale * np.diag([1.0, 0.1, smallest, 0.0])[:3])
            assert (svd.rank, svd.left.shape, svd.right.shape) == (rank, (3, rank), (4, rank))
            assert_close(svd.dropped, 0.0 if rank == 3 else scale * smallest, atol=1e-9 * scale)
    assert constraint_svd(np.eye(4), np.zeros((0, 4))).rank == 0


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_start_is_open_beyond_a_millimetre_or_a_milliradian(case):
    """The last joint of an arm turns its tip about a point a lever away: an angle of that size, and less."""
    plant, q = chain_of(case)
    plant.mechanism.open_allowed = OPEN_ALLOWED
    chain, still = plant.mechanism, np.zeros(plant.mechanism.model.nv)
    for turn, is_open in ((0.8e-3, False), (1.3e-3, True)):
        off = still.copy()
        off[plant.model.arms[1].v_slice.stop - 1] = turn
        start = pin.integrate(chain.model, q, off)
        assert_close(max(max(gap) for gap in chain.closure_errors(start)), turn, atol=0.2 * turn)
        if is_open:
            with pytest.raises(OpenClosureError):
                chain.integrate(start, still, duration=1e-3, step=1e-3)
        else:
            chain.integrate(start, still, duration=1e-3, step=1e-3)


def test_a_motion_needs_eight_bytes_for_each_number_of_each_step():
    chain = chain_of(("spatial", "free"))[0].mechanism
    q, v = np.array(pin.neutral(chain.model)), np.zeros(chain.model.nv)
    assert chain.model.nq == chain.model.nv + 1 == 19
    with pytest.raises(NotEnoughMemoryError) as caught:
        chain.integrate(q, v, duration=1e9, step=1e-9)
    assert caught.value.needed == pytest.approx(1e18 * 8 * (1 + 19 + 18), rel=1e-6)


def test_closures_that_contradict_each_other_are_refused():
    """Two closures that hold one frame at two places contradict each other."""
    cell, start = cell_and_start("spatial")
    plant = CellChain(cell)
    contradictory = [Closure("left/grasp", "universe"), Closure("left/grasp", "payload/right")]
    chain = ClosedChain(plant.mechanism.model, contradictory, open_allowed=10.0)
    with pytest.raises(ConstraintSolveError):
        chain.forward_dynamics(
            plant.configuration(start),
            random_velocity(plant.mechanism, plant.configuration(start), 0),
            np.zeros(chain.model.nv),
        )


@pytest.fixture
def solved_as(monkeypatch):
    """The forward dynamics of a chain at a state, had its solver found an acceleration."""

    def solved(chain, q, v, a):
        monkeypatch.setattr(chain.solver, "acceleration", lambda *_: a)
        return chain.forward_dynamics(q, v, np.zeros(chain.model.nv))

    return solved


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_solution_is_refused_from_a_millionth_of_the_accelerations_on(case, solved_as):
    plant, q = chain_of(case)
    chain, still = plant.mechanism, np.zeros(plant.mechanism.model.nv)
    good = chain.forward_dynamics(q, still, still)
    J = chain.closures.state(q, still).jacobian
    off = np.linalg.pinv(J)[:, 0]  # moves a residual row by one
    off = off / np.abs(J @ off).max()
    allowed = 1e-6 * (1.0 + np.abs(good.acceleration).max())

    def solved_but_for(residual):
        return solved_as(chain, q, still, good.acceleration + residual * off).residual

    assert_close(solved_but_for(0.5 * allowed), 0.5 * allowed, atol=0.01 * allowed)
    with pytest.raises(ConstraintSolveError) as refused:
        solved_but_for(2.0 * allowed)
    assert_close(refused.value.residual, 2.0 * allowed, atol=0.02 * allowed)
    assert_close(refused.value.allowed, allowed, atol=1e-3 * allowed)


def test_near_a_singular_pose_the_allowance_grows_with_what_was_truncated(solved_as):
    """By 10 s |L^T a| for the truncated singular value s: the norm of a in the mass metric, a^T M a."""
    chain = four_bar.four_bars(1)
    q, v = four_bar.start(chain, 1, angle=1e-6)
    a = np.array([3.0, -2.0, 5.0])
    with pytest.raises(ConstraintSolveError) as refused:
        solved_as(chain, q, v, a)
    M = symmetric(pin.crba(chain.model, chain.model.createData(), q))
    J = chain.closures.state(q, v).jacobian
    weighted = J @ np.linalg.inv(np.linalg.cholesky(M)).T
    values = np.linalg.svd(weighted, compute_uv=False)
    truncated = values[values < 1e-5 * values[0]].max()
    assert truncated > 1e-8
    assert_close(refused.value.allowed, 6e-6 + 10.0 * truncated * np.sqrt(a @ M @ a), atol=1e-9)


@pytest.mark.parametrize("damping", [0.0, 0.3, 1.0])
def test_the_least_motion_is_that_of_the_damped_normal_equations(damping):
    """M^-1 J^T (W + mu s_1^2 I)^-1 target with W = J M^-1 J^T, whose largest eigenvalue is s_1^2."""
    rng = np.random.default_rng(5)
    root, J, target = rng.normal(size=(5, 5)), rng.normal(size=(3, 5)), rng.normal(size=3)
    M = root @ root.T + np.eye(5)
    W = J @ np.linalg.solve(M, J.T)
    damped = W + damping * np.linalg.eigvalsh(W)[-1] * np.eye(3)
    found = constraint_svd(M, J).least_motion(target, damping)
    assert_close(found, np.linalg.solve(M, J.T @ np.linalg.solve(damped, target)), atol=1e-12)


def test_a_torque_that_grows_with_time_is_integrated_exactly_up_to_the_third_power():
    """Runge and Kutta's weights are Simpson's: inertia v = t^4 / 4 for a torque of t^3, in any steps."""
    chain = ClosedChain.from_urdf(robot(bar("one", "ground", (0, 0, 0))), gravity=(0, 0, 0))
    inertia = pin.crba(chain.model, chain.model.createData(), np.zeros(1))[0, 0]
    motion = chain.integrate([0.0], [0.0], duration=2.0, step=0.5, torque=lambda t, *_: np.array([t**3]))
    assert_close(motion.v[:, 0] * inertia, motion.time**4 / 4.0, atol=1e-12)


def test_gravity_points_down_when_omitted():
    chain = ClosedChain.from_urdf(robot(bar("one", "ground", (0, 0, 0))))
    assert chain.model.gravity.linear.tolist() == [0.0, 0.0, -9.81]
