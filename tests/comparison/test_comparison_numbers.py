"""Numbers of the comparison: changes of trials, measures, gains that cells set, and the printed table."""

import math
import types

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose
from scipy.optimize import curve_fit
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import FieldError, NameNotFoundError, NothingFeasibleError
from coop_pin.comparison import Comparison, controllers_for, standard_trials, tune_controllers, tuned_gains
from coop_pin.comparison.controllers import t_lambda
from coop_pin.comparison.measures import MEASURES, measures, payload_damping, tuning_cost
from coop_pin.comparison.table import CELL, COLUMNS
from coop_pin.comparison.trials import benchmark_scenario, changes_of, friction_changes
from coop_pin.compiled.engine_choice import choose_engines
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import loop_stability


@pytest.fixture(params=SCENARIOS)
def scenario(request):
    changes = {"controller": ANCHORED[request.param], "events": [], "duration": 6.0}
    return SCENARIOS[request.param]().override(changes)


def test_trials_change_what_their_names_say(scenario):
    trials, mass = standard_trials(scenario), scenario.cell.payload.mass
    (pulse,) = trials["push"].changes["events"]
    assert (pulse["kind"], pulse["time"], pulse["duration"]) == ("wrench-pulse", 3.0, 0.2)
    assert_allclose(pulse["wrench"], 9.81 * mass * np.array([2.0, 1.0, 0, 0, 0, 0]) / np.hypot(2.0, 1.0))
    assert [name for name, trial in trials.items() if trial.random] == ["noise"]
    assert trials["noise"].changes == {
        "sensors.wrist": {"noise": {"force": 1.0, "moment": 0.05}},
        "sensors.encoder": {"resolution": 1e-5, "noise": 1e-5},
    }
    tip = "cell.arms.left.calibration_error.tip.xyz"
    assert trials["bias 0.1 mm"].changes == {tip: [1e-4, 0.0, 0.0]}
    assert trials["bias 1 mm"].changes == {tip: [1e-3, 0.0, 0.0]}
    base = {"cell.arms.left.calibration_error.base.rpy": [0.0, 0.0, 1e-3]}
    assert trials["base turned by 1 mrad"].changes == base
    for factor in (0.5, 2.0):
        (event,) = trials[f"mass x{factor:g}"].changes["events"]
        assert event == {"kind": "payload-change", "time": 0.0, "mass": factor * mass}
    for ticks, name in ((1, "wrench 1 tick late"), (3, "wrench 3 ticks late")):
        assert trials[name].changes == {"sensors.wrist.delay": ticks}
    assert trials["wrist lost at half time"].changes == {"sensors.wrist.lost": [[3.0, 6.0]]}
    for what in ("torque", "commands"):
        fields = trials[f"{what} of an arm lost"].changes["arm_actuators.right"]
        assert {name for name, value in fields.items() if value == 3.0} == {f"{what}_lost_at"}
    for rate in (80.0, 250.0, 1000.0):
        clock = scenario.override(trials[f"{rate:g} Hz"].changes).clock
        step, before = clock.period / clock.steps_per_tick, scenario.clock
        assert clock.rate_hz == rate
        assert step <= before.period / before.steps_per_tick + 1e-12
        assert clock.steps_per_tick == 1 or clock.period / (clock.steps_per_tick - 1) > step
    assert trials["nominal"] == cp.comparison.Trial({}, random=False, friction=1.0)
    assert [trial.friction for name, trial in trials.items() if "friction" in name] == [0.0, 3.0]


def test_friction_is_scaled_and_a_model_of_it_is_not(scenario):
    changes = friction_changes(scenario, 3.0)
    scaled = scenario.override(changes).cell.arms
    for name, arm in scenario.cell.arms.items():
        nominal = scenario.override(friction_changes(scenario, 1.0)).cell.arms[name].friction
        for field in ("viscous", "coulomb", "stiction"):
            assert_allclose(getattr(scaled[name].friction, field), 3.0 * np.array(getattr(nominal, field)))
        for field in ("coulomb_velocity", "stribeck_velocity"):
            assert_allclose(getattr(scaled[name].friction, field), getattr(nominal, field))
        assert_allclose(nominal.viscous, np.broadcast_to(arm.friction.viscous, np.shape(nominal.viscous)))
    three = cp.comparison.Trial({"seed": 4}, friction=3.0)
    law = {"kind": "computed-torque", "model": {"friction": 1.5}}
    found = changes_of(scenario, three, law)
    assert found["seed"] == 4
    assert found["controller"]["model"]["friction"] == 0.5
    inner = {"kind": "user", "options": {"model": {"mass": 1.0}}}
    assert changes_of(scenario, three, inner)["controller"]["options"]["model"] == {
        "mass": 1.0,
        "friction": 1.0 / 3.0,
    }
    none = changes_of(scenario, cp.comparison.Trial({}, friction=0.0), law)
    assert none["controller"]["model"]["friction"] == pytest.approx(1.5e9)
    assert changes_of(scenario, cp.comparison.Trial({"seed": 4}), law) == {"controller": law, "seed": 4}


