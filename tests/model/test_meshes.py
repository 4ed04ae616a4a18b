"""Meshes of several materials: points, areas and colours by hand, of the same solids in both formats."""

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from close import assert_close

import coop_pin as cp
from coop_pin.base.errors import FileReadError, UrdfWarning
from coop_pin.model.meshes import GREY, coloured_meshes
from coop_pin.model.visuals import CellVisuals

MATERIALS = """newmtl white
Kd 1.0 1.0 1.0
newmtl blue
Kd 0.0 0.2 1.0
"""
BLUE = (0.0, 0.2, 1.0, 1.0)
EDGES = {"white": (0.2, 0.4, 0.6), "blue": (0.1, 0.1, 0.1)}
CENTRES = {"white": (0.0, 0.0, 0.0), "blue": (1.0, 0.0, 0.0)}


def quads(first):
    """The faces of a box whose corners count 0 to 7 in binary, x first, from a number on."""
    sides = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    return "".join("f " + " ".join(str(first + corner) for corner in side) + "\n" for side in sides)


def wavefront(folder, library=MATERIALS):
    """Two boxes of squares, each of a material; the first corner of the second is the ninth of the file."""
    text = "mtllib a.mtl\n"
    for name, edges in EDGES.items():
        signs = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)]) - 0.5
        points = CENTRES[name] + signs * edges
        text += "".join("v " + " ".join(f"{value:.17g}" for value in point) + "\n" for point in points)
    text += "".join(f"usemtl {name}\n{quads(1 + 8 * k)}" for k, name in enumerate(EDGES))
    (folder / "a.obj").write_text(text)
    if library is not None:
        (folder / "a.mtl").write_text(library)
    return folder / "a.obj"


def collada(folder):
    """The same boxes, as one mesh of two materials."""
    boxes = [
        trimesh.creation.box(EDGES[name], trimesh.transformations.translation_matrix(CENTRES[name]))
        for name in EDGES
    ]
    points = np.concatenate([box.vertices for box in boxes]).ravel()
    triangles = [box.faces + 8 * k for k, box in enumerate(boxes)]
    colours = {"white": "1 1 1 1", "blue": "0 0.2 1 1"}
    effects = "".join(
        f'<effect id="e{name}"><profile_COMMON><technique sid="common"><lambert><diffuse><color>{colour}'
        "</color></diffuse></lambert></technique></profile_COMMON></effect>"
        for name, colour in colours.items()
    )
    parts = "".join(
        f'<triangles count="12" material="s{name}"><input semantic="VERTEX" source="#v" offset="0"/>'
        f"<p>{' '.join(map(str, faces.ravel()))}</p></triangles>"
        for name, faces in zip(colours, triangles, strict=True)
    )
    materials = "".join(
        f'<material id="m{name}"><instance_effect url="#e{name}"/></material>' for name in colours
    )
    bound = "".join(f'<instance_material symbol="s{name}" target="#m{name}"/>' for name in colours)
    (folder / "a.dae").write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        "<asset><created>2000-01-01T00:00:00</created><modified>2000-01-01T00:00:00</modified>"
        f"<up_axis>Z_UP</up_axis></asset><library_effects>{effects}</library_effects>"
        f"<library_materials>{materials}</library_materials>"
        '<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="48">'
        f"{' '.join(f'{value:.17g}' for value in points)}</float_array><technique_common>"
        '<accessor source="#pa" count="16" stride="3"><param name="X" type="float"/><param name="Y" '
        'type="float"/><param name="Z" type="float"/></accessor></technique_common></source>'
        f'<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{parts}</mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="w"><node><instance_geometry url="#g">'
        f"<bind_material><technique_common>{bound}</technique_common></bind_material></instance_geometry>"
        '</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene>'
        "</COLLADA>"
    )
    return folder / "a.dae"


