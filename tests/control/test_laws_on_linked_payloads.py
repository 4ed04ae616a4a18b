"""Laws on payloads of several links: wrenches and the controlled pose at rest under a bias."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from linked_cells import linked
from numpy.testing import assert_allclose
from scipy.optimize import root

import coop_pin as cp
from coop_pin.grasps import CellChain
from coop_pin.model import CellArm

CELLS = {"planar": "adept-anchored", "spatial": "two-pandas-box"}
GAMMA, K_I, BETA, RHO, BIAS = 4.0, 4.0, 10.0, 0.3, 1e-3
K = {"planar": [300.0, 300.0, 6.0], "spatial": [400.0] * 3 + [20.0] * 3}
K_D, G_V = {"planar": [80.0, 60.0, 20.0], "spatial": [60.0] * 4 + [6.0, 4.0, 2.0]}, 4.0
FUNNELS, LEAK = (0.02, 0.2), 2.0
DURATION = {"lid": 2.5, "table": 8.0}


def law_of(name: str, cell: str, rate: float) -> dict:
    """Controller of a law; PD where the name does not say otherwise."""
    gains = {"pose_gain": GAMMA, "sliding_gain": K[cell], "sign_gain": 0.0, "anchor_gain": 0.0, "leak": 0.0}
    gains["transient_rate"] = 1e4
    anchored = gains | {"sign_gain": 10.0 * K_I, "anchor_gain": BETA / rate}
    late, wide = {"kind": "late"}, {"kind": "saturation", "width": 10.0}
    sliding = {
        "pose_gain": GAMMA,
        "damping_gain": K_D[cell],
        "sign_gain": 0.0,
        "force_gain": 0.0,
        "transient_rate": 1e4,
    }
    B = [60.0] * (2 if cell == "planar" else 3) + [3.0] * (1 if cell == "planar" else 3)
    return {
        "payload-space": {"kind": "payload-space", "gains": gains, "force_path": {"kind": "none"}},
        "anchored": {
            "kind": "payload-space",
            "gains": anchored,
            "force_path": late,
            "switching": wide,
            "anchor_bias": "none",
        },
        "own wrist": {
            "kind": "payload-space",
            "gains": anchored,
            "force_path": {"kind": "none"},
            "switching": wide,
            "payload_mass": 3.0,
        },
        "leaky": {
            "kind": "payload-space",
            "gains": anchored | {"anchor_gain": 0.0, "leak": LEAK},
            "force_path": {"kind": "none"},
            "switching": wide,
        },
        "symmetric": {
            "kind": "symmetric",
            "gains": gains,
            "relative_gain": RHO,
            "force_path": {"kind": "none"},
        },
        "mean-pose": {"kind": "mean-pose", "gains": gains, "force_path": {"kind": "none"}},
        "prescribed-performance": {
            "kind": "prescribed-performance",
            "gains": {"pose_floor": FUNNELS[0], "velocity_floor": FUNNELS[1], "funnel_rate": 50.0}
            | {"velocity_gain": [4.0 if b > 10.0 else 0.2 for b in B]},
        },
        "leader-follower": {
            "kind": "leader-follower",
            "gains": {"sliding_gain": K[cell], "follower_damping": B, "admittance_damping": B}
            | {"follower_stiffness": [10.0 * b for b in B]},
        },
        "sliding-mode": {
            "kind": "sliding-mode" if cell == "planar" else "sliding-mode-redundant",
            "gains": sliding,
            "force_path": late,
        },
    }[name]


def push(x: np.ndarray, rho: float) -> np.ndarray:
    """r eps / rho of prescribed performance."""
    x = np.clip(x, -0.99 * rho, 0.99 * rho)
    return 2.0 / (1.0 - (x / rho) ** 2) * np.log((1.0 + x / rho) / (1.0 - x / rho)) / rho


class Rest:
    """Payload of links at rest on two arms, by Newton's method on the raw tree of its URDF.

    ::

        g(q) + tau_springs = sum_i J_i^T F_i(e_i),    F_i on the arm about the P that it sees
    """

    def __init__(self, scenario: cp.Scenario) -> None:
        self.scenario, self.rows = scenario, list(scenario.cell.task_rows.indices)
        cell, links = scenario.cell, scenario.cell.payload.links
        self.model = pin.buildModelFromXML(links.text, pin.JointModelFreeFlyer())
        self.model.gravity.linear = np.array(cell.gravity)
        self.data, self.X_d = self.model.createData(), pin.SE3(scenario.start.matrix)
        body = links.bodies[links.link]
        self.X_LP = pin.SE3(np.eye(3), body.centre)
        self.q = pin.neutral(self.model)
        self.k = np.zeros(self.model.nv)
        for name in links.robot.joints:
            joint = self.model.getJointId(name)
            self.q[self.model.idx_qs[joint]] = links.joint(name).start
            self.k[self.model.idx_vs[joint]] = links.joint(name).stiffness
        self.rest = np.array([0.0] * 6 + [links.joint(name).rest for name in links.robot.joints])
        pin.framesForwardKinematics(self.model, self.data, self.q)
        X_0P = self.frame(links.link) * self.X_LP
        self.held = []
        for name, grasp in cell.grasps.items():
            link, X_PE = cell.held_links.get(name, links.link), pin.SE3(grasp.matrix)
            off = pin.SE3(cell.arms[name].calibration_error.tip.matrix)
            self.held.append((link, self.frame(link).actInv(X_0P * X_PE), X_PE, off))
        self.q[:7] = pin.SE3ToXYZQUAT(self.X_d * X_0P.inverse())
        self.free = [*self.rows, *range(6, self.model.nv)]  # the root link has P's axes

    def frame(self, link: str) -> pin.SE3:
        return self.data.oMf[self.model.getFrameId(link)]

    def seen(self, q: np.ndarray) -> list[pin.SE3]:
        """X_WP as each arm sees it."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return [self.frame(link) * X_LE * off * X_PE.inverse() for link, X_LE, X_PE, off in self.held]

    def errors(self, seen: list[pin.SE3]) -> np.ndarray:
        return np.array(
            [
                np.concatenate(
                    (X.translation - self.X_d.translation, pin.log3(X.rotation @ self.X_d.rotation.T))
                )
                for X in seen
            ]
        )

    def unbalanced(self, q: np.ndarray, seen: list[pin.SE3], F: np.ndarray) -> np.ndarray:
        g = pin.computeGeneralizedGravity(self.model, self.data, q)
        tau = -g - self.k * (np.append(np.zeros(6), q[7:]) - self.rest)
        pin.framesForwardKinematics(self.model, self.data, q)
        for (link, *_), X, F_i in zip(self.held, seen, F, strict=True):
            frame = self.model.getFrameId(link)
            J = pin.computeFrameJacobian(self.model, self.data, q, frame, pin.LOCAL_WORLD_ALIGNED)
            lever = X.translation - self.data.oMf[frame].translation
            tau -= J.T @ np.concatenate((F_i[:3], F_i[3:] + np.cross(lever, F_i[:3])))
        return tau[self.free]

    def solve(self, wrenches, unknown: int = 0):
        """Return the wrenches about the true P, and the pose error of P, at rest."""
        n = len(self.free)

        def state(y):
            step = np.zeros(self.model.nv)
            step[self.free] = y[:n]
            q = pin.integrate(self.model, self.q, step)
            seen = self.seen(q)
            X = self.frame(self.scenario.cell.payload.links.link) * self.X_LP
            return q, seen, wrenches(self.errors(seen), seen, X, y[n:])

        def residual(y):
            q, seen, (F, more) = state(y)
            return np.concatenate((self.unbalanced(q, seen, F), more))

        solution = root(residual, np.zeros(n + unknown), tol=1e-13)
        q, seen, (F, _) = state(solution.x)
        assert np.abs(residual(solution.x)).max() < 1e-8
        pin.framesForwardKinematics(self.model, self.data, q)
        X = self.frame(self.scenario.cell.payload.links.link) * self.X_LP
        levers = np.array([each.translation - X.translation for each in seen])
        F[:, 3:] += np.cross(levers, F[:, :3])
        return F, self.errors([X])[0]


