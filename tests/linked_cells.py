"""Cells with payloads of several links: a door, a box with a lid, a beam, a table, planar and in space."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

import coop_pin as cp

PAYLOADS = ("door", "lid", "beam", "table")


def link(name: str, mass: float, centre, size) -> str:
    """A homogeneous box as a link of a URDF."""
    x, y, z = (edge * edge * mass / 12.0 for edge in size)
    at = " ".join(map(str, centre))
    return (
        f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia ixx="{y + z}"'
        f' iyy="{x + z}" izz="{x + y}" ixy="0" ixz="0" iyz="0"/></inertial><visual><origin xyz="{at}"/>'
        f'<geometry><box size="{size[0]} {size[1]} {size[2]}"/></geometry></visual></link>'
    )


def joint(name: str, parent: str, child: str, at, axis, limits=(-1.6, 1.6), dynamics="") -> str:
    """A revolute joint of a URDF."""
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin'
        f' xyz="{at[0]} {at[1]} {at[2]}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/><limit'
        f' lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="0"/>{dynamics}</joint>'
    )


def door(leaf: float = 0.3, height: float = 0.1) -> str:
    """A leaf on a vertical hinge at the origin of its frame, with its centre of mass at x = leaf."""
    hinge = joint(
        "hinge", "frame", "leaf", (0, 0, 0), (0, 0, 1), dynamics='<dynamics damping="0.5" friction="0.2"/>'
    )
    return (
        f'<robot name="door"><link name="frame"/>{link("leaf", 4.0, (leaf, 0, 0), (2 * leaf, 0.04, height))}'
        f"{hinge}</robot>"
    )


def box_with_lid(axis=(1, 0, 0), length: float = 0.5) -> str:
    """A box with a flap that hangs at its side."""
    hinge = joint("hinge", "box", "lid", (0, 0.11, 0.05), axis, (-2.0, 2.0), '<dynamics damping="0.01"/>')
    parts = link("box", 2.5, (0, 0, 0), (length, 0.2, 0.1)) + link(
        "lid", 0.5, (0, 0.0, -0.08), (0.4, 0.01, 0.16)
    )
    return f'<robot name="box">{parts}{hinge}</robot>'


def folding_table(axis=(0, 1, 0), reach: float = 0.2) -> str:
    """Two leaves with a hinge between them; each arm holds one."""
    size = (reach, 0.2, 0.03)
    hinge = joint("hinge", "near", "far", (reach / 2.0, 0, 0), axis, (-0.5, 1.6))
    return (
        f'<robot name="table">{link("near", 2.0, (0, 0, 0), size)}'
        f"{link('far', 1.0, (reach / 2.0, 0, 0), size)}{hinge}</robot>"
    )


def payload(kind: str, is_planar: bool) -> dict:
    """Fields of a payload; of a planar cell its joints turn in the plane."""
    reach = 0.12 if is_planar else 0.2
    if kind == "door":
        return {"kind": "links", "path": door(0.2), "link": "leaf", "base": {"xyz": (-0.2, 0.0, 0.0)}}
    if kind == "lid":
        axis = (0, 0, 1) if is_planar else (1, 0, 0)
        spring = {"hinge": {"stiffness": 1.5, "rest": 0.1, "friction": 0.02}}
        return {"kind": "links", "path": box_with_lid(axis, 2.2 * reach), "link": "box", "joints": spring}
    if kind == "table":
        catch = {"hinge": {"stiffness": 20.0, "damping": 0.1, "friction": 0.02}}
        axis = (0, 0, 1) if is_planar else (0, 1, 0)
        return {"kind": "links", "path": folding_table(axis, reach), "link": "near", "joints": catch}
    return {
        "kind": "beam",
        "mass": 2.0,
        "length": 2.0 * reach,
        "bending_stiffness": 20.0,
        "links": 5,
        "axis": "z" if is_planar else "y",
    }


def lid_with_a_stop(name: str, upper: float, **stop) -> cp.Scenario:
    """A box with a flap whose hinge has its upper stop at an angle, m and kg."""
    lid = payload("lid", is_planar=name.startswith("adept"))
    assert 'upper="2.0"' in lid["path"]
    lid["path"] = lid["path"].replace('upper="2.0"', f'upper="{float(upper)!r}"')
    lid["joints"]["hinge"] |= stop
    return linked(name, "lid", **{"cell.payload": lid})


def linked(name: str, kind: str, **changes) -> cp.Scenario:
    """A scenario of the catalogue with a payload of links; the arms hold both ends of a beam or table."""
    scenario = cp.Scenario.load(name)
    fields, is_planar = scenario.model_dump(), scenario.cell.rows == "planar"
    cell, start = fields["cell"], dict(fields["start"])
    cell["payload"] = payload(kind, is_planar)
    if kind == "door":  # at the pose at which the run starts
        X = scenario.start.matrix
        cell["payload"]["base"] = {
            "xyz": (X @ (-0.2, 0.0, 0.0, 1.0))[:3].tolist(),
            "rpy": start["rpy"],
        }
    if ends := {"beam": ("rod0", "rod4"), "table": ("near", "far")}.get(kind):
        for arm, rod in zip(cell["grasps"], ends, strict=True):
            cell["grasps"][arm] = {**cell["grasps"][arm], "link": rod}
            cell["grasps"][arm].pop("kind", None)
    cell["pads"] = {}
    return cp.Scenario(**(fields | {"cell": cell, "events": ()})).override(changes)


def hanging_rope(**changes) -> cp.Scenario:
    """A Panda that carries its own weight and a rope that hangs from its hand; P is on the middle rod."""
    fields, down = cp.Scenario.load("two-pandas-box").model_dump(), np.pi / 2.0
    cell, X = fields["cell"], {"xyz": (-0.2, 0.0, 0.3), "rpy": (0.0, down, 0.0)}
    for part in (cell["arms"], cell["grasps"]):
        part.pop("right")
    cell |= {"pads": {}, "payload": {"kind": "chain", "mass": 0.5, "length": 0.4, "links": 9}}
    cell["grasps"]["left"] = {"xyz": (-0.2, 0.0, 0.0), "rpy": (0.0, down, -down / 2.0), "link": "rod0"}
    fields |= {"start": X, "squeeze": {"left": (0.0,) * 6}, "events": (), "name": "hanging-rope"}
    fields["motion"] |= {"start": X, "goal": X | {"xyz": (-0.15, 0.03, 0.33)}}
    return cp.Scenario(**fields).override({"actuators.gravity_compensation": {}} | changes)


def random_state(chain, q: np.ndarray, seed: int, speed: float):
    """A state near a configuration on the closures, and a generalised force."""
    import pinocchio as pin

    rng, model = np.random.default_rng(seed), chain.mechanism.model
    q = chain.mechanism.project_configuration(pin.integrate(model, q, 0.05 * rng.normal(size=model.nv)))
    v = chain.mechanism.project_velocity(q, speed * rng.normal(size=model.nv))
    return q, v, 5.0 * rng.normal(size=model.nv)


def pulled_rope(name: str, n: int) -> tuple[cp.Scenario, float, float]:
    """A rope of n rods that two arms hold at the polygon of its weight, its pull, and the catenary's.

    Rods turn by tan phi_k = k w / H from the middle one on, with the weight w of a rod.
    """
    scenario, mass, k = cp.Scenario.load(name), 0.6, np.arange(n) - (n - 1) / 2.0
    fields, is_planar = scenario.model_dump(), scenario.cell.rows == "planar"
    length, edges = (0.3 if is_planar else 0.44), np.ones(n)
    edges[[0, -1]] = 0.5
    edges *= length / edges.sum()
    span = 0.9 * length
    part = brentq(lambda part: edges @ np.cos(np.arctan(k * part)) - span, 1e-9, 1e3, xtol=1e-15)
    phi, w = np.arctan(k * part), mass * 9.81 / (n - 1)
    a = brentq(lambda a: 2.0 * a * np.sinh(span / 2.0 / a) - length, 1e-3, 50.0, xtol=1e-15)
    payload = cp.Payload.chain(mass, length, links=n, axis="z" if is_planar else "y").model_dump()
    for joint, turn in enumerate(np.diff(phi).tolist(), start=1):
        payload["links"]["joints"][f"hinge{joint}"]["start"] = turn if is_planar else -turn
    rise = float(edges[n // 2 + 1 :] @ np.sin(phi[n // 2 + 1 :]))
    cell = fields["cell"]
    cell |= {"payload": payload, "pads": {}} | ({"gravity": (0.0, -9.81, 0.0)} if is_planar else {})
    for arm, rod, side in zip(cell["grasps"], ("rod0", f"rod{n - 1}"), (-0.5, 0.5), strict=True):
        at = (side * span, rise, 0.0) if is_planar else (side * span, 0.0, rise)
        cell["grasps"][arm] |= {"link": rod, "xyz": at}
        cell["grasps"][arm].pop("kind", None)
    fields["start"] |= {"rpy": (0.0, 0.0, 0.0)}
    hold = {"kind": "hold", "pose": fields["start"]}
    rope = cp.Scenario(**(fields | {"events": (), "motion": hold, "squeeze": {}, "duration": 2.0}))
    return rope.override({"actuators.gravity_compensation": {}}), w / part, mass * 9.81 / length * a
