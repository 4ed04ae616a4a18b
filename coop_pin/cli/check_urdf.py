"""``coop-pin check-urdf``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import FAILED, OK


@dataclasses.dataclass(frozen=True)
class CheckUrdf:
    """Check a URDF: would Pinocchio read what the file says, can such bodies exist, are units and meshes right?

    Attributes:
        urdf: a URDF or xacro file, or the name of a bundled ("adept_3dof") or example-robot-data arm ("panda").
        strict: masses and inertias that no body can have are errors, not warnings.
    """

    urdf: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    strict: bool = False

    def execute(self) -> int:
        """Print the findings; return whether the file can be used as an exit code."""
        from coop_pin.description.urdf import check_file, find_urdf

        report = check_file(find_urdf(self.urdf))
        print("\n".join(report.lines(self.strict)))
        return FAILED if report.errors(self.strict) else OK
