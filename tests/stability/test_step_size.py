"""Fewest steps in a tick: bounds against an independent finer run, order of convergence, refusals."""

import functools

import numpy as np
import pytest
from cells import SCENARIOS
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import DivergedError, FieldError, OutOfRangeError
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import step_size, step_stability
from coop_pin.sweeps import engine
from coop_pin.sweeps.session import open_session
from coop_pin.sweeps.store import SweepStore

PUSH = cp.events.WrenchPulse(time=0.21, duration=0.1, wrench=(200.0, 100.0, 0.0, 0.0, 0.0, 2.0))
"""It begins and ends between two ticks."""
CHANGES = {
    "planar": {"duration": 0.5, "events": [PUSH]},
    "spatial": {
        "duration": 0.2,
        "motion.pose.xyz": (0.46, 0.04, 0.42),
        "motion.pose.rpy": (0.35, -0.2, 0.45),
    },
}


def moving(cell, changes=()):
    """The planar cell with a push, the spatial one on its way to a pose; sgn in the law of the first."""
    return SCENARIOS[cell]().override(CHANGES[cell] | dict(changes))


def positions(scenario, steps, changes=()):
    """Position of the payload and closure errors at the ticks, of a run with some steps in a tick."""
    data = cp.run(scenario, {"clock.steps_per_tick": steps} | dict(changes), warn=False).data
    return data.payload_position.values, data.closure_distance.values


@functools.cache
def independent_run(cell):
    """Of the KKT solver, with finer steps."""
    return positions(moving(cell), 16, {"plant.formulation": "kkt"})


def with_viscous_friction(scenario, factor):
    arms = {
        name: arm.replace(friction=arm.friction.replace(viscous=factor * np.array(arm.friction.viscous)))
        for name, arm in scenario.cell.arms.items()
    }
    return scenario.replace(cell=scenario.cell.replace(arms=arms))


@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize("error", [3e-9, 1e-10])
def test_the_fewest_steps_keep_the_error_against_an_independent_finer_run(cell, error):
    scenario = moving(cell)
    found = cp.stability.fewest_steps(scenario, error=error)
    position, gap = independent_run(cell)
    for steps, bound in found.errors.items():
        run, open_by = positions(scenario, steps)
        actual = max(np.linalg.norm(run - position, axis=1).max(), np.abs(open_by - gap).max())
        assert actual <= bound < 2.2 * actual
        assert (bound <= error) == (steps >= found.steps)
    assert found.steps > 1
    assert found.limit == error
    assert found.scenario == scenario.override({"clock.steps_per_tick": found.steps})


@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize(
    ("integrator", "order", "error"), [("rk4", 4, 1e-11), ("semi-implicit-euler", 1, 1e-4)]
)
def test_the_errors_fall_with_the_order_of_the_integrator(cell, integrator, order, error):
    """The last one is a bound of twice the error."""
    errors = cp.stability.fewest_steps(moving(cell, {"plant.integrator": integrator}), error=error).errors
    values = np.array(list(errors.values())[:-1])
    assert list(errors) == [2**k for k in range(len(errors))]
    assert len(values) >= 3
    assert_allclose(np.log2(values[:-1] / values[1:]), order, atol=0.4)


@pytest.fixture
def most_steps(monkeypatch):
    """A function that sets the largest number of steps in a tick that is tried."""
    return functools.partial(monkeypatch.setattr, step_size, "MOST_STEPS")


@pytest.mark.parametrize("cell", SCENARIOS)
def test_an_error_that_no_number_of_steps_keeps_is_refused_with_the_smallest(cell, most_steps):
    most_steps(2)
    scenario = moving(cell)
    with pytest.raises(OutOfRangeError) as caught:
        cp.stability.fewest_steps(scenario, error=1e-13)
    assert (caught.value.name, caught.value.value) == ("error", 1e-13)
    smallest = float(caught.value.allowed.removeprefix("at least ").split(" m")[0])
    assert cp.stability.fewest_steps(scenario, error=1.01 * smallest).steps == 2


