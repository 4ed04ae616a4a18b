"""Options of commands with many runs, and what they keep of a run that fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro

from coop_pin.base.errors import CoopPinError
from coop_pin.sweeps.workers.execution import HERE, Execution

__all__ = ["HERE", "ExecutionOptions", "kept_result", "tell"]

ExecutionOptions: TypeAlias = Annotated[Execution, tyro.conf.OmitArgPrefixes, tyro.conf.UseAppendAction]
"""Fields of an Execution as options of a command: --workers, --scheduler, --engine, --merge, --quiet."""


def kept_result(run: Callable[[], Any]) -> Any:
    """Return the RunResult of a run; that of one that failed ends where it failed.

    Raises:
        CoopPinError: the run could not start.
    """
    try:
        return run()
    except CoopPinError as error:
        if error.result is None:
            raise
        return error.result


def tell(execution: Execution, summary: str, folder: Path) -> None:
    """Print the summary of many runs and their folder, unless they are to be quiet."""
    if not execution.quiet:
        print(summary, f"written to {folder}", sep="\n")
