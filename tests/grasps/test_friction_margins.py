"""Margins of friction: the limit surface of points, pads of rigid grasps, and the least squeeze."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import CoopPinError, FieldError, InfeasibleMotionError
from coop_pin.compiled import support
from coop_pin.feasibility import least_squeeze
from coop_pin.feasibility.least_squeeze import with_enough_squeeze
from coop_pin.figures import friction_figure
from coop_pin.results.friction import friction_text
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.viz.curves import cell_curves
from coop_pin.viz.frames import run_samples

MU, N = 0.5, 40.0


def palms(**changes) -> cp.Scenario:
    """Two Pandas with a crate between their palms, at rest."""
    return cp.Scenario.load(
        "two-pandas-palms", {"motion": {"kind": "hold", "pose": {"xyz": (0, 0, 0.5)}}} | changes
    )


def sliding_loads(points: np.ndarray, pressures: np.ndarray) -> np.ndarray:
    """Wrenches of points that turn about many centres, the middle among them, N and N m, shape (n, 6)."""
    rng, loads = np.random.default_rng(1), []
    for distance in (1e-9, *np.geomspace(1e-3, 10.0, 60)):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        arm = points[:, :2] - distance * np.array((np.cos(angle), np.sin(angle)))
        v = np.stack((-arm[:, 1], arm[:, 0]), axis=1)
        f = -MU * N * pressures[:, None] * v / np.linalg.norm(v, axis=1, keepdims=True)
        (x, y), about = points[:, :2].T, N * pressures @ points[:, :2]
        loads.append((*f.sum(axis=0), N, about[1], -about[0], x @ f[:, 1] - y @ f[:, 0]))
    return np.array(loads)


def friction_by_turning(f: np.ndarray, m: float, points: np.ndarray) -> float:
    """Friction mu N of evenly pressed points, the most work over friction of turns about many centres, N."""
    x, y = (part.ravel() for part in np.meshgrid(*2 * [np.linspace(-0.1, 0.1, 401)]))
    speeds = np.hypot(points[:, 0] - x[:, None], points[:, 1] - y[:, None]).mean(axis=1)
    return float(np.abs((y * f[0] - x * f[1] + m) / speeds).max())


OUTLINES = [{"radius": 0.03}, {"size": (0.04, 0.04)}, {"size": (0.06, 0.02)}]


@pytest.mark.parametrize("outline", OUTLINES)
def test_points_that_slide_need_all_their_friction(outline):
    pad = cp.Pad(mu=MU, **outline)
    loads = sliding_loads(pad.points, np.full(len(pad.points), 1.0 / len(pad.points)))
    need = pad.needed_friction(loads)[1:]
    assert_allclose(need, MU * N, rtol=2e-3)
    assert_allclose(pad.needed_friction(0.3 * loads)[1:], 0.3 * need, rtol=1e-9)
    still = pad.needed_friction(np.array((0.0, 0.0, N, 0.0, 0.0, 0.0)))
    assert_allclose(still, 0.0, atol=1e-12)
    assert np.isfinite(pad.needed_friction(np.full(6, np.nan)))


@pytest.mark.parametrize("outline", OUTLINES)
def test_patches_that_lean_on_their_springs_need_all_their_friction_as_they_slide(outline):
    """Pressed from even to lifted at one side; the springs' forces are those of a plane that is tilted."""
    patch, rng = cp.PatchGrasp(mu=MU, **outline), np.random.default_rng(2)
    for lean in np.linspace(0.0, 1.3, 12):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        depth = 1.0 + lean * patch.points[:, :2] @ (np.cos(angle), np.sin(angle)) / patch.reach.min()
        pressures = np.maximum(depth, 0.0) / np.maximum(depth, 0.0).sum()
        loads = sliding_loads(patch.points, pressures)
        if np.linalg.norm(loads[0, 3:5] / patch.levers) < N:
            assert_allclose(patch.pressures(loads), np.tile(pressures, (len(loads), 1)), atol=1e-9)
            assert_allclose(patch.needed_friction(loads), MU * N, rtol=1e-2)


def test_nine_points_slide_where_a_disc_does_within_three_percent():
    """An ellipsoid of the same force and torsion is 7 % outside."""
    radii, angles = np.sqrt((np.arange(60) + 0.5) / 60) * 0.03, np.arange(90) * 2.0 * np.pi / 90
    points = np.stack([np.outer(radii, f(angles)).ravel() for f in (np.cos, np.sin)], axis=1)
    loads, pad = sliding_loads(points, np.full(5400, 1.0 / 5400)), cp.Pad(mu=MU, radius=0.03)
    ellipsoid = np.hypot(np.linalg.norm(loads[:, :2], axis=1), loads[:, 5] / pad.torsion_radius)
    assert 0.05 < 1.0 - ellipsoid.min() / (MU * N) < 0.075
    assert_allclose(pad.needed_friction(loads), MU * N, rtol=0.03)


