"""Planned carries: least time against closed forms, torques against forward dynamics, closed-loop runs."""

import json

import numpy as np
import pytest
from cells import SCENARIOS, SPATIAL_START, spatial_scenario
from numpy.testing import assert_allclose
from scipy.optimize import linprog

import coop_pin as cp
from coop_pin import compiled
from coop_pin.base.errors import (
    ArgumentError,
    FieldError,
    FileReadError,
    InfeasibleMotionError,
    OutOfRangeError,
    UnreachablePoseError,
)
from coop_pin.base.spatial import internal_wrenches
from coop_pin.design.carried_path import CarriedLine
from coop_pin.design.carry_limits import CarryLimits, CarryTiming
from coop_pin.design.path_parameterization import PathLimits, fastest, smoothed, times_of
from coop_pin.grasps import CellChain
from coop_pin.reference.pose_reference import check_consistency


def adept(degrees=300, turn=-np.pi / 3.0):
    """Two Adept arms at 1 kHz with a quarter of the URDF's efforts, half a metre from the paper's start."""
    torque = {f"cell.arms.{arm}.torque_limits": EFFORTS for arm in ("left", "right")}
    clock = {"clock.rate_hz": 1000.0, "clock.steps_per_tick": 1}
    scenario = cp.Scenario.load("adept-anchored", {"events": ()} | clock | torque)
    x, y, _ = scenario.start.xyz
    direction = np.radians(degrees)
    ahead = (x + 0.5 * np.cos(direction), y + 0.5 * np.sin(direction), 0.0)
    goal = cp.Pose(xyz=ahead, rpy=(0.0, 0.0, scenario.start.rpy[2] + turn))
    return scenario, scenario.start, goal


def across():
    """The same arms on a line on which torques are the limit all the way."""
    start = cp.Pose(xyz=(0.55, 0.45, 0.0), rpy=(0.0, 0.0, 0.1))
    goal = cp.Pose(xyz=(0.45, 0.45 - np.sqrt(0.24), 0.0), rpy=(0.0, 0.0, 0.1 + np.pi / 3.0))
    return adept()[0], start, goal


def pandas():
    """Two Pandas, between poses where both stay clear of singular ones."""
    start = cp.Pose(xyz=(0.09, -0.1, 0.51), rpy=(0.0, 0.0, -0.4))
    goal = cp.Pose(xyz=(0.08, 0.28, 0.185), rpy=(0.0, 0.0, -0.4 + np.pi / 3.0))
    return cp.Scenario.load("two-pandas-box"), start, goal


def turned():
    """Two UR5 with turned grasps, unequal shares and friction, on a short line."""
    goal = cp.Pose(xyz=(0.5, 0.0, 0.45), rpy=(0.2, -0.1, 0.7))
    return spatial_scenario(), SPATIAL_START, goal


EFFORTS = (75.0, 50.0, 12.5)
SMOOTHING = {"adept": 0.1, "across": 0.03}
CARRIES = {"adept": adept, "across": across, "pandas": pandas, "turned": turned}


@pytest.fixture(scope="module")
def planned():
    plans = {}

    def plan(name):
        if name not in plans:
            scenario, start, goal = CARRIES[name]()
            plans[name] = cp.carry.plan_carry(
                scenario.cell, start, goal, squeeze=scenario.squeeze, smoothing=SMOOTHING.get(name, 0.05)
            )
        return plans[name]

    return plan


def line_of(name):
    scenario, start, goal = CARRIES[name]()
    line = cp.motions.TimedLineMotion(start=start, goal=goal, times=(0.0, 1.0), fractions=(0.0, 1.0))
    return scenario, line


# ---------------------------------------------------------------- least time


def double_integrator(n, acceleration, speed):
    one = np.ones(n)
    a, b = np.stack((one, -one, 0.0 * one), axis=1), np.tile([0.0, 0.0, 1.0], (n, 1))
    return PathLimits(
        np.linspace(0.0, 1.0, n), a, b, -np.array([acceleration, acceleration, speed**2]) * one[:, None]
    )


