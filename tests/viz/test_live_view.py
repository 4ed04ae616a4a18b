"""Live view: its frames against the run, access control, failures of the viewer, end of its process."""

import asyncio
import http.client
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
from cells import SCENARIOS, SPATIAL_START, planar_scenario, spatial_cell, spatial_scenario
from numpy.testing import assert_allclose, assert_array_equal
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import coop_pin as cp
from coop_pin.base.errors import OutOfRangeError, PortTakenError, RunInterruptedError, ViewWarning
from coop_pin.description.catalogue import scenario_names
from coop_pin.simulation.build_controller import build_controller
from coop_pin.viz import LiveView
from coop_pin.viz.live.live_scene import LiveScene, initial_scene
from coop_pin.viz.live.live_server import LiveServer
from coop_pin.viz.live.live_view import open_view

PATIENCE_S = 20.0


@pytest.fixture(params=SCENARIOS, scope="module")
def scenario(request):
    return SCENARIOS[request.param]().replace(duration=0.5, events=())


@pytest.fixture
def planar():
    """A cell without meshes, for what does not depend on the cell: a page with meshes takes a second."""
    return planar_scenario().replace(duration=0.5, events=())


@pytest.fixture
def server():
    server = LiveServer("<p>page</p>")
    yield server
    server.close()


def eventually(condition) -> bool:
    """Whether a condition becomes true within a time-out that is long enough for slow machines."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False


def is_there(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def accepts_connections(url: str) -> bool:
    address = urllib.parse.urlsplit(url)
    try:
        socket.create_connection((address.hostname, address.port), timeout=1).close()
    except OSError:
        return False
    return True


def get(url: str, path: str | None = None, **headers: str) -> tuple[int, bytes]:
    address = urllib.parse.urlsplit(url)
    connection = http.client.HTTPConnection(address.hostname, address.port, timeout=PATIENCE_S)
    connection.request("GET", address.path if path is None else path, headers=headers)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response.status, body


async def listen(url: str, count: int, **headers: str) -> list[bytes]:
    """The first messages of a WebSocket."""
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


def unpacked(scene: LiveScene, frame: bytes) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Blocks of a frame, and time and values of the curves."""
    values, blocks, start = np.frombuffer(frame, "<f4").astype(float), {}, 0
    for name, width in scene.frames.blocks.items():
        blocks[name] = values[start : start + width]
        start += width
    return blocks, values[start:]


# ---------------------------------------------------------------- frames


def snapshots(scenario):
    seen = []
    result = cp.simulate(scenario, build_controller(scenario), view=seen.append, realtime_rate=math.inf)
    return seen, result


def test_snapshots_are_the_samples_of_the_result(scenario):
    seen, result = snapshots(scenario)
    for name in (
        "interaction_wrench",
        "internal_wrench",
        "desired_internal_wrench",
        "external_wrench",
        "tip_position",
        "configuration",
    ):
        assert_allclose(
            [getattr(snapshot, name) for snapshot in seen], result.data[name].values, rtol=0, atol=1e-12
        )
    assert_allclose(
        [snapshot.jacobian_condition for snapshot in seen],
        result.data["jacobian_condition"].values,
        rtol=1e-9,
    )
    assert_allclose(
        [snapshot.payload_pose[:3, 3] for snapshot in seen],
        result.data["payload_position"].values,
        rtol=0,
        atol=0,
    )
    assert [snapshot.time for snapshot in seen] == list(result.data["time"].values)
    with pytest.raises(ValueError, match="read-only"):
        seen[0].configuration[0] = 1.0


class ShowsLastOnly:
    """Observer that leaves out every snapshot that it may leave out."""

    def __init__(self):
        self.shown = []

    def __call__(self, snapshot):
        pass

    def show(self, snapshot):
        self.shown.append(snapshot.time)


def test_the_last_snapshot_of_a_run_is_always_shown(scenario):
    view = ShowsLastOnly()
    result = cp.run(scenario, view=view, realtime_rate=math.inf, warn=False)
    assert view.shown == [result.end]


def test_an_observer_does_not_change_the_result(scenario):
    _, watched = snapshots(scenario)
    alone = cp.simulate(scenario, build_controller(scenario))
    assert watched.data.identical(alone.data)


