"""Interactive runs: a change acts from the next tick on, as if it had been planned; and the Jupyter panel."""

import sys
import threading
import time

import numpy as np
import pytest
from cells import SCENARIOS, planar_scenario
from faulty import law
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import (
    CoopPinError,
    DivergedError,
    FieldError,
    InvalidStateError,
    MissingExtraError,
    UserCodeError,
)
from coop_pin.reference.squeeze import ConstantSqueeze
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.viz import LiveRun, Panel
from coop_pin.viz.live.panel import gain_sliders

PATIENCE_S = 30.0


def quiet_paper(duration=1.0):
    return planar_scenario().replace(duration=duration, events=())


def advanced(scenario, ticks) -> Simulation:
    simulation = Simulation(scenario, build_controller(scenario))
    for _ in range(ticks):
        simulation.tick()
    return simulation


def to_the_end(simulation):
    while not simulation.is_finished:
        simulation.tick()
    return simulation.result()


def eventually(condition) -> bool:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end and not condition():
        time.sleep(0.01)
    return condition()


@pytest.mark.parametrize("name", SCENARIOS)
def test_ticks_by_hand_are_a_run(name):
    scenario = SCENARIOS[name]().replace(duration=0.3, events=())
    assert to_the_end(advanced(scenario, 5)).data.identical(cp.run(scenario, warn=False).data)


@pytest.mark.parametrize(
    "event",
    [
        cp.events.PayloadChange(time=0.25, mass=5.0),
        cp.events.WrenchPulse(time=0.25, duration=0.113, wrench=(90.0, 20.0, 0.0, 0.0, 0.0, 3.0)),
    ],
)
def test_an_event_added_on_the_way_acts_as_if_it_had_been_planned(event):
    scenario = quiet_paper()
    by_hand = advanced(scenario, 20)
    assert by_hand.time == 0.25
    by_hand.add_event(event)
    result, planned = to_the_end(by_hand), cp.run(scenario.replace(events=(event,)), warn=False)
    assert result.data.identical(planned.data)
    assert result.scenario == planned.scenario


def test_events_must_lie_ahead_and_within_the_run():
    simulation = advanced(quiet_paper(), 20)
    with pytest.raises(FieldError, match=r"0\.2 s.* 0\.25 s"):
        simulation.add_event(cp.events.PayloadChange(time=0.2, mass=5.0))
    with pytest.raises(CoopPinError, match=r"ends at t = 1\.1 s"):
        simulation.add_event(cp.events.WrenchPulse(time=1.0, duration=0.1, wrench=(1.0, 0, 0, 0, 0, 0)))
    assert to_the_end(simulation).data.identical(cp.run(quiet_paper(), warn=False).data)


def test_another_gain_acts_at_the_next_tick_and_not_before():
    scenario = quiet_paper()
    changed = scenario.override({"controller.gains.damping_gain": (30.0, 30.0, 5.0)})
    simulation = advanced(scenario, 20)
    simulation.replace_controller(build_controller(changed))
    result, alone = to_the_end(simulation), cp.run(scenario, warn=False)
    torque, before = result.data["torque"].values, alone.data["torque"].values
    assert_allclose(torque[:20], before[:20], rtol=0, atol=0)
    assert np.abs(torque[20] - before[20]).max() > 1e-3
    assert result.scenario.summary.endswith("controller replaced at t = 0.25 s")


def test_a_controller_replaced_by_its_equal_changes_nothing():
    scenario = quiet_paper()
    simulation = advanced(scenario, 20)
    simulation.replace_controller(build_controller(scenario))
    assert_allclose(
        to_the_end(simulation).data["torque"].values,
        cp.run(scenario, warn=False).data["torque"].values,
        rtol=0,
        atol=0,
    )


def test_another_squeeze_is_followed():
    simulation = advanced(quiet_paper(3.0), 20)
    simulation.replace_squeeze(
        ConstantSqueeze(wrenches={"left": (-25.0, 0, 0, 0, 0, 0), "right": (25.0, 0, 0, 0, 0, 0)})
    )
    internal = to_the_end(simulation).data["internal_wrench"].values[-1, 0, :2]
    assert_allclose(np.linalg.norm(internal), 25.0, atol=5.0)
    with pytest.raises(CoopPinError, match="middle"):
        simulation.replace_squeeze(ConstantSqueeze(wrenches={"middle": (0.0,) * 6}))


def test_a_finished_run_has_no_more_ticks():
    simulation = advanced(quiet_paper(0.1), 9)
    assert simulation.is_finished
    with pytest.raises(InvalidStateError, match=r"t = 0\.1 s"):
        simulation.tick()


