"""Internal force under law (23), contrary to the paper's Theorem 3; and when the squeeze is exact."""

import numpy as np
import pytest
from cells import SCENARIOS, random_velocity
from close import assert_close
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import DivergedError
from coop_pin.base.spatial import internal_wrenches, rotate_vector6
from coop_pin.grasps import CellChain
from coop_pin.model import ArmModel

QUIET = {"events": [], "duration": 10.0}


def force_error(**changes):
    fields = QUIET | {key.replace("__", "."): value for key, value in changes.items()}
    return cp.run("adept-paper", fields, warn=False, engine="compiled").internal_force(
        window=(4.0, fields["duration"])
    )


@pytest.mark.parametrize("shares", [(0.5, 0.5), (0.3, 0.7)])
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_squeeze_is_what_the_torques_say(cell, moving, shares):
    """Torques by eq. (13), tau = M qdd + h - J^T (f_d + delta), squeeze by f_d, at rest and in motion."""
    scenario = SCENARIOS[cell]()
    described = scenario.cell.replace(load_shares=dict(zip(scenario.cell.arms, shares, strict=True)))
    chain = CellChain(described)
    q = chain.configuration(scenario.start.matrix)
    v = random_velocity(chain.mechanism, q, 1) * moving
    rows = described.task_rows
    X, V = chain.payload_pose(q), chain.payload_twist(q, v)
    acceleration = rows.expand(np.linspace(-1, 2, rows.size)) * moving
    payload, R = described.payload, X[:3, :3]
    inertia = R @ payload.inertia_matrix @ R.T
    gravity = np.array(described.gravity) * (rows.name == "full")
    force = payload.mass * (acceleration[:3] - gravity)
    moment = inertia @ acceleration[3:] + np.cross(V[3:], inertia @ V[3:])
    f_d = rotate_vector6(R, scenario.squeeze_wrenches)
    tau = np.zeros(chain.mechanism.model.nv)
    for place, share, squeeze in zip(chain.model.arms, shares, f_d, strict=True):
        arm = ArmModel(described.arms[place.name], described.grasps[place.name].matrix)
        J = rows.select(arm.payload_jacobian(q[place.q_slice]))
        drift = rows.select(arm.payload_acceleration_bias(q[place.q_slice], v[place.v_slice]))
        a = np.linalg.solve(J, rows.select(acceleration) - drift)
        on_arm = squeeze - share * np.concatenate((force, moment))
        tau[place.v_slice] = (
            arm.mass_matrix(q[place.q_slice]) @ a
            + arm.nonlinear_effects(q[place.q_slice], v[place.v_slice])
            - J.T @ rows.select(on_arm)
        )
    internal = internal_wrenches(chain.interaction_wrenches(q, v, tau), described.shares)
    for actual, wanted in zip(internal, f_d, strict=True):
        assert_close(rows.select(actual), rows.select(wanted), atol=2e-8)


def test_static_squeeze_of_the_paper():
    """-10 N along the line from tip 1 to tip 2, alpha = 0, at rest."""
    start = cp.Scenario.load("adept-paper").start.model_dump()
    result = cp.run(
        "adept-paper",
        QUIET
        | {"motion": {"kind": "hold", "pose": start}, "controller.gains.sign_gain": 0.0, "duration": 5.0},
        warn=False,
    )
    force = result.internal_force(window=(4.0, 5.0))
    assert_close([force.axial_mean, force.axial_rms_error, force.shear_rms], [-10.0, 0.0, 0.0], atol=1e-9)


ALPHAS = (0.0, 0.05, 0.2, 1.0)


@pytest.mark.parametrize(
    ("rate", "steps", "duration", "alphas"),
    [
        (80.0, 5, 6.0, ALPHAS),
        *(pytest.param(rate, 1, 6.0, ALPHAS, marks=pytest.mark.slow) for rate in (400.0, 2000.0)),
    ],
)
def test_internal_force_error_grows_with_alpha(rate, steps, duration, alphas):
    """Theorem 3 states zero. The rms error grows with alpha at every control rate, from nearly zero."""
    errors = [
        force_error(
            controller__gains__sign_gain=alpha,
            clock__rate_hz=rate,
            clock__steps_per_tick=steps,
            duration=duration,
        ).force_rms_error
        for alpha in alphas
    ]
    assert errors == sorted(errors)
    assert errors[0] < 0.15
    assert errors[-1] > 30 * errors[0]


@pytest.mark.parametrize(
    "path",
    [{"kind": "late"}, {"kind": "low-pass", "pole": 0.9}],
)
def test_force_gain_only_divides_by_one_plus_itself(path):
    """ "Larger K_f converges faster": it is the static factor 1 / (1 + K_f)."""
    gains = [0.0, 0.5, 0.9] if path["kind"] == "late" else [0.0, 1.0, 9.0]
    errors = [
        force_error(
            controller__force_path=path,
            controller__gains__force_gain=gain,
            controller__gains__sign_gain=0.0,
            duration=6.0,
        ).force_rms_error
        for gain in gains
    ]
    assert_allclose(np.array(errors) * (1 + np.array(gains)), errors[0], rtol=0.06)


def test_late_force_feedback_diverges_beyond_its_bound():
    """One tick late, ftilde[k+1] = -K_f ftilde[k]: 1.1 runs away, 0.9 does not."""
    late = {"controller.force_path": {"kind": "late"}, "beyond_bound": True}
    with pytest.raises(DivergedError) as caught:
        cp.run("adept-paper", QUIET | late | {"controller.gains.force_gain": 1.1}, warn=False)
    assert 0.0 < caught.value.time < 10.0
    assert caught.value.result.end == pytest.approx(caught.value.time)
    assert (
        force_error(
            controller__force_path={"kind": "late"}, controller__gains__force_gain=0.9
        ).force_rms_error
        < 2.5
    )


@pytest.mark.parametrize(("pole", "inside", "outside"), [(0.0, 0.9, 1.1), (0.5, 2.7, 3.3), (0.9, 17.0, 21.0)])
def test_force_gain_bound_is_sharp(pole, inside, outside):
    """(1 + p) / (1 - p)."""
    path = {"kind": "low-pass", "pole": pole}
    assert (
        force_error(
            controller__force_path=path, controller__gains__force_gain=inside, duration=5.0
        ).force_rms_error
        < 2.5
    )
    with pytest.raises(DivergedError):
        force_error(controller__force_path=path, controller__gains__force_gain=outside, beyond_bound=True)


def test_kinematic_bias_winds_the_sign_integral_up():
    """0.1 mm in one arm: with alpha > 0 internal force ramps, with alpha = 0 it stays."""

    def error_over_time(alpha):
        changes = {
            "events": [],
            "controller.gains.sign_gain": alpha,
            "cell.arms.left.calibration_error.tip.xyz": [1e-4, 0.0, 0.0],
        }
        data = cp.run("adept-paper", changes, warn=False, engine="compiled").data
        error = np.nan_to_num((data.internal_wrench - data.desired_internal_wrench).values)[:, 0, :3]
        return np.linalg.norm(error, axis=1)

    ramp, flat = error_over_time(0.2), error_over_time(0.0)
    seconds = (np.array([4, 8, 12, 16, 20]) * 80).tolist()
    assert np.all(np.diff(ramp[seconds]) > 3.0)
    assert ramp[-1] > 30.0
    assert flat[320:].max() < 0.15
