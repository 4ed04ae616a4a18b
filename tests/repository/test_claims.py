"""Corrected claims of the documentation, held on the plant: each test names the sentence that it holds."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cells import ANCHORED, SCENARIOS
from damping import damping_and_inertia
from numpy.testing import assert_allclose
from page_texts import read_numbers, require_numbers
from scipy.linalg import eigh, expm
from scipy.optimize import brentq
from tiers import by_default

import coop_pin as cp
from coop_pin.comparison import controllers_for
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.control import anchor_gain_bound
from coop_pin.simulation.build_controller import build_controller
from coop_pin.stability import loop_stability
from coop_pin.stability.sampled_motion import tick_matrix as sampled_tick

REPOSITORY = Path(__file__).resolve().parents[2]
CONCEPTS, STUDIES = REPOSITORY / "docs" / "concepts", REPOSITORY / "studies"

# ---------------------------------------------------------------- the motion is a cubic


def tick_map(rate, gamma, k_I, T):
    """A tick of a mode of the motion with hold, in x, v and Z / K; rate is an eigenvalue of A^-1 K."""
    by_force, by_s, s = (T**2 / 2.0, T, 0.0), (0.0, 0.0, 1.0), np.array([gamma, 1.0, 0.0])
    free = np.array([[1.0, T, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return free - rate * np.outer(by_force, s + np.array(by_s)) + T * k_I * np.outer(by_s, s)


def largest_gain(rate, T):
    """The gamma = k_I at which a sampled mode neither grows nor decays, 1/s."""

    def growth(gain):
        return np.abs(np.linalg.eigvals(tick_map(rate, gain, gain, T))).max() - 1.0

    return brentq(growth, 0.3 * rate, 2.2 * rate)


def test_the_sampled_boundary_tends_to_that_of_the_cubic():
    """Parts of gamma = k_I = 2 lambda at lambda_min 11.9 of the Adept pair, as on the page."""
    found = [largest_gain(11.9, 1.0 / rate_hz) / (2.0 * 11.9) for rate_hz in (80, 250, 400, 1000, 2000)]
    assert_allclose(found, [0.68, 0.86, 0.91, 0.96, 0.98], atol=0.005)
    for rate, gamma, k_I in ((3.0, 1.0, 9.0), (11.9, 2.0, 5.0)):
        edge = gamma * k_I / (gamma + k_I)
        for factor, decays in ((0.999, False), (1.001, True)):
            cubic = np.poly1d([1.0, 0.0, 0.0, 0.0]) + factor * edge * np.poly1d([-gamma, -k_I], r=True)
            assert (cubic.roots.real.max() < 0.0) == decays
        assert_allclose(
            np.sort(np.log(np.linalg.eigvals(tick_map(rate, gamma, k_I, 1e-5)).astype(complex)) / 1e-5),
            np.sort((np.poly1d([1.0, 0, 0, 0]) + rate * np.poly1d([-gamma, -k_I], r=True)).roots),
            rtol=1e-3,
        )


@pytest.mark.parametrize("T", [1.0 / 80.0, 1.0 / 400.0, 1.0 / 4000.0])
@pytest.mark.parametrize(("gamma", "k_I"), [(16.0, 16.0), (8.0, 20.0), (20.0, 8.0)])
def test_the_sampled_polynomial_and_its_four_numbers_are_those_of_the_tick(gamma, k_I, T):
    """w^3 + T lambda (w + gamma T (1 + w/2))(w + k_I T) is stable iff a_2 a_1 > a_3 a_0, all positive."""
    u = 1.0 - k_I * T / 2.0
    per_rate = (u * (1.0 - gamma * T / 2.0) - k_I * T / 2.0, gamma + k_I - T * gamma * k_I, gamma * k_I)
    edge = per_rate[2] / (per_rate[0] * per_rate[1] + per_rate[2] * T * u / 2.0)
    for factor in (0.999, 1.001):
        rate = factor * edge
        polynomial = np.poly1d([1.0, 0.0, 0.0, 0.0]) + T * rate * np.poly1d(
            [1.0 + gamma * T / 2.0, gamma * T]
        ) * np.poly1d([1.0, k_I * T])
        z = np.linalg.eigvals(tick_map(rate, gamma, k_I, T))
        assert_allclose(np.poly(z - 1.0), polynomial.coeffs, atol=1e-12)
        a_3, (a_2, a_1, a_0) = 1.0 - rate * T * u / 2.0, (rate * value for value in per_rate)
        assert (np.abs(z).max() < 1.0) == (min(a_0, a_1, a_2, a_3) > 0.0 and a_2 * a_1 > a_3 * a_0)
        assert (np.abs(z).max() < 1.0) == (factor > 1.0)


def test_a_load_that_grows_leaves_the_rest_solution_of_the_cubic():
    """x = d' / (gamma k_I K): the state of a mode with hold that stays while the load grows."""
    rate, gamma, k_I, T, growth = 11.9, 2.0, 5.0, 1.0 / 80.0, 3.0 / 800.0  # growth is d' / K
    state = np.linalg.solve(np.eye(3) - tick_map(rate, gamma, k_I, T), [0.0, 0.0, -T * growth])
    assert_allclose(state, [growth / (gamma * k_I), 0.0, -growth / k_I], atol=1e-12)


