"""Whether the bodies of a URDF can exist: masses, inertias, and moved links that weigh nothing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coop_pin.description.urdf.report import UrdfFinding, physical
from coop_pin.description.urdf.tree import Tree
from coop_pin.description.urdf.xml import COUNTS, Node, number

ROUNDING = 1e-6
"""Share of the largest principal moment by which rounded numbers may break an inequality."""


def inertial_findings(link: Node) -> Iterator[UrdfFinding]:
    """Yield what no body can have: a mass that is not positive, an inertia that no distribution of mass gives.

    Numbers that cannot be read are structural and reported elsewhere.
    """
    inertial = link.child("inertial")
    if inertial is None:
        return
    mass, inertia = inertial.child("mass"), inertial.child("inertia")
    if mass is None or "value" not in mass.attributes:
        line = (mass or inertial).line
        yield physical(
            "mass_missing",
            link.label,
            line,
            "<inertial> gives no mass, which is read as zero; add <mass value=...>, kg",
        )
    else:
        yield from _mass_findings(link, mass)
    if inertia is None or not COUNTS["inertia"].keys() <= inertia.attributes.keys():
        line = (inertia or inertial).line
        message = "<inertial> does not give all of ixx, ixy, ixz, iyy, iyz, izz; those missing are read as zero; add them, kg m^2"
        yield physical("inertia_missing", link.label, line, message)
    else:
        yield from _inertia_findings(link, inertia)


def _mass_findings(link: Node, mass: Node) -> Iterator[UrdfFinding]:
    value = number(mass, "value")
    if value == 0.0:
        if not _is_frame(link):
            yield physical(
                "mass_zero",
                link.label,
                mass.line,
                "the mass is zero, but not the inertia; the mass must be positive",
            )
    elif value is not None and value < 0.0:
        yield physical(
            "mass_negative", link.label, mass.line, f"the mass is {value:g} kg; it must be positive"
        )


def _inertia_findings(link: Node, inertia: Node) -> Iterator[UrdfFinding]:
    """Check the principal moments I1 <= I2 <= I3: 0 <= I1 (positive semidefinite) and I3 <= I1 + I2 (triangle inequality)."""
    entries = {name: number(inertia, name) for name in COUNTS["inertia"]}
    matrix = np.array(
        [[entries["i" + "".join(sorted(row + column))] for column in "xyz"] for row in "xyz"],
        dtype=np.float64,
    )
    scale = np.abs(matrix).max()
    if not scale > 0.0:  # a point mass, or a number that could not be read (NaN)
        return
    I1, I2, I3 = np.linalg.eigvalsh(matrix / scale)
    moments = ", ".join(f"{moment * scale:.4g}" for moment in (I1, I2, I3))
    if I1 + ROUNDING * abs(I3) < 0.0:
        message = f"the inertia has principal moments {moments} kg m^2; none may be negative"
        yield physical("inertia_not_psd", link.label, inertia.line, message)
    elif I3 - I1 - I2 > ROUNDING * I3:
        message = f"the inertia has principal moments {moments} kg m^2; the largest must not exceed the sum of the others"
        yield physical("inertia_triangle", link.label, inertia.line, message)


def _is_frame(link: Node) -> bool:
    """Return whether a link is a mere frame, as tools and sensors have them: no <inertial>, or mass and inertia zero."""
    inertial = link.child("inertial")
    if inertial is None:
        return True
    values = [
        number(inertial.child("mass"), "value"),
        *(number(inertial.child("inertia"), name) for name in COUNTS["inertia"]),
    ]
    return all(value == 0.0 for value in values)


def massless_findings(tree: Tree) -> Iterator[UrdfFinding]:
    """Yield the mere frames that a joint moves and to which no link with a mass is fixed.

    A frame that is fixed to its parent is no defect.
    """
    for edge in tree.above.values():
        if edge.joint.attributes.get("type") == "fixed" or not all(
            _is_frame(tree.links[name]) for name in _fixed_to(tree, edge.child)
        ):
            continue
        link = tree.links[edge.child]
        inertial = link.child("inertial")
        mass = None if inertial is None else inertial.child("mass")
        code, line = ("massless_body", link.line) if mass is None else ("mass_zero", mass.line)
        message = "a joint moves this link, but neither it nor a link fixed to it has a mass; only the inner links of a joint of several"
        yield physical(code, link.label, line, f"{message} axes may have none")


def _fixed_to(tree: Tree, name: str) -> Iterator[str]:
    """Yield a link and those fixed to it; each has one joint above it at most, so that no walk from a moved link goes around."""
    waiting = [name]
    while waiting:
        link = waiting.pop()
        yield link
        waiting += [
            edge.child for edge in tree.below.get(link, ()) if edge.joint.attributes.get("type") == "fixed"
        ]
