"""Command line: ``coop-pin`` parses its arguments, runs one command and returns an exit code.

Open first: ``parsing`` (all commands), ``run`` (``coop-pin run``; its folder is written by ``run_folder``),
``overrides`` (fields of a scenario as typed).

- Commands: ``check`` (also ``root_locus``), ``blame``, ``inspect`` (list, show, suggest, new), ``export``,
  ``sweep`` (also ``tune``, and options of commands with many runs), ``compare``, ``conform``, ``zoo``,
  ``view``; ``field_list`` is what ``fields`` prints.
- ``exit_codes`` lists how a command ends; ``terminal`` wraps lines and tells what goes on.

What is slow to load is imported in the command that needs it.

Imports ``base``, ``comparison``, ``compiled``, ``description``, ``design``, ``feasibility``, ``figures``,
``identification``, ``logs``, ``results``, ``running``, ``stability``, ``sweeps``, ``viz`` and
``zoo``.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from coop_pin import __version__
from coop_pin.base.user_files import printable
from coop_pin.cli.exit_codes import BAD_INPUT, FAILED, INTERRUPTED, OK, OUTPUT_CLOSED
from coop_pin.cli.terminal import print_error

_REPEAT_S = 0.05
"""Time after which a dropped Ctrl-C is sent once more, s."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``coop-pin`` and return its exit code; ``coop_pin.cli.exit_codes`` lists them.

    Args:
        arguments: the words after ``coop-pin``; those of the process when omitted.

    Raises:
        SystemExit: help was asked for (0), or the words are no command (2).
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        print(f"coop-pin {__version__}")
        return OK
    from coop_pin.base import errors

    failures = (
        errors.CodeChangedError,
        errors.InfeasibleMotionError,
        errors.NothingFeasibleError,
        errors.StoreLockedError,
        errors.FileWriteError,
        errors.WorkersLostError,
    )
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # user modules are found as ``python -m`` finds them
    original_format, warnings.formatwarning = warnings.formatwarning, _format_warning
    try:
        from coop_pin.cli.parsing import parse  # slow enough to load that Ctrl-C may come meanwhile

        try:
            with _dropped_ctrl_c_repeated():
                return parse(words)() or OK
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python flushes at its end
        return OUTPUT_CLOSED
    except (errors.CoopPinError, OSError) as error:
        is_input = isinstance(error, errors.CoopPinError) and not isinstance(error, failures)
        return _report(str(error), BAD_INPUT if is_input else FAILED)
    except errors.SweepInterruptedError as interrupt:
        status = f"{interrupt.finished} of {interrupt.total} runs are kept in {interrupt.folder}"
        return _report(f"{status}; go on with: {shlex.join(['coop-pin', *words])}", INTERRUPTED)
    except KeyboardInterrupt as interrupt:
        return _report(str(interrupt) or "interrupted", INTERRUPTED)
    except Exception as error:
        if errors.is_ctrl_c(error):
            return _report("interrupted", INTERRUPTED)
        if not errors.is_of_users_code(error):
            raise
        file, line, function = errors.place_of(error)
        return _report(f"{function} failed at {file}:{line}: {type(error).__name__}: {error}", BAD_INPUT)
    finally:
        warnings.formatwarning = original_format


@contextlib.contextmanager
def _dropped_ctrl_c_repeated() -> Iterator[None]:
    """Send Ctrl-C once more where Python drops it, as in a destructor; tell other errors that it drops."""
    tell, timers, main_thread = sys.unraisablehook, list[threading.Timer](), threading.main_thread()

    def repeat_or_tell(dropped: Any) -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt) and threading.current_thread() == main_thread:
            timers.append(threading.Timer(_REPEAT_S, signal.pthread_kill, (main_thread.ident, signal.SIGINT)))
            timers[-1].start()
        else:
            tell(dropped)

    sys.unraisablehook = repeat_or_tell
    try:
        yield
    finally:
        sys.unraisablehook = tell
        for timer in timers:
            timer.cancel()


def _format_warning(message: Warning | str, *_details: object, **_more: object) -> str:
    """Return a warning without the source line of this package that gave it."""
    return f"coop-pin: warning: {message}\n"


def _report(message: str, code: int) -> int:
    print_error(f"coop-pin: {printable(message)}")
    return code
