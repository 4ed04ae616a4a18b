"""The page on laws: what is not traced is refused, and what it says to write in its place is traced."""

import functools

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.compiled import support

LAW = """
import functools

import numpy as np

import coop_pin as cp


class Law(cp.ArmController):
    def __init__(self, scenario, arm):
        self.rows = scenario.cell.task_rows

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        J, e = measurement.payload_jacobian, self.rows.pose_error(measurement.payload_pose, reference.pose)
        return cp.ArmCommand(-J.T @ e * 0.0 + ({value}), state)
"""
WAYS = {
    "1.0 if e[0] > 0 else 2.0": "cp.numbers.where(e[0] > 0, 1.0, 2.0)",
    "max(e[0], e[1])": "np.maximum(e[0], e[1])",
    "np.linalg.pinv(J)[0]": "(J.T @ np.linalg.inv(J @ J.T))[0]",
    "np.linalg.pinv(J)[1]": "(np.linalg.inv(J.T @ J) @ J.T)[1]",
    "np.linalg.solve(J, e)": "np.linalg.inv(J) @ e",
    "np.linalg.det(J)": "np.dot(np.cross(J[0], J[1]), J[2])",
    "np.max(e)": "functools.reduce(np.maximum, e)",
    "np.mean(e)": "e.sum() / len(e)",
    "np.hypot(e[0], e[1])": "cp.numbers.sqrt(e[0] * e[0] + e[1] * e[1])",
    "np.arctan(e[0])": "np.arctan2(e[0], 1.0)",
    "np.arcsin(e[0])": "np.arctan2(e[0], cp.numbers.sqrt(1 - e[0] * e[0]))",
    "np.tan(e[0])": "np.sin(e[0]) / np.cos(e[0])",
    "e[0] ** 3": "e[0] * e[0] * e[0]",
    "np.log10(2.0 + e[0])": "np.log(2.0 + e[0]) / np.log(10.0)",
    "np.round(e[0], 3)": "np.round(1000 * e[0]) / 1000",
    "np.any([e[0] > 0, e[1] > 0]) * 1.0": "np.where((e[0] > 0) | (e[1] > 0), 1.0, 0.0)",
    "float(e[0])": "np.stack([e[0], 0.0, 0.0])[0]",
}
"""What is refused, and what has the same value in its place."""


CASES = [
    pytest.param(refused, marks=[pytest.mark.gate] * (number % 5 > 0)) for number, refused in enumerate(WAYS)
]


@pytest.mark.parametrize("refused", CASES)
def test_a_way_round_is_traced_and_has_the_same_value(refused, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)  # below which a scenario may name code
    number = [*WAYS].index(refused)
    reasons = []
    for name, value in (("refused", refused), ("traced", WAYS[refused])):
        module = f"way_{name}_{number}"
        (tmp_path / f"{module}.py").write_text(LAW.replace("{value}", value))
        law = cp.UserController(target=f"{module}:Law")
        reasons.append(support(cp.Scenario.load("adept-anchored", {"controller": law, "events": ()})))
    assert reasons[0] is not None
    assert reasons[1] is None
    e, J = np.array([0.2, -0.1, 0.3]), np.array([[1.0, 0.2, 0.0], [0.1, 2.0, 0.3], [0.0, 0.4, 1.5]])
    names = {"e": e, "J": J, "np": np, "cp": cp, "functools": functools}
    assert_allclose(eval(WAYS[refused], names), eval(refused, names))