# ---------------------------------------------------------------- LiveRun


def test_a_live_run_starts_pauses_goes_on_and_is_the_run():
    run = LiveRun(quiet_paper(0.5), realtime_rate=float("inf"))
    assert run.time == 0.0
    run.start()
    run.pause()
    paused = run.time
    time.sleep(0.05)
    assert run.time == paused
    run.start()
    assert eventually(lambda: run.is_finished and not run.is_running)
    assert run.result().data.identical(cp.run(quiet_paper(0.5), warn=False).data)
    run.start()  # nothing is left to run
    assert not run.is_running


def test_changes_stay_after_a_reset():
    run = LiveRun(quiet_paper())
    assert run.realtime_rate == 1.0
    run.step()
    run.change({"controller.gains.pose_gain": 3.0})
    run.change_mass(4.0)
    run.change_squeeze(20.0)
    run.reset()
    assert run.time == 0.0
    assert run.scenario.controller.gains.pose_gain == 3.0
    assert run.scenario.cell.payload.mass == 4.0
    assert_allclose(np.linalg.norm(run.scenario.squeeze_wrenches[:, :3], axis=1), 20.0)
    run.step()
    assert run.result().scenario.events == ()


def test_a_squeeze_of_zero_keeps_its_direction_and_none_has_none():
    run = LiveRun(quiet_paper())
    run.change_squeeze(0.0)
    run.change_squeeze(10.0)
    assert_allclose(run.scenario.squeeze_wrenches, quiet_paper().squeeze_wrenches)
    with pytest.raises(FieldError):
        LiveRun(quiet_paper().replace(squeeze=ConstantSqueeze())).change_squeeze(1.0)


def test_a_value_that_is_not_allowed_changes_nothing():
    run = LiveRun(quiet_paper())
    before = run.scenario
    with pytest.raises(CoopPinError, match="pose_gain"):
        run.change({"controller.gains.pose_gain": -1.0})
    assert run.scenario == before


def test_a_push_at_the_end_is_cut_and_after_it_ignored():
    run = LiveRun(quiet_paper(0.1))
    for _ in range(7):
        run.step()
    run.push((10.0, 0, 0, 0, 0, 0), 5.0)
    run.step()
    run.step()
    assert run.is_finished
    run.push((10.0, 0, 0, 0, 0, 0), 5.0)
    run.step()
    (pulse,) = run.result().scenario.events
    assert_allclose(pulse.end, 0.1, rtol=1e-9)


def test_a_run_that_diverges_keeps_its_error_and_ends():
    gains = {"controller.gains.damping_gain": (6000.0, 6000.0, 1000.0)}
    run, ended = LiveRun(quiet_paper(5.0).override(gains), realtime_rate=float("inf")), threading.Event()
    run.on_end = ended.set
    run.start()
    assert ended.wait(PATIENCE_S)
    assert isinstance(run.error, DivergedError)
    assert run.is_finished
    run.reset()
    assert run.error is None


def test_a_users_controller_that_raises_ends_the_run_and_not_the_panel():
    run, ended = LiveRun(quiet_paper().override(law("raise")), realtime_rate=float("inf")), threading.Event()
    run.on_end = ended.set
    run.start()
    assert ended.wait(PATIENCE_S)
    assert isinstance(run.error, UserCodeError)
    assert "ValueError: this law has a mistake" in str(run.error)


# ---------------------------------------------------------------- Panel


@pytest.fixture
def panel():
    panel = Panel(quiet_paper(30.0))
    assert panel.run.realtime_rate == 1.0
    yield panel
    panel.close()


def test_every_slider_of_the_panel_acts_on_the_running_loop(panel):
    panel.buttons["start"].click()
    assert panel.buttons["start"].description == "Pause"
    for field, value in (
        ("controller.gains.pose_gain", 3.0),
        ("controller.gains.sign_gain", 0.0),
        ("mass", 5.0),
        ("squeeze", 20.0),
    ):
        panel.sliders[field].value = value
    panel.sliders["controller.gains.damping_gain"].value = 0.5
    panel.buttons["push"].click()
    assert panel.run.scenario.controller.gains.pose_gain == pytest.approx(3.0)
    assert panel.run.scenario.controller.gains.sign_gain == 0.0
    assert_allclose(
        panel.run.scenario.controller.gains.damping_gain,
        0.5 * np.array(quiet_paper().controller.gains.damping_gain),
    )
    assert eventually(lambda: panel.view.sent > 3)
    panel.buttons["start"].click()
    events = {event.kind: event for event in panel.result().scenario.events}
    assert events["payload-change"].mass == pytest.approx(5.0)
    assert events["wrench-pulse"].wrench[1] == panel.sliders["push"].value
    panel.buttons["reset"].click()
    assert panel.run.time == pytest.approx(0.0125)  # one tick, so that the view shows the start


