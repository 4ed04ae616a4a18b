"""``coop-pin show``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import OK


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
        print("\n".join(cell_summary(scenario.cell, scenario.start.matrix).lines()))
        return OK