def moved(F: np.ndarray, X_WP: pin.SE3, seen: list[pin.SE3]) -> np.ndarray:
    """Wrenches about P as those about the P that each arm sees."""
    F = F.copy()
    for F_i, X in zip(F, seen, strict=True):
        F_i[3:] += np.cross(X_WP.translation - X.translation, F_i[:3])
    return F


def expected(rest: Rest, name: str, cell: str, result: cp.RunResult):
    """Wrenches and pose error of P at rest under a law."""
    scenario, rows = rest.scenario, rest.rows
    f_d = scenario.squeeze_wrenches
    gain = np.zeros(6)
    gain[rows] = K[cell]
    chain = CellChain(scenario.cell, scenario.plant)
    held = chain.loads(chain.configuration(scenario.start.matrix))
    law, at_start = scenario.controller, rest.seen(rest.q)
    held = moved(held, rest.X_d, at_start)

    def wrenches(e, seen, X_WP, unknown):
        squeeze = np.array([np.kron(np.eye(2), X.rotation) @ f for X, f in zip(seen, f_d, strict=True)])
        if name in ("payload-space", "symmetric", "mean-pose"):
            rho = {"payload-space": 1.0, "symmetric": RHO, "mean-pose": 0.0}[name]
            e = e.mean(axis=0) + rho * (e - e.mean(axis=0))
            turned = [pin.exp3(e_i[3:]) @ rest.X_d.rotation for e_i in e]  # as the law then sees P
            squeeze = np.array([np.kron(np.eye(2), R) @ f for R, f in zip(turned, f_d, strict=True)])
            return held + squeeze + 0.5 * GAMMA * gain * e, []
        if name == "leaky":
            return held + squeeze + 0.5 * GAMMA * (1.0 + K_I / LEAK) * gain * e, []
        if name == "own wrist":
            weight = 0.5 * law.payload_mass * np.array([*scenario.cell.gravity, 0, 0, 0])
            return moved(weight + squeeze + 0.5 * K_I * GAMMA / BETA * gain * e, X_WP, seen), []
        if name == "prescribed-performance":
            g = law.gains.sized(len(rows), 0)
            F = squeeze.copy()
            V = g.pose_gain * push(e[:, rows], FUNNELS[0])
            F[:, rows] += 0.5 * g.velocity_gain * push(V, FUNNELS[1])
            return F, []
        if name == "leader-follower":
            weight = 0.5 * scenario.cell.payload.total_mass * np.array([*scenario.cell.gravity, 0, 0, 0])
            F = squeeze + weight
            F[0, rows] += unknown
            return F, e[0, rows]
        F = squeeze.copy()
        if name == "anchored":  # what is measured of all sums to zero
            F[:, rows] += 0.5 * K_I * GAMMA / BETA * gain[rows] * e[:, rows]
            apart, F[:, rows] = F[:, rows].sum(axis=0), F[:, rows] + 0.5 * unknown
            return moved(F, X_WP, seen), apart
        F[:, rows] += [B @ e_i[rows] for B, e_i in zip(springs, e, strict=True)]
        return F, []

    springs = []
    if name == "sliding-mode":
        q = result.data.configuration.values[-1]
        for slot in chain.model.arms:
            J = CellArm(scenario.cell, slot.name).kinematics.view(q[slot.q_slice]).jacobian
            J_plus = np.linalg.pinv(J)
            springs.append(GAMMA * J_plus.T @ np.diag(K_D[cell]) @ J_plus)
    return rest.solve(wrenches, len(rows) if name in ("leader-follower", "anchored") else 0)


