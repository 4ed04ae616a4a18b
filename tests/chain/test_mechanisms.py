"""Mechanisms: URDF trees closed to loops, against closed forms, energies and each other."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from close import assert_close
from linkages import (
    A,
    B,
    bar,
    bead,
    bennett,
    four_bar,
    four_bar_error,
    four_bar_tip,
    joint,
    link,
    robot,
    sarrus,
)
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import (
    ArgumentError,
    ConstraintSolveError,
    FieldError,
    IntegrationError,
    MassMatrixError,
    MimicJointError,
    NameNotFoundError,
    OpenClosureError,
    OutOfRangeError,
    ShapeError,
    UrdfError,
    UrdfWarning,
)
from coop_pin.base.spatial import make_pose, rotation_from_rpy
from coop_pin.chain import ChainDynamics, ChainState, Trajectory


def energies(chain, motion):
    return np.array([chain.energy(q, v).total for q, v in zip(motion.q, motion.v, strict=True)])


def widest_gap(chain, motion):
    return max(max(max(gap) for gap in chain.closure_errors(q)) for q in motion.q)


# ---------------------------------------------------------------- the N-loop four-bar


def test_the_two_closed_forms_agree():
    time = np.linspace(0.0, 10.0, 400)
    for loops in (1, 2, 40):
        assert_allclose(four_bar.closed_form(loops, time), four_bar_tip(loops, time), rtol=0, atol=1e-9)


@pytest.mark.parametrize("duration", [1.5, pytest.param(10.0, marks=pytest.mark.slow)])
def test_two_loops_follow_the_closed_form_to_a_nanometre_at_a_millisecond(duration):
    assert four_bar_error(2, 1e-3, duration) < 1e-9


@pytest.mark.parametrize(
    "step", [*(pytest.param(step, marks=pytest.mark.slow) for step in (2e-3, 5e-3)), 1e-2]
)
def test_two_loops_follow_the_closed_form_through_their_singular_poses(step):
    assert four_bar_error(2, step, 10.0) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("step", [1e-4, 2e-4, 5e-4])
def test_small_steps_do_not_fail_at_singular_poses(step):
    assert four_bar_error(2, step, 10.0) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("step", 1e-3 * np.array([0.454369, 0.636189, 1.156126, 3.3333]))
def test_no_step_is_unlucky_enough_to_fail_at_singular_poses(step):
    assert four_bar_error(2, step, 10.0) < 1e-4


@pytest.mark.slow
def test_forty_loops_follow_the_closed_form():
    """On one thread: those of BLAS only wait for each other at 120 x 81, minutes long on a busy machine."""
    script = "import linkages; print(linkages.four_bar_error(40, 1e-2, 20.0))"
    one_thread = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=Path(__file__).parents[1],
        env=one_thread,
        capture_output=True,
        text=True,
        check=True,
    )
    assert float(done.stdout) < 1e-3


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, -1e-4, np.pi])
def test_a_motion_may_start_at_or_next_to_the_singular_pose(angle):
    chain = four_bar.four_bars(2)
    q, v = four_bar.start(chain, 2, angle, -5.0)
    assert chain.forward_dynamics(q, v, np.zeros(5)).rank == (2 if abs(np.sin(angle)) < 1e-5 else 4)
    motion = chain.integrate(q, v, duration=0.8, step=5e-3)
    energy = energies(chain, motion)
    assert_allclose(energy, energy[0], rtol=0, atol=1e-5)
    assert_allclose(
        motion.q[:, ::2], motion.q[:, :1] @ np.ones((1, 3)), rtol=0, atol=1e-6
    )  # the uprights stay parallel
    assert widest_gap(chain, motion) < 1e-9


def test_the_rank_falls_at_the_singular_pose_and_redundant_rows_are_counted_out():
    chain = four_bar.four_bars(3)
    assert chain.closures.rows == 9
    for angle, rank in ((1.0, 6), (0.1, 6), (0.0, 3)):
        assert chain.forward_dynamics(*four_bar.start(chain, 3, angle), np.zeros(7)).rank == rank


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_the_error_is_of_fourth_order_before_the_singular_pose(kind, monkeypatch):
    revolute = four_bar.rod
    monkeypatch.setattr(four_bar, "rod", lambda *where: revolute(*where).replace('"revolute"', f'"{kind}"'))
    errors = [four_bar_error(2, step, 0.5) for step in (2e-2, 1e-2, 5e-3)]
    assert_close(np.log2(np.array(errors[:-1]) / errors[1:]), 4.0, atol=0.25)


def test_without_projection_the_closures_drift_and_with_it_they_do_not():
    chain = four_bar.four_bars(2)
    closure_errors = {}
    for project in (True, False):
        q, v = four_bar.start(chain, 2)
        q = q + 1e-7 * np.array((0, 0, 1, 0, 0))
        closure_errors[project] = widest_gap(
            chain, chain.integrate(q, v, duration=0.4, step=5e-3, project=project)
        )
    assert closure_errors[True] < 1e-11
    assert 1e-9 < closure_errors[False] < 1e-5


# ---------------------------------------------------------------- over-constrained loops in space


def test_a_sarrus_linkage_has_one_redundant_row_keeps_its_energy_and_moves_its_plate_straight():
    chain, rest = sarrus()
    start = chain.assemble(rest + 0.03, chain.velocity({"lower_pin": 0.6}))
    stiffness = 60.0
    assert chain.closures.rows == 5
    assert chain.forward_dynamics(*start, np.zeros(5)).rank == 4
    motion = chain.integrate(*start, duration=2.0, step=1e-3, torque=lambda _t, q, _v: stiffness * (rest - q))
    energy = energies(chain, motion) + 0.5 * stiffness * ((motion.q - rest) ** 2).sum(axis=1)
    assert_allclose(energy, energy[0], rtol=0, atol=1e-9)
    plates = np.array([chain.frame_pose(q, "plate") for q in motion.q[::20]])
    assert_allclose(plates[:, :3, :3], np.broadcast_to(np.eye(3), (len(plates), 3, 3)), rtol=0, atol=1e-12)
    assert_allclose(plates[:, :2, 3], np.broadcast_to((1.0, 0.0), (len(plates), 2)), rtol=0, atol=1e-12)
    assert np.ptp(plates[:, 2, 3]) > 0.2


@pytest.mark.parametrize(("rows", "count", "rank"), [("point", 3, 2), ("axis", 5, 2), ("full", 6, 3)])
def test_a_bennett_linkage_turns_however_it_is_closed(rows, count, rank):
    """tan(theta_1 / 2) tan(theta_2 / 2) is constant, theta_3 = -theta_1, also with redundant rows."""
    chain, start = bennett(rows)
    assert chain.closures.rows == count
    assert chain.forward_dynamics(*start, np.zeros(chain.model.nv)).rank == rank
    motion = chain.integrate(*start, duration=3.0, step=4e-3)
    energy = energies(chain, motion)
    assert_allclose(energy, energy[0], rtol=0, atol=2e-6)
    first, second = motion.q[:, 0], motion.q[:, 1]
    assert np.ptp(first) > 2.0
    ratio = abs(np.sin((1.1 + 0.5) / 2) / np.sin((1.1 - 0.5) / 2))
    sines, cosines = np.sin(first / 2) * np.sin(second / 2), np.cos(first / 2) * np.cos(second / 2)
    assert_allclose(np.abs(sines), ratio * np.abs(cosines), rtol=0, atol=1e-10)
    assert_close(np.sin((motion.q[:, 2] + first) / 2), 0.0, atol=1e-10)
    assert A / np.sin(0.5) == pytest.approx(B / np.sin(1.1))


def test_a_bennett_linkage_moves_the_same_with_point_and_with_axis_rows():
    chain, start = bennett("axis")
    other, _ = bennett("point")
    motions = [each.integrate(*start, duration=1.0, step=2e-3) for each in (chain, other)]
    assert_allclose(motions[0].q, motions[1].q, rtol=0, atol=1e-7)
    assert_allclose(motions[0].v, motions[1].v, rtol=0, atol=1e-6)


# ---------------------------------------------------------------- two formulations


def four_bars_and_start():
    chain = four_bar.four_bars(2)
    return chain, ChainState(*four_bar.start(chain, 2))


@pytest.mark.parametrize(
    "mechanism",
    [four_bars_and_start, lambda: bennett("point"), lambda: bennett("full")],
    ids=["four-bars", "Bennett, point", "Bennett, full"],
)
def test_constraint_dynamics_and_the_kkt_agree_along_the_motion(mechanism):
    chain, start = mechanism()
    motion = chain.integrate(*start, duration=2.0, step=4e-3)
    proximal = cp.ClosedChain(chain.model, chain.closures.closures, formulation="proximal")
    kkt = cp.ClosedChain(chain.model, chain.closures.closures, formulation="kkt")
    tau = 0.3 * np.arange(chain.model.nv)
    compared = 0
    for q, v in zip(motion.q[::4], motion.v[::4], strict=True):
        two = kkt.forward_dynamics(q, v, tau)
        if two.rank < chain.forward_dynamics(*start, tau).rank or np.abs(np.sin(q[0])) < 1e-2:
            continue
        one = proximal.forward_dynamics(q, v, tau)
        assert_allclose(one.acceleration, two.acceleration, rtol=1e-9, atol=1e-9)
        assert one.rank == two.rank
        compared += 1
    assert compared > 100


def test_formulations_are_chosen_by_name():
    chain = four_bar.four_bars(1, formulation="kkt")
    closures = chain.closures.closures
    with pytest.raises(ArgumentError, match="'auto', 'proximal' or 'kkt'"):
        cp.ClosedChain(chain.model, closures, formulation="fast")
    with pytest.raises(ArgumentError, match="only 'full' and 'point' rows"):
        cp.ClosedChain(chain.model, [cp.Closure("level0", "world", "axis")], formulation="proximal")


# ---------------------------------------------------------------- rows, frames and the world


@pytest.mark.filterwarnings(
    "ignore::coop_pin.base.errors.UrdfWarning"
)  # links between the slides have no mass
def test_two_held_translations_let_a_bead_slide_along_the_third():
    X = make_pose((0.0, 0.0, 0.0), (0.4, -0.7, 1.3))
    along = X[:3, 2]
    for rows in ((True, True, False, False, False, False), [1, 1, 0, 0, 0, 0]):
        chain = bead(rows, X)
        answer = chain.forward_dynamics(np.zeros(3), np.zeros(3), np.zeros(3))
        assert_allclose(answer.acceleration, -9.81 * along[2] * along, rtol=0, atol=1e-12)
        assert answer.rank == 2
        # The wire carries what gravity does across it: on the wire by the bead, in the wire's axes.
        force = answer.closure_wrenches[0, :3]
        assert_allclose(
            X[:3, :3] @ force, (np.array((0, 0, -9.81)) + 9.81 * along[2] * along), rtol=0, atol=1e-12
        )
        motion = chain.integrate(np.zeros(3), np.zeros(3), duration=1.0, step=0.1)
        assert_allclose(
            motion.q, -0.5 * 9.81 * along[2] * np.outer(motion.time**2, along), rtol=0, atol=1e-12
        )


def ladder(**options):
    """A bar that slides in its plane, one end on a wall (x = 0), the other on the floor (y = 0)."""
    slides = [
        joint("a", "ground", (0, 0, 0), axis="1 0 0", kind="prismatic"),
        joint("b", "a", (0, 0, 0), axis="0 1 0", kind="prismatic"),
    ]
    urdf = robot('<link name="a"/><link name="b"/>', *slides, bar("rod", "b", (0, 0, 0)))
    closures = [
        cp.Closure("world", "rod", (False, True, False, False, False, False)),
        cp.Closure("world", "rod", (True, False, False, False, False, False), X_BC=make_pose((1, 0, 0))),
    ]
    return cp.ClosedChain.from_urdf(urdf, closures, gravity=(0, -9.81, 0), **options)


@pytest.mark.filterwarnings("ignore::coop_pin.base.errors.UrdfWarning")
def test_a_ladder_on_floor_and_wall_falls_like_the_pendulum_it_is():
    """theta'' = -(3 g / 2 l) cos theta for the angle of the rod at its foot: a pendulum once more."""
    chain = ladder()
    start = chain.assemble(chain.configuration({"a_pin": 0.3, "rod_pin": 2.0}))
    motion = chain.integrate(*start, duration=1.0, step=1e-3)
    theta, rate = motion.q[:, 2], motion.v[:, 2]
    assert_allclose(motion.q[:, 0], -np.cos(theta), rtol=0, atol=1e-12)
    assert_allclose(
        0.5 * rate**2 + 1.5 * 9.81 * np.sin(theta), 1.5 * 9.81 * np.sin(theta[0]), rtol=0, atol=1e-8
    )
    assert np.ptp(theta) > 0.5


def test_a_closure_may_be_named_from_either_side_and_the_world_has_two_names():
    chain = four_bar.four_bars(2)
    start = four_bar.start(chain, 2)
    end = make_pose((1, 0, 0))
    loose = [cp.Closure(f"upright{i + 1}", f"level{i}", "point", X_AC=end, X_BC=end) for i in range(2)]
    swapped = cp.ClosedChain(chain.model, loose)
    tau = np.arange(5.0)
    one, two = chain.forward_dynamics(*start, tau), swapped.forward_dynamics(*start, tau)
    assert_allclose(one.acceleration, two.acceleration, rtol=1e-10, atol=1e-10)
    held = [
        cp.Closure("level1", world, "full", X_BC=chain.frame_pose(start[0], "level1"))
        for world in ("world", "universe")
    ]
    for closure in held:
        stuck = cp.ClosedChain(chain.model, [*chain.closures.closures, closure])
        assert_close(stuck.forward_dynamics(start[0], np.zeros(5), np.zeros(5)).acceleration, 0.0, atol=1e-9)


def test_poses_of_a_closure_do_what_frames_of_the_urdf_do():
    rpy, xyz = (0.3, -0.2, 0.5), (0.7, 0.1, -0.2)
    fixed = f"""<link name="tool"/>
      <joint name="tool_fix" type="fixed"><parent link="two"/><child link="tool"/>
    <origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/></joint>"""
    arm = [
        bar("one", "ground", (0, 0, 0), axis="0 1 0"),
        bar("two", "one", (1, 0, 0), (0.2, 0, 0), "0 0.6 0.8"),
        fixed,
    ]
    q, v = np.array((0.4, -0.9)), np.array((0.5, 1.5))
    for rows in ("axis", "planar", (True, False, True, False, False, True)):
        answers = []
        for frame, X in (("tool", None), ("two", make_pose(xyz, rpy))):
            chain = cp.ClosedChain.from_urdf(
                robot(*arm), [cp.Closure("world", frame, rows, X_AC=make_pose((0.1, 0.2, 0.3)), X_BC=X)]
            )
            answers.append(chain.closures.state(q, v))
        for one, two in zip(*answers, strict=True):
            assert_allclose(one, two, rtol=0, atol=1e-13)


# ---------------------------------------------------------------- torque, time and results


def sled(**options):
    return cp.ClosedChain.from_urdf(
        robot(link("sled"), joint("sled", "ground", (0, 0, 0), axis="1 0 0", kind="prismatic")), **options
    )


def test_a_tree_without_closures_moves_too_and_torque_sees_the_times_of_the_stages():
    chain, errors = sled(), []
    for step in (0.2, 0.1):
        motion = chain.integrate(
            [0.0], [0.0], duration=2.0, step=step, torque=lambda t, _q, _v: [np.cos(3.0 * t)]
        )
        errors.append(abs(motion.q[-1, 0] - (1.0 - np.cos(6.0)) / 9.0))
    assert errors[1] < 1e-5
    assert_close(np.log2(errors[0] / errors[1]), 4.0, atol=0.3)


def test_torque_sees_the_state_and_cannot_change_it():
    def damper(_t, q, v):
        q[:] = np.nan
        return -2.0 * v

    motion = sled().integrate([0.0], [1.0], duration=1.0, step=0.01, torque=damper)
    assert_allclose(motion.v[:, 0], np.exp(-2.0 * motion.time), rtol=1e-8)


def test_time_ends_at_the_duration_even_where_the_step_does_not_divide_it():
    chain = sled()
    assert_allclose(chain.integrate([0.0], [1.0], duration=0.35, step=0.1).time, [0.0, 0.1, 0.2, 0.3, 0.35])
    motion = chain.integrate([0.0], [1.0], duration=0.3, step=0.1)
    assert isinstance(motion, Trajectory)
    assert_allclose(motion.time, [0.0, 0.1, 0.2, 0.3])
    assert_close(motion.q[:, 0], motion.time, atol=1e-14)
    assert chain.integrate([0.0], [1.0], duration=0.05, step=0.1).q.shape == (2, 1)


def test_results_are_named_and_stay_what_they_were():
    chain = four_bar.four_bars(1)
    q, v = four_bar.start(chain, 1)
    given = q.copy(), v.copy()
    motion = chain.integrate(q, v, duration=0.1, step=0.01)
    answer, energy = chain.forward_dynamics(q, v, np.zeros(3)), chain.energy(q, v)
    kept = [np.copy(field) for field in answer]
    chain.integrate(motion.q[-1], motion.v[-1], duration=0.1, step=0.01)
    assert isinstance(answer, ChainDynamics)
    for field, copy in zip(answer, kept, strict=True):
        assert_allclose(field, copy, rtol=0, atol=0)
    assert_allclose(q, given[0], rtol=0, atol=0)
    assert_allclose(v, given[1], rtol=0, atol=0)
    # Two upright rods turn about their feet, the level one moves with their tips at 1 m/s.
    assert energy.kinetic == pytest.approx(2 * 0.5 / 3 + 0.5, rel=1e-12)
    assert energy.potential == pytest.approx(9.81 * (2 * 0.5 + 1.0), rel=1e-12)
    assert energy.total == pytest.approx(energy.kinetic + energy.potential)


def test_joints_are_set_by_name_also_continuous_ones():
    turning = robot(link("a"), joint("a", "ground", (0, 0, 0), kind="continuous"), bar("b", "a", (1, 0, 0)))
    chain = cp.ClosedChain.from_urdf(turning)
    assert_close(chain.configuration({"a_pin": 2.0}), [np.cos(2.0), np.sin(2.0), 0.0], atol=1e-15)
    assert_allclose(chain.velocity({"b_pin": -1.0}), [0.0, -1.0])
    assert_close(
        chain.frame_pose(chain.configuration({"a_pin": 0.3, "b_pin": 0.2}), "b")[:3, :3],
        rotation_from_rpy((0, 0, 0.5)),
        atol=1e-15,
    )
    with pytest.raises(NameNotFoundError, match="a_pin"):
        chain.configuration({"a_pn": 1.0})


# ---------------------------------------------------------------- assembly


def test_assembly_closes_a_guess_and_makes_the_velocity_consistent():
    chain = four_bar.four_bars(2)
    q, v = four_bar.start(chain, 2, angle=1.0)
    rng = np.random.default_rng(6)
    for _ in range(5):
        guess = q + rng.uniform(-0.4, 0.4, 5)
        start = chain.assemble(guess, v + rng.normal(size=5))
        assert_close([gap.distance for gap in chain.closure_errors(start.q)], 0.0, atol=1e-11)
        state = chain.closures.state(start.q, start.v)
        assert_close(state.velocity, 0.0, atol=1e-11)
        assert np.abs(pin.difference(chain.model, q, start.q)).max() < 2.0
    at_rest = chain.assemble(guess)
    assert_allclose(at_rest.q, start.q, rtol=0, atol=0)
    assert_close(at_rest.v, 0.0, atol=0)
    again = chain.assemble(*start)
    assert_allclose(again.q, start.q, rtol=0, atol=1e-12)


def test_what_cannot_be_closed_is_refused_with_the_gap():
    far = make_pose((5.0, 0, 0))
    chain = cp.ClosedChain.from_urdf(
        robot(bar("one", "ground", (0, 0, 0)), bar("two", "one", (1, 0, 0))),
        [cp.Closure("two", "world", "point", make_pose((1, 0, 0)), far)],
    )
    with pytest.raises(OpenClosureError, match="'two - world' is 3 m") as refused:
        chain.assemble([0.3, 0.4])
    assert refused.value.distance == pytest.approx(3.0, rel=1e-3)


def test_an_open_start_is_refused_and_a_rounded_one_is_closed():
    chain = four_bar.four_bars(2)
    q, v = four_bar.start(chain, 2, angle=1.0)
    with pytest.raises(OpenClosureError, match=r"is 0\.1"):
        chain.integrate(q + 0.12 * np.array((0, 0, 0, 0, 1)), v, duration=0.1, step=0.01)
    motion = chain.integrate(np.round(q, 4) + 1e-4, v, duration=0.1, step=0.01)
    assert widest_gap(chain, motion) < 1e-11


# ---------------------------------------------------------------- bad input

END = make_pose((1, 0, 0))


def test_bad_closures_are_named():
    with pytest.raises(NameNotFoundError, match="did you mean 'level0'"):
        cp.ClosedChain(four_bar.four_bars(1).model, [cp.Closure("levl0", "upright1", "point")])
    with pytest.raises(FieldError, match="rows"):
        cp.ClosedChain(four_bar.four_bars(1).model, [cp.Closure("level0", "upright1", None)])
    with pytest.raises(FieldError, match="rows"):
        cp.ClosedChain(four_bar.four_bars(1).model, [cp.Closure("level0", "upright1", (1, 2, 0, 0, 0, 0))])
    with pytest.raises(ShapeError, match="X_BC has shape"):
        cp.Closure("a", "b", X_BC=np.eye(3))
    with pytest.raises(OutOfRangeError, match=r"X_AC\[0, 3\]"):
        cp.Closure("a", "b", X_AC=make_pose() + np.pad([[np.nan]], ((0, 3), (3, 0))))
    with pytest.raises(OutOfRangeError, match="X_AC"):
        cp.Closure("a", "b", X_AC=np.diag((1.0, 1.0, -1.0, 1.0)))


def test_bad_urdfs_are_typed_errors():
    with pytest.raises(UrdfError):
        cp.ClosedChain.from_urdf("no_such_mechanism.urdf")
    with pytest.raises(UrdfError, match="two_parents"):
        cp.ClosedChain.from_urdf(
            robot(bar("a", "ground", (0, 0, 0)), joint("a", "ground", (1, 0, 0)).replace("a_pin", "again"))
        )
    with pytest.raises(UrdfError):
        cp.ClosedChain.from_urdf("<robot")
    with pytest.raises(MimicJointError, match="b_pin") as caught:
        cp.ClosedChain.from_urdf(mimicking())
    assert "locked" not in str(caught.value)  # which a mechanism does not have
    follower = '<joint name="b_pin" type="{}"'
    assert '"fixed"' in str(caught.value)
    assert follower.format("revolute") in mimicking()
    fixed = mimicking().replace(follower.format("revolute"), follower.format("fixed"))
    assert cp.ClosedChain.from_urdf(fixed).model.nv == 1
    assert cp.ClosedChain.from_urdf(mimicking(), mimic="ignore").model.nv == 2
    with pytest.raises(ShapeError, match="gravity"):
        cp.ClosedChain.from_urdf(mimicking(), gravity=9.81, mimic="ignore")


def mimicking():
    return robot(
        bar("a", "ground", (0, 0, 0)), link("b"), joint("b", "a", (1, 0, 0), extra='<mimic joint="a_pin"/>')
    )


def test_a_file_a_name_and_text_are_the_same_to_it(tmp_path):
    text = robot(bar("a", "ground", (0, 0, 0)))
    (tmp_path / "bar.urdf").write_text(text)
    for urdf in (text, "\n" + text, tmp_path / "bar.urdf", str(tmp_path / "bar.urdf")):
        assert cp.ClosedChain.from_urdf(urdf).model.nv == 1
    assert cp.ClosedChain.from_urdf("adept_3dof").model.nv == 3


@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
def test_a_link_without_mass_is_named_when_it_has_to_move(formulation):
    with pytest.warns(UrdfWarning):
        chain = cp.ClosedChain.from_urdf(
            robot(bar("a", "ground", (0, 0, 0)), '<link name="b"/>', joint("b", "a", (1, 0, 0))),
            formulation=formulation,
        )
    with pytest.raises(MassMatrixError, match="every moving link"):
        chain.forward_dynamics(np.zeros(2), np.zeros(2), np.zeros(2))
    with pytest.raises(MassMatrixError):
        chain.integrate(np.zeros(2), np.zeros(2), duration=0.1, step=0.01)


BAD_RUNS = {
    "short q": ({"q": np.zeros(2)}, ShapeError, "^q has shape"),
    "long v": ({"v": np.zeros(4)}, ShapeError, "^v has shape"),
    "nan in q": ({"q": [np.nan, 0, 0]}, OutOfRangeError, r"^q\[0\] is nan"),
    "infinite v": ({"v": [0, np.inf, 0]}, OutOfRangeError, r"^v\[1\] is inf"),
    "words": ({"q": "upright"}, ArgumentError, "^q has entries of type"),
    "negative step": ({"step": -1e-3}, OutOfRangeError, "^step is -0.001"),
    "no step": ({"step": 0.0}, OutOfRangeError, "^step is 0"),
    "nan step": ({"step": np.nan}, OutOfRangeError, "^step is nan"),
    "two steps": ({"step": [0.1, 0.2]}, ShapeError, "^step has shape"),
    "no duration": ({"duration": 0.0}, OutOfRangeError, "^duration is 0"),
    "endless": ({"duration": np.inf}, OutOfRangeError, "^duration is inf"),
    "torque is an array": ({"torque": np.zeros(3)}, ArgumentError, "must be a function of"),
    "torque is short": ({"torque": lambda *_: np.zeros(2)}, ShapeError, r"^torque\(t, q, v\) has shape"),
    "torque is nan": (
        {"torque": lambda *_: np.full(3, np.nan)},
        OutOfRangeError,
        r"^torque\(t, q, v\)\[0\] is nan",
    ),
    "torque is nothing": ({"torque": lambda *_: None}, (ShapeError, OutOfRangeError), r"^torque\(t, q, v\)"),
}


@pytest.mark.parametrize("case", BAD_RUNS)
def test_bad_arguments_of_a_motion_are_named(case):
    change, error, match = BAD_RUNS[case]
    chain = four_bar.four_bars(1)
    q, v = four_bar.start(chain, 1)
    with pytest.raises(error, match=match):
        chain.integrate(**({"q": q, "v": v, "duration": 0.1, "step": 0.01} | change))


def test_a_motion_that_runs_away_keeps_what_was_good():
    chain = four_bar.four_bars(1)
    with pytest.raises(IntegrationError, match=r"take a step smaller than 0\.01 s") as broken:
        chain.integrate(*four_bar.start(chain, 1), duration=5.0, step=0.01, torque=lambda _t, _q, v: 1e3 * v)
    kept = broken.value.result
    assert isinstance(kept, Trajectory)
    assert kept.time[-1] == broken.value.time > 0.0
    assert len(kept.time) == len(kept.q) == len(kept.v)
    assert np.isfinite(kept.v).all()


def test_closures_that_contradict_each_other_are_refused():
    chain = four_bar.four_bars(1)
    q, v = four_bar.start(chain, 1, angle=1.0)
    end = chain.frame_pose(q, "level0") @ END
    twice = cp.ClosedChain(
        chain.model, [*chain.closures.closures, cp.Closure("world", "level0", "point", X_AC=end, X_BC=END)]
    )
    with pytest.raises(ConstraintSolveError):
        twice.forward_dynamics(q, v, np.zeros(3))
