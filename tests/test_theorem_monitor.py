"""Theorem monitor: its identities close, and it marks where the paper's proof breaks."""

import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.analysis import theorem_monitor
from coop_pin.errors import ArgumentError
from coop_pin.figures import theorem_figure


def moving(name, alpha):
    """A run of half a second with measured force; the spatial cell starts off its target too."""
    scenario = SCENARIOS[name]().replace(duration=0.5, events=())
    changes = {"controller.gains.sign_gain": alpha, "controller.gains.force_gain": 0.5}
    changes["controller.force_path.kind"] = "late"
    if name == "spatial":
        changes["motion"] = {"kind": "hold", "pose": {"xyz": [0.45, 0.07, 0.42], "rpy": [0.3, -0.1, 0.5]}}
    return cp.run(scenario, changes)


@pytest.fixture(scope="module", params=SCENARIOS)
def run_and_monitor(request):
    result = moving(request.param, 0.2)
    return result, theorem_monitor(result)


def test_the_rate_of_v_is_the_sum_of_its_terms(run_and_monitor):
    _, monitor = run_and_monitor
    scale = float(np.abs(monitor["V_rate"]).max())
    assert scale > 0.1
    assert float(np.abs(monitor["V_rate_defect"]).max()) < 1e-6 * scale
    assert float(monitor["residual_21"].max()) < 1e-12
    # one gamma, one K_f and one x: the paper's sum of V_rate_2 vanishes
    terms = np.abs(monitor["V_rate_2"]).max()
    assert float(np.abs(monitor["V_rate_2_sum"]).max()) < 1e-6 * float(terms)


def test_identity_14_closes_without_friction_in_q(run_and_monitor):
    _, monitor = run_and_monitor
    printed = float(np.abs(monitor["friction_defect_14"]).max())
    assert printed > 0.01
    assert float(np.abs(monitor["identity_14"]).max()) < 1e-6 * printed


def test_the_internal_force_is_what_equation_25_says(run_and_monitor):
    result, monitor = run_and_monitor
    error = result.data["internal_wrench"] - result.data["desired_internal_wrench"]
    assert float(monitor["balance_25"].max()) < 1e-6 * float(np.abs(error).max())


def test_the_figure_has_its_four_panels(run_and_monitor):
    figure = theorem_figure(*run_and_monitor)
    assert len(figure.axes) == 4
    assert all(axes.lines for axes in figure.axes)


def test_the_monitor_marks_where_the_proof_breaks():
    """With the sign integral Vdot_3 is positive most of the time, without it never after the transient."""
    marked = {}
    for alpha in (0.0, 0.2):
        result = cp.run("adept-paper", {"controller.gains.sign_gain": alpha, "duration": 4.0, "events": ()})
        monitor = theorem_monitor(result)
        marked[alpha] = float(monitor["V_rate_3_is_positive"].sel(time=slice(3.5, None)).mean())
    assert marked[0.0] == 0.0
    assert marked[0.2] > 0.9


def test_other_laws_and_thinned_runs_are_refused():
    with pytest.raises(ArgumentError):
        theorem_monitor(cp.run("two-pandas-box", {"duration": 0.02}))
    with pytest.raises(ArgumentError):
        theorem_monitor(cp.run("adept-paper", {"duration": 0.1, "clock.record_every": 2, "events": ()}))
