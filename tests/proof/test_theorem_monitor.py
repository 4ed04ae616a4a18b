"""Theorem monitor: its identities close, and it marks where the paper's proof breaks."""

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS, planar_three_arms, spatial_scenario
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import ArgumentError
from coop_pin.figures import theorem_figure
from coop_pin.proof import anchor_bounded_time, theorem_monitor


def moving(name, alpha):
    """A run of half a second with measured force; the spatial cell starts off its target too."""
    scenario = SCENARIOS[name]().replace(duration=0.5, events=())
    changes = {"controller.gains.sign_gain": alpha, "controller.gains.force_gain": 0.5}
    changes["controller.force_path.kind"] = "late"
    if name == "spatial":
        changes["motion"] = {"kind": "hold", "pose": {"xyz": [0.45, 0.07, 0.42], "rpy": [0.3, -0.1, 0.5]}}
    return cp.run(scenario, changes, warn=False)


@pytest.fixture(scope="module", params=SCENARIOS)
def run_and_monitor(request):
    result = moving(request.param, 0.2)
    return result, theorem_monitor(result)


def test_the_rate_of_v_is_the_sum_of_its_terms(run_and_monitor):
    _, monitor = run_and_monitor
    scale = float(np.abs(monitor["V_rate"]).max())
    assert scale > 0.1
    assert float(np.abs(monitor["V_rate_defect"]).max()) < 1e-6 * scale
    assert float(monitor["residual_21"].max()) < 1e-12
    # one gamma, one K_f and one x: the paper's sum of V_rate_2 vanishes
    terms = np.abs(monitor["V_rate_2"]).max()
    assert float(np.abs(monitor["V_rate_2_sum"]).max()) < 1e-6 * float(terms)


def test_identity_14_closes_without_friction_in_q(run_and_monitor):
    _, monitor = run_and_monitor
    printed = float(np.abs(monitor["friction_defect_14"]).max())
    assert printed > 0.01
    assert float(np.abs(monitor["identity_14"]).max()) < 1e-6 * printed


def test_the_internal_force_is_what_equation_25_says(run_and_monitor):
    result, monitor = run_and_monitor
    error = result.data["internal_wrench"] - result.data["desired_internal_wrench"]
    assert float(monitor["balance_25"].max()) < 1e-6 * float(np.abs(error).max())


def test_the_figure_has_its_six_panels(run_and_monitor):
    figure = theorem_figure(*run_and_monitor)
    assert len(figure.axes) == 6
    assert all(axes.lines for axes in figure.axes)


def test_the_monitor_marks_where_the_proof_breaks():
    """With the sign integral Vdot_3 is positive most of the time, without it never after the transient."""
    marked = {}
    for alpha in (0.0, 0.2):
        result = cp.run(
            "adept-paper",
            {"controller.gains.sign_gain": alpha, "duration": 4.0, "events": ()},
            warn=False,
            engine="compiled",
        )
        monitor = theorem_monitor(result)
        marked[alpha] = float(monitor["V_rate_3_is_positive"].sel(time=slice(3.5, None)).mean())
    assert marked[0.0] == 0.0
    assert marked[0.2] > 0.9


# ------------------------------------------------------------ payload-space law

AWAY = {"motion": {"kind": "hold", "pose": {"xyz": [0.45, 0.07, 0.42], "rpy": [0.3, -0.1, 0.5]}}}
BIAS = {"cell.arms.left.calibration_error.tip.xyz": [1e-3, 0.0, 0.0]}
MEASURED = {
    "late, pushed": {
        "events": [
            {"kind": "wrench-pulse", "time": 0.05, "duration": 0.06, "wrench": [9.0, 4.0, 0, 0, 0, 1.0]},
            {"kind": "payload-change", "time": 0.1, "mass": 2.0},
        ]
    },
    "biased, noisy and lost": BIAS
    | {"sensors.wrist": {"noise": {"force": 1.0, "moment": 0.1}, "delay": 1, "lost": [[0.03, 0.11]]}}
    | {"controller.gains.force_gain": 0.2, "controller.force_path": {"kind": "low-pass", "pole": 0.5}},
    "bounded": BIAS
    | {"controller.anchor_bias": [1e-5, 1e-5], "controller.anchor_bias_answered": [2e-5, 2e-5]},
    "own wrist": {
        "controller.force_path": {"kind": "none"},
        "controller.payload_mass": 2.5,
        "sensors.wrist": {},
    },
    "nothing": {"controller.force_path": {"kind": "none"}},
}


