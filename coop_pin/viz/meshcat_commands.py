"""Meshcat commands: a scene translated for meshcat's viewer page, without meshcat's server.

Three properties of meshcat 0.3.2 are worked around: it names objects by network address and time (uuid1), it
turns property names to lower case, and it writes each keyframe as a dictionary of its own.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import meshcat
import numpy as np
import umsgpack
from meshcat import geometry
from meshcat.commands import SetObject

from coop_pin.arrays import Array
from coop_pin.model.shapes import Box, Cylinder, Mesh, Sphere
from coop_pin.viz.scene import Camera, Cone, Item, Scene, Segments, Track, translation

_FLOAT32 = 0x17
"""The msgpack extension that the viewer reads as a Float32Array."""

_HOLD = 2300
"""three.js: InterpolateDiscrete."""

_Y_TO_Z = np.array(((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
"""Cylinders lie along y in three.js, and along z here."""


class CommandRecorder:
    """Stand-in for meshcat's connection to its server: records the commands instead of sending them.

    Attributes:
        messages: recorded commands, packed with msgpack.
    """

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def send(self, command: Any) -> None:
        """Record a meshcat command."""
        self.record(command.lower())

    def record(self, command: dict[str, Any]) -> None:
        """Record a command that is a dictionary already."""
        self.messages.append(umsgpack.packb(command, force_float_precision="single"))

    def set_property(self, node: Any, name: str, value: Any) -> None:
        """Record a property of a node's object; meshcat's SetProperty would write "castshadow"."""
        path = f"{node.path.lower()}/<object>"
        self.record({"type": "set_property", "path": path, "property": name, "value": value})


def viewer_file(name: str) -> str:
    """Return a file of meshcat's viewer, a script that needs nothing else."""
    return Path(meshcat.viewer_assets_path(), "dist", name).read_text(encoding="utf-8")


def scene_messages(scene: Scene) -> list[bytes]:
    """Return the packed commands that draw and animate a scene, in order."""
    recorder = CommandRecorder()
    root, names = meshcat.Visualizer(window=recorder), (f"coop-pin-{number}" for number in itertools.count())
    for item in scene.items:
        node, shape, material = root[item.path], _geometry(item), _material(item)
        kind = geometry.LineSegments if isinstance(item.drawable, Segments) else geometry.Mesh
        drawn = kind(shape, material)
        shape.uuid, material.uuid, drawn.uuid = next(names), next(names), next(names)
        recorder.send(SetObject(drawn, path=node.path))
        node.set_transform(item.pose @ _Y_TO_Z if isinstance(item.drawable, Cylinder | Cone) else item.pose)
        if item.paint.opacity < 1.0 or item.paint.on_top or not item.paint.lit:
            recorder.set_property(node, "castShadow", value=False)
            recorder.set_property(node, "receiveShadow", value=False)
    _set_camera(root, recorder, scene.camera)
    if scene.tracks:
        animations = [
            {"path": root[track.path].path.lower(), "clip": _clip(track, scene.time)}
            for track in scene.tracks
        ]
        options = {"play": True, "repetitions": 1}
        recorder.record({"type": "set_animation", "animations": animations, "options": options, "path": ""})
    return recorder.messages


def _geometry(item: Item) -> Any:
    """Return meshcat's geometry of a drawable."""
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
    """Cylinder with a top of radius zero, whose base is at the origin."""

    def __init__(self, length: float, radius: float) -> None:
        super().__init__(length, radiusTop=0.0, radiusBottom=radius)

    def intrinsic_transform(self) -> Array:
        # three.js reads matrices by columns, and meshcat does not transpose this one.
        return translation((0.0, self.height / 2.0, 0.0)).T


def _material(item: Item) -> Any:
    """Return meshcat's material of a drawable."""
    paint = item.paint
    red, green, blue = (round(255 * part) for part in paint.colour)
    options: dict[str, Any] = {"depthTest": False, "depthWrite": False} if paint.on_top else {}
    if isinstance(item.drawable, Mesh):
        options["flatShading"] = True  # normals of merged vertices are not worth smoothing
    if isinstance(item.drawable, Segments):
        return geometry.LineBasicMaterial(vertexColors=True, transparent=paint.on_top, **options)
    kind = geometry.MeshPhongMaterial if paint.lit else geometry.MeshBasicMaterial
    # Transparent objects are drawn last; convex ones without their back sides need no depth test.
    return kind(
        color=(red << 16) + (green << 8) + blue,
        opacity=paint.opacity,
        transparent=paint.on_top or paint.opacity < 1.0,
        side=0 if paint.on_top else 2,
        **options,
    )


def _set_camera(root: Any, recorder: CommandRecorder, camera: Camera) -> None:
    """Place the camera, in its own axes, where y is up.

    meshcat's camera always looks at the world's origin, so the whole scene is shifted to bring the target
    there.
    """
    root.set_transform(translation(-camera.target))
    x, y, z = (float(part) for part in camera.eye - camera.target)
    rotated = root["/Cameras/default/rotated"]
    recorder.set_property(rotated, "fov", camera.field_of_view)
    recorder.set_property(rotated, "position", [x, z, -y])


def _clip(track: Track, time: Array) -> dict[str, Any]:
    """Return the animation clip of a track, its numbers in typed arrays."""
    parts = (
        ("position", "vector3", track.position),
        ("quaternion", "quaternion", track.quaternion),
        ("scale", "vector3", track.scale),
    )
    held = {"interpolation": _HOLD} if track.held else {}
    tracks = [
        {"name": f".{name}", "type": kind, "times": _float32(time), "values": _float32(values), **held}
        for name, kind, values in parts
        if values is not None
    ]
    return {"fps": 1, "name": "default", "tracks": tracks}  # one frame per second: times are in seconds


def _float32(values: Array) -> Any:
    return umsgpack.Ext(_FLOAT32, np.ascontiguousarray(values, dtype="<f4").tobytes())
