"""Mean-pose law: the payload-space law of every arm, acting on the mean of what all arms see."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any, ClassVar, Literal

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.force_path import SampledLoop
from coop_pin.control.interface import (
    ArmMeasurement,
    ArmReference,
    CellCommand,
    CellController,
    ControlledArm,
)
from coop_pin.control.payload_space import PayloadSpace, PayloadSpaceGains
from coop_pin.control.steady_state import SteadyDirection
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

    All arms must average the same numbers, as sent: rounded and delayed alike. An arm that loses a message
    while others have it sees another mean, and its integral drifts from theirs; all arms then go on with the
    last set that all have. Here every set arrives.

    Attributes:
        laws: Laws of the arms.
    """

    needs: ClassVar[tuple[str, ...]] = ("poses of all arms",)

    laws: CellController

    def init(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Any, ...]:
        """Return the first state of each arm's law; raises as the law."""
        return self.laws.init(_agreed(measurements, references[0].pose), references)

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return the torque and the next state of each arm; raises as the law."""
        return self.laws.step(_agreed(measurements, references[0].pose), references, state)


def _agreed(measurements: Sequence[ArmMeasurement], X_d: Array) -> list[ArmMeasurement]:
    """Return the measurements with the means of all pose errors, put to the desired pose, and twists."""
    e = _mean([pose_error(seen.payload_pose, X_d) for seen in measurements])
    V = _mean([seen.payload_twist for seen in measurements])
    X = np.zeros_like(measurements[0].payload_pose)
    X[:3, :3], X[:3, 3], X[3, 3] = exp3(e[3:]).dot(X_d[:3, :3]), X_d[:3, 3] + e[:3], 1.0
    return [seen._replace(payload_pose=X, payload_twist=V) for seen in measurements]


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

    Its integral does not leak where no wrench is measured, unless ``gains.leak`` says so.
    """

    reads_plan: ClassVar[bool] = False

    kind: Literal["mean-pose"] = "mean-pose"  # type: ignore[assignment]  # names the class, not its base

    @property
    def needs(self) -> tuple[str, ...]:
        """What the law uses besides kinematics: the poses of all arms, and wrenches as stated."""
        return ("poses of all arms", *super().needs)

    def _leak(self, gains: PayloadSpaceGains) -> float:
        """Return lambda, 1/s: none where the integrals agree by themselves."""
        return super()._leak(gains) if self.measures or gains.leak is not None else 0.0

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller of the cell; see Law."""
        return MeanPoseController(super().build(scenario, arms))

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return those of the payload-space law, on which all arms agree."""
        return [AgreedDirection(*direction) for direction in super().steady_directions(rows, loop, period)]
