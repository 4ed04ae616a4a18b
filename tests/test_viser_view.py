"""The view through viser shows what the one through meshcat shows, on this machine only, and gives its port back."""

import io
import socket
import sys
import time
import urllib.parse
from contextlib import closing
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from browser import browser_page
from cells import SCENARIOS
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from test_live_view import answers

import coop_pin as cp
from coop_pin.errors import MissingExtraError, NotPositiveError, PortTakenError
from coop_pin.model.visuals import CellVisuals
from coop_pin.viz.arrows import HEAD_LENGTH_M
from coop_pin.viz.live_scene import LiveScene
from coop_pin.viz.meshes import cone_mesh
from coop_pin.viz.palette import SATURATED, SINGULAR
from coop_pin.viz.scene import Segments
from coop_pin.viz.standing import standing_scenario
from coop_pin.viz.trail import MOST_POINTS, Trail
from coop_pin.viz.viewer import Viewer


@pytest.fixture(params=SCENARIOS)
def scenario(request):
    return SCENARIOS[request.param]().replace(duration=0.3, events=())


@pytest.fixture
def view(scenario):
    pytest.importorskip("viser", reason="viser is not installed: pip install 'coop-pin[viser]'")
    view = cp.viz.open_viser(scenario)
    yield view
    view.close()


def nodes(view) -> dict:
    """Everything in viser's scene, by name."""
    return view.server.scene._handle_from_node_name


def last_moment(scenario, view):
    seen = []

    def watch(moment) -> None:
        seen.append(moment)
        view(moment)

    cp.run(scenario, view=watch, pace=float("inf"))
    view.show(seen[-1])
    return seen[-1]


def test_everything_of_the_scene_is_a_node_of_viser(scenario, view):
    live = LiveScene(*standing_scenario(scenario))
    kinds = {"Box": "BoxHandle", "Cylinder": "CylinderHandle", "Sphere": "IcosphereHandle"}
    for item in live.scene.items:
        kind = "LineSegmentsHandle" if isinstance(item.drawable, Segments) else kinds.get(type(item.drawable).__name__, "MeshHandle")
        assert type(nodes(view)[f"/{item.path}"]).__name__ == kind
    assert {f"/{path}" for path in live.nodes} <= set(nodes(view))
    camera = view.server.initial_camera
    assert_allclose(camera.position, live.scene.camera.eye)
    assert_allclose(camera.look_at, live.scene.camera.target)


def test_arrows_are_those_of_the_other_view_and_of_the_run(scenario, view):
    moment, live = last_moment(scenario, view), LiveScene(*standing_scenario(scenario))
    rows = dict(zip(live.nodes, live.frame(moment).rows, strict=True))
    for group, per_metre, axes in (("forces", live.scales[0], slice(0, 3)), ("moments", live.scales[1], slice(3, 6))):
        for index, arm in enumerate(scenario.cell.arms):
            path = f"{group}/{arm}/internal"
            node, head, body = (nodes(view)[f"/{name}"] for name in (path, f"{path}/head", f"{path}/head/body"))
            assert_allclose(node.position, rows[path][:3], rtol=0, atol=1e-12)
            assert_allclose(node.position, moment.tip_position[index], rtol=0, atol=1e-12)
            assert_allclose(node.wxyz, np.roll(rows[path][3:7], 1), rtol=0, atol=1e-12)
            along = Rotation.from_quat(np.roll(node.wxyz, -1)).apply((0.0, 0.0, 1.0))
            length = head.position[2] + HEAD_LENGTH_M * body.scale[2]
            wanted = np.nan_to_num(moment.internal_wrench)[index, axes] / per_metre
            assert_allclose(length * along, wanted, rtol=1e-9, atol=1e-6)
            shaft = nodes(view)[f"/{path}/shaft/body"]
            assert_allclose(shaft.scale, rows[f"{path}/shaft"][7:], rtol=0, atol=1e-12)
            assert_allclose(shaft.position[2], 0.5 * shaft.scale[2], rtol=1e-12)  # it stands on the arrow's origin
    second = nodes(view)["/moments/left/internal/head/second"]
    assert_allclose(second.position[2], 0.5 * HEAD_LENGTH_M * second.scale[2], rtol=1e-12)


def test_bodies_ghost_trail_and_clock_follow_the_run(scenario, view):
    moment = last_moment(scenario, view)
    assert_allclose(nodes(view)["/payload"].position, moment.payload_pose[:3, 3], rtol=0, atol=1e-12)
    turn = Rotation.from_quat(np.roll(nodes(view)["/payload"].wxyz, -1)).as_matrix()
    assert_allclose(turn, moment.payload_pose[:3, :3], rtol=0, atol=1e-12)
    assert_allclose(nodes(view)["/desired"].position, moment.desired_pose[:3, 3], rtol=0, atol=1e-12)
    assert nodes(view)["/desired/shape"].opacity == 0.35
    assert type(nodes(view)["/trails/actual"]).__name__ == "LineSegmentsHandle"
    assert f"t = {moment.time:.2f} s" in view._clock.content


