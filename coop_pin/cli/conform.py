"""Command ``conform``: closed forms against several engines."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.base.errors import FieldError


def conform(
    engine: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = (),
    case: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD")] = (),
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> int:
    """Compare the internal force of several engines with closed forms, in digits of force and moment.

    Twelve cases in a plane and in space. An engine that is not installed is a column of "-". It needs a
    checkout: pip install -e '.[bench]'.

    Args:
        engine: names of benchmarks/conform/engines, files or folders of your own, or module:Class; all of
            that folder when omitted.
        case: words that the names of cases must have; all cases when omitted.
        page: page in which the text between its comments "conform" is replaced by the table.

    Raises:
        FieldError: coop_pin is installed without its checkout.
    """
    folder = conform_folder(Path(__file__).parents[2])
    options = {"--engine": engine, "--case": case, "--page": () if page is None else (str(page),)}
    words = [word for option, values in options.items() if values for word in (option, *values)]
    return subprocess.run([sys.executable, str(folder), *words], check=False).returncode


def conform_folder(checkout: Path) -> Path:
    """Return the folder of cases and engines: other engines are no part of what one run needs.

    Args:
        checkout: Folder of the repository, if coop_pin runs from one.

    Raises:
        FieldError: it is none.
    """
    folder = checkout / "benchmarks" / "conform"
    if not folder.is_dir():
        remedy = "git clone the repository, and in it: pip install -e '.[bench]'"
        raise FieldError(f"is a benchmark, which only a checkout has; {remedy}", "conform")
    return folder