@pytest.mark.parametrize(("acceleration", "speed"), [(2.0, 0.8), (2.0, 10.0), (0.5, 0.2)])
@pytest.mark.parametrize("n", [51, 200])
def test_least_time_of_a_double_integrator_is_the_closed_form(n, acceleration, speed):
    limits = double_integrator(n, acceleration, speed)
    peak = np.sqrt(acceleration)
    closed = 2.0 / peak if peak <= speed else 1.0 / speed + speed / acceleration
    # A switch of the acceleration between two places costs a part of the spacing.
    assert_allclose(times_of(limits.places, fastest(limits))[-1], closed, rtol=0.5 / n)


def test_a_joint_under_gravity_switches_where_energy_says():
    # s'' = u - g with |u| <= L: rises with L - g, brakes with L + g, which switch at s = (L + g) / (2 L).
    g, L, n = 3.0, 5.0, 401
    one = np.ones((n, 1))
    limits = PathLimits(
        np.linspace(0.0, 1.0, n),
        np.hstack((one, -one, 0.0 * one)),
        np.hstack((0.0 * one, 0.0 * one, one)),
        np.hstack((g - L + 0.0 * one, -g - L + 0.0 * one, -100.0 * one)),
    )
    switch = (L + g) / (2.0 * L)
    closed = np.sqrt(2.0 * switch / (L - g)) + np.sqrt(2.0 * (1.0 - switch) / (L + g))
    assert_allclose(times_of(limits.places, fastest(limits))[-1], closed, rtol=1e-9)


def test_a_moving_average_is_that_of_sampled_fractions():
    """Of a motion that rises and brakes at uneven places; the ends rest, and the width comes on top."""
    places, x, width = np.array((0.0, 0.1, 0.3, 0.6, 0.85, 1.0)), np.array((0, 0.2, 0.5, 0.7, 0.3, 0)), 0.4
    ends = times_of(places, x)
    assert_allclose(ends[:2], (0.0, 2.0 * 0.1 / np.sqrt(0.2)))
    u = np.diff(x) / (2.0 * np.diff(places))
    fine = np.linspace(-width, ends[-1] + width, 200_001)
    i = np.clip(np.searchsorted(ends, fine, side="right") - 1, 0, len(u) - 1)
    h = fine - ends[i]
    s = np.where(fine >= ends[-1], 1.0, places[i] + np.sqrt(x[i]) * h + 0.5 * u[i] * h**2) * (fine > 0.0)
    area = np.concatenate(((0.0,), np.cumsum((s[1:] + s[:-1]) / 2.0 * np.diff(fine))))
    for least in (10, 300):
        times, fractions = smoothed(places, x, width, least)
        assert_allclose(times[[0, -1]], (0.0, ends[-1] + width))
        assert len(times) == max(least, int(8.0 * (ends[-1] / width + 1.0) + 1.0))
        expected = (np.interp(times, fine, area) - np.interp(times - width, fine, area)) / width
        assert_allclose(fractions, expected, rtol=0, atol=1e-8)


def test_the_largest_limit_at_a_place_is_that_of_its_rows():
    a, b, c = np.random.default_rng(1).normal(size=(3, 4, 5))
    u, x = np.random.default_rng(2).normal(size=(2, 4))
    rows = [max(a[i, r] * u[i] + b[i, r] * x[i] + c[i, r] for r in range(5)) for i in range(4)]
    assert_allclose(PathLimits(np.arange(4.0), a, b, c).largest(u, x), rows)


@pytest.mark.parametrize("name", ["adept", "pandas", "turned"])
def test_least_time_is_that_of_a_linear_program(name):
    scenario, line = line_of(name)
    path = CarriedLine(scenario.cell, line).dynamics(np.linspace(0.0, 1.0, 41), scenario.squeeze_wrenches)
    cell = CarryLimits.of(scenario.cell, path, 0.0)
    limits = cell.along(path, np.zeros_like(path.torque[2]))
    x = fastest(limits)
    # The largest sum of x with u eliminated: the fastest profile is the largest at every place at once.
    n, step = len(x), limits.places[1]
    A, b = [], []
    for i in range(n - 1):
        for j in (i, i + 1):
            for row in range(limits.a.shape[1]):
                entries = np.zeros(n)
                entries[i] -= limits.a[j, row] / (2.0 * step)
                entries[i + 1] += limits.a[j, row] / (2.0 * step)
                entries[j] += limits.b[j, row]
                A.append(entries)
                b.append(-limits.c[j, row])
    ends = [(0.0, 0.0), *[(0.0, None)] * (n - 2), (0.0, 0.0)]
    solved = linprog(-np.ones(n), A_ub=np.array(A), b_ub=b, bounds=ends)
    assert (np.array(A) @ x - b).max() < 1e-9
    assert_allclose(times_of(limits.places, x)[-1], times_of(limits.places, solved.x)[-1], rtol=1e-6)


