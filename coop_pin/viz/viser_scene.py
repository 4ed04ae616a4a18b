"""A live scene in viser: the items drawn once on viser's nodes, and frames that move the nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.model.shapes import Box, Cylinder, Mesh, Sphere
from coop_pin.viz import palette
from coop_pin.viz.cell_scene import TRAIL_RADIUS_M
from coop_pin.viz.live_frame import LiveFrame
from coop_pin.viz.live_scene import LiveScene
from coop_pin.viz.meshes import cone_mesh
from coop_pin.viz.scene import Cone, Item, Segments
from coop_pin.viz.tints import COLOURS, IS_PLAIN
from coop_pin.viz.trail import Trail
from coop_pin.viz.viewer import FrameRate

TRAIL_NODE = "/trails/actual"
_LINE_M = 0.004
_TRAILS_PER_SECOND = 5.0
"""A trail is sent whole, so not with every frame."""


class ViserScene:
    """Draws a live scene through viser's scene interface.

    viser scales a node's own geometry and not what hangs on it; so the scale of an arrow's parts is put on the shapes that hang on them.
    """

    def __init__(self, api: Any, live: LiveScene) -> None:
        """Draw everything once.

        Args:
            api: viser's ``ViserServer.scene``.
            live: what to draw.
        """
        self._api, self._live = api, live
        self._nodes = [api.add_frame(f"/{path}", show_axes=False) for path in live.nodes]
        self._drawn = [(item, _draw(api, item)) for item in live.scene.items]
        self._rows = np.full((len(live.nodes), 10), np.nan)
        self._tints = (IS_PLAIN,) * len(live.bodies)
        self._trail, self._trail_rate = Trail(), FrameRate(_TRAILS_PER_SECOND)

    def show(self, frame: LiveFrame) -> None:
        """Move the nodes and tint the bodies of which something has changed."""
        for index in np.flatnonzero((frame.rows != self._rows).any(axis=1)):
            row, node = frame.rows[index], self._nodes[index]
            node.position, node.wxyz = row[:3], np.roll(row[3:7], 1)
            if not np.array_equal(row[7:], self._rows[index, 7:]):
                self._scale(self._live.nodes[index], row[7:])
        self._rows = frame.rows.copy()
        for path, code, before in zip(self._live.bodies, frame.tints, self._tints, strict=True):
            if code != before:
                self._tint(path, code)
        self._tints = frame.tints
        self._trail.follow(frame.time, frame.rows[self._live.nodes.index("payload"), :3])
        if self._trail_rate.is_due():
            self._draw_trail()

    def _on(self, path: str) -> list[tuple[Item, Any]]:
        """Return what is drawn on a node."""
        return [(item, handle) for item, handle in self._drawn if item.path.rpartition("/")[0] == path]

    def _scale(self, path: str, scale: Array) -> None:
        for item, handle in self._on(path):
            handle.scale, handle.position = tuple(map(float, scale)), scale * item.pose[:3, 3]

    def _tint(self, path: str, code: int) -> None:
        for item, handle in self._on(path):
            handle.color = _bytes(COLOURS[code] or item.paint.colour)

    def _draw_trail(self) -> None:
        segments = self._trail.segments()
        self._api.add_line_segments(
            TRAIL_NODE, segments, _bytes(palette.rgb(palette.ACTUAL)), thickness=2.0 * TRAIL_RADIUS_M, visible=len(segments) > 0
        )


def _draw(api: Any, item: Item) -> Any:
    """Draw an item and return its handle."""
    paint, name = item.paint, f"/{item.path}"
    place = {"position": item.pose[:3, 3], "wxyz": np.roll(Rotation.from_matrix(item.pose[:3, :3]).as_quat(), 1)}
    if isinstance(item.drawable, Segments):
        points, colours = (part.reshape(-1, 2, 3) for part in item.drawable)
        return api.add_line_segments(name, points, colours, thickness=_LINE_M, **place)
    look = {"color": _bytes(paint.colour), "opacity": None if paint.opacity == 1.0 else paint.opacity, "side": "double", **place}
    look |= {"cast_shadow": False, "receive_shadow": False}  # viser's reach only part of the floor, with an edge
    match item.drawable:
        case Box(size):
            return api.add_box(name, dimensions=size, **look)
        case Cylinder(radius, length):
            return api.add_cylinder(name, radius, length, **look)
        case Sphere(radius):
            return api.add_icosphere(name, radius, **look)
        case Cone(radius, length):
            return _draw_mesh(api, name, cone_mesh(radius, length), look)
        case Mesh():
            return _draw_mesh(api, name, item.drawable, look)


def _draw_mesh(api: Any, name: str, mesh: Mesh, look: dict[str, Any]) -> Any:
    return api.add_mesh_simple(name, mesh.vertices, mesh.faces, flat_shading=True, **look)


def _bytes(colour: tuple[float, float, float]) -> tuple[int, int, int]:
    """Return red, green and blue from 0 to 255."""
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue
