"""What a live view shows at one moment."""

from __future__ import annotations

import json
import struct
from typing import NamedTuple

from coop_pin.arrays import Array


class LiveFrame(NamedTuple):
    """A moment of a run as values that any viewer can show.

    Attributes:
        time: s.
        position_error: distance of the payload from where it should be, m.
        orientation_error: angle, rad.
        internal: largest internal force of all arms, N.
        desired_internal: what it should be, N.
        tints: code of every body's colour, in the order of the scene's bodies; see ``tints``.
        rows: position (m), quaternion x, y, z, w and scale of every node, in the order of the scene's nodes, shape (nodes, 10).
    """

    time: float
    position_error: float
    orientation_error: float
    internal: float
    desired_internal: float
    tints: tuple[int, ...]
    rows: Array

    def packed(self) -> bytes:
        """Return the frame as the page reads it: the length of a JSON text, the text, and a row of float32 for each node."""
        told = self._asdict()
        del told["rows"]
        text = json.dumps(told).encode()
        text += b" " * (-len(text) % 4)  # the numbers after it start at a multiple of four
        return struct.pack("<I", len(text)) + text + self.rows.astype("<f4").tobytes()
