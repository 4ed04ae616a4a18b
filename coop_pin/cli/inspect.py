"""``coop-pin check``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import FAILED, OK


@dataclasses.dataclass(frozen=True)
class List:
    """List the scenarios that come with coop_pin."""

    def execute(self) -> int:
        """Print one line for each scenario."""
        from coop_pin.description import Scenario, scenario_names

        for scenario in map(Scenario.load, scenario_names()):
            print(
                f"{scenario.name:<20} {len(scenario.cell.arms)} arms  {scenario.duration:g} s  {scenario.summary}"
            )
        return OK


@dataclasses.dataclass(frozen=True)
class Fields:
    """List the fields of a scenario, their values and meanings: 'coop-pin run' takes each of them as an option.

    Attributes:
        scenario: a name that 'coop-pin list' shows, or a TOML file.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]

    def execute(self) -> int:
        """Print one line for each field."""
        from coop_pin.cli.field_list import field_list
        from coop_pin.description import Scenario

        print("\n".join(field_list(Scenario.load(self.scenario))))
        return OK


@dataclasses.dataclass(frozen=True)
class Show:
    """Show the cell of a scenario as a tree: joints, masses, reach, closure rows and their rank.

    Attributes:
        scenario: a name that 'coop-pin list' shows, or a TOML file.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]

    def execute(self) -> int:
        """Print the tree."""
        from coop_pin.analysis.cell_summary import cell_summary
        from coop_pin.description import Scenario

        scenario = Scenario.load(self.scenario)
        print(cell_summary(scenario.cell, scenario.start.matrix).summary())
        return OK


@dataclasses.dataclass(frozen=True)
class Check:
    """Look along the desired motion without simulating: is it within reach, how near to singular, which limits are met when?

    And at the start: can the control rate bear the damping that the gains ask for? A controller of your own
    is not asked.

    Attributes:
        scenario: a name that 'coop-pin list' shows, or a TOML file.
        poses: how many poses along the motion are looked at.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
    poses: int = 401

    def execute(self) -> int:
        """Print what was found; return whether the motion can be held as an exit code."""
        from coop_pin.analysis import reachability, sampled_stability
        from coop_pin.description import Scenario

        scenario = Scenario.load(self.scenario)
        found = reachability(scenario, poses=self.poses)
        print(found.summary())
        if not found.ok or scenario.controller.kind == "user":
            return OK if found.ok else FAILED
        held = sampled_stability(scenario)
        print(f"  {held.summary()}")
        return OK if held.ok else FAILED


@dataclasses.dataclass(frozen=True)
class CheckUrdf:
    """Check a URDF: would Pinocchio read what the file says, can such bodies exist, are units and meshes right?

    Attributes:
        urdf: a URDF or xacro file, or the name of a bundled ("adept_3dof") or example-robot-data arm
            ("panda").
        strict: masses and inertias that no body can have are errors, not warnings.
    """

    urdf: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    strict: bool = False

    def execute(self) -> int:
        """Print the findings; return whether the file can be used as an exit code."""
        from coop_pin.description.urdf import check_file, find_urdf

        report = check_file(find_urdf(self.urdf))
        print(report.summary(strict=self.strict))
        return FAILED if report.errors(strict=self.strict) else OK