@pytest.mark.parametrize("start", [1e-4, 10.0])
def test_beyond_the_boundary_a_saturated_integral_ends_in_one_oscillation(start):
    """A mode of lambda 1, gamma = k_I = 4, layer 0.05: a pole at +0.36, and an amplitude of 0.041."""
    assert_allclose(np.roots([1.0, 1.0, 8.0, 16.0]).real.max(), 0.36, atol=0.005)
    T, x, v, integral, path = 2e-3, start, 0.0, 0.0, []
    for _ in range(int(120.0 / T)):
        s = v + 4.0 * x
        v -= T * (s + integral)
        integral += T * 4.0 * min(max(s, -0.05), 0.05)
        x += T * v
        path.append(abs(x))
    assert_allclose([max(path[-15000:-7500]), max(path[-7500:])], 0.041, rtol=0.01)


def least_damping(rates, gamma, k_I):
    """The least damping ratio of the cubic's roots over a range of lambda."""
    return min(
        (-roots.real / np.abs(roots)).min()
        for roots in (
            np.roots([1.0, rate, rate * (gamma + k_I), rate * gamma * k_I])
            for rate in np.geomspace(*rates, 60)
        )
    )


def task_inertias(scenario, X_WP):
    """(J M^-1 J^T)^-1 of every arm, and A, at a pose of the payload."""
    cell, rows = scenario.cell, scenario.cell.task_rows
    inertias = []
    for name, arm in cell.arms.items():
        model = cp.model.CellArm(cell, name)
        q = cp.solve_ik(model, X_WP, posture=arm.posture)
        J = rows.select(model.payload_jacobian(q))
        inertias.append(np.linalg.inv(J @ np.linalg.solve(model.mass_matrix(q), J.T)))
    R, payload = X_WP[:3, :3], np.zeros((6, 6))
    payload[:3, :3] = cell.payload.mass * np.eye(3)
    payload[3:, 3:] = R @ cell.payload.inertia_matrix @ R.T
    return inertias, rows.select(rows.select(payload).T) + sum(inertias)


def test_damping_that_the_tuning_rule_gives():
    """0.515 at the edge of both parts, which the rule lowers; 0.69 with a quarter for both."""
    assert_allclose(least_damping((1.0, 1e3), 0.25, 0.5), 0.515, atol=5e-4)
    for gamma in np.linspace(0.02, 0.25, 8):
        assert min(least_damping((1.0, 1e3), gamma, k_I) for k_I in np.linspace(0.02, 0.5, 8)) > 0.51
    assert_allclose(least_damping((1.0, 1e3), 0.25, 0.25), 0.691, atol=5e-4)
    assert_allclose(least_damping((11.9, 74.0), 2.0, 2.5), 0.85, atol=0.005)