@pytest.mark.parametrize("value", [0.0, -1e-9, np.nan])
def test_the_error_must_be_positive(value):
    with pytest.raises(OutOfRangeError):
        cp.stability.fewest_steps(moving("planar"), error=value)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_numbers_of_steps_with_which_the_run_diverges_are_passed_over(cell, most_steps):
    scenario = with_viscous_friction(moving(cell), 500.0)
    found = cp.stability.fewest_steps(scenario, error=1e-6)
    assert min(found.errors) > 1
    for steps in (found.steps, min(found.errors) // 2):
        steady = scenario.override({"clock.steps_per_tick": steps})
        assert step_stability(Simulation(steady, build_controller(steady))).ok == (steps == found.steps)
    most_steps(min(found.errors) // 2)
    with pytest.raises(DivergedError):
        cp.stability.fewest_steps(scenario, error=1e-6)


def test_the_summary_has_the_choice_and_every_error():
    found = cp.stability.fewest_steps(moving("planar"), error=1e-9)
    text = found.summary()
    assert f"{12.5 / found.steps:.4g} ms" in text
    assert all(f"{steps:3d} in a tick: {error:.2g} m" in text for steps, error in found.errors.items())


# ---------------------------------------------------------------- steps_per_tick = "auto"

AUTO = {"clock.steps_per_tick": "auto"}
HERE = cp.Execution(workers=0, quiet=True)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_run_with_automatic_steps_is_that_with_the_fewest_for_1e_8(cell):
    scenario = moving(cell)
    found = cp.stability.fewest_steps(scenario, error=1e-8)
    result = cp.run(scenario, AUTO, warn=False)
    assert result.scenario == found.scenario
    converged, _ = positions(scenario, 32)
    assert np.linalg.norm(result.data.payload_position.values - converged, axis=1).max() <= 1e-8


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_a_sweep_with_automatic_steps_keeps_its_error_at_points_that_were_not_measured(
    cell, tmp_path, monkeypatch
):
    """Random points of a plan of 108, and what the folder has of the choice."""
    monkeypatch.setattr(engine, "_SAMPLE", 2)
    scenario, error = moving(cell), {"planar": 1e-8, "spatial": 1e-9}[cell]
    mass = scenario.cell.payload.mass
    axes = {
        "cell.payload.mass": np.linspace(0.7 * mass, 1.5 * mass, 36).tolist(),
        "controller.gains.damping_gain": [0.5, 0.3, 0.4],
    }
    plan = cp.SweepPlan(base=scenario, axes=axes, changes=AUTO, steps_error_m=error, engine="pinocchio")
    measured = engine.extreme_points(plan)
    others = np.random.default_rng(31).choice([n for n in range(len(plan)) if n not in measured], 2)
    decided = engine.with_steps(plan, SweepStore(tmp_path))
    steps = decided.changes["clock.steps_per_tick"]
    assert steps > 1
    for number in others.tolist():
        point = decided.scenario(number)
        assert point.clock.steps_per_tick == steps
        run, gap = positions(point, steps)
        converged, closed = positions(point, 32)
        assert np.linalg.norm(run - converged, axis=1).max() <= error
        assert np.abs(gap - closed).max() <= error


@pytest.mark.parametrize("cell", SCENARIOS)
def test_automatic_steps_stand_in_plan_key_and_record_and_are_kept_on_resume(cell, tmp_path, monkeypatch):
    scenario, axes = (
        moving(cell, {"duration": 0.1, "events": ()}),
        {"controller.gains.damping_gain": [0.4, 0.5]},
    )
    first = cp.sweep(scenario, axes, out=tmp_path / "auto", execution=HERE, changes=AUTO)
    steps = first.plan.changes["clock.steps_per_tick"]
    stated = {"clock.steps_per_tick": steps}
    other = cp.sweep(scenario, axes, out=tmp_path / "stated", execution=HERE, changes=stated)
    assert first.table.key.tolist() == other.table.key.tolist()
    records = (tmp_path / "auto" / "runs").glob("*.jsonl")
    assert f'"clock.steps_per_tick":{steps}' in "".join(path.read_text() for path in records).replace(" ", "")
    measured = []
    original = engine.fewest_steps
    monkeypatch.setattr(engine, "fewest_steps", lambda *a, **b: measured.append(a) or original(*a, **b))
    again = cp.sweep(scenario, axes, out=tmp_path / "auto", execution=HERE, changes=AUTO)
    assert again.plan == first.plan
    assert not measured
    more = axes | {"controller.gains.transient_rate": [1.0, 2.0]}
    grown = cp.sweep(scenario, more, out=tmp_path / "auto", execution=HERE, changes=AUTO)
    assert measured
    assert grown.plan.changes["clock.steps_per_tick"] >= steps


def test_automatic_steps_that_keep_no_error_are_refused_and_elsewhere_a_number_is_asked_for(tmp_path):
    scenario = moving("planar", {"duration": 0.1, "events": ()})
    with pytest.raises(OutOfRangeError, match="error"):
        cp.sweep(scenario, out=tmp_path, execution=HERE, changes=AUTO, steps_error_m=1e-18)
    with pytest.raises(FieldError, match="number"), open_session(tmp_path / "other", HERE, 1) as session:
        session.compute(cp.SweepPlan(base=scenario, changes=AUTO))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes", "steps"),
    [
        ("adept-paper", {}, {1e-8: 2, 1e-9: 4}),
        ("adept-paper", {"events": []}, {1e-8: 1, 1e-9: 2}),
        ("adept-anchored", {}, {1e-8: 2, 1e-9: 4}),
        ("two-pandas-box", {}, {1e-8: 1, 1e-9: 1}),
    ],
)
def test_the_fewest_steps_of_the_catalogue_are_those_on_the_page(name, changes, steps):
    """docs/howto/sweep.md."""
    scenario = cp.Scenario.load(name, changes)
    assert {error: cp.stability.fewest_steps(scenario, error=error).steps for error in steps} == steps
