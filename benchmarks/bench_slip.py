"""Load at which grasps slip: the margin of friction against contacts of MuJoCo, on seeded grasps.

    python benchmarks/bench_slip.py [--seeds 200] [--first 0] [--contact finger pad] [--all]
                                    [--creep 1e-4] [--step 1e-3] [--impratio 1e4] [--slower 1]

Each seed draws two or three palms that hold a box: mass, mu, squeeze, outline and attitude of the pads, pose
of the payload, its weight and a push on it; even seeds are planar cells (weight across the plane, push in
it), odd ones are turned in space. Weight and push grow together, in parts of their drawn size, until a palm
slips; predicted is the part at which ``friction_use`` of the cell's pads tells a margin of zero, or where one
point touches the part at which force and torsion leave their ellipsoid.

In MuJoCo the palms do what the law does: each is pressed with its normal force of squeeze and virtual
linkage, and is held by position across it. One of two palms, or all three, have their moment about the normal
from there, too. So statics leave nothing open, and what is compared is friction alone. Its contacts creep
below the limit; a palm slips from a stated speed on, which counts spin at the pad's torsion radius.

- finger: one point with friction about the normal (condim 4), whose cone is that ellipsoid.
- pad: 64 points evenly over the pad (condim 3), which a ball joint lays on the face. The contact is soft,
  because MuJoCo's cones make sliding points lift: those that slide faster then bear more.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco_cell import numbers
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.spatial import shift_wrench
from coop_pin.base.spatial.internal_wrench import linkage_loads
from coop_pin.description.cell.cell import Cell
from coop_pin.results.friction import FrictionUse, friction_use

G = 9.81
FIRST, LAST, SETTLE = 0.8, 1.3, 0.3
"""Parts of the predicted load between which it grows, and the time to reach the first, s."""
INERTIA = 5e-3
"""Part of the load by which it may grow while a free payload reaches the speed of slip."""
SPHERE = 5e-3


class Settings(NamedTuple):
    """Settings of MuJoCo: creep m/s, step s, impratio, and by what the ramp is slower than it need be."""

    creep: float = 1e-4
    step: float = 1e-3
    impratio: float = 1e4
    slower: float = 1.0


SETTINGS = Settings()


class Grasps(NamedTuple):
    """Grasps of a payload with pads.

    Attributes:
        cell: description.
        R: attitude of the payload.
        load: wrench of weight and push on the arms about P in payload axes, shape (6,).
        squeeze: internal wrenches likewise, shape (m, 6).
    """

    cell: Cell
    R: np.ndarray
    load: np.ndarray
    squeeze: np.ndarray

    @property
    def planes(self) -> np.ndarray:
        """Planes of the pads in payload axes, shape (m, 4, 4)."""
        return np.array([grasp.matrix @ self.cell.pads[arm].plane for arm, grasp in self.cell.grasps.items()])

    def wrenches(self, part: float) -> np.ndarray:
        """Wrenches on the arms about P in payload axes, by the virtual linkage, shape (m, 6)."""
        return part * (linkage_loads(self.planes[:, :3, 3]) @ self.load) + self.squeeze

    def use(self, part: float) -> FrictionUse:
        """Return what the package tells of the friction at a part of the load."""
        F = self.wrenches(part).reshape(-1, 2, 3) @ self.R.T
        quaternion = Rotation.from_matrix(self.R).as_quat()
        data = {"time": np.zeros(1), "payload_quaternion": quaternion[None]}
        return friction_use(data | {"interaction_wrench": F.reshape(1, -1, 6)}, self.cell)

    def limit(self, contact: str) -> float:
        """Return the part of the load at which the margin is zero, of a finger that of the ellipsoid."""

        def beyond(part: float) -> float:
            use = self.use(part)
            used = use.used if contact == "pad" else np.hypot(use.force, use.torsion)
            return min(float(used.max()), 2.0) - 1.0

        return brentq(beyond, 0.0, next(2.0**k for k in range(20) if beyond(2.0**k) > 0.0), xtol=1e-9)

    def commands(self, part: float) -> np.ndarray:
        """Return the normal force and the moment about the normal with which each palm presses, (m, 2)."""
        sides = zip(self.wrenches(part), self.planes, strict=True)
        return -np.array([shift_wrench(F, -X[:3, 3]).reshape(2, 3) @ X[:3, 2] for F, X in sides])


def grasps(seed: int) -> Grasps:
    """Return random grasps."""
    rng, planar = np.random.default_rng(seed), seed % 2 == 0
    three = not planar and rng.random() < 1.0 / 3.0
    cell = cp.Scenario.load(
        "adept-paper" if planar else "three-ur5-plate" if three else "two-pandas-box"
    ).cell
    m, half = len(cell.arms), rng.uniform(0.05, 0.25)
    mu, mass = rng.uniform(0.2, 1.2), rng.uniform(0.5, 5.0)
    force = rng.uniform(1.2, 4.0) * mass * G / (m * mu)
    round_pad = rng.random() < 0.5
    outline = (
        {"radius": rng.uniform(0.01, 0.04)} if round_pad else {"size": rng.uniform(0.02, 0.06, 2).tolist()}
    )
    offset = np.array((0.0, *rng.uniform(-0.02, 0.02, 2)))  # of the palms from P
    poses, pads, squeeze = {}, {}, []
    for arm, angle in zip(cell.arms, np.pi + 2.0 * np.pi * np.arange(m) / m, strict=True):
        normal = np.array((np.cos(angle), np.sin(angle), 0.0))
        press = rng.choice(["x", "-x", "y", "-y", *([] if planar else ["z", "-z"])])
        pads[arm] = cp.Pad(mu=mu, press=press, **outline)
        r = half * normal + offset * ((0, 0, 1) if three else 1)
        poses[arm] = {
            "xyz": r.tolist(),
            "rpy": attitude(normal, pads[arm], planar, rng).as_euler("xyz").tolist(),
        }
        squeeze.append(shift_wrench(np.concatenate((force * normal, np.zeros(3))), r))
    payload = {"kind": "box", "mass": mass, "size": (2.0 * half,) * 3}
    cell = cell.replace(payload=payload, grasps=poses, pads=pads, load_shares=None)
    turn = Rotation.from_euler("z", rng.uniform(0.0, 6.28)) if planar else Rotation.random(random_state=rng)
    way, lever = rng.normal(size=3), half * rng.uniform(-1.0, 1.0, 3)
    if planar:
        way[2] = lever[2] = 0.0
    push = rng.uniform(0.0, 1.5) * mass * G * way / np.linalg.norm(way)
    weight = turn.inv().apply((0.0, 0.0, -mass * G))
    load = np.concatenate((weight + push, np.cross(lever, push)))
    return Grasps(cell, turn.as_matrix(), load, np.array(squeeze))


def attitude(normal: np.ndarray, pad: cp.Pad, planar: bool, rng: np.random.Generator) -> Rotation:
    """Return the attitude of a grasp whose pad presses against a normal: turned about z, or about it."""
    if planar:
        (x, y), (n_x, n_y) = pad.plane[:2, 2], normal[:2]
        return Rotation.from_euler("z", np.arctan2(n_y, n_x) - np.arctan2(y, x))
    out = Rotation.from_matrix(np.column_stack((np.cross((0, 0, 1), normal), (0, 0, 1), normal)))
    turn = Rotation.from_euler("z", rng.uniform(0.0, 6.28))
    return out * turn * Rotation.from_matrix(pad.plane[:3, :3]).inv()


def evenly(pad: cp.Pad) -> np.ndarray:
    """Return 64 points, each in the middle of an equal part of the pad, m, shape (64, 2)."""
    if pad.size is not None:
        x = (np.arange(8) + 0.5) / 8.0 - 0.5
        return np.stack(np.meshgrid(*(edge * x for edge in pad.size)), axis=-1).reshape(-1, 2)
    rings = []
    for k in range(4):
        angle = (np.arange(8 * k + 4) + 0.5) * 2.0 * np.pi / (8 * k + 4)
        r = pad.radius * ((k + 1) ** 3 - k**3) / (6.0 * (2 * k + 1))  # the mean distance of the ring
        rings.append(r * np.stack((np.cos(angle), np.sin(angle)), axis=1))
    return np.concatenate(rings)


CONTACTS = {
    "finger": (lambda _: np.zeros((1, 2)), 'condim="4" solref="0.004 1" solimp="0.95 0.99 0.001"'),
    "pad": (evenly, 'condim="3" solref="0.01 1" solimp="0.5 0.5 0.001"'),
}


def quaternion(R: np.ndarray) -> str:
    """Return a rotation as MuJoCo writes it: w, x, y, z."""
    return numbers(Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]])


def mjcf(grasps: Grasps, contact: str, settings: Settings) -> str:
    """Return the model: a free payload, and palms that slide along their normals."""
    cell, (points, words) = grasps.cell, CONTACTS[contact]
    faces = palms = pairs = motors = ""
    X_WP = np.eye(4)
    X_WP[:3, :3] = grasps.R
    for arm, X in zip(cell.arms, grasps.planes, strict=True):
        pad, free = cell.pads[arm], spins(grasps)[arm]
        faces += f"""<geom name="{arm}" type="box" size="0.2 0.2 0.02" mass="0"
            pos="{numbers(X[:3, 3] - 0.02 * X[:3, 2])}" quat="{quaternion(X[:3, :3])}"/>"""
        axes = ("1 0 0", "0 1 0") * (contact == "pad") + ("0 0 1",) * free
        hinges = "".join(f'<joint axis="{axis}" damping="1e-3" name="{arm} {axis}"/>' for axis in axes)
        spheres = ""
        for k, (x, y) in enumerate(points(pad)):
            spheres += f'<geom name="{arm}{k}" size="{SPHERE}" pos="{numbers((x, y, SPHERE))}" mass="0"/>'
            friction = numbers((pad.mu, pad.mu, pad.mu * pad.torsion_radius, 0.0, 0.0))
            pairs += f'<pair geom1="{arm}" geom2="{arm}{k}" friction="{friction}" {words}/>'
        palms += f"""<body pos="{numbers((X_WP @ X)[:3, 3])}" quat="{quaternion((X_WP @ X)[:3, :3])}">
            <joint name="{arm}" type="slide" axis="0 0 1" damping="10"/>{hinges}{spheres}
            <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body>"""
        motors += f'<motor joint="{arm}"/>' + f'<motor joint="{arm} 0 0 1"/>' * free
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = cell.payload.inertia_matrix
    inertia = numbers((xx, yy, zz, xy, xz, yz))
    return f"""<mujoco><option gravity="0 0 0" timestep="{settings.step}" integrator="implicitfast"
            cone="elliptic" impratio="{settings.impratio}" tolerance="1e-12" iterations="200"/>
        <default><geom contype="0" conaffinity="0"/></default><size memory="100M"/>
        <worldbody><body name="payload" quat="{quaternion(grasps.R)}"><freejoint/>
        <inertial pos="0 0 0" mass="{cell.payload.mass}" fullinertia="{inertia}"/>{faces}</body>{palms}
        </worldbody><contact>{pairs}</contact><actuator>{motors}</actuator></mujoco>"""


def spins(grasps: Grasps) -> dict[str, bool]:
    """Return which palms turn about their normal, by a stated moment: all but the second of two."""
    arms = list(grasps.cell.arms)
    return {arm: len(arms) > 2 or arm == arms[0] for arm in arms}


class Slip(NamedTuple):
    """Part of the predicted load at which a palm slips, and the payload's inertia then in parts of it."""

    part: float
    inertia: float


