"""``coop-pin check``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import FAILED, OK


@dataclasses.dataclass(frozen=True)
class Check:
    """Look along the desired motion without simulating: is it within reach, how near to singular, which limits are met when?

    Attributes:
        scenario: a name that 'coop-pin list' shows, or a TOML file.
        poses: how many poses along the motion are looked at.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
    poses: int = 401

    def execute(self) -> int:
        """Print what was found; return whether the motion can be held as an exit code."""
        from coop_pin.analysis import reachability
        from coop_pin.description import Scenario

        found = reachability(Scenario.load(self.scenario), self.poses)
        print(found.text())
        return OK if found.ok else FAILED
