"""Exercise 7: how much damping does a wrist bear that a hinge makes spare? T D / I, by its own inertia I."""

import numpy as np

import coop_pin as cp
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.inverse_kinematics import solve_ik
from coop_pin.stability.sampled_stability import sampled_stability


def hinged(damping):
    """Return adept-hinges with another damping of the posture, N m s/rad."""
    stiffness = {"controller.posture.stiffness": 5.0 * damping, "controller.posture.damping": damping}
    return cp.Scenario.load("adept-hinges").override(stiffness)


def wrist_inertia(scenario):
    """Return the least inertia that an arm moves with the payload at rest, in drive coordinates, kg m^2."""
    inertias = []
    for name in scenario.cell.arms:
        arm = CellArm(scenario.cell, name)
        q = solve_ik(arm, scenario.start.matrix, posture=arm.description.posture)
        u = np.linalg.svd(arm.null_space(q))[0][:, 0]
        inertias.append(float(u @ arm.from_drive.T @ arm.mass_matrix(q) @ arm.from_drive @ u))
    return min(inertias)


def compared(dampings=(8.0, 1.6, 0.5)):
    """Return T D / I and the T lambda of ``cp.check`` by the damping of the posture."""
    rows = {}
    for damping in dampings:
        scenario = hinged(damping)
        predicted = scenario.clock.period * damping / wrist_inertia(scenario)
        rows[damping] = predicted, sampled_stability(scenario).value
    return rows


if __name__ == "__main__":
    print("damping, N m s/rad   T D / I   T lambda")
    for damping, (predicted, value) in compared().items():
        print(f"{damping:18.1f} {predicted:9.2f} {value:10.2f}")
    proposed = cp.suggest(hinged(8.0), poses=21)
    print(f"cp.suggest: {proposed.scenario.controller.posture.damping:.3g} N m s/rad")
