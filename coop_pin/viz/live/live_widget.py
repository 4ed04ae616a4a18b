"""Live page in a notebook: an anywidget whose messages go through the notebook's own kernel.

To the page: frames (bytes) and changes. From it: "hello", when it is ready, and "push", when a person has
dragged the payload. It needs neither a port nor a proxy.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from anywidget import AnyWidget
from traitlets import Int, List, Unicode

from coop_pin.base.arrays import Array
from coop_pin.viz.page import web_file

_MOST_BYTES = 600_000
"""Frames of a run that a page gets which opens on the way; a Jupyter server drops messages over 3 MB."""


class LiveWidget(AnyWidget):
    """Live page of a simulation under way.

    Attributes:
        page: HTML of the page.
        height: pixels.
        changes: list of the changes of the run: "start" and "end", s, and "text".
        on_push: function of a point on the payload, m, and a force on it, N, in world axes; None where pushes
            are ignored.
    """

    _esm = web_file("widget.js")
    page = Unicode().tag(sync=True)
    height = Int().tag(sync=True)
    changes: List[dict[str, Any]] = List().tag(sync=True)

    def __init__(self, page: str, height: int) -> None:
        """Build the widget.

        Args:
            page: HTML of the page.
            height: pixels.
        """
        super().__init__(page=page, height=height, layout={"width": "100%"})
        self.on_push: Callable[[Array, Array], None] | None = None
        self._frames, self._lock = list[bytes](), threading.Lock()
        self.on_msg(self._receive)

    def show(self, frame: bytes) -> None:
        """Send a frame, whose first number is its time; one earlier than the last begins a new run."""
        with self._lock:
            if self._frames and _time(frame) < _time(self._frames[-1]):
                self._frames.clear()
            self._frames.append(frame)
            while len(self._frames) * len(frame) > _MOST_BYTES:
                del self._frames[1:-1:2]
            self.send({"kind": "frames", "to": ""}, [frame])

    def _receive(self, _: AnyWidget, message: Any, buffers: Any) -> None:
        """Answer a page; what it does not send is ignored."""
        if not isinstance(message, Mapping):
            return
        if message.get("kind") == "hello":
            with self._lock:  # no frame between these and the next
                self.send({"kind": "frames", "to": str(message.get("view"))}, [b"".join(self._frames)])
        if message.get("kind") == "push" and self.on_push is not None:
            point, force = _vector(message.get("point")), _vector(message.get("force"))
            if point is not None and force is not None:
                self.on_push(point, force)


def _time(frame: bytes) -> float:
    return float(np.frombuffer(frame, "<f4", count=1)[0])


def _vector(value: Any) -> Array | None:
    """Return three finite numbers as an array; None of anything else."""
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return None
    return vector if vector.shape == (3,) and np.isfinite(vector).all() else None