def anchored(name, changes, duration=0.12):
    scenario = SCENARIOS[name]().replace(controller=ANCHORED[name], duration=duration, events=())
    return cp.run(scenario, changes | (AWAY if name == "spatial" else {}), warn=False)


def largest(values):
    return float(np.nanmax(np.abs(values)))


@pytest.mark.parametrize("measured", MEASURED)
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_integrals_disagree_as_predicted_and_v_has_its_rates(name, measured):
    """Eqs. (1), (2) and (4) of the payload-space law along a run, to 1e-6."""
    result = anchored(name, MEASURED[measured])
    monitor = theorem_monitor(result)
    f_d = result.data["desired_internal_wrench"].values[-1, 0, :3]
    assert largest(monitor["balance_2"]) < 1e-6 * np.linalg.norm(f_d)
    scale = largest(monitor["disagreement_rate"]) if measured != "nothing" else 1.0
    assert scale >= 1.0
    assert largest(monitor["rate_defect"]) < 1e-6 * scale
    assert largest(monitor["V_rate"]) > 0.01
    assert largest(monitor["V_rate_defect"]) < 1e-6 * largest(monitor["V_rate"])
    assert bool(monitor["anchor_acts"].any()) == (measured != "nothing")
    if measured == "bounded":
        assert bool(monitor["anchor_is_bounded"].any())
    # One sample for all arms, split after its noise: the anchors cancel, if the arms see one pose.
    unbounded = monitor["anchor_sum"].values[~monitor["anchor_is_bounded"].any("arm").values]
    if measured == "late, pushed":
        assert largest(unbounded) < 1e-9
    assert bool(unbounded.max() > 0.1) == (measured == "own wrist")


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_dead_arm_brings_the_other_anchor_to_its_bound(name):
    """The metric counts the time; the bounds are such that the start itself does not need more."""
    bounds = {"planar": ([1e-4, 1e-3], [2e-2, 1e-1]), "spatial": ([1e-3, 1e-2], [1e-3, 1e-2])}[name]
    scenario = SCENARIOS[name]().replace(controller=ANCHORED[name], duration=0.15, events=())
    last, times = list(scenario.cell.arms)[-1], []
    for lost_at in (0.05, None):
        changes = dict(
            zip(("controller.anchor_bias", "controller.anchor_bias_answered"), bounds, strict=True)
        )
        changes[f"arm_actuators.{last}.torque_lost_at"] = lost_at
        times.append(anchor_bounded_time(cp.run(scenario, changes, warn=False))["anchor_bounded_s"])
    assert 0.0 < times[0] <= 0.1 + 1e-9
    assert times[1] == 0.0


@pytest.mark.gate
def test_a_sweep_tells_the_time_at_the_bound(tmp_path):
    """A column of the table by either engine: an arm lost at 0.4 and at 0.7 s."""
    plan = cp.SweepPlan(
        base=cp.Scenario.load("adept-anchored").replace(events=(), duration=0.9),
        axes={"arm_actuators.right.torque_lost_at": [0.4, 0.7]},
        metrics=["coop_pin.proof:anchor_bounded_time"],
    )
    columns = [
        cp.sweep(plan, out=tmp_path / engine, execution=cp.Execution(workers=0, quiet=True, engine=engine))
        .values("anchor_bounded_s")
        .values.tolist()
        for engine in ("pinocchio", "compiled")
    ]
    assert_allclose(columns[0], (0.5, 0.2), atol=0.05)
    assert columns[1] == columns[0]


MORE_ARMS = {
    "planar, three": lambda: planar_three_arms("adept-anchored"),
    "spatial, three": lambda: cp.Scenario.load("three-ur5-plate", {"duration": 0.04}),
    "spatial, unequal": lambda: cp.Scenario.load("panda-ur5-bar", {"duration": 0.04}),
}


