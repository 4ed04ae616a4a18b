"""Compiled plants under interpreted laws: runs of Pinocchio, its guards, views and interrupted results."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from cells import planar_scenario, spatial_scenario
from numpy.testing import assert_allclose
from ways import run_on

import coop_pin as cp
from coop_pin.base import errors
from coop_pin.cli import main
from coop_pin.compiled import plant_of
from coop_pin.compiled.engine_choice import choose_engine
from coop_pin.compiled.engines import FORMER
from coop_pin.compiled.plant.closures import closure_error
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.simulation import Simulation

CASES = {
    "planar": (planar_scenario, 0.5),
    "spatial": (spatial_scenario, 0.1),
    "continuous": (lambda: cp.Scenario.load("kinova-pair"), 0.06),
    "three": (lambda: cp.Scenario.load("three-ur5-plate"), 0.06),
}


def eventful(name: str) -> cp.Scenario:
    """A short run whose payload's mass halves between two ticks and that is pushed within one."""
    scenario, duration = CASES[name][0](), CASES[name][1]
    push = (3.0, -2.0, 0.0, 0.0, 0.0, 0.2)
    pulse = {"kind": "wrench-pulse", "time": 0.4711 * duration, "duration": 0.2 * duration, "wrench": push}
    drop = {"kind": "payload-change", "time": 0.31 * duration, "mass": 0.5 * scenario.cell.payload.mass}
    return scenario.override({"duration": duration, "events": [drop, pulse]})


SLOW = pytest.param("three", marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=["planar", "spatial", "continuous", SLOW])
def pair(request) -> tuple[cp.RunResult, cp.RunResult]:
    """The same run on both plants."""
    scenario = eventful(request.param)
    return run_on("pinocchio", scenario), run_on("compiled", scenario)


def test_a_run_has_the_samples_of_pinocchio(pair):
    ours, traced = (result.data for result in pair)
    assert set(ours.variables) == set(traced.variables)
    for name, variable in ours.data_vars.items():
        found, wanted = traced[name].values, variable.values
        if wanted.dtype.kind == "f":
            scale = max(1.0, float(np.abs(np.nan_to_num(wanted)).max()))
            assert_allclose(found, wanted, rtol=0.0, atol=1e-9 * scale, err_msg=str(name))
        else:
            assert (found == wanted).all()
    work = traced["work_payload_change"].values[-1], traced["work_external"].values[-1]
    assert all(work)  # the events happened
    assert pair[1].energy_balance_max() < 1e-6


def test_the_results_name_their_engines(pair):
    assert [result.engine for result in pair] == ["pinocchio", "compiled"]
    assert "engine" not in pair[0].data.attrs


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_the_plant_has_the_accelerations_of_pinocchio_at_random_states(name):
    """From the change of velocity in a step so short that only the acceleration counts; off closures, too."""
    scenario, rng = CASES[name][0](), np.random.default_rng(3)
    chain = CellChain(scenario.cell)
    q_start, model = chain.configuration(scenario.start.matrix), chain.mechanism.model
    traced, rows = plant_of("compiled")(chain, PlantOptions(), q_start), scenario.cell.task_rows
    for gap in (0.0, 0.0, 1e-3):
        q = chain.mechanism.project_configuration(q_start + 0.03 * rng.normal(size=model.nv))
        v = chain.mechanism.project_velocity(q, rng.normal(size=model.nv))
        q, v = q + gap * rng.normal(size=model.nv), v + 100.0 * gap * rng.normal(size=model.nv)
        force, push = 20.0 * rng.normal(size=model.nv), np.zeros(6)
        push[list(rows.indices)] = rng.normal(size=rows.size)
        oracle = PinocchioPlant(chain, PlantOptions(), q)
        seen = []
        for plant in (oracle, traced):
            state, pushed = plant.state(), chain.cell.surroundings._replace(push=push)
            plant.restore(state._replace(q=q, v=v, force=force, surroundings=pushed))
            seen.append(plant.observe(*(np.array([part, part]) for part in (q, v, force)), np.zeros(2)))
            found = plant.interaction_wrenches()
            assert_allclose(seen[-1].interaction_wrench, [found, found], rtol=1e-12, atol=1e-12)
            plant.advance(0.0, 1e-6)
        assert_allclose((traced.v - v) / 1e-6, (oracle.v - v) / 1e-6, rtol=1e-7)
        for field in ("payload_pose", "payload_twist", "tip_position"):
            assert_allclose(getattr(seen[1], field), getattr(seen[0], field), rtol=0.0, atol=1e-12)
        F, F_wanted = (one.interaction_wrench[..., list(rows.indices)] for one in seen[::-1])
        assert_allclose(F, F_wanted, rtol=0.0, atol=1e-10 * np.abs(F_wanted).max())
        for field in ("kinetic_energy", "potential_energy"):
            assert_allclose(getattr(seen[1], field), getattr(seen[0], field), rtol=1e-12)


def test_closure_errors_of_compiled_code_are_logarithms():
    """Of a weld that has come apart by some hundredths of a radian, far from the world's origin."""
    rng = np.random.default_rng(2)
    for size in (1e-9, 1e-3, 0.05):
        X_0 = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        X_i = X_0 * pin.exp6(pin.Motion(size * rng.uniform(-1.0, 1.0, 6)))
        sides = (X_0.rotation, X_0.translation, X_i.rotation, X_i.translation)
        wanted = -pin.log6(X_0 * X_i.inverse()).vector
        assert_allclose(closure_error(*sides).astype(float), wanted, rtol=0, atol=1e-12)