def test_a_frame_has_the_wrenches_poses_and_curves_of_its_snapshot(scenario):
    scene = LiveScene(initial_scene(scenario))
    seen, result = snapshots(scenario)
    last = seen[-1]
    blocks, curves = unpacked(scene, scene.frame(last))
    for block, wrench in (
        ("interaction", last.interaction_wrench),
        ("internal", last.internal_wrench),
        ("wanted", last.desired_internal_wrench),
        ("external", last.external_wrench),
    ):
        assert_allclose(blocks[block], np.nan_to_num(wrench).ravel(), rtol=1e-6, atol=1e-12)
    assert np.abs(blocks["internal"]).max() > 1.0  # there was something to draw
    assert_allclose(blocks["tips"], last.tip_position.ravel(), atol=1e-6)
    poses = dict(zip(scene.frames.nodes, blocks["poses"].reshape(-1, 7), strict=True))
    assert_allclose(poses["payload"][:3], last.payload_pose[:3, 3], atol=1e-6)
    assert_allclose(poses["desired"][:3], last.desired_pose[:3, 3], atol=1e-6)
    assert_allclose([blocks["time"][0], curves[0]], last.time, rtol=1e-6)
    end = result.data.isel(time=-1)
    found = {(curve.plot, curve.role): value for curve, value in zip(scene.curves, curves[1:], strict=True)}
    for part in ("axial", "shear", "moment"):
        assert_allclose(found[part, "actual"], end[f"internal_{part}"].values[0], rtol=1e-5, atol=1e-6)
        assert_allclose(
            found[part, "desired"], end[f"desired_internal_{part}"].values[0], rtol=1e-5, atol=1e-6
        )


def test_the_hand_of_a_partner_is_at_the_point_that_it_moves_while_it_holds(scenario):
    """Where the handle would be if the payload moved as the partner wants; before and after there is none."""
    tilt = (0.0, 0.0, 0.5) if scenario.cell.rows == "planar" else (0.3, -0.2, 0.5)
    start, handle = scenario.start, cp.Pose(xyz=(0.05, -0.08, 0.0), rpy=tilt)
    motion = cp.motions.TurnMotion(pose=start, axis=(0, 0, 1), angle=0.05, duration=0.3)
    partner = cp.events.Partner(
        time=0.1, duration=0.2, motion=motion, handle=handle, stiffness=6 * (80.0,), damping=6 * (1.0,)
    )
    scenario = scenario.replace(events=(partner,))
    scene, (seen, _) = LiveScene(initial_scene(scenario)), snapshots(scenario)
    moved = 0.0
    for snapshot in seen[:: len(seen) // 10]:
        blocks, _ = unpacked(scene, scene.frame(snapshot))
        pose = dict(zip(scene.frames.nodes, blocks["poses"].reshape(-1, 7), strict=True))["hand"]
        holds = partner.time <= snapshot.time < partner.end
        assert (blocks["warnings"][scene.frames.nodes.index("hand")] == 0) == holds  # else none is drawn
        if holds:
            X_WG = motion.at(snapshot.time).X_WP_d @ handle.matrix
            assert_allclose(pose[:3], X_WG[:3, 3], atol=1e-6)
            moved = max(moved, np.linalg.norm(pose[:3] - (snapshot.payload_pose @ handle.matrix)[:3, 3]))
    assert moved > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_names())
def test_a_view_draws_the_first_ticks_of_every_scenario(name):
    scenario, seen = cp.Scenario.load(name), []

    def stop(tick, _total):
        if tick == 4:
            raise KeyboardInterrupt

    with pytest.raises(RunInterruptedError):
        cp.run(scenario, view=seen.append, realtime_rate=math.inf, progress=stop, warn=False)
    scene = LiveScene(initial_scene(scenario))
    assert len({len(scene.frame(snapshot)) for snapshot in seen}) == 1
    assert len(seen) == 5


def test_the_initial_snapshot_has_nan_in_the_rows_that_a_run_does_not_determine(scenario):
    seen, _ = snapshots(scenario)
    initial = initial_scene(scenario).snapshot
    assert_array_equal(np.isnan(initial.interaction_wrench), np.isnan(seen[0].interaction_wrench))
    assert_array_equal(np.isnan(initial.internal_wrench), np.isnan(seen[0].internal_wrench))


def test_a_cell_without_determined_moments_has_no_arrows_for_them(scenario):
    initial = initial_scene(scenario)
    unknown = np.array((0.0, 0.0, 0.0, np.nan, np.nan, np.nan)) * np.ones((2, 1))
    snapshot = initial.snapshot._replace(interaction_wrench=unknown, internal_wrench=unknown)
    initial = initial._replace(snapshot=snapshot)
    scene, view = LiveScene(initial), LiveView(initial)
    view.close()
    assert scene.scales.newton_metres_per_metre is None
    assert '"moments": null' in view.page()


