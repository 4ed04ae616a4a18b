"""``coop-pin report``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import OK


@dataclasses.dataclass(frozen=True)
class Report:
    """Write one page that tells a whole run: scenario, judgements, figures, limits and the 3-D replay; it opens offline.

    Attributes:
        result: the folder of a run, or its result.nc.
        out: the page; report.html beside the result when omitted.
    """

    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR_OR_FILE")]
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None

    def execute(self) -> int:
        """Write the page and print its path."""
        from coop_pin.report import save_report
        from coop_pin.results import RunResult
        from coop_pin.run_folder import RunFolder

        file = self.result / RunFolder.RESULT if self.result.is_dir() else self.result
        page = self.out or file.with_name(RunFolder.REPORT)
        save_report(RunResult.load(file), page)
        print(page.resolve())
        return OK
