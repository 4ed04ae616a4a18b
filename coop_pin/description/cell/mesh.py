"""Mesh files of payloads: read as bytes with a bound on their size, and refused where they are damaged."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.base.errors import FieldError
from coop_pin.base.user_files import read_user_file
from coop_pin.description.urdf.meshes import MAX_MESH_BYTES


def read_mesh(path: Path) -> Any:
    """Return the trimesh.Trimesh of a file, its parts joined into one.

    Raises:
        FieldError: the file cannot be read, or unpacks to more than 100 MB.
    """
    import trimesh  # a tenth of a second, only for payloads that are meshes

    if not os.path.lexists(path):
        raise FieldError(f"there is no mesh at {path}", "mesh_file")
    try:
        # As bytes: a mesh that names further files does not get them.
        content = read_user_file(path, limit=MAX_MESH_BYTES, kind="a mesh")
        mesh = trimesh.load(io.BytesIO(content), file_type=path.suffix[1:].lower(), force="mesh")
    except Exception as error:  # the readers of many formats have no common base of their errors
        alone = "; one file must hold it all: save it as .glb" if path.suffix.lower() == ".gltf" else ""
        raise FieldError(f"{path} cannot be read as a mesh: {error}{alone}", "mesh_file") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise FieldError(f"{path} holds no triangles", "mesh_file")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices) or not np.isfinite(mesh.vertices).all():
        raise FieldError(f"{path} is damaged: a triangle has a corner that is no finite point", "mesh_file")
    return mesh


def closed_mesh(path: Path) -> Any:
    """Return the trimesh.Trimesh of a file whose surface encloses a volume, its triangles facing outwards.

    Raises:
        FieldError: the file cannot be read as a mesh, or its surface is open.
    """
    mesh = read_mesh(path)
    mesh.merge_vertices()
    if not mesh.is_watertight:
        raise FieldError(
            f"{path} is open: it encloses no volume. Close its holes, or give mass and inertia yourself",
            "mesh_file",
        )
    if mesh.volume < 0.0:
        mesh.invert()  # the triangles look inwards
    return mesh
