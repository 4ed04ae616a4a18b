"""Templates of a sweep: which numbers are plain; their runs are those that are validated as a whole."""

from __future__ import annotations

import pytest

import coop_pin as cp
from coop_pin.base.errors import ScenarioError
from coop_pin.base.schema.parts import Filled
from coop_pin.compiled import BatchSimulator
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.run_key import keyed_points, run_key, unresolved_key
from coop_pin.sweeps.template import Template, Templates
from coop_pin.tracing.tape import Tape, operands
from coop_pin.tracing.traced_array import inputs
from coop_pin.tracing.tree import leaves

PLAIN = {
    "controller.gains.pose_gain": (0.5, 2),
    "controller.switching.width": (0.01, 0.2),
    "controller.normal_guard": (0.0, 2.0),
    "cell.payload.mass": (1.0, 7.0),
    "events.0.mass": (3.0, 4),
    "sensors.encoder.noise": (0.0, 1e-5),
    "clock.record_every": (1, 3),
    "seed": (0, 5),
}
"""Plain numbers of adept-anchored."""
READ = (
    "controller.gains.anchor_gain",  # bounded by the delay of the force path
    "clock.rate_hz",
    "events.0.time",
    "duration",
    "motion.constant.0",  # of a row
    "cell.nothing",
)
"""Numbers that others look at, or that are none."""


@pytest.mark.parametrize("name", PLAIN)
def test_a_plain_number_changes_nothing_else(name: str) -> None:
    scenario = cp.Scenario.load("adept-anchored")
    template = Template(scenario, [name])
    for value in PLAIN[name]:
        changed, numbers = scenario.override({name: value}), template.numbers({name: value})
        assert numbers is not None
        assert template.scenario(numbers) == changed
        assert template.text(numbers) == changed.model_dump_json()
        assert template.agrees(changed, {name: value})


@pytest.mark.parametrize("name", READ)
def test_a_number_that_others_read_is_not_plain(name: str) -> None:
    with pytest.raises((TypeError, LookupError, AttributeError, ValueError, ScenarioError)):
        Template(cp.Scenario.load("adept-anchored"), [name])


def test_values_that_a_field_or_its_class_refuses_are_left_to_the_whole_validation() -> None:
    template = Template(
        cp.Scenario.load("adept-anchored"), ["cell.payload.mass", "controller.gains.pose_gain"]
    )
    for mass, gain in ((-1.0, 1.0), (1.0, 0.0), (float("nan"), 1.0), (1.0, float("inf"))):
        changes = {"cell.payload.mass": mass, "controller.gains.pose_gain": gain}
        assert template.numbers(changes) is None
    changes = {"cell.payload.mass": 1.0, "controller.gains.pose_gain": 1.0}
    assert not template.agrees(cp.Scenario.load("adept-paper"), changes)


def test_nothing_precomputed_goes_with_the_numbers() -> None:
    scenario = cp.Scenario.load("two-pandas-box")
    target = scenario.motion.at(3.0)  # precomputes
    template = Template(scenario, ["motion.duration"])
    numbers = template.numbers({"motion.duration": 30.0})
    assert numbers is not None
    changed = template.scenario(numbers)
    assert (changed.motion.at(3.0).X_WP_d != target.X_WP_d).any()
    assert (
        changed.motion.at(3.0).X_WP_d == scenario.override({"motion.duration": 30.0}).motion.at(3.0).X_WP_d
    ).all()


def test_keys_of_a_plan_are_those_of_its_runs_one_by_one() -> None:
    plan = SweepPlan(
        base="adept-anchored",
        cases={"law": {"as it is": {}, "late": {"controller.force_path.delay": 3}}},
        axes={
            "controller.gains.anchor_gain": [0.05, 0.1, 3.0],  # read, and the last one refused
            "controller.gains.pose_gain": [1.0, 2, -1.0, 2.5],
            "cell.payload.mass": [5.0, 6.0, 7.0, 8.0],
        },
        engine="compiled",
    )
    templates, used = Templates(plan), 0
    for keyed in keyed_points(plan):
        whole = plan.resolved(keyed.point)
        used += templates.of(keyed.point) is not None
        if isinstance(whole, ScenarioError):
            assert isinstance(keyed.example, ScenarioError)
            assert keyed.key == unresolved_key(plan.base["adept-anchored"], keyed.point.changes)
        else:
            filled = keyed.pattern and keyed.pattern.filled(keyed.numbers)
            assert (filled or keyed.example) == whole
            assert keyed.key == run_key(whole, engine="compiled")
    assert used == 64  # where the anchor gain is accepted


ALIKE = {
    ("adept-paper", "sign_gain"): True,
    ("adept-anchored", "transient_rate"): True,
    ("two-pandas-box", "transient_rate"): True,
    ("adept-anchored", "pose_gain"): False,  # looked up in a set
    ("three-ur5-plate", "sliding_gain"): False,  # inverted
}
"""Whether the numbers of laws are made together, by the number that varies."""


@pytest.mark.parametrize(("cell", "gain"), ALIKE)
def test_numbers_of_laws_as_columns_have_the_bits_of_single_ones(cell: str, gain: str) -> None:
    pytest.importorskip("llvmlite")
    base = cp.Scenario.load(cell).replace(duration=0.1, events=())
    template, simulator = Template(base, [f"controller.gains.{gain}"]), BatchSimulator()
    values = [0.1 * base.clock.period * (1.0 + number) for number in range(5)]
    runs = simulator.prepare_alike(Filled(template.pattern, [[value] for value in values]))
    assert (runs is not None) == ALIKE[cell, gain]
    for index, value in enumerate(values if runs else ()):
        run, alone = runs.part(slice(index, None)), simulator.prepare(template.pattern.filled([value]))
        assert run.values[0].tobytes() == alone.values.tobytes()
        assert run.kind == alone.kind
        assert leaves(run.controller()) == leaves(alone.controller())


def test_sums_that_libraries_may_round_otherwise_are_found() -> None:
    tape = Tape()
    x, y = inputs(tape, 2)
    alike = {"x / y": x / y, "x + y": x + y, "x * y / 3": x * y / 3.0, "1 / x + 1 / y": 1.0 / x + 1.0 / y}
    others = {"x * y + x": x * y + x, "x + y + 1": x + y + 1.0, "|x|": abs(x)}
    for text, value in (alike | others).items():
        assert tape.rounds_alike(operands(tape, [value])) == (text in alike), text
