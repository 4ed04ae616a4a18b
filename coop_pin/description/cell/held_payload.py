"""Held payload: arms with their grasps, and what these hold, transmit and leave free."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Name, Positive, Vector3, check_arm_names, unknown_arms
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial.grasp_rows import GraspRows, transmits, transmitted_loads, unheld_motion
from coop_pin.base.spatial.task_rows import RowsName, TaskRows, task_rows
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.closure import NamedRows, row_mask
from coop_pin.description.cell.contact import Pad, PatchGrasp, Table
from coop_pin.description.cell.grasp import (
    CompliantGrasp,
    Grasp,
    JointGrasp,
    ToolTip,
    compliance_of,
    grasps_from_configuration,
)
from coop_pin.description.cell.payload import Payload


class HeldPayload(Description):
    """Payload, the grasps by which arms hold it, and who bears which part of the load.

    Attributes:
        arms: the arms by name; arrays over arms have their order.
        payload: the held object.
        payload_pose: payload pose X_WP that belongs to the arms' postures; for "as-posed" grasps only.
        grasps: pose X_PE of each arm's tip in the payload frame, in the order of the arms; with ``kind =
            "compliant"`` a spring and damper holds the tip there, with ``kind = "patch"`` friction alone,
            with "hinge", "ball" or "cylinder" a joint; with "tool" it holds nothing.
            "as-posed" computes rigid ones from ``payload_pose`` and the postures, and the cell stores the
            result.
        rows: task rows: "full" (6), "planar" (x, y and the rotation about z, for arms that move in the
            world's x-y plane) or "positional" (x, y, z).
        gravity: gravitational acceleration in world axes, m/s^2.
        load_shares: load share c_i of each arm, summing to one, a tool none; equal when omitted or empty.
        tables: tables that the payload may lie on, by name.
        pads: pads of arms with rigid or compliant grasps, by which results tell whether friction would hold.
        split_length: l, m, of the split of the load beside grasps of fewer rows: a moment over l counts as
            much as a force. Motion terms of K leave no internal wrench at l^2 = K_rotation / K_position.
    """

    arms: dict[str, Arm] = Field(min_length=1)
    payload: Payload
    payload_pose: Pose | None = None
    grasps: dict[str, Grasp]
    rows: RowsName = "full"
    gravity: Vector3 = (0.0, 0.0, -9.81)
    load_shares: dict[str, float] | None = None
    tables: dict[Name, Table] = Field(default={})
    pads: dict[str, Pad] = Field(default={})
    split_length: Positive = 0.1

    @field_validator("grasps", mode="before")
    @classmethod
    def _as_posed(cls, grasps: Any, earlier: ValidationInfo) -> Any:
        if not isinstance(grasps, str):
            return grasps
        if grasps != "as-posed":
            raise FieldError(f'is {grasps!r}; it must be a table of poses by arm, or "as-posed"')
        arms, pose = earlier.data.get("arms"), earlier.data.get("payload_pose")
        if arms is None:
            return {}
        unposed = [name for name, arm in arms.items() if arm.posture is None]
        if pose is None or unposed:
            missing = "payload_pose is" if pose is None else f"the postures of {unposed} are"
            raise FieldError(f'is "as-posed", but {missing} missing; the grasps are computed from them')
        return grasps_from_configuration(arms, {name: arm.posture for name, arm in arms.items()}, pose)

    @field_validator("grasps")
    @classmethod
    def _one_grasp_each(cls, grasps: dict[str, Grasp], earlier: ValidationInfo) -> dict[str, Grasp]:
        arms = earlier.data.get("arms")
        check_arm_names(grasps, arms)
        return grasps if arms is None else {name: grasps[name] for name in arms}

    @field_validator("grasps")
    @classmethod
    def _patches_on_faces(cls, grasps: dict[str, Grasp], earlier: ValidationInfo) -> dict[str, Grasp]:
        payload = earlier.data.get("payload")
        for name, grasp in grasps.items():
            if payload is not None and isinstance(grasp, PatchGrasp):
                try:
                    grasp.bounds(payload)
                except FieldError as error:
                    raise error.below(name) from None
        return grasps

    @field_validator("pads")
    @classmethod
    def _pads_of_other_grasps(cls, pads: dict[str, Pad], earlier: ValidationInfo) -> dict[str, Pad]:
        grasps = earlier.data.get("grasps", {})
        if strangers := unknown_arms(pads, earlier.data.get("arms", pads)):
            raise strangers[0]
        for name in pads:
            if isinstance(grasps.get(name), PatchGrasp | JointGrasp | ToolTip):
                raise FieldError("is of a tool, of a grasp that is a joint, or has a patch of its own", name)
        return pads

    @model_validator(mode="after")
    def _links_held(self) -> Self:
        links, named = self.payload.links, self.held_links
        for name, link in named.items():
            if links is None:
                raise FieldError("names a link, and the payload has only one", f"grasps.{name}.link")
            links.require_link(link, f"grasps.{name}.link")
        if links is not None and (
            self.unclosed or self.tools or self.tables or self.pads or self.rows == "positional"
        ):
            detail = (
                "has several links; they go with rigid grasps and joints, in task rows 'full' or 'planar',"
            )
            raise FieldError(f"{detail} without tools, tables and pads", "payload")
        return self

    @model_validator(mode="after")
    def _joints_hold(self) -> Self:
        if not self.jointed:
            return self
        if self.rows == "positional" or self.unclosed or self.tables:
            detail = "has joints; they go with rigid grasps, in task rows 'full' or 'planar', without tables"
            raise FieldError(detail, "grasps")
        for name in self.jointed:
            if self.grasp_rows(name) is None:
                raise FieldError(
                    "has its axis askew to the plane; it must be in it or across", f"grasps.{name}"
                )
        self.require_payload_held([True] * len(self.arms), "grasps")
        return self

    def require_payload_held(self, holds: Sequence[bool], path: str) -> None:
        """Refuse grasps that leave the payload a motion.

        Args:
            holds: mask of the arms that hold.
            path: field of the error.

        Raises:
            FieldError: with a twist that no grasp holds.
        """
        wrenches, links = self.transmitted(holds), self.payload.links
        if links is not None and links.base is not None:  # which holds all but its freedom
            wrenches.append(np.linalg.svd(links.freedom[None])[2][1:].T[list(self.task_rows.indices)])
        V = unheld_motion(wrenches)
        if V is not None:
            rows = dict(zip(self.task_rows.axes, np.round(V / np.abs(V).max(), 3).tolist(), strict=True))
            shown = ", ".join(f"{axis} {value:g}" for axis, value in rows.items() if value)
            detail = f"leave the payload a motion that nobody holds: about P in its axes {shown}"
            raise FieldError(f"{detail}. Make a grasp rigid, or turn an axis", path)

    def require_transmitted(self, wrenches: Array) -> None:
        """Refuse internal wrenches that a joint does not transmit.

        Args:
            wrenches: wrench on each arm about P in payload axes, N and N m, shape (m, 6).

        Raises:
            FieldError: with the arm.
        """
        rows = list(self.task_rows.indices)
        for name, B, F in zip(self.arms, self.transmitted(), wrenches, strict=True):
            if not transmits(B, F[rows]):
                detail = f"is {F.tolist()} about P, which the {self.jointed[name].kind} does not transmit"
                raise FieldError(f"{detail}; state tip forces: kind = 'tip-force' or 'tip-wrench'", name)

    @field_validator("load_shares")
    @classmethod
    def _shares_sum_to_one(
        cls, shares: dict[str, float] | None, earlier: ValidationInfo
    ) -> dict[str, float] | None:
        if not shares:
            return None
        check_arm_names(shares, earlier.data.get("arms"))
        total = sum(shares.values())
        if abs(total - 1.0) > 1e-9:
            raise FieldError(
                f"{shares} sum to {total:.9g}; load shares must sum to 1 (eq. (11) of the paper)"
            )
        return shares

    @property
    def task_rows(self) -> TaskRows:
        """Task rows of the cell, k_0 of them."""
        return task_rows(self.rows)

    @property
    def compliant(self) -> dict[str, CompliantGrasp]:
        """Compliant grasps by arm, in their order."""
        return {name: grasp for name, grasp in self.grasps.items() if isinstance(grasp, CompliantGrasp)}

    @property
    def patches(self) -> dict[str, PatchGrasp]:
        """Grasps by friction by arm, in their order."""
        return {name: grasp for name, grasp in self.grasps.items() if isinstance(grasp, PatchGrasp)}

    def compliance(self, arm: str) -> Array:
        """Return C of ``compliance_of`` the grasp of an arm, in payload axes, shape (6, 6)."""
        return compliance_of(self.grasps[arm])

    def way_out(self, arm: str) -> Array:
        """Return the axis of the payload on which an arm retreats from its grasp, shape (3,)."""
        grasp = self.grasps[arm]
        return (grasp.matrix @ grasp.plane)[:3, 2] if isinstance(grasp, PatchGrasp) else -grasp.matrix[:3, 2]

    @property
    def padded(self) -> dict[str, Pad]:
        """Patch or pad of each arm that has one, in the order of the arms."""
        faces: dict[str, Pad] = {**self.pads, **self.patches}
        return {name: faces[name] for name in self.arms if name in faces}

    @property
    def closing(self) -> dict[str, NamedRows]:
        """Rows of the loop that each rigid grasp closes, by arm, in their order."""
        return {
            name: grasp.closes if isinstance(grasp, JointGrasp) else "full"
            for name, grasp in self.grasps.items()
            if not isinstance(grasp, CompliantGrasp | PatchGrasp | ToolTip)
        }

    @property
    def tools(self) -> dict[str, ToolTip]:
        """Tips that hold nothing by arm, in their order."""
        return {name: grasp for name, grasp in self.grasps.items() if isinstance(grasp, ToolTip)}

    @property
    def jointed(self) -> dict[str, JointGrasp]:
        """Grasps of fewer rows by arm, in their order."""
        return {name: grasp for name, grasp in self.grasps.items() if isinstance(grasp, JointGrasp)}

    @property
    def held_links(self) -> dict[str, str]:
        """Link that the grasp of each arm names, of those that name one."""
        named = {name: getattr(grasp, "link", "") for name, grasp in self.grasps.items()}
        return {name: link for name, link in named.items() if link}

    @property
    def is_pulled(self) -> bool:
        """Whether arms hold links with a joint without a spring between them, as the ends of a rope."""
        links = self.payload.links
        if links is None or links.base is not None or self.tools or self.jointed:
            return False
        sides = [links.robot.movers(self.held_links.get(name, links.link)) for name in self.arms]
        between = {name for side in sides for name in side if not all(name in other for other in sides)}
        return any(not links.joint(name).stiffness for name in between)

    @property
    def splits_load(self) -> bool:
        """Whether ``loads_within`` splits the load: with joints as grasps, or of a payload with a base."""
        links = self.payload.links
        return bool(self.jointed or (links is not None and links.base is not None))

    def grasp_rows(self, arm: str) -> GraspRows | None:
        """Return the rows that an arm's grasp holds, all of them of one that is no joint.

        None if the axis of a joint is askew to the plane of a planar cell.
        """
        grasp = self.grasps[arm]
        if isinstance(grasp, JointGrasp):
            return GraspRows.of(self.task_rows, grasp.matrix @ grasp.X_EC, row_mask(grasp.closes))
        return GraspRows.of(self.task_rows, np.eye(4), (True,) * 6)

    def transmitted(self, holds: Sequence[bool] | None = None) -> list[Array]:
        """Return B_i of ``GraspRows.wrenches`` of the arms that hold, all by default, shape (k_0, k) each."""
        rows = map(self.grasp_rows, itertools.compress(self.arms, holds or itertools.repeat(True)))
        return [each.wrenches for each in rows if each is not None]

    def loads_within(self, holds: Sequence[bool]) -> Array:
        """Return L_i of ``transmitted_loads`` of the arms that hold, shape (n, 6, 6).

        Of a payload with a base they act on the part of the resultant that moves it: L_i Pi, with its freedom
        s and Pi = Q^-1 s (s^T Q^-1 s)^-1 s^T, the least load that does the same work.
        """
        shares, links = self.shares[list(holds)], self.payload.links
        L = transmitted_loads(
            self.transmitted(holds), shares / shares.sum(), self.task_rows, self.split_length
        )
        if links is None or links.base is None:
            return L
        s, Q_inverse = links.freedom, np.repeat((1.0, self.split_length**2), 3)
        return np.asarray(L @ np.outer(Q_inverse * s, s) / (s @ (Q_inverse * s)))

    @property
    def unclosed(self) -> list[str]:
        """Arms whose grasps are compliant or held by friction: those that close no loop."""
        return [name for name in self.grasps if name not in self.closing and name not in self.tools]

    @property
    def has_contacts(self) -> bool:
        """Whether something touches with friction: a patch, or the payload and a table."""
        return bool(self.patches or self.tables)

    @property
    def has_force_elements(self) -> bool:
        """Whether forces of state hold the payload: compliant grasps, patches or tables."""
        return bool(self.compliant or self.has_contacts)

    @property
    def shares(self) -> Array:
        """Load shares c_i in the order of the arms, zero of tools, shape (m,)."""
        holds, parts = [name not in self.tools for name in self.arms], self.gain_shares
        return parts if all(holds) else np.where(holds, parts, 0.0) / parts[holds].sum()

    @property
    def gain_shares(self) -> Array:
        """Parts of the gains: the stated load shares, also of tools, in the order of the arms, shape (m,)."""
        stated, m = self.load_shares, len(self.arms)
        return np.full(m, 1.0 / m) if stated is None else np.array([stated[name] for name in self.arms])
