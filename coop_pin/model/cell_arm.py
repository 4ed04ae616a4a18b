"""One arm of a cell: its model with grasp and gravity, load share, drive Jacobian and posture."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import NameNotFoundError
from coop_pin.base.spatial import FullRows
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.grasp import JointGrasp
from coop_pin.model.arm_model import ArmKinematics, ArmModel


class CellArm(ArmModel):
    """Model of an arm of a cell, about the payload frame that its grasp gives it.

    Attributes:
        description: Arm in the description of the cell.
        share: Load share c.
        rows: Task rows of the cell.
        X_PE: Pose of the tip in the payload frame, by its grasp.
        grasp_rows: Rows of its grasp where that is a joint. With fewer joints than task rows, inverse
            kinematics leave the turns of that joint free; else they keep its grasp frame.
    """

    def __init__(self, cell: Cell, name: str) -> None:
        """Build the model.

        Args:
            cell: Description of the cell.
            name: Name of the arm in it.

        Raises:
            NameNotFoundError: the cell has no such arm, or its tip is not in the URDF.
            UrdfError: the URDF is missing or defective.
        """
        require_type("cell", cell, Cell)
        require_type("name", name, str)
        if name not in cell.arms:
            raise NameNotFoundError("arm", name, cell.arms, "the cell")
        self.description, self.X_PE = cell.arms[name], cell.grasps[name].matrix
        super().__init__(self.description, self.X_PE, cell.gravity, name=name)
        self.share, self.rows = cell.share(name), cell.task_rows
        grasp = cell.grasps[name]
        self.grasp_rows = cell.grasp_rows(name) if isinstance(grasp, JointGrasp) else None
        if isinstance(grasp, JointGrasp) and self.nv < self.rows.size:
            self.to_held_rows = grasp.to_held_rows
            model, tip, X_WB, X_PE = self.key
            self.key = (model, tip, X_WB, X_PE + self.to_held_rows.tobytes())

    @cached_property
    def kinematics(self) -> ArmKinematics:
        """Kinematics as the arm's controller sees them: with its calibration error, without inertias."""
        return ArmKinematics(self.description, self.X_PE, self.rows)

    @cached_property
    def posture_configuration(self) -> Array:
        """Configuration at the arm's posture, all angles zero without one, shape (nq,)."""
        return self.posture(self.description.posture)

    @property
    def spare(self) -> int:
        """Number of joints beyond the rows of its grasp; negative with fewer."""
        return int(self.nv - (self.grasp_rows or self.rows).size)

    def task_jacobian(self, q: Array, R_WP: Array | None = None) -> Array:
        """Return J = S J_WP T^-1 with V_WP = J qdot on the task rows S, shape (k_0, nv).

        Of a grasp that is a joint it is J_i on the rows that this holds, about C in its axes, shape (k, nv).

        Args:
            q: Configuration.
            R_WP: Orientation of the payload beyond a joint, shape (3, 3); as the arm sees it when omitted.
        """
        J = self.payload_jacobian(q) @ self.from_drive
        if self.grasp_rows is None:
            return self.rows.select(J)
        R_seen, X_PC = self.payload_pose(q)[:3, :3], self.grasp_rows.X_PC
        turned = np.kron(np.eye(2), ((R_seen if R_WP is None else R_WP) @ X_PC[:3, :3]).T)
        return self.grasp_rows.select(turned @ FullRows().twist_shift(R_seen @ X_PC[:3, 3]) @ J)

    def null_space(self, q: Array) -> Array:
        """Return N = I - J^+ J: the drive velocities that do not move the payload, shape (nv, nv)."""
        J = self.task_jacobian(q)
        return np.eye(self.nv) - np.linalg.pinv(J) @ J