@pytest.mark.parametrize("name", ["across", pytest.param("turned", marks=pytest.mark.slow)])
def test_least_time_falls_with_every_limit_and_is_the_same_backwards(name):
    scenario, line = line_of(name)
    arms = {arm: each.replace(friction="none") for arm, each in scenario.cell.arms.items()}
    cell, times = scenario.cell.replace(arms=arms), list[float]()
    back = line.replace(start=line.goal, goal=line.start)
    for way, reserve in ((line, 0.0), (line, 0.1), (line, 0.3), (back, 0.0)):
        chain = CarriedLine(cell, way)
        path = chain.dynamics(np.linspace(0.0, 1.0, 61), scenario.squeeze_wrenches)
        limits = CarryLimits.of(cell, path, reserve)
        times.append(times_of(path.places, fastest(limits.along(path, np.zeros_like(path.torque[2]))))[-1])
    assert times[0] < times[1] < times[2]
    assert_allclose(times[3], times[0], rtol=1e-6)


# ---------------------------------------------------------------- torques of the plan


@pytest.mark.parametrize("name", ["adept", "pandas", "turned"])
def test_torques_of_a_plan_cause_its_motion_and_squeeze(name, planned):
    plan, (scenario, *_) = planned(name), CARRIES[name]()
    chain, line = CellChain(scenario.cell), CarriedLine(scenario.cell, plan.motion)
    slots = chain.model.arms
    path = line.dynamics(np.linspace(0.0, 1.0, 11), scenario.squeeze_wrenches)
    shares, rows = np.array([slot.share for slot in slots]), list(scenario.cell.task_rows.indices)
    for time in np.linspace(0.0, plan.duration, 7)[1:-1]:
        s = plan.motion.scaling(time)
        q, first, second = line.derivatives(s.value)
        v, a = first * s.rate, first * s.acceleration + second * s.rate**2
        tau = path.transmission.torque([table[0] for table in plan.torques_at([time])])
        tau = tau + path.transmission.friction(v)
        forward = chain.mechanism.forward_dynamics(q, v, tau)
        assert_allclose(forward.acceleration, a, rtol=0, atol=2e-4 * np.abs(a).max())
        target = plan.motion.at(time)
        assert_allclose(chain.payload_pose(q), target.X_WP_d, atol=1e-9)
        assert_allclose(chain.payload_twist(q, v)[rows], target.V_WP_d[rows], atol=1e-7)
        internal = internal_wrenches(chain.interaction_wrenches(q, v, tau), shares)
        R = np.kron(np.eye(2), target.X_WP_d[:3, :3])
        wanted = scenario.squeeze_wrenches @ R.T
        assert_allclose(internal[:, rows], wanted[:, rows], atol=2e-2)


@pytest.mark.parametrize("name", ["adept", "pandas"])
def test_a_plan_is_within_its_limits_and_shorter_than_the_quintic(name, planned):
    plan = planned(name)
    assert plan.method == "least time"
    assert plan.duration < 0.7 * plan.quintic_duration
    check_consistency(plan.motion, np.linspace(0.01, plan.duration - 0.01, 20))
    limits = np.array([75.0, 50.0, 12.5] * 2 if name == "adept" else [87.0] * 4 + [12.0] * 3)
    used = max(np.abs(np.array(rows) / limits[: len(rows[0])]).max() for rows in plan.torques.values())
    assert used <= 0.951
    # Of the Pandas, speeds are at their limits.
    assert used > 0.945 or name == "pandas"


def test_a_plan_survives_json(tmp_path, planned):
    plan = planned("adept")
    plan.save(tmp_path / "plan.json")
    assert cp.carry.CarryPlan.load(tmp_path / "plan.json") == plan
    assert json.loads((tmp_path / "plan.json").read_text())["method"] == "least time"
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(FileReadError):
        cp.carry.CarryPlan.load(tmp_path / "plan.json")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adept", "pandas"])
