"""A page on this machine's loopback, served by a process of its own; the sender is never blocked and never outlived."""

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

from coop_pin.errors import PortTakenError, ViewWarning

_PROCESS = Path(__file__).with_name("view_server_process.py")
_END_S = 1.0
_SHOWN_CHARACTERS = 400
_LAST_PORT = 65535


class ViewServer:
    """Serves one page to browsers of this machine that know its address.

    The socket is bound here, to 127.0.0.1 only, and handed to the server process: the address is known at
    once and nobody waits for the process to start. Frames go through a pipe that never blocks: one that finds
    it full is dropped, and what is shown is always the latest that fitted. The process ends when its end of
    the pipe does, so it outlives nobody, however we die.

    Attributes:
        url: the address, with a secret in it: other users of the machine do not know it.
    """

    def __init__(self, page: str, port: int = 0) -> None:
        """Start the server process.

        Args:
            page: what it serves.
            port: on 127.0.0.1; 0 for any free one.

        Raises:
            PortTakenError: the chosen port cannot be had.
            OSError: there is no process, port or temporary file to be had.
        """
        self._complaints = _nameless_file()
        try:
            self.url, self._process = _start(page, port, self._complaints)
        except OSError:
            self._complaints.close()
            raise
        assert self._process.stdin is not None
        self._pipe = self._process.stdin
        os.set_blocking(self._pipe.fileno(), False)
        self._rest = b""
        self._is_alive = True
        self._end = weakref.finalize(self, _end, self._process, self._pipe, self._complaints)

    @property
    def is_alive(self) -> bool:
        """Whether the server process was there when we last wrote to it, and nobody closed it."""
        return self._is_alive and self._end.alive

    @property
    def pid(self) -> int:
        """The server process."""
        return self._process.pid

    def send(self, frame: bytes) -> bool:
        """Send a frame if the pipe has room for it; never wait.

        A process that is gone is warned of once; from then on nothing is sent.

        Returns:
            Whether it was sent, perhaps with its rest to follow.
        """
        if not self.is_alive:
            return False
        try:
            self._rest = self._rest[self._write(self._rest) :]
            if self._rest:
                return False
            message = struct.pack("<I", len(frame)) + frame
            self._rest = message[self._write(message) :]
        except (BrokenPipeError, ConnectionResetError):
            self._is_alive = False
            warnings.warn(
                f"the 3-D view is gone ({self._why()}); the simulation goes on without it",
                ViewWarning,
                stacklevel=3,
            )
            return False
        return True

    def close(self) -> None:
        """End the server process and give back its port."""
        self._end()

    def _write(self, data: bytes) -> int:
        """Return how much of the data the pipe took."""
        if not data:
            return 0
        try:
            return os.write(self._pipe.fileno(), data)
        except BlockingIOError:
            return 0

    def _why(self) -> str:
        """Say how the process ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self._complaints.seek(0)
        said = self._complaints.read()[-_SHOWN_CHARACTERS:].decode(errors="replace").strip()
        return f"its process ended with code {self._process.returncode}" + (f": {said}" if said else "")


def loopback_socket(port: int) -> socket.socket:
    """Return a listening socket on this machine's loopback.

    Args:
        port: 0 for any free one.

    Raises:
        PortTakenError: the chosen port cannot be had.
        OSError: there is no free one.
    """
    if not 0 <= port <= _LAST_PORT:
        raise PortTakenError(port, "no port has this number")
    try:
        return socket.create_server(("127.0.0.1", port), backlog=64)
    except OSError as error:
        if port == 0:
            raise
        raise PortTakenError(port, os.strerror(error.errno) if error.errno else str(error)) from error


def _start(page: str, port: int, complaints: IO[bytes]) -> tuple[str, subprocess.Popen[bytes]]:
    """Return the page's address and the process that serves it."""
    secret = secrets.token_urlsafe(16)
    with loopback_socket(port) as bound, _nameless_file() as file:
        file.write(page.encode())
        file.flush()
        process = subprocess.Popen(
            [sys.executable, "-P", str(_PROCESS), str(bound.fileno()), str(file.fileno()), secret],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=complaints,
            bufsize=0,
            pass_fds=(bound.fileno(), file.fileno()),
            start_new_session=True,  # Ctrl-C in the terminal is meant for the run, not for its view
        )
        return f"http://127.0.0.1:{bound.getsockname()[1]}/{secret}/", process


def _nameless_file() -> IO[bytes]:
    """Return a file that vanishes with its last owner."""
    return tempfile.TemporaryFile()


def _end(process: subprocess.Popen[bytes], pipe: IO[bytes], complaints: IO[bytes]) -> None:
    """End a server process: the end of the pipe tells it to go, and a signal makes it."""
    pipe.close()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(_END_S)
    complaints.close()
