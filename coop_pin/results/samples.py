"""What a run hands over: one plain array for each recorded quantity."""

from __future__ import annotations

from typing import NamedTuple

from coop_pin.arrays import Array, Mask


class RunSamples(NamedTuple):
    """Samples of a run at its n ticks; m arms, at most k joints each. Torques and wrenches hold from the tick on.

    Attributes:
        time: s, shape (n,).
        configuration: q of the tree, shape (n, nq).
        velocity: v of the tree, shape (n, nv).
        payload_pose: X_WP, shape (n, 4, 4).
        payload_twist: V_WP, shape (n, 6).
        desired_pose: X_WP_d, shape (n, 4, 4).
        desired_twist: V_WP_d, shape (n, 6).
        desired_squeeze: f_d in payload axes, shape (n, m, 6).
        tip_position: m, shape (n, m, 3).
        drive_velocity: rad/s, shape (n, m, k); NaN beyond an arm's joints.
        torque: drive torques as applied, N m, shape (n, m, k); NaN beyond an arm's joints.
        commanded_torque: drive torques before saturation, likewise.
        saturated: whether a torque was cut at its limit, shape (n, m, k).
        joint_position: joint angles, rad or m, shape (n, m, k); NaN beyond an arm's joints.
        joint_velocity: joint rates, likewise.
        interaction_wrench: on each arm by the payload, about P in world axes; NaN in rows that rigid bodies do not
            determine, shape (n, m, 6).
        external_wrench: on the payload, about P in world axes, shape (n, 6).
        closure_error: distance and angle of each grasp, m and rad, shape (n, m, 2).
        jacobian_condition: of each payload Jacobian, shape (n, m).
        energy: kinetic and potential, J, shape (n, 2).
        work: of actuation, friction, external wrenches and payload changes so far, J, shape (n, 4).
    """

    time: Array
    configuration: Array
    velocity: Array
    payload_pose: Array
    payload_twist: Array
    desired_pose: Array
    desired_twist: Array
    desired_squeeze: Array
    tip_position: Array
    drive_velocity: Array
    torque: Array
    commanded_torque: Array
    saturated: Mask
    joint_position: Array
    joint_velocity: Array
    interaction_wrench: Array
    external_wrench: Array
    closure_error: Array
    jacobian_condition: Array
    energy: Array
    work: Array

    def first(self, count: int) -> RunSamples:
        """Return the first samples alone."""
        return RunSamples(**{name: array[:count] for name, array in self._asdict().items()})