def test_a_view_opens_for_a_cell_a_scenario_and_a_result(planar):
    for what in (
        spatial_cell().replace(payload_pose=SPATIAL_START),
        planar.cell,
        planar,
        cp.run(spatial_scenario().replace(duration=0.5, events=()), warn=False),
        "adept-paper",
    ):
        view = open_view(what)
        status, page = get(view.url)
        view.close()
        assert status == 200
        assert b"coopPinStage" in page


# ---------------------------------------------------------------- access control


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


def test_the_secret_is_not_in_the_arguments_that_every_user_can_read(server):
    secret = urllib.parse.urlsplit(server.url).path.strip("/")
    assert len(secret) > 20
    for file in ("cmdline", "environ"):
        assert secret.encode() not in Path(f"/proc/{server.process.pid}/{file}").read_bytes()


def test_a_chosen_port_is_served_and_given_back(planar):
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = found.getsockname()[1]
        with pytest.raises(PortTakenError) as caught:
            open_view(planar, port=port)
        assert caught.value.port == port
    for _ in range(2):  # it is free again at once
        view = open_view(planar, port=port)
        assert view.url.startswith(f"http://127.0.0.1:{port}/")
        assert get(view.url)[0] == 200
        view.close()
    assert not accepts_connections(view.url)


@pytest.mark.parametrize("port", [-1, 65536])
def test_invalid_port_numbers_are_refused(planar, port):
    with pytest.raises(PortTakenError) as caught:
        open_view(planar, port=port)
    assert caught.value.port == port


def test_the_server_accepts_its_own_names_and_no_others(server):
    port = urllib.parse.urlsplit(server.url).port
    assert get(server.url) == (200, b"<p>page</p>")
    assert get(server.url, Host=f"localhost:{port}")[0] == 200
    foreign = (
        "evil.example",
        f"evil.example:{port}",
        f"127.0.0.1.evil.example:{port}",
        f"192.168.1.1:{port}",
        "",
        "127.0.0.1@evil.example",
    )
    for host in foreign:
        assert get(server.url, Host=host)[0] in (400, 403)


def test_requests_without_the_secret_are_refused(server):
    for path in (
        "/",
        "/frames",
        "/wrong/",
        "/wrong/frames",
        "//",
        f"/x{urllib.parse.urlsplit(server.url).path}",
        "/%2e%2e/",
    ):
        assert get(server.url, path)[0] == 404


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1.evil.example", "http://127.0.0.1:1"]
)
def test_a_foreign_page_gets_no_frames(server, origin):
    server.send(b"frame")
    assert get(server.url, Origin=origin)[0] == 403
    with pytest.raises(HTTPClientError, match="403"):
        asyncio.run(listen(server.url, 1, Origin=origin))
    own = server.url.split("/", 3)
    assert asyncio.run(listen(server.url, 1, Origin=f"http://{own[2]}")) == [b"frame"]


def test_a_new_browser_gets_the_run_so_far_at_once(server):
    frames = [struct.pack("<ff", 0.1 * number, number) for number in range(5)]
    for frame in frames:
        server.send(frame)
    assert eventually(lambda: asyncio.run(listen(server.url, 1)) == [b"".join(frames)])
    server.send(frames[1])  # earlier than the last one: a new run
    assert eventually(lambda: asyncio.run(listen(server.url, 1)) == [frames[1]])


# ---------------------------------------------------------------- failures of the viewer


def test_a_viewer_killed_during_a_run_causes_one_warning(planar):
    view = open_view(planar)
    assert view.server is None  # nobody has asked for the address
    assert view.url
    killed = []

    def kill_in_the_middle(snapshot) -> None:
        if snapshot.time > 0.2 and not killed:
            os.kill(view.server.process.pid, signal.SIGKILL)
            killed.append(eventually(lambda: not is_there(view.server.process.pid)))
        view(snapshot)

    with pytest.warns(ViewWarning, match="code -9") as caught:
        result = cp.simulate(planar, build_controller(planar), view=kill_in_the_middle)
    view.close()
    assert killed == [True]
    assert len(caught) == 1
    assert not view.is_alive
    assert result.data.identical(cp.run(planar, warn=False).data)