def test_least_effort_is_below_that_of_the_quintic(name):
    scenario, start, goal = CARRIES[name]()
    fast = cp.carry.plan_carry(scenario.cell, start, goal, squeeze=scenario.squeeze, places=61)
    T = 1.3 * fast.quintic_duration
    plan = cp.carry.plan_carry(scenario.cell, start, goal, squeeze=scenario.squeeze, duration=T, places=61)
    assert plan.method == "least effort"
    assert_allclose(plan.duration, T, rtol=1e-12)
    assert plan.effort < 0.96 * plan.quintic_effort


# ---------------------------------------------------------------- pads


def palms(more):
    """Two Pandas with the patches of two-pandas-palms as pads; they press more than the least squeeze."""
    scenario = cp.Scenario.load("two-pandas-palms")
    pads = {
        name: cp.Pad(**{field: getattr(patch, field) for field in cp.Pad.model_fields})
        for name, patch in scenario.cell.patches.items()
    }
    cell, start = scenario.cell.rigid.replace(pads=pads), scenario.start
    chain, still = CellChain(cell), np.zeros(14)
    least = chain.friction_squeeze(chain.configuration(start.matrix), still, still).internal
    squeeze = least @ np.kron(np.eye(2), start.matrix[:3, :3])
    squeeze = squeeze + cp.squeezes.TipForceSqueeze(force=more).at(0.0, cell.grasps)
    goal = start.replace(xyz=tuple(np.add(start.xyz, (0.0, 0.15, 0.1))))
    wrenches = dict(zip(cell.arms, squeeze, strict=True))
    return cell, start, goal, cp.squeezes.ConstantSqueeze(wrenches=wrenches)


@pytest.mark.parametrize("outline", [{"radius": 0.03}, {"size": (0.05, 0.03)}])
@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_planes_of_a_pad_are_inside_its_cones_and_near_them(name, outline):
    """Along random directions of friction and of tilt, with a reserve of a fifth."""
    cell = SCENARIOS[name]().cell
    grasps = {"left": {"xyz": (-0.1, 0.01, 0.02), "rpy": (0.2, -0.1, 0.3)}, "right": {"xyz": (0.1, 0.0, 0.0)}}
    pads = {"left": cp.Pad(mu=0.6, press="x", **outline), "right": cp.Pad(mu=0.4, press="-x", **outline)}
    cell, rng = cell.replace(grasps=grasps, pads=pads), np.random.default_rng(3)
    rows = CarryLimits.of(cell, None, 0.2).pads
    for index, (arm, pad) in enumerate(cell.pads.items()):
        on_pad = pad.in_plane(np.eye(6), cell.grasps[arm].matrix).T
        used = rows[np.abs(rows).max(axis=(1, 2)) > 0.0]
        of_arm = used[np.abs(used[:, index]).max(axis=1) > 0.0]
        assert len(of_arm) == 64 + 16
        assert not np.abs(np.delete(of_arm, index, axis=1)).any()
        pressed = of_arm[:, index] @ np.linalg.solve(on_pad, np.eye(6)[2])  # 1 N along the normal
        assert pressed.max() < 0.0
        for kind in ("slip", "tip"):
            for along in rng.normal(size=(40, 6)):
                free = [0, 1, 5] if kind == "slip" else [3, 4]
                F = np.zeros(6)
                F[free] = along[free] * ((1.0, 1.0, pad.torsion_radius) if kind == "slip" else pad.levers)
                growth = of_arm[:, index] @ np.linalg.solve(on_pad, F)
                largest = (-pressed[growth > 1e-12] / growth[growth > 1e-12]).min()
                used_up = (
                    pad.needed_friction(F) / pad.mu if kind == "slip" else np.linalg.norm(F[3:5] / pad.levers)
                )
                assert 0.85 < largest * used_up / 0.8 <= 1.0 + 1e-9


