"""Mesh files of a URDF's visuals: where they are, and whether they can be read."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from coop_pin.base.errors import FileReadError
from coop_pin.base.user_files import head_of_user_file
from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.xml import Element, finding

_PACKAGES = ("package://", "model://")
MAX_MESH_BYTES = 100_000_000
"""Two million triangles of a binary STL."""
_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes of a binary STL: its header, which ends with the number of triangles, and each triangle."""


def mesh_findings(robot: Element, package_dirs: Sequence[Path]) -> Iterator[UrdfFinding]:
    """Yield the visuals whose mesh file does not exist, which drawings omit, or cannot be read.

    Args:
        robot: the <robot> element.
        package_dirs: folders that are searched for the packages of package://.
    """
    for mesh, path in meshes(robot, package_dirs):
        name, link = mesh.get("filename", ""), next(mesh.iterancestors("link"))
        if path is None:
            searched = f" in {listed(map(str, package_dirs))}" if name.startswith(_PACKAGES) else ""
            message = f"there is no mesh {quoted(name)}{searched}; only drawings need it, and omit it"
            yield finding(link, "mesh_missing", message, at=mesh, kind="doubtful")
        elif problem := _mesh_problem(path):
            yield finding(link, "mesh_unreadable", f"the mesh {quoted(name)} {problem}", at=mesh)


def meshes(robot: Element, package_dirs: Sequence[Path]) -> Iterator[tuple[Element, Path | None]]:
    """Yield the <mesh> and its file, if there is one, of every visual that is a mesh.

    Pipes and devices count as files, so that they are refused before Pinocchio opens them.
    """
    for mesh in robot.findall("link/visual/geometry/mesh"):
        name = mesh.get("filename", "")
        paths = [Path(name.removeprefix("file://"))]
        if name.startswith(_PACKAGES):
            paths = [folder / name.partition("://")[2] for folder in package_dirs]
        yield mesh, next((path for path in paths if os.path.lexists(path)), None)


def _mesh_problem(path: Path) -> str:
    """Return what is wrong with the size of a mesh file, or of the triangles that a binary STL claims."""
    try:
        head, size = head_of_user_file(path, limit=MAX_MESH_BYTES, kind="a mesh")
    except FileReadError as error:
        return f"cannot be read: {error}"
    if not size:
        return "is empty"
    if path.suffix.lower() != ".stl" or (head.lstrip()[:5].lower() == b"solid" and b"facet" in head):
        return ""
    triangles = int.from_bytes(head[80:_STL_HEADER], "little")
    held = max(0, (size - _STL_HEADER) // _STL_TRIANGLE)
    return "" if 0 < triangles <= held else f"claims {triangles} triangles and holds {held}; export it again"
