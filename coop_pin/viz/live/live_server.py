"""Server of a live page: a process that listens on the loopback interface and ends with its parent."""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import struct
import subprocess
import sys
import tempfile
import warnings
import weakref
from pathlib import Path
from typing import IO

from coop_pin.base.arrays import require_type
from coop_pin.base.errors import PortTakenError, ViewWarning

_PROCESS = Path(__file__).with_name("live_server_process.py")
_END_S = 1.0
_SHOWN_CHARACTERS = 400
_LAST_PORT = 65535


class LiveServer:
    """Server of one page and its frames, for browsers of this machine that know its address.

    The socket is bound here, to 127.0.0.1 only, and passed to the server process, so the address is known
    before the process has started. Frames go through a non-blocking pipe: a frame that finds it full is
    dropped. The process ends when its end of the pipe is closed, however the sender ended.

    Attributes:
        url: address with a secret, which other users of the machine do not know.
        process: the server process.
    """

    def __init__(self, page: str, *, port: int = 0) -> None:
        """Start the server process.

        Args:
            page: HTML of the page.
            port: port on 127.0.0.1; 0 for any free one.

        Raises:
            PortTakenError: the chosen port is not available.
            OSError: no process, port or temporary file is available.
        """
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 (closed by _end)
        try:
            self.url, self.process = _start(page, port, self._stderr)
        except OSError:
            self._stderr.close()
            raise
        assert self.process.stdin is not None
        self._pipe = self.process.stdin
        os.set_blocking(self._pipe.fileno(), False)
        self._unsent = b""
        self._is_broken = False
        self._end = weakref.finalize(self, _end, self.process, self._pipe, self._stderr)

    @property
    def is_alive(self) -> bool:
        """Whether the process was alive at the last write, and has not been closed."""
        return self._end.alive and not self._is_broken

    def send(self, frame: bytes) -> bool:
        """Send a frame if there is space in the pipe; never block.

        If the process has ended, one warning is issued, and nothing is sent from then on.

        Returns:
            Whether the frame was accepted; its rest may follow with the next one.
        """
        if not self.is_alive:
            return False
        try:
            self._write(self._unsent)
            if self._unsent:
                return False
            self._write(struct.pack("<I", len(frame)) + frame)
        except (BrokenPipeError, ConnectionResetError):
            self._is_broken = True
            text = f"the 3-D view has ended ({self._exit_reason()}); the simulation goes on without it"
            warnings.warn(text, ViewWarning, stacklevel=3)
            return False
        return True

    def close(self) -> None:
        """End the server process and free its port."""
        self._end()

    def _write(self, data: bytes) -> None:
        """Write what the pipe takes, and keep the rest."""
        self._unsent = data
        with contextlib.suppress(BlockingIOError):
            self._unsent = data[os.write(self._pipe.fileno(), data) if data else 0 :]

    def _exit_reason(self) -> str:
        """Return exit code and error output of the process."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(_END_S)
        self._stderr.seek(0)
        output = self._stderr.read()[-_SHOWN_CHARACTERS:].decode(errors="replace").strip()
        return f"its process ended with code {self.process.returncode}" + (f": {output}" if output else "")


def _start(page: str, port: int, stderr: IO[bytes]) -> tuple[str, subprocess.Popen[bytes]]:
    """Return the page's address and the process that serves it."""
    secret = secrets.token_urlsafe(16)
    with _loopback_socket(port) as bound, tempfile.TemporaryFile() as file:
        file.write(page.encode())
        file.flush()
        process = subprocess.Popen(
            [sys.executable, "-P", str(_PROCESS), str(bound.fileno()), str(file.fileno())],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            bufsize=0,
            pass_fds=(bound.fileno(), file.fileno()),
            start_new_session=True,  # Ctrl-C in the terminal must end the run, not its view
        )
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # a process that has ended is reported by the first frame
            process.stdin.write(f"{secret}\n".encode())  # not an argument: any user can read those with ps
        return f"http://127.0.0.1:{bound.getsockname()[1]}/{secret}/", process


def _loopback_socket(port: int) -> socket.socket:
    """Return a listening socket on 127.0.0.1; port 0 for any free one."""
    require_type("port", port, int)
    if not 0 <= port <= _LAST_PORT:
        raise PortTakenError(port, "no port has this number")
    try:
        return socket.create_server(("127.0.0.1", port), backlog=64)
    except OSError as error:
        if port == 0:
            raise
        raise PortTakenError(port, os.strerror(error.errno) if error.errno else str(error)) from error


def _end(process: subprocess.Popen[bytes], pipe: IO[bytes], stderr: IO[bytes]) -> None:
    """End a server process: by the end of the pipe, or by a signal if it hangs."""
    pipe.close()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(_END_S)
    stderr.close()