@pytest.mark.slow
def test_pads_slow_a_carry_down_to_what_friction_bears():
    durations = []
    for more in (10.0, 30.0):
        cell, start, goal, pressed = palms(more)
        plan = cp.carry.plan_carry(cell, start, goal, squeeze=pressed, places=61)
        durations.append(plan.duration)
        squeezed = pressed.at(0.0, cell.grasps)
        path = CarriedLine(cell, plan.motion).dynamics(np.linspace(0.0, 1.0, 61), squeezed)
        _, s, v, a = CarryTiming.of(plan.motion, 101)
        A, B, C = path.at(s).wrench
        F = A * a[:, None, None] + B * v[:, None, None] ** 2 + C
        for index, name in enumerate(cell.arms):
            assert friction_used(F[:, index], cell.grasps[name], cell.pads[name]).max() <= 0.951
    assert durations[0] > 1.02 * durations[1]
    cell, start, goal, pressed = palms(0.0)
    with pytest.raises(InfeasibleMotionError, match="pad of") as dropped:
        cp.carry.plan_carry(cell, start, goal, squeeze=pressed, places=61)
    assert dropped.value.cause == "torque"


def friction_used(F, grasp, pad):
    """Larger of u of results.friction and |b| / (R N), of wrenches about P in payload axes."""
    moment = F[:, 3:] + np.cross(-np.array(grasp.xyz), F[:, :3])
    R = grasp.matrix[:3, :3] @ pad.plane[:3, :3]
    f, n = F[:, :3] @ R, moment @ R
    slip = pad.needed_friction(np.hstack((f, n))) / (pad.mu * f[:, 2])
    return np.maximum(slip, np.linalg.norm(n[:, :2] / pad.levers, axis=1) / f[:, 2])


# ---------------------------------------------------------------- what is refused


def test_what_no_plan_can_do_is_refused_by_its_cause():
    scenario, start, goal = across()
    cell = scenario.cell
    far = goal.replace(xyz=(0.45, -1.5, 0.0))
    with pytest.raises(InfeasibleMotionError) as reach:
        cp.carry.plan_carry(cell, start, far)
    assert reach.value.cause == "reach"
    with pytest.raises(UnreachablePoseError):
        cp.carry.plan_carry(cell, far, start)
    hard = cp.squeezes.TipForceSqueeze(force=500.0)
    with pytest.raises(InfeasibleMotionError, match=r"drive \d of 'left'") as torque:
        cp.carry.plan_carry(cell, start, goal, squeeze=hard)
    assert torque.value.cause == "torque"
    with pytest.raises(InfeasibleMotionError) as short:
        cp.carry.plan_carry(cell, start, goal, duration=0.1, places=41)
    assert short.value.cause == "limits"
    with pytest.raises(OutOfRangeError):
        cp.carry.plan_carry(cell, start, goal, reserve=1.0)
    with pytest.raises(OutOfRangeError):
        cp.carry.plan_carry(cell, start, goal, smoothing=0.0)
    with pytest.raises(ArgumentError):
        cp.carry.plan_carry(cp.Scenario.load("adept-compliant").cell, start, goal)


def test_the_feed_forward_does_not_know_the_errors_of_sensors_and_drives(planned):
    plan, exact = planned("adept"), adept()[0].override({"clock.rate_hz": 80.0})
    errors = {"sensors.holding_torque_error": 0.1, "actuators.lag": 0.005, "actuators.missed_ticks": 0.1}
    played = [plan.played_by(each, start_time=0.1) for each in (exact, exact.override(errors))]
    assert played[0].feed_forward == played[1].feed_forward
    assert played[1].sensors.holding_torque_error == 0.1
    # Before the start nothing is added, and the run ends with a tick.
    assert not np.any(played[0].feed_forward.at(0.09))
    assert_allclose(played[0].duration * 80.0 % 1.0, 0.0, atol=1e-9)


def test_proofs_and_exports_refuse_a_feed_forward(tmp_path):
    table = {"right": np.ones((1, 3)), "left": np.zeros((1, 3))}
    scenario = short_scenario().replace(feed_forward=cp.laws.FeedForward(times=(0.0,), torques=table))
    with pytest.raises(ArgumentError, match="feed-forward"):
        cp.export.export_c(scenario, "left", tmp_path)
    with pytest.raises(ArgumentError, match="feed-forward"):
        cp.proof.theorem_monitor(cp.run(scenario, warn=False))


def test_arms_that_cannot_turn_the_payload_are_refused_with_the_angle():
    scenario = cp.Scenario.load("five-joint-pair")
    goal = scenario.start.replace(rpy=tuple(np.add(scenario.start.rpy, (0.0, 0.0, 0.15))))
    with pytest.raises(InfeasibleMotionError, match="rad at s") as reach:
        cp.carry.plan_carry(scenario.cell, scenario.start, goal)
    assert reach.value.cause == "reach"