def test_a_viewer_that_hangs_drops_frames_and_nothing_else(planar):
    view = open_view(planar)
    assert view.url
    os.kill(view.server.process.pid, signal.SIGSTOP)
    seen, _ = snapshots(planar)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        start = time.monotonic()
        while not view.dropped:  # until the pipe is full; sending never blocks
            view.show(seen[-1])
        view.show(seen[0])
        spent = time.monotonic() - start
    view.close()  # a hanging process is killed
    assert spent < 2.0
    assert not is_there(view.server.process.pid)


def test_frames_come_whole_after_a_hang(server):
    os.kill(server.process.pid, signal.SIGSTOP)
    big = os.urandom(300_000)
    assert server.send(big)
    assert not server.send(b"dropped")
    os.kill(server.process.pid, signal.SIGCONT)
    assert eventually(lambda: server.send(b"last"))
    assert eventually(lambda: asyncio.run(listen(server.url, 1))[0].endswith(b"last"))


def test_a_run_goes_on_with_a_warning_if_no_process_can_be_started(planar, monkeypatch):
    def refuse(*_, **__):
        raise OSError("no more processes")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    view = open_view(planar)
    with pytest.warns(ViewWarning, match="no more processes"):
        assert view.url == ""
    assert cp.run(planar, view=view, realtime_rate=math.inf, warn=False).end == planar.duration


def test_a_closed_view_is_silent(planar):
    view = open_view(planar)
    url = view.url
    view.close()
    view.close()
    snapshot = initial_scene(planar).snapshot
    view.show(snapshot)
    view(snapshot)
    assert view.sent == 0
    assert view.url == url
    assert not is_there(view.server.process.pid)
    assert not accepts_connections(url)


def test_rates_must_be_positive(planar):
    with pytest.raises(OutOfRangeError) as caught:
        open_view(planar, frames_per_second=0.0)
    assert (caught.value.name, caught.value.value) == ("frames_per_second", 0.0)
    with pytest.raises(OutOfRangeError) as caught:
        cp.run(planar, realtime_rate=-1.0, warn=False)
    assert (caught.value.name, caught.value.value) == ("realtime_rate", -1.0)


# ---------------------------------------------------------------- end of the process

PARENT = """
import os, sys, time
from coop_pin.viz.live.live_server import LiveServer
server = LiveServer("page")
if sys.argv[1] == "forked" and os.fork() == 0:  # another process keeps the pipe open
    time.sleep(60)
    os._exit(0)
print(server.process.pid, server.url, flush=True)
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
def test_the_server_ends_with_its_parent(how, number):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, how],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    pid, url = parent.stdout.readline().split()
    assert get(url)[0] == 200
    if number is not None:
        parent.send_signal(number)
    parent.wait(PATIENCE_S)
    assert eventually(lambda: not is_there(int(pid)))
    assert not accepts_connections(url)
    if how == "forked":
        os.killpg(parent.pid, signal.SIGKILL)
    parent.stdout.close()


def test_an_unreferenced_server_frees_its_process_and_port():
    server = LiveServer("page")
    pid, url = server.process.pid, server.url
    assert get(url)[0] == 200
    del server
    assert eventually(lambda: not is_there(pid))
    assert not accepts_connections(url)


def test_ctrl_c_in_the_terminal_does_not_reach_the_view(server):
    assert os.getpgid(server.process.pid) != os.getpgid(0)


def test_the_process_loads_neither_pinocchio_nor_meshcat_nor_files_of_the_working_directory(tmp_path):
    (tmp_path / "tornado.py").write_text("raise SystemExit('the wrong tornado')")
    code = textwrap.dedent("""
        import urllib.request
        from coop_pin.viz.live.live_server import LiveServer
        server = LiveServer("page")
        print(urllib.request.urlopen(server.url, timeout=20).read().decode())
        loaded = open(f"/proc/{server.process.pid}/maps").read()
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
        lambda: len(list(Path(f"/proc/{server.process.pid}/fd").iterdir())) < 30
    )  # what was opened is closed again
    assert get(server.url)[0] == 200


# ---------------------------------------------------------------- realtime_rate


def test_simulated_time_never_runs_ahead_of_wall_time(planar):
    start, ahead = [], []

    def watch(snapshot) -> None:
        start.append(time.monotonic())
        ahead.append(snapshot.time / 2.0 - (time.monotonic() - start[0]))

    cp.run(planar, view=watch, realtime_rate=2.0, warn=False)
    assert max(ahead) < 0.02
    assert time.monotonic() - start[0] > 0.24