@pytest.mark.parametrize("lag", [0.0, 0.7])
@pytest.mark.parametrize(("rate", "gamma", "k_I"), [(11.9, 2.0, 5.0), (40.0, 20.0, 8.0)])
def test_a_mode_of_the_sampled_motion_is_that_of_the_page(rate, gamma, k_I, lag):
    """One motion y: its matrix is similar to that of the scalar tick; with a lag to its exact integral."""
    T, law = 1.0 / 80.0, np.array([[gamma, 1.0]])
    found = sampled_tick(-rate * law, -rate * T * k_I * law, T, lag=lag * T)
    if not lag:
        expected = np.linalg.eigvals(tick_map(rate, gamma, k_I, T))
        z = np.linalg.eigvals(found)
        assert_allclose(np.sort_complex(z[np.abs(z) > 1e-9]), np.sort_complex(expected), atol=1e-12)
        return
    # [y, w, b, h, u] in continuous time over the tick, u held, then the law.
    flow = np.zeros((5, 5))
    flow[0, 1] = flow[1, 2] = 1.0
    flow[2, 2], flow[2, 4] = -1.0 / (lag * T), 1.0 / (lag * T)
    law_tick = np.eye(5)
    law_tick[4] = [-rate * gamma, -rate, 0.0, 1.0, 0.0]
    law_tick[3] = [-rate * T * k_I * gamma, -rate * T * k_I, 0.0, 1.0, 0.0]
    assert_allclose(
        np.sort_complex(np.linalg.eigvals(found)),
        np.sort_complex(np.linalg.eigvals((expm(T * flow) @ law_tick)[:4, :4])),
        atol=1e-9,
    )


@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.slow)])
def test_the_catalogues_damping_is_as_the_page_says(every):
    """Of the sampled loop along the motions; least eigenvalue of A^-1 K at three poses."""
    page = (CONCEPTS / "payload-space.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| `([\w-]+)` \| (\d+) \| (\d+)(?:, turns (\d+))? \| ([\d.]+) \| ([\d.]+) \|", page, re.MULTILINE
    )
    assert len(rows) == 7
    for name, gamma, k_I, turns, least, damping in rows[::every]:
        scenario = cp.Scenario.load(name)
        gains = scenario.controller.gains
        stated = np.array([float(k_I)] * 3 + [float(turns or k_I)] * 3)[list(scenario.cell.task_rows.indices)]
        assert_allclose(gains.sign_gain * np.ones(stated.size) / scenario.controller.switching.width, stated)
        assert gains.pose_gain == float(gamma)
        simulation = cp.Simulation(scenario, build_controller(scenario))
        found = loop_stability(simulation, cp.feasibility.reachability(scenario, poses=21))
        assert_allclose(found.damping, float(damping), atol=0.006)
        assert found.damping > 0.55
        if scenario.cell.controls_turns:
            times = np.linspace(0.0, scenario.duration, 3)[1:]
            poses = [scenario.start.matrix, *(simulation.references(t)[0].pose for t in times)]
            K = np.diag(gains.sliding_gain)
            rates = [eigh(K, task_inertias(scenario, X)[1], eigvals_only=True)[0] for X in poses]
            assert_allclose(min(rates), float(least), rtol=0.02)


def test_damping_of_single_arms_is_beyond_the_limit():
    """T lambda_max(Lambda_i^-1 c_i K), limit 2, of soft grasps."""
    page = (CONCEPTS.parent / "reference" / "not-modelled.md").read_text(encoding="utf-8")
    rows = re.findall(r"([\d.]+) for `([\w-]+)`", page)
    assert len(rows) == 3
    for value, name in rows:
        scenario = cp.Scenario.load(name)
        K, period = np.diag(scenario.controller.gains.sliding_gain), scenario.clock.period
        inertias, _ = task_inertias(scenario, scenario.start.matrix)
        found = [
            period * eigh(share * K, inertia, eigvals_only=True).max()
            for share, inertia in zip(scenario.cell.shares, inertias, strict=True)
        ]
        assert_allclose(max(found), float(value), rtol=0.02)


@cache
def slowest_mode(name):
    """The least eigenvalue of A^-1 K at the start of a test cell, A times its mode, and the mode."""
    scenario, law = SCENARIOS[name](), ANCHORED[name]
    none = dict.fromkeys(scenario.cell.arms, np.zeros((len(law.gains.sliding_gain),) * 2))
    _, A = damping_and_inertia(scenario.cell, scenario.start.matrix, none)
    rates, modes = eigh(np.diag(law.gains.sliding_gain), A)
    return rates[0], A @ modes[:, 0]