def test_a_plan_is_played_with_its_own_cell_and_drives_that_take_torques(planned):
    plan, (scenario, *_) = planned("adept"), adept()
    with pytest.raises(ArgumentError):
        plan.played_by(scenario.override({"cell.payload.mass": 12.0}))
    with pytest.raises(ArgumentError):
        plan.played_by(scenario.override({"actuators.gravity_compensation": {"mass_error": 0.1}}))


# ---------------------------------------------------------------- feed-forward


def short_scenario(**changes):
    return cp.Scenario.load(
        "adept-anchored", {"events": (), "duration": 0.2, "clock.steps_per_tick": 1} | changes
    )


def test_no_torques_added_leave_the_bits_and_added_ones_act_at_their_times():
    scenario = short_scenario()
    nothing = cp.laws.FeedForward(
        times=(0.05, 0.1), torques={"right": np.zeros((2, 3)), "left": np.zeros((2, 3))}
    )
    plain, same = (
        cp.run(scenario, warn=False).data,
        cp.run(scenario.replace(feed_forward=nothing), warn=False).data,
    )
    assert np.array_equal(plain.torque, same.torque)
    more = cp.laws.FeedForward(
        times=(0.05, 0.1), torques={"left": [[0.0] * 3, [1.0, 0.0, 0.0]], "right": np.zeros((2, 3))}
    )
    added = cp.run(scenario.replace(feed_forward=more), warn=False).data
    time = np.asarray(plain.time)
    before = time < 0.0501
    assert np.array_equal(plain.torque.values[before], added.torque.values[before])
    assert added.torque.values[time > 0.061][0, 0, 0] != plain.torque.values[time > 0.061][0, 0, 0]
    assert_allclose(more.at(0.075)[0], [0.5, 0.0, 0.0])
    assert_allclose(more.at(7.0)[0], [1.0, 0.0, 0.0])
    assert not more.at(0.04)[0].any()


def test_feed_forward_is_a_part_of_the_scenario():
    table = {"right": np.ones((2, 3)), "left": np.zeros((2, 3))}
    scenario = short_scenario().replace(feed_forward=cp.laws.FeedForward(times=(0.0, 0.1), torques=table))
    assert list(scenario.feed_forward.torques) == ["left", "right"]
    assert cp.Scenario.from_toml(scenario.to_toml()) == scenario
    assert "feed_forward" not in short_scenario().to_toml()
    assert "feed-forward" in compiled.support(scenario)


@pytest.mark.parametrize(
    "fields",
    [
        {"times": (), "torques": {}},
        {"times": (0.0, 0.0), "torques": {}},
        {"times": (0.0,), "torques": {"left": ((0.0,), (1.0,))}},
    ],
)
def test_tables_of_feed_forward_that_do_not_fit_are_refused(fields):
    with pytest.raises(FieldError):
        cp.laws.FeedForward(**fields)


def test_feed_forward_for_other_arms_or_drives_is_refused():
    scenario = short_scenario()
    with pytest.raises(FieldError):
        scenario.replace(feed_forward=cp.laws.FeedForward(times=(0.0,), torques={"left": ((0.0,) * 3,)}))
    table = {"left": ((0.0,) * 3,), "right": ((0.0,) * 2,)}
    with pytest.raises(FieldError, match="right"):
        cp.run(scenario.replace(feed_forward=cp.laws.FeedForward(times=(0.0,), torques=table)), warn=False)


@pytest.mark.parametrize(
    "fields",
    [
        {"times": (0.0,), "fractions": (0.0,)},
        {"times": (0.0, 1.0), "fractions": (0.0, 0.9)},
        {"times": (1.0, 0.0), "fractions": (0.0, 1.0)},
        {"times": (0.0, 1.0), "fractions": (0.0, 0.5, 1.0)},
    ],
)
def test_tables_of_timed_lines_that_do_not_fit_are_refused(fields):
    with pytest.raises(FieldError):
        cp.motions.TimedLineMotion(start=cp.Pose(), goal=cp.Pose(xyz=(1.0, 0.0, 0.0)), **fields)


