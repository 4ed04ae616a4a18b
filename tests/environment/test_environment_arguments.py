"""Environments of Gymnasium: types of spaces, registered name, render mode, and hostile arguments."""

import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from tiers import by_default

from coop_pin.base.errors import (
    ArgumentError,
    CoopPinError,
    InvalidStateError,
    NameNotFoundError,
    NotEnoughMemoryError,
    OutOfRangeError,
    WrongTypeError,
)

pytest.importorskip("gymnasium")

import gymnasium

from coop_pin.environment.cell_env import CellEnv
from coop_pin.environment.task import Task
from coop_pin.environment.vector_cell_env import VectorCellEnv

NAME = "coop_pin.environment:coop_pin/Cell-v0"  # which needs no other import


def cell(name):
    scenario = SCENARIOS[name]().replace(events=(), controller=ANCHORED[name])
    changes = {"sensors.encoder": {"noise": 1e-5}, "duration": 14 * scenario.clock.period}
    return scenario.override(changes)


@pytest.fixture(scope="module")
def planar():
    return cell("planar")


@pytest.fixture(scope="module")
def lanes(planar):
    return VectorCellEnv(planar, num_envs=2, render_mode="ansi")


@pytest.mark.parametrize("name", SCENARIOS)
def test_spaces_are_of_float32_and_the_run_is_not(name):
    """Of float64 on request; the observations then differ by rounding only, the rewards not at all."""
    scenario = cell(name)
    coarse, fine = (CellEnv(scenario, Task(dtype=dtype)) for dtype in ("float32", "float64"))
    assert (coarse.action_space.dtype, coarse.observation_space.dtype) == (np.float32, np.float32)
    assert fine.observation_space.dtype == np.float64
    action = np.full(coarse.action_space.shape, 0.5, np.float32)
    seen, exact = [], []
    for env, each in ((coarse, seen), (fine, exact)):
        each.append(env.reset(seed=3)[0])
        observation, reward, *_ = env.step(action)
        each += [observation, reward]
    assert seen[0].dtype == seen[1].dtype == np.float32
    np.testing.assert_array_equal(seen[1], exact[1].astype(np.float32))
    assert seen[2] == exact[2]


@pytest.mark.parametrize("name", SCENARIOS)
def test_gymnasium_makes_it_by_its_registered_name(name):
    scenario, task = cell(name), Task(scale=5.0, ticks=2)
    made, direct = gymnasium.make(NAME, scenario=scenario, task=task), CellEnv(scenario, task)
    first, _ = made.reset(seed=3)
    assert isinstance(made.unwrapped, CellEnv)
    assert np.array_equal(first, direct.reset(seed=3)[0])
    action = np.ones(made.action_space.shape, np.float32)
    assert np.array_equal(made.step(action)[0], direct.step(action)[0])


def test_gymnasium_makes_lanes_by_the_registered_name(planar):
    made = gymnasium.make_vec(NAME, num_envs=1, scenarios=planar)
    assert isinstance(made, VectorCellEnv)
    assert made.num_envs == 1
    assert made.reset(seed=3)[0].dtype == made.observation_space.dtype == np.float32


@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_a_line_of_text_says_how_large_the_errors_are(name):
    """Before any motion: errors of the payload's pose as the sample of the first tick has them."""
    scenario = cell(name)
    env = CellEnv(scenario, render_mode="ansi")
    env.reset(seed=3)
    sample = env.simulation.recorder.sample()
    run = env.simulation.result()
    position = 1e3 * np.linalg.norm((sample["payload_pose"] - sample["desired_pose"])[0, :3, 3])
    turn = 1e3 * np.linalg.norm(run.data.pose_error.values[0, 3:])
    text = env.render()
    assert text.startswith("t = 0.0000 s")
    assert f"{position:.3f} mm" in text
    assert f"{turn:.3f} mrad" in text
    lines = VectorCellEnv(scenario, num_envs=2, render_mode="ansi")
    lines.reset(seed=3)
    assert lines.render()[0] == text
    assert CellEnv(scenario).render() is None


