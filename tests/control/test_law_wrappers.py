"""Wrappers of laws: internal wrenches by PI average consensus, and less a load that arms learn."""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from batches import require_same_samples
from cells import SCENARIOS
from network_cells import BIASED, CELLS, Silent, arriving, network_of, samples
from numpy.testing import assert_allclose
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import FieldError, ScenarioError
from coop_pin.base.spatial import make_pose, task_rows
from coop_pin.compiled import support
from coop_pin.control import (
    ArmMeasurement,
    AveragedWrench,
    ConsensusPose,
    ControlledArm,
    estimator_radius,
)
from coop_pin.control.consensus import graph_eigenvalues
from coop_pin.control.force_paths.averaged_wrench import (
    AveragedState,
    ConsensusForcePath,
    averaged_loop_radius,
)
from coop_pin.control.law_wrapper import WrappedState
from coop_pin.description.network import edges_of
from coop_pin.simulation.build_controller import build_controller

REFERENCE = cp.ArmReference(np.eye(4), np.zeros(6), np.zeros(6), np.zeros(6))
GAINS = ConsensusForcePath()


def arms_on_a_ring(count, law_of):
    """Laws, constant measurements and eigenvalues of the graph, of arms on a ring."""
    names, rng = [f"arm {index}" for index in range(count)], np.random.default_rng(count)
    edges = list(edges_of("ring", names))
    seen = [
        ArmMeasurement(
            0.0, None, None, make_pose(rng.normal(size=3)), rng.normal(size=6), None, None, None
        )._replace(interaction_wrench=rng.normal(scale=30.0, size=6), interaction_wrench_age=0.0)
        for _ in names
    ]
    arms = [
        ControlledArm(
            name,
            False,
            task_rows("full"),
            0.01,
            1.0 / count,
            6,
            None,
            np.array([0.0, 0.0, -9.81]),
            np.eye(4),
            0,
        )
        for name in names
    ]
    return [law_of(arm) for arm in arms], seen, edges, names


def states_of(laws, seen, edges, names, states, ticks, *, delay=0, lost=0, loss=0.0):
    """Yield the states of laws over ticks; messages are lost in the first so many of them."""
    edges = [*edges, *((name, name) for name in names)]
    network = network_of(names, edges, delay)
    rng, memory = np.random.default_rng(1), None
    for tick in range(ticks):
        said = [
            law.message(one, REFERENCE, state) for law, one, state in zip(laws, seen, states, strict=True)
        ]
        arrived = (rng.random(len(edges)) >= loss * (tick < lost)) | np.array([a == b for a, b in edges])
        arrived &= tick >= delay
        memory = network.start(said) if memory is None else memory
        mail, memory = network.step(memory, said, arriving(arrived, delay))
        states = [
            law.step(one._replace(messages=each.received), REFERENCE, state).state
            for law, one, each, state in zip(laws, seen, mail, states, strict=True)
        ]
        yield states


def mean_errors(laws, seen, edges, names, ticks, seed=3, **network):
    """Largest error of the arms' means of the wrenches after each tick, from random states."""
    rng, mean = np.random.default_rng(seed), np.mean([one.interaction_wrench for one in seen], axis=0)
    states = [WrappedState(AveragedState(*rng.normal(scale=30.0, size=(2, 6)), 0.0), None) for _ in names]
    every = states_of(laws, seen, edges, names, states, ticks, **network)
    return np.array([max(np.abs(state.memory.mean - mean).max() for state in states) for states in every])


@pytest.mark.parametrize("arms", [3, 8])
def test_pi_consensus_converges_at_its_rate_from_any_state(arms):
    """The property of Freeman, Yang and Lynch: no error of constants, from any state of the estimators."""
    laws, *ring = arms_on_a_ring(arms, lambda arm: AveragedWrench(Silent(), arm, GAINS, arms))
    errors = mean_errors(laws, *ring, 600)
    radius = estimator_radius(graph_eigenvalues(*ring[1:]), GAINS)
    tail = errors[(errors > 1e-9) & (np.arange(600) > 60)]
    assert_allclose((tail[-1] / tail[0]) ** (1.0 / (len(tail) - 1)), radius, rtol=0.005)
    assert errors[-1] < 1e-9
    assert_allclose(radius, {3: 0.8, 8: 0.954}[arms], atol=1e-3)