def test_steps_wait_until_something_asks_and_give_the_same_state():
    scenario = planar_scenario()
    chain = CellChain(scenario.cell)
    q = chain.configuration(scenario.start.matrix)
    at_once, one_by_one = (plant_of("compiled")(chain, PlantOptions(), q) for _ in range(2))
    for plant in (at_once, one_by_one):
        force = np.linspace(-3.0, 3.0, chain.mechanism.model.nv)
        plant.restore(plant.state()._replace(force=force))
    for step in range(150):  # more than one call makes
        for plant in (at_once, one_by_one):
            plant.advance(1e-3 * step, 1e-3)
        assert one_by_one.v.any()
    assert (at_once.q == one_by_one.q).all()
    assert (at_once.work == one_by_one.work).all()
    assert at_once.work[0] > 0.0


def test_a_view_sees_every_tick_and_an_interrupted_run_is_kept():
    scenario, seen = eventful("planar"), []

    def watch(snapshot):
        seen.append(snapshot.payload_pose)
        if len(seen) == 12:
            raise KeyboardInterrupt

    with pytest.raises(errors.RunInterruptedError) as caught:
        cp.run(scenario, engine="compiled", view=watch, realtime_rate=np.inf, warn=False)
    kept = caught.value.result
    assert kept.data.sizes["time"] == 12
    assert kept.engine == "compiled"
    assert_allclose(kept.data["payload_position"].values[:, :2], [X[:2, 3] for X in seen], rtol=0, atol=0)


def test_an_event_added_on_the_way_acts():
    scenario = planar_scenario().replace(duration=0.5, events=())
    results = []
    for engine in ("pinocchio", "compiled"):
        run = Simulation(scenario, build_controller(scenario), plant=plant_of(engine))
        for _ in range(10):
            run.tick()
        run.add_event(cp.events.PayloadChange(time=0.2, mass=1.0))
        while not run.is_finished:
            run.tick()
        results.append(run.result().data)
    ours, traced = results
    assert_allclose(traced["interaction_wrench"], ours["interaction_wrench"], rtol=0, atol=1e-9)
    assert traced["work_payload_change"].values[-1] != 0.0


class TooStrong(cp.ArmController):
    """Pushes until the motion diverges."""

    def __init__(self, scenario, arm):
        self.size = len(scenario.cell.arms[arm].posture)

    def init(self, measurement, reference):
        return 1.0

    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.full(self.size, state), 3.0 * state)


def test_a_users_law_that_diverges_ends_both_runs_alike():
    scenario = planar_scenario().override(
        {"controller": {"kind": "user", "target": TooStrong}, "events": [], "duration": 2.0}
    )
    found = []
    for engine in ("pinocchio", "compiled"):
        with pytest.raises(errors.DivergedError) as caught:
            run_on(engine, scenario)
        found.append(caught.value)
    assert found[0].time == found[1].time
    assert found[0].result.end == found[1].result.end


PINOCCHIO_ALONE = {
    "free payload": {"plant.payload": "free"},
    "another integrator": {"plant.integrator": "semi-implicit-euler"},
    "projection": {"plant.project": "step"},
    "released": {"plant.payload": "free", "events": [{"kind": "release", "time": 0.1, "arm": "left"}]},
    "braked": {"events": [{"kind": "lose-arm", "time": 0.1, "arm": "left", "form": "braked"}]},
}
"""Changes after which nothing of adept-paper can be compiled."""


@pytest.mark.parametrize("change", PINOCCHIO_ALONE)
def test_what_only_pinocchio_has_is_refused_before_the_run(change, tmp_path):
    """By a run and a sweep that name the compiled engine; both name one that can."""
    scenario, ticks = cp.Scenario.load("adept-paper", {"duration": 0.2, "events": []}), []
    scenario = scenario.override(PINOCCHIO_ALONE[change])
    here = cp.Execution(workers=0, quiet=True, engine="compiled")
    with pytest.raises(errors.FieldError, match="'pinocchio'"):
        cp.run(scenario, engine="compiled", warn=False, progress=lambda *_: ticks.append(1))
    with pytest.raises(errors.FieldError, match="'pinocchio'"):
        cp.sweep(scenario, {"seed": [0, 1]}, out=tmp_path, execution=here)
    assert not ticks
    assert choose_engine(scenario).engine == "pinocchio"


def test_unknown_engines_are_refused_and_former_ones_named_as_they_are_called():
    for name, present in (("compield", "compiled"), *FORMER.items()):
        for call in (
            lambda name=name: cp.run("adept-paper", engine=name, warn=False),
            lambda name=name: cp.Execution(engine=name),
            lambda name=name: cp.SweepPlan(base="adept-paper", engine=name),
        ):
            with pytest.raises(errors.FieldError, match=f"'{present}'") as caught:
                call()
            assert caught.value.path == "engine"


@pytest.mark.parametrize("former", FORMER)
@pytest.mark.parametrize("form", [["--engine", "{}"], ["--engine={}"]], ids=len)
def test_commands_name_former_engines_as_they_are_called(former, form, capsys):
    for command in (["run", "adept-paper"], ["sweep", "plan.toml"]):
        assert main([*command, *(word.format(former) for word in form)]) == 2
        assert f"'{FORMER[former]}'" in capsys.readouterr().err


def test_the_command_line_chooses_the_engine(tmp_path, capsys):
    words = ["run", "adept-paper", "--engine", "compiled", "--duration", "0.1", "--events", "[]"]
    assert main([*words, "--no-figures", "--no-replay", "--out", str(tmp_path)]) == 4
    assert "engine compiled" in capsys.readouterr().out
    assert cp.RunResult.load(tmp_path / "result.nc").engine == "compiled"
    assert json.loads((tmp_path / "metrics.json").read_text())["simulation_sound"]
