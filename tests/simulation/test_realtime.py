"""Real-time pacing, with a clock and a sleep that the test controls."""

import math
import time

import pytest
from close import assert_close

import coop_pin as cp
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulate import RealtimePacer


class Wall:
    """Wall time that passes only in sleep."""

    def __init__(self):
        self.now, self.slept = 100.0, []

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def wall(monkeypatch):
    wall = Wall()
    monkeypatch.setattr(time, "monotonic", wall.monotonic)
    monkeypatch.setattr(time, "sleep", wall.sleep)
    return wall


def test_simulated_time_passes_at_the_rate(wall):
    pacer = RealtimePacer(4.0)
    for simulated in (0.0, 1.0, 2.0, 4.0):
        pacer.wait_until(simulated)
    assert_close(wall.slept, [0.25, 0.25, 0.5], atol=1e-12)


def test_work_counts_as_waiting_and_small_delays_are_made_up_for(wall):
    pacer = RealtimePacer(1.0)
    pacer.wait_until(0.0)
    wall.now += 0.3
    pacer.wait_until(1.0)
    wall.now += 1.08
    pacer.wait_until(2.0)  # 0.08 s late
    pacer.wait_until(3.0)
    assert_close(wall.slept, [0.7, 0.92], atol=1e-12)


def test_after_falling_far_behind_it_does_not_run_faster(wall):
    pacer = RealtimePacer(2.0)
    pacer.wait_until(0.0)
    wall.now += 5.0
    pacer.wait_until(1.0)
    pacer.wait_until(2.0)
    pacer.wait_until(3.0)
    assert_close(wall.slept, [0.5, 0.5], atol=1e-12)


def test_an_infinite_rate_never_waits(wall):
    pacer = RealtimePacer(math.inf)
    pacer.wait_until(0.0)
    pacer.wait_until(1e6)
    assert wall.slept == []


@pytest.mark.parametrize(
    ("given", "view", "rate"),
    [
        (None, None, math.inf),
        (None, lambda _snapshot: None, 1.0),
        (3.0, None, 3.0),
        (3.0, lambda _snapshot: None, 3.0),
        (math.inf, lambda _snapshot: None, math.inf),
    ],
)
def test_a_run_with_a_view_is_paced_at_real_time_and_one_without_is_not(wall, given, view, rate):
    scenario = cp.Scenario.load("adept-paper", {"duration": 0.02, "events": []})
    cp.simulate(scenario, build_controller(scenario), view=view, realtime_rate=given)
    last = scenario.clock.ticks(0.02) * scenario.clock.period
    assert_close(sum(wall.slept), last / rate, atol=1e-12)
