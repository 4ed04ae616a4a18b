"""Constants of a cell's dynamics: its arms, compliant grasps, friction and surroundings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.chain.free_flyer import displaced, increment_rate
from coop_pin.compiled.plant.arm_dynamics import ArmInput
from coop_pin.compiled.plant.serial_arm import (
    Numbers,
    RigidInertia,
    SerialArm,
    frames,
)
from coop_pin.description.events import Surroundings
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.grasps.spring_damper import SpringDamper
from coop_pin.model.joint_stops import JointStops
from coop_pin.model.transmission import Friction, friction
from coop_pin.results.energies import work_names
from coop_pin.tracing.tape import Number, Traced
from coop_pin.tracing.traced_array import parts, traced


class GraspNumbers(NamedTuple):
    """Numbers of a compliant grasp.

    Attributes:
        spring: spring and damper; zero where the grasp is open.
        X_PE: pose of the tip on the payload as the arm's own kinematics have it, shape (4, 4).
        X_PG: pose on the payload at which the spring rests, shape (4, 4).
    """

    spring: SpringDamper
    X_PE: Numbers
    X_PG: Numbers

    @classmethod
    def of_chain(cls, chain: CellChain) -> tuple[GraspNumbers | None, ...]:
        """Return those of each arm; None for a rigid grasp."""
        numbers: list[GraspNumbers | None] = [None] * len(chain.model.arms)
        grasps, springs = list(chain.cell.grasps.values()), chain.springs
        for i, spring, X_PG in zip(springs.arms, springs.acting(), springs.held().poses, strict=True):
            numbers[i] = cls(spring, grasps[i].matrix, X_PG)
        return tuple(numbers)


class CellNumbers(NamedTuple):
    """Constants of a cell's dynamics, most of which fold into its code.

    Attributes:
        arms: serial arms of the plant; the payload is not part of the last body of the one that carries it.
        carries: whether the payload is welded to each arm: to none where it is free.
        grasps: compliant grasp of each arm; None for a rigid one.
        tips: position of each tip in the payload frame, m, shape (m, 3).
        position_gain: omega^2 of Baumgarte's stabilisation, 1/s^2.
        velocity_gain: 2 zeta omega, 1/s.
        friction: friction of each arm.
        stops: end stops of each arm; None where it has none.
        surroundings: payload, and what acts on it from outside.
    """

    arms: tuple[SerialArm, ...]
    carries: tuple[bool, ...]
    grasps: tuple[GraspNumbers | None, ...]
    tips: Numbers
    position_gain: Number
    velocity_gain: Number
    friction: tuple[Friction, ...]
    stops: tuple[JointStops | None, ...]
    surroundings: Surroundings

    @classmethod
    def from_chain(cls, chain: CellChain) -> CellNumbers:
        """Return the constants of a chain whose payload is welded to an arm, or free on compliant grasps.

        Raises:
            TracingError: an arm is no serial chain.
        """
        tree, cell, model, arms = chain.model, chain.cell, chain.mechanism.model, []
        for slot in tree.arms:
            X_JP = model.frames[slot.tip].placement * pin.SE3(cell.grasps[slot.name].matrix).inverse()
            is_welded = slot.name in tree.closed_by_tree
            last = tree.carrier_inertia if is_welded else model.inertias[slot.joints[-1]]
            arms.append(SerialArm.from_model(model, slot.joints, X_JP, last))
        gains = chain.mechanism.stabilisation
        return cls(
            arms=tuple(arms),
            carries=tuple(slot.name in tree.closed_by_tree for slot in tree.arms),
            grasps=GraspNumbers.of_chain(chain),
            tips=np.array([cell.grasps[arm].matrix[:3, 3] for arm in cell.arms]),
            position_gain=gains.position_gain,
            velocity_gain=gains.velocity_gain,
            friction=tuple(friction(arm, name) for name, arm in cell.arms.items()),
            stops=tuple(chain.stops.arms),
            surroundings=cell.surroundings,
        )

    @property
    def carrier(self) -> int | None:
        """Index of the arm to which the payload is welded; None where it is free."""
        return self.carries.index(True) if any(self.carries) else None

    @property
    def closed(self) -> list[int]:
        """Indices of the arms whose grasps are closures."""
        return [i for i in range(len(self.arms)) if i != self.carrier and self.grasps[i] is None]

    @property
    def compliant(self) -> dict[int, GraspNumbers]:
        """Compliant grasps by the index of their arm."""
        return {i: grasp for i, grasp in enumerate(self.grasps) if grasp is not None}

    @property
    def joints(self) -> int:
        """Number of joints of all arms."""
        return sum(len(arm.bodies) for arm in self.arms)

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Sizes of configuration and velocity, a free payload's last, and number of works."""
        N, is_free = self.joints, self.carrier is None
        return N + 7 * is_free, N + 6 * is_free, len(self.works)

    @property
    def works(self) -> tuple[str, ...]:
        """Names of the works."""
        return work_names(bool(self.compliant), any(stops is not None for stops in self.stops))

    def by_arm(self, values: Numbers) -> list[Numbers]:
        """Return the part of each arm of values of all joints or drives, without those of a free payload."""
        return parts(values[: self.joints], [len(arm.bodies) for arm in self.arms])

    def displaced(self, q: Numbers, increments: Sequence[Numbers]) -> Numbers:
        """Return q (+) u of an increment u, a sum: shape (N,) or, with a free payload, (N + 7,)."""
        if self.carrier is not None:
            return sum(increments, q)
        N, u = self.joints, sum(increments[1:], increments[0])
        return traced(np.concatenate((q[:N] + u[:N], displaced(q[N:], u[N:]))))

    def increment_rate(self, u: Numbers, v: Numbers) -> Numbers:
        """Return u' with which q (+) u moves with velocity v, shape (N,) or (N + 6,)."""
        if self.carrier is not None:
            return v
        N = self.joints
        return traced(np.concatenate((v[:N], increment_rate(u[N:], v[N:]))))

    def moving_rows(self, q: Sequence[Numbers]) -> list[int]:
        """Return the rows of world six-vectors that are not zero by structure for every motion of the cell.

        Args:
            q: Joint positions of each arm, traced, shape (n,) each.
        """
        S = np.hstack([frames(arm, positions).S for arm, positions in zip(self.arms, q, strict=True)])
        return [row for row in range(6) if any(isinstance(x, Traced) or x != 0.0 for x in S[row])]

    def arm_inputs(self, payload: RigidInertia, *states: Sequence[Numbers]) -> list[ArmInput]:
        """Return the input of each arm, given q, v and tau of each."""
        arm_inputs = []
        for index, (arm, q, v, tau) in enumerate(zip(self.arms, *states, strict=True)):
            first, last, held = arm.bodies[0], arm.bodies[-1].inertia, (arm.R_JP, arm.p_JP)
            carried = last.plus(payload.moved(*held)) if index == self.carrier else last
            arm_inputs.append(ArmInput(q, v, tau, (first.R, first.p), carried, held))
        return arm_inputs
