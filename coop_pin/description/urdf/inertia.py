"""Physical checks: positive masses, possible inertias, and moved links without mass; repair of inertias.

A body that joints move is what fixed and locked joints make of several links. An impossible inertia of one
link is judged on that body. The inertias of its links are added as pseudo-inertias in the body's frame::

    J = [S + m c c^T, m c; m c^T, m],   S = tr(I) / 2 - I,   possible if S >= 0 and m > 0
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.urdf.report import Kind, UrdfFinding
from coop_pin.description.urdf.tree import Tree, pose_of
from coop_pin.description.urdf.xml import Element, finding, number

ROUNDING = 1e-6
"""Tolerance of the inequalities for rounded numbers, relative to the largest principal moment."""

REPAIRED = ("inertia_not_psd", "inertia_triangle")
"""Codes of findings that a repair removes."""
_NEGLIGIBLE = 1e-12
"""A violation that is rounding noise of a drawing program, kg m^2: no motion shows it."""


def physical_findings(
    robot: Element, tree: Tree, locked: Mapping[str, float], repairs: bool | None
) -> Iterator[UrdfFinding]:
    """Yield masses and inertias that no body has, and massless links that a joint moves.

    A massless link that is fixed to its parent is not a defect. Malformed numbers are structural findings
    (see number_findings).

    Args:
        robot: the <robot> element.
        tree: tree of the robot.
        locked: positions of the locked joints, rad or m.
        repairs: whether moved links are repaired, see ``repairable``; None for no repair.
    """
    first = tree.bodies(locked)
    heavy = {first[name] for name, link in tree.links.items() if not _is_frame(link)}
    for name, edge in tree.above.items():
        if name not in heavy and not edge.is_fixed and edge.name not in locked:
            mass = tree.links[name].find("inertial/mass")
            message = (
                "a joint moves this link, but neither it nor a link fixed to it has a mass; only the inner"
                " links of a joint with several axes may have none"
            )
            code = "massless_body" if mass is None else "mass_zero"
            yield finding(tree.links[name], code, message, at=mass, kind="physical")
    false = impossible_bodies(tree, locked)
    repaired = repairable(tree, locked, repairs) if false and repairs is not None else ()
    for link in robot.iterchildren("link"):
        name = link.get("name", "")
        kind: Kind = "impossible" if first.get(name) in false else "physical"
        yield from _inertial_findings(link, kind, name in repaired)


def impossible_bodies(tree: Tree, locked: Mapping[str, float]) -> set[str]:
    """Return the first links of the moved bodies whose inertias are impossible."""
    first = tree.bodies(locked)
    suspects = {
        first[name] for name, link in tree.links.items() if any(_inertial_findings(link, "impossible"))
    }
    suspects &= {*tree.above}
    sums = {name: np.zeros((4, 4)) for name in suspects}
    X = {name: np.eye(4) for name in suspects}
    with np.errstate(all="ignore"):  # numbers beyond what doubles can hold stay impossible
        for name in suspects:
            sums[name] += _pseudo_inertia(tree.links[name], X[name])
        for edge in tree.edges():
            if (body := first[edge.child]) in suspects and edge.child != body:
                X[edge.child] = X[edge.parent] @ edge.pose(locked.get(edge.name, 0.0))
                sums[body] += _pseudo_inertia(tree.links[edge.child], X[edge.child])
        return {name for name, J in sums.items() if not _is_possible(J)}


def repairable(tree: Tree, locked: Mapping[str, float], everywhere: bool) -> set[str]:
    """Return the links of impossible bodies whose inertias a repair makes possible.

    Args:
        tree: the tree of the file.
        locked: positions of the locked joints, rad or m.
        everywhere: whether moved links are repaired; otherwise those behind locked joints alone.
    """
    first, joined = tree.bodies(locked), tree.bodies(())
    bodies = impossible_bodies(tree, locked)
    links = (name for name, body in first.items() if body in bodies and (everywhere or joined[name] != body))
    codes = {
        name: [each.code for each in _inertial_findings(tree.links[name], "impossible")] for name in links
    }
    return {name for name, each in codes.items() if each and {*each} <= {*REPAIRED}}


def repair(tree: Tree, links: Collection[str]) -> None:
    """Replace the inertias of some links by the nearest possible ones, in the elements of the tree."""
    for name in links:
        inertia = tree.links[name].find("inertial/inertia")
        nearest = _nearest_possible(_matrix(inertia))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            inertia.set(f"i{'xyz'[i]}{'xyz'[j]}", repr(float(nearest[i, j])))


def _nearest_possible(matrix: Array) -> Array:
    """Return the inertia whose S = tr(I) / 2 - I is the nearest positive semidefinite one, shape (3, 3)."""
    moments, axes = np.linalg.eigh(0.5 * np.trace(matrix) * np.eye(3) - matrix)
    S = axes @ np.diag(np.maximum(moments, 0.0)) @ axes.T
    nearest: Array = np.trace(S) * np.eye(3) - S
    return nearest


def _pseudo_inertia(link: Element, X: Array) -> Array:
    """Return J of a link whose pose is X, shape (4, 4); zero for malformed numbers."""
    inertial, matrix = link.find("inertial"), _matrix(link.find("inertial/inertia"))
    matrix, J = np.where(np.isfinite(matrix), matrix, 0.0), np.zeros((4, 4))
    J[:3, :3] = 0.5 * np.trace(matrix) * np.eye(3) - matrix
    J[3, 3] = number(link.find("inertial/mass"), "value") or 0.0
    X = X @ pose_of(inertial)
    return np.asarray(X @ J @ X.T)


def _is_possible(J: Array) -> bool:
    """Return whether a pseudo-inertia is that of a body, or of none."""
    m, first = J[3, 3], J[:3, 3]
    if not (m > 0.0 and np.isfinite(J).all()):
        return not J.any()
    S = J[:3, :3] - np.outer(first, first) / m
    code, is_noise = _moment_code(np.trace(S) * np.eye(3) - S)
    return not code or is_noise


def _matrix(inertia: Element | None) -> Array:
    """Return the matrix of an <inertia>, kg m^2, shape (3, 3); NaN for absent or malformed numbers."""
    return np.array(
        [[number(inertia, "i" + "".join(sorted(row + column))) for column in "xyz"] for row in "xyz"],
        dtype=np.float64,
    )


def _inertial_findings(link: Element, false: Kind, is_repaired: bool = False) -> Iterator[UrdfFinding]:
    """Yield the defects of mass and inertia of a link; those that falsify its dynamics are of a kind."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    value = number(mass, "value")
    if value == 0.0 and not _is_frame(link):
        message = "the mass is zero, but the inertia is not; the mass must be positive"
        yield finding(link, "mass_zero", message, at=mass, kind=false)
    if value is not None and value < 0.0:
        message = f"the mass is {value:g} kg; it must be positive"
        yield finding(link, "mass_negative", message, at=mass, kind=false)
    matrix = _matrix(inertia)
    if not np.isfinite(matrix).all() or not (code := _moment_code(matrix))[0]:
        return  # missing and malformed numbers are findings of others
    message = f"the inertia has principal moments {_moments(matrix)} kg m^2; {_REASON[code[0]]}"
    if is_repaired:
        nearest = _moments(_nearest_possible(matrix))
        message += f". It is repaired: the nearest possible ones, {nearest} kg m^2, about the same axes"
    elif false == "impossible" and not code[1]:
        message += f"; {_REMEDY}"
    yield finding(link, code[0], message, at=inertia, kind="physical" if code[1] or is_repaired else false)


