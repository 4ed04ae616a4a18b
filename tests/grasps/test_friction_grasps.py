"""Runs whose payload is held by friction: carried, at the limit of slip, dropped; planar and in space."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.base.errors import CoopPinError, DivergedError
from coop_pin.base.spatial import weight_wrench
from coop_pin.base.spatial.internal_wrench import linkage_loads, virtual_linkage_internal_wrenches
from coop_pin.compiled import support
from coop_pin.design import Suggestion
from coop_pin.feasibility import least_squeeze
from coop_pin.results.energies import energy_balance
from coop_pin.running.check import quick_findings
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.sensing import SlipSensors
from coop_pin.simulation.devices.signals import SensorSignals
from coop_pin.simulation.simulate import errors_with_results
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import grasp_stability
from coop_pin.viz.frames import snapshot_samples
from coop_pin.viz.highlights import telling_instant
from coop_pin.viz.live.live_scene import LiveScene, initial_scene

BAR = {"kind": "bar", "mass": 1.5, "length": 0.24}


def palms(mu: float = 0.6, **changes) -> cp.Scenario:
    """Two Pandas with a crate between their palms, at rest."""
    friction = {f"cell.grasps.{arm}.mu": mu for arm in ("left", "right")}
    hold = {"motion": {"kind": "hold", "pose": {"xyz": (0.0, 0.0, 0.5)}}}
    return cp.Scenario.load("two-pandas-palms", friction | hold | changes)


def adepts(mu: float = 0.6, **changes) -> cp.Scenario:
    """Two planar arms that press a light bar between them; gravity is across their plane."""
    patch = {"kind": "patch", "mu": mu, "radius": 0.014}
    grasps = {
        "left": patch | {"xyz": (-0.12, 0.0, 0.0), "press": "x"},
        "right": patch | {"xyz": (0.12, 0.0, 0.0), "press": "-x"},
    }
    scenario = cp.Scenario.load("adept-compliant", {"cell.grasps": grasps, "cell.payload": BAR, "events": ()})
    hold = {"motion": {"kind": "hold", "pose": scenario.start}}
    law = {"controller.force_path.split": "virtual-linkage", "controller.zero_at_grasp": True}
    return scenario.override({"squeeze": squeeze(30.0)} | hold | law | changes)


CELLS = {"planar": adepts, "spatial": palms}


def squeeze(force: float) -> dict[str, tuple[float, ...]]:
    """Forces along the line between two patches, N."""
    return {"left": (-force, 0.0, 0.0, 0.0, 0.0, 0.0), "right": (force, 0.0, 0.0, 0.0, 0.0, 0.0)}


def least(scenario: cp.Scenario) -> float:
    """Squeeze m g / (2 mu) at which two patches bear the weight, N."""
    mu = scenario.cell.patches["left"].mu
    return scenario.cell.payload.mass * 9.81 / (2.0 * mu)


@pytest.mark.parametrize("name", CELLS)
def test_a_view_shows_the_friction_that_the_result_has(name):
    scenario, seen = CELLS[name](duration=0.05), []
    used = cp.run(scenario, view=seen.append, realtime_rate=np.inf, warn=False).friction_use().used
    scene, samples = LiveScene(initial_scene(scenario)), snapshot_samples(seen[-1], scenario.cell)
    assert len(scene.frame(seen[-1])) == len(scene.frame(seen[0]))
    shown = [curve.values(samples) for curve in scene.curves if curve.plot == "friction"]
    assert_allclose(np.concatenate(shown), 100.0 * np.minimum(used[-1], 2.0))


@pytest.mark.parametrize("name", CELLS)
def test_a_run_starts_at_rest_with_the_squeeze_on_and_the_load_as_tip_forces(name):
    scenario = CELLS[name]().override({"actuators.gravity_compensation": None})
    simulation = Simulation(scenario, build_controller(scenario))
    plant, cell = simulation.plant, scenario.cell
    plant.drive(simulation.actuation.holding_commands(plant.q))
    state, h = plant.state(), 1e-6
    plant.advance(0.0, h)
    assert np.abs(plant.v - state.v).max() < 1e-8 * h
    plant.restore(state)
    wrenches = plant.interaction_wrenches()
    assert_allclose(wrenches.sum(axis=0), weight_wrench(cell.payload.mass, cell.gravity), rtol=0, atol=1e-8)
    state = plant.chain.patches.at(plant.q, plant.v)
    pressed = abs(scenario.squeeze_wrenches[0, 0])
    assert_allclose(state.wrench[:, 2], pressed, rtol=1e-9)
    assert_allclose(state.wrench[:, 3:], 0.0, atol=5e-3)  # no moment on a patch but that of its depth


@pytest.mark.parametrize("name", CELLS)
def test_the_first_torque_holds_the_cell(name):
    scenario = CELLS[name](duration=0.01)
    data = cp.run(scenario, warn=False).data
    still = 1e-5 * np.abs(data.torque.values[0]).max()
    assert np.nanmax(np.abs(data.joint_velocity.values)) < 1e-3
    assert_allclose(data.torque.values[1], data.torque.values[0], atol=max(still, 1e-2))


def test_loads_of_the_linkage_are_what_its_split_leaves():
    rng = np.random.default_rng(1)
    for m in (2, 3, 4):
        tips, F = rng.normal(size=(m, 3)), rng.normal(size=(m, 6))
        L = linkage_loads(tips)
        assert_allclose(L.sum(axis=0), np.eye(6), atol=1e-12)
        assert_allclose(F - L @ F.sum(axis=0), virtual_linkage_internal_wrenches(F, tips), atol=1e-12)


def test_a_crate_is_carried_by_friction_alone():
    line = {"kind": "line", "start_time": 0.05, "duration": 0.4, "start": {"xyz": (0.0, 0.0, 0.5)}}
    line["goal"] = {"xyz": (0.002, 0.004, 0.504), "rpy": (0.0, 0.0, 0.006)}
    result = cp.run(palms(duration=0.5, motion=line), warn=False)
    data = result.data
    assert np.linalg.norm(data.pose_error.values[:, :3], axis=1).max() < 2e-3
    assert float(data.patch_slip.max()) < 1e-9
    assert (data.patch_points.values == 9.0).all()
    assert_allclose(data.patch_wrench.values[:, :, 2], 60.0, atol=0.5)
    assert result.friction_use().used.max() < 0.5
    exchanged = float(np.abs(np.diff(data.work_actuation.values)).sum())
    assert np.abs(energy_balance(data)).max() < 1e-3 * exchanged
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()


@pytest.mark.parametrize(
    ("name", "mu"),
    [
        ("planar", 0.5),
        pytest.param("planar", 0.8, marks=pytest.mark.gate),
        pytest.param("spatial", 0.5, marks=pytest.mark.slow),
        ("spatial", 0.8),
    ],
)
def test_patches_slip_at_the_least_squeeze(name, mu):
    scenario = CELLS[name](mu)
    force = least(scenario)
    ramp = {"kind": "ramp", "start": squeeze(1.02 * force), "goal": squeeze(0.98 * force), "start_time": 0.05}
    ramp["duration"] = 0.04 * force / 3.5  # at most 6.6 N/s
    result = cp.run(scenario.override({"squeeze": ramp, "duration": ramp["duration"] + 0.1}), warn=False)
    data = result.data
    F = data.patch_wrench.values
    N, f = F[..., 2].mean(axis=1), np.linalg.norm(F[..., :2], axis=-1).mean(axis=1)
    at_limit = f > 0.9999 * mu * N
    assert at_limit.any()
    assert_allclose(N[at_limit.argmax()], force, rtol=5e-3)
    assert N.min() > 0.0
    used = result.friction_use().used
    assert_allclose(used[at_limit.argmax()], 1.0, rtol=1e-2)
    assert np.isnan(result.dropped_at)
    assert "slides" in result.verdict()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "offset", "at_tips"),
    [
        ("planar", 4e-3, True),
        ("spatial", 6e-3, True),
        ("spatial", 12e-3, True),
        ("planar", 4e-3, False),
        ("spatial", 6e-3, False),
        ("spatial", 12e-3, False),
    ],
)
def test_patches_slip_where_the_margin_is_zero_whatever_twists_or_tilts_them(name, offset, at_tips):
    """Palms beside P: pressed in their middles the load twists them, pressed in line with P they lean."""
    grasps = CELLS[name]().cell.grasps
    moved = {f"cell.grasps.{arm}.xyz": (grasp.xyz[0], offset, 0.0) for arm, grasp in grasps.items()}
    moved |= {f"cell.grasps.{arm}.radius": 0.01 if name == "planar" else 0.03 for arm in grasps}
    lever = offset if at_tips else 0.0

    def pressed(force: float) -> dict[str, tuple[float, ...]]:
        sides = {"left": 1.0, "right": -1.0}
        return {arm: (-s * force, 0.0, 0.0, 0.0, 0.0, s * lever * force) for arm, s in sides.items()}

    scenario = CELLS[name](**moved)
    at_least = scenario.override({"squeeze": pressed(least(scenario))})
    found = least_squeeze(at_least)
    assert not found.by_moment
    ramp = {"kind": "ramp", "start": pressed(1.05 * found.force), "goal": pressed(0.83 * found.force)}
    ramp |= {"start_time": 0.05, "duration": 0.22 * found.force / 6.0}
    result = cp.run(scenario.override({"squeeze": ramp, "duration": ramp["duration"] + 0.1}), warn=False)
    data, use = result.data, result.friction_use()
    N, slip = data.patch_wrench.values[..., 2].mean(axis=1), data.patch_slip.values.max(axis=1)
    slides = (slip > 1e-3).argmax()
    begins = (use.used[:slides].max(axis=1) < 0.99).nonzero()[0][-1]
    print(name, offset, at_tips, N[begins] / found.force, slip[begins], use.used[slides])
    assert_allclose(N[begins] / found.force, 1.0, atol=5e-2)  # palms that lean twist against each other
    assert slip[begins] < 5e-4
    assert_allclose(use.used[slides].max(), 1.0, atol=1e-2)


@pytest.mark.parametrize("name", [pytest.param("planar", marks=pytest.mark.slow), "spatial"])
def test_a_squeeze_that_is_too_small_drops_the_payload_and_the_arms_stay(name):
    scenario = CELLS[name](duration=0.4, **{"trust.energy_share": 1e-2})
    scenario = scenario.override({"squeeze": squeeze(0.7 * least(scenario))})
    result = cp.run(scenario, warn=False)
    data = result.data
    fallen = (data.payload_position.values[-1] - data.payload_position.values[0]) @ scenario.cell.gravity
    assert fallen / 9.81 > 0.3
    assert (result.simulation_sound, result.task.state) == (True, "dropped"), result.verdict()
    assert 0.05 < result.dropped_at < 0.2
    assert result.metrics()["dropped_at_s"] == result.dropped_at
    assert f"drops at {result.dropped_at:.3g} s" in result.verdict()
    assert all(f"of {arm!r} slides from" in result.verdict() for arm in scenario.cell.arms)
    assert f"drops at {result.dropped_at:.3g} s" in telling_instant(result).text
    findings = quick_findings(Simulation(scenario, build_controller(scenario)))
    assert any(finding.kind == "friction" for finding in findings.of("error"))
    assert float(data.patch_points[-1].sum()) == 0.0
    assert float(data.patch_slip[-1].max()) < 0.05
    assert np.nanmax(np.abs(data.joint_velocity.values)) < 1.0
    assert np.abs(energy_balance(data)).max() < 5e-2
    with pytest.raises(DivergedError) as caught, errors_with_results(lambda: result, lambda: 0.4):
        raise DivergedError(0.4, "joint speed, rad/s,", 1020.0, 1000.0)
    fallen, advice = f"drops at {result.dropped_at:.3g} s", "actuators.gravity_compensation"
    assert str(caught.value).index(fallen) < str(caught.value).index(advice)


@pytest.mark.parametrize("name", CELLS)
def test_the_normal_force_of_its_own_wrist_tells_an_arm_of_a_loss(name):
    """At the start the wrist reads the squeeze; the guard watches where twice its force is desired."""
    scenario = CELLS[name](**{"controller.normal_guard": 5.0, "sensors.wrist": {}})
    simulation = Simulation(scenario, build_controller(scenario))
    inputs, law = simulation.observe(), simulation.controller
    for arm, seen, reference in zip(law.controllers, inputs.measurements, inputs.references, strict=True):
        controller = law.controllers[arm]
        controller = getattr(controller, "law", controller)
        pressed = abs(scenario.squeeze_wrenches[0, 0])
        guard = controller.guard
        F, rows = seen.interaction_wrench, scenario.cell.task_rows
        normal = rows.turn(reference.pose, rows.select(np.append(controller.arm.way_out, np.zeros(3))))
        f_r = rows.turn(reference.pose, reference.internal_wrench)
        assert_allclose((normal @ F, normal @ f_r), pressed, rtol=1e-3)
        lost = seen._replace(interaction_wrench=4.0 / pressed * F)
        assert guard.grips(seen, reference, f_r) == 1.0
        assert guard.grips(lost, reference, f_r) == 0.0
        assert guard.grips(lost, reference, 9.0 / pressed * f_r) == 1.0  # too little is desired
        assert guard.grips(lost._replace(interaction_wrench=None), reference, f_r) == 1.0
        assert guard.grips(seen._replace(slip=0.02), reference, f_r) == 0.0


@pytest.mark.parametrize(
    ("guard", "speed"),
    [
        ({"controller.slip_guard": 1.0, "controller.normal_guard": 5.0, "sensors.wrist": {}}, 1.0),
        pytest.param({"sensors.slip": {"noise": 5e-4, "delay": 20}}, 0.3, marks=pytest.mark.slow),
    ],
    ids=["normal force", "noisy slip"],
)
@pytest.mark.gate
def test_guards_keep_arms_slow_after_a_loss_whose_anchor_has_no_bound(guard, speed):
    """13.7 rad/s without any."""
    scenario = palms(duration=0.4, **{"controller.anchor_bias": "none"} | guard)
    result = cp.run(scenario.override({"squeeze": squeeze(0.7 * least(scenario))}), warn=False)
    assert np.isfinite(result.dropped_at)
    assert np.nanmax(np.abs(result.data.joint_velocity.values)) < speed


def test_slip_is_noisy_and_late_and_that_of_arms_that_hold():
    sensors = {"sensors.slip": {"noise": 1e-3, "delay": 3}, "arm_sensors": {"left": {}}}
    scenario = palms(duration=1.0, **sensors)
    slip, noise = SlipSensors.of(scenario), SensorSignals(scenario, [7, 7]).draw(400).slip_noise
    assert not noise[:, 0].any()
    assert slip.delay.tolist() == [0, 3]
    memory, both, read = slip.start(), np.ones(2, dtype=bool), []
    for tick in range(400):
        one, memory = slip.step(memory, np.array((0.0, 1.0)) * tick, noise[tick], both)
        read.append(one)
    assert read[:3] == [0.0, 0.0, 0.0]
    errors = np.array(read[3:]) - np.arange(397)
    assert_allclose(errors[1:], noise[1:397, 1], rtol=0, atol=1e-12)
    assert_allclose((errors.mean(), errors.std()), (0.0, 1e-3), atol=1.5e-4)
    assert slip.step(memory, np.array((7.0, 9.0)), noise[0], both & False)[0] == 0.0
    assert slip.step(memory, np.array((7.0, 9.0)), noise[0], np.array((True, False)))[0] == 7.0
    source = SensorSignals(scenario, [7, 7])
    source.draw(5)
    assert_array_equal(source.draw(1).slip_noise, noise[5:6])
    with pytest.raises(CoopPinError, match="delay"):
        palms(duration=0.001, **{"sensors.slip": {"delay": 2}})


def on_table(top: float, start: float, goal: float, **changes) -> cp.Scenario:
    """A crate above or on a table, which is lifted or put down in 1 s."""
    table = {"xyz": (0.0, 0.0, top), "size": (1.0, 0.8), "mu": 0.4, "stiffness": 2e5, "shear_stiffness": 2e5}
    line = {"kind": "line", "start_time": 0.1, "duration": 1.0}
    line |= {"start": {"xyz": (0.0, 0.0, start)}, "goal": {"xyz": (0.0, 0.0, goal)}}
    pose = {"cell.tables": {"bench": table}, "motion": line, "start": {"xyz": (0.0, 0.0, start)}}
    return cp.Scenario.load("two-pandas-palms", pose | changes)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [2.0, 3.0])
def test_an_unknown_weight_is_picked_up_from_a_table(mass):
    box = {"kind": "box", "mass": mass, "size": (0.4, 0.3, 0.2)}
    result = cp.run(on_table(0.4, 0.5, 0.55, **{"cell.payload": box, "duration": 2.5}), warn=False)
    data = result.data
    table = data.patch_wrench.sel(patch="bench", axis="z").values
    assert_allclose(table[0], mass * 9.81, rtol=1e-6)  # it lies, and the arms only squeeze
    assert (table[data.time.values > 0.6] == 0.0).all()
    assert table.min() == 0.0
    error = np.linalg.norm(data.pose_error.values[:, :3], axis=1)
    assert error.max() < 1e-2  # the integral takes the weight over
    assert error[-1] < 2e-3
    assert float(data.patch_slip.sel(patch=["left", "right"]).max()) < 1e-5
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()


@pytest.mark.slow
def test_a_table_that_is_higher_than_planned_is_pressed_by_the_integral():
    data = cp.run(on_table(0.402, 0.53, 0.5, duration=2.1), warn=False).data
    force = data.patch_wrench.sel(patch="bench", axis="z").values
    late = data.time.values > 1.6
    rate = np.polyfit(data.time.values[late], force[late], 1)[0]
    assert_allclose(rate, 600.0 * 2.5 * 5.0 * 1.5e-3, rtol=0.15)  # K gamma k_I of the error that arms see
    assert float(data.patch_slip.max()) < 1e-5


def test_a_restored_run_goes_on_with_the_same_bits():
    scenario = palms(duration=0.06, **{"sensors.slip": {"noise": 1e-3, "delay": 2}})
    simulation = Simulation(scenario, build_controller(scenario))
    for _ in range(50):
        simulation.tick()
    state = simulation.state()
    results = []
    for _ in range(2):
        while not simulation.is_finished:
            simulation.tick()
        results.append(simulation.result().data.patch_wrench.values.copy())
        simulation.restore(state)
    assert_array_equal(*results)


def test_batches_refuse_patches_in_words():
    """With the names of the contacts, and what the traced plant has."""
    refused = support(palms()) or ""
    assert "['left', 'right'] have friction" in refused
    assert "springs and rigid grasps" in refused


def scaled(scenario: cp.Scenario, factor: float) -> cp.Scenario:
    """The scenario with K times a factor."""
    K = factor * np.array(scenario.controller.gains.sliding_gain)
    return scenario.override({"controller.gains.sliding_gain": tuple(K.tolist())})


def stability(scenario: cp.Scenario):
    return grasp_stability(Simulation(scenario, build_controller(scenario)))


@pytest.mark.parametrize(
    ("name", "edge"), [("planar", 1.2227), pytest.param("spatial", 1.5609, marks=pytest.mark.slow)]
)
@pytest.mark.gate
def test_gains_on_patches_are_unstable_where_the_check_says_so(name, edge):
    """The edge of K by the linear loop; runs from rest decay below it, and grow above it as it says."""
    scenario = CELLS[name](duration=0.4)
    assert stability(scaled(scenario, 0.999 * edge)).ok
    grows = stability(scaled(scenario, 1.001 * edge))
    assert not grows.ok
    assert "patches that stick" in grows.summary()
    speeds = {}
    for part in (0.92, 1.08):
        data = cp.run(scaled(scenario, part * edge), warn=False).data
        speeds[part] = np.nanmax(np.abs(data.joint_velocity.values), axis=(1, 2))
    assert speeds[0.92][-20:].max() < 1.5e-3
    assert speeds[1.08][-20:].max() > 1e2 * speeds[0.92][-20:].max()
    if name == "planar":  # far from any limit: the rate of growth, too
        late = slice(60, 100)
        rate = np.exp(np.polyfit(np.arange(40), np.log(speeds[1.08][late]), 1)[0])
        assert_allclose(rate, stability(scaled(scenario, 1.08 * edge)).radius, rtol=5e-3)


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_stiffness_of_patches_that_stick_is_the_slope_of_their_forces(name):
    scenario = CELLS[name]()
    plant = Simulation(scenario, build_controller(scenario)).plant
    elements, q, still = plant.chain.elements, plant.q, np.zeros(len(plant.v))
    model = plant.chain.mechanism.model

    def force(q, v):
        elements.act(q, v)
        return elements.force(q)

    K, D = plant.chain.patches.matrices(q)
    h = 1e-7
    moved = [
        [force(pin.integrate(model, q, sign * h * row), still) for sign in (1.0, -1.0)]
        for row in np.eye(len(still))
    ]
    slope = np.array([(a - b) / (2.0 * h) for a, b in moved]).T
    damping = np.array([force(q, h * row) - force(q, -h * row) for row in np.eye(len(still))])
    scale = np.abs(K).max()
    assert_allclose(-slope, K, rtol=0, atol=2e-3 * scale)  # the prestress of the squeeze is not in K
    assert_allclose(-damping.T / (2.0 * h), D, rtol=0, atol=1e-6 * np.abs(D).max())


def lifted(name: str) -> cp.Scenario:
    """A cell whose payload moves a bit, with a squeeze of 1.1 times the least and no gains of its own."""
    scenario = CELLS[name](duration=0.6)
    goal = scenario.start.replace(xyz=tuple(np.add(scenario.start.xyz, (2e-3, 4e-3, 0.0))))
    line = {"kind": "line", "start_time": 0.05, "duration": 0.4, "start": scenario.start, "goal": goal}
    return scenario.override({"motion": line, "squeeze": squeeze(1.1 * least(scenario)), "sensors.wrist": {}})


def suggested(name: str) -> Suggestion:
    draft = lifted(name)
    path = draft.controller.force_path.replace(split="shares")
    return cp.suggest(draft.replace(controller=draft.controller.replace(force_path=path)), poses=5)


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_suggest_states_squeeze_split_and_guards_for_patches(name):
    found = suggested(name)
    law, margin = found.scenario.controller, least_squeeze(found.scenario)
    assert_allclose(margin.use, 1.0 / 1.5, rtol=2e-2)
    assert law.force_path.split == "virtual-linkage"
    assert law.zero_at_grasp
    assert_allclose(law.normal_guard, margin.stated / 4.0, rtol=2e-2)
    assert law.slip_guard == min(1e-2, found.scenario.cell.patches["left"].radius / 2.0)
    text = found.summary()
    for words in ("squeeze RAISED", "split of the load: virtual-linkage", "guards:", "least squeeze"):
        assert words in text
    assert stability(found.scenario).ok


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
def test_a_suggested_law_carries_by_friction(name):
    result = cp.run(suggested(name).scenario, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert not result.friction_text
    assert np.linalg.norm(result.data.pose_error.values[:, :3], axis=1).max() < 5e-5
    assert result.friction_use().used.max() < 0.75
