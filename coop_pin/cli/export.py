"""Command ``coop-pin export-c``: the law of one arm as C99 for a real controller."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import OK
from coop_pin.cli.overrides import ScenarioCommand


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExportC(ScenarioCommand):
    """Write the law of one arm as C99: forward kinematics, Jacobian and law, with a self-test.

    Every field of the scenario can be changed as in 'coop-pin run'. The code is straight-line: it allocates
    nothing, and its state goes in and out.

    Attributes:
        arm: name of the arm.
        out: output folder; out/, the scenario's name and -c when omitted.
        ticks: number of ticks of the self-test, recorded from the start of the scenario.
    """

    arm: str
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    ticks: int = 20

    def execute(self) -> int:
        """Write the files, and print their names and the operations of a step.

        Raises:
            CoopPinError: the law cannot be exported, or the scenario cannot start.
        """
        from coop_pin.batch import export_c  # slow to load

        scenario = self.loaded()
        folder = self.out or Path("out") / f"{scenario.name}-c"
        law = export_c(scenario, self.arm, folder, ticks=self.ticks)
        print(law.summary())
        names = f"{law.source} {law.self_test} -lm -o {law.source.with_suffix('')}_self_test"
        print(f"self-test: cc -std=c99 -O2 {names} && {law.source.with_suffix('')}_self_test")
        return OK