_REASON = {
    "inertia_not_psd": "none may be negative",
    "inertia_triangle": "the largest must not exceed the sum of the others",
}
_REMEDY = 'correct it, lock its joint in the arm, or let the arm repair it: impossible_inertia = "repair"'


def _moment_code(matrix: Array) -> tuple[str, bool]:
    """Return the code of impossible principal moments, or "", and whether they are so by rounding noise.

    Of I1 <= I2 <= I3: 0 <= I1 (semidefinite), I3 <= I1 + I2 (triangle inequality).
    """
    scale = np.abs(matrix).max()
    if scale == 0.0:  # a point mass
        return "", False
    I1, I2, I3 = np.linalg.eigvalsh(matrix / scale)
    is_noise = bool(scale * max(-I1, I3 - I1 - I2) < _NEGLIGIBLE)
    if I1 + ROUNDING * abs(I3) < 0.0:
        return "inertia_not_psd", is_noise
    return "inertia_triangle" if I3 - I1 - I2 > ROUNDING * I3 else "", is_noise


def _moments(matrix: Array) -> str:
    return ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(matrix))


def _is_frame(link: Element) -> bool:
    """Return whether a link is only a frame, as of a tool: no <inertial>, or zero mass and inertia."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    massless = number(mass, "value") == 0.0 and not _matrix(inertia).any()
    return massless or link.find("inertial") is None
