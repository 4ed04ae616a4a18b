"""Load of the arms that they learn together, and the internal wrench of an arm that is left of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.schema.base import NotNegative, Positive
from coop_pin.base.spatial import weight_wrench
from coop_pin.control.consensus import disagreement, require_consensus
from coop_pin.control.controller import ArmController
from coop_pin.control.force_paths.exchanged_wrench import less_load, own_wrench
from coop_pin.control.force_paths.force_path import PlainForcePath
from coop_pin.control.law_wrapper import LawWrapper, Parts, Received, WrappedState
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm


class LearnedState(NamedTuple):
    """Memory of an arm that learns the load.

    Attributes:
        belief: mass by its own wrist, as mean times precision, and precision, shape (2,).
        correction: z, of the consensus on both, shape (2,).
        twist: V_WP at the last tick, m/s and rad/s, shape (k_0,).
    """

    belief: Array
    correction: Array
    twist: Array


@dataclass(frozen=True, eq=False)
class LearnedLoad(LawWrapper):
    """Law whose internal wrench is its wrist's less its share of a learned load: ``f = F - c mass phi_d``.

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

    Every arm sends x_i, two numbers; wrenches do not cross. Where the mass is
    wrong, or the load no weight, what is left of it is a load on the motion, as of an arm's own wrench.

    Attributes:
        law: Law of this arm.
        arm: Numbers of the arm; c_i is its load share where references name none.
        path: Prior of the mass, and the gain.
        arms: m.
    """

    arm: ControlledArm
    path: LearnedForcePath
    arms: int

    def start(self, measurement: ArmMeasurement, reference: ArmReference) -> LearnedState:
        """Return the prior: mean times precision, and precision, of the mass that is expected."""
        prior = np.array([self.path.payload_mass, 1.0]) / self.path.mass_deviation**2
        return LearnedState(prior, 0.0 * prior, measurement.payload_twist)

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return x_i."""
        return {"belief": state.memory.belief - state.memory.correction}

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: LearnedState,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, LearnedState]:
        """Return the measurement with the internal wrench, and the next u, z and V."""
        F, V, x = own_wrench(measurement, self.arm), measurement.payload_twist, sent["belief"]
        phi = self._wrench_of_a_kilogram((V - memory.twist) / self.arm.period)
        precision = np.where(measurement.interaction_wrench_age < np.inf, self.path.force_deviation**-2, 0.0)
        news = precision * np.array([self.arms * phi.dot(F), phi.dot(phi)])
        apart = disagreement(self.arm.name, received["belief"])
        z = memory.correction + self.path.consensus_gain * apart
        load = x[0] / x[1] * self._wrench_of_a_kilogram(reference.acceleration)
        return less_load(measurement, reference, self.arm, load), LearnedState(memory.belief + news, z, V)

    def remarks(self, pose: Array, state: WrappedState) -> list[str]:
        """Return the mass that is believed, and the remarks of the law."""
        mean, precision = state.memory.belief - state.memory.correction
        return [f"it has learned a payload of {mean / precision:.4g} kg", *super().remarks(pose, state)]

    def _wrench_of_a_kilogram(self, acceleration: Array) -> Array:
        """Return phi, the wrench on the arms by a kilogram with an acceleration of P, shape (k_0,)."""
        rows = self.arm.rows
        return (
            rows.select(weight_wrench(1.0, self.arm.gravity)) - rows.are_linear.astype(float) * acceleration
        )


class LearnedForcePath(PlainForcePath):
    """Wrist wrench less the share of a load that the arms learn together: LearnedLoad.

    Attributes:
        payload_mass: Mean of the mass that is expected, kg.
        mass_deviation: Standard deviation of that mass, kg.
        force_deviation: Standard deviation of a wrist's force, N.
        consensus_gain: g of the consensus on what is learned.
    """

    exchanges_wrenches: ClassVar[bool] = False

    kind: Literal["learned-load"] = "learned-load"
    payload_mass: NotNegative = 0.0
    mass_deviation: Positive = 10.0
    force_deviation: Positive = 1.0
    consensus_gain: Positive = 0.25

    def wrapped(self, law: ArmController, arm: ControlledArm, scenario: Any) -> ArmController:
        """Return the law of an arm in a LearnedLoad.

        Raises:
            FieldError: the consensus does not come to the mean over the scenario's graph.
        """
        names, path = list(scenario.cell.arms), "controller.force_path.consensus_gain"
        require_consensus(scenario.network, names, self.consensus_gain, path)
        return LearnedLoad(law, arm, self, len(names))
