"""What stands for a payload in pictures."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from coop_pin.description.mesh import read_mesh
from coop_pin.description.payload import Payload
from coop_pin.errors import GeometryWarning, MeshError
from coop_pin.model.shapes import Box, Cylinder, Mesh, Shape


def payload_shape(payload: Payload, scale: float = 1.0) -> Shape:
    """Return the shape of a payload, centred at its ``shape_pose``; its box where the mesh cannot be read any more.

    Args:
        payload: the description.
        scale: factor of its size.
    """
    x, y, z = (scale * edge for edge in payload.size)
    if payload.shape == "cylinder":
        return Cylinder(x / 2.0, z)
    if payload.shape == "mesh":
        try:
            mesh = read_mesh(Path(payload.mesh_file))
        except MeshError as error:
            warnings.warn(f"the payload is drawn as a box: {error}", GeometryWarning, stacklevel=2)
        else:
            return Mesh(scale * payload.mesh_scale * np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64))
    return Box((x, y, z))