def test_a_timed_line_with_two_entries_is_the_quintic():
    ends = {"start": cp.Pose(), "goal": cp.Pose(xyz=(1.0, 2.0, 0.0), rpy=(0.1, 0.2, 0.3))}
    line = cp.motions.LineMotion(duration=2.0, start_time=1.0, **ends)
    timed = cp.motions.TimedLineMotion(times=(1.0, 3.0), fractions=(0.0, 1.0), **ends)
    for time in (0.0, 1.0, 1.3, 2.2, 3.0, 4.0):
        for part, other in zip(timed.at(time), line.at(time), strict=True):
            assert_allclose(part, other, atol=1e-12)


# ---------------------------------------------------------------- played in closed loop


def played(name, plan):
    scenario = CARRIES[name]()[0]
    return cp.run(plan.played_by(scenario), warn=False).data


def errors_of(data, since):
    moving = np.asarray(data.time) >= since
    error = (np.asarray(data.internal_wrench) - np.asarray(data.desired_internal_wrench))[moving]
    return {
        "internal force": float(np.linalg.norm(np.nan_to_num(error[..., :3]), axis=-1).max()),
        "closure": float(max(np.nanmax(data.closure_distance), np.nanmax(data.closure_angle))),
        "torque": float(np.nanmax(np.abs(data.torque.values[moving]) / data.torque_limit.values)),
        "speed": float(np.nanmax(np.abs(data.joint_velocity.values[moving]) / data.velocity_limit.values)),
        "pose": float(np.abs(data.pose_error.values[moving]).max()),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adept", "across", "pandas"])
def test_a_played_plan_keeps_limits_squeeze_and_closure(name, planned):
    plan = planned(name)
    start, goal = plan.motion.start, plan.motion.goal
    assert_allclose(np.linalg.norm(np.subtract(goal.xyz, start.xyz)), 0.5, atol=2e-3)
    assert_allclose(abs(goal.rpy[2] - start.rpy[2]), np.pi / 3.0, atol=1e-12)
    errors = errors_of(played(name, plan), 1.0)
    print(name, plan.summary(), errors)
    assert errors["internal force"] < 1.0
    assert errors["closure"] < 1e-9
    assert errors["torque"] < 0.97
    assert errors["speed"] < 0.97
    assert errors["pose"] < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("change", ["law (23)", "a fifth more mass"])
def test_laws_without_a_model_play_a_plan_and_correct_what_it_does_not_know(change, planned):
    if change == "law (23)":
        law = cp.Scenario.load("adept-paper").controller
        data = cp.run(planned("across").played_by(adept()[0].replace(controller=law)), warn=False).data
    else:
        scenario = planned("pandas").played_by(pandas()[0])
        data = cp.run(
            scenario.replace(events=(cp.events.PayloadChange(time=0.02, mass=3.6),)), warn=False
        ).data
    errors = errors_of(data, 1.0)
    print(change, errors)
    assert errors["internal force"] < (1.5 if change == "law (23)" else 1.0)
    assert errors["pose"] < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize(("name", "price"), [("pandas", 0.054), ("adept", 0.171), ("across", 0.046)])
def test_smoothing_costs_time_by_the_line(name, price, planned):
    """Against 2 ms of smoothing."""
    scenario, start, goal = CARRIES[name]()
    options = {"squeeze": scenario.squeeze, "smoothing": 0.002, "places": 401}
    sharp = cp.carry.plan_carry(scenario.cell, start, goal, **options)
    assert_allclose(planned(name).duration / sharp.duration - 1.0, price, atol=0.005)


@pytest.mark.slow
def test_what_least_time_gains_depends_on_the_line():
    gains = []
    for turn in (-np.pi / 3.0, np.pi / 3.0):
        for degrees in range(0, 360, 15):
            scenario, start, goal = adept(degrees, turn)
            try:
                options = {"squeeze": scenario.squeeze, "smoothing": 0.03, "places": 61}
                plan = cp.carry.plan_carry(scenario.cell, start, goal, **options)
            except (InfeasibleMotionError, UnreachablePoseError):
                continue
            gains.append(1.0 - plan.duration / plan.quintic_duration)
    print(len(gains), np.round(np.sort(gains), 2))
    assert len(gains) == 13
    assert 0.05 < min(gains) < np.median(gains) < 0.18
    assert 0.38 < max(gains) < 0.43