def slip(grasps: Grasps, contact: str, settings: Settings = SETTINGS) -> Slip:
    """Let the load grow until a palm slips."""
    limit, mass, (creep, step, *_) = grasps.limit(contact), grasps.cell.payload.mass, settings
    model = mujoco.MjModel.from_xml_string(mjcf(grasps, contact, settings))
    data, payload = mujoco.MjData(model), model.body("payload").id
    free = np.array([on for spin in spins(grasps).values() for on in (True, spin)])
    squeeze, load = (grasps.commands(part).ravel()[free] for part in (0.0, 1.0))
    W = (grasps.load.reshape(2, 3) @ grasps.R.T).ravel()
    pull = limit * np.linalg.norm(W[:3]) / mass
    rate = min(0.1, INERTIA**2 * pull / (2.0 * creep)) / settings.slower
    V, J = np.zeros((11, 3)), slips(grasps, model)
    for k in range(int((SETTLE + (LAST - FIRST) / rate) / step)):
        t = k * step
        part = FIRST * min(1.5 * t / SETTLE, 1.0) + rate * max(t - SETTLE, 0.0)
        data.xfrc_applied[payload] = part * limit * W
        data.ctrl[:] = squeeze + part * limit * (load - squeeze)
        mujoco.mj_step(model, data)
        V = np.vstack((V[1:], data.qvel[:3]))
        if t > SETTLE and np.linalg.norm(J @ data.qvel, axis=1).max() > creep:
            break
    a = np.linalg.norm(V[-1] - V[0]) / (10.0 * step)
    inertia = mass * a / (part * limit * np.linalg.norm(W[:3]))
    return Slip(part, inertia)


