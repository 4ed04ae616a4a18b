"""Internal wrenches without a centre: by average consensus of wrenches, or less a load that arms learn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.consensus import (
    MeanGains,
    averaged_loop_radius,
    disagreement,
    estimator_radius,
    graph_eigenvalues,
    require_consensus,
)
from coop_pin.control.exchanged_wrench import ExchangedWrench, heard
from coop_pin.control.force_path import (
    INSIST,
    ConsensusForcePath,
    ForcePath,
    LearnedForcePath,
    MessageForcePath,
)
from coop_pin.control.interface import (
    ArmCommand,
    ArmController,
    ArmMeasurement,
    ArmReference,
    ControlledArm,
)
from coop_pin.errors import FieldError, InvalidStateError
from coop_pin.spatial import weight_wrench


class AveragedState(NamedTuple):
    """Memory of an arm that averages wrenches.

    Attributes:
        mean: nu, N and N m, shape (k_0,).
        correction: eta, N and N m, shape (k_0,).
        wrench_age: age of the wrist's sample at the last tick, ticks; inf before the first.
        law: state of the law.
    """

    mean: Array
    correction: Array
    wrench_age: float
    law: Any


@dataclass(frozen=True, eq=False)
class AveragedWrench(ArmController):
    """A law that measures the internal wrench over any connected graph: ``f_i = F_i - c_i m nu_i``.

    nu_i follows the mean of the m wrist wrenches by proportional-integral average consensus::

        nu_i  <- nu_i + gamma (F_i - nu_i) - k_P sum_j (nu_i - nu_j) + k_I sum_j (eta_i - eta_j)
        eta_i <- eta_i - k_I sum_j (nu_i - nu_j),   nu_i(t_0) = F_i,  eta_i(t_0) = 0

    over the arms j that it hears, all as they were sent. For constant wrenches the error vanishes, from any
    nu and eta: lost messages leave nothing behind. It converges by ``estimator_radius`` in a tick. Freeman,
    Yang and Lynch, "Stability and convergence properties of dynamic average consensus estimators", CDC 2006,
    in discrete time.

    Every arm says nu_i and eta_i, 2 k_0 numbers, and then what its law says. Its own F_i acts at once: the
    delay of the network slows the agreement; the loop of the anchor has ``averaged_loop_radius``.

    Attributes:
        law: Law of this arm.
        arm: Numbers of the arm; c_i is its load share where references name none.
        path: The gains.
        arms: m.
    """

    needs: ClassVar[tuple[str, ...]] = ("messages", "wrenches of all arms")

    law: ArmController
    arm: ControlledArm
    path: ConsensusForcePath
    arms: int

    def message(
        self, measurement: ArmMeasurement, reference: ArmReference, state: AveragedState | None
    ) -> Array:
        """Return nu_i, eta_i and what the law says, shape (2 k_0 + w,)."""
        nu, eta = self._mean(measurement, state)
        law = None if state is None else state.law
        return np.concatenate((nu, eta, self.law.message(measurement, reference, law)))

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> AveragedState:
        """Return nu = F, eta = 0 and the first state of the law; raises as the law."""
        nu, eta = self._mean(measurement, None)
        seen = self._with_wrench(measurement, reference, nu)
        return AveragedState(nu, eta, measurement.interaction_wrench_age, self.law.init(seen, reference))

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: AveragedState) -> ArmCommand:
        """Return the command of the law, and the next state; raises as the law."""
        F, age, path = _own_wrench(measurement, self.arm), measurement.interaction_wrench_age, self.path
        nu, eta = self._mean(measurement, state)
        command = self.law.step(self._with_wrench(measurement, reference, nu), reference, state.law)
        apart = disagreement(self.arm.name, heard(measurement))
        nu_apart, eta_apart = apart[: len(nu)], apart[len(nu) : 2 * len(nu)]
        change = path.input_gain * (F - nu) - path.proportional_gain * nu_apart
        later = AveragedState(
            nu + change + path.integral_gain * eta_apart,
            eta - path.integral_gain * nu_apart,
            age,
            command.state,
        )
        return replace(command, state=later)

    def remarks(self, pose: Array, state: AveragedState) -> list[str]:
        """Return the sentences of the law."""
        return self.law.remarks(pose, state.law)

    def _mean(self, measurement: ArmMeasurement, state: AveragedState | None) -> tuple[Array, Array]:
        """Return nu and eta; until the wrist has a first sample, F and 0."""
        F = _own_wrench(measurement, self.arm)
        if state is None:
            return F, 0.0 * F
        return np.where(state.wrench_age < np.inf, state.mean, F), state.correction

    def _with_wrench(self, measurement: ArmMeasurement, reference: ArmReference, nu: Array) -> ArmMeasurement:
        """Return the measurement with the internal wrench, and the messages of the law."""
        return _measured(measurement, reference, self.arm, self.arms * nu, 2 * len(nu))


class LearnedState(NamedTuple):
    """Memory of an arm that learns the load.

    Attributes:
        belief: mass by its own wrist, as mean times precision, and precision, shape (2,).
        correction: z, of the consensus on both, shape (2,).
        twist: V_WP at the last tick, m/s and rad/s, shape (k_0,).
        law: state of the law.
    """

    belief: Array
    correction: Array
    twist: Array
    law: Any


@dataclass(frozen=True, eq=False)
class LearnedLoad(ArmController):
    """A law whose internal wrench is its wrist's less its share of a learned load: ``f = F - c mass phi_d``.

    Bayesian linear regression at every arm, and dynamic average consensus on what each believes::

        m F_i = phi mass + noise,  phi = g - dV/T on the linear rows, the wrench of a kilogram
        u_i <- u_i + [phi . m F_i, phi . phi] / sigma^2         mean times precision, and precision
        x_i  = u_i - z_i,   z_i <- z_i + gain sum_j (x_i - x_j),   mass = x_i[0] / x_i[1]

    dV is what the twist gained in the last tick; phi_d = g - A_d. An internal wrench spoils what one arm
    believes, and none of the mean over all: there it adds to zero. So all come to the regression of the
    resultant wrench. The mass of P. Budde gen. Dohmann, A. Lederer, M.
    Dissemond and S. Hirche, "Distributed Bayesian online learning for cooperative manipulation" (2021),
    arXiv:2104.04342, equations (18), (19), (32) and (34); there with the places of the grasps, from the arms'
    impedances in place of wrenches.

    Every arm says x_i, two numbers, and then what its law says; wrenches do not cross. Where the mass is
    wrong, or the load no weight, what is left of it is a load on the motion, as of an arm's own wrench.

    Attributes:
        law: Law of this arm.
        arm: Numbers of the arm; c_i is its load share where references name none.
        path: Prior of the mass, and the gain.
        arms: m.
    """

    needs: ClassVar[tuple[str, ...]] = ("messages", "own wrench")

    law: ArmController
    arm: ControlledArm
    path: LearnedForcePath
    arms: int

    def message(
        self, measurement: ArmMeasurement, reference: ArmReference, state: LearnedState | None
    ) -> Array:
        """Return x_i and what the law says, shape (2 + w,)."""
        x, law = (self._prior(), None) if state is None else (state.belief - state.correction, state.law)
        return np.concatenate((x, self.law.message(measurement, reference, law)))

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> LearnedState:
        """Return what is expected, and the first state of the law; raises as the law."""
        x = self._prior()
        seen = self._with_wrench(measurement, reference, x)
        return LearnedState(x, 0.0 * x, measurement.payload_twist, self.law.init(seen, reference))

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: LearnedState) -> ArmCommand:
        """Return the command of the law, and the next state; raises as the law."""
        F, V = _own_wrench(measurement, self.arm), measurement.payload_twist
        phi = self._wrench_of_a_kilogram((V - state.twist) / self.arm.period)
        seen = self._with_wrench(measurement, reference, state.belief - state.correction)
        command = self.law.step(seen, reference, state.law)
        precision = np.where(measurement.interaction_wrench_age < np.inf, self.path.force_deviation**-2, 0.0)
        news = precision * np.array([self.arms * phi.dot(F), phi.dot(phi)])
        apart = disagreement(self.arm.name, heard(measurement))[:2]
        z = state.correction + self.path.consensus_gain * apart
        return replace(command, state=LearnedState(state.belief + news, z, V, command.state))

    def remarks(self, pose: Array, state: LearnedState) -> list[str]:
        """Return the mass that is believed, and the sentences of the law."""
        mean, precision = state.belief - state.correction
        return [f"it has learned a payload of {mean / precision:.4g} kg", *self.law.remarks(pose, state.law)]

    def _prior(self) -> Array:
        """Return mean times precision, and precision, of the mass that is expected."""
        return np.array([self.path.payload_mass, 1.0]) / self.path.mass_deviation**2

    def _wrench_of_a_kilogram(self, acceleration: Array) -> Array:
        """Return phi, the wrench on the arms by a kilogram with an acceleration of P, shape (k_0,)."""
        is_linear = np.array([float(index < 3) for index in self.arm.rows.indices])
        return self.arm.rows.select(weight_wrench(1.0, self.arm.gravity)) - is_linear * acceleration

    def _with_wrench(self, measurement: ArmMeasurement, reference: ArmReference, x: Array) -> ArmMeasurement:
        """Return the measurement with the internal wrench, and the messages of the law."""
        load = x[0] / x[1] * self._wrench_of_a_kilogram(reference.acceleration)
        return _measured(measurement, reference, self.arm, load, 2)


def with_told_wrench(law: ArmController, arm: ControlledArm, path: ForcePath, scenario: Any) -> ArmController:
    """Return a law that forms its internal wrench from messages, where its force path says so, else the law.

    Args:
        law: Law of the arm.
        arm: Numbers of the arm.
        path: Force path.
        scenario: Scenario, of which network and arms are looked at.

    Raises:
        FieldError: the graph is not connected both ways, or consensus over it is unstable with the gains.
    """
    if isinstance(path, MessageForcePath):
        return ExchangedWrench(law, arm)
    if not isinstance(path, ConsensusForcePath | LearnedForcePath):
        return law
    names, network = list(scenario.cell.arms), scenario.network
    edges, delay = network.edges_at(0.0, names), network.slowest_of(names)
    if isinstance(path, LearnedForcePath):
        gain = "controller.force_path.consensus_gain"
        require_consensus(edges, names, path.consensus_gain, delay, gain)
        return LearnedLoad(law, arm, path, len(names))
    gains = MeanGains(path.input_gain, path.proportional_gain, path.integral_gain, delay)
    _require_decay(graph_eigenvalues(edges, names), gains, scenario)
    return AveragedWrench(law, arm, path, len(names))


def _require_decay(eigenvalues: Array, gains: MeanGains, scenario: Any) -> None:
    """Refuse gains with which the means, or the law's feedback on them, grow; see with_told_wrench."""
    late = f"over this graph with messages {gains.delay} ticks late"
    if (radius := estimator_radius(eigenvalues, gains)) >= 1.0:
        detail = f"grows by {radius:.4g} a tick {late}; lower its gains"
        raise FieldError(detail, "controller.force_path")
    loop = scenario.controller.loop(scenario.timing)
    fed_back = {"anchor_gain": loop.anchor_gain, "force_gain": loop.force_gain, "delay": loop.delay}
    radius = averaged_loop_radius(eigenvalues, gains, **fed_back)
    if radius >= 1.0 and not scenario.beyond_bound:
        detail = f"is {loop.anchor_gain:g}, but the anchored integral on means grows by {radius:.4g} a tick"
        raise FieldError(f"{detail} {late}; lower it, {INSIST}", "controller.gains.anchor_gain")


