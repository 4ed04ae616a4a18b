"""``coop-pin run`` as it is typed; what it does is in ``running``, which takes longer to load."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import tyro


@dataclasses.dataclass(frozen=True)
class Run:
    """Run a scenario and write its results into a folder.

    Every field of the scenario can be changed: --controller.gains.sign-gain 0.5 --cell.arms.left.posture 1 2 3
    --controller.switching.kind tanh --events []. 'coop-pin fields NAME_OR_FILE' lists them.

    Attributes:
        scenario: a name that 'coop-pin list' shows, or a TOML file.
        out: the folder; out/ and the scenario's name when omitted.
        quiet: no progress bar and no table.
        replay: whether to write replay.html, the motion in 3-D.
        figures: whether to write the figures.
        report: whether to write report.html, one page that tells the whole run.
        fields: fields of the scenario, as typed.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    quiet: bool = False
    replay: bool = True
    figures: bool = True
    report: bool = False
    fields: Annotated[Mapping[str, Sequence[str]], tyro.conf.Suppress] = dataclasses.field(default_factory=dict)

    def execute(self) -> int:
        """Run, write, print; return the exit code."""
        from coop_pin.cli.running import run_into_folder

        return run_into_folder(self)
