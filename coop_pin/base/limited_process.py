"""Processes with limits of time and memory, for libraries without limits that read users' files.

A script calls ``answer`` with its function; ``ask`` starts it and returns what the function does.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

REFUSED = 2
"""Exit code if the function raises an exception."""


def ask(
    script: Path, order: dict[str, Any], *, cpu_s: int, memory: int, patience_s: float, quiet: bool = False
) -> tuple[int, bytes]:
    """Return the exit code of a script, and what its function returns.

    The code is 0; REFUSED with the message of an exception instead; or another one if a limit, or a crash,
    ends the process.

    Args:
        script: a file that calls ``answer``.
        order: keyword arguments of its function, JSON.
        cpu_s: processor time, imports included, s.
        memory: bytes.
        patience_s: wall time, for a crowded machine, and for systems without limits of processor time, s.
        quiet: drop its standard error.
    """
    path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(script)],
            input=json.dumps({"order": order, "cpu_s": cpu_s, "memory": memory}).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
            env=os.environ | {"PYTHONPATH": path},
            timeout=patience_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return -1, b""
    return done.returncode, done.stdout


def answer(function: Callable[..., bytes]) -> None:
    """Call a function as ``ask`` orders; its result is the standard output."""
    request = json.load(sys.stdin)
    with contextlib.suppress(ImportError):  # on Windows the patience is the only limit
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (request["cpu_s"], request["cpu_s"]))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if sys.platform != "darwin":  # which refuses it
            resource.setrlimit(resource.RLIMIT_AS, (request["memory"], request["memory"]))
    code = 0
    try:
        result = function(**request["order"])
    except Exception as error:  # whatever the library raises
        code, result = REFUSED, (str(error) or type(error).__name__).encode(errors="replace")
    sys.stdout.buffer.write(result)
    sys.exit(code)
