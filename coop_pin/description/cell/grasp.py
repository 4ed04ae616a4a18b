"""Grasp of an arm on the payload: rigid, a spring and damper between tip and payload, or a pressed patch."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Discriminator, Tag

from coop_pin.base.arrays import Array, as_array
from coop_pin.base.errors import OutOfRangeError
from coop_pin.base.schema.base import Positive, Vector6, by_name, not_negative, positive
from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.contact import PatchGrasp

STIFFNESSES = {
    "paper": (3e5, 3e5, 3e5, 3e3, 3e3, 3e3),
    "firm": (3e4, 3e4, 3e4, 3e2, 3e2, 3e2),
    "soft": (5e3, 5e3, 5e3, 50.0, 50.0, 50.0),
}
"""Stiffness of a grasp by name, N/m and N m/rad.

"paper" is the 300 kN/m of the paper's own simulation, and "soft" the 5 kN/m of a planner for
torque-controlled dual arms. Neither source states the rotation: it is k / 100 m^2, as for pads of some 0.1 m.
"""


class CompliantGrasp(Pose):
    """Compliant grasp: a spring and damper holds the arm's tip at the grasp frame on the payload.

    In axes of the grasp frame, with the tip's displacement p and rotation R from it and its relative twist V,
    the wrench on the arm about the tip is

    ::

        F = -K [p, r] - D V,    r = vee(R G - G R^T) / k_r,    G = tr(K_r) / 2 - K_r

    with r the rotation vector for small angles. It is the gradient of p.K_p p / 2 + tr(G - G R), so that
    energy only leaves through D (Fasse's spring).

    Attributes:
        xyz: Position of the grasp frame in payload axes, m.
        rpy: Roll, pitch, yaw of the grasp frame, rad.
        kind: "compliant"; in a file, a grasp without a kind is rigid.
        stiffness: Diagonal of K in grasp axes, N/m and N m/rad: six numbers, or "paper" (300 kN/m and 3
            kN m/rad), "firm" (30 kN/m, 0.3 kN m/rad) or "soft" (5 kN/m, 50 N m/rad).
        damping_ratio: zeta of D_ii = 2 zeta sqrt(K_ii / W_ii), with W the mobility between tip and grasp at
            the start, arm and payload free.
        damping: Diagonal of D, N s/m and N m s/rad, in place of the ratio.
    """

    kind: Literal["compliant"] = "compliant"
    stiffness: Annotated[Vector6, AfterValidator(positive), by_name(STIFFNESSES, "six numbers")]
    damping_ratio: Positive = 0.3
    damping: Annotated[Vector6, AfterValidator(not_negative)] | None = None

    @classmethod
    def measured(cls, load: ArrayLike, deflection: ArrayLike, **fields: Any) -> Self:
        """Return the grasp whose stiffness a load and its deflection show.

        Args:
            load: Force and moment along each grasp axis, N and N m, shape (6,).
            deflection: Displacement and rotation that each causes, m and rad, shape (6,).
            fields: The other fields.

        Raises:
            OutOfRangeError: a ratio is not a positive number.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            stiffness: Array = np.abs(as_array("load", load, 6) / as_array("deflection", deflection, 6))
        for index, value in enumerate(stiffness.tolist()):
            if not 0.0 < value < np.inf:
                raise OutOfRangeError(f"load[{index}] / deflection[{index}]", value, "a positive number")
        return cls(stiffness=tuple(stiffness.tolist()), **fields)


def _kind(value: Any) -> str:
    if not isinstance(value, dict):
        return value.kind if isinstance(value, CompliantGrasp | PatchGrasp) else "rigid"
    return "patch" if value.get("kind") == "patch" else "compliant" if "kind" in value else "rigid"


Grasp = Annotated[
    Annotated[Pose, Tag("rigid")]
    | Annotated[CompliantGrasp, Tag("compliant")]
    | Annotated[PatchGrasp, Tag("patch")],
    Discriminator(_kind),
]
"""Pose X_PE of a rigid grasp, a compliant one, or a patch."""
