"""Law in the rows of its arm's grasp: measurements and references about the frame of a joint, and gains."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.parts import fields_of, refilled
from coop_pin.base.spatial.grasp_rows import GraspRows
from coop_pin.base.spatial.task_rows import FullRows
from coop_pin.control.controller import ArmCommand, ArmController
from coop_pin.control.gains import Gains
from coop_pin.control.measurement import ArmMeasurement, ArmReference, Outgoing

_FULL = FullRows()
G = TypeVar("G", bound=Gains)


@dataclass(frozen=True, eq=False)
class GraspSpaceController(ArmController):
    """A law of one arm in the k rows of its own grasp, where the task rows are those of the payload.

    The arm sees its tip, not how far the joint has turned: of its view of the payload only the rows about C
    in axes of the desired C_d are used, so that the joint needs no encoder. With S the held rows::

        J_i = S R_d^T J_WC,    V_i = S R_d^T V_WC,    h_i = S R_d^T F_C,    e_i = S R_d^T [p - p_d, turn]

    The torque J_i^T h of the law is that of the wrench B_i h about P.

    Attributes:
        law: law of the arm, whose rows are those of the grasp.
        rows: rows of the grasp, and the task rows.
    """

    law: ArmController
    rows: GraspRows

    @property
    def command_kind(self) -> str:
        """Kind of the law's commands."""
        return self.law.command_kind

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> Any:
        """Return the law's state at t_0; raises as the law."""
        return self.law.init(*self.about_joint(measurement, reference))

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> ArmCommand:
        """Return the law's command and next state; raises as the law."""
        return self.law.step(*self.about_joint(measurement, reference), state)

    def message(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Outgoing:
        """Return the law's message."""
        return self.law.message(*self.about_joint(measurement, reference), state)

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return the remarks of the law."""
        return self.law.remarks(pose @ self.rows.X_PC, state)

    def about_joint(
        self, measurement: ArmMeasurement, reference: ArmReference
    ) -> tuple[ArmMeasurement, ArmReference]:
        """Return measurement and reference about C, in the rows of the grasp."""
        X_WP, X_WP_d, r = measurement.payload_pose, reference.pose, self.rows.X_PC[:3, 3]
        X_WC, X_WC_d, task = X_WP @ self.rows.X_PC, X_WP_d @ self.rows.X_PC, self.rows.task
        S, r_d = self._turned(X_WC_d[:3, :3]), X_WP_d[:3, :3] @ r
        seen, desired = S @ _FULL.twist_shift(X_WP[:3, :3] @ r), S @ _FULL.twist_shift(r_d)
        w = task.expand(reference.twist)[3:]
        centripetal = np.concatenate((np.cross(w, np.cross(w, r_d)), np.zeros(3)))
        measurement = measurement._replace(
            payload_pose=X_WC,
            payload_twist=seen @ task.expand(measurement.payload_twist),
            payload_jacobian=seen @ task.expand(measurement.payload_jacobian.T).T,
            internal_wrench=self._at_joint(measurement.internal_wrench, X_WP_d),
            interaction_wrench=self._at_joint(measurement.interaction_wrench, X_WP_d),
        )
        reference = reference._replace(
            pose=X_WC_d,
            twist=desired @ task.expand(reference.twist),
            acceleration=desired @ task.expand(reference.acceleration) + S @ centripetal,
            internal_wrench=self._from_payload @ reference.internal_wrench,
        )
        return measurement, reference

    @cached_property
    def _from_payload(self) -> Array:
        """Map of a wrench about P in payload axes to its rows about C, shape (k, k_0)."""
        X_PC = self.rows.X_PC
        about_C = self._turned(X_PC[:3, :3]) @ _FULL.twist_shift(-X_PC[:3, 3]).T
        return about_C[:, list(self.rows.task.indices)]

    def _at_joint(self, F: Array | None, X_WP_d: Array) -> Array | None:
        """Return the rows of a measured wrench, with the payload as desired; None of None."""
        return None if F is None else self._from_payload @ self.rows.task.turn(X_WP_d.T, F)

    def _turned(self, R: Array) -> Array:
        """Return S R^T, shape (k, 6)."""
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = R.T
        return turn[list(self.rows.indices)]


def gains_in_grasp(gains: G, rows: GraspRows, in_payload: bool, feedback: str = "") -> G:
    """Return sized gains of a law on the rows of a grasp, from those on the task rows.

    ::

        K_i = (B_i^T K^-1 B_i)^-1

    of a feedback gain K about P: c K_i is the least wrench that the grasp transmits in place of c K x, in the
    norm of K^-1. Motion terms then leave no internal wrench in the split with Q = K^-1, the payload never
    feels more than K, and of a rigid grasp it is the law about P. Other gains are taken row by row.

    Args:
        gains: Gains on the task rows, as arrays.
        rows: Rows of the grasp.
        in_payload: Whether the axes of K are those of the payload.
        feedback: Name of K; none if empty.

    Raises:
        FieldError: a gain is not one value for positions and one for rotations, and would turn.
    """
    linear, of_grasp = rows.task.are_linear, rows.are_linear
    arrays = dict[str, Array]()
    for name in gains.on_rows:
        gain, path = fields_of(gains)[name], f"controller.gains.{name}"
        diagonal = gain.diagonal()
        kinds = [{*diagonal[linear].tolist()}, {*diagonal[~linear].tolist()}]
        is_equal = max(map(len, kinds)) == 1 and not np.any(gain - np.diag(diagonal))
        if not is_equal and not (in_payload and name == feedback):
            detail = f"is {gain.tolist()}; on a grasp that is a joint it must be one value for all positions"
            raise FieldError(f"{detail}, and one for all rotations", path)
        if name == feedback:
            B = rows.wrenches
            arrays[name] = np.array(np.linalg.inv(B.T @ np.linalg.inv(gain) @ B), dtype=np.float64)
        else:
            of_kind = np.where(of_grasp, diagonal[linear][0], diagonal[~linear][0])
            arrays[name] = np.diag(of_kind)
    return refilled(gains, arrays)
