"""Mesh files of a URDF's visuals: where they are, and whether they can be read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.xml import Node
from coop_pin.errors import FileReadError
from coop_pin.user_files import head_of_user_file

_PACKAGES = ("package://", "model://")
_MAX_MESH_BYTES = 100_000_000
_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes of a binary STL: its header, which ends with the number of triangles, and each triangle."""


def mesh_findings(robot: Node, package_dirs: Iterable[Path]) -> Iterator[UrdfFinding]:
    """Yield the visuals whose mesh file does not exist, which drawings omit, or cannot be read.

    Args:
        robot: the <robot> element.
        package_dirs: folders that are searched for the packages of package://.
    """
    folders = tuple(package_dirs)
    for link, mesh, path in meshes(robot, folders):
        name = mesh.attributes.get("filename", "")
        if path is not None and (problem := _mesh_problem(path)):
            yield link.finding("mesh_unreadable", f"the mesh {quoted(name)} {problem}", at=mesh)
        if path is None:
            searched = f" in {listed(map(str, folders))}" if name.startswith(_PACKAGES) else ""
            message = f"there is no mesh {quoted(name)}{searched}; only drawings need it, and omit it"
            yield link.finding("mesh_missing", message, at=mesh, kind="doubtful")


def meshes(robot: Node, package_dirs: Sequence[Path]) -> Iterator[tuple[Node, Node, Path | None]]:
    """Yield the link, the <mesh> and the file, if there is one, of every visual that is a mesh."""
    for link in robot.children:
        for visual in link.children if link.tag == "link" else ():
            geometry = visual.child("geometry") if visual.tag == "visual" else None
            mesh = None if geometry is None else geometry.child("mesh")
            if mesh is not None:
                name = mesh.attributes.get("filename", "")
                paths = [Path(name.removeprefix("file://"))]
                if name.startswith(_PACKAGES):
                    paths = [folder / name.partition("://")[2] for folder in package_dirs]
                yield link, mesh, next((path for path in paths if os.path.lexists(path)), None)


def _mesh_problem(path: Path) -> str:
    """Return what is wrong with the size of a mesh file, or of the triangles that a binary STL claims."""
    try:
        head, size = head_of_user_file(path, limit=_MAX_MESH_BYTES, kind="a mesh")
    except FileReadError as error:
        return f"cannot be read: {error}"
    if not size:
        return "is empty"
    if path.suffix.lower() != ".stl" or (head.lstrip()[:5].lower() == b"solid" and b"facet" in head):
        return ""
    triangles = int.from_bytes(head[80:_STL_HEADER], "little")
    held = (size - _STL_HEADER) // _STL_TRIANGLE
    if 0 < triangles <= held:
        return ""
    return f"claims {triangles} triangles and holds {max(held, 0)}; export it again"
