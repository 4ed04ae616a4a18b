"""Distances between the bodies of a cell at a configuration, by Pinocchio and coal on convex hulls."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import Table, corners
from coop_pin.feasibility.convex_shapes import (
    FIXED,
    ArmShapes,
    arm_shapes,
    disabled_pairs,
    link_shapes,
    payload_geometry,
    srdf_of,
)
from coop_pin.model.cell_model import CellModel
from coop_pin.model.joint_limits import JointLimits
from coop_pin.model.pinocchio_model import joint_id

PAYLOAD = "payload"
_THICK = 0.02
"""Thickness of a table's top, m."""
_LIES = 5e-3
"""Largest height of the payload's lowest corner over a table, or below, at which it lies on it, m."""
_NEAR = 2
"""Joints between two bodies of one robot that are adjacent, where no SRDF says which pairs matter; with one,
those with a single joint between them are."""


_TRIED = 20
"""Configurations at which shapes of one robot that always overlap are looked for."""


class Exemption(NamedTuple):
    """Pair of bodies that is not looked at.

    Attributes:
        pair: names of the bodies.
        reason: "SRDF", "adjacent", "always overlap" or "holds it".
    """

    pair: tuple[str, str]
    reason: str


class _Shape(NamedTuple):
    """Shape in the tree.

    Attributes:
        body: name of its link as arm/link, "payload", or table/name.
        robot: number of its robot, after them that of the payload; -1 for tables.
        link: name in the URDF.
        joint: index of the joint that moves it, 0 for none.
    """

    body: str
    robot: int
    link: str
    joint: int


