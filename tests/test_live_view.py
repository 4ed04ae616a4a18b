"""A live view shows the run, refuses strangers, costs a run nothing when it dies, and outlives nobody."""

import asyncio
import http.client
import json
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import time
import urllib.parse
import warnings
from pathlib import Path

import numpy as np
import pytest
from cells import SCENARIOS, SPATIAL_START, planar_scenario, spatial_cell
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import coop_pin as cp
from coop_pin.controller_factory import build_controller
from coop_pin.errors import OutOfRangeError, PortTakenError, ViewWarning
from coop_pin.viz import open_view
from coop_pin.viz.arrows import HEAD_LENGTH_M
from coop_pin.viz.initial_scene import standing_scenario
from coop_pin.viz.live_scene import LiveScene
from coop_pin.viz.live_server import ViewServer
from coop_pin.viz.live_view import live_html

PATIENCE_S = 20.0


@pytest.fixture(params=SCENARIOS, scope="module")
def scenario(request):
    return SCENARIOS[request.param]().replace(duration=0.5, events=())


@pytest.fixture
def server():
    server = ViewServer("<p>page</p>")
    yield server
    server.close()


def eventually(condition) -> bool:
    """Whether something becomes true before our patience ends; it never fails because the machine is slow."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False


def is_there(pid: int) -> bool:
    """Whether a process runs; one that nobody has buried yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def answers(url: str) -> bool:
    address = urllib.parse.urlsplit(url)
    try:
        socket.create_connection((address.hostname, address.port), timeout=1).close()
    except OSError:
        return False
    return True


