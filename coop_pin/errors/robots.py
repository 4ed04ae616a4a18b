"""Robot description files and meshes that cannot be used."""

from __future__ import annotations

from collections.abc import Iterable

from coop_pin.errors.fields import FieldError


class UrdfNotFoundError(FieldError, FileNotFoundError):
    """A robot description file is not where it was looked for."""


class UrdfError(FieldError):
    """A robot description file that cannot be used."""


class AmbiguousTipError(UrdfError):
    """No tip is given and the URDF has several links at its ends.

    Attributes:
        leaves: the links that carry no other.
    """

    def __init__(self, urdf: str, leaves: Iterable[str], path: str = "") -> None:
        self.leaves = tuple(leaves)
        super().__init__(f"must be given: {urdf!r} has {len(self.leaves)} links at its ends, {', '.join(map(repr, self.leaves))}", path)


class LockedJointError(UrdfError):
    """A joint is locked where it cannot be."""


class MimicJointError(UrdfError):
    """A URDF couples moving joints, and nothing says what to do about it.

    Attributes:
        joints: the joints that follow others.
    """

    def __init__(self, urdf: str, joints: Iterable[str], path: str = "") -> None:
        self.joints = tuple(joints)
        super().__init__(
            f"{urdf!r} has joints that mimic others: {', '.join(map(repr, self.joints))}. Pinocchio's forward dynamics cannot couple them:"
            ' lock them or their leaders with locked = { joint = angle }, or let them move on their own with mimic = "ignore"',
            path,
        )


class UnsupportedJointError(UrdfError):
    """A joint that no motor turns: planar or floating.

    Attributes:
        joint: its name.
    """

    def __init__(self, urdf: str, joint: str, kind: str, path: str = "") -> None:
        self.joint = joint
        super().__init__(f"{urdf!r} has joint {joint!r} of type {kind}; arms have revolute, continuous, prismatic and fixed joints", path)


class MeshError(FieldError):
    """A mesh that cannot be read, or does not enclose a volume."""
