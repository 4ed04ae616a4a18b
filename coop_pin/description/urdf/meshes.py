"""Mesh files of a URDF's visuals and of payloads: where they are, and whether they can be read."""

from __future__ import annotations

import io
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from coop_pin.base.errors import FieldError, FileReadError
from coop_pin.base.user_files import head_of_user_file, read_user_file
from coop_pin.description.urdf.find import UrdfFile
from coop_pin.description.urdf.packages import packages
from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.xml import Element, finding

_PACKAGES = ("package://", "model://")
MAX_MESH_BYTES = 100_000_000
"""Two million triangles of a binary STL."""
_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes of a binary STL: its header, which ends with the number of triangles, and each triangle."""


def mesh_findings(robot: Element, urdf: UrdfFile) -> Iterator[UrdfFinding]:
    """Yield the visuals whose mesh file does not exist, which drawings omit, or cannot be read.

    Args:
        robot: the <robot> element.
        urdf: file of the robot.
    """
    for mesh, path in meshes(robot, urdf):
        name, link = mesh.get("filename", ""), next(mesh.iterancestors("link"))
        if path is None:
            searched = urdf.package_dirs if name.startswith(_PACKAGES) else (urdf.path.parent,)
            message = f"there is no mesh {quoted(name)} in {listed(map(str, searched))}"
            message += "; only drawings need it, and omit it"
            yield finding(link, "mesh_missing", message, at=mesh, kind="doubtful")
        elif problem := _mesh_problem(path):
            yield finding(link, "mesh_unreadable", f"the mesh {quoted(name)} {problem}", at=mesh)


def meshes(
    robot: Element, urdf: UrdfFile, kind: Literal["visual", "collision"] = "visual"
) -> Iterator[tuple[Element, Path | None]]:
    """Yield the <mesh> and its file, if there is one, of every visual or collision shape that is a mesh.

    package:// is a folder or the name of a package.xml, in the package folders; other paths are relative to
    the URDF's folder. Pipes and devices count as files, so that they are refused before Pinocchio opens them.

    Args:
        robot: the <robot> element.
        urdf: file of the robot.
        kind: element of the shapes.
    """
    roots: dict[str, list[Path]] | None = None
    for mesh in robot.findall(f"link/{kind}/geometry/mesh"):
        name = mesh.get("filename", "")
        paths = [urdf.path.parent / name.removeprefix("file://")]
        if name.startswith(_PACKAGES):
            package, _, rest = name.partition("://")[2].partition("/")
            paths = [folder / package / rest for folder in urdf.package_dirs]
            if not any(map(os.path.lexists, paths)):
                if roots is None:
                    roots = defaultdict(list)
                    for stated, folder in packages(urdf.package_dirs):
                        roots[stated].append(folder)
                paths = [folder / rest for folder in roots.get(package, ())]
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


def read_mesh(path: Path) -> Any:
    """Return the trimesh.Trimesh of a file, its parts joined into one.

    Raises:
        FieldError: the file cannot be read, or unpacks to more than 100 MB.
    """
    import trimesh  # a tenth of a second, only for payloads that are meshes

    if not os.path.lexists(path):
        raise FieldError(f"there is no mesh at {path}", "mesh_file")
    try:
        # As bytes: a mesh that names further files does not get them.
        content = read_user_file(path, limit=MAX_MESH_BYTES, kind="a mesh")
        mesh = trimesh.load(io.BytesIO(content), file_type=path.suffix[1:].lower(), force="mesh")
    except Exception as error:  # the readers of many formats have no common base of their errors
        alone = "; one file must hold it all: save it as .glb" if path.suffix.lower() == ".gltf" else ""
        raise FieldError(f"{path} cannot be read as a mesh: {error}{alone}", "mesh_file") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise FieldError(f"{path} holds no triangles", "mesh_file")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices) or not np.isfinite(mesh.vertices).all():
        raise FieldError(f"{path} is damaged: a triangle has a corner that is no finite point", "mesh_file")
    return mesh


def closed_mesh(path: Path) -> Any:
    """Return the trimesh.Trimesh of a file whose surface encloses a volume, its triangles facing outwards.

    Raises:
        FieldError: the file cannot be read as a mesh, or its surface is open.
    """
    mesh = read_mesh(path)
    mesh.merge_vertices()
    if not mesh.is_watertight:
        raise FieldError(
            f"{path} is open: it encloses no volume. Close its holes, or give mass and inertia yourself",
            "mesh_file",
        )
    if mesh.volume < 0.0:
        mesh.invert()  # the triangles look inwards
    return mesh
