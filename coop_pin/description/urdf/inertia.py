"""Physical checks: positive masses, possible inertias, and moved links without mass."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.urdf.numbers import COUNTS, number
from coop_pin.description.urdf.report import Kind, UrdfFinding
from coop_pin.description.urdf.tree import Tree
from coop_pin.description.urdf.xml import Node

ROUNDING = 1e-6
"""Tolerance of the inequalities for rounded numbers, relative to the largest principal moment."""

_NEGLIGIBLE = 1e-12
"""A violation that is rounding noise of a drawing program, kg m^2: no motion shows it."""


def inertia_matrix(inertia: Node | None) -> Array:
    """Return the matrix of an <inertia>, kg m^2, shape (3, 3); NaN for absent or malformed numbers."""
    return np.array(
        [[number(inertia, "i" + "".join(sorted(row + column))) for column in "xyz"] for row in "xyz"],
        dtype=np.float64,
    )


def inertial_findings(link: Node, *, moves: bool) -> Iterator[UrdfFinding]:
    """Yield masses that are not positive and inertias that no distribution of mass has.

    Malformed numbers are structural findings (see number_findings).

    Args:
        link: the link.
        moves: whether a joint moves it: findings that falsify the dynamics are then of kind "impossible".
    """
    false: Kind = "impossible" if moves else "physical"
    inertial = link.child("inertial")
    if inertial is None:
        return
    mass, inertia = inertial.child("mass"), inertial.child("inertia")
    value = number(mass, "value")
    if mass is None or "value" not in mass.attributes:
        message = "<inertial> has no mass, which is read as zero; add <mass value=...>, kg"
        yield link.finding("mass_missing", message, at=mass or inertial, kind="physical")
    elif value == 0.0 and not _is_frame(link):
        message = "the mass is zero, but the inertia is not; the mass must be positive"
        yield link.finding("mass_zero", message, at=mass, kind=false)
    elif value is not None and value < 0.0:
        message = f"the mass is {value:g} kg; it must be positive"
        yield link.finding("mass_negative", message, at=mass, kind=false)
    if inertia is None or not COUNTS["inertia"].keys() <= inertia.attributes.keys():
        message = (
            "<inertial> lacks some of ixx, ixy, ixz, iyy, iyz, izz, which are read as zero; add them, kg m^2"
        )
        yield link.finding("inertia_missing", message, at=inertia or inertial, kind="physical")
    else:
        yield from _moment_findings(link, inertia, false)


def _moment_findings(link: Node, inertia: Node, false: Kind) -> Iterator[UrdfFinding]:
    """Check principal moments I1 <= I2 <= I3: 0 <= I1 (semidefinite), I3 <= I1 + I2 (triangle inequality)."""
    matrix = inertia_matrix(inertia)
    scale = np.abs(matrix).max()
    if not scale > 0.0:  # a point mass, or a malformed number (NaN)
        return
    I1, I2, I3 = np.linalg.eigvalsh(matrix / scale)
    moments = ", ".join(f"{moment * scale:.4g}" for moment in (I1, I2, I3))
    message = f"the inertia has principal moments {moments} kg m^2; "
    if scale * max(-I1, I3 - I1 - I2) < _NEGLIGIBLE:
        false = "physical"
    if I1 + ROUNDING * abs(I3) < 0.0:
        message += "none may be negative"
        yield link.finding("inertia_not_psd", message, at=inertia, kind=false)
    elif I3 - I1 - I2 > ROUNDING * I3:
        message += "the largest must not exceed the sum of the others"
        yield link.finding("inertia_triangle", message, at=inertia, kind=false)


def _is_frame(link: Node) -> bool:
    """Return whether a link is only a frame, as of a tool: no <inertial>, or zero mass and inertia."""
    inertial = link.child("inertial")
    if inertial is None:
        return True
    return (
        number(inertial.child("mass"), "value") == 0.0 and not inertia_matrix(inertial.child("inertia")).any()
    )


def massless_findings(tree: Tree) -> Iterator[UrdfFinding]:
    """Yield the massless links that a joint moves and to which no link with mass is fixed.

    A massless link that is fixed to its parent is not a defect.
    """
    for edge in tree.above.values():
        if edge.is_fixed or not all(_is_frame(tree.links[name]) for name in _fixed_to(tree, edge.child)):
            continue
        link = tree.links[edge.child]
        inertial = link.child("inertial")
        mass = None if inertial is None else inertial.child("mass")
        yield link.finding(
            "massless_body" if mass is None else "mass_zero",
            "a joint moves this link, but neither it nor a link fixed to it has a mass; only the inner links"
            " of a joint with several axes may have none",
            at=mass,
            kind="physical",
        )


def moved_links(tree: Tree) -> set[str]:
    """Return the names of the links between which and the root a joint is not fixed."""
    moved: set[str] = set()
    waiting = [edge.child for edge in tree.above.values() if not edge.is_fixed]
    while waiting:
        if (name := waiting.pop()) not in moved:
            moved.add(name)
            waiting += [edge.child for edge in tree.below.get(name, ())]
    return moved


def _fixed_to(tree: Tree, name: str) -> Iterator[str]:
    """Yield a link and the links fixed to it; a moved link has one joint above it, so the search ends."""
    waiting = [name]
    while waiting:
        yield (link := waiting.pop())
        waiting += [edge.child for edge in tree.below.get(link, ()) if edge.is_fixed]
