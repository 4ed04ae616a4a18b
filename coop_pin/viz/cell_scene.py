"""3-D scene of a cell: arms, payload, grasp frames, contacts, floor and camera."""

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
from coop_pin.viz.camera import framing_camera
from coop_pin.viz.contact_scene import contact_items
from coop_pin.viz.scene import Axes, Item, Scene, thinned

_BALL_M, _PIN_M, _PINS_M = 0.018, 0.006, {"hinge": 0.12, "cylinder": 0.24}
"""Radii of balls and pins; lengths of pins, along which a cylinder slides."""
LINK_FACES = 1800
"""Largest number of triangles of one link's mesh."""

_TRIAD_M = 0.05
_GHOST_SCALE = 0.97
"""The ghost at the desired pose is smaller than the payload, so that it is hidden while there is no error."""

_PLATE_M, _PLATE_THICKNESS, _PLATE_COLOUR = (0.22, 0.22), 0.03, "#33383f"
_TABLE_COLOUR, _LEG_M, _LEVEL = "#c9b08b", 0.035, 1e-6
"""Colour of a table's top, edge of its legs, m, and how far from one the cosine of a level table may be."""
_ROD_M, _ROD_COLOUR, _ROD_FROM_M = 0.008, "#7d858f", 0.01
"""Radius and colour of the rod to a grasp away from the payload, and the distance from which there is one."""

_FLUSH_M = 5e-4


def cell_scene(
    cell: Cell,
    bodies: tuple[Body, ...],
    partners: Sequence[Partner] = (),
    *,
    nearest: bool = False,
    tips: Array,
    path: Array,
    shown: Array,
    at: Array | None = None,
) -> Scene:
    """Return the drawables of a cell, and a camera close to its payload.

    Args:
        cell: the cell.
        bodies: visual shapes of the arms.
        partners: partners of the run.
        nearest: whether the nearest points of two bodies are drawn.
        tips: positions of the tips at the instant that the camera frames, m, shape (m, 3).
        path: positions of the payload over time, m, shape (n, 3).
        shown: points that are in view at the instant, m, shape (k, 3).
        at: position of the payload at the instant, m, shape (3,); the first of its path when omitted.
    """
    arms = _body_items(bodies)
    feet = {name: arm.base.xyz[2] for name, arm in cell.arms.items()}  # of arms whose base has no visual
    lowest = [(item.node.split("/")[1], _lowest(item, cell)) for item in arms if item.node.endswith("/base")]
    feet |= {name: min(low for of, low in lowest if of == name) for name, _ in lowest}
    floor = min(feet.values())
    items = (
        *_plates(cell, feet, floor),
        *_tables(cell, floor),
        *arms,
        *_payload_items(cell),
        *contact_items(cell, partners, nearest),
    )
    return Scene(items, framing_camera(cell, tips, path, path[0] if at is None else at, shown), floor)


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


def _tables(cell: Cell, floor: float) -> Iterator[Item]:
    """Yield the tops of the cell's tables, and legs down to the floor under those that are level."""
    for table in cell.tables.values():
        X_WS = table.matrix @ make_pose((0.0, 0.0, -_PLATE_THICKNESS / 2.0))
        yield Item("floor", Box((*table.size, _PLATE_THICKNESS)), _TABLE_COLOUR, X_WS)
        length = float(table.matrix[2, 3]) - _PLATE_THICKNESS - floor
        if table.matrix[2, 2] < 1.0 - _LEVEL or length <= 0.0:
            continue
        x, y = (edge / 2.0 - _LEG_M for edge in table.size)
        for corner in ((x, y), (-x, y), (x, -y), (-x, -y)):
            X_TL = make_pose((*corner, -_PLATE_THICKNESS - length / 2.0))
            yield Item("floor", Box((_LEG_M, _LEG_M, length)), _PLATE_COLOUR, table.matrix @ X_TL)


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
        *_pins(cell),
    )


def _pins(cell: Cell) -> Iterator[Item]:
    """Yield the axis of every hinge and cylinder on the payload, and a sphere for a ball."""
    for grasp in cell.jointed.values():
        shape = Sphere(_BALL_M) if grasp.kind == "ball" else Cylinder(_PIN_M, _PINS_M[grasp.kind])
        yield Item("payload", shape, palette.LOAD, grasp.matrix @ grasp.X_EC)


def _rods(shape: Shape, X_PS: Array, cell: Cell) -> Iterator[Item]:
    """Yield a rod to every grasp away from the payload, from the nearest point of the box around it."""
    for X_PG in cell.grasps.values():
        grasp, reach = (np.linalg.inv(X_PS) @ X_PG.matrix)[:3, 3], half_extents(shape)
        line = grasp - np.clip(grasp, -reach, reach)
        if (length := float(np.linalg.norm(line))) > _ROD_FROM_M:
            x, y, z = line / length
            X_SR = make_pose(grasp - line / 2.0, (0.0, np.arccos(z), np.arctan2(y, x)))
            yield Item("payload", Cylinder(_ROD_M, length), _ROD_COLOUR, X_PS @ X_SR)
