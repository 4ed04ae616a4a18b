"""3-D scene of a cell: arms, payload, grasp frames, floor and camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import make_pose
from coop_pin.description.cell.cell import Cell
from coop_pin.description.events import Partner
from coop_pin.figures import palette
from coop_pin.model.shapes import Box, Cylinder, Mesh, Shape, Sphere, half_extents, payload_shape
from coop_pin.model.visuals import Body
from coop_pin.viz.contacts import contact_items
from coop_pin.viz.scene import LONGEST_M, Axes, Camera, Item, Scene, thinned

LINK_FACES = 1800
"""Largest number of triangles of one link's mesh."""

_TRIAD_M = 0.05
_GHOST_SCALE = 0.97
"""The ghost at the desired pose is smaller than the payload, so that it is hidden while there is no error."""

_PLATE_M, _PLATE_THICKNESS, _PLATE_COLOUR = (0.22, 0.22), 0.03, "#33383f"
_ROD_M, _ROD_COLOUR, _ROD_FROM_M = 0.008, "#7d858f", 0.01
"""Radius and colour of the rod to a grasp away from the payload, and the distance from which there is one."""

_FLUSH_M = 5e-4

_FIELD_OF_VIEW_DEG = 32.0
_AZIMUTH_DEG = 22.0
_ELEVATION_DEG = 24.0
_PLANAR_ELEVATION_DEG = 42.0
_MARGIN = 1.02


def cell_scene(
    cell: Cell, bodies: tuple[Body, ...], partners: Sequence[Partner] = (), *, tips: Array, points: Array
) -> Scene:
    """Return the drawables of a cell, and a camera close to its payload.

    Args:
        cell: the cell.
        bodies: visual shapes of the arms.
        partners: partners of the run.
        tips: positions of the tips whose longest arrows the camera must show, m, shape (m, 3).
        points: other points that it must show, m, shape (n, 3).
    """
    arms = _body_items(bodies)
    feet = {name: arm.base.xyz[2] for name, arm in cell.arms.items()}  # of arms whose base has no visual
    lowest = [(item.node.split("/")[1], _lowest(item, cell)) for item in arms if item.node.endswith("/base")]
    feet |= {name: min(low for of, low in lowest if of == name) for name, _ in lowest}
    floor = min(feet.values())
    reach = LONGEST_M * np.concatenate((np.eye(3), -np.eye(3)))
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    points = np.concatenate((points, bases, (tips[:, None] + reach).reshape(-1, 3)))
    items = (
        *_plates(cell, feet, floor),
        *_tables(cell),
        *arms,
        *_payload_items(cell),
        *contact_items(cell, partners),
    )
    return Scene(items, _camera(cell, points, tips), floor)


def _camera(cell: Cell, points: Array, tips: Array) -> Camera:
    """Return a camera that shows points, the first arm on the left and the last on the right.

    Its azimuth is a little off the front, to the side from which the line between the tips appears longer.
    Planar cells are seen from higher up, arms on one base from the front.
    """
    line = tips[-1] - tips[0]
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    low, high = points.min(axis=0), points.max(axis=0)
    target = (low + high) / 2.0
    across = bases[-1, :2] - bases[0, :2]
    if np.linalg.norm(across) < 1e-6:
        ahead = tips.mean(axis=0) - bases[0]
        across = np.array((-ahead[1], ahead[0]))
    front = np.arctan2(across[1], across[0]) - np.pi / 2.0
    sides = (front + np.radians(_AZIMUTH_DEG), front - np.radians(_AZIMUTH_DEG))
    azimuth = max(sides, key=lambda side: abs(line[0] * np.sin(side) - line[1] * np.cos(side)))
    elevation = np.radians(_PLANAR_ELEVATION_DEG if cell.rows == "planar" else _ELEVATION_DEG)
    level = np.cos(elevation)
    outwards = np.array((np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)))
    along = (points - target) @ outwards  # towards the camera
    across_view = np.linalg.norm(points - target - along[:, None] * outwards, axis=1)
    distance = _MARGIN * float((along + across_view / np.tan(np.radians(_FIELD_OF_VIEW_DEG / 2.0))).max())
    return Camera(target + distance * outwards, target, _FIELD_OF_VIEW_DEG)