@pytest.mark.parametrize("delay", [0, 2])
def test_pi_consensus_is_stable_where_its_modes_are(delay):
    eigenvalues = graph_eigenvalues(*arms_on_a_ring(4, lambda arm: arm)[2:])
    low, high = 0.0, 2.0
    for _ in range(40):
        k = (low + high) / 2.0
        path = GAINS.replace(proportional_gain=k, integral_gain=0.4 * k)
        low, high = (k, high) if estimator_radius(eigenvalues, path, delay) < 1.0 else (low, k)
    for part, decays in ((0.97, True), (1.03, False)):
        path = GAINS.replace(proportional_gain=part * low, integral_gain=part * 0.4 * low)
        laws, *ring = arms_on_a_ring(4, lambda arm, path=path: AveragedWrench(Silent(), arm, path, 4))
        errors = mean_errors(laws, *ring, 500, delay=delay)
        assert (errors[-50:].max() < 0.3 * errors[:50].max()) == decays
        assert (errors[-50:].max() > 3.0 * errors[:50].max()) != decays


def test_lost_messages_leave_nothing_behind_in_pi_consensus_but_an_error_in_that_of_first_order():
    laws, *ring = arms_on_a_ring(5, lambda arm: AveragedWrench(Silent(), arm, GAINS, 5))
    assert mean_errors(laws, *ring, 300, lost=100, loss=0.2)[-1] < 1e-9
    seen, edges, names = ring
    laws = [ConsensusPose(Silent(), name, 0.2) for name in names]
    said = np.array([law.message(one, REFERENCE, None) for law, one in zip(laws, seen, strict=True)])
    states = [WrappedState(np.zeros(12), None) for _ in names]
    *_, states = states_of(laws, seen, edges, names, states, 300, lost=100, loss=0.2)
    x = np.array([view - state.memory for view, state in zip(said, states, strict=True)])
    assert np.abs(x - x.mean(axis=0)).max() < 1e-9
    assert np.abs(x.mean(axis=0) - said.mean(axis=0)).max() > 0.01


# ---------------------------------------------------------------- three unequal arms in a line


def in_a_line(cell, path, **fields):
    """Unequal arms of which the first and the last of three do not hear each other, the first 1 mm off."""
    of, name = CELLS[cell]
    base, law = of(name)
    arms = list(base.cell.arms)
    graph = [edge for one, other in pairwise(arms) for edge in ([one, other], [other, one])]
    goal = base.start.replace(xyz=np.add(base.start.xyz, (0.12, -0.09, 0.0)))
    return base.override(
        {
            "controller": law.model_dump() | {"force_path": path},
            "sensors.wrist": {},
            "network": {"graph": graph},
            "duration": 2.0,
            BIASED.format(arms[0]): [1e-3, 0.0, 0.0],
            "motion": cp.motions.LineMotion(start=base.start, goal=goal, duration=1.0),
            **fields,
        }
    )


def finished(scenario):
    run = cp.Simulation(scenario, build_controller(scenario))
    while not run.is_finished:
        run.tick()
    return run


REPOSITORY = Path(__file__).resolve().parents[2]
THREE = ["three planar", "three spatial"]


def errors_of(scenario):
    """Largest error of the internal wrench, on task rows of all arms, in each eighth of a run."""
    data, rows = samples(scenario), list(scenario.cell.task_rows.indices)
    error = (data.internal_wrench - data.desired_internal_wrench).values[:, :, rows]
    return [np.abs(part).max() for part in np.array_split(error, 8)]