@pytest.mark.parametrize(
    ("cell", "measured"),
    [
        ("planar, three", "internal wrench"),
        ("spatial, three", "internal wrench"),
        ("spatial, three", "own wrist"),
        ("spatial, unequal", "internal wrench"),
        ("spatial, unequal", "nothing"),
    ],
)
def test_the_derivation_holds_for_three_and_for_unequal_arms(cell, measured):
    """Anchored, by the own wrist and leaky, with a bias of one arm."""
    scenario = MORE_ARMS[cell]().override(MEASURED.get(measured, {}))
    first, *others = scenario.cell.arms
    arms = {arm: {} for arm in others} | {first: {"tip": {"xyz": [1e-3, 0.0, 0.0]}}}
    result = cp.run(
        scenario,
        {f"cell.arms.{arm}.calibration_error": arms[arm] for arm in arms},
        warn=False,
    )
    monitor = theorem_monitor(result)
    assert result.simulation_sound, result.verdict()
    assert largest(monitor["balance_2"]) < 1e-6
    assert largest(monitor["rate_defect"]) < 1e-6
    assert largest(monitor["V_rate_defect"]) < 1e-6 * largest(monitor["V_rate"])
    assert largest(monitor["disagreement_rate"].isel(time=slice(1, None))) > 1e-3


@pytest.mark.parametrize("cell", ["planar", "spatial"])
def test_the_printed_laws_identities_close_for_three_arms(cell):
    scenario = planar_three_arms("adept-paper")
    if cell == "spatial":
        law = spatial_scenario().controller
        scenario = cp.Scenario.load("three-ur5-plate", {"duration": 0.04}).replace(controller=law)
    monitor = theorem_monitor(cp.run(scenario, warn=False))
    assert largest(monitor["V_rate_defect"]) < 1e-6 * largest(monitor["V_rate"])
    assert largest(monitor["balance_25"]) < 1e-6 * largest(monitor["u_prime"])
    assert largest(monitor["residual_21"]) < 1e-12


def test_v_falls_where_the_load_comes_to_rest_and_the_disagreement_with_it():
    """To a hold 20 mm away: while friction and squeeze change V may grow, then it falls to nothing."""
    start = cp.Scenario.load("adept-anchored").start.replace(xyz=(0.62, 0.15, 0.0))
    hold = {"motion": {"kind": "hold", "pose": start.model_dump()}, "clock.steps_per_tick": 1}
    monitor = theorem_monitor(anchored("planar", hold, duration=2.0)).isel(time=slice(0, -2))
    assert bool(monitor["V_may_grow"].sel(time=slice(0.0, 0.4)).any())
    assert not bool(monitor["V_may_grow"].sel(time=slice(1.0, None)).any())
    rate = np.linalg.norm(monitor["disagreement_rate"].values[:, 0], axis=1)
    assert monitor["V"].values[-1] < 1e-4 * monitor["V"].values.max()
    assert rate[-1] < 0.02 * rate.max()


def test_the_figure_of_the_payload_space_law_has_its_four_panels():
    result = anchored("planar", {})
    figure = theorem_figure(result, theorem_monitor(result))
    assert len(figure.axes) == 4
    assert all(axes.lines for axes in figure.axes)


def test_other_laws_and_thinned_runs_are_refused():
    with pytest.raises(ArgumentError):
        theorem_monitor(
            cp.run("adept-anchored", {"duration": 0.1, "actuators.lag": 0.01, "events": ()}, warn=False)
        )
    with pytest.raises(ArgumentError):
        theorem_monitor(
            cp.run(
                "adept-anchored",
                {"duration": 0.1, "controller.zero_at_grasp": True, "events": ()},
                warn=False,
            )
        )
    gains = cp.Scenario.load("adept-paper").controller.gains
    redundant = {"controller": cp.laws.RedundantSlidingMode(gains=gains), "duration": 0.1, "events": ()}
    with pytest.raises(ArgumentError):
        theorem_monitor(cp.run("adept-paper", redundant, warn=False))
    with pytest.raises(ArgumentError):
        theorem_monitor(
            cp.run("adept-paper", {"duration": 0.1, "clock.record_every": 2, "events": ()}, warn=False)
        )