def slips(grasps: Grasps, model: mujoco.MjModel) -> np.ndarray:
    """Return J with J v the slip of each palm, in its plane and by spin at its torsion radius, (m, 3, nv)."""
    J = np.zeros((len(grasps.cell.arms), 3, model.nv))
    for slide, (arm, spin), X in zip(J, spins(grasps).items(), grasps.planes, strict=True):
        r = grasps.cell.pads[arm].torsion_radius
        slide[:2, :3] = X[:3, :2].T @ grasps.R.T
        slide[:2, 3:6] = np.cross(X[:3, 3], X[:3, :2].T)
        slide[2, 3:6] = r * X[:3, 2]
        if spin:
            slide[2, model.joint(f"{arm} 0 0 1").dofadr[0]] = -r
    return J


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--contact", nargs="+", choices=CONTACTS, default=list(CONTACTS))
    for name, value in SETTINGS._asdict().items():
        parser.add_argument(f"--{name}", type=float, default=value)
    parser.add_argument("--all", action="store_true", help="print each grasp")
    given = parser.parse_args(words)
    settings = Settings(*(getattr(given, name) for name in Settings._fields))
    print(
        "| contact | cells | within 5 % | least | 5 % | median | 95 % | largest | inertia |\n|" + "---|" * 9
    )
    for contact in given.contact:
        parts, inertia = [], 0.0
        for seed in range(given.first, given.first + given.seeds):
            cell = grasps(seed)
            found = slip(cell, contact, settings)
            parts.append(found.part)
            inertia = max(inertia, found.inertia)
            if given.all:
                use = cell.use(cell.limit(contact))
                print(
                    seed,
                    len(use.arms),
                    f"{found.part:.4f} {found.inertia:.1e}",
                    use.torsion[0, use.used[0].argmax()],
                )
        near = np.mean(np.abs(np.array(parts) - 1.0) < 0.05)
        spread = " | ".join(f"{value:.4f}" for value in np.quantile(parts, (0.0, 0.05, 0.5, 0.95, 1.0)))
        print(f"| {contact} | {len(parts)} | {100.0 * near:.1f} % | {spread} | {inertia:.1e} |")


if __name__ == "__main__":
    main()
