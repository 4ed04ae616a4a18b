"""Server process of a live view: serves one page on a socket of its parent, and sends frames to all browsers.

Started by ``live_server``, never imported. It imports neither coop_pin nor meshcat: bytes in, bytes out.

    python -P live_server_process.py SOCKET PAGE

SOCKET and PAGE are file descriptors: a bound listening socket, and the page. The first line of stdin is the
secret of the address; frames follow, each after its length (four bytes, little-endian). The process ends with
stdin, which the end of the parent closes; a changed parent process id ends it too, in case another process
still holds the pipe open.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import os
import socket
import struct
import sys
from typing import Any
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

_LOOPBACK = {"127.0.0.1", "localhost"}
_PARENT_CHECK_S = 0.5
_LARGEST_REQUEST = 4096
_MOST_FRAMES = 20_000


class Frames:
    """Frames of the run so far, and a condition that signals the next.

    A frame starts with its time (float32, s). One that is earlier than the last begins a new run. Of a run
    with more than 20000 frames every second one is dropped.
    """

    def __init__(self) -> None:
        self._frames: list[bytes] = []
        self._changed = asyncio.Condition()
        self._count = 0

    async def put(self, frame: bytes) -> None:
        """Add a frame."""
        async with self._changed:
            if self._frames and _time(frame) < _time(self._frames[-1]):
                self._frames.clear()
            if len(self._frames) >= _MOST_FRAMES:
                del self._frames[1::2]
            self._frames.append(frame)
            self._count += 1
            self._changed.notify_all()

    async def after(self, count: int) -> tuple[int, bytes]:
        """Wait for a frame later than the counted one; return its number, and its bytes.

        A browser without frames gets all of the run so far, one after the other; others only the latest.
        """
        async with self._changed:
            await self._changed.wait_for(lambda: self._count > count)
            return self._count, b"".join(self._frames) if count == 0 else self._frames[-1]


def _time(frame: bytes) -> float:
    return float(struct.unpack_from("<f", frame)[0])


class Guarded(RequestHandler):
    """Handler of requests that are for a loopback name and have the secret.

    The host is checked because a foreign page can resolve its own name to 127.0.0.1 (DNS rebinding).
    """

    def initialize(self, page: bytes, frames: Frames, secret: str) -> None:
        """Store what all handlers share."""
        self.page, self.frames, self.secret = page, frames, secret

    def prepare(self) -> None:
        """Refuse foreign hosts and origins, and requests without the secret.

        Raises:
            HTTPError: 403 or 404.
        """
        origin = self.request.headers.get("Origin")
        if urlsplit(f"//{self.request.host}").hostname not in _LOOPBACK or (
            origin and urlsplit(origin).netloc != self.request.host
        ):
            raise HTTPError(403)
        if not hmac.compare_digest(self.request.path.split("/")[1].encode(), self.secret.encode()):
            raise HTTPError(404)

    def set_default_headers(self) -> None:
        """Forbid caching, content sniffing and passing the secret address on as a referrer."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")


class Page(Guarded):
    """Handler of the page."""

    def get(self) -> None:
        """Send the page."""
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.write(self.page)


class Stream(Guarded, WebSocketHandler):
    """WebSocket of the frames; a slow browser gets fewer of them and delays no other."""

    async def open(self, *_: str, **__: str) -> None:
        """Send frames until the connection is closed."""
        asyncio.get_running_loop().create_task(self._send())

    def on_message(self, message: str | bytes) -> None:
        """Ignore messages of the browser."""

    async def _send(self) -> None:
        count = 0
        try:
            while True:
                count, frame = await self.frames.after(count)
                await self.write_message(frame, binary=True)
        except (WebSocketClosedError, StreamClosedError):
            return


async def read_frames(frames: Frames) -> None:
    """Read frames from stdin until it ends."""
    reader = asyncio.StreamReader(limit=1 << 20)
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), sys.stdin.buffer
    )
    try:
        while True:
            (length,) = struct.unpack("<I", await reader.readexactly(4))
            await frames.put(await reader.readexactly(length))
    except asyncio.IncompleteReadError:
        return


async def watch_parent(parent: int) -> None:
    """Return when the parent process has ended."""
    while os.getppid() == parent:
        await asyncio.sleep(_PARENT_CHECK_S)


async def serve(listening: int, page: int, secret: str) -> None:
    """Serve until the parent process has ended."""
    parent, frames = os.getppid(), Frames()
    with os.fdopen(page, "rb") as file:
        file.seek(0)
        shared: dict[str, Any] = {"page": file.read(), "frames": frames, "secret": secret}
    server = HTTPServer(
        Application(
            [(r"/[^/]*/", Page, shared), (r"/[^/]*/frames", Stream, shared)],
            websocket_max_message_size=_LARGEST_REQUEST,
            websocket_ping_interval=20,
            websocket_ping_timeout=20,
        ),
        max_body_size=_LARGEST_REQUEST,
        max_header_size=_LARGEST_REQUEST * 4,
        idle_connection_timeout=60,
        body_timeout=10,
    )
    with socket.socket(fileno=listening) as bound:
        bound.setblocking(False)
        server.add_socket(bound)
        watchers = [asyncio.create_task(read_frames(frames)), asyncio.create_task(watch_parent(parent))]
        await asyncio.wait(watchers, return_when=asyncio.FIRST_COMPLETED)


if __name__ == "__main__":
    logging.disable(logging.ERROR)  # refused requests must not fill the parent's log
    with open(sys.stdin.fileno(), "rb", buffering=0, closefd=False) as unbuffered:
        secret = unbuffered.readline().decode().rstrip()  # byte by byte, so that no frame is swallowed
    if secret:  # else the parent has ended
        asyncio.run(serve(int(sys.argv[1]), int(sys.argv[2]), secret))
    os._exit(0)  # nothing needs to be cleaned up
