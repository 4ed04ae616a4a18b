"""Environments of Gymnasium: its own checks, lanes against single runs, refusals."""

import time
import warnings
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.errors import (
    ArgumentError,
    CoopPinError,
    InvalidStateError,
    NameNotFoundError,
    TracingError,
)
from coop_pin.compiled import BatchSimulator
from coop_pin.control import CellCommand
from coop_pin.simulation.build_controller import build_controller

pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env

from coop_pin.environment.acted_law import ActedLaw
from coop_pin.environment.cell_env import CellEnv
from coop_pin.environment.task import EpisodeSeeds, Task
from coop_pin.environment.vector_cell_env import VectorCellEnv

EXACT = {"dtype": "float64"}
TASKS = {
    "squeeze": Task("squeeze", scale=5.0, ticks=2, **EXACT),
    "torque": Task("torque", scale=2.0, **EXACT),
    "torque alone": Task("torque", scale=2.0, law=False, rewards={"orientation_error_rad": 1.0}, **EXACT),
    "velocity": Task("velocity", scale=0.02, **EXACT),
    "velocity alone": Task("velocity", scale=0.02, law=False, **EXACT),
}
SLOW = {"planar": ["torque", "velocity alone"], "spatial": [*TASKS][1:]}
"""Tasks whose code is compiled in the slow tier only."""
GAINS = Task("gains", scale=0.5, gains=("sliding_gain", "anchor_gain"))


def cell(name, changes=None):
    scenario = SCENARIOS[name]().replace(events=(), controller=ANCHORED[name])
    duration = 16 * scenario.clock.period
    return scenario.replace(duration=duration).override(changes or {})


SERVOS = {
    "clock.rate_hz": 200.0,
    "clock.steps_per_tick": 5,
    "controller": cp.laws.Admittance(command="velocity"),
    "actuators.servo": {"command": "velocity", "rate_hz": 1000.0},
}


def with_noise(name, action=""):
    """A cell with noise, for velocities with a law and servos that take them."""
    return cell(name, {"sensors.encoder": {"noise": 1e-5}} | (SERVOS if action == "velocity" else {}))


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("task", [*TASKS.values(), GAINS], ids=[*TASKS, "gains"])
def test_gymnasium_finds_nothing_wrong(name, task):
    check(with_noise(name, task.action), task)


@pytest.mark.parametrize("arms", [2, 3])
@pytest.mark.parametrize("lead", [(), (4,)])
def test_an_action_on_the_squeeze_loads_the_payload_nowhere(arms, lead):
    """Each arm but the last presses as the agent says, within the scale; the last takes the sum."""
    law = SimpleNamespace(squeeze=np.zeros((arms, 3)), commands=[np.zeros(3)] * arms)
    action = np.random.default_rng(2).normal(size=(*lead, (arms - 1) * 3))
    squeeze, commands = TASKS["squeeze"].additions(action, law)
    expected = 5.0 * np.clip(action, -1.0, 1.0).reshape(*lead, arms - 1, 3)
    np.testing.assert_array_equal(squeeze[..., : arms - 1, :], expected)
    np.testing.assert_allclose(squeeze.sum(axis=-2), 0.0, atol=1e-14)
    assert not any(command.any() for command in commands)


class Reference(NamedTuple):
    """The part of a reference that an action changes."""

    internal_wrench: np.ndarray


class Told(cp.CellController):
    """Commands 1, 2, ... to the drives of each arm and keeps the internal wrenches that it is to make."""

    def __init__(self):
        self.desired = []

    def init(self, measurements, references):
        self.messages(measurements, references, None)
        return "begun"

    def step(self, measurements, references, state):
        self.messages(measurements, references, state)
        return CellCommand([1.0 + np.arange(2.0), 1.0 + np.arange(3.0)], state + "!")

    def messages(self, measurements, references, state):
        self.desired.append([each.internal_wrench.tolist() for each in references])
        return ["said"]


