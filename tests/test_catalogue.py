"""Every cell of the catalogue carries its payload along a path under gravity by a payload-space law."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.model import ArmModel

PAYLOAD_SPACE = {
    "controller": {
        "kind": "payload-space",
        "gains": {"pose_gain": 2, "sliding_gain": [800, 800, 40], "sign_gain": 0.2, "transient_rate": 5},
    },
    "events": [],
    "duration": 10.0,
}
CHANGES = {name: PAYLOAD_SPACE if name == "adept-paper" else {} for name in cp.scenario_names()}


@pytest.fixture(scope="module", params=CHANGES)
def result(request):
    return cp.run(request.param, CHANGES[request.param])


def smallest_singular_value(result):
    """Of every arm's payload Jacobian in the task rows, every quarter of a second."""
    cell, rows = result.scenario.cell, result.scenario.cell.task_rows
    every = max(1, round(0.25 / float(result.data.time[1])))
    place, values = 0, []
    for name, arm in cell.arms.items():
        model = ArmModel(arm, cell.grasps[name].matrix)
        angles = result.data.configuration.values[::every, place : place + model.nq]
        place += model.nq
        values += [
            np.linalg.svd(rows.select(model.payload_jacobian(q)), compute_uv=False)[-1] for q in angles
        ]
    return min(values)


def test_cell_does_its_work(result):
    assert result.end == 10.0
    moved = np.ptp(result.data.payload_position.values, axis=0)
    assert np.linalg.norm(moved) > 0.05
    assert result.position_rms() < 2e-3
    assert result.settling_time() < 3.0
    assert not [
        violation for violation in result.limit_violations() if violation.kind in ("position", "velocity")
    ]
    assert smallest_singular_value(result) > 0.05
    assert max(result.closure_error_max()) < 1e-8
    assert result.energy_balance_max() < 1e-5
    assert result.verdict() == "trustworthy"


def test_squeeze_is_near_what_is_desired(result):
    """What friction and weight leave is divided by 1 + K_f where the scenario measures forces."""
    force = result.internal_force()
    assert force.axial_mean < -4.0
    assert force.force_rms_error < 3.0


@pytest.mark.parametrize("name", cp.scenario_names())
def test_payload_free_or_rooted_is_the_same_mechanism(name):
    """The same path and wrenches; tanh in place of sgn, which turns rounding into different sequences."""
    smooth = {"duration": 0.2, "events": [], "controller.switching": {"kind": "tanh", "width": 0.05}}
    welded, free = (cp.run(name, smooth | {"plant.payload": payload}).data for payload in ("welded", "free"))
    assert_allclose(free.payload_position.values, welded.payload_position.values, atol=1e-8)
    difference = (free.interaction_wrench - welded.interaction_wrench).values
    assert_allclose(np.nan_to_num(difference), 0.0, atol=1e-4)
