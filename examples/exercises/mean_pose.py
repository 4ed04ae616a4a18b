"""Exercise 3: a law without a wrench sensor that neither sags under a load nor ramps under a bias.

Every arm runs the plain payload-space PI, not on its own view of the payload but on the mean of all views.
Poses and twists cross between the arms, wrenches do not. Equal views make equal integrals.
"""

import argparse

import numpy as np
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.comparison import controllers_for
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.laws import build_controller
from coop_pin.spatial import pose_error

BIAS = {"tip.xyz": [1e-3, 0.0, 0.0]}


class MeanPosePI(cp.CellController):
    """The payload-space law, every arm acting on the mean of all arms' pose errors and twists.

    ::

        e = (1/m) sum_j e_j,   V = (1/m) sum_j V_j,   s = V - V_d + gamma e   for every arm

    Attributes:
        law: the law of each arm, which sees the mean in place of its own view.
    """

    needs = ("poses of all arms",)

    def __init__(self, scenario, law):
        self.law = build_controller(scenario.override({"controller": law}))

    def init(self, measurements, references):
        return self.law.init(self.agreed(measurements, references), references)

    def step(self, measurements, references, state):
        return self.law.step(self.agreed(measurements, references), references, state)

    def agreed(self, measurements, references):
        """Return the measurements with one pose and one twist: the mean of errors, and of twists."""
        X_d = references[0].pose
        e = np.mean([pose_error(seen.payload_pose, X_d) for seen in measurements], axis=0)
        X = np.eye(4)
        X[:3, 3] = X_d[:3, 3] + e[:3]
        X[:3, :3] = Rotation.from_rotvec(e[3:]).as_matrix() @ X_d[:3, :3]
        V = np.mean([seen.payload_twist for seen in measurements], axis=0)
        return [seen._replace(payload_pose=X, payload_twist=V) for seen in measurements]


def mean_pose(law):
    """Return the description of the mean-pose law with the gains of a payload-space law."""
    return {"kind": "user", "target": "mean_pose:MeanPosePI", "options": {"law": law}}


def compared(cell, changes=None, duration=5.0):
    """Return position, mm, and internal-force error, N, rms from 0.4 of the run on, by law."""
    scenario = benchmark_scenario(cp.Scenario.load(cell), duration)
    laws = controllers_for(scenario, ["payload-pi", "anchored"])
    laws = {"mean pose": mean_pose(laws["payload-pi"]), **laws}
    first = next(iter(scenario.cell.arms))
    bias = {f"cell.arms.{first}.calibration_error.{field}": value for field, value in BIAS.items()}
    window = (0.4 * duration, duration)
    rows = {}
    for name, law in laws.items():
        result = cp.run(scenario, {"controller": law} | (bias if changes is None else changes))
        force = result.internal_force(window=window).force_rms_error
        rows[name] = (1e3 * result.position_rms(window=window), force)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cells", nargs="*", default=["adept-anchored"])
    parser.add_argument("--duration", type=float, default=5.0)
    chosen = parser.parse_args()
    print("one arm off by 1 mm: position, mm rms, and internal force, N rms")
    for cell in chosen.cells:
        for name, (position, force) in compared(cell, duration=chosen.duration).items():
            print(f"{cell:16} {name:12} {position:8.3f} {force:10.4f}")
