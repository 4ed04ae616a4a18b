"""End stops: one-sided springs with dampers in every engine, their energy, their steps, the verdict."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from cells import SCENARIOS
from linked_cells import lid_with_a_stop
from numpy.testing import assert_allclose, assert_array_equal
from stops import JOINTS, ahead, index, limited

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.base.errors import CoopPinError, FieldError
from coop_pin.compiled import BatchSimulator
from coop_pin.compiled.plant.compiled_plant import CompiledPlant
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.model.joint_stops import JointStops
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.mujoco_plant import MujocoPlant
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import step_stability

STIFFNESS = {"planar": 3000.0, "spatial": 1e4}
GAP = 0.02


class Driving(cp.ArmController):
    """Holds the cell, and drives the joint of the left arm that has a stop ahead of it."""

    def __init__(self, scenario, arm, torque, joint):
        self.added = torque * np.eye(scenario.cell.arms[arm].drive_matrix(joint[1]).shape[0])[joint[0]]
        self.added = self.added if arm == "left" else 0.0 * self.added

    def init(self, measurement, reference):
        return measurement.holding_torque

    def step(self, measurement, reference, state):
        return cp.ArmCommand(state + self.added, state)


def driven(name: str, folder: Path, torque: float, **stops) -> cp.Scenario:
    """A short run that drives a joint into its stop."""
    joints = {"planar": 3, "spatial": 6}[name]
    options = {"torque": torque, "joint": (index(name), joints)}
    scenario = ahead(name, folder, GAP, stiffness=STIFFNESS[name], **stops)
    law = {"kind": "user", "target": Driving, "options": options}
    return scenario.override({"controller": law, "duration": 0.3, "clock.steps_per_tick": 8})


class Hit:
    """A plant whose joint runs into its stop, and the books of it."""

    def __init__(self, scenario: cp.Scenario, name: str, speed: float, made=PinocchioPlant) -> None:
        self.chain = chain = CellChain(scenario.cell)
        q = chain.configuration(scenario.start.matrix)
        self.plant: Plant = made(chain, PlantOptions(), q)
        place, stops = next((place, stops) for place, stops in chain.stops)
        first = 0 if place is chain.model.linked else index(name)
        self.j, rest = place.v_slice.start + first, np.zeros(chain.mechanism.model.nv)
        self.entry, self.upper = place.q_slice.start + first, stops.upper[first]
        v = chain.mechanism.project_velocity(q, np.eye(len(rest))[self.j])
        self.plant.restore(self.plant.state()._replace(v=v * speed / v[self.j]))
        torque = chain.mechanism.inverse_dynamics(q, rest, rest).torque
        self.plant.drive([slot.from_drive.T @ torque[slot.v_slice] for slot in chain.model.arms])
        self.mobility = chain.joint_mobility(q)[self.j]
        self.rate = chain.stops.rates(chain.joint_mobility(q))[self.j]

    def energy(self) -> float:
        """Energy less all work: constant but for what the steps leave."""
        plant, chain = self.plant, self.chain
        stored = sum(part.state(plant.q, plant.v).energy for part in (chain.stops, chain.joints) if part)
        return chain.energy(plant.q, plant.v) + stored - float(plant.work.sum())

    def over(self, h: float, time: float) -> tuple[float, float, list[float]]:
        """What is unexplained after a time, J, what the damper lost, J, and the depths, rad."""
        before, depths, self.stored = self.energy(), [], [0.0]
        for k in range(round(time / h)):
            self.plant.advance(k * h, h)
            depths.append(float(self.plant.q[self.entry] - self.upper))
            self.stored.append(self.chain.stops.state(self.plant.q, self.plant.v).energy)
        lost = self.plant.work[self.plant.works.index("work_stops")]
        return self.energy() - before, -float(lost), depths


# ------------------------------------------------------------ the law


def test_a_stop_pushes_back_and_never_pulls():
    stops = JointStops(np.full(4, -1.0), np.full(4, 1.0), np.full(4, 100.0), np.full(4, 3.0))
    cases = [(0.5, 9.0, 0.0), (1.1, 0.0, -10.0), (1.1, 2.0, -16.0), (1.1, -2.0, -4.0), (1.1, -4.0, 0.0)]
    for q, v, force in cases:
        for sign in (1.0, -1.0):
            state = stops.state(np.full(4, sign * q), np.full(4, sign * v))
            assert_allclose(state.force, np.full(4, sign * force), atol=1e-12)
            assert state.power <= 1e-12
            depth = max(q - 1.0, 0.0)
            assert_allclose(state.energy, 4 * 50.0 * depth**2, atol=1e-12)
            assert_allclose(state.power, 4 * (force + 100.0 * depth) * v, atol=1e-12)


def test_the_stop_of_a_joint_that_grasps_hold_still_has_a_finite_damping():
    """Of which rounding leaves a mobility around zero."""
    stops = JointStops(*np.full((4, 3), (-1.0, -1.0, -1.0)), 0.5)._replace(stiffness=np.full(3, 100.0))
    damping = stops.damped(np.array((0.01, 0.0, -1e-18))).damping
    assert_allclose(damping[0], np.sqrt(100.0 / 0.01))
    assert np.isfinite(damping).all()


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_default_stiffness_gives_way_by_give_under_the_largest_force(name):
    stated = {"planar": (50.0, 40.0, 20.0), "spatial": (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)}[name]
    arm = SCENARIOS[name]().cell.arms["left"].replace(torque_limits=stated)
    stops = JointStops.of_arm(arm.replace(stops={"give": 0.02}), "left")
    T = arm.drive_matrix(len(stated))
    largest = [abs(T.T @ np.array(s) * 1.0) for s in itertools.product(*((-x, x) for x in stated))]
    assert_allclose(stops.stiffness, np.max(largest, axis=0) / 0.02)
    with pytest.raises(FieldError, match="stiffness"):
        JointStops.of_arm(arm.replace(stops={}, torque_limits="none"), "left")
    assert JointStops.of_arm(arm, "left") is None
    for wrong in ({"stiffness": -1.0}, {"stiffness": (1.0, 2.0)}, {"give": 0.0}, {"damping_ratio": -0.1}):
        with pytest.raises(CoopPinError):
            JointStops.of_arm(arm.replace(posture=(0.0,) * len(stated), stops=wrong), "left")
    continuous = cp.Scenario.load("kinova-pair").cell.arms["left"]
    turns = JointStops.of_arm(continuous.replace(stops={"stiffness": 100.0}), "left")
    assert {*turns.stiffness.tolist()} == {0.0, 100.0}


# ------------------------------------------------------------ energy


def flap(name: str) -> cp.Scenario:
    """A cell whose payload has a flap with its default stop a gap ahead of where it hangs."""
    cell = {"planar": "adept-anchored", "spatial": "two-pandas-box"}[name]
    scenario = lid_with_a_stop(cell, 2.0)
    chain = CellChain(scenario.cell)
    angle = chain.joints.positions(chain.configuration(scenario.start.matrix))[0]
    return lid_with_a_stop(cell, angle + GAP)


@pytest.mark.parametrize("what", ["alone", "closed chain", "payload"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_hit_is_explained_to_0_2_percent_and_sixteen_times_better_at_a_quarter_of_the_step(
    name, what, tmp_path
):
    """Over phases of contact in a step: steps straddle the contact, which makes the error quadratic."""
    if what == "payload":
        hit, errors = Hit(flap(name), name, 1.0), list[list[float]]()
    else:
        arm = ahead(name, tmp_path, GAP, what == "alone", stiffness=STIFFNESS[name])
        hit, errors = Hit(arm, name, 1.0), []
    start = hit.plant.state()
    limit = 0.08 if what == "payload" else 0.12
    for part in (limit, limit / 4.0):
        unexplained, h = [], part / hit.rate
        for phase in np.arange(8) / 8.0:
            hit.plant.restore(start)
            hit.plant.advance(0.0, (0.01 + phase) * h)
            left, lost, depths = hit.over(h, GAP + 6.0 / hit.rate)
            assert max(depths) > 0.2 / hit.rate
            assert lost > 0.0
            unexplained.append(left / (lost + np.abs(np.diff(hit.stored)).sum()))  # as the verdict has it
        errors.append(unexplained)
    coarse, fine = (np.sqrt(np.mean(np.square(each))) for each in errors)
    assert np.abs(errors[0]).max() < 2e-3
    assert 8.0 < coarse / fine < 80.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_joint_feels_the_closed_chain_on_its_stop(name, tmp_path):
    """Without damping it stays in the stop for half a period of sqrt(k W), deep by v / sqrt(k W)."""
    scenario = ahead(name, tmp_path, 1e-4, stiffness=400.0 * STIFFNESS[name], damping_ratio=0.0)
    hit = Hit(scenario, name, 0.5)
    q = hit.plant.q
    _, singular, rows = np.linalg.svd([hit.chain.mechanism.project_velocity(q, e) for e in np.eye(len(q))])
    free, M = rows[singular > 1e-9], _mass(hit.chain, q)
    W = (free.T @ np.linalg.solve(free @ M @ free.T, free))[hit.j, hit.j]
    assert_allclose(hit.mobility, W, rtol=1e-9)
    alone = np.linalg.inv(M)[hit.j, hit.j]
    assert 0.95 * alone > W
    h = 0.02 / hit.rate
    _, lost, depths = hit.over(h, 1e-4 / 0.5 + 5.0 / hit.rate)
    assert_allclose(max(depths), 0.5 / hit.rate, rtol=0.02)
    assert_allclose(h * sum(d > 0.0 for d in depths), math.pi / hit.rate, rtol=0.03)
    assert abs(lost) < 1e-9


def _mass(chain: CellChain, q: Array) -> Array:
    import pinocchio as pin

    model = chain.model.model
    M = pin.crba(model, model.createData(), q)
    return np.triu(M) + np.triu(M, 1).T


# ------------------------------------------------------------ engines


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_all_engines_hit_alike(name, tmp_path):
    scenario = ahead(name, tmp_path, GAP, stiffness=STIFFNESS[name])
    hits = [Hit(scenario, name, 1.0, made) for made in (PinocchioPlant, CompiledPlant, MujocoPlant)]
    h = 0.05 / hits[0].rate
    (_, lost, depths), compiled, mujoco = (hit.over(h, GAP + 4.0 / hits[0].rate) for hit in hits)
    assert lost > 1e-3
    assert_allclose(compiled[1], lost, rtol=1e-8)
    assert_allclose(compiled[2], depths, rtol=0, atol=1e-9)
    assert_allclose(mujoco[1], lost, rtol=1e-3)
    assert_allclose(mujoco[2], depths, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_a_run_names_the_stop_that_was_hit_and_is_sound(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    joints = {"planar": 30.0, "spatial": 60.0}
    result = cp.run(driven(name, tmp_path, joints[name]), engine="pinocchio", warn=False)
    data = result.data
    force = data["stop_force"].sel(arm="left").values[:, index(name)]
    depth = data["joint_position"].sel(arm="left").values[:, index(name)]
    upper = float(data["position_upper"].sel(arm="left")[index(name)])
    assert (force <= 0.0).all()
    assert force.min() < -1.0
    assert_array_equal(force < 0.0, (force < 0.0) & (depth > upper))
    assert np.isnan(data["stop_force"].sel(arm="right").values).all()
    assert data["stop_energy"].values.max() > 0.0
    assert data["work_stops"].values[-1] < 0.0
    assert result.metrics()["simulation_sound"] == 1.0
    hits = [each for each in result.task.deviations if each.cause == "end stop"]
    assert [(each.arm, each.joint) for each in hits] == [("left", JOINTS[name])]
    assert_allclose(hits[0].value, -force.min())
    assert result.task.state == "off"
    without = result.scenario.override({"cell.arms.left.stops": None})
    through = cp.run(without, engine="pinocchio", warn=False)
    assert through.metrics()["simulation_sound"] == 0.0
    assert "stop_force" not in through.data


def test_a_batch_has_the_samples_of_single_runs(tmp_path):
    scenario = ahead("planar", tmp_path, 1e-3, stiffness=300.0)
    scenario = scenario.override({"duration": 0.2, "clock.steps_per_tick": 4})
    pair = [scenario, scenario.override({"cell.arms.left.stops.stiffness": 900.0})]
    batch = BatchSimulator().run(pair)
    for lane, single in enumerate(cp.run(one, engine="pinocchio", warn=False) for one in pair):
        for key in ("stop_force", "stop_energy", "work_stops"):
            assert_allclose(batch.samples[key][lane], single.data[key].values, rtol=0, atol=1e-8)
        assert batch.metrics()[lane]["task_kept"] == single.metrics()["task_kept"]
        assert batch.metrics()[lane]["simulation_sound"] == single.metrics()["simulation_sound"]
    assert np.nanmax(np.abs(batch.samples["stop_force"])) > 0.1


# ------------------------------------------------------------ what is known before


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_step_finding_knows_the_stops_and_its_remedy_works(name, tmp_path):
    scenario = ahead(name, tmp_path, GAP, stiffness=50.0 * STIFFNESS[name])
    scenario = scenario.override({"clock.steps_per_tick": 1})

    def steps(scenario: cp.Scenario):
        return step_stability(Simulation(scenario, build_controller(scenario)))

    finding = steps(scenario)
    assert finding.cause == "end stops"
    assert not finding.ok
    chain = CellChain(scenario.cell)
    W = chain.joint_mobility(chain.configuration(scenario.start.matrix))[: len(chain.model.arms[0].drive)]
    h = scenario.clock.period
    assert_allclose(finding.value, h * np.sqrt(50.0 * STIFFNESS[name] * W.max()), rtol=1e-9)
    needed = math.ceil(finding.value / finding.limit)
    assert f"from 1 to {needed}" in finding.summary()
    assert steps(scenario.override({"clock.steps_per_tick": needed})).ok
    strong = scenario.override({"cell.arms.left.stops.damping_ratio": 1.0})
    assert_allclose(steps(strong).limit, 0.5 * finding.limit)


def test_limited_changes_one_joint_only(tmp_path):
    arm = SCENARIOS["spatial"]().cell.arms["left"]
    other = limited(tmp_path, arm, "elbow_joint", 2.0)
    assert other.moving_joints() == arm.moving_joints()
