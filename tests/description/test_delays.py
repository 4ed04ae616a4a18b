"""Delays as times: ticks of the control rate, kept as they were stated."""

import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import ScenarioError


def delayed(scenario, delay):
    """The scenario with wrist sensors that are late."""
    return scenario.override({"sensors.wrist": {"delay": delay}})


@pytest.mark.parametrize(
    ("delay", "rate", "ticks"),
    [
        *(("5 ms", 1000.0, 5), ("5ms", 800.0, 4), ("0.0049 s", 1000.0, 5), ("300 us", 1000.0, 1)),
        *(("0 s", 80.0, 0), ("1e-2 s", 80.0, 1), (" 25 ms", 80.0, 2), (".1 s", 80.0, 8), (7, 80.0, 7)),
    ],
)
def test_a_time_is_rounded_up_to_ticks(delay, rate, ticks):
    scenario = delayed(SCENARIOS["planar"]().override({"clock.rate_hz": rate}), delay)
    assert scenario.wrists[0].delay == ticks


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_time_keeps_its_length_at_another_rate_and_in_files(name):
    scenario = delayed(SCENARIOS[name](), "20 ms")
    twice = scenario.override({"clock.rate_hz": 2.0 * scenario.clock.rate_hz})
    assert twice.wrists[0].delay == 2 * scenario.wrists[0].delay
    again = cp.Scenario.from_toml(scenario.to_toml())
    assert again == scenario
    assert again.sensors.wrist.delay.text == "20 ms"
    assert cp.Scenario.model_validate_json(scenario.model_dump_json()).wrists == scenario.wrists


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_run_with_a_time_is_that_with_its_ticks(name):
    path = {"controller.force_path": {"kind": "late"}, "duration": 0.3, "events": ()}
    scenario = SCENARIOS[name]().override(path)
    runs = [cp.run(delayed(scenario, delay), warn=False) for delay in ("25 ms", 0)]
    ticks = cp.run(delayed(scenario, runs[0].scenario.wrists[0].delay), warn=False)
    assert np.array_equal(runs[0].data.pose_error, ticks.data.pose_error)


def test_every_delay_may_be_a_time():
    scenario = SCENARIOS["planar"]().override(
        {
            "network": {
                "delay": "20 ms",
                "links": [{"sender": "left", "receiver": "right", "delay": "40 ms"}],
            },
            "controller.force_path": {"kind": "low-pass", "delay": "15 ms"},
            "sensors.slip": {"delay": "1 s"},
            "beyond_bound": True,
        }
    )
    network = scenario.network
    assert (network.channel(("left", "right")).delay, network.channel(("right", "left")).delay) == (4, 2)
    assert (scenario.controller.force_path.delay, scenario.sensors.slip.delay) == (2, 80)
    servo = cp.Scenario.load("two-ur5-admittance").override({"actuators.servo.delay": "9 ms"})
    assert servo.actuators.servo.delay == -(-servo.clock.rate_hz * 9 // 1000)


@pytest.mark.parametrize("delay", ["5", "5 min", "-5 ms", "", "ms", "1e400 s", "nan s", "100 s"])
def test_what_is_no_time_or_too_long_is_refused(delay):
    with pytest.raises(ScenarioError, match=r"wrist\.delay"):
        delayed(SCENARIOS["planar"](), delay)


def test_a_sweep_over_rates_has_the_ticks_of_each(tmp_path):
    base = delayed(SCENARIOS["planar"]().replace(duration=0.2, events=()), "25 ms")
    result = cp.sweep(base, {"clock.rate_hz": [80.0, 160.0, 240.0, 320.0]}, out=tmp_path / "rates")
    assert [result.open(k).scenario.wrists[0].delay for k in range(4)] == [2, 4, 6, 8]
