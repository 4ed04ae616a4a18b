"""Messages of the live page in a notebook: through the kernel's comm to the page, and back to the run."""

import sys

import comm
import numpy as np
import pytest
from cells import SCENARIOS, planar_scenario
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.viz import LiveView, Panel
from coop_pin.viz.live.live_scene import LiveScene, initial_scene

UNITS = ("share", "torque")
"""Plots of the drive torques, in % of their limits or in N m."""


class Channel(comm.base_comm.BaseComm):
    """Comm as of a kernel, whose other end is the test."""

    def publish_msg(self, msg_type, data=None, metadata=None, buffers=None, **keys):
        self.__dict__.setdefault("sent", []).append((msg_type, data, buffers))

    def say(self, **content):
        """Deliver a custom message, as a front end sends it."""
        message = {"content": {"comm_id": self.comm_id, "data": {"method": "custom", "content": content}}}
        self.handle_msg({**message, "buffers": []})

    def frames(self, to=""):
        """Bytes of all frames that were sent to all pages or to one."""
        messages = [(data, buffers) for kind, data, buffers in self.sent if kind == "comm_msg"]
        addressed = {"kind": "frames", "to": to}
        return [bytes(buffers[0]) for data, buffers in messages if data.get("content") == addressed]


@pytest.fixture(autouse=True)
def channel(monkeypatch):
    monkeypatch.setattr(comm, "create_comm", Channel)


@pytest.fixture(params=SCENARIOS)
def scenario(request):
    return SCENARIOS[request.param]().replace(duration=0.5, events=())


def test_a_page_gets_every_frame_and_one_that_opens_later_the_run_so_far(scenario):
    view, scene = LiveView(initial_scene(scenario)), LiveScene(initial_scene(scenario))
    channel, seen = view.in_notebook().comm, []

    def watch(snapshot):
        seen.append(scene.frame(snapshot))
        view.show(snapshot)

    result = cp.run(scenario, view=watch, realtime_rate=float("inf"), warn=False)
    assert channel.frames() == seen
    assert view.sent == len(seen) == len(result.data["time"])
    channel.say(kind="hello", view="second")
    assert channel.frames("second") == [b"".join(seen)]
    assert channel.frames("first") == []
    view.show(initial_scene(scenario).snapshot)  # earlier than the last one: a new run
    channel.say(kind="hello", view="third")
    assert channel.frames("third") == [scene.frame(initial_scene(scenario).snapshot)]
    view.close()
    view.show(initial_scene(scenario).snapshot)
    assert len(channel.frames()) == len(seen) + 1
    assert view.server is None


def test_a_long_run_is_told_in_less_than_a_jupyter_server_lets_through():
    widget = LiveView(initial_scene(planar_scenario())).in_notebook()
    frames = np.arange(4000.0)[:, None] + np.zeros(250)  # the first number is the time
    for frame in frames.astype("<f4"):
        widget.show(frame.tobytes())
    widget.comm.say(kind="hello", view="late")
    (told,) = widget.comm.frames("late")
    times = np.frombuffer(told, "<f4").reshape(-1, 250)[:, 0]
    assert 100_000 < len(told) < 1_000_000
    assert (times[0], times[-1]) == (0.0, 3999.0)
    assert (np.diff(times) > 0.0).all()


def test_the_payload_that_a_person_drags_is_pushed_at_that_point(scenario):
    panel = Panel(scenario.replace(duration=5.0))
    panel.run.step()
    P, rows = panel.view.payload_position, scenario.cell.task_rows
    lever, force = np.array([0.05, -0.02, 0.03]), np.array([20.0, 10.0, -5.0])
    panel.view.widget.comm.say(kind="push", point=(P + lever).tolist(), force=force.tolist(), view="one")
    panel.run.step()
    expected = np.zeros(6)
    moment = [  # r x F
        lever[1] * force[2] - lever[2] * force[1],
        lever[2] * force[0] - lever[0] * force[2],
        lever[0] * force[1] - lever[1] * force[0],
    ]
    expected[list(rows.indices)] = np.array([*force, *moment])[list(rows.indices)]
    (pulse,) = panel.result().scenario.events
    assert_allclose(pulse.wrench, expected, atol=1e-12)
    assert_allclose(panel.result().data["external_wrench"].values[-1], expected, atol=1e-12)
    (change,) = panel.view.widget.changes
    assert change["text"].startswith("push ")
    panel.close()


def test_what_no_page_sends_is_ignored():
    panel = Panel(planar_scenario().replace(duration=5.0, events=()))
    for content in (
        {},
        {"kind": "push"},
        {"kind": "push", "point": [0, 0], "force": [1, 0, 0]},
        {"kind": "push", "point": [0, 0, 0], "force": ["a", None, {}]},
        {"kind": "push", "point": [0, 0, 0], "force": [float("nan"), 0, 0]},
        {"kind": "reset"},
    ):
        panel.view.widget.comm.say(**content)
    panel.run.step()
    assert panel.result().scenario.events == ()
    assert panel.run.error is None


def test_torques_of_drives_with_limits_are_shares_as_in_a_replay(scenario):
    limits = cp.run(scenario, warn=False).data["torque_limit"].values
    torques = {
        curve.plot: curve for curve in LiveScene(initial_scene(scenario)).curves if curve.plot in UNITS
    }
    assert list(torques) == ["share" if np.isfinite(limits).all() else "torque"]


def test_a_notebook_displays_the_widget_and_without_anywidget_a_still_image(monkeypatch):
    view = LiveView(initial_scene(planar_scenario()))
    data, _ = view._repr_mimebundle_()
    assert data["application/vnd.jupyter.widget-view+json"]["model_id"] == view.widget.model_id
    assert '"channel": "notebook"' in view.widget.page
    assert "still image: " in data["text/html"]
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "coop_pin.viz.live.live_widget")
    data, _ = LiveView(initial_scene(planar_scenario()))._repr_mimebundle_()
    assert list(data) == ["text/html"]
    assert "anywidget is not installed" in data["text/html"]