def plant_growth(name, rate_hz, gain):
    """Growth of the slowest mode on the plant, 1/s: gamma = k_I = gain, after one push along the mode.

    Without friction and gravity, in the linear layer; three poles are fitted to the free response.
    """
    _, force = slowest_mode(name)
    scenario = SCENARIOS[name]().replace(controller=ANCHORED[name])
    T, ticks = 1.0 / rate_hz, max(24, int(0.5 * rate_hz))
    wrench = np.zeros(6)
    wrench[list(scenario.cell.task_rows.indices)] = 0.05 * force / np.linalg.norm(force)
    pushed = {"kind": "wrench-pulse", "time": 0.0, "duration": 2 * T, "wrench": tuple(wrench)}
    changes = {
        "motion": {"kind": "hold", "pose": scenario.start.model_dump()},
        "events": [pushed],
        "clock.rate_hz": float(rate_hz),
        "clock.steps_per_tick": 1 if rate_hz > 100 else 5,
        "duration": (ticks + 4) * T,
        "cell.gravity": [0.0, 0.0, 0.0],
        "controller.gains.pose_gain": gain,
        "controller.gains.sign_gain": gain * scenario.controller.switching.width,
        "beyond_bound": True,
    } | {f"cell.arms.{arm}.friction": "none" for arm in scenario.cell.arms}
    error = cp.run(scenario, changes, warn=False).data.pose_error.values[3:]
    x = scenario.cell.task_rows.select(error.T).T @ force
    stride = max(1, rate_hz // 100)
    rows = np.column_stack([x[n * stride : len(x) - (3 - n) * stride] for n in range(3)])
    coefficients = np.linalg.lstsq(rows, x[3 * stride :])[0]
    return float(np.log(np.abs(np.roots([1.0, *-coefficients[::-1]])).max()) * rate_hz / stride)


@pytest.mark.parametrize(
    ("name", "rate_hz"),
    [
        ("planar", 80),
        ("planar", 400),
        ("spatial", 400),
        pytest.param("planar", 4000, marks=pytest.mark.slow),
        pytest.param("spatial", 4000, marks=pytest.mark.slow),
    ],
)
def test_the_motion_is_stable_up_to_the_gains_of_its_polynomial(name, rate_hz):
    """The cubic's boundary at 4 kHz, gamma = k_I = 2 lambda; below, that of the sampled polynomial."""
    rate, _ = slowest_mode(name)
    boundary = 2.0 * rate if rate_hz > 1000 else largest_gain(rate, 1.0 / rate_hz)
    factors = np.array([0.9, 1.1])
    slower, faster = (plant_growth(name, rate_hz, factor * boundary) for factor in factors)
    assert slower < 0.0 < faster
    assert_allclose(0.9 + 0.2 * slower / (slower - faster), 1.0, atol=0.02)


# ---------------------------------------------------------------- the counterexample to Theorem 3

LIMIT = '<limit lower="-3" upper="3" effort="1000" velocity="100"/>'


def gantry(axes):
    """URDF of a gantry whose joints are the task rows themselves, so that its payload Jacobian is I."""
    parts, parent = ['<robot name="gantry"><link name="ground"/>'], "ground"
    for number, (kind, axis) in enumerate(axes):
        child = f"link{number}"
        parts.append(
            f'<link name="{child}"><inertial><mass value="1"/>'
            '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint{number}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="{axis}"/>{LIMIT}</joint>'
        )
        parent = child
    return "".join([*parts, "</robot>"])


X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
GANTRIES = {
    "planar": [("prismatic", X), ("prismatic", Y), ("revolute", Z)],
    "full": [*(("prismatic", axis) for axis in (X, Y, Z)), *(("revolute", axis) for axis in (Z, Y, X))],
}


def one_axis(rows, alpha, folder):
    """Two gantries on one payload, K_d 60 and 30 along every row, equal shares, 5 N along x."""
    (folder / "gantry.urdf").write_text(gantry(GANTRIES[rows]))
    tip = f"link{len(GANTRIES[rows]) - 1}"
    arm = cp.Arm(urdf=str(folder / "gantry.urdf"), tip=tip, friction="none")
    law = {"pose_gain": 2.0, "sign_gain": alpha, "force_gain": 0.0, "transient_rate": 5.0}
    return cp.Scenario(
        name="one-axis",
        cell={
            "rows": rows,
            "arms": {"left": arm, "right": arm},
            "payload": {"mass": 10.0, "inertia": (0.1, 0.1, 0.1, 0.0, 0.0, 0.0), "size": (0.1, 0.1, 0.1)},
            "grasps": {"left": {}, "right": {}},
            "gravity": (0.0, 0.0, 0.0),
        },
        controller={
            "kind": "sliding-mode",
            "switching": {"kind": "saturation", "width": 0.05},
            "gains": {"damping_gain": 60.0, **law},
            "arm_gains": {"right": {"damping_gain": 30.0, **law}},
        },
        motion={"kind": "hold", "pose": {}},
        squeeze=dict.fromkeys(("left", "right"), (0.0,) * 6),
        start={},
        events=[{"kind": "wrench-pulse", "time": 0.0, "duration": 15.0, "wrench": (5.0, 0, 0, 0, 0, 0)}],
        clock={"rate_hz": 80.0, "steps_per_tick": 1},
        duration=15.0,
    )


@pytest.mark.parametrize("rows", by_default(GANTRIES, "planar"))
def test_a_force_gain_leaves_a_part_of_what_contradicts_theorem_3(rows, tmp_path):
    """A quarter of 0.8333 N at K_f 3, behind a low-pass."""
    filtered = {"sensors.wrist": {}, "controller.force_path": {"kind": "low-pass", "pole": 0.9}}
    gains = {f"controller.{part}.force_gain": 3.0 for part in ("gains", "arm_gains.right")}
    scenario = one_axis(rows, 0.2, tmp_path).override(filtered | gains)
    force = cp.run(scenario, warn=False).data.internal_wrench.isel(arm=0, time=-2).values[0]
    assert_allclose(force, (60.0 / 90.0 - 0.5) * 5.0 / 4.0, atol=1e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.2])