def test_an_acted_law_adds_to_what_the_law_is_told_and_to_what_it_commands():
    squeeze, added = np.array(((2.0, 0.0, -1.0), (-2.0, 0.0, 1.0))), [np.array((0.5, -0.5)), np.full(3, 0.25)]
    references = [Reference(np.array((10.0, 5.0, 0.1))), Reference(np.array((-10.0, -5.0, -0.1)))]
    told = Told()
    law = ActedLaw(squeeze, added, told)
    state = law.init([], references)
    command = law.step([], references, state)
    assert (command.state, law.messages([], references, state)) == ("begun!", ["said"])
    assert told.desired == [[[12.0, 5.0, -0.9], [-12.0, -5.0, 0.9]]] * 3
    assert [torques.tolist() for torques in command.torques] == [[1.5, 1.5], [1.25, 2.25, 3.25]]


@pytest.mark.parametrize(("kind", "field"), [("torque", "torques"), ("velocity", "velocities")])
def test_without_a_law_torques_are_added_to_those_that_hold_the_start_and_velocities_to_rest(kind, field):
    law = ActedLaw(np.zeros((2, 3)), [np.array((0.5, -0.5)), np.full(3, 0.25)], None, kind)
    measured = [SimpleNamespace(holding_torque=np.array((7.0, 8.0))), SimpleNamespace(holding_torque=None)]
    state = law.init(measured, [])
    command = law.step(measured, [], state)
    held = [[7.5, 7.5], [0.25] * 3] if kind == "torque" else [[0.5, -0.5], [0.25] * 3]
    assert [values.tolist() for values in getattr(command, field)] == held
    assert command.state is state
    assert law.messages(measured, [], state) == []
    assert law.command_kind == kind


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_action_on_torques_is_in_the_record(name):
    """Without the law the drives get what holds the start, and ``scale`` times the action."""
    env = CellEnv(cell(name), Task("torque", scale=2.0, law=False, ticks=3, **EXACT))
    env.reset()
    action = np.linspace(-0.9, 0.9, env.action_space.shape[0])
    env.step(action)
    data = env.simulation.result().data
    commanded = [values[np.isfinite(values)] for values in data.commanded_torque.values]
    assert len(commanded) == 4
    for values in commanded[1:]:
        np.testing.assert_allclose(values, commanded[0] + 2.0 * action, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_action_on_the_squeeze_is_a_run_with_another_squeeze(name):
    """From the second tick on, in payload axes; the first presses by ``scale`` times the action."""
    scenario, task = cell(name), Task("squeeze", scale=5.0, ticks=3, **EXACT)
    env, run = CellEnv(scenario, task), cp.Simulation(scenario, build_controller(scenario))
    env.reset()
    run.tick()
    rows = list(scenario.cell.task_rows.indices)
    action = np.linspace(0.2, 0.8, len(rows))
    added = np.zeros((2, 6))
    added[:, rows] = np.outer((5.0, -5.0), action)
    now = scenario.squeeze.at(0.0, scenario.cell.grasps)
    arms = dict(zip(scenario.cell.arms, (now + added).tolist(), strict=True))
    run.replace_squeeze(cp.squeezes.ConstantSqueeze(wrenches=arms))
    env.step(action)
    for _ in range(3):
        run.tick()
    np.testing.assert_allclose(env.simulation.plant.q, run.plant.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(env.simulation.plant.v, run.plant.v, rtol=0, atol=1e-10)


def check(scenario, task):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*infinity", category=UserWarning)
        check_env(CellEnv(scenario, task), skip_render_check=True)


@pytest.mark.parametrize(
    "name", ["adept-compliant", "two-pandas-palms", "three-ur5-handover", "human-partner"]
)
def test_gymnasium_finds_nothing_wrong_with_force_elements(name):
    """Compliant grasps, patches, a partner who comes and goes; without an action it is the run."""
    scenario = cp.Scenario.load(name)
    T = scenario.clock.period
    partner = [
        event.replace(time=4 * T, duration=3 * T) for event in scenario.events if name == "human-partner"
    ]
    scenario = scenario.replace(events=(), duration=16 * T).override({"events": partner})
    scenario = scenario.override({"sensors.encoder": {"noise": 1e-5}})
    check(scenario, TASKS["squeeze"])
    env, run, is_last = (
        CellEnv(scenario, TASKS["squeeze"]),
        cp.Simulation(scenario, build_controller(scenario)),
        False,
    )
    env.reset()
    run.tick()
    while not is_last:
        is_last = env.step(np.zeros(env.action_space.shape))[3]
        while run.ticks_done < env.simulation.ticks_done:
            run.tick()
        assert np.array_equal(env.simulation.plant.q, run.plant.q)


@pytest.mark.parametrize(
    ("name", "task"),
    [
        pytest.param(name, task, marks=[pytest.mark.slow] * (task in SLOW[name]))
        for name in SCENARIOS
        for task in TASKS
    ],
)
def test_lanes_are_single_runs(name, task):
    compare_lanes(with_noise(name, TASKS[task].action), TASKS[task])


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_arms_of_lanes_talk_to_each_other(name):
    """By a network that is late, loses messages and carries noise, in a single environment and in lanes."""
    network = {"delay": 1, "jitter": 1, "loss": 0.2}
    sensors = {"encoder": {"noise": 1e-5}, "wrist": {"noise": {"force": 0.1}}}
    talking = cell(
        name, {"controller.force_path": {"kind": "consensus"}, "sensors": sensors, "network": network}
    )
    check(talking, TASKS["squeeze"])
    compare_lanes(talking, TASKS["squeeze"])


@pytest.mark.parametrize(
    "name", ["adept-compliant", pytest.param("three-ur5-handover", marks=pytest.mark.slow)]
)
def test_lanes_on_compliant_grasps_are_single_runs(name):
    scenario = cp.Scenario.load(name).replace(events=(), beyond_bound=True)
    changes = {"sensors.encoder": {"noise": 1e-5}, "duration": 16 * scenario.clock.period}
    compare_lanes(scenario.override(changes), TASKS["squeeze"])


def compare_lanes(scenario, task):
    """Two lanes, of which one has another payload, against their single environments."""
    scenarios = [scenario, scenario.override({"cell.payload.mass": 2.2})]
    lanes = VectorCellEnv(scenarios, task)
    actions = np.random.default_rng(1).uniform(-1.2, 1.2, (20, 2, lanes.single_action_space.shape[0]))
    seen = [lanes.reset(seed=[5, 6])[0]]
    rewards = []
    for action in actions:
        observation, reward, terminated, truncated, _ = lanes.step(action)
        seen.append(observation)
        rewards.append(reward)
        if truncated.any():
            break
    assert truncated.all()
    assert not terminated.any()
    for lane, scenario in enumerate(scenarios):
        env = CellEnv(scenario, task)
        np.testing.assert_allclose(env.reset(seed=5 + lane)[0], seen[0][lane], rtol=0, atol=1e-9)
        for index, action in enumerate(actions[: len(rewards), lane]):
            observation, reward, _, is_last, _ = env.step(action)
            np.testing.assert_allclose(observation, seen[index + 1][lane], rtol=0, atol=1e-9)
            np.testing.assert_allclose(reward, rewards[index][lane], rtol=0, atol=1e-8)
        assert is_last


@pytest.mark.parametrize("name", SCENARIOS)
def test_without_an_action_it_is_the_run_of_the_scenario(name):
    scenario, task = cell(name), Task(rewards={"internal_axial_error_N": 1.0}, ticks=1)
    env, result = CellEnv(scenario, task), cp.simulate(scenario, build_controller(scenario))
    env.reset()
    rewards = [env.step(np.zeros(env.action_space.shape))[1] for _ in range(len(result.data.time) - 1)]
    expected = -np.abs(result.data.internal_axial_error.values).max(axis=1)[1:]
    np.testing.assert_allclose(rewards, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_observations_and_rewards_are_those_of_the_record(name):
    """Joints now; errors of pose, twist and internal wrenches, turned into payload axes, of the last tick."""
    scenario = cell(name, {"sensors.encoder": {"noise": 1e-4}})
    weights = {"position_error_m": 2.0, "orientation_error_rad": 3.0, "internal_shear_error_N": 5.0}
    env = CellEnv(scenario, Task(rewards=weights, ticks=1, **EXACT))
    record = cp.simulate(scenario, build_controller(scenario)).data
    seen, rewards, is_last = [env.reset()[0]], [], False
    while not is_last:
        observation, reward, _, is_last, _ = env.step(np.zeros(env.action_space.shape))
        seen.append(observation)
        rewards.append(reward)
    R_WP = Rotation.from_quat(record.payload_quaternion.values)
    assert np.abs(R_WP[-1].as_rotvec()).max() > 0.1
    error = np.nan_to_num(record.internal_wrench - record.desired_internal_wrench)
    turned = [
        R_WP.inv().apply(part.reshape(-1, 3)[arm :: error.shape[1]])
        for arm in range(error.shape[1])
        for part in (error[..., :3], error[..., 3:])
    ]
    pose = record.pose_error.values
    expected = np.hstack((pose, record.payload_twist - record.desired_twist, *turned))
    count = expected.shape[1]
    np.testing.assert_allclose(np.array(seen)[:, -count:], expected, rtol=0, atol=1e-9)
    joints = np.array(seen)[:-1, :-count].reshape(len(seen) - 1, 2, -1)
    for now, field in zip(np.swapaxes(joints, 0, 1), ("joint_position", "joint_velocity"), strict=True):
        np.testing.assert_allclose(now, record[field].values[1:].reshape(len(now), -1), rtol=0, atol=1e-12)
    sizes = np.linalg.norm(pose[:, :3], axis=1), np.linalg.norm(pose[:, 3:], axis=1)
    sizes = (*sizes, np.abs(record.internal_shear_error.values).max(axis=1))
    costs = sum(weight * size for weight, size in zip(weights.values(), sizes, strict=True))
    np.testing.assert_allclose(rewards, -costs[1:], rtol=1e-12)


def test_one_lane_is_the_default_and_is_a_single_run():
    scenario, task = cell("planar"), Task(ticks=2, **EXACT)
    lanes, env = VectorCellEnv(scenario, task), CellEnv(scenario, task)
    assert lanes.num_envs == 1
    action = np.full(env.action_space.shape, 0.3)
    pairs = [(lanes.reset()[0], env.reset()[0]), (lanes.step(action[None])[0], env.step(action)[0])]
    for many, one in pairs:
        np.testing.assert_allclose(many, one[None], rtol=0, atol=1e-9)
        assert lanes.observation_space.contains(many)
        assert lanes.single_observation_space.contains(many[0])


def test_seeds_of_episodes_are_drawn_from_62_bits():
    seeds = EpisodeSeeds(3)
    drawn = [seeds.following() for _ in range(200)]
    assert drawn[0] == 3
    assert len(set(drawn)) == 200
    assert min(drawn) < 2**61 < max(drawn) < 2**62


@pytest.mark.parametrize("name", SCENARIOS)
def test_actions_on_gains_are_laws_with_other_gains(name):
    """Against a run whose controller is replaced by one with the gains times 1 + a / 2."""
    scenario = cell(name)
    task = GAINS
    env, run = CellEnv(scenario, task), cp.Simulation(scenario, build_controller(scenario))
    env.reset()
    run.tick()
    own = scenario.controller.gains
    for action in ((0.6, -1.0), (-0.4, 0.2)):
        env.step(np.array(action))
        factors = 1.0 + 0.5 * np.array(action)
        gains = {
            "controller.gains.sliding_gain": (factors[0] * np.array(own.sliding_gain)).tolist(),
            "controller.gains.anchor_gain": factors[1] * own.anchor_gain,
        }
        run.replace_controller(build_controller(scenario.override(gains)))
        for _ in range(task.ticks):
            run.tick()
        assert np.array_equal(env.simulation.plant.q, run.plant.q)
    with pytest.raises(NameNotFoundError):
        CellEnv(scenario, Task("gains", scale=0.5, gains=("damping_gain",)))
    with pytest.raises(CoopPinError, match="CellEnv"):
        VectorCellEnv(scenario, task)


@pytest.mark.parametrize("name", SCENARIOS)
def test_actions_on_gains_are_cut_to_one(name):
    scenario = cell(name)
    sliding, anchor = scenario.controller.gains.sliding_gain, scenario.controller.gains.anchor_gain
    gains = GAINS.retuned(scenario, np.array((3.0, -2.0))).controller.gains
    np.testing.assert_allclose(gains.sliding_gain, 1.5 * np.array(sliding), rtol=1e-12)
    assert gains.anchor_gain == pytest.approx(0.5 * anchor)


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_action_takes_a_gain_beyond_the_bound_of_the_law(name):
    """A force gain is below 1 on a path that is one tick late; 0.8 times 1.5 is not."""
    scenario = cell(name, {"controller.gains.force_gain": 0.8})
    with pytest.raises(CoopPinError, match="beyond_bound"):
        scenario.override({"controller.gains.force_gain": 1.2})
    env = CellEnv(scenario, Task("gains", scale=0.5, gains=("force_gain",)))
    env.reset()
    assert not env.step(np.ones(1))[2]


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_the_seed_alone_draws_the_numbers(name):
    lanes = VectorCellEnv(with_noise(name).replace(seed=1), TASKS["torque"], num_envs=3)
    action = np.zeros(lanes.action_space.shape)

    def observed(seed):
        lanes.reset(seed=seed)
        lanes.step(action)
        return lanes.step(action)[0]

    first = observed(3)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(observed(9), first)
    assert np.array_equal(observed(3), first)
    assert np.array_equal(observed(4)[0], first[1])


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_episodes_without_a_seed_go_on_with_the_generator_alike_in_a_cell_and_in_lanes(name):
    """As trainers rely on: a seed once, then resets without one."""
    scenario, task = with_noise(name), TASKS["torque"]

    def episodes(env, *seeds):
        return [observed(env, seed) for seed in seeds]

    def observed(env, seed):
        env.reset(seed=seed)
        env.step(np.zeros(env.action_space.shape))
        return env.step(np.zeros(env.action_space.shape))[0]

    lanes = VectorCellEnv(scenario, task, num_envs=3)
    drawn = episodes(lanes, 7, None, None)
    assert len({part.tobytes() for episode in drawn for part in episode}) == 9
    np.testing.assert_array_equal(episodes(lanes, 7, None, None), drawn)
    np.testing.assert_array_equal(
        episodes(VectorCellEnv(scenario, task, num_envs=3), np.int64(7), None, None), drawn
    )
    np.testing.assert_array_equal(episodes(lanes, np.array([7, 8, 9]), None, None), drawn)
    for lane in range(3):
        alone = episodes(CellEnv(scenario, task), 7 + lane, None, None)
        np.testing.assert_allclose(alone, np.stack(drawn)[:, lane], rtol=0, atol=1e-9)
    first, second = (episodes(CellEnv(scenario, task), None, None) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(*first)
    np.testing.assert_array_equal(first[0], episodes(CellEnv(scenario, task), scenario.seed)[0])
    for wrong in (-1, 1.5, "one", [1, 2], [1, 2, "three"]):
        with pytest.raises(CoopPinError):
            lanes.reset(seed=wrong)
        with pytest.raises(CoopPinError):
            CellEnv(scenario, task).reset(seed=wrong)


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_a_lane_that_diverges_ends_alone(name):
    task = Task("torque", scale=1e9, law=False, failure=7.0)
    lanes, env = VectorCellEnv(cell(name), task, num_envs=2), CellEnv(cell(name), task)
    lanes.reset()
    env.reset()
    action = np.zeros(lanes.action_space.shape)
    action[1, 0] = 1.0
    _, reward, terminated, _, _ = lanes.step(action)
    assert terminated.tolist() == [False, True]
    assert reward[1] == -7.0
    assert env.step(action[1])[1:3] == (-7.0, True)
    observation, reward, terminated, _, _ = lanes.step(0.0 * action)
    assert terminated.tolist() == [False, True]
    assert reward[1] == 0.0
    assert not observation[1].any()
    assert np.isfinite(observation).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box"])
def test_a_thousand_lanes_make_half_of_the_ticks_of_a_batch(name):
    """Processor time in turn, of 1024 payloads and one tick an action; the batch is prepared and compiled."""
    scenario = cp.Scenario.load(name).replace(events=())
    ticks, task = 100, Task(ticks=1)
    scenario = scenario.replace(duration=ticks * scenario.clock.period)
    mass = scenario.cell.payload.mass
    cells = [scenario.override({"cell.payload.mass": mass * (1.0 + 1e-4 * lane)}) for lane in range(1024)]
    lanes, simulator = VectorCellEnv(cells, task), BatchSimulator()
    runs, action = [simulator.prepare(cell) for cell in cells], np.zeros(lanes.action_space.shape)
    simulator.run_prepared(runs)
    ratios = []
    for _ in range(3):
        lanes.reset()
        began = time.process_time()
        for _ in range(ticks):
            lanes.step(action)
        between = time.process_time()
        simulator.run_prepared(runs)
        ratios.append((time.process_time() - between) / (between - began))
    print(f"{name}: {np.median(ratios):.2f} of the ticks of a batch {np.round(ratios, 2)}")
    assert np.median(ratios) > 0.5


def test_what_does_not_fit_is_refused():
    scenario = cell("planar")
    for wrong in ({"rewards": {"speed": 1.0}}, {"action": "jump"}):
        with pytest.raises(NameNotFoundError):
            Task(**wrong)
    no_gains, large = {"action": "gains"}, {"action": "gains", "gains": ("pose_gain",), "scale": 1.0}
    of_others = {"gains": ("pose_gain",)}
    for wrong in (
        {"scale": -1.0},
        {"ticks": 0},
        {"action": "squeeze", "law": False},
        no_gains,
        large,
        of_others,
    ):
        with pytest.raises(CoopPinError):
            Task(**wrong)
    with pytest.raises(ArgumentError, match="velocity"):
        CellEnv(scenario, Task("velocity"))
    with pytest.raises(ArgumentError):
        VectorCellEnv([scenario, scenario], num_envs=3)
    with pytest.raises(CoopPinError):
        VectorCellEnv(scenario.override({"controller": {"kind": "computed-torque"}}))
    lanes = VectorCellEnv(scenario, num_envs=2)
    with pytest.raises(InvalidStateError):
        lanes.step(np.zeros(lanes.action_space.shape))
    with pytest.raises(ArgumentError):
        lanes.reset(seed=[1])


@pytest.mark.parametrize("name", SCENARIOS)
def test_episodes_of_a_law_that_remembers_are_equal_and_lanes_refuse_it(name):
    scenario = cell(name, {"controller": {"kind": "user", "target": "stateful_laws:History"}})
    env, episodes = CellEnv(scenario, Task("torque")), []
    for _ in range(2):
        observations = [env.reset(seed=0)[0]]
        for _ in range(3):
            observations.append(env.step(np.zeros(env.action_space.shape))[0])
        episodes.append(observations)
    assert np.array_equal(*episodes)
    with pytest.raises(TracingError, match="'past'"):
        VectorCellEnv(scenario, Task("torque"))