def made_up_run(rng):
    """A run of 11 samples in 1 s, and its numbers from 0.4 s on."""
    time = np.linspace(0.0, 1.0, 11)
    parts = {f"internal_{part}_error": rng.normal(size=11) for part in ("axial", "shear", "moment")}
    error, torque = rng.normal(size=(11, 6)), rng.normal(size=(11, 2, 3))
    torque[:, 1, 2] = np.nan  # a joint that the second arm does not have
    samples = {"pose_error": (("time", "axis"), error), "torque": (("time", "arm", "joint"), torque)}
    samples |= {name: ("time", values) for name, values in parts.items()}
    data = xr.Dataset(samples, {"time": time})
    scenario = types.SimpleNamespace(duration=1.0)
    result = types.SimpleNamespace(arrays=data, scenario=scenario, dropped_at=math.nan)
    return result, error[4:], torque[4:].reshape(7, 6)[:, :5], [values[4:] for values in parts.values()]


def test_measures_are_of_the_samples_from_four_tenths_on():
    result, error, torque, internal = made_up_run(np.random.default_rng(3))
    found = measures(result)
    assert list(found) == [*MEASURES, "dropped"]
    assert found.pop("dropped") == 0.0
    expected = [1e3 * np.sqrt((error[:, part] ** 2).sum(axis=1).mean()) for part in (slice(3), slice(3, 6))]
    expected += [np.sqrt((values**2).mean()) for values in internal]
    expected += [np.sqrt((torque**2).mean()), np.sqrt((np.diff(torque, axis=0) ** 2).mean())]
    assert_allclose(list(found.values()), expected)


def table_of(**columns):
    """A comparison of two controllers under two trials; the last cell was not run."""
    names = [("cell", "a", "t"), ("cell", "a", "u"), ("cell", "b", "t")]
    cells = pd.DataFrame(index=pd.MultiIndex.from_tuples(names, names=CELL))
    for name in COLUMNS:
        cells[name] = columns.get(name, [1.0, 2.0, 3.0])
    texts = {"information": "blind", "engine": "compiled", "gains": ["tuned", "tuned", "untuned"]}
    texts["failure"] = columns["failure"]
    return Comparison.of_cells(
        cells.assign(
            runs=4, finished=[4, 4, 1], sound=[4, 3, 1], kept=[4, 4, 0], dropped=0, merged=0, **texts
        )
    )


def test_the_summary_has_tracking_and_the_length_of_axial_and_shear_force():
    table = table_of(
        tracking_rms_mm=[1.5, 2.5, math.inf],
        axial_rms_N=[3.0, 8.0, math.inf],
        shear_rms_N=[4.0, 6.0, math.inf],
        failure=["", "", "DivergedError: of speed"],
    )
    first, head, one, two, _, *rest = table.summary().splitlines()
    assert first == "cell: tracking mm / internal force N"
    assert head.split() == ["a", "b", "(untuned)"]
    assert one.split() == ["t", "1.5", "/", "5", "failed"]
    assert two.split() == ["u", "2.5", "/", "10", "*", "-"]
    assert rest == ["blind: a, b", "", "cell | b failed in t (3 of 4 runs): DivergedError: of speed"]


def test_ranks_have_the_interval_of_a_stated_seed():
    rng = np.random.default_rng(8)
    index = pd.MultiIndex.from_product([["cell"], list("abc"), map(str, range(9))], names=CELL)
    cells = pd.DataFrame({name: rng.random(27) for name in COLUMNS}, index).assign(runs=1.0)
    ranks = Comparison.of_cells(cells).ranks("axial_rms_N")
    assert ranks.equals(Comparison.of_cells(cells).ranks("axial_rms_N", seed=0))
    places = cells["axial_rms_N"].to_numpy().reshape(3, 9).argsort(axis=0).argsort(axis=0) + 1.0
    drawn = np.random.default_rng(0).integers(9, size=(1000, 9))
    means = places.T[drawn].mean(axis=1)
    for name, row in zip("abc", np.sort(means, axis=0).T, strict=True):
        assert ranks.loc[name, ["low", "high"]].tolist() == [row[25], row[974]]


