"""The mean-pose law: poses cure a bias, wrenches cure friction."""

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from tiers import by_default

import coop_pin as cp
from coop_pin.base.spatial import make_pose
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.control import ArmMeasurement, PayloadSpace
from coop_pin.simulation.build_controller import build_controller
from coop_pin.stability import steady_errors

LAW = {"kind": "mean-pose", "switching": {"kind": "saturation", "width": 10.0}}
ANCHORED_LAW = {"kind": "payload-space", "force_path": {"kind": "late"}}
ROUGH = {"coulomb": 2.0, "stiction": 3.0}


def mean_pose(cell, gamma, k_I_width, **fields):
    """The law with K of a cell and no wrench."""
    K = list(cp.Scenario.load(cell).controller.gains.sliding_gain)
    gains = {"pose_gain": gamma, "sign_gain": k_I_width, "anchor_gain": 0.0, "transient_rate": 5.0}
    return LAW | {"gains": gains | {"sliding_gain": K}} | fields


def anchored(cell, gamma, alpha, g):
    K = list(cp.Scenario.load(cell).controller.gains.sliding_gain)
    gains = {"pose_gain": gamma, "sign_gain": alpha, "anchor_gain": g, "transient_rate": 5.0}
    return ANCHORED_LAW | {"gains": gains | {"sliding_gain": K}}


def tip_of(cell, bias=1e-3):
    first = next(iter(cp.Scenario.load(cell).cell.arms))
    return {f"cell.arms.{first}.calibration_error.tip.xyz": [bias, 0.0, 0.0]}


def judged(cell, controller, changes, duration=5.0):
    """Position, mm, and internal-force error, N, rms from 0.4 of the run on."""
    scenario = benchmark_scenario(cp.Scenario.load(cell), duration)
    result = cp.run(scenario, {"controller": controller} | changes, warn=False, engine="compiled")
    window = (0.4 * duration, duration)
    return 1e3 * result.position_rms(window=window), result.internal_force(window=window).force_rms_error


@pytest.mark.parametrize("cell", SCENARIOS)
def test_the_torque_is_the_payload_space_law_at_the_mean_by_hand(cell):
    """Mean of positions, of rotation vectors from the desired attitude, and of twists."""
    fields = ANCHORED[cell].model_dump(exclude={"kind", "force_path"})
    scenario = SCENARIOS[cell]().override({"events": [], "controller": {"kind": "mean-pose"} | fields})
    controller = build_controller(scenario)
    alone = build_controller(
        scenario.replace(controller=PayloadSpace(**fields | {"gains": gains_of(scenario)}))
    )
    run = cp.Simulation(scenario, controller)
    references, rng = run.references(0.0), np.random.default_rng(3)
    X_d, k_0 = references[0].pose, scenario.cell.task_rows.size
    planar = k_0 == 3
    turns = [rng.normal(size=3) * (0.0, 0.0, 0.3) if planar else 0.3 * rng.normal(size=3) for _ in references]
    shifts = [rng.normal(size=3) * (0.01, 0.01, 0.0 if planar else 0.01) for _ in references]
    seen = [
        ArmMeasurement(
            0.0,
            rng.normal(size=law.arm.drives),
            rng.normal(size=law.arm.drives),
            placed(X_d, shift, turn),
            rng.normal(size=k_0),
            rng.normal(size=(k_0, law.arm.drives)) + 2.0 * np.eye(k_0, law.arm.drives),
            None,
            np.zeros(law.arm.drives, dtype=bool),
        )
        for law, shift, turn in zip(alone.controllers.values(), shifts, turns, strict=True)
    ]
    X = placed(X_d, np.mean(shifts, axis=0), np.mean(turns, axis=0))
    V = np.mean([each.payload_twist for each in seen], axis=0)
    agreed = [each._replace(payload_pose=X, payload_twist=V) for each in seen]
    state, expected = controller.init(seen, references), alone.init(agreed, references)
    for _ in range(2):
        command, by_hand = (
            controller.step(seen, references, state),
            alone.step(agreed, references, expected),
        )
        assert_allclose(np.concatenate(command.torques), np.concatenate(by_hand.torques), rtol=1e-11)
        state, expected = command.state, by_hand.state
        seen, agreed = later(seen), later(agreed)


def gains_of(scenario):
    """The gains with the leak that the mean-pose law has: none."""
    return scenario.controller.gains.replace(leak=0.0)


def placed(X_d, shift, turn):
    return make_pose(X_d[:3, 3] + shift) @ np.block(
        [[Rotation.from_rotvec(turn).as_matrix() @ X_d[:3, :3], np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]]
    )