@pytest.mark.parametrize(
    ("cell", "duration"),
    [("three planar", 4.0), pytest.param("three spatial", 1.6, marks=pytest.mark.slow)],
)
def test_over_a_line_the_anchor_leaves_what_wrenches_of_all_leave(cell, duration):
    by_all, by_mean = (
        errors_of(in_a_line(cell, {"kind": kind}, duration=duration)) for kind in ("late", "consensus")
    )
    assert_allclose(by_mean[-1], by_all[-1], rtol=5e-3)
    assert_allclose(by_mean, by_all, rtol=0.2)
    assert by_all[-1] < 0.1 * max(by_all)


@pytest.mark.parametrize("cell", by_default(THREE, "three planar"))
def test_arms_in_a_line_learn_the_regression_of_the_resultant_wrench(cell):
    """One arm alone would believe anything; all come to what the sum of their wrenches says."""
    scenario = in_a_line(cell, {"kind": "learned-load"})
    run = finished(scenario)
    data, linear = run.result().data, [row for row in scenario.cell.task_rows.indices if row < 3]
    gained = np.diff(data.payload_twist.values[:, linear], axis=0) / scenario.clock.period
    phi = np.array(scenario.cell.gravity)[linear] - gained
    F = data.interaction_wrench.values[1:, :, linear].sum(axis=1)
    memories = [state.memory for state in run.controller_state]
    learned = [memory.belief - memory.correction for memory in memories]
    masses = [mean / precision for mean, precision in learned]
    assert_allclose(masses, (phi * F).sum() / (phi * phi).sum(), rtol=0.005)
    assert_allclose(masses, scenario.cell.payload.mass, rtol=0.005)
    assert_allclose([one for _, one in learned], 0.01 + (phi * phi).sum(), rtol=0.01)  # the prior's, and news
    alone = [memory.belief[0] / memory.belief[1] for memory in memories]
    assert np.abs(np.subtract(alone, scenario.cell.payload.mass)).max() > 2.0
    if cell == "three spatial":
        page = REPOSITORY.joinpath("docs", "concepts", "messages.md").read_text(encoding="utf-8")
        shown = re.search(
            r"learn ([\d.]+) to ([\d.]+) of 6 kg .* find ([\d.]+) to ([\d.]+) kg", page
        ).groups()
        ends = (min(masses), max(masses), min(alone), max(alone))
        assert [f"{end:.{len(text) - 2}f}" for end, text in zip(ends, shown, strict=True)] == list(shown)
    assert "kg" in build_controller(scenario).remarks(np.eye(4), run.controller_state)[0]