def test_the_last_action_ends_with_the_run(planar, lanes):
    """After the tick of the reset there are 14: three actions of four ticks, and one of two."""
    env = CellEnv(planar, render_mode="ansi")
    for each in (env, lanes):
        each.reset(seed=3)
        action, ends = np.zeros(each.action_space.shape), []
        while not np.any(ends):
            ends.append(each.step(action)[3])
        assert len(ends) == 4
        assert np.all(ends[-1])
        assert str(each.render()).strip("(')").startswith(f"t = {14 * planar.clock.period:.4f} s")
        with pytest.raises(InvalidStateError):
            each.step(action)
    assert env.simulation.ticks_done == env.simulation.timeline.ticks + 1


def test_the_line_of_text_has_the_time_of_the_last_tick_after_an_action(planar, lanes):
    """An action of the default task takes four ticks after that of the reset."""
    env, T = CellEnv(planar, render_mode="ansi"), planar.clock.period
    for each in (env, lanes):
        each.reset(seed=3)
        each.step(np.zeros(each.action_space.shape))
    assert env.render().startswith(f"t = {4 * T:.4f} s")
    assert [line.partition(":")[0] for line in lanes.render()] == [f"t = {4 * T:.4f} s"] * 2


def test_the_line_of_text_has_the_sizes_of_errors_in_an_observation():
    """Of five drives with angles and rates, pose and twist errors, and two arms with internal wrenches."""
    law = SimpleNamespace(commands=[np.zeros(3), np.zeros(2)])
    pose = (3e-3, 4e-3, 12e-3, 2e-3, 3e-3, 6e-3)  # 13 mm and 7 mrad
    wrenches = (1.0, 2.0, 2.0, 50.0, 50.0, 50.0, 2.0, 3.0, 6.0, 50.0, 50.0, 50.0)  # 3 N and 7 N
    observation = np.concatenate((np.full(10, 9.0), pose, np.full(6, 9.0), wrenches))
    text = Task().text(observation, law, 0.25)
    numbers = [float(number) for number in re.findall(r"\d+\.\d+", text)]
    assert numbers == [0.25, 13.0, 7.0, 7.0]


def test_a_task_is_on_the_squeeze_by_default():
    """One newton, paid by newtons and millimetres, every four ticks."""
    rewards = {"internal_axial_error_N": 1.0, "position_error_m": 1000.0}
    fields = {"scale": 1.0, "rewards": rewards, "ticks": 4, "law": True, "failure": 1000.0, "gains": ()}
    assert Task() == Task(action="squeeze", dtype="float32", **fields)


def test_unknown_render_modes_are_refused_by_name(planar):
    for mode in ("human", "rgb_array", 3):
        for kind in (CellEnv, VectorCellEnv):
            with pytest.raises(NameNotFoundError) as caught:
                kind(planar, render_mode=mode)
            assert caught.value.known == ("ansi",)


def wrong_actions(shape):
    good = np.zeros(shape)
    masked = np.ma.masked_array(good, mask=True)
    return [None, "x", {}, 0.0, good[..., :-1], good[None], good + 1j, np.full(shape, "1"), masked]


@pytest.mark.parametrize(
    "task", [Task(), Task("torque"), Task("gains", scale=0.5, gains=("anchor_gain", "sliding_gain"))]
)
def test_wrong_actions_are_refused_and_move_nothing(planar, task):
    env = CellEnv(planar, task)
    good = np.zeros(env.action_space.shape)
    with pytest.raises(InvalidStateError):
        env.step(good)
    env.reset(seed=3)
    for action in wrong_actions(env.action_space.shape):
        with pytest.raises(ArgumentError):
            env.step(action)
    for value in (np.nan, np.inf):
        action = good.copy()
        action[1] = value
        with pytest.raises(OutOfRangeError) as caught:
            env.step(action)
        assert (caught.value.name, caught.value.index) == ("action", (1,))
    other = CellEnv(planar, task)
    other.reset(seed=3)
    assert np.array_equal(env.step(good)[0], other.step(good)[0])


