"""Physical checks: positive masses, possible inertias, and moved links without mass."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.urdf.report import Kind, UrdfFinding
from coop_pin.description.urdf.tree import Tree
from coop_pin.description.urdf.xml import Element, finding, number

ROUNDING = 1e-6
"""Tolerance of the inequalities for rounded numbers, relative to the largest principal moment."""

_NEGLIGIBLE = 1e-12
"""A violation that is rounding noise of a drawing program, kg m^2: no motion shows it."""


def physical_findings(robot: Element, tree: Tree) -> Iterator[UrdfFinding]:
    """Yield masses and inertias that no body has, and massless links that a joint moves.

    A massless link that is fixed to its parent is not a defect. Malformed numbers are structural findings
    (see number_findings).
    """
    first = {name: name for name in tree.links}  # the first link of the body that fixed joints make
    for edge in tree.edges():
        if edge.is_fixed:
            first[edge.child] = first[edge.parent]
    heavy = {first[name] for name, link in tree.links.items() if not _is_frame(link)}
    for name, edge in tree.above.items():
        if name not in heavy and not edge.is_fixed:
            mass = tree.links[name].find("inertial/mass")
            message = (
                "a joint moves this link, but neither it nor a link fixed to it has a mass; only the inner"
                " links of a joint with several axes may have none"
            )
            code = "massless_body" if mass is None else "mass_zero"
            yield finding(tree.links[name], code, message, at=mass, kind="physical")
    for link in robot.iterchildren("link"):
        moves = first.get(link.get("name", "")) in tree.above
        yield from _inertial_findings(link, "impossible" if moves else "physical")


def _matrix(inertia: Element | None) -> Array:
    """Return the matrix of an <inertia>, kg m^2, shape (3, 3); NaN for absent or malformed numbers."""
    return np.array(
        [[number(inertia, "i" + "".join(sorted(row + column))) for column in "xyz"] for row in "xyz"],
        dtype=np.float64,
    )


def _inertial_findings(link: Element, false: Kind) -> Iterator[UrdfFinding]:
    """Yield the defects of mass and inertia of a link; those that falsify its dynamics are of a kind."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    value = number(mass, "value")
    if value == 0.0 and not _is_frame(link):
        message = "the mass is zero, but the inertia is not; the mass must be positive"
        yield finding(link, "mass_zero", message, at=mass, kind=false)
    if value is not None and value < 0.0:
        message = f"the mass is {value:g} kg; it must be positive"
        yield finding(link, "mass_negative", message, at=mass, kind=false)
    if np.isfinite(matrix := _matrix(inertia)).all():  # missing and malformed numbers are findings of others
        yield from _moment_findings(link, inertia, matrix, false)


def _moment_findings(
    link: Element, inertia: Element | None, matrix: Array, false: Kind
) -> Iterator[UrdfFinding]:
    """Check principal moments I1 <= I2 <= I3: 0 <= I1 (semidefinite), I3 <= I1 + I2 (triangle inequality)."""
    scale = np.abs(matrix).max()
    if scale == 0.0:  # a point mass
        return
    I1, I2, I3 = np.linalg.eigvalsh(matrix / scale)
    moments = ", ".join(f"{moment * scale:.4g}" for moment in (I1, I2, I3))
    message = f"the inertia has principal moments {moments} kg m^2; "
    kind: Kind = "physical" if scale * max(-I1, I3 - I1 - I2) < _NEGLIGIBLE else false
    if I1 + ROUNDING * abs(I3) < 0.0:
        yield finding(link, "inertia_not_psd", message + "none may be negative", at=inertia, kind=kind)
    elif I3 - I1 - I2 > ROUNDING * I3:
        message += "the largest must not exceed the sum of the others"
        yield finding(link, "inertia_triangle", message, at=inertia, kind=kind)


def _is_frame(link: Element) -> bool:
    """Return whether a link is only a frame, as of a tool: no <inertial>, or zero mass and inertia."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    massless = number(mass, "value") == 0.0 and not _matrix(inertia).any()
    return massless or link.find("inertial") is None
