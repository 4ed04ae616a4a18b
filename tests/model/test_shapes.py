"""Shapes that are drawn: extents by hand, and the shape of a payload."""

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from close import assert_close

from coop_pin.base.errors import UrdfWarning
from coop_pin.description.cell.payload import Payload
from coop_pin.model.shapes import Box, Cylinder, Mesh, Sphere, half_extents, payload_shape, shape_of

CORNERS = np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, -0.2, 0.0), (0.0, 0.0, 0.3)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])


@pytest.mark.parametrize(
    ("shape", "extents"),
    [
        (Box((0.2, 0.4, 0.6)), (0.1, 0.2, 0.3)),
        (Cylinder(0.2, 1.0), (0.2, 0.2, 0.5)),
        (Sphere(0.3), (0.3, 0.3, 0.3)),
        (Mesh(CORNERS, FACES), (0.1, 0.2, 0.3)),
    ],
)
def test_half_extents(shape, extents):
    assert_close(half_extents(shape), extents, atol=1e-15)


@pytest.mark.parametrize(
    ("drawn", "shape"),
    [
        ('<box size="0.2 0.4 0.6"/>', Box((0.2, 0.4, 0.6))),
        ('<cylinder radius="0.2" length="0.7"/>', Cylinder(0.2, 0.7)),
        ('<sphere radius="0.3"/>', Sphere(0.3)),
    ],
)
def test_the_shape_of_a_geometry_of_pinocchio_has_the_sizes_of_the_urdf(drawn, shape):
    text = f'<robot name="r"><link name="l"><visual><geometry>{drawn}</geometry></visual></link></robot>'
    model = pin.buildModelFromXML(text)
    geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL).geometryObjects[0].geometry
    assert shape_of(geometry) == shape
    assert shape_of(None) is None


def test_the_shape_of_a_payload():
    assert payload_shape(Payload.box(1.0, (0.2, 0.4, 0.6))) == Box((0.2, 0.4, 0.6))
    assert payload_shape(Payload.box(1.0, (0.2, 0.4, 0.6)), scale=2.0) == Box((0.4, 0.8, 1.2))
    assert payload_shape(Payload.cylinder(1.0, 0.2, 0.7)) == Cylinder(0.2, 0.7)
    assert payload_shape(Payload.cylinder(1.0, 0.25, 0.5), scale=2.0) == Cylinder(0.5, 1.0)


def test_a_mesh_payload_is_drawn_in_metres(tmp_path):
    path = tmp_path / "millimetres.obj"
    trimesh.Trimesh(1000.0 * CORNERS, FACES, process=False).export(path)
    payload = Payload(
        mass=1.0, inertia=(1, 1, 1, 0, 0, 0), shape="mesh", mesh_file=str(path), mesh_scale=1e-3
    )
    shape = payload_shape(payload, scale=2.0)
    assert isinstance(shape, Mesh)
    assert_close(np.sort(shape.vertices, axis=0), np.sort(2.0 * CORNERS, axis=0), atol=1e-9)
    assert len(shape.faces) == len(FACES)


def test_a_mesh_that_cannot_be_read_is_drawn_as_a_box_and_warned_of(tmp_path):
    size, missing = (0.1, 0.2, 0.3), str(tmp_path / "no.stl")
    payload = Payload(mass=1.0, inertia=(1, 1, 1, 0, 0, 0), size=size, shape="mesh", mesh_file=missing)
    with pytest.warns(UrdfWarning, match=r"no\.stl"):
        assert payload_shape(payload) == Box((0.1, 0.2, 0.3))
