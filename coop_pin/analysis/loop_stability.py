"""Stability of the sampled motion with all gains of a law, under the lag of the drives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, typed
from coop_pin.control.bounds import lag_pole
from coop_pin.description.sensors import Sensors
from coop_pin.simulation import Simulation
from coop_pin.simulation.sensing import Sensing

_SMALL = 1e-6
"""Displacement of differences, rad or m; speeds likewise."""
_SETTLED = 1e6
"""A time at which the transients of the start are gone, s."""
_NEUTRAL = 1e-6
"""Growth in a tick, and part of a singular value, that count as none."""
_LARGEST_LAG = 1.0


class LoopStability(NamedTuple):
    """Stability of the sampled motion with pose gain, integral and lag.

    Attributes:
        radius: largest ``|z|`` of the motion from tick to tick; 1 where nothing controls a direction.
        lag: largest time constant of an arm's drives, s.
        largest_lag: largest lag with which the motion would still not grow, s, counted from that of the
            drives if that is stable, else from none; at most 1, and 0 where the motion grows without any.
    """

    radius: float
    lag: float
    largest_lag: float

    @property
    def ok(self) -> bool:
        """Whether the motion does not grow from tick to tick."""
        return self.radius < 1.0 + _NEUTRAL

    def summary(self) -> str:
        """Return the finding as text, in one line."""
        finding = f"|z| = {self.radius:.5f} with pose gain, integral and a lag of {1e3 * self.lag:.3g} ms"
        bound = f"lags up to {1e3 * self.largest_lag:.3g} ms"
        if self.ok:
            return f"{finding}: the motion is stable, with {bound}"
        allowed = f"stable with {bound}" if self.largest_lag else "unstable without any lag, too"
        return f"! {finding}: the motion is unstable ({allowed}). Lower the gains or raise clock.rate_hz"


@typed
def loop_stability(simulation: Simulation) -> LoopStability:
    """Return the stability of a law with all its gains under the lag of the drives, linearised at the start.

    On the n motions y that the closures leave, with their speed w, the acceleration b by the torques that
    act, and what the law keeps in its integral, h::

        u[k] = G [y, w][k] + h[k],   h[k+1] = h[k] + H [y, w][k],   y' = w,  w' = b,  b' = (u - b) / lag

    over a tick in closed form, with the largest lag of an arm for all. sgn has no linear integral: there H =
    0. Friction, leak, rate limits, and filters and delays of the sensors are not considered.

    Args:
        simulation: simulation of a law of coop_pin that has not begun.

    Raises:
        SingularJacobianError: an arm is singular at the start.
    """
    clock, (G, H) = simulation.scenario.clock, _feedback(simulation)
    lag_of_drives = simulation.scenario.actuator_lag * clock.period

    def radius(lag: float) -> float:
        return float(np.abs(np.linalg.eigvals(_tick_map(G, H, clock.period, lag))).max())

    def is_stable(lag: float) -> bool:
        return radius(lag) < 1.0 + _NEUTRAL

    # A lag can also stabilise what the sampling does not bear without: looked for from that of the drives on.
    low, high = lag_of_drives if is_stable(lag_of_drives) else 0.0, max(_LARGEST_LAG, lag_of_drives)
    if not is_stable(low) or is_stable(high):
        return LoopStability(radius(lag_of_drives), lag_of_drives, high if is_stable(low) else 0.0)
    while high - low > _SMALL:
        middle = (low + high) / 2.0
        low, high = (middle, high) if is_stable(middle) else (low, middle)
    return LoopStability(radius(lag_of_drives), lag_of_drives, low)


def _tick_map(G: Array, H: Array, T: float, lag: float) -> Array:
    """Return the map of [y, w, b, h] over a tick, h in coordinates U of what H can reach."""
    basis, singular, _ = np.linalg.svd(H)
    U, eye = basis[:, singular > _NEUTRAL * np.abs(G).max()], np.eye(len(G))
    r = lag_pole(lag / T)
    held = lag * (1.0 - r)  # the integral of exp(-s / lag) over the tick
    free = np.array([[1.0, T, lag * (T - held)], [0.0, 1.0, held], [0.0, 0.0, r]])
    by_u = np.array([[T * T / 2.0 - free[0, 2]], [T - held], [1.0 - r]])
    zero = np.zeros((len(G), U.shape[1]))
    feedback, kept = np.hstack((G, 0.0 * eye, U)), np.hstack((U.T @ H, zero.T, np.eye(U.shape[1])))
    return np.vstack((np.hstack((np.kron(free, eye), np.tile(zero, (3, 1)))) + np.kron(by_u, feedback), kept))


def _feedback(simulation: Simulation) -> tuple[Array, Array]:
    """Return d(acceleration)/d[y, w] by a tick's torque, and by what the law keeps of it, (n, 2 n) each.

    At rest on the reference, joints measured as they are and internal wrenches as desired.
    """
    plant, law, scenario = simulation.plant, simulation.controller, simulation.scenario
    chain, rest = plant.chain.mechanism, np.zeros(len(plant.v))
    ideal = scenario.replace(sensors=Sensors(), arm_sensors={}, beyond_bound=True)
    sensing = Sensing(ideal, plant.chain.model.arms, holding_torques=simulation.actuation.holding_commands)
    first = sensing.start(plant.q, rest, simulation.references(0.0))
    references = [
        reference._replace(pose=seen.payload_pose, twist=0.0 * reference.twist)
        for reference, seen in zip(simulation.references(0.0), first, strict=True)
    ]
    basis, singular, _ = np.linalg.svd(
        np.column_stack([chain.project_velocity(plant.q, row) for row in np.eye(len(rest))])
    )
    N = basis[:, singular > _NEUTRAL]

    def step(q: Array, v: Array, state: object) -> tuple[Array, object]:
        seen = [arm._replace(time=_SETTLED) for arm in sensing.start(q, v, references)]
        command = law.step(seen, references, state)
        torque = plant.transmission.torque(simulation.actuation.commanded(command))
        return N.T @ chain.forward_dynamics(q, rest, torque).acceleration, command.state

    def answer(q: Array, v: Array) -> Array:
        now, state = step(q, v, start)
        kept = step(plant.q, rest, state)[0] if scenario.controller.has_linear_integral else 0.0 * now
        return np.concatenate((now, kept))

    start = law.init(first, references)
    moved = [
        [answer(pin.integrate(chain.model, plant.q, h * row), rest), answer(plant.q, h * row)]
        for row in N.T
        for h in (_SMALL, -_SMALL)
    ]
    slopes = (np.array(moved[::2]) - np.array(moved[1::2])) / (2.0 * _SMALL)
    G, H = np.split(np.hstack((slopes[:, 0].T, slopes[:, 1].T)), 2)
    return G, H