def ask(url: str, path: str | None = None, **headers: str) -> tuple[int, bytes]:
    address = urllib.parse.urlsplit(url)
    connection = http.client.HTTPConnection(address.hostname, address.port, timeout=PATIENCE_S)
    connection.request("GET", address.path if path is None else path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body


async def listen(url: str, count: int, **headers: str) -> list[bytes]:
    """The first messages of a socket."""
    request = HTTPRequest(
        url.replace("http", "ws") + "frames",
        headers=headers,
        connect_timeout=PATIENCE_S,
        request_timeout=PATIENCE_S,
    )
    connection = await websocket_connect(request)
    messages = [await asyncio.wait_for(connection.read_message(), PATIENCE_S) for _ in range(count)]
    connection.close()
    while await asyncio.wait_for(connection.read_message(), PATIENCE_S) is not None:
        pass  # frames under way
    return messages


def unpacked(frame: bytes) -> tuple[dict, np.ndarray]:
    (length,) = struct.unpack_from("<I", frame)
    return json.loads(frame[4 : 4 + length]), np.frombuffer(frame, "<f4", offset=4 + length).reshape(-1, 10)


# ---------------------------------------------------------------- what a frame says


def moments(scenario):
    seen = []
    result = cp.simulate(scenario, build_controller(scenario), view=seen.append, realtime_rate=math.inf)
    return seen, result


def test_an_observer_sees_what_the_result_holds(scenario):
    seen, result = moments(scenario)
    for name in (
        "interaction_wrench",
        "internal_wrench",
        "desired_internal_wrench",
        "external_wrench",
        "tip_position",
        "configuration",
    ):
        assert_allclose(
            [getattr(moment, name) for moment in seen], result.data[name].values, rtol=0, atol=1e-12
        )
    assert_allclose(
        [moment.jacobian_condition for moment in seen], result.data["jacobian_condition"].values, rtol=1e-9
    )
    assert_allclose(
        [moment.payload_pose[:3, 3] for moment in seen],
        result.data["payload_position"].values,
        rtol=0,
        atol=0,
    )
    assert [moment.time for moment in seen] == list(result.data["time"].values)
    with pytest.raises(ValueError, match="read-only"):
        seen[0].configuration[0] = 1.0


class Dozing:
    """Leaves every moment out that it may leave out."""

    def __init__(self):
        self.shown = []

    def __call__(self, moment):
        pass

    def show(self, moment):
        self.shown.append(moment.time)


def test_the_last_moment_of_a_run_is_shown_however_fast_it_went_by(scenario):
    view = Dozing()
    result = cp.run(scenario, view=view, realtime_rate=math.inf)
    assert view.shown == [result.end]


def test_watching_changes_nothing(scenario):
    _, watched = moments(scenario)
    alone = cp.simulate(scenario, build_controller(scenario))
    assert watched.data.identical(alone.data)


def test_arrows_of_a_frame_are_the_wrenches_of_its_moment(scenario):
    scene = LiveScene(*standing_scenario(scenario))
    seen, _ = moments(scenario)
    told, rows = unpacked(scene.frame(seen[-1]).packed())
    row = dict(zip(scene.nodes, rows, strict=True))
    for group, per_metre, axes in (
        ("forces", scene.scales[0], slice(0, 3)),
        ("moments", scene.scales[1], slice(3, 6)),
    ):
        for index, arm in enumerate(scenario.cell.arms):
            internal = np.nan_to_num(seen[-1].internal_wrench)[index, axes]
            load = np.nan_to_num(seen[-1].interaction_wrench)[index, axes] - internal
            for part, wanted in (("internal", internal), ("load", load)):
                path = f"{group}/{arm}/{part}"
                along = Rotation.from_quat(row[path][3:7]).apply((0.0, 0.0, 1.0))
                length = row[f"{path}/head"][2] + HEAD_LENGTH_M * row[f"{path}/head"][9]
                assert_allclose(length * along, wanted / per_metre, rtol=1e-5, atol=1e-6)
                assert_allclose(row[path][:3], seen[-1].tip_position[index], atol=1e-6)
            assert np.linalg.norm(internal) > 0.01  # there was something to draw
    assert_allclose(row["payload"][:3], seen[-1].payload_pose[:3, 3], atol=1e-6)
    assert told["time"] == seen[-1].time
    assert_allclose(
        told["position_error"], np.linalg.norm(seen[-1].payload_pose[:3, 3] - seen[-1].desired_pose[:3, 3])
    )
    assert_allclose(
        told["internal"], np.linalg.norm(np.nan_to_num(seen[-1].internal_wrench)[:, :3], axis=1).max()
    )


def test_a_standing_cell_knows_which_rows_a_run_will_determine(scenario):
    seen, _ = moments(scenario)
    standing = standing_scenario(scenario).moment
    assert_array_equal(np.isnan(standing.interaction_wrench), np.isnan(seen[0].interaction_wrench))
    assert_array_equal(np.isnan(standing.internal_wrench), np.isnan(seen[0].internal_wrench))


def test_a_cell_without_determined_moments_has_no_arrows_for_them(scenario):
    standing = standing_scenario(scenario)
    unknown = np.array((0.0, 0.0, 0.0, np.nan, np.nan, np.nan)) * np.ones((2, 1))
    scene = LiveScene(
        *standing._replace(
            moment=standing.moment._replace(interaction_wrench=unknown, internal_wrench=unknown)
        )
    )
    assert scene.scales.newton_metres_per_metre is None
    assert not [path for path in scene.nodes if path.startswith("moments/")]
    assert "moment: " not in live_html("cell", scene, scene.frame(standing.moment))


def test_a_view_opens_for_a_cell_a_scenario_and_a_result(scenario):
    result = cp.run(scenario)
    for what in (
        spatial_cell().replace(payload_pose=SPATIAL_START),
        planar_scenario().cell,
        scenario,
        result,
        "adept-paper",
    ):
        view = open_view(what)
        status, page = ask(view.url)
        view.close()
        assert status == 200
        assert b"coopPinStage" in page


# ---------------------------------------------------------------- who may look


def test_the_server_listens_on_loopback_only(server):
    port = urllib.parse.urlsplit(server.url).port
    listening = [
        line.split()[1:4]
        for name in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
    ]
    assert [
        address for address, _, state in listening if state == "0A" and address.endswith(f":{port:04X}")
    ] == [f"0100007F:{port:04X}"]


def test_a_chosen_port_is_served_and_given_back(scenario):
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = found.getsockname()[1]
        with pytest.raises(
            PortTakenError,
            match=rf"^port {port} of 127\.0\.0\.1 cannot be used \(Address already in use\); choose another",
        ):
            open_view(scenario, port=port)
    for _ in range(2):  # it can be had again at once
        view = open_view(scenario, port=port)
        assert view.url.startswith(f"http://127.0.0.1:{port}/")
        assert ask(view.url)[0] == 200
        view.close()
    assert not answers(view.url)


@pytest.mark.parametrize("port", [-1, 65536])
def test_numbers_that_no_port_has_are_refused(scenario, port):
    with pytest.raises(PortTakenError, match=f"port {port} "):
        open_view(scenario, port=port)


def test_the_server_answers_its_own_names_and_no_others(server):
    port = urllib.parse.urlsplit(server.url).port
    assert ask(server.url) == (200, b"<p>page</p>")
    assert ask(server.url, Host=f"localhost:{port}")[0] == 200
    strangers = (
        "evil.example",
        f"evil.example:{port}",
        f"127.0.0.1.evil.example:{port}",
        f"192.168.1.1:{port}",
        "",
        "127.0.0.1@evil.example",
    )
    for host in strangers:
        assert ask(server.url, Host=host)[0] in (400, 403)


def test_who_does_not_know_the_secret_sees_nothing(server):
    for path in (
        "/",
        "/frames",
        "/wrong/",
        "/wrong/frames",
        "//",
        f"/x{urllib.parse.urlsplit(server.url).path}",
        "/%2e%2e/",
    ):
        assert ask(server.url, path)[0] == 404


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1.evil.example", "http://127.0.0.1:1"]
)
def test_a_foreign_page_gets_no_frames(server, origin):
    server.send(b"frame")
    assert ask(server.url, Origin=origin)[0] == 403
    with pytest.raises(HTTPClientError, match="403"):
        asyncio.run(listen(server.url, 1, Origin=origin))
    own = server.url.split("/", 3)
    assert asyncio.run(listen(server.url, 1, Origin=f"http://{own[2]}")) == [b"frame"]