@pytest.mark.parametrize("rows", GANTRIES)
def test_theorem_3_fails_on_one_axis_with_exact_equal_views(rows, alpha, tmp_path):
    """(K_d1 / sum K_d - c_1) L at rest, as on two pages; with alpha the payload does not sag."""
    result = cp.run(one_axis(rows, alpha, tmp_path), warn=False)
    expected = (60.0 / 90.0 - 0.5) * 5.0
    told = r"gains K_d of (\d+) and (\d+), K_f = 0 and a payload's weight of (\d+) N, ([\d.]+) N are left"
    require_numbers("paper", {told: [60.0, 30.0, 5.0, expected]})
    told = r"\$K_\{d,1\} = (\d+)\$ and \$K_\{d,2\} = (\d+)\$.*: ([\d.]+) N at \$L\$ = (\d+) N"
    require_numbers("paper-claims", {told: [60.0, 30.0, expected, 5.0]})
    force = result.data.internal_wrench.isel(arm=0, time=-2).values[0]
    assert_allclose(force, expected, atol=1e-3)
    sag = result.data.pose_error.values[-2, 0]
    assert_allclose(sag, 0.0 if alpha else 5.0 / (90.0 * 2.0), atol=1e-4)


def test_unequal_pose_gains_drive_the_internal_force_by_the_integral():
    """gamma 2 and 3: 68 N at 10 s with alpha 0.2, 0.09 N without."""
    paper, errors = cp.Scenario.load("adept-paper", {"events": [], "duration": 10.0}), []
    for alpha in (0.2, 0.0):
        gains = paper.controller.gains.replace(sign_gain=alpha)
        changes = {
            "controller.gains": gains.model_dump(),
            "controller.arm_gains": {"right": gains.replace(pose_gain=3.0).model_dump()},
            "beyond_bound": True,
        }
        data = cp.run(paper, changes, warn=False, engine="compiled").data
        error = (data.internal_wrench - data.desired_internal_wrench).isel(arm=0, time=-2).values
        errors.append(np.linalg.norm(error[:2]))
    assert_allclose(errors, [68.0, 0.09], rtol=0.06)


