"""The one door to meshcat: a scene as the commands that its viewer page understands, without a server, a process or a port.

What is worked around here: meshcat 0.3.2 names objects by the machine's network address and the time (uuid1),
turns property names to lower case, and writes every keyframe as a table of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import meshcat
import numpy as np
import umsgpack
from meshcat import animation, geometry
from meshcat.commands import SetAnimation, SetObject

from coop_pin.arrays import Array
from coop_pin.model.shapes import Box, Cylinder, Mesh, Sphere
from coop_pin.viz.scene import Camera, Cone, Item, Scene, Segments, Track, translation

_FLOAT32 = 0x17
"""The msgpack extension that the viewer reads as a Float32Array."""

_HOLD = 2300
"""three.js: InterpolateDiscrete."""

_Y_TO_Z = np.array(((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
"""three.js stands cylinders along y, we along z."""


class MemoryWindow:
    """What meshcat takes for a connection to its server: keeps the commands instead of sending them.

    Attributes:
        messages: the commands, packed as for the wire.
    """

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def send(self, command: Any) -> None:
        """Keep a command."""
        self.messages.append(umsgpack.packb(command.lower(), force_float_precision="single"))


class ObjectProperty(NamedTuple):
    """A property of a node's own object; meshcat's SetProperty would write "castshadow".

    Attributes:
        path: of the node.
        name: of the property.
        value: what it becomes.
    """

    path: Any
    name: str
    value: Any

    def lower(self) -> dict[str, Any]:
        """Return the command as meshcat's viewer reads it."""
        return {
            "type": "set_property",
            "path": f"{self.path.lower()}/<object>",
            "property": self.name,
            "value": self.value,
        }


class _Keyframes(NamedTuple):
    """An animation track whose numbers stand in two typed arrays."""

    name: str
    kind: str
    time: Array
    values: Array
    held: bool

    def lower(self) -> dict[str, Any]:
        track = {
            "name": f".{self.name}",
            "type": self.kind,
            "times": _float32(self.time),
            "values": _float32(self.values),
        }
        return {**track, "interpolation": _HOLD} if self.held else track


def viewer_script() -> str:
    """Return meshcat's viewer, a script that needs nothing else."""
    return _viewer_file("main.min.js")


def viewer_licences() -> str:
    """Return the licence texts that go with the viewer's script."""
    return _viewer_file("main.min.js.LICENSE.txt")


def scene_messages(scene: Scene) -> list[bytes]:
    """Return the commands that draw and animate a scene, in order."""
    window = MemoryWindow()
    root = meshcat.Visualizer(window=window)
    names = (f"coop-pin-{number}" for number in itertools.count())
    for item in scene.items:
        _draw(root[item.path], item, names)
    _look(root, scene.camera)
    if scene.tracks:
        clips = {root[track.path].path: _clip(track, scene.time) for track in scene.tracks}
        window.send(SetAnimation(animation.Animation(clips=clips)))
    return window.messages


def _draw(node: Any, item: Item, names: Iterator[str]) -> None:
    shape, material = _geometry(item), _material(item)
    shape.uuid, material.uuid = next(names), next(names)
    kind = geometry.LineSegments if isinstance(item.drawable, Segments) else geometry.Mesh
    drawn = kind(shape, material)
    drawn.uuid = next(names)
    node.window.send(SetObject(drawn, path=node.path))
    upright = isinstance(item.drawable, Cylinder | Cone)
    node.set_transform(item.pose @ _Y_TO_Z if upright else item.pose)
    if item.paint.opacity < 1.0 or item.paint.on_top or not item.paint.lit:
        node.window.send(ObjectProperty(node.path, "castShadow", False))
        node.window.send(ObjectProperty(node.path, "receiveShadow", False))


def _geometry(item: Item) -> Any:
    match item.drawable:
        case Box(size):
            return geometry.Box(list(size))
        case Cylinder(radius, length):
            return geometry.Cylinder(length, radius)
        case Sphere(radius):
            return geometry.Sphere(radius)
        case Mesh(vertices, faces):
            return geometry.TriangularMeshGeometry(vertices, faces)
        case Cone(radius, length):
            return _ConeGeometry(length, radius)
        case Segments(points, colours):
            return geometry.PointsGeometry(points.T.astype(np.float32), colours.T.astype(np.float32))


class _ConeGeometry(geometry.Cylinder):  # type: ignore[misc]
    """A cylinder that ends in a point and stands on the origin instead of around it."""

    def __init__(self, length: float, radius: float) -> None:
        super().__init__(length, radiusTop=0.0, radiusBottom=radius)

    def intrinsic_transform(self) -> Array:
        lifted = np.eye(4)
        lifted[3, 1] = (
            self.height / 2.0
        )  # three.js reads columns first, and meshcat does not turn this matrix over
        return lifted


def _material(item: Item) -> Any:
    paint = item.paint
    red, green, blue = (round(255 * part) for part in paint.colour)
    colour = (red << 16) + (green << 8) + blue
    over: dict[str, Any] = {"depthTest": False, "depthWrite": False} if paint.on_top else {}
    if isinstance(item.drawable, Mesh):
        over["flatShading"] = True  # merged vertices have no normals worth smoothing
    if isinstance(item.drawable, Segments):
        return geometry.LineBasicMaterial(vertexColors=True, transparent=paint.on_top, **over)
    kind = geometry.MeshPhongMaterial if paint.lit else geometry.MeshBasicMaterial
    # Transparent things are drawn last; with their back sides left out, convex ones need no depth to look
    # right.
    return kind(
        color=colour,
        opacity=paint.opacity,
        transparent=paint.on_top or paint.opacity < 1.0,
        side=0 if paint.on_top else 2,
        **over,
    )


def _look(root: Any, camera: Camera) -> None:
    """Place the camera, in its own axes, where y is up.

    meshcat's camera looks at the world's origin wherever it stands, so the whole scene is moved until its
    target is there.
    """
    root.set_transform(translation(-camera.target))
    x, y, z = (float(part) for part in camera.eye - camera.target)
    rotated = root["/Cameras/default/rotated"].path
    root.window.send(ObjectProperty(rotated, "fov", camera.field_of_view))
    root.window.send(ObjectProperty(rotated, "position", [x, z, -y]))


def _clip(track: Track, time: Array) -> Any:
    parts = (
        ("position", "vector3", track.position),
        ("quaternion", "quaternion", track.quaternion),
        ("scale", "vector3", track.scale),
    )
    tracks = {
        name: _Keyframes(name, kind, time, values, track.held)
        for name, kind, values in parts
        if values is not None
    }
    return animation.AnimationClip(tracks=tracks, fps=1)  # one frame a second: the times are seconds


def _float32(values: Array) -> Any:
    return umsgpack.Ext(_FLOAT32, np.ascontiguousarray(values, dtype="<f4").tobytes())


def _viewer_file(name: str) -> str:
    return Path(meshcat.viewer_assets_path(), "dist", name).read_text(encoding="utf-8")
