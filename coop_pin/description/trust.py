"""Trust thresholds: bounds on numerical errors, joint positions and torque cuts of a run."""

from __future__ import annotations

from pydantic import Field

from coop_pin.schema.base import Description, NotNegative, Positive


class TrustThresholds(Description):
    """Thresholds beyond which a run is not trustworthy.

    The work that energy errors are compared with is gross: the amounts of work done between ticks by drives,
    friction, external wrenches, payload changes and gravity, summed without sign. The catalogue's runs stay
    below 1e-10 of it. At 1e-4 an integration error is still far below what masses and friction are known to,
    and it is what a few steps through a singular pose exceed.

    Attributes:
        closure_error: largest distance and angle between a tip and its grasp, m and rad.
        energy_share: largest energy that work does not explain, as a share of the gross work.
        energy_floor: energy error that is accepted even without any work, J.
        joint_slack: how far a joint may go beyond its position limits, rad or m; the plant has no stops.
        torque_cut: how long a drive torque may stay cut at its limit without a break, s.
        jacobian_condition: largest condition number of an arm's payload Jacobian; the catalogue's reach 12,
            and the control laws stop at 1e6.
    """

    closure_error: Positive = 1e-6
    energy_share: Positive = 1e-4
    energy_floor: NotNegative = 1e-6
    joint_slack: NotNegative = 1e-6
    torque_cut: NotNegative = 0.1
    jacobian_condition: float = Field(default=1e3, ge=1.0)