# ---------------------------------------------------------------- numbers of the pages


def test_gains_of_the_papers_experiment_do_what_its_page_says():
    """T lambda_max along the motion, below half of its limit; what is left of the start's error."""
    scenario = cp.Scenario.load("adept-paper")
    K_d = np.diag(scenario.controller.gains.damping_gain)
    gains, rates = dict.fromkeys(scenario.cell.arms, K_d), []
    for time in np.linspace(0.0, scenario.duration, 21).tolist():
        B, A = damping_and_inertia(scenario.cell, np.array(scenario.motion.at(time).X_WP_d), gains)
        rates.append(scenario.clock.period * eigh(B, A, eigvals_only=True).max())
    stability = cp.stability.sampled_stability(scenario)
    ends = [min(rates), max(rates), stability.limit]
    require_numbers("paper", {r"between ([\d.]+) and ([\d.]+), below half of the stability limit (\d)": ends})
    assert max(rates) < 0.5 * stability.limit
    left, later_s = read_numbers("paper", r"leaves about (\d) % of the starting position error after (\d) s")
    error = cp.run(scenario, {"events": [], "duration": 2.1}, warn=False).data.pose_error
    times = (0.0, float(later_s))
    first, later = (np.linalg.norm(error.sel(time=t, method="nearest").values[:2]) for t in times)
    assert_allclose(later / first, 0.021, atol=5e-4)
    assert round(100.0 * later / first) == float(left)


def curve(rate, trial, measure):
    """Medians of the printed law over alpha, of studies/alpha.csv."""
    table = pd.read_csv(STUDIES / "alpha.csv")
    chosen = (table["rate_hz"] == rate) & (table["trial"] == trial) & (table["measure"] == measure)
    return table[chosen].set_index("alpha")["median"]


def test_the_papers_alpha_serves_its_experiment_best():
    """Of all that track within 0.02 mm, the one with the least internal force; none is closer by 15 %."""
    position, force = (curve(80.0, "quiet", name) for name in ("position_mm", "force_N"))
    alpha = cp.Scenario.load("adept-paper").controller.gains.sign_gain
    assert force[position < 0.02].idxmin() == alpha
    assert position[alpha] < 1.15 * position.min()


def test_a_squeeze_at_the_tips_lowers_the_torque_at_rest():
    """Of the most loaded drive of two Pandas: 9.0 N m with a squeeze about P, 8.5 with one at the tips."""
    about_P = {"left": (-10.0, *(0.0,) * 5), "right": (10.0, *(0.0,) * 5)}
    for changes, expected in (({}, 8.54), ({"squeeze": about_P}, 9.03)):
        summary = cp.feasibility.static_torques(
            cp.Scenario.load("two-pandas-box", changes), poses=2
        ).summary()
        torque, limit = re.search(r"needs ([\d.]+) of (\d+) N m", summary).groups()
        assert (float(torque), limit) == (expected, "12")


@pytest.mark.parametrize(("name", "ratio"), [("planar", 25.0), ("spatial", 23.0)])
def test_a_stiffer_stabilisation_leaves_a_larger_closure_error_at_large_steps(name, ratio):
    """omega of 50 and 10 rad/s, one step in a tick: 12.5 ms on the paper's cell, 4 ms in space."""
    large = {"clock.steps_per_tick": 1, "duration": 1.5, "events": []}
    runs = [
        cp.run(SCENARIOS[name](), large | {"plant.stabilisation.frequency": omega}, warn=False)
        for omega in (10.0, 50.0)
    ]
    least, most = (max(run.closure_error_max()) for run in runs)
    assert_allclose(most / least, ratio, rtol=0.06)


def test_bounds_of_a_filter_a_lag_and_both():
    bounds = [
        anchor_gain_bound(pole=0.9),
        anchor_gain_bound(lag=10.0),
        anchor_gain_bound(pole=0.9, lag=10.0),
    ]
    assert_allclose(bounds, [38.0, 40.0, 0.228], rtol=0.01)


def benchmark_table():
    """The benchmark's table with the internal force, axial and shear together, N."""
    table = pd.read_csv(STUDIES / "benchmark.csv")
    return table.assign(force_N=np.hypot(table["axial_rms_N"], table["shear_rms_N"])).set_index(
        ["controller", "trial", "scenario"]
    )