def still(name: str, cell: str, kind: str) -> cp.Scenario:
    """The cell at rest under a law, without friction; the tip of the left arm is off in its model."""
    rate = 500.0 if name == "sliding-mode" else 250.0
    changes = {f"cell.arms.{arm}.friction": "none" for arm in ("left", "right")}
    changes |= {"cell.arms.left.calibration_error.tip.xyz": [BIAS, 0.0, 0.0], "events": []}
    changes |= {"clock": {"rate_hz": rate, "steps_per_tick": 1}, "actuators.gravity_compensation": {}}
    changes |= {"controller": law_of(name, cell, rate), "duration": DURATION[kind]}
    if name in ("sliding-mode", "leader-follower"):
        changes["duration"] = 5.0
    if name in ("leader-follower", "own wrist"):
        changes["sensors.wrist"] = {}
    scenario = linked(CELLS[cell], kind)
    hold = {"kind": "hold", "pose": scenario.start.model_dump()}
    return scenario.override(changes | {"motion": hold})


LAWS = ("symmetric", "mean-pose", "prescribed-performance", "leader-follower", "sliding-mode", "anchored")
LAWS += ("own wrist", "leaky")
CASES = [("planar", "lid", name) for name in LAWS]
MORE = [("spatial", "lid", name) for name in LAWS]
MORE += [(cell, "table", name) for cell in CELLS for name in ("payload-space", "anchored", "symmetric")]


