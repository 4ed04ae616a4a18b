"""``coop-pin check``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import FAILED, OK


@dataclasses.dataclass(frozen=True)
class Check:
    """Look along the desired motion without simulating: is it within reach, how near to singular, which limits are met when?

    And at the start: can the control rate bear the damping that the gains ask for? A controller of your own is not asked.

    Attributes:
        scenario: a name that 'coop-pin list' shows, or a TOML file.
        poses: how many poses along the motion are looked at.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
    poses: int = 401

    def execute(self) -> int:
        """Print what was found; return whether the motion can be held as an exit code."""
        from coop_pin.analysis import held_damping, reachability
        from coop_pin.description import Scenario

        scenario = Scenario.load(self.scenario)
        found = reachability(scenario, self.poses)
        print(found.text())
        if not found.ok or scenario.controller.kind == "user":
            return OK if found.ok else FAILED
        held = held_damping(scenario)
        print(f"  {held.text()}")
        return OK if held.ok else FAILED
