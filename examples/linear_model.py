"""A cell as control theory sees it: inverse dynamics with a squeeze, a linear model, a regulator.

Two Pandas hold a box at rest. Torques of least effort and torques with a squeeze of 20 N keep it; a linear
quadratic regulator of the sampled model moves every eigenvalue into the unit circle.
"""

import numpy as np
import scipy.linalg

import coop_pin as cp

PERIOD = 1e-3
WEIGHT_ON_TORQUE = 1e-4


def regulator(model):
    """Return the gain K of u = -K x that minimises the sum of x^T x + r u^T u."""
    A, B = model.A, model.B
    R = WEIGHT_ON_TORQUE * np.eye(B.shape[1])
    P = scipy.linalg.solve_discrete_are(A, B, np.eye(len(A)), R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)


def main():
    scenario = cp.Scenario.load("two-pandas-box")
    cell = cp.grasps.CellChain(scenario.cell)
    q = cell.configuration(scenario.start.matrix)
    still = np.zeros(cell.mechanism.model.nv)

    squeeze = np.zeros((2, 6))
    squeeze[:, 0] = (-20.0, 20.0)
    for name, internal in (("least effort", None), ("20 N along x", squeeze)):
        held = cell.inverse_dynamics(q, still, still, internal=internal)
        forces = held.interaction_wrench[:, :3].round(1).tolist()
        print(f"{name}: |tau| = {np.linalg.norm(held.torque):.2f} N m, forces on the arms {forces} N")

    print("effective inertia of the cell at P:", np.diag(cell.effective_inertia(q)).round(2))
    model = cell.linearise(q, still, held.torque)
    print(f"{len(model.joints)} degrees of freedom: {', '.join(model.joints)}")
    sampled = model.sampled(PERIOD)
    closed = sampled.A - sampled.B @ regulator(sampled)
    for name, A in (("held torques", sampled.A), ("with the regulator", closed)):
        print(f"{name}: largest |z| = {np.abs(np.linalg.eigvals(A)).max():.4f}")


if __name__ == "__main__":
    main()