def later(measurements):
    return [each._replace(time=0.01) for each in measurements]


def test_what_it_needs_crosses_and_a_bias_leaves_no_force():
    law = mean_pose("adept-anchored", 7.2, 115.5)
    scenario = cp.Scenario.load("adept-anchored").override({"controller": law, "events": []})
    assert scenario.controller.needs == ("poses of all arms", "holding torque")
    found = steady_errors(scenario, bias=1e-3)
    assert found.force == 0.0
    assert found.product == 0.0
    assert found.wrenches == 0
    assert scenario.controller.active_gains["leak"] == 0.0
    measured = scenario.override({"controller.force_path": {"kind": "late"}, "sensors.wrist": {}})
    assert measured.controller.needs == ("poses of all arms", "holding torque", "internal wrench")


def test_poses_cure_a_bias_and_wrenches_cure_friction():
    """With the gains of payload-pi and of the anchored law at 4824ca2."""
    cell, law = "adept-anchored", mean_pose("adept-anchored", 7.19894, 115.522)
    assert_allclose(judged(cell, law, tip_of(cell)), [0.504, 0.105], rtol=0.01)
    arms = cp.Scenario.load(cell).cell.arms
    rough = {f"cell.arms.{name}.friction.{field}": value for name in arms for field, value in ROUGH.items()}
    _, by_pose = judged(cell, law, rough)
    _, by_wrench = judged(cell, anchored(cell, 6.38034, 0.53399, 0.0500622), rough)
    assert by_pose > 5.0 * by_wrench


@pytest.mark.slow
def test_no_drift_in_a_minute():
    law = mean_pose("adept-anchored", 7.19894, 115.522)
    _, early = judged("adept-anchored", law, tip_of("adept-anchored"), 20.0)
    position, late = judged("adept-anchored", law, tip_of("adept-anchored"), 60.0)
    assert_allclose([early, position], [0.0787, 0.5], rtol=0.01)
    assert late < 0.01


@pytest.mark.parametrize("cell", by_default(SCENARIOS, "planar"))
def test_a_bias_leaves_no_force_that_grows(cell):
    """Each arm on its own view pulls harder by the second; on the mean of all views it does not."""
    fields = ANCHORED[cell].model_dump(exclude={"kind", "force_path"})
    fields["gains"] |= {"leak": 0.0, "anchor_gain": 0.0}
    scenario = SCENARIOS[cell]().override({"events": [], "duration": 1.0})
    arm = next(iter(scenario.cell.arms))
    bias = {f"cell.arms.{arm}.calibration_error.tip.xyz": [1e-3, 0.0, 0.0]}
    growth = {}
    for kind in ("payload-space", "mean-pose"):
        law = {"controller": {"kind": kind} | fields}
        force, without = (
            cp.run(scenario, law | change, warn=False, engine="compiled").data.internal_axial_error
            for change in (bias, {})
        )
        caused = np.abs((force - without).sel(time=[0.5, 1.0], method="nearest").values)
        growth[kind] = float(np.max(caused[1] - caused[0]))
    assert growth["payload-space"] > 0.2
    assert abs(growth["mean-pose"]) < 0.05 * growth["payload-space"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "gains", "wrench_gains", "force"),
    [
        ("two-pandas-box", (1.01932, 173.616), (7.66324, 0.235618, 0.0252397), 0.049),
        ("panda-ur5-bar", (1.12452, 163.272), (2.76738, 0.225837, 0.0202697), 0.039),
        ("three-ur5-plate", (1.00439, 189.11), (2.76738, 0.225837, 0.0202697), 0.050),
        ("kinova-pair", (1.24677, 198.318), (2.76738, 0.225837, 0.0202697), 0.008),
        ("five-joint-pair", (7.89657, 197.473), (7.94812, 0.935176, 0.113315), 1.12),
    ],
)
def test_in_the_cells_in_space(cell, gains, wrench_gains, force):
    """Forces within a tenth, and tracking within a quarter of the anchored law's, with gains of 4824ca2.

    The five-joint arms turn their spare joints with the motion: no spring pulls them back.
    """
    law = mean_pose(cell, *gains)
    if cell == "five-joint-pair":
        law["posture"] = {"stiffness": 0.0}
    position, found = judged(cell, law, tip_of(cell))
    by_wrench, _ = judged(cell, anchored(cell, *wrench_gains), tip_of(cell))
    assert_allclose(found, force, rtol=0.1)
    assert position < 1.25 * by_wrench
