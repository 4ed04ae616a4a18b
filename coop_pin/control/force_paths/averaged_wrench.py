"""Internal wrench of an arm over any connected graph, by average consensus on the wrist wrenches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import NotNegative, Positive
from coop_pin.control.consensus import disagreement, graph_eigenvalues
from coop_pin.control.controller import ArmController
from coop_pin.control.force_paths.exchanged_wrench import less_load, own_wrench
from coop_pin.control.force_paths.force_path import INSIST, PlainForcePath
from coop_pin.control.law_wrapper import LawWrapper, Parts, Received, WrappedState
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm

_AT_REST = 1e-9
"""Distance from 1 of a factor that counts as it: of an integral without an anchor."""


class AveragedState(NamedTuple):
    """Memory of an arm that averages wrenches.

    Attributes:
        mean: nu, N and N m, shape (k_0,).
        correction: eta, N and N m, shape (k_0,).
        wrench_age: age of the wrist's sample at the last tick, ticks; inf before the first.
    """

    mean: Array
    correction: Array
    wrench_age: float


@dataclass(frozen=True, eq=False)
class AveragedWrench(LawWrapper):
    """Law that measures the internal wrench over any connected graph: ``f_i = F_i - c_i m nu_i``.

    nu_i follows the mean of the m wrist wrenches by proportional-integral average consensus::

        nu_i  <- nu_i + gamma (F_i - nu_i) - k_P sum_j (nu_i - nu_j) + k_I sum_j (eta_i - eta_j)
        eta_i <- eta_i - k_I sum_j (nu_i - nu_j),   nu_i(t_0) = F_i,  eta_i(t_0) = 0

    over the arms j that it hears, all as they were sent. For constant wrenches the error vanishes, from any
    nu and eta: lost messages leave nothing behind. It converges by ``estimator_radius`` in a tick. Freeman,
    Yang and Lynch, "Stability and convergence properties of dynamic average consensus estimators", CDC 2006,
    in discrete time.

    Every arm sends nu_i and eta_i, 2 k_0 numbers. Its own F_i acts at once: the delay of the network slows
    the agreement; the loop of the anchor has ``averaged_loop_radius``.

    Attributes:
        law: Law of this arm.
        arm: Numbers of the arm; c_i is its load share where references name none.
        path: The gains.
        arms: m.
    """

    arm: ControlledArm
    path: ConsensusForcePath
    arms: int

    def start(self, measurement: ArmMeasurement, reference: ArmReference) -> AveragedState:
        """Return nu = F and eta = 0."""
        F = own_wrench(measurement, self.arm)
        return AveragedState(F, 0.0 * F, measurement.interaction_wrench_age)

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return nu_i and eta_i; until the wrist has a first sample, F and 0."""
        F, (nu, eta, age) = own_wrench(measurement, self.arm), state.memory
        return {"mean": np.where(age < np.inf, nu, F), "correction": eta}

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: AveragedState,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, AveragedState]:
        """Return the measurement with the internal wrench, and the next nu and eta."""
        F, path, nu = own_wrench(measurement, self.arm), self.path, sent["mean"]
        nu_apart, eta_apart = (disagreement(self.arm.name, received[part]) for part in ("mean", "correction"))
        change = path.input_gain * (F - nu) - path.proportional_gain * nu_apart
        following = AveragedState(
            nu + change + path.integral_gain * eta_apart,
            memory.correction - path.integral_gain * nu_apart,
            measurement.interaction_wrench_age,
        )
        return less_load(measurement, reference, self.arm, self.arms * nu), following


