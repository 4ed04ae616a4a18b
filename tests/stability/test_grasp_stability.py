"""Grasps that give: limits of the plant's steps, and stable ranges of the stiffness by known radii."""

import importlib
import math

import numpy as np
import pytest
from cells import SCENARIOS
from compliant_cells import anchored, with_grasps
from numpy.testing import assert_allclose

from coop_pin.base.errors import ArgumentError
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import LoopStability, grasp_stability, loop_stability, step_stability
from coop_pin.stability.grasp_stability import _GraspLoop
from coop_pin.stability.modes import Mode
from coop_pin.stability.step_stability import plant_matrix

steps = importlib.import_module("coop_pin.stability.step_stability")


def on_springs(name):
    scenario = with_grasps(anchored(name), "paper")
    return Simulation(scenario, build_controller(scenario))


def step_limit(s):
    """Largest h with |R(h s)| <= 1, R(x) = 1 + x + x^2/2 + x^3/6 + x^4/24, as roots of a polynomial in h."""
    R = np.array([s**4 / 24.0, s**3 / 6.0, s**2 / 2.0, s, 1.0])
    edges = np.roots(np.polysub(np.polymul(R, R.conj()).real, [1.0]))
    return min(root.real for root in edges if abs(root.imag) < 1e-7 * abs(root) and root.real > 1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_step_limit_is_where_a_root_of_runge_kutta_leaves_the_unit_circle(name, monkeypatch):
    """Of the poles of springs and friction; of others, of which one that is slower has a smaller limit."""
    simulation = on_springs(name)
    found, clock = step_stability(simulation), simulation.scenario.clock
    A, N = plant_matrix(simulation.chain, simulation.plant.q)
    h, poles = clock.period / clock.steps_per_tick, np.linalg.eigvals(A)
    worst = max((s for s in poles if abs(s) > 1.0), key=lambda s: abs(s) * h / step_limit(s))
    assert_allclose((found.value, found.limit), (h * abs(worst), abs(worst) * step_limit(worst)), rtol=1e-3)
    swings = 0.97e5 * np.exp(1j * np.deg2rad(125.0))
    A = -np.eye(len(A))
    A[0, 0], A[1:3, 1:3] = -1e5, [[swings.real, swings.imag], [-swings.imag, swings.real]]
    monkeypatch.setattr(steps, "plant_matrix", lambda *_, **__: (A, N))
    found = step_stability(simulation)
    assert_allclose((found.value, found.limit), (h * 0.97e5, 0.97e5 * step_limit(swings)), rtol=1e-3)
    assert found.limit < 0.95 * 2.785293563405282


def test_stable_ranges_of_the_stiffness_are_those_of_its_radii(monkeypatch):
    """Holds from the last edge on; of the ranges below it the widest by its ratio."""
    simulation, ranges = on_springs("planar"), ((1.5, 2.5), (5.0, 40.0), (60.0, math.inf))

    def radius(_loop, factor):
        return 0.99 if any(low < factor < high for low, high in ranges) else 1.01

    monkeypatch.setattr(_GraspLoop, "radius", radius)
    found = grasp_stability(simulation)
    assert (found.ok, found.radius) == (False, 1.01)
    assert_allclose(found.holds_from, 60.0, rtol=2e-3)
    assert_allclose(found.window, (5.0, 40.0), rtol=2e-3)
    ranges = ((0.5, 3.0), (4.0, 5e4))  # stiffer than 1e5 is not looked at
    assert grasp_stability(simulation).holds_from == 1.0
    ranges = ((2.0, 3.0), (1e4, 1.1e5))
    found = grasp_stability(simulation)
    assert_allclose(found.holds_from, 1e4, rtol=2e-3)
    assert_allclose(found.window, (2.0, 3.0), rtol=2e-3)
    ranges = ((2.0, 3.0), (1e4, 0.9e5))
    found = grasp_stability(simulation)
    assert found.holds_from == math.inf
    assert_allclose(found.window, (1e4, 0.9e5), rtol=2e-3)


@pytest.mark.parametrize("name", SCENARIOS)
def test_each_stability_is_of_its_own_kind_of_grasp(name):
    scenario = anchored(name)
    with pytest.raises(ArgumentError, match="compliant"):
        loop_stability(on_springs(name))
    with pytest.raises(ArgumentError, match="rigid"):
        grasp_stability(Simulation(scenario, build_controller(scenario)))


@pytest.mark.parametrize(
    ("z", "is_spare", "remedy"),
    [
        (1.01 + 0.0j, False, "Raise controller.gains.pose_gain"),
        (1.01 + 0.0j, True, "Raise controller.posture.stiffness"),
        (0.8 + 0.7j, True, "Raise controller.posture.stiffness"),  # it swings, slower than the ticks
        (0.8 + 0.7j, False, "Lower the gains"),
        (-1.2 + 0.0j, False, "Lower the gains"),
        (-1.2 + 0.0j, True, "Lower controller.posture"),
    ],
)
def test_what_cures_a_motion_that_grows_goes_by_where_its_mode_is(z, is_spare, remedy):
    mode = Mode(z, "motion of left/1", 0.01, ("left/1",), is_spare)
    loop = LoopStability(abs(z), 0.0, 0.0, mode, mode, mode, None, 0.01, "controller.posture.stiffness")
    assert not loop.ok
    assert remedy in loop.summary()


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_factor_of_the_stiffness_is_that_of_the_springs_themselves(name):
    """Springs four times as stiff, with the wrenches that they feed back, at the same damping ratios."""
    radii = []
    for stiffness in (3e4, 1.2e5):
        size = (stiffness,) * 3 + (stiffness / 100.0,) * 3
        scenario = with_grasps(anchored(name), size, damping_ratio=0.4)
        weightless = {"cell.gravity": (0.0, 0.0, 0.0), "controller.gains.force_gain": 5.0}
        scenario = scenario.override(weightless | {"squeeze": {}, "beyond_bound": True})
        loop = _GraspLoop(Simulation(scenario, build_controller(scenario)))
        radii.append(loop.radius(1.2e5 / stiffness))
    assert_allclose(radii[0] - 1.0, radii[1] - 1.0, rtol=1e-6)
    assert abs(loop.radius(4.0) - radii[1]) > 1e-5