@pytest.mark.parametrize("outline", OUTLINES)
def test_points_have_the_torsion_of_evenly_pressed_faces(outline):
    pad, (x, y) = cp.Pad(mu=MU, **outline), np.meshgrid(*2 * [(np.arange(400) + 0.5) / 400 - 0.5])
    a, b = pad.size or (2.0 * pad.radius,) * 2
    r = np.hypot(a * x, b * y)
    mean = r.mean() if pad.size else r[r < pad.radius].mean()
    assert_allclose(pad.torsion_radius, mean, rtol=1e-4)
    stiffness = (pad.points[:, :2] ** 2).mean(axis=0)  # against tilting
    assert_allclose(stiffness, np.array((a, b)) ** 2 / (12.0 if pad.size else 16.0), rtol=0.1)
    assert (np.abs(pad.points[:, :2]).max(axis=0) < pad.reach).all()
    assert (pad.levers <= np.abs(pad.points[:, 1::-1]).max(axis=0)).all()


@pytest.mark.parametrize("size", [(0.04, 0.04), (0.06, 0.02)])
def test_five_points_slide_where_a_rectangle_does_within_six_percent(size):
    x, y = ((np.arange(60) + 0.5) / 60 - 0.5) * np.array(size)[:, None]
    points = np.stack([part.ravel() for part in np.meshgrid(x, y)], axis=1)
    loads = sliding_loads(points, np.full(3600, 1.0 / 3600))
    assert_allclose(cp.Pad(mu=MU, size=size).needed_friction(loads), MU * N, rtol=0.06)


def test_pads_of_rigid_grasps_use_what_patches_use():
    scenario = palms(**{"duration": 0.02, "controller.gains.transient_rate": 20.0})
    patches = cp.run(scenario, warn=False).friction_use()
    pads = {
        name: {"mu": grasp.mu, "radius": grasp.radius, "press": grasp.press}
        for name, grasp in scenario.cell.patches.items()
    }
    cell = scenario.cell.rigid.replace(pads=pads)
    rigid = cp.run(scenario.replace(cell=cell, duration=0.35), warn=False)
    use = rigid.friction_use()
    assert use.arms == patches.arms == ("left", "right")
    assert_allclose(use.normal[-1], 60.0, rtol=1e-2)  # the squeeze has come on
    assert_allclose(use.used[-1], patches.used[0], rtol=2e-2)
    assert np.isinf(use.used[0]).all() or use.used[0].min() > 1.0
    assert "would slip" in rigid.verdict()
    assert_allclose(use.reserve[-1], (use.normal * (1.0 - use.used))[-1], rtol=1e-9)
    assert rigid.metrics()["squeeze_reserve_min_N"] < 0.0
    samples = run_samples(rigid)
    shown = [curve.values(samples) for curve in cell_curves(samples, cell) if curve.plot == "friction"]
    assert_allclose(shown, 100.0 * np.minimum(use.used, 2.0).T)
    drawn = [line.get_ydata() for panel in friction_figure(rigid).axes for line in panel.lines]
    assert_allclose(drawn[0], shown[0])
    assert_allclose(drawn[-2], use.reserve[:, 1])
    assert np.isnan(rigid.dropped_at)
    assert "pads" in (support(rigid.scenario.override({"plant.payload": "welded"})) or "")


def test_least_squeeze_of_a_crate_at_rest():
    found = least_squeeze(palms())
    assert_allclose(found.force, 3.0 * 9.81 / (2.0 * 0.6), rtol=1e-9)
    assert found.ok
    assert found.stated == 60.0
    equal = least_squeeze(palms(**{"controller.force_path.split": "shares"}))
    assert_allclose(equal.force, 3.0 * 9.81 / 2.0 * 0.2 / 0.02, rtol=1e-9)  # r c W on a ring of 20 mm
    assert equal.by_moment
    assert not equal.ok
    assert least_squeeze(cp.Scenario.load("two-pandas-box")) is None


def test_least_squeeze_of_a_crate_that_is_lifted():
    scenario = cp.Scenario.load("two-pandas-palms")
    times = np.linspace(0.0, scenario.duration, 401)
    A = np.array([scenario.motion.at(time).A_WP_d for time in times.tolist()])
    force = np.hypot(A[:, 1], 9.81 + A[:, 2]) * 3.0 / (2.0 * 0.6)
    found = least_squeeze(scenario)
    assert_allclose(found.force, force.max(), rtol=2e-2)  # its turn asks for the rest