def _own_wrench(measurement: ArmMeasurement, arm: ControlledArm) -> Array:
    """Return F_i.

    Raises:
        InvalidStateError: the arm has no wrist sensor.
    """
    if measurement.interaction_wrench is None:
        raise InvalidStateError(f"arm {arm.name!r} has no wrist sensor; give it one: sensors.wrist")
    return measurement.interaction_wrench


def _measured(
    measurement: ArmMeasurement, reference: ArmReference, arm: ControlledArm, load: Array, size: int
) -> ArmMeasurement:
    """Return a measurement with F_i - c_i load for the internal wrench, f_d before the wrist's first sample.

    Args:
        measurement: Measurement of the arm.
        reference: Reference of the arm.
        arm: Numbers of the arm.
        load: Wrench of the payload on all arms, shape (k_0,).
        size: Number of numbers of a message that are not the law's.
    """
    age, F = measurement.interaction_wrench_age, _own_wrench(measurement, arm)
    share = arm.load_share if reference.load_share is None else reference.load_share
    f_d = arm.rows.turn(measurement.payload_pose, reference.internal_wrench)
    messages = heard(measurement)
    return measurement._replace(
        internal_wrench=np.where(age < np.inf, F - share * load, f_d),
        internal_wrench_age=age,
        messages={name: one._replace(numbers=one.numbers[size:]) for name, one in messages.items()},
    )