@pytest.mark.parametrize("folder", [None, "out/made up"])
def test_the_page_replays_a_cell_from_the_folder_of_its_runs_if_there_is_one(folder, tmp_path):
    table = table_of(failure=["", "", ""])
    table.folder = None if folder is None else tmp_path / folder
    table.write_html(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert ("--replay {cells}" in page) == (folder is not None)
    assert ("--controllers {controller}" in page) == (folder is None)


def test_the_page_of_a_table_alone_has_shares_of_the_squeezes_that_are_stated(tmp_path):
    table = table_of(failure=["", "", ""])
    table.write_html(tmp_path / "page.html")
    assert '"wanted":[null,null,null]' in (tmp_path / "page.html").read_text()
    table.write_html(tmp_path / "page.html", squeezes={"cell": 12.5, "other": 1.0})
    assert '"wanted":[12.5,12.5,12.5]' in (tmp_path / "page.html").read_text()


def test_gains_that_the_cell_sets_are_parts_of_its_own(scenario):
    K = np.broadcast_to(scenario.controller.gains.sliding_gain, scenario.cell.task_rows.size)
    names = ["printed", "leader-follower", "prescribed-performance", "anchored"]
    laws = controllers_for(scenario, names, tuned=False)
    gains = laws["leader-follower"]["gains"]
    parts = {"sliding_gain": 0.5, "follower_damping": 0.25, "follower_stiffness": 1.0}
    for field, part in {**parts, "admittance_damping": 0.1}.items():
        assert_allclose(gains[field], part * K)
    assert_allclose(laws["prescribed-performance"]["gains"]["velocity_gain"], 0.1 * K)
    assert_allclose(laws["anchored"]["gains"]["sliding_gain"], K)
    weight = np.array([*np.multiply(scenario.cell.payload.mass, scenario.cell.gravity), 0.0, 0.0, 0.0])
    assert_allclose(gains["payload_weight"], scenario.cell.task_rows.select(weight))
    assert laws["printed"]["kind"] == "sliding-mode"
    assert len(laws["printed"]["gains"]["damping_gain"]) == K.size  # of both arms, which are alike
    assert 0.7 < t_lambda(scenario.override({"controller": laws["printed"]})) <= 0.9


def test_gains_of_spare_joints_have_a_spring_unless_the_cell_has_a_joint_without():
    scenario = cp.Scenario.load("two-pandas-box")
    for stiffness in (30.0, 0.0):
        own = scenario.override({"controller.posture.stiffness": stiffness})
        laws = controllers_for(
            own, ["printed", "leader-follower", "computed-torque", "adaptive"], tuned=False
        )
        spring = float(stiffness > 0.0)
        assert tuple(laws["leader-follower"]["gains"]["spare_gains"]) == (40.0 * spring, 8.0)
        assert tuple(laws["computed-torque"]["gains"]["spare_gains"]) == (25.0 * spring, 10.0)
        assert laws["adaptive"]["gains"]["spare_gain"] == 4.0 * spring
        assert laws["printed"]["kind"] == "sliding-mode-redundant"


def test_every_controller_is_searched_with_the_same_number_of_runs(scenario, tmp_path, monkeypatch):
    searches = []

    def tune(base, ranges, **options):
        searches.append((base, ranges, options))
        raise NothingFeasibleError(1, 1, [], str(tmp_path))

    monkeypatch.setattr(tuned_gains, "tune", tune)
    names = ["payload-pd", "printed", "leader-follower"]
    assert tune_controllers(scenario, names, out=tmp_path, duration=0.05) == []
    assert [len(ranges) * options["population"] for _, ranges, options in searches] == [6, 6, 6]
    for base, ranges, options in searches:
        assert (options["generations"], options["seed"], base.duration) == (4, 1000, 0.05)
        assert (options["minimize"], options["subject_to"]) == ("cost", ("t_lambda<1", "damping>0.55"))
        assert {span.scale for span in ranges.values()} == {"log"}
        assert {changes["seed"] for changes in options["cases"].values()} == {1000}
        assert list(options["cases"]) == ["noise", "bias 1 mm", "mass x0.5", "torque of an arm lost"]
    few = {"trials": ["noise", "push"], "least_damping": -1.0}
    tune_controllers(scenario, names[:1], out=tmp_path, size=18, generations=2, duration=0.05, **few)
    assert list(searches[-1][2]["cases"]) == ["noise", "push"]
    assert searches[-1][2]["subject_to"] == ("t_lambda<1", "damping>-1.0")
    with pytest.raises(NameNotFoundError):
        tune_controllers(scenario, names, out=tmp_path, trials=["nose"])
    _, ranges, options = searches[-1]
    assert (len(ranges) * options["population"], options["generations"]) == (18, 2)
    tune_controllers(scenario, ["printed"], out=tmp_path, size=1, duration=0.05)
    assert searches[-1][2]["population"] == 1


def test_ways_are_those_of_the_engine_that_is_named(scenario):
    model = {"kind": "computed-torque", "gains": {"position_gain": 9.0, "velocity_gain": 6.0}}
    runs, free = [10**7], scenario.override({"plant.payload": "free"})
    expected = {"auto": "lanes", "compiled": "lanes", "pinocchio": "pinocchio"}
    assert {name: choose_engines([scenario], name, runs)[0].way for name in expected} == expected
    assert choose_engines([scenario], "auto", [1])[0].way == "pinocchio"
    modelled = scenario.override({"controller": model})
    for engine, ways in (("compiled", ["lanes", "plant"]), ("auto", ["lanes", "pinocchio"])):
        assert [each.way for each in choose_engines([scenario, modelled], engine, runs * 2)] == ways
    (choice,) = choose_engines([free], "compiled", [1])
    with pytest.raises(FieldError, match="free"):
        choice.require("compiled")


FRICTION = {"viscous": 3.0, "coulomb": 0.01}


@pytest.mark.parametrize("name", by_default(["adept-anchored", "two-pandas-box"], "adept-anchored"))
def test_an_impedance_is_damped_as_stated_whatever_friction_its_model_takes_out(name):
    """D / (2 sqrt(M K)) = 0.71 of object impedance; the loop has no friction in its plant."""
    base = benchmark_scenario(cp.Scenario.load(name), 2.5)
    base = base.override({f"cell.arms.{arm}.friction": FRICTION for arm in base.cell.arms})
    law = controllers_for(base, ["object-impedance"], tuned=False)["object-impedance"]
    gains = law["gains"]
    stated = gains["damping"][0] / (2.0 * math.sqrt(gains["inertia"][0] * gains["stiffness"][0]))
    scenario = base.override({"controller": law})
    assert_allclose(payload_damping(scenario), stated, rtol=0.02)
    assert loop_stability(Simulation(scenario, build_controller(scenario))).damping < 0.9 * stated
    if name == "adept-anchored":
        assert_allclose(damping_of_a_run(scenario), stated, rtol=0.03)


def damping_of_a_run(scenario):
    """The damping ratio of the position along x after a push, of a least-squares fit."""
    push = {"kind": "wrench-pulse", "time": 0.5, "duration": 0.02, "wrench": (100.0, 0, 0, 0, 0, 0)}
    hold = {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}, "events": [push]}
    x = cp.run(scenario, hold, warn=False).data.pose_error.isel(axis=0).sel(time=slice(0.6, None))

    def decay(t, cosine, sine, rate, omega):
        return np.exp(-rate * t) * (cosine * np.cos(omega * t) + sine * np.sin(omega * t))

    (*_, rate, omega), _ = curve_fit(decay, x.time - 0.6, x / float(np.abs(x).max()), p0=[1, 0, 5, 5])
    return rate / math.hypot(rate, omega)


def test_the_cost_of_a_search_has_the_bounds_of_the_gains(scenario):
    base = benchmark_scenario(scenario, 0.05)
    law = controllers_for(base, ["payload-pi"], tuned=False)["payload-pi"]
    run = cp.run(base.override({"controller": law}), warn=False)
    bounds = tuning_cost(run)
    assert bounds["t_lambda"] == t_lambda(run.scenario)
    assert bounds["damping"] == payload_damping(run.scenario)
    zone = law | {"integral_dead_zone": (1e-3, 1e-3), "gains": law["gains"] | {"leak": None}}
    assert payload_damping(base.override({"controller": zone})) == pytest.approx(bounds["damping"])
