"""The process behind a live view: serves one page on a listening socket of its parent, and hands frames on to whoever looks.

Started by ``view_server``, never imported. It knows neither coop_pin nor meshcat: bytes in, bytes out.

    python -P view_server_process.py SOCKET PAGE SECRET

SOCKET and PAGE are file descriptors: a bound listening socket and the page. Frames come through stdin, each
after its length (four bytes, little-endian). The end of stdin is the end of the parent, however it died; a
changed parent process says the same where somebody else still holds the pipe.
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


class Frames:
    """The latest frame, and who waits for the next; nobody ever gets an old one."""

    def __init__(self) -> None:
        self.latest: bytes | None = None
        self._changed = asyncio.Condition()
        self._count = 0

    async def put(self, frame: bytes) -> None:
        """Replace the frame."""
        async with self._changed:
            self.latest = frame
            self._count += 1
            self._changed.notify_all()

    async def after(self, count: int) -> tuple[int, bytes]:
        """Return the number and the bytes of a frame later than the counted one, as soon as there is one."""
        async with self._changed:
            await self._changed.wait_for(lambda: self._count > count)
            assert self.latest is not None
            return self._count, self.latest


class Guarded(RequestHandler):
    """Answers only to loopback names (a foreign page may lead its own name to 127.0.0.1) and to those who know the secret."""

    def initialize(self, page: bytes, frames: Frames, secret: str) -> None:
        """Take over what all handlers share."""
        self.page, self.frames, self.secret = page, frames, secret

    def prepare(self) -> None:
        """Refuse foreign hosts and origins, and whoever does not know the secret.

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
        """Let browsers guess nothing, keep nothing, and tell nobody the secret address."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")


class Page(Guarded):
    """Serves the page."""

    def get(self) -> None:
        """Answer with the page."""
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.write(self.page)


class Stream(Guarded, WebSocketHandler):
    """Sends frames; a slow browser gets fewer of them and holds up nobody."""

    def check_origin(self, origin: str) -> bool:
        """Accept the page itself; ``prepare`` has refused all others."""
        return bool(urlsplit(origin).netloc == self.request.host)

    async def open(self, *_: str, **__: str) -> None:
        """Send frames for as long as somebody looks."""
        asyncio.get_running_loop().create_task(self._send())

    def on_message(self, message: str | bytes) -> None:
        """Ignore what is said: a view only shows."""

    async def _send(self) -> None:
        count = 0
        try:
            while True:
                count, frame = await self.frames.after(count)
                await self.write_message(frame, binary=True)
        except (WebSocketClosedError, StreamClosedError):
            return


async def read_frames(frames: Frames) -> None:
    """Take frames from stdin until it ends."""
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
    """Return when the parent is gone."""
    while os.getppid() == parent:
        await asyncio.sleep(_PARENT_CHECK_S)


async def serve(listening: int, page: int, secret: str) -> None:
    """Serve until the parent is gone."""
    parent, frames = os.getppid(), Frames()
    with os.fdopen(page, "rb") as file:
        file.seek(0)
        shared: dict[str, Any] = {"page": file.read(), "frames": frames, "secret": secret}
    routes = [(r"/[^/]*/", Page, shared), (r"/[^/]*/frames", Stream, shared)]
    server = HTTPServer(
        Application(
            routes,
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
    logging.disable(logging.ERROR)  # strangers must not fill the parent's log
    asyncio.run(serve(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]))
    os._exit(0)  # nothing of ours is worth waiting for