def test_sliders_follow_changes_made_by_code_and_do_not_act_again(panel):
    run, sliders, calls = panel.run, panel.sliders, []
    damping = quiet_paper().controller.gains.damping_gain
    run.change(
        {"controller.gains.pose_gain": 3.0, "controller.gains.damping_gain": tuple(2 * np.array(damping))}
    )
    run.change_mass(5.0)
    run.change_squeeze(25.0)
    found = [sliders[name].value for name in ("controller.gains.pose_gain", "mass", "squeeze")]
    assert_allclose(found, (3.0, 5.0, 25.0))
    assert sliders["controller.gains.damping_gain"].value == 1.0  # of the gain that code has set
    change, run.change = run.change, lambda fields: (calls.append(fields), change(fields))
    run.change({"controller.gains.pose_gain": 300.0})  # beyond the slider's end, which moves
    assert sliders["controller.gains.pose_gain"].value == pytest.approx(300.0)
    assert len(calls) == 1
    sliders["controller.gains.damping_gain"].value = 0.5
    assert_allclose(run.scenario.controller.gains.damping_gain, damping)
    run.change_squeeze(0.0)
    assert (sliders["squeeze"].value, run.squeeze) == (0.0, 0.0)
    run.reset()  # starts with the last squeeze that had a direction
    assert sliders["squeeze"].value == run.squeeze == pytest.approx(25.0)


def test_a_panel_shows_the_error_of_a_refused_change(panel):
    panel.run.change = lambda _: (_ for _ in ()).throw(FieldError("is <nonsense>", "squeeze"))
    panel.sliders["controller.gains.pose_gain"].value = 3.0
    assert "is &lt;nonsense&gt;" in panel.widget.children[-1].value


def test_a_panel_shows_its_view_through_the_kernel_and_a_still_image_without_one(panel):
    assert panel.widget.children[0] is panel.view.widget
    assert panel.view.server is None
    shown = panel._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in shown
    assert "still image: " in shown["text/html"]  # for pages without a kernel


def test_changes_are_on_the_clock_until_the_reset(panel):
    run, clock = panel.run, panel.view.widget
    run.step()
    run.change({"controller.gains.pose_gain": 3.0})
    run.change_mass(5.0)
    run.change_squeeze(25.0)
    run.push((30.0, 40.0, 0, 0, 0, 0), 0.2)
    texts = ["pose gain 3", "payload 5 kg", "squeeze 25 N", "push 50 N"]
    assert [change["text"] for change in clock.changes] == texts
    ends = [(change["start"], change["end"]) for change in clock.changes]
    assert_allclose(ends, [(0.0125, 0.0125)] * 3 + [(0.0125, 0.2125)])
    panel.buttons["reset"].click()
    assert clock.changes == []


def test_sliders_are_the_gains_that_have_an_effect():
    names = [slider.field.rpartition(".")[2] for slider in gain_sliders(quiet_paper())]
    assert names == [
        "pose_gain",
        "sign_gain",
        "transient_rate",
        "damping_gain",
    ]  # without a force path no force gain
    with_path = quiet_paper().override({"controller.force_path": {"kind": "late"}})
    assert "controller.gains.force_gain" in [slider.field for slider in gain_sliders(with_path)]
    for slider in gain_sliders(quiet_paper()):
        assert slider.low <= slider.value <= slider.high
        quiet_paper().override({slider.field: slider.field_value(slider.high)})


def test_sliders_of_the_payload_space_law_are_the_gains_that_have_an_effect():
    """An omitted leak has a slider with the value that the law takes."""
    leaky = {"controller.force_path": {"kind": "none"}}
    for changes, leak, anchors in (({}, 10.0, True), (leaky, 0.2, False)):
        scenario = cp.Scenario.load("adept-anchored", changes)
        sliders = {slider.field.rpartition(".")[2]: slider for slider in gain_sliders(scenario)}
        assert (sliders["leak"].value, "anchor_gain" in sliders) == (leak, anchors)
        build_controller(scenario.override({sliders["leak"].field: sliders["leak"].high}))


@pytest.mark.parametrize("name", ["ipywidgets", "anywidget"])
def test_a_panel_without_its_widgets_names_the_extra(monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "coop_pin.viz.live.live_widget", raising=False)
    with pytest.raises(MissingExtraError) as caught:
        Panel(quiet_paper())
    assert caught.value.extra == "notebook"
