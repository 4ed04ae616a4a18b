"""Sampled closed loop of the motion at a pose: law near rest, matrix from tick to tick, and modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.schema.pose import Pose
from coop_pin.control.bounds import lag_pole
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.description.sensors import Sensors
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.encoder import Encoders, EncoderState
from coop_pin.simulation.devices.exchange import heard
from coop_pin.simulation.devices.sensing import Sensing
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.tick import SignalSource
from coop_pin.stability.modes import NEUTRAL, Mode, Motions, fastest_joints


class RestingLaw:
    """Law of a simulation that begins at rest on the reference at a configuration.

    Sensors are ideal, measured internal wrenches are as desired, torque limits play no part, and messages
    arrive at once. Where the law is zeroed at the grasp, the pose is that of the grasp.

    Attributes:
        references: references at rest at the pose.
        at_rest: measurements there.
        state: state of the law, which begins there from the torques that hold the cell.
    """

    def __init__(self, simulation: Simulation, q: Array, time: float, law_time: float | None = None) -> None:
        """Begin the law.

        Args:
            simulation: Simulation that has not begun.
            q: Configuration of the chain at the pose.
            time: Time of the references, s.
            law_time: Time of the measurements, s; that of the references when omitted.

        Raises:
            SingularJacobianError: an arm is singular there.
        """
        chain, scenario = simulation.chain, simulation.scenario
        self._simulation, self._time = simulation, time if law_time is None else law_time
        self._rest, X_WP = np.zeros(chain.mechanism.model.nv), chain.payload_pose(q)
        holding = simulation.actuation.holding_commands(q)
        ideal = scenario.with_ideal_sensors
        self._sensing = Sensing(ideal, simulation.slots, chain.arms, holding_torques=lambda _q: holding)
        self._signals = next(SignalSource(ideal, simulation.slots).rows()).sensors
        self._law, is_zeroed = simulation.controller, scenario.controller.near_rest.is_zeroed
        if is_zeroed:  # at this pose, not where the start is
            self._law = build_controller(scenario.replace(start=Pose.from_matrix(X_WP)))
        first = self._sensing.start(q, self._rest, simulation.references(time), self._signals)
        pairs = zip(scenario.cell.arms, simulation.references(time), first, strict=True)
        self.references = [  # an arm does not see how far a joint has turned
            reference._replace(
                pose=X_WP if is_zeroed or name in scenario.cell.jointed else one.payload_pose,
                twist=0.0 * reference.twist,
            )
            for name, reference, one in pairs
        ]
        first = heard(self._law, first, self.references, None, simulation.exchange.at_once)
        self.state = self._law.init(first, self.references)
        self.at_rest = self.measured(q)

    def measured(self, q: Array) -> list[ArmMeasurement]:
        """Return the measurements at rest at a configuration; the command of the last tick has acted."""
        measured = self._sensing.start(q, self._rest, self.references, self._signals)
        return [arm._replace(time=self._time, reported_torque=None) for arm in measured]

    def moving(self, v: Array) -> list[ArmMeasurement]:
        """Return the measurements at the pose at a velocity, shape (nv,)."""
        slots = self._simulation.slots
        rates = [frozen(slot.drive.dot(v[slot.v_slice])) for slot in slots]
        return [
            arm._replace(v=rate, payload_twist=frozen(arm.payload_jacobian.dot(rate)))
            for arm, rate in zip(self.at_rest, rates, strict=True)
        ]

    def step(
        self, measured: Sequence[ArmMeasurement], state: Any, spoken: Sequence[ArmMeasurement] | None = None
    ) -> tuple[Array, Any]:
        """Return the generalised force of the law, shape (nv,), and its next state.

        Args:
            measured: Measurements of the arms.
            state: State of the law.
            spoken: Measurements that the messages are made of; ``measured`` when omitted.
        """
        simulation, spoken = self._simulation, measured if spoken is None else spoken
        messages = heard(self._law, spoken, self.references, state, simulation.exchange.at_once)
        measured = [
            arm._replace(messages=each.messages) for arm, each in zip(measured, messages, strict=True)
        ]
        command = self._law.step(measured, self.references, state)
        torques = simulation.actuation.torques_of(command)
        return simulation.chain.transmission.torque(torques), command.state


_SMALL = 1e-6
"""Displacement of differences, rad or m; speeds likewise."""
_SETTLED = 1e6
"""A time at which the transients of the start are gone, s."""
_IDEAL_VELOCITY: Array = np.array([[0.0, 1.0]])


class SampledMotion(NamedTuple):
    """Closed loop of the motion from tick to tick, linear, at rest on the reference at a pose.

    On the n motions y that the closures leave, with their speed w, the acceleration b by the torques that
    act, what the law keeps in its integral, h, and what the estimate of the speed keeps, e::

        u[k] = G [y, w_m][k] + h[k],   h[k+1] = h[k] + H [y, w_m][k],   y' = w,  w' = b,  b' = (u - b) / lag

    w_m is the measured speed. The states are [y, w, b, h, e], h in coordinates of what H can reach.

    Attributes:
        feedback: G, 1/s^2 and 1/s, shape (n, 2 n).
        integral: H, likewise.
        motions: the n motions.
        velocity: measured speed and the estimate's next states by [y, w, e], shape (1 + e, 2 + e).
        period: T, s.
        time: time of the pose, s.
    """

    feedback: Array
    integral: Array
    motions: Motions
    velocity: Array
    period: float
    time: float

    def matrix(self, lag: float) -> Array:
        """Return the matrix of a tick with a lag of the drives, s."""
        return tick_matrix(self.feedback, self.integral, self.period, lag=lag, velocity=self.velocity)

    def radius(self, lag: float) -> float:
        """Return the largest ``|z|`` with a lag of the drives, s."""
        return float(np.abs(np.linalg.eigvals(self.matrix(lag))).max())

    def modes(self, simulation: Simulation, lag: float) -> list[Mode]:
        """Return the modes that move the chain, with a lag of the drives, s.

        Args:
            simulation: Simulation of which it is the motion.
            lag: Time constant of the drives, s.
        """
        z, vectors = np.linalg.eig(self.matrix(lag))
        z, y = z.astype(complex), vectors[: len(self.feedback)]
        z, y = z[moves := np.linalg.norm(y, axis=0) > 0.0], y[:, moves]
        joints = [fastest_joints(simulation, speeds) for speeds in np.abs(self.motions.basis @ y).T]
        parts = zip(z.tolist(), joints, self.motions.is_spare(y).tolist(), strict=True)
        return [Mode(z, _mode_name(*of), self.period, *of) for z, *of in parts]


def _mode_name(joints: tuple[str, ...], is_spare: bool) -> str:
    """Return the name of the spare joints with their arms, or of the joints."""
    arms = " and ".join(sorted({joint.partition("/")[0] for joint in joints}))
    return f"elbow (spare joints) of {arms}" if is_spare else f"motion of {', '.join(joints)}"


def tick_matrix(
    G: Array, H: Array, period: float, *, lag: float = 0.0, velocity: Array = _IDEAL_VELOCITY
) -> Array:
    """Return the matrix of [y, w, b, h, e] over a tick with zero-order hold, in closed form.

    Args:
        G: Acceleration that the law's torque asks for by [y, w_m], shape (n, 2 n).
        H: Acceleration that it adds for all later ticks, likewise.
        period: T, s.
        lag: Time constant of the drives, s.
        velocity: Measured speed and next states, as in SampledMotion.
    """
    r, T, eye = lag_pole(lag / period), period, np.eye(len(G))
    held = lag * (1.0 - r)  # the integral of exp(-s / lag) over the tick
    free = np.array([[1.0, T, lag * (T - held)], [0.0, 1.0, held], [0.0, 0.0, r]])
    by_u = np.array([[T * T / 2.0 - free[0, 2]], [T - held], [1.0 - r]])
    return closed_tick(np.kron(free, eye), np.kron(by_u, eye), G, H, velocity)


def closed_tick(free: Array, by_u: Array, G: Array, H: Array, velocity: Array = _IDEAL_VELOCITY) -> Array:
    """Return the matrix of [y, w, b, h, e] over a tick of a plant under a law.

    Args:
        free: Map of [y, w, b] over a tick, shape (3 n, 3 n).
        by_u: Map of a held acceleration by torques to them, shape (3 n, n).
        G: Acceleration that the law's torque asks for by [y, w_m], shape (n, 2 n).
        H: Acceleration that it adds for all later ticks, likewise.
        velocity: Measured speed and next states, as in SampledMotion.
    """
    basis, singular, _ = np.linalg.svd(H)
    U = basis[:, singular > NEUTRAL * np.abs(G).max()]
    n, k, e = len(G), U.shape[1], len(velocity) - 1
    # [y, w, e] from the states, then [y, w_m] and the next e.
    slots, eye = np.eye(3 * n + k + e * n), np.eye(n)
    observed = np.vstack((slots[: 2 * n], slots[3 * n + k :]))
    measured = np.vstack((slots[:n], np.kron(velocity[:1], eye) @ observed))
    h = slots[3 * n : 3 * n + k]
    motion = free @ slots[: 3 * n] + by_u @ (G @ measured + U @ h)
    return np.vstack((motion, h + U.T @ H @ measured, np.kron(velocity[1:], eye) @ observed))


def sampled_motion(
    simulation: Simulation,
    q: Array,
    time: float,
    wrench_errors: Callable[[Array, Array], Array] | None = None,
) -> SampledMotion:
    """Return the closed loop of the motion of a law of coop_pin at a pose, by central differences.

    All gains are in it, per row and of spare joints, and the estimate of the speed, the slowest of an arm for
    all. At rest on the reference, internal wrenches as desired unless errors of them are given: their loop is
    not in it. sgn has no linear integral: there H = 0. Messages arrive at once. Friction, leak and rate
    limits are not considered.

    Args:
        simulation: Simulation that has not begun.
        q: Configuration of the chain at the pose.
        time: Time of the pose, s.
        wrench_errors: Errors of the measured internal wrenches at a state, task rows, shape (m, k_0).

    Raises:
        SingularJacobianError: an arm is singular there.
    """
    scenario, chain = simulation.scenario, simulation.chain
    mechanism, rest = chain.mechanism, np.zeros(chain.mechanism.model.nv)
    law, motions = RestingLaw(simulation, q, time, law_time=_SETTLED), Motions.at(chain, q)
    N = motions.basis

    def step(measured: Any, q: Array, v: Array, state: object) -> tuple[Array, object]:
        if wrench_errors is not None:
            measured = [
                arm._replace(internal_wrench=arm.internal_wrench + error, internal_wrench_age=0.0)
                for arm, error in zip(measured, wrench_errors(q, v), strict=True)
            ]
        torque, state = law.step(measured, state)
        torque = torque + chain.transmission.torque(simulation.actuation.carried(q))
        return N.T @ mechanism.forward_dynamics(q, rest, torque).acceleration, state

    def response(measured: Any, moved: Array, v: Array) -> Array:
        now, state = step(measured, moved, v, law.state)
        is_kept = scenario.controller.near_rest.integral == "linear"
        kept = step(law.at_rest, q, rest, state)[0] if is_kept else 0.0 * now
        return np.concatenate((now, kept))

    def responses(y: Array) -> list[Array]:
        moved = pin.integrate(mechanism.model, q, y)
        return [response(law.measured(moved), moved, rest), response(law.moving(y), q, y)]

    ends = np.array([responses(h * row) for row in N.T for h in (_SMALL, -_SMALL)])
    slopes = (ends[::2] - ends[1::2]) / (2.0 * _SMALL)
    G, H = np.split(np.hstack((slopes[:, 0].T, slopes[:, 1].T)), 2)
    return SampledMotion(G, H, motions, _velocity_estimate(simulation), scenario.clock.period, time)


def _velocity_estimate(simulation: Simulation) -> Array:
    """Return measured speed and next states of the slowest estimate of an arm, by [y, w, e]."""
    scenario = simulation.scenario
    estimates = [
        Encoders.of_sensors(Sensors(velocity=scenario.sensors_of(arm).velocity), scenario.clock.period, 1, "")
        for arm in scenario.cell.arms
    ]
    slowest = max(estimates, key=lambda estimate: (estimate.velocity != "ideal", estimate.pole))
    if slowest.velocity == "ideal":
        return _IDEAL_VELOCITY
    y, w, last, estimate = np.eye(4)  # the estimate is linear: all four unit inputs at once
    (_, measured), state = slowest.step(EncoderState(last, estimate), y, w, 0.0 * y)
    return np.array([measured, *state])
