"""A controller of your own: a spring and damper on the payload pose in each arm, plus the desired squeeze.

It receives measurements of its arm and nothing else. Here it runs from Python; on the command line, from this
folder: coop-pin run adept-paper --controller.kind user --controller.target own_controller:PayloadSpring
"""

import numpy as np

import coop_pin as cp


class PayloadSpring(cp.ArmController):
    """tau = -J^T [c (K xtilde + D xtildedot) + f_d], without memory."""

    def __init__(self, scenario, arm, stiffness=(3000.0, 3000.0, 60.0), damping=(600.0, 600.0, 12.0)):
        self.rows = scenario.cell.task_rows
        self.share = dict(zip(scenario.cell.arms, scenario.cell.shares, strict=True))[arm]
        self.stiffness, self.damping = np.array(stiffness), np.array(damping)

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        error = self.rows.pose_error(measurement.payload_pose, reference.pose)
        pull = self.stiffness * error + self.damping * (measurement.payload_twist - reference.twist)
        # The reference states the squeeze in payload axes.
        squeeze = self.rows.turn(measurement.payload_pose, reference.internal_wrench)
        return cp.ArmCommand(-measurement.payload_jacobian.T @ (self.share * pull + squeeze), state)


if __name__ == "__main__":
    mine = cp.UserController(target="own_controller:PayloadSpring", options={"damping": [800.0, 800.0, 12.0]})
    print("rms errors of position and internal force")
    for name, controller in (("printed law", {}), ("spring and damper", {"controller": mine})):
        result = cp.run("adept-paper", controller)
        force = result.internal_force(window=(4.0, 10.0))
        distance = 1e3 * result.position_rms(window=(4.0, 10.0))
        print(f"{name:18} position {distance:6.3f} mm, force {force.axial_rms_error:6.3f} N")
