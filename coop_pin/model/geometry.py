"""Visual and collision geometry of a URDF, and a process that tries whether it can be read.

Pinocchio's reader of meshes (Assimp) has no limits: some damaged files end its process, others take forever.
The process runs this file through ``limited_process``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import pinocchio as pin

from coop_pin.base import limited_process
from coop_pin.base.errors import FileReadError
from coop_pin.description.urdf.find import UrdfFile
from coop_pin.description.urdf.meshes import meshes
from coop_pin.description.urdf.xml import Element, read_document, text_of
from coop_pin.model.meshes import SUFFIXES, MeshFile, coloured_meshes

_MEMORY = 4 * 2**30
_CPU_S, _BYTES_PER_S = 3, 5_000_000
"""Processor time: this, and a second for so many bytes of meshes."""
_PATIENCE_S = 120.0
_MESHES = pin.coal.CachedMeshLoader(pin.coal.NODE_TYPE.BV_OBB)
"""Reads a file again only if it has changed, and builds the tree for collisions that costs least."""
Kind: TypeAlias = Literal["visual", "collision"]
_TYPES = {"visual": pin.GeometryType.VISUAL, "collision": pin.GeometryType.COLLISION}
_UNREADABLE = ValueError, RuntimeError, MemoryError


def with_located_meshes(text: str, urdf: UrdfFile, kind: Kind = "visual") -> tuple[str, list[Path]]:
    """Return a URDF whose meshes of a kind are named by their paths, and these files.

    Args:
        text: the URDF.
        urdf: file of the robot.
        kind: kind of the shapes.
    """
    robot, files = read_document(text.encode()), []
    for mesh, path in meshes(robot, urdf, kind):
        if path is not None:
            mesh.set("filename", str(path))
            files.append(path)
    return text_of(robot), files


def geometry_objects(model: pin.Model, text: str, kind: Kind = "visual") -> tuple[list[Any], dict[str, str]]:
    """Return Pinocchio's geometry objects of a kind, and why those of a link cannot be read, by its name.

    Args:
        model: model of the URDF, with all its joints.
        text: the URDF, with the paths of its meshes.
        kind: kind of the shapes.
    """
    try:
        return _build(model, text, kind), {}
    except _UNREADABLE:  # one bad mesh fails the whole file: read it link by link
        objects: list[Any] = []
        problems: dict[str, str] = {}
        for link in read_document(text.encode()).iter("link"):
            name = link.get("name", "")
            try:
                objects += _build(model, _with_shapes_of(name, text, kind), kind)
            except _UNREADABLE as error:
                problems[name] = str(error)
        return objects, problems


def can_be_read(text: str, size: int, kind: Kind = "visual") -> bool:
    """Return whether reading all meshes ends in a process with limits of time and memory.

    Args:
        text: the URDF, with the paths of its meshes.
        size: size of all its meshes, bytes.
        kind: kind of the shapes.
    """
    cpu_s = _CPU_S + size // _BYTES_PER_S
    code, _ = limited_process.ask(
        Path(__file__),
        {"text": text, "kind": kind},
        cpu_s=cpu_s,
        memory=_MEMORY,
        patience_s=_PATIENCE_S,
        quiet=True,
    )
    return code in (0, limited_process.REFUSED)  # an exception of Python is none of a mesh


def without_meshes(text: str, kind: Kind = "visual") -> str:
    """Return a URDF without the shapes of a kind that are meshes."""
    robot = read_document(text.encode())
    _remove([shape for shape in robot.iter(kind) if shape.find("geometry/mesh") is not None])
    return text_of(robot)


def without_mesh_files(text: str) -> tuple[str, dict[str, MeshFile]]:
    """Return a URDF with points in place of the meshes that ``model.meshes`` reads, and these meshes.

    Args:
        text: the URDF, with the paths of its meshes.

    Returns:
        The URDF, and the meshes by Pinocchio's names of their visuals.
    """
    robot = read_document(text.encode())
    files: dict[str, MeshFile] = {}
    for link in robot.iter("link"):
        for number, visual in enumerate(link.findall("visual")):
            mesh = visual.find("geometry/mesh[@filename]")
            if mesh is None:
                continue
            path = Path(mesh.get("filename", ""))
            if path.suffix.lower() in SUFFIXES and path.is_file():
                scale = tuple(map(float, mesh.get("scale", "1 1 1").split()))
                files[f"{link.get('name')}_{number}"] = MeshFile(path, scale, visual.find("material") is None)
                mesh.tag = "sphere"
                mesh.attrib.clear()
                mesh.set("radius", "0")
    return text_of(robot), files


def _with_shapes_of(name: str, text: str, kind: Kind) -> str:
    robot = read_document(text.encode())
    others = [link for link in robot.iter("link") if link.get("name") != name]
    _remove([shape for link in others for shape in link.findall(kind)])
    return text_of(robot)


def _remove(shapes: Sequence[Element]) -> None:
    for shape in shapes:
        shape.getparent().remove(shape)


def _build(model: pin.Model, text: str, kind: Kind) -> list[Any]:
    # Without the geometry model as an argument, pin 4.1 warns that passing folders is deprecated.
    geometry = pin.buildGeomFromUrdfString(model, text, _TYPES[kind], pin.GeometryModel(), [], _MESHES)
    return list(geometry.geometryObjects)


def _try(text: str, kind: Kind) -> bytes:
    rest, files = without_mesh_files(text) if kind == "visual" else (text, {})
    for path, scale, _ in files.values():
        with contextlib.suppress(FileReadError):  # which drawings of the other links survive
            coloured_meshes(path, scale)
    geometry_objects(pin.buildModelFromXML(text), rest, kind)
    return b""


if __name__ == "__main__":
    limited_process.answer(_try)
