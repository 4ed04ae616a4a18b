"""Mean-pose law: the payload-space law of every arm, acting on the mean of what all arms see."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any, ClassVar, Literal

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.force_path import SampledLoop
from coop_pin.control.interface import (
    ArmCommand,
    ArmController,
    ArmMeasurement,
    ArmReference,
    CellCommand,
    CellController,
    ControlledArm,
    DecentralisedController,
    Message,
)
from coop_pin.control.payload_space import PayloadSpace, PayloadSpaceGains
from coop_pin.control.steady_state import SteadyDirection
from coop_pin.errors import FieldError, InvalidStateError
from coop_pin.spatial import exp3, pose_error
from coop_pin.spatial.task_rows import TaskRows


@dataclass(frozen=True, eq=False)
class MeanPoseController(CellController):
    """The payload-space law of every arm on the mean of all arms' pose errors and twists.

    ::

        e = (1/m) sum_j [p_j - p_d, log(R_j R_d^T)],   V = (1/m) sum_j V_j
        p = p_d + e_p,   R = exp(e_R) R_d                for every arm, in place of its own p_i, R_i, V_i

    m poses and twists cross between the arms at each tick, wrenches do not. Equal views make equal integrals:
    a kinematic bias moves the payload by its mean and leaves no internal force that grows, and no integral
    needs a leak. What the arms do not see, such as friction in their joints, stays in the internal force.

    Here every view arrives at once and exactly; MeanPoseByMessages has them from a network.

    Attributes:
        laws: Laws of the arms.
    """

    needs: ClassVar[tuple[str, ...]] = ("poses of all arms",)

    laws: CellController

    def init(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Any, ...]:
        """Return the first state of each arm's law; raises as the law."""
        return self.laws.init(self._agreed(measurements, references), references)

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return the torque and the next state of each arm; raises as the law."""
        return self.laws.step(self._agreed(measurements, references), references, state)

    @staticmethod
    def _agreed(
        measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> list[ArmMeasurement]:
        """Return the measurements with the mean of all views."""
        X_d = references[0].pose
        mean = _mean([_view(seen, X_d) for seen in measurements])
        return [_placed(seen, mean, X_d) for seen in measurements]


@dataclass(frozen=True, eq=False)
class MeanPoseByMessages(ArmController):
    """The mean-pose law of one arm, which hears the views of the others and its own.

    Every arm says ``[p_i - p_d, log(R_i R_d^T), V_i]``, k_0 + 6 numbers, and averages the latest of all views
    as they were sent. So it takes its own view rounded and delayed like the others: else the arms' means, and
    with them their integrals, differ by a constant for ever.

    A view that is lost is replaced by the last that arrived: the means then differ by what that view changed
    since, which is no bias and averages out. ``skips`` leaves it out instead: the means differ by the bias,
    and the integrals drift apart. It is for arms that fall silent; let the integral leak then.

    Attributes:
        law: Payload-space law of this arm.
        name: Name of this arm.
        skips: Whether a view that is older than this arm's own is left out.
    """

    needs: ClassVar[tuple[str, ...]] = ("messages", "poses of all arms")

    law: ArmController
    name: str
    skips: bool = False

    def message(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Array:
        """Return this arm's view: pose error and twist, shape (6 + k_0,)."""
        return _view(measurement, reference.pose)

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> Any:
        """Return the first state of the law; raises as the law."""
        return self.law.init(self._agreed(measurement, reference), reference)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> ArmCommand:
        """Return the command of the law at the mean of the views; raises as the law."""
        return self.law.step(self._agreed(measurement, reference), reference, state)

    def _agreed(self, measurement: ArmMeasurement, reference: ArmReference) -> ArmMeasurement:
        """Return the measurement with the mean of the views; its own before any arrived."""
        heard = _heard(measurement)
        oldest = heard[self.name].age if self.skips else np.finfo(float).max
        weights = [np.where(view.age <= oldest, 1.0, 0.0) for view in heard.values()]
        total = reduce(add, weights)
        sums = reduce(add, [w * view.numbers for w, view in zip(weights, heard.values(), strict=True)])
        alone = total < 0.5
        mean = np.where(alone, _view(measurement, reference.pose), sums / np.where(alone, 1.0, total))
        return _placed(measurement, mean, reference.pose)

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return the sentences of the law."""
        return self.law.remarks(pose, state)


def _heard(measurement: ArmMeasurement) -> Mapping[str, Message]:
    """Return the messages of a measurement."""
    if measurement.messages is None:
        raise InvalidStateError("the law hears no messages; give the scenario a network")
    return measurement.messages


def _view(seen: ArmMeasurement, X_d: Array) -> Array:
    """Return the pose error and the twist that an arm sees, shape (6 + k_0,)."""
    return np.concatenate((pose_error(seen.payload_pose, X_d), seen.payload_twist))


def _placed(seen: ArmMeasurement, mean: Array, X_d: Array) -> ArmMeasurement:
    """Return a measurement with a mean of views, put to the desired pose."""
    X = np.zeros_like(seen.payload_pose)
    X[:3, :3], X[:3, 3], X[3, 3] = exp3(mean[3:6]).dot(X_d[:3, :3]), X_d[:3, 3] + mean[:3], 1.0
    return seen._replace(payload_pose=X, payload_twist=mean[6:])


def _mean(vectors: Sequence[Array]) -> Array:
    """Return the mean of vectors."""
    return reduce(add, vectors) / float(len(vectors))


class AgreedDirection(SteadyDirection):
    """A direction in which all arms see the same error, whatever their biases."""

    def force(self, share: float, bias: float) -> float:
        """Return the internal force of a bias: none."""
        return 0.0


class MeanPose(PayloadSpace):
    """The payload-space law on exchanged poses: MeanPoseController.

    Where the scenario has a network, the arms hear each other through it, by MeanPoseByMessages; without one
    they are one controller. Without a measured wrench nothing leaks unless ``gains.leak`` says so.

    Attributes:
        on_loss: substitute of a view that did not arrive: the "last" that did, or none, "skip".
    """

    reads_plan: ClassVar[bool] = False
    later_fields: ClassVar[tuple[str, ...]] = ("on_loss",)

    kind: Literal["mean-pose"] = "mean-pose"  # type: ignore[assignment]  # names the class, not its base
    on_loss: Literal["last", "skip"] = "last"

    @property
    def needs(self) -> tuple[str, ...]:
        """What the law uses besides kinematics: the poses of all arms, and wrenches as stated."""
        return ("poses of all arms", *super().needs)

    def _leak(self, gains: PayloadSpaceGains) -> float:
        """Return lambda, 1/s: none where the integrals agree by themselves."""
        return super()._leak(gains) if self.measures or gains.leak is not None else 0.0

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller of the cell, or those of the arms where messages cross; see Law."""
        laws = super().build(scenario, arms)
        network = scenario.network
        if network is None or not isinstance(laws, DecentralisedController):
            return MeanPoseController(laws)
        names, heard = list(laws.controllers), network.edges_at(0.0, list(laws.controllers))
        edges = [(one, other) for one in names for other in names if one != other]
        if missing := [f"{other} does not hear {one}" for one, other in edges if (one, other) not in heard]:
            detail = f"leaves arms unheard ({', '.join(missing)}); 'mean-pose' averages all views: take 'all'"
            raise FieldError(detail, "network.graph")
        skips = self.on_loss == "skip"
        return DecentralisedController(
            {name: MeanPoseByMessages(law, name, skips) for name, law in laws.controllers.items()}
        )

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return those of the payload-space law, on which all arms agree."""
        return [AgreedDirection(*direction) for direction in super().steady_directions(rows, loop, period)]