@pytest.mark.parametrize("delay", [0, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("cell", ["three planar", pytest.param("three spatial", marks=pytest.mark.slow)])
def test_the_anchor_on_means_has_its_own_bound(cell, delay):
    """Equal shares, a late wrist: runs at 0.97 and 1.03 of the gain at which the loop's modes grow."""
    even = {"beyond_bound": True, "duration": 2.0}
    scenario = in_a_line(cell, {"kind": "consensus", "proportional_gain": 0.15, "integral_gain": 0.1}, **even)
    arms = list(scenario.cell.arms)
    even = {"cell.load_shares": dict.fromkeys(arms, 1.0 / 3.0), "controller.anchor_bias": "none"}
    scenario = scenario.override({"network.delay": delay, "sensors.wrist.delay": 1} | even)
    eigenvalues = graph_eigenvalues(scenario.network.edges_at(0.0, arms), arms)
    path, low, high = scenario.controller.force_path, 0.0, 2.0
    for _ in range(40):
        g = (low + high) / 2.0
        stable = averaged_loop_radius(eigenvalues, path, delay, anchor_gain=g, wrist_delay=1) < 1.0
        low, high = (g, high) if stable else (low, g)
    assert_allclose(low, {0: 1.027, 2: 0.901}[delay], atol=1e-3)
    below, above = (
        errors_of(scenario.override({"controller.gains.anchor_gain": part * low})) for part in (0.97, 1.03)
    )
    assert below[-1] < 0.1 * max(below)
    assert above[-1] > 2.0 * above[3] or above[-1] > 100.0
    with pytest.raises((FieldError, ScenarioError), match=r"means grows|unstable from 1 on"):
        build_controller(
            scenario.override({"controller.gains.anchor_gain": 1.03 * low, "beyond_bound": False})
        )


@pytest.mark.slow
@pytest.mark.parametrize("cell", THREE)
def test_the_own_wrench_acts_at_once_however_late_the_network_is(cell):
    """Eight ticks late at g = 0.5: wrenches that all tell each other swing, from 0.184 on; these do not."""
    gain = {"controller.gains.anchor_gain": 0.5}
    late = {"network": {"delay": 8, "graph": "all"}, "duration": 3.0, "beyond_bound": True}
    slow = {"input_gain": 0.05, "proportional_gain": 0.03, "integral_gain": 0.02}
    learned, averaged, told = (
        errors_of(in_a_line(cell, path, **late).override(gain))
        for path in (
            {"kind": "learned-load", "consensus_gain": 0.04},
            {"kind": "consensus", **slow},
            {"kind": "messages"},
        )
    )
    assert max(learned[-1], averaged[-1]) < 0.5
    assert told[-1] > 2.0
    assert told[-1] > 0.95 * told[-2]
    with pytest.raises(ScenarioError, match=r"0\.18"):
        in_a_line(cell, {"kind": "messages"}, **late).override({**gain, "beyond_bound": False})


@pytest.mark.parametrize(
    ("cell", "kind"),
    [
        ("two planar", "consensus"),
        pytest.param("two planar", "learned-load", marks=pytest.mark.slow),
        pytest.param("three spatial", "consensus", marks=pytest.mark.slow),
        pytest.param("three spatial", "learned-load", marks=pytest.mark.slow),
    ],
)
def test_both_engines_agree(cell, kind):
    far = {"network.delay": 1, "network.loss": 0.2, "network.resolution": 1e-5, "duration": 0.15}
    scenario = in_a_line(cell, {"kind": kind}).override(far)
    assert support(scenario) is None
    require_same_samples(samples(scenario), cp.compiled.simulate_batch([scenario]).result(0).data)


@pytest.mark.parametrize(
    ("path", "network", "where"),
    [
        ({"kind": "consensus"}, {"graph": [["left", "right"]]}, "network.graph"),
        ({"kind": "learned-load"}, {"graph": [["left", "right"], ["right", "left"]]}, "network.graph"),
        ({"kind": "consensus", "proportional_gain": 0.9}, {}, "controller.force_path"),
        ({"kind": "learned-load", "consensus_gain": 0.7}, {}, "controller.force_path.consensus_gain"),
    ],
)
def test_graphs_and_gains_are_checked(path, network, where):
    scenario = in_a_line("three planar", path, network=network)
    with pytest.raises(FieldError) as caught:
        build_controller(scenario)
    assert caught.value.path == where


def test_they_need_a_network_and_wrists():
    kinds = ("consensus", "learned-load")
    laws = {kind: in_a_line("three planar", {"kind": kind}).controller for kind in kinds}
    assert {kind: law.needs for kind, law in laws.items()} == {
        "consensus": ("holding torque", "internal wrench"),
        "learned-load": ("holding torque", "own wrench", "learned mass"),
    }
    for missing in ({"network": None}, {"sensors.wrist": None}):
        with pytest.raises(ScenarioError, match=r"network|wrist"):
            in_a_line("three planar", {"kind": "consensus"}, **missing)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_wrapped_law_commands_velocities_and_remarks_like_the_law_itself(cell):
    scenario = SCENARIOS[cell]()
    law = {"kind": "admittance", "force_path": {"kind": "learned-load"}, "zero_at_grasp": True}
    servo = {"command": "velocity", "rate_hz": scenario.clock.rate_hz}
    told = scenario.replace(
        events=(),
        duration=0.02,
        beyond_bound=True,
        network={},
        sensors={"wrist": {}},
        actuators={"servo": servo},
        controller=law,
    )
    result = cp.run(told, warn=False)
    assert {build_controller(told).commands_of(arm) for arm in told.cell.arms} == {"velocity"}
    assert result.data.attrs[result.REMARKS].count("it has learned a payload") == len(told.cell.arms)
