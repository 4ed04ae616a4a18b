"""Trust thresholds: bounds on numerical errors, joint positions and torque cuts of a run."""

from __future__ import annotations

from pydantic import Field

from coop_pin.base.schema.base import Description, NotNegative, Positive


class TrustThresholds(Description):
    """Thresholds beyond which a run is not trustworthy.

    Energy errors are compared with the gross work: the amounts of work done between ticks by drives,
    friction, external wrenches, payload changes and gravity, summed without sign. Sound runs stay below 1e-8
    of it (the catalogue's below 2e-11), semi-implicit Euler needs 1e-2, and a motion through a singular pose
    leaves 1e-4.

    Attributes:
        closure_error: largest distance and angle between a tip and its grasp, m and rad.
        energy_share: largest energy error as a share of the gross work.
        energy_floor: energy error that is accepted without any work, J.
        joint_slack: distance that a joint may go beyond its position limits, rad or m; the plant has no
            stops.
        torque_cut: time that a drive torque may stay at its limit without a break, s.
        jacobian_condition: largest condition number of an arm's payload Jacobian; the catalogue's reach 12,
            and at 100 the torques of an arm that passes a singular pose are many times their usual size.
        joint_drift: distance that a joint may drift in the last second of a run whose payload and reference
            rest, rad or m: spare joints of redundant arms that nothing holds.
    """

    closure_error: Positive = 1e-6
    energy_share: Positive = 1e-6
    energy_floor: NotNegative = 1e-6
    joint_slack: NotNegative = 1e-6
    torque_cut: NotNegative = 0.1
    jacobian_condition: float = Field(default=100.0, ge=1.0)
    joint_drift: NotNegative = 0.01
