"""Where the payload shall be, and how hard it shall be squeezed, at time t.

A ``PoseReference`` answers ``at(time)`` with a ``PoseTarget``: the desired pose, twist and acceleration of
the payload frame P, world axes, linear first. The kinds:

- ``Hold``: stand still.
- ``Exponentials``: a position along decaying exponentials, as in the reference experiment of Gueaieb et al.
  (2007).
- ``Line``: from one pose to another, straight, from rest to rest.
- ``Circle``: round a circle, from rest.
- ``Turn``, ``Swing``: about an axis through P, once or to and fro.
- ``Waypoints``, ``Tabulated``: smoothly through poses given in an array or in a file.
- ``FromFunction``: a function of time of the user's own.

A ``SqueezeReference`` answers ``at(time)`` with the desired internal wrench of each arm, payload axes, about
P: ``ConstantSqueeze``, ``RampedSqueeze``, ``SqueezeFromFunction``.

All are immutable values, defined at every time. ``check_consistency`` tests any pose reference against
central differences.
"""

from coop_pin.reference.motions import Circle, Exponentials, FromFunction, Hold, Line, Swing, Turn
from coop_pin.reference.pose_reference import ConsistencyGaps, PoseReference, PoseTarget, check_consistency
from coop_pin.reference.splines import Tabulated, Waypoints
from coop_pin.reference.squeeze import ConstantSqueeze, RampedSqueeze, SqueezeFromFunction, SqueezeReference

__all__ = [
    "Circle",
    "ConsistencyGaps",
    "ConstantSqueeze",
    "Exponentials",
    "FromFunction",
    "Hold",
    "Line",
    "PoseReference",
    "PoseTarget",
    "RampedSqueeze",
    "SqueezeFromFunction",
    "SqueezeReference",
    "Swing",
    "Tabulated",
    "Turn",
    "Waypoints",
    "check_consistency",
]
