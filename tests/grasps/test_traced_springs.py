"""Compliant grasps as compiled code: the runs of Pinocchio; planar, and in space with turned grasps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from batches import require_same_bits, require_same_samples
from cells import SCENARIOS
from compliant_cells import anchored, moved, with_grasps
from numpy.testing import assert_allclose
from sensing_settings import SETTINGS
from ways import WAYS, run_as_lane, run_on

import coop_pin as cp
from coop_pin.base.errors import TracingError
from coop_pin.chain.free_flyer import displaced, increment_rate, rotation
from coop_pin.compiled import plant_of, support
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.simulation.plant import Plant

STEPS = {"planar": 20, "spatial": 4}


def compliant(name: str, arms=None, **changes) -> cp.Scenario:
    """A short run on compliant grasps whose payload's mass halves and that is pushed within a tick."""
    scenario = with_grasps(anchored(name), arms=arms)
    push = {
        "kind": "wrench-pulse",
        "time": 0.0234,
        "duration": 0.01,
        "wrench": (3.0, -2.0, 0.0, 0.0, 0.0, 0.2),
    }
    drop = {"kind": "payload-change", "time": 0.0155, "mass": 0.5 * scenario.cell.payload.mass}
    steps = {"clock.steps_per_tick": STEPS[name], "duration": 0.05, "events": [drop, push]}
    return scenario.override(steps | changes)


def sensed(name: str) -> cp.Scenario:
    """The same with noise at encoders and wrists, and a late force path."""
    return compliant(name, **SETTINGS["everything at once"])


def test_free_flyer_is_that_of_pinocchio():
    rng, model = np.random.default_rng(4), pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "payload")
    for size in (1e-9, 1e-3, 0.05):
        X = pin.randomConfiguration(model, -np.ones(7), np.ones(7))
        u, V = size * rng.normal(size=6), rng.normal(size=6)
        assert_allclose(displaced(X, u), pin.integrate(model, X, u), rtol=0, atol=2e-15)
        assert_allclose(rotation(X[3:]), pin.XYZQUATToSE3(X).rotation, rtol=0, atol=1e-15)
        h = 1e-5  # X (+) u(t) moves with V
        ahead, behind = (displaced(X, u + sign * h * increment_rate(u, V)) for sign in (0.5, -0.5))
        assert_allclose(pin.difference(model, behind, ahead) / h, V, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "arms"), [pytest.param("planar", None, marks=pytest.mark.slow), ("spatial", ["right"])]
)
def test_the_plant_moves_and_observes_as_that_of_pinocchio(name, arms):
    scenario = with_grasps(SCENARIOS[name](), arms=arms)
    chain = CellChain(scenario.cell)
    q_start, plants = chain.configuration(scenario.start.matrix), list[Plant]()
    plants = [plant_of(engine)(chain, PlantOptions(), q_start) for engine in ("pinocchio", "compiled")]
    rng, seen = np.random.default_rng(5), []
    q, v = moved(chain, scenario.start.matrix, 6)
    v = chain.mechanism.project_velocity(q := chain.mechanism.project_configuration(q), v)
    force = np.zeros(len(v))
    force[: chain.model.arms[-1].v_slice.stop] = 20.0 * rng.normal(size=chain.model.arms[-1].v_slice.stop)
    for plant in plants:
        plant.restore(plant.state()._replace(q=q, v=v, force=force))
        seen.append(plant.observe(q[None], v[None], force[None], np.zeros(1)))
        for step in range(3):
            plant.advance(1e-4 * step, 1e-4)
    ours, traced = plants
    assert_allclose(traced.q, ours.q, rtol=0, atol=1e-11)
    assert_allclose(traced.v, ours.v, rtol=0, atol=1e-9)
    assert_allclose(traced.work, ours.work, rtol=0, atol=1e-11)
    assert ours.work[-1] < 0.0
    for field, wanted in seen[0]._asdict().items():
        if wanted is not None:
            scale = max(1.0, float(np.nanmax(np.abs(wanted))))
            assert_allclose(getattr(seen[1], field), wanted, rtol=0, atol=1e-11 * scale, err_msg=field)
    if arms:
        with pytest.raises(TracingError, match="rigid"):
            traced.release(0)


def test_a_run_in_a_plane_is_that_of_pinocchio():
    scenario = compliant("planar")
    single = cp.run(scenario, warn=False)
    require_same_samples(run_as_lane(scenario).data, single.data)
    assert single.data["elastic_energy"].values.min() > 0.0


RUNS = {
    **{f"{name} {kind.__name__}": (kind, name) for name in SCENARIOS for kind in (compliant, sensed)},
    **{f"{name} beside a rigid grasp": (lambda n: compliant(n, ["right"]), name) for name in SCENARIOS},
    **{f"{name} where the first gives": (lambda n: compliant(n, ["left"]), name) for name in SCENARIOS},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", RUNS)
def test_runs_are_those_of_pinocchio_in_both_ways(case):
    make, name = RUNS[case]
    scenario = make(name)
    single = cp.run(scenario, warn=False)
    for way in ("plant", "lanes"):
        require_same_samples(WAYS[way](scenario).data, single.data)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_batch_of_stiffnesses_has_the_bits_of_every_machine(name):
    records = [
        compliant(
            name, **{"cell.grasps.right.stiffness": tuple(scale * np.array((3e4, 3e4, 3e4, 300, 300, 300)))}
        )
        for scale in (0.5, 1.0, 2.0)
    ]
    require_same_bits(records)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adept-compliant", "three-ur5-handover"])
def test_scenarios_of_the_catalogue_are_those_of_pinocchio(name):
    scenario = cp.Scenario.load(name)
    traced = run_on("compiled", scenario).data
    require_same_samples(traced, cp.run(scenario, warn=False).data)


def test_releases_are_of_the_plant_alone_and_lanes_refuse_them_by_name():
    event = cp.events.HandOver(time=0.01, arm="left", duration=0.02)
    scenario = compliant("planar").replace(
        events=(event, cp.events.Regrasp(time=0.04, arm="left", duration=0.01))
    )
    single = cp.run(scenario, warn=False)
    assert single.data["load_share"].values[:, 0].min() == 0.0
    require_same_samples(cp.run(scenario, engine="compiled", warn=False).data, single.data)
    assert "hand-over" in support(scenario)
    with pytest.raises(TracingError, match="hand-over"):
        run_as_lane(scenario)
