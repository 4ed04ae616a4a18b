"""What can be read but is hardly meant: degrees for radians, millimetres for metres, meshes that are not there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from coop_pin.description.urdf.numbers import number, numbers
from coop_pin.description.urdf.report import UrdfFinding, doubtful, listed, quoted
from coop_pin.description.urdf.xml import Node

_DEGREES = (45.0, 720.0)
"""Size of a revolute joint's limit that is likely in degrees; larger ones stand for "no limit" in many files."""

_FAR_M = 10.0
"""Distance from one joint to the next beyond which no arm reaches."""

_PACKAGES = ("package://", "model://")


def unit_findings(joint: Node) -> Iterator[UrdfFinding]:
    """Yield the numbers of a joint that look like another unit's."""
    limit = joint.child("limit")
    if joint.attributes.get("type") == "revolute" and limit is not None:
        ends = [value for value in (number(limit, "lower"), number(limit, "upper")) if value is not None]
        largest = max(map(abs, ends), default=0.0)
        if _DEGREES[0] <= largest <= _DEGREES[1]:
            message = f"a limit of {largest:g} rad is {largest / 6.283185307:.0f} turns; URDF counts in radians: are these degrees?"
            yield doubtful("limit_degrees", joint.label, limit.line, message)
    origin = joint.child("origin")
    far = max(map(abs, numbers(origin, "xyz") or (0.0,)))
    if origin is not None and far > _FAR_M:
        message = f"its origin is {far:g} m off its parent's; URDF counts in metres: are these millimetres?"
        yield doubtful("origin_far", joint.label, origin.line, message)


def mesh_findings(robot: Node, package_dirs: Iterable[Path]) -> Iterator[UrdfFinding]:
    """Yield the meshes of visuals that are not there; pictures leave their links out.

    Args:
        robot: the <robot> element.
        package_dirs: folders in which the packages of package:// are looked for.
    """
    folders = tuple(package_dirs)
    for link in robot.children:
        for visual in link.children if link.tag == "link" else ():
            geometry = visual.child("geometry") if visual.tag == "visual" else None
            mesh = geometry.child("mesh") if geometry is not None else None
            name = mesh.attributes.get("filename", "") if mesh is not None else ""
            if mesh is not None and not any(path.is_file() for path in _candidates(name, folders)):
                looked = f" in {listed(map(str, folders))}" if name.startswith(_PACKAGES) else ""
                message = f"there is no mesh {quoted(name)}{looked}; pictures leave the link out, the physics does not need it"
                yield doubtful("mesh_missing", link.label, mesh.line, message)


def _candidates(name: str, folders: tuple[Path, ...]) -> list[Path]:
    """Return where Pinocchio looks for a mesh."""
    if name.startswith(_PACKAGES):
        return [folder / name.partition("://")[2] for folder in folders]
    return [Path(name.removeprefix("file://"))]
