"""``coop-pin view``."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import OK


@dataclasses.dataclass(frozen=True)
class View:
    """Open the 3-D replay of a run; it is made anew from result.nc if it is missing.

    Attributes:
        folder: the folder of a run.
        open: whether to open a browser; without a screen only the file's path is printed.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    open: bool = True

    def execute(self) -> int:
        """Print the path of the replay and open it."""
        from coop_pin.output import RunFolder

        replay = RunFolder(self.folder).replay().resolve()
        print(replay)
        if self.open and _has_screen():
            import webbrowser

            webbrowser.open(replay.as_uri())
        return OK


def _has_screen() -> bool:
    """Say whether a browser has somewhere to show; on a bare terminal one in text mode would take the terminal over."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
