"""The body of a URDF with a single link."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.urdf.numbers import number, numbers
from coop_pin.description.urdf.report import listed
from coop_pin.description.urdf.xml import Node, read_document
from coop_pin.errors import UrdfError
from coop_pin.spatial import make_pose

_ORIGIN = (0.0, 0.0, 0.0)


class LinkBody(NamedTuple):
    """A link seen from its centre of mass, in the link's axes.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, kg m^2.
        size: edges of the box around its shape, m.
        shape: what its first visual is.
        X_PS: pose of the shape in the frame at the centre of mass, shape (4, 4).
    """

    mass: float
    inertia: tuple[float, ...]
    size: tuple[float, float, float]
    shape: Literal["box", "cylinder"]
    X_PS: Array


def link_body(text: str, source: str) -> LinkBody:
    """Return the body of a URDF's only link.

    Args:
        text: checked URDF.
        source: its name, for messages.

    Raises:
        UrdfError: it has more than one link, or the link has no mass.
    """
    robot = read_document(text.encode()).robot
    assert robot is not None
    links = [node for node in robot.children if node.tag == "link"]
    if len(links) != 1:
        raise UrdfError(f"{source} has {len(links)} links, {listed(link.name for link in links)}; a payload is a single one")
    inertial = links[0].child("inertial")
    mass = None if inertial is None else number(inertial.child("mass"), "value")
    if inertial is None or not mass:
        raise UrdfError(f"link {links[0].name!r} of {source} has no mass; a payload must have one")
    X_LI = _pose(inertial)
    return LinkBody(mass, _inertia(inertial, X_LI), *_shape(links[0], X_LI[:3, 3]))


def _inertia(inertial: Node, X_LI: Array) -> tuple[float, ...]:
    """Return the inertia turned into the link's axes."""
    node = inertial.child("inertia")
    xx, yy, zz, xy, xz, yz = (number(node, name) or 0.0 for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    R = X_LI[:3, :3]
    M = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    return (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2])


def _shape(link: Node, centre: Array) -> tuple[tuple[float, float, float], Literal["box", "cylinder"], Array]:
    """Return size, kind and pose of the first visual; a small box at the centre of mass where it is neither box nor cylinder."""
    visual = link.child("visual")
    geometry = None if visual is None else visual.child("geometry")
    X_PS = np.eye(4) if visual is None else _pose(visual)
    X_PS[:3, 3] -= centre if visual is not None else 0.0
    box, cylinder = (None, None) if geometry is None else (geometry.child("box"), geometry.child("cylinder"))
    edges, radius, length = numbers(box, "size"), number(cylinder, "radius"), number(cylinder, "length")
    if edges is not None:
        return (edges[0], edges[1], edges[2]), "box", X_PS
    if radius is not None and length is not None:
        return (2.0 * radius, 2.0 * radius, length), "cylinder", X_PS
    return (0.1, 0.1, 0.1), "box", np.eye(4)


def _pose(owner: Node) -> Array:
    origin = owner.child("origin")
    return make_pose(numbers(origin, "xyz") or _ORIGIN, numbers(origin, "rpy") or _ORIGIN)
