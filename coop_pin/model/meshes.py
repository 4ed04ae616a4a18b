"""Meshes of COLLADA and Wavefront files, in pieces of one colour.

Pinocchio's reader drops materials, and numbers the triangles of a file's second material by the points of
the first: a link of four colours becomes a tangle of a hundred times its area.
"""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FileReadError
from coop_pin.base.user_files import read_user_file
from coop_pin.description.urdf.meshes import MAX_MESH_BYTES
from coop_pin.model.shapes import Mesh, joined

Colour: TypeAlias = tuple[float, float, float, float]
_Part: TypeAlias = tuple[Array, NDArray[np.int64], Colour]
GREY = (0.9, 0.9, 0.9, 1.0)
"""Colour of meshes that have none, which is Pinocchio's, too."""
SUFFIXES = (".dae", ".obj")
"""Formats whose files hold several materials."""


class MeshFile(NamedTuple):
    """Mesh of a visual.

    Attributes:
        path: the file, of one of ``SUFFIXES``.
        scale: factors of x, y, z.
        is_coloured: True if its colours are those of the file, False if the URDF says one.
    """

    path: Path
    scale: tuple[float, ...]
    is_coloured: bool


@lru_cache(maxsize=256)
def coloured_meshes(path: Path, scale: tuple[float, ...]) -> Sequence[tuple[Mesh, Colour]]:
    """Return the pieces of a file by their colours; none where none of its materials can be read.

    Args:
        path: the file, of one of ``SUFFIXES``.
        scale: factors of x, y, z.

    Raises:
        FileReadError: the file cannot be read.
    """
    try:
        parts = _collada(path) if path.suffix.lower() == ".dae" else _wavefront(path)
    except FileReadError:
        raise
    except Exception as error:  # of readers whose errors have no common base
        raise FileReadError(str(error) or type(error).__name__, str(path)) from error
    pieces: dict[Colour, list[Mesh]] = {}
    for vertices, faces, colour in parts:
        used, faces = np.unique(faces, return_inverse=True)
        pieces.setdefault(colour, []).append(Mesh(vertices[used] * np.array(scale), faces.reshape(-1, 3)))
    return [(joined(meshes), colour) for colour, meshes in pieces.items()]


def colour_of(shares: Iterable[float]) -> Colour:
    """Return red, green, blue and opacity, from 0 to 1."""
    red, green, blue, opacity = map(float, shares)
    return red, green, blue, opacity


def _collada(path: Path) -> list[_Part]:
    """Return points, triangles and colour of every part of a COLLADA file."""
    import collada  # loads pictures and dates, too, of which most runs read nothing

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PendingDeprecationWarning)  # pycollada uses numpy's matrices
        scene = collada.Collada(str(path), ignore=[collada.common.DaeError]).scene
        primitives = [primitive for part in scene.objects("geometry") for primitive in part.primitives()]
        parts = [part.triangleset() if hasattr(part, "triangleset") else part for part in primitives]
    pieces = []
    for triangles in parts:
        if isinstance(triangles, collada.triangleset.BoundTriangleSet):
            diffuse = triangles.material.effect.diffuse if triangles.material else None
            flat = diffuse if isinstance(diffuse, tuple) else GREY  # of a texture, or of none
            colour = colour_of(np.rint(np.multiply(flat, 255)) / 255)
            pieces.append((triangles.vertex, triangles.vertex_index, colour))
    return pieces


_LIBRARY = re.compile(rb"^mtllib[ \t]+(.+?)[ \t\r]*$", re.MULTILINE)


def _wavefront(path: Path) -> list[_Part]:
    """Return points, triangles and colour of every material of a Wavefront file; it gets no textures."""
    import trimesh  # a tenth of a second, only for cells that have such meshes

    content, library = read_user_file(path, limit=MAX_MESH_BYTES, kind="a mesh"), {}
    if (named := _LIBRARY.search(content)) and (file := path.parent / os.fsdecode(named[1])).is_file():
        library[os.fsdecode(named[1])] = read_user_file(file, limit=MAX_MESH_BYTES, kind="materials")
    scene = trimesh.load_scene(io.BytesIO(content), file_type="obj", resolver=library, process=False)
    parts = []
    for mesh in scene.geometry.values():
        if not isinstance(mesh, trimesh.Trimesh):
            continue  # points
        material = getattr(mesh.visual, "material", None) if library else None
        colour = GREY if material is None else colour_of(material.diffuse / 255)
        parts.append((np.asarray(mesh.vertices), np.asarray(mesh.faces), colour))
    return parts
