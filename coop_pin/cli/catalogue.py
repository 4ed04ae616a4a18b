"""``coop-pin list`` and ``coop-pin fields``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import OK


@dataclasses.dataclass(frozen=True)
class List:
    """List the scenarios that come with coop_pin."""

    def execute(self) -> int:
        """Print one line for each scenario."""
        from coop_pin.description import Scenario, scenario_names

        for scenario in map(Scenario.load, scenario_names()):
            print(f"{scenario.name:<20} {len(scenario.cell.arms)} arms  {scenario.duration:g} s  {scenario.summary}")
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