class ConsensusForcePath(PlainForcePath):
    """Internal wrench over any connected graph, by consensus on the mean of the wrenches: AveragedWrench.

    Attributes:
        input_gain: gamma, part of its own wrench that an arm's mean takes up in a tick.
        proportional_gain: k_P, on the disagreement with the arms that are heard.
        integral_gain: k_I, likewise.
    """

    kind: Literal["consensus"] = "consensus"
    input_gain: float = Field(default=0.2, gt=0.0, lt=2.0)
    proportional_gain: NotNegative = 0.25
    integral_gain: Positive = 0.2

    def modes(self, eigenvalue: float, delay: int) -> Array:
        """Return the polynomial of a mode of the disagreement, times z^2D.

        (z - 1 + gamma + k_P lambda z^-D)(z - 1) + (k_I lambda z^-D)^2, of Freeman, Yang and Lynch (2006) in
        discrete time.

        Args:
            eigenvalue: lambda of the graph's L.
            delay: D, ticks by which messages are late.
        """
        late, step = np.append(1.0, np.zeros(delay)), np.array([1.0, -1.0])
        alone = np.polymul(np.polymul([1.0, self.input_gain - 1.0], step), np.polymul(late, late))
        coupled = self.proportional_gain * eigenvalue * np.polymul(step, late)
        return np.polyadd(np.polyadd(alone, coupled), [(self.integral_gain * eigenvalue) ** 2])

    def wrapped(self, law: ArmController, arm: ControlledArm, scenario: Any) -> ArmController:
        """Return the law of an arm in an AveragedWrench.

        Raises:
            FieldError: means or feedback on them grow, or the graph is not connected both ways.
        """
        names, network = list(scenario.cell.arms), scenario.network
        eigenvalues, delay = graph_eigenvalues(network.edges_at(0.0, names), names), network.slowest_of(names)
        late = f"over this graph with messages {delay} ticks late"
        if (radius := estimator_radius(eigenvalues, self, delay)) >= 1.0:
            detail = f"grows by {radius:.4g} a tick {late}; lower its gains"
            raise FieldError(detail, "controller.force_path")
        loop = scenario.controller.loop(scenario.timing)
        radius = averaged_loop_radius(
            eigenvalues,
            self,
            delay,
            anchor_gain=loop.anchor_gain,
            force_gain=loop.force_gain,
            wrist_delay=loop.delay,
        )
        if radius >= 1.0 and not scenario.beyond_bound:
            detail = (
                f"is {loop.anchor_gain:g}, but the anchored integral on means grows by {radius:.4g} a tick"
            )
            raise FieldError(f"{detail} {late}; lower it, {INSIST}", "controller.gains.anchor_gain")
        return AveragedWrench(law, arm, self, len(names))


def estimator_radius(eigenvalues: Array, path: ConsensusForcePath, delay: int = 0) -> float:
    """Return the largest ``|z|`` of average consensus, by which it converges in a tick.

    That of the mean is 1 - gamma.

    Args:
        eigenvalues: lambda of the graph's L, the first of them 0, shape (m,).
        path: Gains.
        delay: D, ticks by which messages are late.
    """
    sizes = [np.abs(np.roots(path.modes(eigenvalue, delay))).max() for eigenvalue in eigenvalues[1:]]
    return float(max([abs(1.0 - path.input_gain), *sizes]))


def averaged_loop_radius(
    eigenvalues: Array,
    path: ConsensusForcePath,
    delay: int = 0,
    *,
    anchor_gain: float,
    force_gain: float = 0.0,
    wrist_delay: int = 0,
) -> float:
    """Return the largest ``|z|`` of anchor and force feedback on internal wrenches by average consensus.

    f = F - c m nu is the own wrench but for what nu follows of it, H = gamma (z - 1) z^2D / modes(z), with
    equal shares c m = 1. With Z[k] = Z[k-1] - g f_m[k] and a wrist that is late by D_w ticks::

        (z - 1) z^(D_w + 1) + (g z + K_f (z - 1)) (1 - H(z)) = 0

    Args:
        eigenvalues: lambda of the graph's L, the first of them 0, shape (m,).
        path: Gains of the consensus.
        delay: D, ticks by which messages are late.
        anchor_gain: g.
        force_gain: K_f.
        wrist_delay: D_w.
    """
    step, sizes = np.array([1.0, -1.0]), [0.0]
    loop = np.append(step, np.zeros(wrist_delay + 1))
    feedback = np.array([anchor_gain + force_gain, -force_gain])
    followed = path.input_gain * np.append(step, np.zeros(2 * delay))
    for eigenvalue in eigenvalues[1:]:
        modes = path.modes(eigenvalue, delay)
        fed_back = np.polymul(feedback, np.polysub(modes, followed))
        z = np.roots(np.polyadd(np.polymul(loop, modes), fed_back))
        sizes.append(float(np.abs(z[np.abs(z - 1.0) > _AT_REST]).max(initial=0.0)))
    return max(sizes)