def test_links_are_tinted_and_get_their_colour_back(view, scenario):
    moment = standing_scenario(scenario).moment
    saturated, singular = moment.saturated.copy(), moment.jacobian_condition.copy()
    saturated[0, 0], singular[0] = True, 1e4
    joint = CellVisuals(scenario.cell, scenario.plant.payload).joints["left"][0]
    link = next(handle for name, handle in nodes(view).items() if name.startswith(f"/arms/left/{joint}/"))
    own = link.color
    for shown, colour in (
        (moment._replace(saturated=saturated), SATURATED),
        (moment._replace(jacobian_condition=singular), SINGULAR),
        (moment, None),
    ):
        view.show(shown)
        wanted = own if colour is None else tuple(bytes.fromhex(colour[1:]))
        assert tuple(link.color) == tuple(wanted)


def test_watching_through_viser_changes_nothing(scenario, view):
    assert cp.run(scenario, view=view).data.identical(cp.run(scenario).data)


@pytest.mark.parametrize("kind", [cp.viz.LiveView, cp.viz.ViserView])
def test_both_views_do_what_a_viewer_does(kind):
    asked = {name for name in dir(Viewer) if not name.startswith("_")} | {"__call__"}
    assert asked == {"url", "is_alive", "show", "close", "__call__"}
    for name in asked:
        assert isinstance(getattr(kind, name), property) == isinstance(getattr(Viewer, name), property)


def test_it_listens_on_loopback_only_and_the_port_is_gone_after_close(scenario, view):
    port = urllib.parse.urlsplit(view.url).port
    listening = [line.split()[1:4] for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    assert [address for address, _, state in listening if state == "0A" and address.endswith(f":{port:04X}")] == [f"0100007F:{port:04X}"]
    assert answers(view.url)
    assert view.is_alive
    url = view.url
    view.close()
    view.close()
    view(standing_scenario(scenario).moment)  # shows nothing, and raises nothing
    assert not view.is_alive
    patience = time.monotonic() + 60.0
    while answers(url) and time.monotonic() < patience:  # on a busy machine viser's thread ends a moment after it was told to
        time.sleep(0.05)
    assert not answers(url)


def test_a_chosen_port_is_taken_or_refused():
    pytest.importorskip("viser", reason="viser is not installed: pip install 'coop-pin[viser]'")
    scenario = SCENARIOS["planar"]()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PortTakenError, match=rf"port {port} of 127\.0\.0\.1 cannot be had \(Address already in use\)"):
            cp.viz.open_viser(scenario, port=port)
    view = cp.viz.open_viser(scenario, port=port)
    assert view.url == f"http://127.0.0.1:{port}/"
    view.close()
    with pytest.raises(NotPositiveError, match="frames_per_second"):
        cp.viz.open_viser(scenario, frames_per_second=0.0)


def test_without_viser_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'coop-pin\[viser\]'"):
        cp.viz.open_viser("adept-paper")


@pytest.mark.slow
def test_a_browser_draws_the_cell_and_its_arrows():
    pytest.importorskip("viser", reason="viser is not installed: pip install 'coop-pin[viser]'")
    scenario = SCENARIOS["planar"]().replace(duration=1.0, events=())
    with closing(cp.viz.open_viser(scenario)) as view, browser_page() as page:
        page.goto(view.url)
        moment = last_moment(scenario, view)
        page.get_by_text(f"t = {moment.time:.2f} s").wait_for()
        page.wait_for_selector("canvas")
        for _ in range(200):  # it fetches its parts one after the other
            page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            red, green, blue, *_ = np.moveaxis(matplotlib.image.imread(io.BytesIO(page.screenshot()))[150:, 330:860], -1, 0)
            orange = (red > 0.5) & (green < 0.7 * red) & (blue < 0.35 * red)  # internal forces, lit or in the shade
            if orange.sum() > 200:
                break
        assert orange.sum() > 200


# ---------------------------------------------------------------- what only viser needs


def test_a_trail_keeps_its_distance_and_starts_again_with_the_clock():
    trail = Trail()
    for step in range(100):
        trail.follow(0.01 * step, np.array((0.001 * step, 0.0, 0.0)))
    segments = trail.segments()
    assert_array_equal(segments[1:, 0], segments[:-1, 1])
    assert_allclose(np.diff(segments, axis=1)[..., 0], 0.004, atol=1e-3 + 1e-12)
    assert_allclose(segments[0, 0], 0.0)
    trail.follow(0.0, np.ones(3))
    assert trail.segments().shape == (0, 2, 3)
    for step in range(2 * MOST_POINTS):
        trail.follow(1.0 + step, np.array((float(step), 0.0, 0.0)))
    assert MOST_POINTS / 2 <= len(trail.segments()) <= MOST_POINTS


def test_a_cone_is_closed_and_has_its_volume():
    mesh = cone_mesh(0.3, 0.5)
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    volume = np.einsum("ni,ni", a, np.cross(b, c)) / 6.0
    assert_allclose(volume, np.pi * 0.3**2 * 0.5 / 3.0, rtol=0.02)  # faces look outwards; 24 sides are not quite round
    edges = np.sort(np.concatenate((mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]])), axis=1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}
