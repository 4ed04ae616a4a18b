"""Commands that simulate nothing: ``coop-pin list``, ``fields``, ``show``, ``check`` and ``check-urdf``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import FAILED, OK

_ScenarioName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]


@dataclasses.dataclass(frozen=True)
class List:
    """List the scenarios that come with coop_pin."""

    def execute(self) -> int:
        """Print one line for each scenario."""
        from coop_pin.description import Scenario, scenario_names

        for scenario in map(Scenario.load, scenario_names()):
            size = f"{len(scenario.cell.arms)} arms  {scenario.duration:g} s"
            print(f"{scenario.name:<20} {size}  {scenario.summary}")
        return OK


@dataclasses.dataclass(frozen=True)
class Fields:
    """List the fields of a scenario with values and meanings; 'coop-pin run' takes each of them as an option.

    Attributes:
        scenario: a name listed by 'coop-pin list', or a TOML file.
    """

    scenario: _ScenarioName

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
        scenario: a name listed by 'coop-pin list', or a TOML file.
    """

    scenario: _ScenarioName

    def execute(self) -> int:
        """Print the tree."""
        from coop_pin.analysis.cell_summary import cell_summary
        from coop_pin.description import Scenario

        scenario = Scenario.load(self.scenario)
        print(cell_summary(scenario.cell, scenario.start.matrix).summary())
        return OK


@dataclasses.dataclass(frozen=True)
class Check:
    """Check reachability, distance to singularities and joint limits along the desired motion.

    Nothing is simulated. For the built-in controllers, also check at the initial pose that the damping gains
    are stable at the control rate.

    Attributes:
        scenario: a name listed by 'coop-pin list', or a TOML file.
        poses: number of poses checked along the motion.
    """

    scenario: _ScenarioName
    poses: int = 401

    def execute(self) -> int:
        """Print the results; the exit code is OK if the motion is feasible."""
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
    """Check structure, inertias, units and mesh paths of a URDF before loading it.

    Attributes:
        urdf: a URDF or xacro file, or the name of a bundled ("adept_3dof") or example-robot-data arm
            ("panda").
        strict: physically impossible masses and inertias are errors, not warnings.
    """

    urdf: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    strict: bool = False

    def execute(self) -> int:
        """Print the findings; the exit code is OK if the file can be used."""
        from coop_pin.description.urdf import check_file, find_urdf

        report = check_file(find_urdf(self.urdf))
        print(report.summary(strict=self.strict))
        return FAILED if report.errors(strict=self.strict) else OK