@pytest.mark.parametrize("name", ["adept-anchored", "adept-compliant", "two-pandas-box"])
def test_pads_whose_friction_rigid_bodies_leave_open_are_named(name):
    scenario = cp.Scenario.load(name)
    pads = {arm: {"mu": 0.5, "radius": 0.01} for arm in scenario.cell.arms}
    found = implausible_numbers(scenario.replace(cell=scenario.cell.replace(pads=pads)))
    assert any(finding.kind == "pad" for finding in found) == (name == "adept-anchored")


def test_pads_that_cannot_be_are_refused():
    cell = palms().cell
    with pytest.raises(FieldError, match="patch"):
        cell.replace(pads={"left": {"mu": 0.5, "radius": 0.01}})
    for pad in ({"mu": 0.0, "radius": 0.01}, {"mu": 0.5}, {"mu": 0.5, "radius": 0.01, "press": "w"}):
        with pytest.raises(CoopPinError):
            cell.rigid.replace(pads={"left": pad})
    with pytest.raises(FieldError, match="does not have"):
        cell.rigid.replace(pads={"middle": {"mu": 0.5, "radius": 0.01}})


def test_least_squeeze_follows_the_plan_of_the_grasps_and_pushes():
    """Two of three arms press 75 N along the line between their palms, which is 0.175 off the normals."""
    task = cp.Scenario.load("pick-carry-place")
    still = {"motion": {"kind": "hold", "pose": task.start}}
    found = least_squeeze(task.override(still))
    normal = 75.0 / np.hypot(1.0, 0.175)
    y = 0.07 / 2.0
    # Tip forces bear no moment about the line u of two tips: each tip gets half of it, and turns by u_x.
    u, W = np.array((0.4, -0.07, 0.0)) / np.hypot(0.4, 0.07), np.array((0.0, 0.0, -3.0 * 9.81))
    half = u @ -np.cross((0.0, y, 0.0), W) / 2.0 * u[0]
    across = np.array((W[2] / 2.0, 0.175 * normal))
    assert_allclose(found.stated, normal, rtol=2e-2)
    needed = friction_by_turning(across, half, task.cell.patches["second"].points)
    assert_allclose(found.force, needed / 0.6, rtol=0.175**2)  # the moment across the normals is left out
    assert 0.0 < found.use < 1.0
    assert found.time < 7.7  # afterwards a table bears the load
    push = {"kind": "wrench-pulse", "time": 1.0, "duration": 0.5, "wrench": (0.0, 20.0, 0.0, 0.0, 0.0, 0.0)}
    pushed = least_squeeze(palms(events=[push]))
    assert_allclose(pushed.force, np.hypot(3.0 * 9.81, 20.0) / 2.0 / 0.6, rtol=1e-9)


def test_a_squeeze_with_a_margin_is_proposed():
    kept, text = with_enough_squeeze(palms())
    assert (kept, text) == (palms(), ())
    for squeeze in ({"kind": "tip-force", "force": 20.0}, {}):
        raised, text = with_enough_squeeze(palms(squeeze=squeeze))
        assert_allclose(raised.squeeze.force, 1.5 * 3.0 * 9.81 / 1.2, rtol=2e-3)
        assert "36.8 N" in text[0]


@pytest.mark.slow
def test_a_squeeze_off_the_normals_is_raised_too_or_refused():
    task = cp.Scenario.load("pick-carry-place", {"cell.payload.mass": 6.0})
    raised, _ = with_enough_squeeze(task)
    assert_allclose(least_squeeze(raised).use, 1.0 / 1.5, rtol=2e-3)
    slippery = {f"cell.grasps.{arm}.mu": 0.1 for arm in task.cell.arms}
    with pytest.raises(InfeasibleMotionError, match="friction"):  # its squeeze is 0.175 off the normals
        with_enough_squeeze(task.override(slippery))


def test_every_patch_that_opens_or_slides_is_named_with_its_time():
    """Left slides at 0.2 s and opens at 0.4 s, right slides at 0.3 s; both drop the crate at 0.5 s."""
    time = np.linspace(0.0, 0.6, 7)
    F = np.zeros((7, 2, 6))
    F[..., 2] = 20.0
    touches = np.stack((time < 0.35, time < 0.45), axis=1)
    data = {
        "time": time,
        "patch_wrench": F,
        "interaction_wrench": touches[..., None] * F,
        "patch_points": 9.0 * touches,
        "patch_slip": 1e-3 * np.stack((time > 0.15, time > 0.25), axis=1),
    }
    said = friction_text(data, palms())
    parts = (
        "at 0.5 s",
        "of 'left' slides from 0.2 s",
        "of 'right' slides from 0.3 s",
        "of 'left' opens at 0.4 s",
    )
    assert [said.count(part) for part in parts] == [1, 1, 1, 1]
    assert sorted(parts, key=said.index) == list(parts)
