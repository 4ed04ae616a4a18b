"""Visual geometry of a URDF, and a process that tries whether Pinocchio can read it.

Pinocchio's reader of meshes (Assimp) has no limits: some damaged files end its process, others take forever.
The process runs this file through ``limited_process``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree

import pinocchio as pin

from coop_pin.base import limited_process

_MEMORY = 4 * 2**30
_CPU_S, _BYTES_PER_S = 3, 5_000_000
"""Processor time: this, and a second for so many bytes of meshes."""
_PATIENCE_S = 120.0
_MESHES = pin.coal.CachedMeshLoader(pin.coal.NODE_TYPE.BV_OBB)
"""Reads a file again only if it has changed, and builds the tree for collisions that costs least."""
ColouredMesh: TypeAlias = tuple[Path, tuple[float, ...]]
"""File of a mesh and its scale along x, y, z."""
_UNREADABLE = ValueError, RuntimeError, MemoryError


def visual_geometry(model: pin.Model, text: str, folders: Sequence[str]) -> tuple[list[Any], dict[str, str]]:
    """Return Pinocchio's visual geometry objects, and why those of a link cannot be read, by its name.

    Args:
        model: model of the URDF, with all its joints.
        text: the URDF.
        folders: searched for the packages of package://.
    """
    try:
        return _build(model, text, folders), {}
    except _UNREADABLE:  # one bad mesh fails the whole file: read it link by link
        objects: list[Any] = []
        problems: dict[str, str] = {}
        for link in ElementTree.fromstring(text).iter("link"):
            name = link.get("name", "")
            try:
                objects += _build(model, _with_visuals_of(name, text), folders)
            except _UNREADABLE as error:
                problems[name] = str(error)
        return objects, problems


def can_be_read(text: str, folders: Sequence[str], size: int) -> bool:
    """Return whether visual_geometry ends in a process with limits of time and memory.

    Args:
        text: the URDF.
        folders: searched for the packages of package://.
        size: size of all its meshes, bytes.
    """
    cpu_s = _CPU_S + size // _BYTES_PER_S
    order = {"text": text, "folders": list(folders)}
    code, _ = limited_process.ask(
        Path(__file__), order, cpu_s=cpu_s, memory=_MEMORY, patience_s=_PATIENCE_S, quiet=True
    )
    return code in (0, limited_process.REFUSED)  # an exception of Python is none of a mesh


def without_meshes(text: str) -> str:
    """Return a URDF without the visuals that are meshes."""
    robot = ElementTree.fromstring(text)
    _remove(robot, [visual for visual in robot.iter("visual") if visual.find("geometry/mesh") is not None])
    return ElementTree.tostring(robot, encoding="unicode")


def without_coloured_meshes(text: str, folders: Sequence[Path]) -> tuple[str, dict[str, ColouredMesh]]:
    """Return a URDF with points in place of COLLADA meshes that the URDF gives no material, and these meshes.

    Args:
        text: the URDF.
        folders: searched for the packages of package://.

    Returns:
        The URDF, and file and scale of the meshes by Pinocchio's names of their visuals.
    """
    robot = ElementTree.fromstring(text)
    coloured: dict[str, ColouredMesh] = {}
    for link in robot.iter("link"):
        for number, visual in enumerate(link.findall("visual")):
            mesh = visual.find("geometry/mesh[@filename]")
            if mesh is None or visual.find("material") is not None:
                continue
            paths = (folder / mesh.get("filename", "").partition("://")[2] for folder in folders)
            path = next(filter(Path.is_file, paths), None)
            if path is not None and path.suffix.lower() == ".dae":
                scale = tuple(map(float, mesh.get("scale", "1 1 1").split()))
                coloured[f"{link.get('name')}_{number}"] = path, scale
                mesh.tag, mesh.attrib = "sphere", {"radius": "0"}
    return ElementTree.tostring(robot, encoding="unicode"), coloured


def _with_visuals_of(name: str, text: str) -> str:
    robot = ElementTree.fromstring(text)
    others = [link for link in robot.iter("link") if link.get("name") != name]
    _remove(robot, [visual for link in others for visual in link.findall("visual")])
    return ElementTree.tostring(robot, encoding="unicode")


def _remove(robot: ElementTree.Element, visuals: Sequence[ElementTree.Element]) -> None:
    for link in robot.iter("link"):
        for visual in link.findall("visual"):
            if visual in visuals:
                link.remove(visual)


def _build(model: pin.Model, text: str, folders: Sequence[str]) -> list[Any]:
    # Without the geometry model as an argument, pin 4.1 warns that passing folders is deprecated.
    geometry = pin.buildGeomFromUrdfString(
        model, text, pin.GeometryType.VISUAL, pin.GeometryModel(), list(folders), _MESHES
    )
    return list(geometry.geometryObjects)


def _try(text: str, folders: Sequence[str]) -> bytes:
    visual_geometry(pin.buildModelFromXML(text), text, folders)
    return b""


if __name__ == "__main__":
    limited_process.answer(_try)
