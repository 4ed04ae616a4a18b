"""Mean-pose law: the payload-space law of every arm on the mean of the poses and twists of all arms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Positive
from coop_pin.base.spatial import TaskRows, exp3, pose_error
from coop_pin.control.bounds import SampledLoop
from coop_pin.control.consensus import ANY_AGE, disagreement, mean_received, require_consensus
from coop_pin.control.controller import ArmCommand, ArmController, CellController, DecentralisedController
from coop_pin.control.law import LoadTransfer
from coop_pin.control.law_wrapper import CellLawWrapper, LawWrapper, Parts, Received, WrappedState
from coop_pin.control.laws.payload_space import PayloadSpace
from coop_pin.control.laws.payload_space_controller import PayloadSpaceController, PayloadSpaceGains
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.steady_state import SteadyDirection


@dataclass(frozen=True, eq=False)
class MeanPoseController(CellLawWrapper):
    """Payload-space law of every arm on the mean of all arms' pose errors and twists.

    ::

        e = (1/m) sum_j [p_j - p_d, log(R_j R_d^T)],   V = (1/m) sum_j V_j
        p = p_d + e_p,   R = exp(e_R) R_d                for every arm, in place of its own p_i, R_i, V_i

    m poses and twists cross between the arms at each tick, wrenches do not. Equal views make equal integrals:
    a kinematic bias moves the payload by its mean and leaves no internal force that grows, and no integral
    needs a leak. What the arms do not see, such as friction in their joints, stays in the internal force.

    Here every view arrives at once and exactly; MeanPoseByMessages has them from a network.
    """

    def transformed(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Sequence[ArmMeasurement], Sequence[ArmReference]]:
        """Return the measurements with the mean of all views, and the references."""
        X_d = references[0].pose
        mean = reduce(add, [view_of(each, X_d) for each in measurements]) / float(len(measurements))
        return [placed_at(each, mean, X_d) for each in measurements], references


@dataclass(frozen=True, eq=False)
class MeanPoseByMessages(LawWrapper):
    """Mean-pose law of one arm, by messages with the views of all arms.

    Every arm sends ``[p_i - p_d, log(R_i R_d^T), V_i]``, k_0 + 6 numbers, and averages the latest of all
    views as they were sent. So it takes its own view rounded and delayed like the others: else the arms'
    means, and with them their integrals, differ by a constant for ever.

    A view that is lost is replaced by the last that arrived: the means then differ by what that view changed
    since, which is no bias and averages out. ``skips`` leaves it out instead: the means differ by the bias,
    and the integrals drift apart. It is for arms that fall silent; let the integral leak then.

    Attributes:
        law: Payload-space law of this arm.
        name: Name of this arm.
        skips: Whether a view that is older than this arm's own is left out.
    """

    name: str
    skips: bool = False

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return this arm's view."""
        return {"view": view_of(measurement, reference.pose)}

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Any,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Any]:
        """Return the measurement with the mean of the views; its own before any arrived."""
        views = received["view"]
        mean = mean_received(views, sent["view"], views[self.name].age if self.skips else ANY_AGE)
        return placed_at(measurement, mean, reference.pose), memory


@dataclass(frozen=True, eq=False)
class ConsensusPose(LawWrapper):
    """Mean-pose law of one arm by consensus with its neighbours.

    ::

        x_i = u_i - z_i,   z_i <- z_i + g sum_j (x_i - x_j),   z_i(t_0) = 0

    u_i is the view of the arm, and x_i takes the place of the mean. Every arm sends x_i; its neighbours' and
    its own enter the sum as they were sent, so that what one adds the other takes away: the x_i keep the mean
    of the views, and come to it at the rates 1 - g lambda, lambda > 0 the eigenvalues of the graph's
    Laplacian. A constant bias of a view leaves no disagreement. Of views that change, x_i is late by about
    1 / (g lambda_2) ticks. The memory is z_i. Dynamic average consensus of first order: Zhu and Martinez,
    Automatica 46 (2010).

    Attributes:
        law: Payload-space law of this arm.
        name: Name of this arm.
        gain: g, less than ``consensus_bound``.
    """

    name: str
    gain: float

    def start(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return z = 0, shape (6 + k_0,)."""
        return np.zeros(6 + len(measurement.payload_twist))

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return x_i."""
        return {"view": view_of(measurement, reference.pose) - state.memory}

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Array,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Array]:
        """Return the measurement at x_i, and the next z_i."""
        z = memory + self.gain * disagreement(self.name, received["view"])
        return placed_at(measurement, sent["view"], reference.pose), z