def _lowest(item: Item, cell: Cell) -> float:
    """Return the height of the lowest point of a shape on the base of an arm, m."""
    X_WS = cell.arms[item.node.split("/")[1]].base.matrix @ item.pose
    down, shape = X_WS[2, :3], item.drawable
    match shape:
        case Mesh(vertices, _):
            reach = -float((vertices @ down).min())
        case Cylinder(radius, length):
            reach = float(abs(down[2]) * length / 2.0 + radius * np.hypot(down[0], down[1]))
        case Box() | Sphere():
            reach = float(np.abs(down) @ half_extents(shape))
        case _:
            reach = 0.0
    return float(X_WS[2, 3]) - reach


def _plates(cell: Cell, feet: Mapping[str, float], floor: float) -> Iterator[Item]:
    """Yield a plate under every upright arm that would float above the floor, and one behind any other arm.

    Args:
        cell: the cell.
        feet: height of the lowest point of each arm's base, m.
        floor: height of the floor, m.
    """
    for name, arm in cell.arms.items():
        if feet[name] - floor > _FLUSH_M and arm.base.matrix[2, 2] > 0.0:
            x, y, _ = arm.base.xyz
            plate = Box((*_PLATE_M, feet[name] - floor))
            yield Item("floor", plate, _PLATE_COLOUR, make_pose((x, y, (feet[name] + floor) / 2.0)))
        elif arm.base.matrix[2, 2] <= 0.0:
            X_WB = arm.base.matrix @ make_pose((0.0, 0.0, -_PLATE_THICKNESS / 2.0))
            yield Item("floor", Box((*_PLATE_M, _PLATE_THICKNESS)), _PLATE_COLOUR, X_WB)


def _tables(cell: Cell) -> Iterator[Item]:
    """Yield the tops of the cell's tables."""
    for table in cell.tables.values():
        X_WS = table.matrix @ make_pose((0.0, 0.0, -_PLATE_THICKNESS / 2.0))
        yield Item("floor", Box((*table.size, _PLATE_THICKNESS)), _PLATE_COLOUR, X_WS)


def _body_items(bodies: tuple[Body, ...]) -> tuple[Item, ...]:
    """Return the visual shapes of bodies, on their nodes; equal arms share their thinned meshes."""
    thin: dict[int, Mesh] = {}
    items: list[Item] = []
    for body in bodies:
        for visual in body.visuals:
            shape = visual.shape
            if isinstance(shape, Mesh):
                if id(shape) not in thin:
                    thin[id(shape)] = thinned(shape, LINK_FACES)
                shape = thin[id(shape)]
            colour = "#" + "".join(f"{round(255 * part):02x}" for part in visual.colour[:3])
            items.append(Item(f"arms/{body.name}", shape, colour, visual.pose, opacity=visual.colour[3]))
    return tuple(items)


def _payload_items(cell: Cell) -> tuple[Item, ...]:
    """Return the payload with its grasp frames, and the ghost at the desired pose."""
    shape, ghost = payload_shape(cell.payload), payload_shape(cell.payload, _GHOST_SCALE)
    X_PS = cell.payload.shape_pose.matrix
    return (
        Item("payload", shape, palette.ACTUAL, X_PS),
        Item("desired", ghost, palette.DESIRED, X_PS, "desired", 0.35, lit=False),
        *(Item("payload", Axes(_TRIAD_M), "", X_PG.matrix, "path") for X_PG in cell.grasps.values()),
        *_rods(shape, X_PS, cell),
    )


def _rods(shape: Shape, X_PS: Array, cell: Cell) -> Iterator[Item]:
    """Yield a rod to every grasp away from the payload, from the nearest point of the box around it."""
    for X_PG in cell.grasps.values():
        grasp, reach = (np.linalg.inv(X_PS) @ X_PG.matrix)[:3, 3], half_extents(shape)
        line = grasp - np.clip(grasp, -reach, reach)
        if (length := float(np.linalg.norm(line))) > _ROD_FROM_M:
            x, y, z = line / length
            X_SR = make_pose(grasp - line / 2.0, (0.0, np.arccos(z), np.arctan2(y, x)))
            yield Item("payload", Cylinder(_ROD_M, length), _ROD_COLOUR, X_PS @ X_SR)
