"""Grasps that give: limits of the plant's steps, and what cures a motion that grows."""

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from compliant_cells import anchored, with_grasps
from numpy.testing import assert_allclose

from coop_pin.base.errors import ArgumentError
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import LoopStability, grasp_stability, loop_stability, step_stability
from coop_pin.stability.modes import Mode
from coop_pin.stability.step_stability import plant_matrix


def on_springs(name):
    scenario = with_grasps(anchored(name), "paper")
    return Simulation(scenario, build_controller(scenario))


def step_limit(s):
    """Largest h with |R(h s)| <= 1, R(x) = 1 + x + x^2/2 + x^3/6 + x^4/24, as roots of a polynomial in h."""
    R = np.array([s**4 / 24.0, s**3 / 6.0, s**2 / 2.0, s, 1.0])
    edges = np.roots(np.polysub(np.polymul(R, R.conj()).real, [1.0]))
    return min(root.real for root in edges if abs(root.imag) < 1e-7 * abs(root) and root.real > 1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_step_limit_is_where_a_root_of_runge_kutta_leaves_the_unit_circle(name):
    """Of the poles of springs and friction."""
    simulation = on_springs(name)
    found, clock = step_stability(simulation), simulation.scenario.clock
    A = plant_matrix(simulation.chain, simulation.plant.q)[0]
    h, poles = clock.period / clock.steps_per_tick, np.linalg.eigvals(A)
    worst = max((s for s in poles if abs(s) > 1.0), key=lambda s: abs(s) * h / step_limit(s))
    assert_allclose((found.value, found.limit), (h * abs(worst), abs(worst) * step_limit(worst)), rtol=1e-3)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_stiffness_from_which_a_law_holds_is_the_edge_of_stiffer_springs(name):
    """From springs a third and a tenth as stiff alike; dampers go with the root of the stiffness."""
    edges, rigid = [], SCENARIOS[name]().replace(controller=ANCHORED[name], events=(), beyond_bound=True)

    def stability(k):
        scenario = with_grasps(rigid, (k, k, k, k / 100.0, k / 100.0, k / 100.0))
        return grasp_stability(Simulation(scenario, build_controller(scenario)))

    for k in (3e4, 1e5):
        found = stability(k)
        assert not found.ok
        edges.append(k * found.holds_from)
    assert_allclose(edges[0], edges[1], rtol=1e-2)
    assert stability(1.005 * edges[1]).ok
    assert not stability(0.995 * edges[1]).ok


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