def view_of(measurement: ArmMeasurement, X_d: Array) -> Array:
    """Return the pose error and the twist as an arm measures them, shape (6 + k_0,)."""
    return np.concatenate((pose_error(measurement.payload_pose, X_d), measurement.payload_twist))


def placed_at(measurement: ArmMeasurement, view: Array, X_d: Array) -> ArmMeasurement:
    """Return a measurement with the pose and twist of a view, at a desired pose."""
    X = np.zeros_like(measurement.payload_pose)
    X[:3, :3], X[:3, 3], X[3, 3] = exp3(view[3:6]).dot(X_d[:3, :3]), X_d[:3, 3] + view[:3], 1.0
    return measurement._replace(payload_pose=X, payload_twist=view[6:])


class ExchangedPoses(PayloadSpace):
    """Payload-space law on the poses of all arms, whatever it makes of them; a base of laws."""

    controls_grasps: ClassVar[bool] = False  # views by tips that turn in their joints have no mean

    @model_validator(mode="after")
    def _sees_no_deflection(self) -> Self:
        if self.knows_deflection:
            detail = "is true, but the poses that all arms see together have no deflection by a squeeze"
            raise FieldError(f"{detail}; leave it out", "knows_deflection")
        return self

    @property
    def load_transfer(self) -> LoadTransfer:
        """Response of an arm that reads no plan: the poses are those of all."""
        return super().load_transfer._replace(follows_plan=False)

    @property
    def needs(self) -> tuple[str, ...]:
        """Needs of the law: the poses of all arms, and wrenches as stated."""
        return ("poses of all arms", *super().needs)