class CellDistances:
    """Distances between arms, payload and tables of a cell, whose payload is free in the tree.

    The links of a payload of several are bodies payload/link, but that of P, with the joints where the grasps
    are stated or as they are told. Their bodies are those of a robot.

    Pairs that cannot move against each other are none. Exempt are, of one robot: pairs that its SRDF
    disables, bodies with one joint between them (without an SRDF with one or two), and shapes that overlap at
    each of 20 random configurations; and the bodies that hold the payload or a link of it, from that. A
    payload that lies on a table, by its lowest corner, is at no distance.

    Attributes:
        pairs: names of the bodies of each pair of shapes.
        exempt: pairs of bodies that are not looked at.
        rules: source, for each robot, of what exempts pairs of it: the name of its SRDF, or adjacency.
        omitted: links without a shape, as it cannot be read, with the reason.
    """

    def __init__(self, cell: Cell) -> None:
        """Read the shapes of the arms; raises as ``load_arm_model``."""
        self._cell, self._tree = cell, CellModel(cell, "free")
        self._model, self._geometry = self._tree.model, pin.GeometryModel()
        self._data, self._shapes = self._model.createData(), list[_Shape]()
        self.omitted, self.rules, self._kinds = list[str](), dict[str, str](), dict[str, str]()
        self._payload = len(cell.arms)
        self._disabled: dict[int, frozenset[frozenset[str]] | None] = {self._payload: None}
        frames = {frame.name: int(frame.parentJoint) for frame in self._model.frames}
        self._held = {(frames[f"{name}/grasp"], frames[f"payload/{name}"]) for name in cell.arms}
        for name in cell.arms:
            self._add_arm(name)
        self._add_payload()
        for name, table in cell.tables.items():
            top = pin.SE3(table.matrix) * pin.SE3(np.eye(3), np.array((0.0, 0.0, -0.5 * _THICK)))
            self._add(_Shape(f"table/{name}", -1, "", 0), top, pin.coal.Box(*table.size, _THICK))
        self.pairs, exempt = list[tuple[str, str]](), dict[Exemption, None]()
        for (i, one), (j, other) in itertools.combinations(enumerate(self._shapes), 2):
            pair = one.body, other.body
            if one.joint == other.joint:
                continue
            if reason := self._reason(one, other):
                exempt[Exemption(pair, reason)] = None
            else:
                self._geometry.addCollisionPair(pin.CollisionPair(i, j))
                self.pairs.append(pair)
        self.exempt = tuple(exempt)
        self._results = self._geometry.createData()
        self._lying: dict[int, Table] = {}
        self._exempt_overlaps()
        tables = {f"table/{name}": table for name, table in cell.tables.items()}
        ends = [
            (self._shapes[pair.first], self._shapes[pair.second]) for pair in self._geometry.collisionPairs
        ]
        self._lying = {
            k: tables[other.body]
            for k, (one, other) in enumerate(ends)
            if (one.robot, other.robot) == (self._payload, -1)
        }

    def _add_arm(self, name: str) -> None:
        """Add the shapes of an arm, and once those of its robot that are fixed or on shared joints."""
        cell, slots = self._cell, {slot.name: slot for slot in self._tree.arms}
        arm, siblings = cell.arms[name], cell.siblings(name)
        free = {joint: angle for joint, angle in arm.locked.items() if joint not in cell.shared_joints}
        names = list(cell.arms)
        robot = min(map(names.index, (name, *siblings)))
        is_first = robot == names.index(name)
        without = {*itertools.chain(*(slots[other].joint_names for other in siblings))}
        shapes: ArmShapes = arm_shapes(arm.replace(locked=free), without)
        self.omitted += [f"{name}/{text}" for text in shapes.omitted]
        self._kinds[name] = shapes.kind
        if is_first:
            srdf = srdf_of(arm)
            self._disabled[robot] = None if srdf is None else disabled_pairs(srdf)
            self.rules[name] = "adjacency" if srdf is None else srdf.name
        X_WB = pin.SE3(arm.base.matrix)
        for shape in shapes.shapes:
            is_fixed, is_shared = shape.joint == FIXED, shape.joint in cell.shared_joints
            if (is_fixed or is_shared) and not is_first:
                continue
            mover = f"shared.{shape.joint}" if is_shared else f"{name}/{shape.joint}"
            joint = self._tree.root_joint(name) if is_fixed else joint_id(self._model, mover)
            pose = X_WB * pin.SE3(shape.pose) if joint == 0 else pin.SE3(shape.pose)
            self._add(_Shape(f"{name}/{shape.link}", robot, shape.link, joint), pose, shape.geometry)

    def _add_payload(self) -> None:
        """Add the shapes of the payload, or of its links; the link of P without any has its box."""
        payload, tree, robot, has_shape = self._cell.payload, self._tree, self._payload, False
        if (links := payload.links) is not None and tree.linked is not None:
            shapes, omitted = link_shapes(links.text, links.file)
            seen = {shape.link for shape in shapes}
            for link, _, X_LS, geometry in shapes:
                joint, X = tree.linked.held(link, X_LS)
                body, name = (PAYLOAD, "") if link == links.link else (f"{PAYLOAD}/{link}", link)
                self._add(_Shape(body, robot, name, joint), X, geometry)
            has_shape = links.link in seen
            self.omitted += [f"{PAYLOAD}/{text}" for text in omitted]
            told = seen | {links.link} | {text.partition(":")[0] for text in omitted}
            bare = [name for name, body in links.bodies.items() if body.mass and name not in told]
            self.omitted += [f"{PAYLOAD}/{name}: no shape" for name in bare]
        if not has_shape:
            X_PS = self._model.frames[tree.payload_frame].placement * pin.SE3(payload.shape_pose.matrix)
            self._add(_Shape(PAYLOAD, robot, "", tree.payload_joint), X_PS, payload_geometry(payload))

    def _add(self, shape: _Shape, pose: pin.SE3, geometry: object) -> None:
        name = f"{len(self._shapes)} {shape.body}"
        self._geometry.addGeometryObject(pin.GeometryObject(name, shape.joint, pose, geometry))
        self._shapes.append(shape)

    def _reason(self, one: _Shape, other: _Shape) -> str:
        """Return why a pair is exempt; empty if it is not."""
        if (one.robot == self._payload) != (other.robot == self._payload):
            return "holds it" if {(one.joint, other.joint), (other.joint, one.joint)} & self._held else ""
        if one.robot != other.robot or one.robot < 0:
            return ""
        disabled = self._disabled[one.robot]
        if disabled is not None and frozenset((one.link, other.link)) in disabled:
            return "SRDF"
        near = _NEAR if disabled is None else 1
        return "adjacent" if self._between(one.joint, other.joint) <= near else ""

    def _exempt_overlaps(self) -> None:
        """Exempt the shapes of one robot that overlap at every one of some configurations."""
        overlaps = np.ones(len(self.pairs), dtype=bool)
        limits = [JointLimits(arm, name) for name, arm in self._cell.arms.items()]
        for configurations in zip(*(each.random_configurations(_TRIED) for each in limits), strict=True):
            overlaps &= self.at(self.configuration(list(configurations), np.eye(4))) <= 0.0
        exempt, kept = dict.fromkeys(self.exempt), list[tuple[str, str]]()
        pairs = list(self._geometry.collisionPairs)
        self._geometry.removeAllCollisionPairs()
        for names, pair, overlap in zip(self.pairs, pairs, overlaps, strict=True):
            one, other = self._shapes[pair.first], self._shapes[pair.second]
            if overlap and one.robot == other.robot >= 0:
                exempt[Exemption(names, "always overlap")] = None
            else:
                self._geometry.addCollisionPair(pair)
                kept.append(names)
        self.pairs, self.exempt, self._results = kept, tuple(exempt), self._geometry.createData()

    def _between(self, a: int, b: int) -> int:
        """Return the number of joints on the way from one body of the tree to another."""
        paths = [{*map(int, self._model.supports[joint])} for joint in (a, b)]
        return len(paths[0] ^ paths[1])

    def configuration(
        self, arms: list[Array], X_WP: Array, shared: Array | None = None, links: Array | None = None
    ) -> Array:
        """Return q of the tree from each arm's configuration and the payload's pose.

        Args:
            arms: Configuration of each arm.
            X_WP: Pose of the payload, shape (4, 4).
            shared: Positions of the shared joints, m or rad, shape (n,); their start when omitted.
            links: Positions of the joints of a payload of several links, likewise.
        """
        q, linked = self._tree.configuration(arms, X_WP), self._tree.linked
        if linked is not None and links is not None:
            q[linked.q_slice] = linked.angles.configuration(links)
            q = linked.configured(q, X_WP)
        for slot, angle in zip(
            self._tree.shared, () if shared is None else shared, strict=shared is not None
        ):
            q[slot.q_slice] = slot.angles.configuration(np.array([angle]))
        return q

    def at(self, q: Array) -> Array:
        """Return the distance of every pair at a configuration, negative where they overlap, m, shape (p,).

        Where the payload lies on a table, their distance is infinite.
        """
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._results, q)
        pin.computeDistances(self._geometry, self._results)
        distances = np.array([result.min_distance for result in self._results.distanceResults])
        for k, table in self._lying.items():
            X_WP = self._data.oMi[self._tree.payload_joint].homogeneous
            X_TP = np.linalg.solve(table.matrix, X_WP)
            lowest = (corners(self._cell.payload) @ X_TP[:3, :3].T + X_TP[:3, 3])[:, 2].min()
            if abs(lowest) <= _LIES:
                distances[k] = np.inf
        return distances

    def points(self, pair: int) -> Array:
        """Return the nearest points of a pair at the last configuration, in the world, m, shape (2, 3)."""
        result = self._results.distanceResults[pair]
        return np.array((result.getNearestPoint1(), result.getNearestPoint2()))