def test_a_newcomer_gets_the_latest_frame_at_once(server):
    for number in range(5):
        server.send(b"%d" % number)
    assert eventually(lambda: asyncio.run(listen(server.url, 1)) == [b"4"])


# ---------------------------------------------------------------- what a dead or stuck viewer costs


def test_a_viewer_killed_in_the_middle_of_a_run_costs_one_warning(scenario):
    view = open_view(scenario)
    killed = []

    def kill_in_the_middle(moment) -> None:
        if moment.time > 0.2 and not killed:
            os.kill(view.pid, signal.SIGKILL)
            killed.append(eventually(lambda: not is_there(view.pid)))
        view(moment)

    with pytest.warns(ViewWarning, match=r"ended with code -9\); the simulation goes on") as caught:
        result = cp.simulate(scenario, build_controller(scenario), view=kill_in_the_middle)
    view.close()
    assert killed == [True]
    assert len(caught) == 1
    assert not view.is_alive
    assert result.data.identical(cp.run(scenario).data)


def test_a_viewer_that_hangs_drops_frames_and_nothing_else(scenario):
    view = open_view(scenario)
    os.kill(view.pid, signal.SIGSTOP)
    seen, _ = moments(scenario)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        start = time.monotonic()
        while not view.dropped:  # the pipe is full at some point, and nobody waits for it
            view.show(seen[-1])
        view.show(seen[0])
        spent = time.monotonic() - start
    view.close()  # a hanging process is killed
    assert spent < 2.0
    assert not is_there(view.pid)


def test_frames_come_whole_after_a_hang(server):
    os.kill(server.pid, signal.SIGSTOP)
    big = os.urandom(300_000)
    assert server.send(big)
    assert not server.send(b"dropped")
    os.kill(server.pid, signal.SIGCONT)
    assert eventually(lambda: server.send(b"last"))
    assert eventually(lambda: asyncio.run(listen(server.url, 1)) == [b"last"])


