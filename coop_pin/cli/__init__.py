"""The command line: parse, call, print. What it does can be done in Python as well."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence

from coop_pin import __version__
from coop_pin.cli.exit_codes import BAD_INPUT, FAILED, INTERRUPTED, OK


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``coop-pin`` and return its exit code; ``coop_pin.cli.exit_codes`` lists them.

    Args:
        arguments: the words after ``coop-pin``; those of the process when omitted.

    Raises:
        SystemExit: help was asked for (0), or the words make no command (2).
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        print(f"coop-pin {__version__}")
        return OK
    from coop_pin.errors import CoopPinError

    pythons_own, warnings.formatwarning = warnings.formatwarning, _worded
    try:
        from coop_pin.cli.parsing import parse  # takes long enough to load for somebody to press Ctrl-C

        return parse(words).execute()
    except CoopPinError as error:
        return _report(str(error), BAD_INPUT)
    except OSError as error:
        return _report(str(error), FAILED)
    except KeyboardInterrupt as interrupt:
        return _report(str(interrupt) or "interrupted", INTERRUPTED)
    finally:
        warnings.formatwarning = pythons_own


def _worded(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:  # noqa: ARG001
    """Return a warning for people: without the line of this package's source that gave it."""
    return f"coop-pin: warning: {message}\n"


def _report(message: str, code: int) -> int:
    print(f"coop-pin: {message}", file=sys.stderr)
    return code