def area(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def surface(x, y, z):
    return 2.0 * (x * y + y * z + z * x)


def assert_boxes(pieces, factor=1.0):
    """Both boxes: corners, surface and colour."""
    by_colour = {colour: mesh for mesh, colour in pieces}
    assert set(by_colour) == {(1.0, 1.0, 1.0, 1.0), BLUE}
    for name, colour in (("white", (1.0, 1.0, 1.0, 1.0)), ("blue", BLUE)):
        mesh, half = by_colour[colour], np.array(EDGES[name]) / 2.0
        assert_close(mesh.vertices.min(axis=0), factor * (CENTRES[name] - half), atol=1e-6)
        assert_close(mesh.vertices.max(axis=0), factor * (CENTRES[name] + half), atol=1e-6)
        assert_close(area(mesh), factor**2 * surface(*EDGES[name]), atol=1e-6)


@pytest.mark.parametrize("written", [wavefront, collada])
def test_the_pieces_of_a_file_are_its_solids_with_their_colours(written, tmp_path):
    path = written(tmp_path)
    assert_boxes(coloured_meshes(path, (1.0, 1.0, 1.0)))
    assert_boxes(coloured_meshes(path, (0.5, 0.5, 0.5)), 0.5)


@pytest.mark.parametrize("written", [wavefront, collada])
def test_pinocchio_numbers_the_second_material_by_the_points_of_the_first(written, tmp_path):
    """Why its reader is not asked: once this fails, ``coop_pin.model.meshes`` may go."""
    mesh = pin.coal.MeshLoader(pin.coal.NODE_TYPE.BV_OBB).load(str(written(tmp_path)), np.ones(3))
    corners = mesh.vertices()
    faces = [[mesh.tri_indices(k)[corner] for corner in range(3)] for k in range(mesh.num_tris)]
    assert corners[np.ravel(faces)][:, 0].max() < 0.5  # none of the box at x = 1


def arm_with(folder, mesh, material=""):
    visual = f'<visual><geometry><mesh filename="{mesh}"/></geometry>{material}</visual>'
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    path = folder / "arm.urdf"
    path.write_text(
        f'<robot name="r"><link name="l"/><link name="m">{visual}'
        f'<visual><geometry><sphere radius="0.3"/></geometry></visual>{inertial}</link><joint name="j" '
        'type="revolute"><parent link="l"/><child link="m"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="10" velocity="1"/></joint></robot>'
    )
    arm, payload = cp.Arm.from_urdf(str(path), "m"), cp.Payload.box(1.0, (0.1, 0.1, 0.1))
    return cp.Cell(arms={"one": arm}, payload=payload, grasps={"one": cp.Pose()})


@pytest.mark.parametrize("written", [wavefront, collada])
def test_a_users_arm_is_drawn_in_the_colours_of_its_files_or_in_that_of_its_urdf(written, tmp_path):
    name = written(tmp_path).name
    (body,) = CellVisuals(arm_with(tmp_path, name), "free").bodies
    assert_boxes(
        [(visual.shape, visual.colour) for visual in body.visuals if "vertices" in dir(visual.shape)]
    )
    red = '<material name="red"><color rgba="1 0 0 1"/></material>'
    (body,) = CellVisuals(arm_with(tmp_path, name, red), "free").bodies
    whole = next(visual for visual in body.visuals if "vertices" in dir(visual.shape))
    assert whole.colour == (1.0, 0.0, 0.0, 1.0)
    assert_close(area(whole.shape), sum(surface(*edges) for edges in EDGES.values()), atol=1e-6)


def test_without_its_materials_a_wavefront_file_is_grey(tmp_path):
    pieces = coloured_meshes(wavefront(tmp_path, None), (1.0, 1.0, 1.0))
    assert {colour for _, colour in pieces} == {GREY}
    assert_close(sum(area(mesh) for mesh, _ in pieces), 0.88 + 0.06, atol=1e-6)


@pytest.mark.parametrize("name", ["a.obj", "a.dae"])
def test_a_damaged_file_is_left_out_with_a_warning_and_the_rest_is_drawn(name, tmp_path):
    (tmp_path / name).write_text("v 0 0 0\nf 1 2 999\n<")
    with pytest.raises(FileReadError, match=name):
        coloured_meshes(tmp_path / name, (1.0, 1.0, 1.0))
    with pytest.warns(UrdfWarning, match="not drawn"):
        (body,) = CellVisuals(arm_with(tmp_path, name), "free").bodies
    assert [type(visual.shape).__name__ for visual in body.visuals] == ["Sphere"]