class MeanPose(ExchangedPoses):
    """The payload-space law on exchanged poses: MeanPoseController.

    Where the scenario has a network, the arms hear each other through it, by MeanPoseByMessages; without one
    they are one controller. Without a measured wrench nothing leaks without ``gains.leak``.

    Attributes:
        on_loss: substitute of a view that did not arrive: the "last" that did, or none, "skip".
        averaging: way to the mean by messages: of "all" views, which each arm hears, or by "consensus" of
            neighbours over any connected graph.
        consensus_gain: g of the consensus.
        leak_to: Goal of ``gains.leak``: the integral of the "start", or by messages the "mean" of all arms'
            integrals, by AgreedIntegral.
    """

    works_apart: ClassVar[bool] = False  # nothing would keep a tool beside the payload

    kind: Literal["mean-pose"] = "mean-pose"  # type: ignore[assignment]  # names the class, not its base
    on_loss: Literal["last", "skip"] = "last"
    averaging: Literal["all", "consensus"] = "all"
    consensus_gain: Positive = 0.25
    leak_to: Literal["start", "mean"] = "start"

    @model_validator(mode="after")
    def _leaks_somewhere(self) -> Self:
        if self.leak_to == "mean" and (self.measures or not self.gains.leak):
            why = "a measured wrench anchors the integral" if self.measures else "gains.leak is its rate"
            detail = f"is 'mean', but {why}; " + ("take 'start'" if self.measures else "state one above 0")
            raise FieldError(detail, "leak_to")
        return self

    def _leak(self, gains: PayloadSpaceGains) -> float:
        """Return lambda, 1/s: none where the integrals agree by themselves."""
        return super()._leak(gains) if self.measures or gains.leak is not None else 0.0

    def controller_of(self, arm: ControlledArm, gains: PayloadSpaceGains, scenario: Any) -> ArmController:
        """Return the law of one arm; without messages all integrals are equal, and leak nothing."""
        law: Any = super().controller_of(arm, gains, scenario)
        if self.leak_to == "start":
            return law
        if scenario.network is not None:
            return AgreedIntegral(law)
        return replace(law, integral=law.integral._replace(leak=0.0))

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller of the cell, or those of the arms where messages cross; see Law."""
        laws, network = self.controllers(scenario, arms), scenario.network
        if network is None:
            return MeanPoseController(DecentralisedController(laws))
        if self.averaging == "consensus":
            gain = self.consensus_gain
            require_consensus(network, list(laws), gain, "controller.consensus_gain")
            return DecentralisedController(
                {name: ConsensusPose(law, name, gain) for name, law in laws.items()}
            )
        names, edges = list(laws), network.edges_at(0.0, list(laws))
        pairs = [(one, other) for one in names for other in names if one != other]
        if missing := [f"{other} does not hear {one}" for one, other in pairs if (one, other) not in edges]:
            detail = f"leaves out messages ({', '.join(missing)}); 'mean-pose' averages all views: take 'all'"
            raise FieldError(detail, "network.graph")
        skips = self.on_loss == "skip"
        if skips and network.longest_silence_of(names, scenario.clock):
            detail = (
                "is 'skip', but with network.threshold arms are silent where nothing changed; take 'last'"
            )
            raise FieldError(detail, "controller.on_loss")
        return DecentralisedController(
            {name: MeanPoseByMessages(law, name, skips) for name, law in laws.items()}
        )

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return those of the payload-space law, on which all agree; a leak to the mean takes no load."""
        directions = super().steady_directions(rows, loop, period)
        keeps = self.leak_to == "mean"
        return [each._replace(apart=0.0, load_rate=0.0 if keeps else each.load_rate) for each in directions]


@dataclass(frozen=True, eq=False)
class AgreedIntegral(LawWrapper):
    """Payload-space law of one arm, whose integral leaks to the mean of the integrals of its neighbours.

    ::

        D_i  = (Z_i - Z_i(t_0)) / c_i
        Z_i <- Z_i - lambda T (Z_i - Z_i(t_0) - c_i mean_j D_j)      its own D_i as sent among the D_j

    By equal views all D_i are equal, and nothing leaks. What they differ by, by a view that was lost, a drive
    at its limit or the first ticks of a consensus, is internal force; it decays by 1 - lambda T a tick where
    all hear all, and no slower than by the graph's second eigenvalue elsewhere. Their mean does not leak:
    it still takes any constant load. Distributed-averaging proportional-integral control: Simpson-Porco,
    Doerfler and Bullo, Automatica 49 (2013), with load shares in place of the inverters' ratings.

    Every arm sends D_i, k_0 numbers. The memory is Z(t_0).

    Attributes:
        law: Payload-space law of this arm, with lambda and without a measured wrench.
    """

    law: PayloadSpaceController

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return D_i, zero before ``init``."""
        if state.law is None:
            return {"gained": np.zeros(self.law.arm.rows.size)}
        return {"gained": (state.law.integral.value - state.memory) / self.law.arm.load_share}

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> WrappedState:
        """Return the first integral and the first state of the law; raises as the law."""
        law = self.law.init(measurement, reference)
        return WrappedState(law.integral.value, law)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> ArmCommand:
        """Return the command of the law, which leaks to the mean, and the next state; raises as the law."""
        measurement, goal = self.inner(measurement, reference, state)
        integral = state.law.integral._replace(anchored=goal)
        command = self.law.step(measurement, reference, state.law._replace(integral=integral))
        return replace(command, state=state._replace(law=command.state))

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Array,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Array]:
        """Return the measurement, and Z_i(t_0) + c_i mean_j D_j."""
        mean = mean_received(received["gained"], sent["gained"])
        return measurement, memory + self.law.arm.load_share * mean
