"""Mobile base under an arm: driven joints x, y and yaw of an omnidirectional platform, added to its URDF."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Annotated, Literal

from pydantic import AfterValidator, field_validator

from coop_pin.base.errors import FieldError, UrdfError
from coop_pin.base.schema.base import Description, Positive, Vector3, positive
from coop_pin.description.urdf.tree import read_tree
from coop_pin.description.urdf.xml import read_document

_JOINTS = ("base_x", "base_y", "base_yaw", "base_mount")
_LINKS = ("base_ground", "base_along_x", "base_along_y", "mobile_base")
_PLATFORM = """
<link name="base_ground"/><link name="base_along_x"/><link name="base_along_y"/>
<link name="mobile_base">
  <inertial>
    <origin xyz="0 0 {middle!r}"/><mass value="{base.mass!r}"/>
    <inertia ixx="{inertia[0]!r}" iyy="{inertia[1]!r}" izz="{inertia[2]!r}" ixy="0" ixz="0" iyz="0"/>
  </inertial>
  <visual>
    <origin xyz="0 0 {middle!r}"/><geometry><box size="{x!r} {y!r} {z!r}"/></geometry>
    <material name="mobile_base"><color rgba="0.3 0.33 0.37 1"/></material>
  </visual>
</link>
<joint name="base_x" type="prismatic">
  <parent link="base_ground"/><child link="base_along_x"/><axis xyz="1 0 0"/>
  <limit lower="-{base.travel!r}" upper="{base.travel!r}" effort="{base.force!r}" velocity="{base.speed!r}"/>
</joint>
<joint name="base_y" type="prismatic">
  <parent link="base_along_x"/><child link="base_along_y"/><axis xyz="0 1 0"/>
  <limit lower="-{base.travel!r}" upper="{base.travel!r}" effort="{base.force!r}" velocity="{base.speed!r}"/>
</joint>
<joint name="base_yaw" type="revolute">
  <parent link="base_along_y"/><child link="mobile_base"/><axis xyz="0 0 1"/>
  <limit lower="-{base.turn!r}" upper="{base.turn!r}" effort="{base.torque!r}" velocity="{base.speed!r}"/>
</joint>
<joint name="base_mount" type="fixed">
  <origin xyz="0 0 {z!r}"/><parent link="mobile_base"/><child link={root}/>
</joint>
"""
"""Links and joints of a platform under the root link of a URDF."""


def root_of(urdf: str) -> str:
    """Return the name of the root link of a checked URDF."""
    tree = read_tree(read_document(urdf.encode()))
    return next(link for link in tree.links if link not in tree.above)


def require_no_names(urdf: str, names: Sequence[str]) -> None:
    """Raise an error if a URDF has a link or joint with the name of one of a platform's.

    Raises:
        UrdfError: with the names.
    """
    tree = read_tree(read_document(urdf.encode()))
    if taken := sorted({*tree.links, *(edge.name for edge in tree.edges())}.intersection(names)):
        raise UrdfError(
            f"the URDF has {', '.join(taken)}, names of the mobile base; rename them", names=taken
        )


class MobileBase(Description):
    """Omnidirectional platform that carries an arm: its three drives come before the arm's joints.

    ``X_WB`` of the arm (its field ``base``) is the pose of the platform on the ground at zero. The platform
    moves along x and y of this frame and turns about z; the root link of the arm's URDF stands on it. Wheels
    are not modelled: the drives act on x (N), y (N) and yaw (N m) directly. Two driven wheels, which do not
    slide sideways, are those of ``DifferentialBase``.

    Attributes:
        drive: kind of the drive, "omnidirectional".
        mass: mass of the platform, kg, homogeneous.
        size: edges of the platform, m; its underside is on the ground.
        travel: largest distance from zero along x and along y, m.
        turn: largest angle from zero, rad.
        force: limit of the drives along x and y, N.
        torque: limit of the drive about z, N m.
        speed: limit along x and y, m/s; about z the same number of rad/s.
    """

    drive: Literal["omnidirectional"] = "omnidirectional"
    mass: Positive = 120.0
    size: Annotated[Vector3, AfterValidator(positive)] = (0.9, 0.7, 0.4)
    travel: Positive = 10.0
    turn: Positive = 6.0
    force: Positive = 1000.0
    torque: Positive = 500.0
    speed: Positive = 2.0

    @field_validator("drive", mode="before")
    @classmethod
    def _holonomic(cls, drive: object) -> object:
        if drive != "omnidirectional":
            raise FieldError(
                f"is {drive!r}; it must be 'omnidirectional', or 'differential' with the fields of"
                " cp.actuators.DifferentialBase; cars are not modelled"
            )
        return drive

    def under(self, urdf: str) -> str:
        """Return the text of a checked URDF whose root link stands on this platform.

        Raises:
            UrdfError: the URDF has a link or joint with a name of the platform's.
        """
        require_no_names(urdf, (*_LINKS, *_JOINTS))
        x, y, z = self.size
        inertia = [self.mass * (a * a + b * b) / 12.0 for a, b in ((y, z), (x, z), (x, y))]
        added = _PLATFORM.format(
            base=self, x=x, y=y, z=z, middle=z / 2.0, inertia=inertia, root=f'"{escape(root_of(urdf))}"'
        )
        before, _, after = urdf.rpartition("</robot>")
        return f"{before}{added}</robot>{after}"