def test_one_millimetre_is_one_table():
    """Every row of the table is in the data it names, or a test of its own holds it."""
    page = (CONCEPTS.parent / "studies" / "measurements.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \| ([^|]+) \| ([^|]+) \| ([\d.]+) \| `([^`]+)` \|$", page, re.M)
    assert len(rows) == 14
    claims = pd.read_csv(STUDIES / "paper_claims" / "laws.csv").set_index(["law", "trial"])
    front = pd.read_csv(STUDIES / "front" / "adept-judged.csv").set_index(["law", "trial"])
    for law, _, judged, shown, source in rows:
        name = law.replace(", tuned", "")
        if source.endswith("benchmark.csv"):
            value = benchmark_table().loc[(name, "bias 1 mm", "adept-anchored"), "force_N"]
        elif source.endswith("laws.csv"):
            measure = "end_force_N" if judged.startswith("last") else "force_N"
            value = claims.loc[(name, "bias 1 mm"), measure]
        elif source.endswith("adept-judged.csv"):
            value = front.loc[("printed, tuned" if name == "printed" else name, "bias 1 mm"), "force_N"]
        else:
            assert source == "examples/exercises/mean_pose.py"
            continue
        digits = len(shown.replace(".", "").lstrip("0"))
        assert float(f"{value:.{digits - 1}e}") == float(shown), law
    for g, k_I, gamma, force in ((0.1, 5.0, 2.0, 0.25), (0.0345408, 6.31112e-5 / 0.05, 9.33, 0.00085)):
        assert_allclose(0.5 * k_I * 800.0 * gamma * 0.5e-3 / (g * 80.0), force, rtol=0.02)


def test_what_follows_from_the_benchmark_is_in_its_table():
    table = benchmark_table()
    force, track = (table[name].unstack("scenario") for name in ("force_N", "tracking_rms_mm"))
    held = ["adept-anchored", "five-joint-pair", "kinova-pair", "three-ur5-plate"]

    def extremes(frame, controller, trial, cells=None):
        values = frame.loc[(controller, trial)].dropna()
        values = values if cells is None else values[cells]
        return values.min(), values.max()

    anchored = {"force": force.loc["anchored"], "track": track.loc["anchored"]}
    assert anchored["force"].notna().sum().sum() == 75
    for other, wins in (("mean-pose", (51, 24)), ("zeroed-leaky", (57, 17))):
        less = ((anchored["force"] < force.loc[other]), (anchored["track"] < track.loc[other]))
        assert tuple(frame.sum().sum() for frame in less) == wins
    biased = {"anchored": 0.17, "zeroed-leaky": 1.2, "payload-pi": 7.5, "printed": 25.3, "mean-pose": 0.78}
    for name, most in biased.items():
        assert_allclose(extremes(force, name, "bias 1 mm")[1], most, rtol=0.05)
    pandas = [frame.loc["printed"]["two-pandas-box"] for frame in (track, force)]
    assert_allclose(pandas[0][["nominal", "mass x2"]], (0.00365, 0.483), rtol=0.01)
    assert_allclose(pandas[1][["nominal", "bias 0.1 mm", "bias 1 mm"]], (7.72, 20.8, 25.3), rtol=0.01)
    assert_allclose(extremes(force, "dead-zone", "bias 1 mm")[1], 1.25, rtol=0.01)
    assert_allclose(extremes(track, "dead-zone", "mass x2"), (0.10, 1.47), rtol=0.05)
    change = force.loc[("mean-pose", "bias 1 mm")] / force.loc[("mean-pose", "nominal")]
    assert change.max() < 1.04
    for name, most in (("anchored", 1.17), ("mean-pose", 0.541), ("computed-torque", 1.37)):
        assert_allclose(extremes(track, name, "mass x2")[1], most, rtol=0.01)
    limp = "torque of an arm lost"
    for name, ends in {
        "anchored": (2.44, 4.85),
        "mean-pose": (0.51, 2.21),
        "payload-pi": (4.16, 9.65),
        "computed-torque": (59.6, 584.0),
    }.items():
        assert_allclose(extremes(track, name, limp, held), ends, rtol=0.01)
    lost = ["two-pandas-box", "panda-ur5-bar"]
    assert track.xs(limp, level="trial")[lost].min().min() > 240.0
    for name, most in (("anchored", 4.26), ("mean-pose", 1.96)):
        assert_allclose(extremes(track, name, "commands of an arm lost")[1], most, rtol=0.01)
    for frame, expected in ((force, (9.8, 57.5)), (track, (1.0, 2.34))):
        ratio = frame.loc[("anchored", "wrist lost at half time")] / frame.loc[("anchored", "nominal")]
        assert_allclose((ratio.min(), ratio.max()), expected, rtol=0.02)
    assert_allclose(extremes(force, "anchored", "wrist lost at half time")[1], 1.03, rtol=0.01)


