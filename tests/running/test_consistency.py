"""Findings before seeded runs: none that ends off or diverges begins without an error or a warning."""

import numpy as np
import pytest

import coop_pin as cp
from coop_pin.running.check import quick_findings
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

CELLS = (
    *("adept-anchored", "adept-compliant", "adept-paper", "baxter-box", "five-joint-pair", "human-partner"),
    *(
        "kinova-pair",
        "panda-ur5-bar",
        "three-ur5-far",
        "three-ur5-plate",
        "two-pandas-box",
        "two-ur5-admittance",
    ),
)
FIELDS = (
    *(f"controller.gains.{gain}_gain" for gain in ("pose", "sliding", "sign", "anchor", "damping")),
    *("controller.gains.admittance_damping", "controller.posture.stiffness", "controller.posture.damping"),
    *("clock.rate_hz", "cell.payload.mass", "squeeze.force"),
)
OFF = 20e-3
"""Position error at the end of a run from which on it is off, m."""


def value_of(scenario, path):
    for part in path.split("."):
        scenario = getattr(scenario, part, None)
    return scenario


def changed_cell(rng):
    """A cell of the catalogue without its events, one or two of its fields times 0.3 to 3."""
    while True:
        scenario = cp.Scenario.load(str(rng.choice(CELLS))).replace(events=())
        stated = {path: value_of(scenario, path) for path in FIELDS}
        fields = rng.permutation([path for path, value in stated.items() if value is not None])
        factors = 3.0 ** rng.uniform(-1.0, 1.0, size=rng.integers(1, 3))
        changes = {
            str(path): (factor * np.array(stated[path])).tolist()
            for path, factor in zip(fields, factors, strict=False)
        }
        if "clock.rate_hz" in changes:
            changes["clock.rate_hz"] = round(changes["clock.rate_hz"])
        try:
            changed = scenario.override({**changes, "beyond_bound": True})
            return changed.replace(duration=min(6.0, changed.duration)), changes
        except cp.CoopPinError:  # such as a rate that a servo does not divide
            continue


def is_lost(scenario):
    """Whether a run diverges, is not sound, or ends off."""
    try:
        result = cp.run(scenario, engine="compiled", warn=False)
    except cp.CoopPinError:
        return True
    end = np.linalg.norm(result.data.pose_error.values[-1, :3])
    cut = any(deviation.cause == "torque cut" for deviation in result.task.deviations)
    return bool(result.breaches()) or cut or end > OFF


def silent_losses(seed, count):
    """Changes of cells whose run is lost without an error or a warning before it."""
    rng, silent = np.random.default_rng(seed), []
    for _ in range(count):
        scenario, changes = changed_cell(rng)
        findings = quick_findings(Simulation(scenario, build_controller(scenario)))
        is_warned = len(findings.of("error", "warning")) + len(implausible_numbers(scenario))
        if not is_warned and is_lost(scenario):
            silent.append((scenario.name, changes))
    return silent


def test_no_run_of_a_sample_is_lost_without_a_finding():
    assert silent_losses(seed=3, count=4) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 110))
def test_no_run_of_three_hundred_is_lost_without_a_finding(seed):
    assert silent_losses(seed, count=30) == []
