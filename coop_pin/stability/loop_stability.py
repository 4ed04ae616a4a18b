"""Stability of the sampled motion with all gains of a law, spare joints included, along the motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.bisection import edge
from coop_pin.feasibility.reachability import Reachability
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.modes import NEUTRAL, Mode
from coop_pin.stability.sampled_motion import SampledMotion, sampled_motion
from coop_pin.stability.sampled_stability import start_and_later

LEAST_DAMPING = 0.55
"""Damping ratio below which a motion swings."""
_LARGEST_LAG, _LAG_ERROR = 1.0, 1e-6
"""Largest lag that is tried, and that to which the largest one is found, s."""
_POSES = 6
"""Largest number of poses on the reference, evenly spread."""


class LoopStability(NamedTuple):
    """Stability of the sampled motion with pose gain, integral, posture and lag.

    Attributes:
        radius: largest ``|z|`` of the motion from tick to tick; 1 where nothing controls a direction.
        lag: largest time constant of an arm's drives, s.
        largest_lag: largest lag with which the motion would still not grow, s, counted from that of the
            drives if that is stable, else from none; at most 1, and 0 where the motion grows without any.
        mode: mode of that ``|z|``.
        least_damped: mode with the smallest damping ratio, at any of the poses.
        least_damped_payload: the same of the modes that are not of spare joints.
        spare: slowest mode of the spare joints; None without any.
        period: period of the control, s.
        remedy: field of the spring of spare joints; empty if the law has none.
        time: time of the pose at which the motion is least stable, s.
    """

    radius: float
    lag: float
    largest_lag: float
    mode: Mode
    least_damped: Mode
    least_damped_payload: Mode
    spare: Mode | None
    period: float
    remedy: str
    time: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the motion does not grow from tick to tick."""
        return self.radius < 1.0 + NEUTRAL

    @property
    def spare_rate(self) -> float:
        """Decay of the slowest mode of the spare joints, 1/s; negative if it grows, inf without any."""
        return np.inf if self.spare is None else self.spare.rate

    @property
    def damping(self) -> float:
        """Smallest damping ratio of a mode."""
        return self.least_damped.damping

    def summary(self) -> str:
        """Return the finding as text, in one line."""
        at = f" at t = {self.time:.3g} s" if self.time else ""
        finding = f"|z| = {self.radius:.5f}{at} with all gains and a lag of {1e3 * self.lag:.3g} ms"
        bound = f"lags up to {1e3 * self.largest_lag:.3g} ms"
        if self.ok:
            advice = (
                "" if self.damping >= LEAST_DAMPING else f" < {LEAST_DAMPING}: lower sign_gain or pose_gain"
            )
            return f"{finding}: the motion is stable, with {bound}; damping ratio {self.damping:.2f}{advice}"
        falls = abs(self.mode.z.imag) < NEUTRAL < self.mode.z.real
        if falls or (self.mode.is_spare and self.mode.z.real > 0.0):
            spring = f"Raise {self.remedy}" if self.remedy else "Its law has no spring for them"
            spring = spring if self.mode.is_spare else "Raise controller.gains.pose_gain"
            growth = f"grows by e in {self.period / np.log(self.radius):.3g} s"
            return f"{finding}: the {self.mode.name} {growth}: nothing holds it against gravity. {spring}"
        allowed = f"stable with {bound}" if self.largest_lag else "unstable without any lag, too"
        lower = f"Lower {self.remedy.rpartition('.')[0]}" if self.mode.is_spare else "Lower the gains"
        return f"{finding}: the {self.mode.name} is unstable ({allowed}). {lower} or raise clock.rate_hz"


@typed
def loop_stability(simulation: Simulation, cell_reach: Reachability | None = None) -> LoopStability:
    """Return the stability of a law with all its gains under the lag of the drives, where it is least.

    That of SampledMotion, with the largest lag of an arm for all. At each pose the law starts anew from the
    torques that hold the cell there.

    Args:
        simulation: simulation of a law of coop_pin that has not begun.
        cell_reach: reachability of its scenario, in which every arm holds the start; up to six poses of the
            motion are looked at. The start alone when omitted.

    Raises:
        SingularJacobianError: an arm is singular at a pose.
        ArgumentError: a grasp is compliant.
    """
    if not simulation.scenario.cell.tools:  # whose arms are loops of their own
        simulation.scenario.cell.require_rigid("loop_stability")
    stabilities, bound = list[LoopStability](), _LARGEST_LAG
    for time, q in start_and_later(simulation, cell_reach, _POSES):
        stabilities.append(_stability(simulation, sampled_motion(simulation, q, time), bound))
        bound = stabilities[-1].largest_lag
    worst = max(stabilities, key=lambda stability: stability.radius)
    slowest = min(stabilities, key=lambda stability: stability.spare_rate)
    swinging = min((each.least_damped for each in stabilities), key=_damping_of)
    payload = min((each.least_damped_payload for each in stabilities), key=_damping_of)
    return worst._replace(
        largest_lag=bound, spare=slowest.spare, least_damped=swinging, least_damped_payload=payload
    )


def _damping_of(mode: Mode) -> float:
    return mode.damping


def _stability(simulation: Simulation, motion: SampledMotion, bound: float) -> LoopStability:
    """Return the stability at the lag of the drives, and the largest lag up to a bound, s."""
    scenario = simulation.scenario
    lag = scenario.actuator_lag * motion.period
    modes = motion.modes(simulation, lag)
    mode = max(modes, key=lambda mode: abs(mode.z))
    return LoopStability(
        radius=abs(mode.z),
        lag=lag,
        largest_lag=_largest_lag(motion, lag, bound),
        mode=mode,
        least_damped=min(modes, key=_damping_of),
        least_damped_payload=min((mode for mode in modes if not mode.is_spare), key=_damping_of),
        spare=max((mode for mode in modes if mode.is_spare), key=lambda mode: abs(mode.z), default=None),
        period=motion.period,
        remedy=scenario.controller.spare_spring,
        time=motion.time,
    )


def _largest_lag(motion: SampledMotion, lag: float, bound: float) -> float:
    """Return the largest lag up to a bound with which the motion does not grow, s."""

    def is_stable(lag: float) -> bool:
        return motion.radius(lag) < 1.0 + NEUTRAL

    # A lag can also stabilise what the sampling does not bear without: the search starts at the drives'.
    low, high = lag if is_stable(lag) else 0.0, max(bound, lag)
    if is_stable(high):
        return high
    if not is_stable(low):
        return 0.0
    return edge(is_stable, low, high, _LAG_ERROR)