def test_gains_at_an_end_of_their_range_are_the_pose_gain_that_is_required_and_the_least_rho():
    gains = pd.read_csv(REPOSITORY / "coop_pin" / "comparison" / "gains.csv")
    part = np.log(gains["value"] / gains["low"]) / np.log(gains["high"] / gains["low"])
    at_end = gains[(part < 0.05) | (part > 0.95)]
    page = (STUDIES.parent / "docs" / "studies" / "benchmark.md").read_text(encoding="utf-8")
    shown = re.search(r"(\d+) of (\d+) tuned gains lie within 5% of an end", page)
    assert [int(count) for count in shown.groups()] == [len(at_end), len(gains)]
    required = at_end[
        (at_end["field"] == "gains.pose_gain") & (at_end["low"] == 0.3) & (at_end["value"] < 0.5)
    ]
    least = at_end[at_end["field"] == "relative_gain"]
    shown = re.search(r"near an end (\d+) are a \$.gamma\$ at 0.3 /s.* and (\d+) the least", page)
    assert [int(count) for count in shown.groups()] == [len(required), len(least)]


@pytest.mark.slow
def test_the_adaptive_law_sags_under_a_load_outside_its_regressor():
    """50 N along x on the paper's cell at rest, middle gains: an adapted disturbance brings it back."""
    scenario = benchmark_scenario(cp.Scenario.load("adept-anchored"), 5.0)
    push = {"kind": "wrench-pulse", "time": 0.0, "duration": 5.0, "wrench": (50.0, 0, 0, 0, 0, 0)}
    hold = {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}, "events": [push]}
    scenario = scenario.override(hold | {"clock.steps_per_tick": 1})
    laws = controllers_for(scenario, ["adaptive", "adaptive-verginis"], tuned=False)
    errors = {}
    for name, law in laws.items():
        x = cp.run(scenario, {"controller": law}, warn=False).data.pose_error.sel(
            time=[3.0, 4.9], method="nearest"
        )
        errors[name] = 1e3 * np.linalg.norm(x.values[:, :2], axis=1)
    assert_allclose(errors["adaptive"], [53.5, 53.5], rtol=0.01)
    assert_allclose(errors["adaptive-verginis"], [31.2, 20.0], rtol=0.01)


class WithoutHoldingTorque(cp.CellController):
    """A law that is not given the drives' holding torques."""

    def __init__(self, scenario, law):
        self.law = build_controller(scenario.override({"controller": law}))

    def init(self, measurements, references):
        return self.law.init([seen._replace(holding_torque=None) for seen in measurements], references)

    def step(self, measurements, references, state):
        return self.law.step(measurements, references, state)


@pytest.mark.slow
def test_the_holding_torque_is_a_measurement():
    """Two Pandas, the nominal trial, with it and without it."""
    scenario = benchmark_scenario(cp.Scenario.load("two-pandas-box"), 5.0)
    law = controllers_for(scenario, ["payload-pd"])["payload-pd"]
    blind = {"kind": "user", "target": f"{__name__}:WithoutHoldingTorque", "options": {"law": law}}
    errors = [
        1e3 * cp.run(scenario, {"controller": given}, warn=False).position_rms(window=(2.0, 5.0))
        for given in (law, blind)
    ]
    require_numbers("choose", {r"to ([\d.]+) mm instead of ([\d.]+) mm": errors[::-1]})
