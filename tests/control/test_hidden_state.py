"""Memory of users' laws besides their state: noticed, brought back, and named where it cannot be."""

import collections
import itertools
import random
import re
import warnings

import numpy as np
import pytest
import stateful_laws
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import ScenarioWarning, TracingError
from coop_pin.control.hidden_state import content_of, of_classes, of_objects, require_no_outside, unrepeatable
from coop_pin.control.law_memory import LawMemory
from coop_pin.laws import build_controller

BROUGHT_BACK = ["Counter", "InPlaceArray", "History", "InState", "Later", "Drawn"]
NAMED = {
    "Iterated": "'steps'",
    "ClassList": "'past' of class ClassList",
    "InModule": "'COUNT' of module stateful_laws",
    "NumpyRandom": "numpy.random",
    "PlainRandom": "the random numbers of random",
}


def scenario_of(name, cell="planar", **options):
    controller = {"kind": "user", "target": f"stateful_laws:{name}", "options": options}
    changes = {"duration": 0.3, "events": (), "beyond_bound": True, "controller": controller}
    return SCENARIOS[cell]().override(changes)


def torques(run):
    while not run.is_finished:
        run.tick()
    return run.result().data["commanded_torque"].values


class Slots:
    __slots__ = ("n",)


@pytest.mark.parametrize(
    ("make", "change"),
    [
        (lambda: collections.deque([1, 2]), collections.deque.rotate),
        (lambda: bytearray(2), lambda held: held.__setitem__(0, 1)),
        (itertools.count, next),
        (lambda: iter([1, 2]), next),
        (lambda: random.Random(1), random.Random.random),
        (lambda: np.random.default_rng(1), lambda held: held.normal()),
        (Slots, lambda held: setattr(held, "n", 1)),
    ],
)
def test_what_an_object_without_attributes_holds_is_seen(make, change):
    value = make()
    before = content_of(value, {})
    assert before == content_of(make(), {})
    change(value)
    assert before != content_of(value, {})


@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize("name", BROUGHT_BACK)
def test_reset_and_restore_bring_back_what_a_law_holds(name, cell):
    scenario = scenario_of(name, cell)
    run = cp.Simulation(scenario, build_controller(scenario))
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScenarioWarning)
        first = torques(run)
        run.reset()
        for _ in range(5):
            run.tick()
        middle = run.state()
        assert np.array_equal(torques(run), first)
        for _ in range(2):
            run.restore(middle)
            assert np.array_equal(torques(run), first)


@pytest.mark.parametrize("name", NAMED)
def test_what_cannot_be_brought_back_is_named(name):
    scenario = scenario_of(name)
    run = cp.Simulation(scenario, build_controller(scenario))
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScenarioWarning)
        run.reset()  # nothing has happened yet
    torques(run)
    with pytest.warns(ScenarioWarning, match=NAMED[name]):
        run.reset()


def test_arrays_come_back_in_place_and_the_packages_laws_have_no_memory():
    scenario = scenario_of("InPlaceArray")
    controller = build_controller(scenario)
    law = next(iter(controller.controllers.values()))
    sums, memory = law.sums, LawMemory.of(controller)
    sums += 1.0
    law.further = 1
    assert memory.restore(controller) == []
    assert law.sums is sums
    assert not sums.any()
    assert not hasattr(law, "further")
    assert LawMemory.of(build_controller(SCENARIOS["planar"]())) is None
    assert of_objects(build_controller(SCENARIOS["planar"]())) == {}


@pytest.mark.parametrize("name", [name for name in NAMED if name != "Iterated"])
def test_a_run_warns_of_what_it_leaves_to_the_next(name):
    with pytest.warns(ScenarioWarning, match=NAMED[name]):
        result = cp.run(scenario_of(name))
    assert [finding.kind for finding in result.findings.of("warning")].count("user code") == 1
    assert not [f for f in cp.run(scenario_of("History")).findings.entries if f.kind == "user code"]


@pytest.mark.parametrize(("name", "word"), [("Clocked", "time"), ("Unseeded", "default_rng()")])
def test_a_run_warns_of_clocks_and_generators_without_a_seed(name, word):
    with pytest.warns(ScenarioWarning, match=re.escape(word)):
        result = cp.run(scenario_of(name))
    assert [finding.kind for finding in result.findings.of("warning")] == ["user code"]
    assert unrepeatable(["stateful_laws:Clean"]) == []


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("Counted", "numbers"),
        ("InFile", "open"),
        ("InEnvironment", "os"),
        ("InCache", "cached"),
        ("NumpyRandom", "numpy.random"),
        ("PlainRandom", "random"),
    ],
)
def test_what_is_another_each_time_is_refused_by_name(name, word):
    with pytest.raises(TracingError, match=word):
        require_no_outside([f"stateful_laws:{name}"])
    for harmless in ("Clean", "Counter", "InBytes"):
        require_no_outside([f"stateful_laws:{harmless}"])


def test_bytes_of_a_module_are_seen():
    before = of_classes(["stateful_laws:InBytes"])
    stateful_laws.InBytes.more(None, None)
    assert before != of_classes(["stateful_laws:InBytes"])