def test_wrong_actions_of_lanes_are_told_with_the_lane(lanes):
    good = np.zeros(lanes.action_space.shape)
    first, _ = lanes.reset(seed=3)
    for action in wrong_actions(good.shape):
        with pytest.raises(ArgumentError):
            lanes.step(action)
    action = good.copy()
    action[1, 2] = np.nan
    with pytest.raises(OutOfRangeError, match="lane 1") as caught:
        lanes.step(action)
    assert caught.value.index == (2,)
    for second in ([0.0], "x", None):
        with pytest.raises(ArgumentError, match="lane 1"):
            lanes.step([[0.0] * good.shape[1], second])
    after = lanes.step(good)[0]
    assert np.array_equal(lanes.reset(seed=3)[0], first)
    assert np.array_equal(lanes.step(good)[0], after)


def test_wrong_seeds_are_refused(planar, lanes):
    env = CellEnv(planar)
    for seed in (1.5, -1, "x", True, 2**70, np.nan, 1j, {}, [1, [2, 3]], [True, 1], np.array(3.0)):
        for each in (env, lanes):
            with pytest.raises(CoopPinError):
                each.reset(seed=seed)
    for each in (env, lanes):
        drawn = each.reset(seed=np.int64(3))[0]
        assert np.array_equal(drawn, each.reset(seed=3)[0])


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (WrongTypeError, {"law": "no"}),
        (WrongTypeError, {"law": 1}),
        (WrongTypeError, {"ticks": True}),
        (ArgumentError, {"scale": "1"}),
        (ArgumentError, {"scale": 1j}),
        (NameNotFoundError, {"action": None}),
        (NameNotFoundError, {"dtype": "float16"}),
        (ArgumentError, {"rewards": {"position_error_m": "1"}}),
        (WrongTypeError, {"rewards": ["position_error_m"]}),
        (NameNotFoundError, {"rewards": {3: 1.0}}),
        (WrongTypeError, {"gains": "anchor_gain", "action": "gains", "scale": 0.5}),
        (WrongTypeError, {"gains": None}),
        (ArgumentError, {"gains": ("anchor_gain", "anchor_gain"), "action": "gains", "scale": 0.5}),
    ],
)
def test_wrong_tasks_are_refused(kind, wrong):
    with pytest.raises(kind):
        Task(**wrong)


def test_wrong_arguments_are_refused(planar):
    for scenario, task in ((None, None), (3, None), ("x", None), (planar, 0), (planar, "x")):
        for kind in (CellEnv, VectorCellEnv):
            with pytest.raises(WrongTypeError):
                kind(scenario, task)
    for number in (10**8, 10**30, 10**400):
        with pytest.raises(NotEnoughMemoryError):
            VectorCellEnv(planar, num_envs=number)
    with pytest.raises(NameNotFoundError):
        CellEnv(planar, Task("gains", scale=0.5, gains=(3,)))


def of_processes():
    return gymnasium.make(NAME, scenario=cell("planar"), task=Task(scale=5.0))


@pytest.mark.slow
def test_stable_baselines_trains_on_it():
    """Its checker has no warning; PPO with its vectorised wrappers, in this process and in two others."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common import env_checker, vec_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env_checker.check_env(CellEnv(cell("planar")))
    for kind in (vec_env.DummyVecEnv, vec_env.SubprocVecEnv):
        env = vec_env.VecNormalize(vec_env.VecCheckNan(vec_env.VecMonitor(kind([of_processes] * 2))))
        model = PPO("MlpPolicy", env, n_steps=32, batch_size=32, n_epochs=2, seed=3, device="cpu")
        model.learn(128)
        assert model.num_timesteps == 128
        assert np.isfinite(model.predict(env.reset())[0]).all()
        env.close()
