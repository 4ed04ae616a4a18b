"""Options of commands with many runs: workers, engine, folders to merge."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import tyro

from coop_pin.sweeps.execution import HERE, Execution

__all__ = ["HERE", "ExecutionOptions"]

ExecutionOptions: TypeAlias = Annotated[Execution, tyro.conf.OmitArgPrefixes, tyro.conf.UseAppendAction]
"""Fields of an Execution as options of a command: --workers, --scheduler, --engine, --merge, --quiet."""
