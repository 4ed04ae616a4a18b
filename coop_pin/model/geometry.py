"""Visual geometry of a URDF, and a process that tries whether Pinocchio can read it.

    python -P geometry.py

Pinocchio's reader of meshes (Assimp) has no limits: some damaged files end its process, others take forever.
stdin of the process is a table in JSON: ``text`` and ``folders`` as of visual_geometry, ``cpu_s``.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import pinocchio as pin

_MEMORY = 4 * 2**30
_CPU_S, _BYTES_PER_S = 3, 5_000_000
"""Processor time: this, and a second for so many bytes of meshes."""
_PATIENCE_S = 120.0
_UNREADABLE = ValueError, RuntimeError, MemoryError


def visual_geometry(model: pin.Model, text: str, folders: Sequence[str]) -> tuple[list[Any], dict[str, str]]:
    """Return Pinocchio's visual geometry objects, and why those of a link cannot be read, by its name.

    Args:
        model: of the URDF, with all its joints.
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
        size: of all its meshes, bytes.
    """
    order = {"text": text, "folders": list(folders), "cpu_s": _CPU_S + size // _BYTES_PER_S}
    try:
        done = subprocess.run(
            [sys.executable, "-P", __file__],
            input=json.dumps(order).encode(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=_PATIENCE_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode in (0, 1)  # 1 is an exception of Python, which is none of a mesh


def without_meshes(text: str) -> str:
    """Return a URDF without the visuals that are meshes."""
    robot = ElementTree.fromstring(text)
    _remove(robot, [visual for visual in robot.iter("visual") if visual.find("geometry/mesh") is not None])
    return ElementTree.tostring(robot, encoding="unicode")


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
        model, text, pin.GeometryType.VISUAL, pin.GeometryModel(), list(folders)
    )
    return list(geometry.geometryObjects)


def _main(order: dict[str, Any]) -> None:
    with contextlib.suppress(ImportError):  # on Windows the parent's patience is the only limit
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (order["cpu_s"], order["cpu_s"]))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if sys.platform != "darwin":  # which refuses it
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    visual_geometry(pin.buildModelFromXML(order["text"]), order["text"], order["folders"])


if __name__ == "__main__":
    _main(json.load(sys.stdin))