@pytest.mark.parametrize(
    ("cell", "kind", "name"), [*CASES, *(pytest.param(*each, marks=pytest.mark.gate) for each in MORE)]
)
def test_a_bias_leaves_the_internal_wrench_and_the_pose_of_the_statics(cell, kind, name):
    """Both arms hold the box with the lid, or each a leaf of the table, which a squeeze bends in space."""
    scenario = still(name, cell, kind)
    result = cp.run(scenario.override({"clock.record_every": 100}), warn=False)
    assert result.simulation_sound
    F, e = expected(Rest(scenario), name, cell, result)
    rows, data = list(scenario.cell.task_rows.indices), result.data.isel(time=-1)
    error = (data.internal_wrench - data.desired_internal_wrench).values[:, rows]
    predicted = (F - F.mean(axis=0))[:, rows] - data.desired_internal_wrench.values[:, rows]
    assert_allclose(error, predicted, rtol=1e-2, atol=1e-3)
    if name not in ("mean-pose", "leader-follower"):  # these leave none
        assert np.abs(predicted[:, :2]).max() > 0.05
    assert_allclose(data.pose_error.values[rows], e[rows], rtol=2e-2, atol=3e-5)


@pytest.mark.parametrize(
    ("cell", "damping", "duration"),
    [
        pytest.param("planar", (360.0, 360.0, 18.0), 6.0, marks=pytest.mark.gate),
        pytest.param("spatial", (720.0,) * 3 + (36.0,) * 3, 16.0, marks=pytest.mark.slow),
    ],
)
def test_an_admittance_comes_to_rest_where_the_internal_wrench_is_the_desired_one(cell, damping, duration):
    law = {"kind": "admittance", "command": "velocity", "force_path": {"kind": "late"}}
    gains = {"admittance_damping": damping, "pose_gain": 10.0}
    servo = {"actuators.servo": {"command": "velocity", "rate_hz": 1000.0}, "clock.steps_per_tick": 4}
    changes = {"controller": law | {"gains": gains}, "duration": duration, "clock.record_every": 250}
    data = cp.run(still("payload-space", cell, "lid").override(servo | changes), warn=False).data
    error = np.nan_to_num((data.internal_wrench - data.desired_internal_wrench).values)
    assert np.abs(error[0]).max() > 1.0
    assert_allclose(error[-1], 0.0, atol=1e-3)
