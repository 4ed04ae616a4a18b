"""Numbers of fields: defaults, which users read on a page of their own, ends of ranges, and named values."""

import inspect
import json
import math
import re
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import BaseModel, TypeAdapter, ValidationError

import coop_pin as cp
from coop_pin.base.errors import OutOfRangeError
from coop_pin.description import (
    actuators,
    events,
    grasp_events,
    log_table,
    model_laws,
    network,
    plant,
    scenario,
    sensors,
    servo,
    thresholds,
)
from coop_pin.description.cell import (
    arm,
    armature,
    cell,
    contact,
    differential_base,
    end_stops,
    grasp,
    held_payload,
    joint_friction,
    linkage,
    miscalibration,
    mobile_base,
    payload,
    shared_joint,
)

PAGE = Path(__file__).parents[2] / "docs" / "fields.md"
MODULES = (actuators, events, grasp_events, log_table, model_laws, network, plant, scenario, sensors, servo)
MODULES += (thresholds, arm, armature, cell, contact, differential_base, end_stops, grasp, held_payload)
MODULES += (joint_friction, linkage, miscalibration, mobile_base, payload, shared_joint)


def defaults_on_page():
    """Defaults as they are written, by class or constructor of a payload and by field."""
    found, rows = {}, {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if kind := re.match(r'### `kind = "(\w+)"`', line):
            rows = found.setdefault(kind[1], {})
        elif name := re.match(r"\[?`(?:cp\.)?(?:\w+\.)?([A-Z]\w+)`", line):
            rows = found.setdefault(name[1], {})
        elif row := re.match(r"\| `(\w+)` \| `?(.*?)`? \|", line):
            rows[row[1]] = row[2]
    return found


def as_written(default):
    if default is None:
        return "omitted"
    if isinstance(default, BaseModel):
        return f'kind = "{default.kind}"' if hasattr(default, "kind") else "its defaults"
    return json.dumps(default)


CLASSES = {
    value.__name__: value
    for module in MODULES
    for value in vars(module).values()
    if inspect.isclass(value) and issubclass(value, BaseModel) and value.__module__ == module.__name__
}


WRITTEN = defaults_on_page()


@pytest.mark.parametrize("name", sorted(CLASSES.keys() & WRITTEN))
def test_defaults_of_a_class_are_those_of_the_page(name):
    fields = CLASSES[name].model_fields
    for field, written in WRITTEN[name].items():
        if fields[field].is_required():
            assert written == "required"
        else:
            assert as_written(fields[field].get_default(call_default_factory=True)) == written, field


@pytest.mark.parametrize("kind", ["bar", "mesh", "urdf", "of_links", "beam", "chain"])
def test_defaults_of_a_constructor_of_payloads_are_those_of_the_page(kind):
    make = getattr(cp.Payload, kind, None) or getattr(cp.Payload, f"from_{kind}")
    for argument in inspect.signature(make).parameters.values():
        written = WRITTEN[kind][argument.name]
        required = argument.default is argument.empty
        assert ("required" if required else as_written(argument.default)) == written, argument.name


def test_most_classes_of_scenarios_are_on_the_page():
    assert len(CLASSES.keys() & WRITTEN) > 55


def is_accepted(of, field, value):
    info = of.model_fields[field]
    try:
        TypeAdapter(Annotated[info.annotation, *info.metadata]).validate_python(value)
    except ValidationError:
        return False
    return True


@pytest.mark.parametrize(
    ("of", "field", "last", "beyond"),
    [
        (plant.Clock, "rate_hz", 1e6, math.inf),
        (plant.Clock, "steps_per_tick", 10_000, 10_001),
        (plant.Clock, "steps_per_tick", 1, 0),
        (plant.Clock, "record_every", 1, 0),
        (plant.MujocoOptions, "time_constant", 2.0, 0.0),
        (plant.MujocoOptions, "time_constant", 1000.0, math.inf),
        (plant.MujocoOptions, "impedance", 0.9999, 1.0),
        (plant.MujocoOptions, "impedance", 5e-324, 0.0),
        (plant.MujocoOptions, "torque_scale", 1000.0, math.inf),
        (plant.MujocoOptions, "torque_scale", 5e-324, 0.0),
        (thresholds.TrustThresholds, "jacobian_condition", 1.0, 0.0),
        (scenario.Scenario, "duration", 1e8, math.inf),
        (scenario.Scenario, "seed", 0, -1),
        (scenario.Scenario, "seed", 2**63 - 1, 2**63),
        (actuators.GravityCompensation, "mass_error", -1.0, -2.0),
        (actuators.Actuators, "missed_ticks", 0.0, -1.0),
        (actuators.Actuators, "missed_ticks", 1.0, 2.0),
        (network.Channel, "loss", 0.0, -1.0),
        (network.Channel, "loss", math.nextafter(1.0, 0.0), 1.0),
        (network.Channel, "jitter", 0, -1),
        (servo.Servo, "rate_hz", 1e7, math.inf),
        (servo.Servo, "velocity_feedforward", 0.0, -1.0),
        (servo.Servo, "velocity_feedforward", 1.0, 2.0),
        (servo.Servo, "delay", 1000, 1001),
        (grasp.LinkGrasp, "link", "a", ""),
    ],
)
def test_a_range_ends_where_it_is_stated(of, field, last, beyond):
    """The last value of a field is taken, and the next number after it on that side is not."""
    assert is_accepted(of, field, last)
    assert not is_accepted(of, field, math.nextafter(last, beyond) if isinstance(last, float) else beyond)


@pytest.mark.parametrize(("rods", "fits"), [(2, False), (3, True), (1000, True), (1001, False)])
def test_a_row_has_three_to_a_thousand_rods(rods, fits):
    count = TypeAdapter(linkage.Count)
    if fits:
        assert count.validate_python(rods) == rods
    else:
        with pytest.raises(ValidationError):
            count.validate_python(rods)


@pytest.mark.parametrize(("name", "k"), [("paper", 300e3), ("firm", 30e3), ("soft", 5e3)])
def test_a_named_stiffness_is_that_of_its_description(name, k):
    """In rotation it is k times 1/100 m^2."""
    stiffness = cp.CompliantGrasp(stiffness=name).stiffness
    assert_allclose(stiffness, k * np.repeat((1.0, 0.01), 3), rtol=1e-12)


def test_measured_stiffness_is_load_over_deflection():
    grasp = cp.CompliantGrasp.measured((20, 20, 20, 1, 1, 1), (4e-3, -4e-3, 2e-3, 0.02, 0.02, 0.01))
    assert_allclose(grasp.stiffness, (5e3, 5e3, 1e4, 50.0, 50.0, 100.0))
    with pytest.raises(OutOfRangeError, match=r"deflection\[2\]"):
        cp.CompliantGrasp.measured((20, 20, 20, 1, 1, 1), (4e-3, 4e-3, 0.0, 0.02, 0.02, 0.01))


@pytest.mark.parametrize("command", ["velocity", "position"])
def test_named_servos_have_the_numbers_of_the_manuals(command):
    """Of Universal Robots 500 Hz and 180 degrees a second; of Franka the joint limits of its Panda."""
    ur, franka = (servo.SERVOS[f"{robot}-{command}"] for robot in ("ur", "franka"))
    assert (ur.rate_hz, ur.speed_limit, ur.acceleration_limit) == (500.0, math.pi, None)
    assert (franka.rate_hz, franka.speed_limit) == (1000.0, (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61))
    assert franka.acceleration_limit == (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
    assert {each.command for each in (ur, franka)} == {command}


def test_the_named_servo_of_abb_takes_positions_at_250_hz():
    abb = servo.SERVOS["abb-position"]
    assert (abb.command, abb.rate_hz, abb.speed_limit) == ("position", 250.0, None)
    assert "abb-velocity" not in servo.SERVOS