def test_without_a_process_to_be_had_there_is_a_warning_and_a_run(scenario, monkeypatch):
    def refuse(*_, **__):
        raise OSError("no more processes")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with pytest.warns(ViewWarning, match="no more processes"):
        view = open_view(scenario)
    assert cp.run(scenario, view=view, realtime_rate=math.inf).end == scenario.duration
    assert view.url == ""


def test_a_closed_view_is_silent(scenario):
    view = open_view(scenario)
    view.close()
    view.close()
    moment = standing_scenario(scenario).moment
    view.show(moment)
    view(moment)
    assert view.sent == 0
    assert not is_there(view.pid)
    assert not answers(view.url)


def test_rates_must_be_positive(scenario):
    with pytest.raises(OutOfRangeError, match="frames_per_second"):
        open_view(scenario, frames_per_second=0.0)
    with pytest.raises(OutOfRangeError, match="realtime_rate"):
        cp.run(scenario, realtime_rate=-1.0)


# ---------------------------------------------------------------- nobody is outlived

PARENT = """
import os, sys, time
from coop_pin.viz.live_server import ViewServer
server = ViewServer("page")
if sys.argv[1] == "forked" and os.fork() == 0:  # somebody else keeps our end of the pipe open
    time.sleep(60)
    os._exit(0)
print(server.pid, server.url, flush=True)
if sys.argv[1] == "leaves":
    sys.exit()
time.sleep(60)
"""


@pytest.mark.parametrize(
    ("how", "number"),
    [
        ("stays", signal.SIGKILL),
        ("stays", signal.SIGTERM),
        ("stays", signal.SIGINT),
        ("forked", signal.SIGKILL),
        ("leaves", None),
    ],
)
def test_the_server_dies_with_its_parent(how, number):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, how],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    pid, url = parent.stdout.readline().split()
    assert ask(url)[0] == 200
    if number is not None:
        parent.send_signal(number)
    parent.wait(PATIENCE_S)
    assert eventually(lambda: not is_there(int(pid)))
    assert not answers(url)
    if how == "forked":
        os.killpg(parent.pid, signal.SIGKILL)
    parent.stdout.close()


def test_a_forgotten_view_gives_its_process_and_port_back():
    server = ViewServer("page")
    pid, url = server.pid, server.url
    assert ask(url)[0] == 200
    del server
    assert eventually(lambda: not is_there(pid))
    assert not answers(url)


def test_ctrl_c_in_the_terminal_does_not_reach_the_view(server):
    assert os.getpgid(server.pid) != os.getpgid(0)


def test_the_process_loads_neither_pinocchio_nor_meshcat_nor_files_of_the_working_directory(tmp_path):
    (tmp_path / "tornado.py").write_text("raise SystemExit('the wrong tornado')")
    code = textwrap.dedent("""
        import urllib.request
        from coop_pin.viz.live_server import ViewServer
        server = ViewServer("page")
        print(urllib.request.urlopen(server.url, timeout=20).read().decode())
        loaded = open(f"/proc/{server.pid}/maps").read()
        print([name for name in ("pinocchio", "numpy", "matplotlib") if name in loaded])
    """)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.split("\n")[:2] == ["page", "[]"]


@pytest.mark.slow
def test_1500_reconnections(server):
    server.send(b"frame")

    async def reconnect() -> None:
        for _ in range(1500):
            assert await listen(server.url, 1) == [b"frame"]

    asyncio.run(reconnect())
    assert eventually(
        lambda: len(list(Path(f"/proc/{server.pid}/fd").iterdir())) < 30
    )  # what was opened is closed again
    assert ask(server.url)[0] == 200


# ---------------------------------------------------------------- realtime_rate


def test_simulated_time_never_runs_ahead_of_the_wall():
    scenario = planar_scenario().replace(duration=0.5, events=())
    start, ahead = [], []

    def watch(moment) -> None:
        start.append(time.monotonic())
        ahead.append(moment.time / 2.0 - (time.monotonic() - start[0]))

    cp.run(scenario, view=watch, realtime_rate=2.0)
    assert max(ahead) < 0.02
    assert time.monotonic() - start[0] > 0.24
