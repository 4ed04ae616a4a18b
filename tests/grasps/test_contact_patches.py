"""Contacts with dry friction: element, block on a table, refusals; planar, and in space, turned."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from lifts import planar_cell, spatial_cell
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.actuators import SharedJoint
from coop_pin.base.errors import ArgumentError, CoopPinError, FieldError
from coop_pin.compiled import support
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.grasps.contact_equilibrium import laid, lies
from coop_pin.grasps.contact_points import ContactPoints
from coop_pin.simulation.pinocchio_plant import PinocchioPlant

MU, MASS, G = 0.5, 2.0, 9.81
TABLES = {
    "planar": ("adept-paper", (0.0, 0.0, 0.0)),
    "spatial": ("two-pandas-box", (0.3, -0.2, 0.5)),
}
"""A cell, one arm of which stands beside the table, and rpy of the table; gravity turns with it."""
BOX = {"kind": "box", "mass": MASS, "size": (0.2, 0.2, 0.1)}
DISC = {"kind": "cylinder", "mass": MASS, "radius": 0.1, "length": 0.1}


class Bench:
    """A payload on a table, beside an arm whose palm is far away: a plant without torques at the payload."""

    def __init__(self, name: str, payload: dict = BOX, height: float = 0.05, k: float = 4e5) -> None:
        scenario, rpy = TABLES[name]
        cell = cp.Scenario.load(scenario).cell
        arm = next(iter(cell.arms))
        palm = cp.PatchGrasp(xyz=(-0.1, 0.0, 0.0), press="x", mu=MU, radius=0.02, face=(0.2, 0.1))
        table = cp.Table(
            xyz=(3.0, 1.0, 0.2), rpy=rpy, size=(4.0, 4.0), mu=MU, stiffness=k, shear_stiffness=k,
            damping_ratio=0.7,
        )  # fmt: skip
        self.R = table.matrix[:3, :3]
        cell = cell.replace(
            arms={arm: cell.arms[arm]}, grasps={arm: palm}, load_shares=None, payload=payload,
            tables={"table": table}, gravity=tuple(-G * self.R[:, 2]),
        )  # fmt: skip
        options = PlantOptions(payload="free")
        self.chain = CellChain(cell, options)
        X_WP = table.matrix
        X_WP[:3, 3] += height * self.R[:, 2]
        q = self.chain.model.configuration([slot.posture for slot in self.chain.model.arms], X_WP)
        patches, model = self.chain.patches, self.chain.model
        self.plant = PinocchioPlant(self.chain, options, laid(patches, q) if lies(patches, q) else q)
        self.start = int(model.model.idx_vs[model.payload_joint])
        self.zero, self.time = self._balance(), 0.0

    def throw(self, linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0)) -> None:
        """Give the payload a velocity in its axes."""
        v = np.zeros(self.chain.mechanism.model.nv)
        v[self.start : self.start + 6] = *linear, *angular
        self.plant.v = v
        self.zero = self._balance()

    def push(self, force) -> None:
        """Push the payload at P in axes of the table from now on."""
        wrench = np.concatenate((self.R @ force, np.zeros(3)))
        self.plant.surround(self.plant.surroundings._replace(push=wrench))

    def run(self, duration: float, h: float, force=None) -> np.ndarray:
        """Times, positions and twists of P in axes of the table, normal force, energy not explained."""
        rows = []
        for _ in range(round(duration / h)):
            if force is not None:
                self.push(force(self.time))
            self.plant.advance(self.time, h)
            self.time += h
            plant, patches = self.plant, self.chain.patches
            V = plant.chain.payload_twist(plant.q, plant.v).reshape(2, 3) @ self.R
            p = plant.chain.payload_pose(plant.q)[:3, 3] @ self.R
            N = patches.at(plant.q, plant.v).wrench[1, 2]
            rows.append((self.time, *p, *V.ravel(), N, self._balance() - self.zero))
        return np.array(rows)

    def _balance(self) -> float:
        return self.chain.energy(self.plant.q, self.plant.v) - float(self.plant.work.sum())


def slope(rows: np.ndarray, column: int, first: float = 0.02, last: float = 0.15) -> float:
    """Slope of a column between two times."""
    part = rows[(rows[:, 0] > first) & (rows[:, 0] < last)]
    return float(np.polyfit(part[:, 0], part[:, column], 1)[0])


@pytest.mark.parametrize("name", TABLES)
def test_stiffness_and_damping_are_of_the_motions_of_the_points_in_their_planes(name):
    """Of a palm and a payload that are turned against each other, by differences of the points' places."""
    chain = Bench(name).chain
    patches, model, rng = chain.patches, chain.mechanism.model, np.random.default_rng(5)
    q = pin.integrate(model, chain.model.configuration([arm.posture for arm in chain.model.arms], np.eye(4)),
                      rng.normal(size=model.nv))  # fmt: skip
    patches.damp(q)
    h, part, points = 1e-6, patches.parts[0], patches.points
    moved = [
        [patches.positions(pin.integrate(model, q, sign * h * row))[part] for sign in (1.0, -1.0)]
        for row in np.eye(model.nv)
    ]
    J = np.moveaxis([(after - before) / (2.0 * h) for after, before in moved], 0, -1)
    springs = [points.shear_stiffness, points.shear_stiffness, points.stiffness]
    dampers = [points.shear_damping, points.shear_damping, points.damping]
    for matrix, numbers in zip(patches.matrices(q), (springs, dampers), strict=True):
        expected = np.einsum("nia,in,nib->ab", J, np.array(numbers)[:, part], J)
        assert_allclose(matrix, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    J_0, palm = J.mean(axis=0), next(iter(chain.cell.patches.values()))
    assert_allclose(patches.on_body[part].mean(axis=0), 0.0, atol=1e-12)
    M = np.triu(pin.crba(model, model.createData(), q))
    W = np.diag(J_0 @ np.linalg.solve(M + np.triu(M, 1).T, J_0.T))
    for numbers, k, mobility in (
        (points.damping, palm.stiffness, W[2]),
        (points.shear_damping, palm.shear_stiffness, W[:2].mean()),
    ):
        assert_allclose(numbers[part].sum(), 2.0 * palm.damping_ratio * np.sqrt(k / mobility), rtol=1e-6)


# ------------------------------------------------------------ the element


def some_points(n: int = 6) -> ContactPoints:
    """Points with uneven numbers."""
    rng = np.random.default_rng(3)
    k, c, sigma, d = rng.uniform(1.0, 9.0, (4, n))
    return ContactPoints(
        k, c, sigma, d, rng.uniform(0.2, 1.0, n), np.full((n, 2), -5.0), np.full((n, 2), 5.0)
    )


def test_forces_stay_in_the_cone_and_never_pull():
    points, rng = some_points(), np.random.default_rng(4)
    for _ in range(200):
        x, v = rng.normal(size=(2, 6, 3))
        F, _ = points.forces(x, v, rng.normal(size=(6, 2)), np.ones(6, dtype=bool))
        assert F[:, 2].min() >= 0.0
        assert (np.linalg.norm(F[:, :2], axis=1) <= points.mu * F[:, 2] * (1.0 + 1e-12)).all()
        assert (F[x[:, 2] > 0.0] == 0.0).all()


def test_stuck_points_are_the_gradient_of_their_energy_and_only_dampers_take_power():
    points, rng, h = some_points()._replace(mu=np.full(6, 1e6)), np.random.default_rng(5), 1e-6
    x, roots, within = (
        rng.normal(size=(6, 3)) - (0.0, 0.0, 3.0),
        rng.normal(size=(6, 2)),
        np.ones(6, dtype=bool),
    )
    F, stored = points.forces(x, np.zeros((6, 3)), roots, within)
    assert stored == 0.0
    for index in np.ndindex(6, 3):
        step = np.zeros((6, 3))
        step[index] = h
        ahead, behind = (points.energy(x + sign * step, roots, within) for sign in (1, -1))
        assert_allclose((ahead - behind) / (2 * h), -F[index], rtol=1e-6, atol=1e-6)
    v = 1e-2 * rng.normal(size=(6, 3))
    damped, stored = points.forces(x, v, roots, within)
    dissipated = points.damping @ v[:, 2] ** 2 + points.shear_damping @ (v[:, :2] ** 2).sum(axis=1)
    assert_allclose((damped * v).sum() + stored, -dissipated, rtol=1e-9)


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_damping_of_a_patch_is_its_ratio_of_the_mobility_between_both_bodies(name, tmp_path):
    """2 zeta sqrt(k / W); torso and lift move both the palm and the payload that the other arm holds."""
    make, joints = {"planar": (planar_cell, ("rail", "yaw")), "spatial": (spatial_cell, ("lift", "yaw"))}[
        name
    ]
    cell = make(tmp_path, **{joint: SharedJoint() for joint in joints})
    palm = cp.PatchGrasp(xyz=(0.15, 0.01, 0.0), press="-x", mu=MU, radius=0.02, face=(0.1, 0.1))
    cell = cell.replace(grasps={"left": cell.grasps["left"], "right": palm})
    chain = CellChain(cell)
    model = chain.mechanism.model
    q = pin.integrate(model, pin.neutral(model), np.random.default_rng(6).normal(size=model.nv))
    chain.patches.damp(q)
    data = model.createData()
    M = np.triu(pin.crba(model, data, q))
    M += np.triu(M, 1).T
    frames = chain.model.arms[1].tip, model.getFrameId("payload/right")
    J_tip, J_face = (
        pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED) for frame in frames
    )
    pin.framesForwardKinematics(model, data, q)
    X_tip, X_face = (data.oMf[frame] for frame in frames)
    lever = pin.skew(X_tip.translation - X_face.translation)
    J = (X_face.rotation @ palm.plane[:3, :3]).T @ (J_tip[:3] - J_face[:3] + lever @ J_face[3:])
    W = np.diag(J @ np.linalg.solve(M, J.T))
    points, zeta = chain.patches.points, palm.damping_ratio
    assert_allclose(points.damping.sum(), 2.0 * zeta * np.sqrt(palm.stiffness / W[2]), rtol=1e-9)
    shear = 2.0 * zeta * np.sqrt(palm.shear_stiffness / W[:2].mean())
    assert_allclose(points.shear_damping.sum(), shear, rtol=1e-9)


@pytest.mark.parametrize("size", [(0.04, 0.04), (0.1, 0.02), (0.03, 0.12)])
def test_points_of_a_rectangle_have_the_torsion_of_an_even_pressure(size):
    """The mean distance from the middle, against a sum over small parts."""
    patch = cp.PatchGrasp(xyz=(-0.1, 0.0, 0.0), press="x", mu=0.5, size=size, face=(0.2, 0.2))
    x, y = (edge * ((np.arange(500) + 0.5) / 500 - 0.5) for edge in size)
    even = np.hypot(*np.meshgrid(x, y)).mean()
    assert_allclose(np.linalg.norm(patch.points, axis=1).mean(), even, rtol=1e-5)


def test_bristles_return_to_the_cone_once():
    points, rng = some_points(), np.random.default_rng(6)
    x, roots, within = rng.normal(size=(6, 3)), rng.normal(size=(6, 2)), np.ones(6, dtype=bool)
    x[0, 0], x[1, 2], x[2, 2] = 9.0, 1.0, -1e-3  # beyond the edge, above, on the plane
    settled, inside, slid = points.settled(x, roots, within)
    size = points.shear_stiffness * np.linalg.norm(x[:, :2] - settled, axis=1)
    assert (size <= points.mu * points.stiffness * np.maximum(-x[:, 2], 0.0) * (1 + 1e-12)).all()
    assert not inside[0]
    assert inside[1:].all()
    assert slid.min() >= 0.0
    assert slid[1] == 0.0
    assert slid[2] > 0.0
    again, _, none = points.settled(x, settled, inside)
    assert_allclose(again, settled, atol=1e-15)
    assert none.max() < 1e-15
    assert points.energy(x, settled, inside) <= points.energy(x, roots, within)
    below = x - (0.0, 0.0, 5.0)
    assert not points.settled(below, roots, inside & False)[1].any()  # passes under the plane


# ------------------------------------------------------------ a payload on a table
# Columns of a bench: 0 time, 1 to 3 position, 4 to 6 velocity, 7 to 9 rates, 10 normal force, 11 energy.


@pytest.mark.parametrize("name", TABLES)
def test_a_sliding_block_slows_down_by_mu_g(name):
    bench, v = Bench(name), 1.0
    start = (bench.chain.payload_pose(bench.plant.q)[:3, 3] @ bench.R)[0]
    bench.throw(linear=(v, 0.0, 0.0))
    rows = bench.run(0.3, 1e-3)
    assert_allclose(slope(rows, 4), -MU * G, rtol=1e-7)
    prestroke, distance = MU * MASS * G / 4e5, v**2 / (2.0 * MU * G)
    assert_allclose(rows[:, 1].max() - start, distance, rtol=1e-6)
    tilt = MU * MASS * G * 0.05**2 / (4e5 * 0.1**2)
    assert_allclose(rows[-1, 1] - start, distance - prestroke - tilt, atol=1e-6)  # springs back
    assert_allclose(bench.chain.patches.state.slip[1], distance - prestroke - tilt, atol=2e-6)
    assert rows[:, 10].min() >= 0.0
    assert np.abs(rows[:, 11]).max() < 1e-5  # of 1 J
    assert np.abs(rows[-1, 4:10]).max() < 1e-5


@pytest.mark.parametrize("name", TABLES)
def test_a_spinning_disc_slows_down_by_the_torsion_of_its_rim(name):
    bench, w = Bench(name, DISC), 30.0
    bench.throw(angular=(0.0, 0.0, w))
    rows = bench.run(0.1, 2.5e-4)  # w h is the angle that a bristle lags behind in a step
    assert_allclose(slope(rows, 9, 0.02, 0.1), -MU * MASS * G * 0.1 / (MASS * 0.1**2 / 2.0), rtol=1e-7)
    assert np.abs(rows[:, 11]).max() < 1e-5
    assert np.abs(rows[:, 4:6]).max() < 1e-6


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_a_stuck_block_does_not_creep(name):
    bench, limit = Bench(name), MU * MASS * G
    rows = bench.run(0.4, 1e-3, lambda t: (0.8 * limit * min(8.0 * t, 1.0), 0.0, 0.0))
    settled = rows[rows[:, 0] > 0.3, 1]
    assert np.ptp(settled) < 1e-12
    slip = bench.chain.patches.state.slip[1]
    assert slip < 1e-6  # of points that the tilting moment unloads
    shaken = bench.run(0.7, 1e-3, lambda t: (0.5 * limit * (1.0 + 0.8 * np.sin(80.0 * np.pi * t)), 0.0, 0.0))
    whole = shaken[24::25, 1]  # once a period
    assert abs(whole[-1] - whole[7]) < 5e-7  # in half a second


@pytest.mark.parametrize("name", TABLES)
def test_a_block_slides_at_mu_m_g(name):
    bench, limit = Bench(name), MU * MASS * G
    rows = bench.run(0.55, 1e-3, lambda t: (2.0 * limit * t, 0.0, 0.0))
    free = rows[rows[:, 0] > 0.51]
    since = free[:, 0] - 0.5  # m a = F - mu m g = 2 mu m g (t - t_0)
    assert_allclose(np.polyfit(since, np.gradient(free[:, 4], since), 1), (2.0 * MU * G, 0.0), atol=0.1)


@pytest.mark.parametrize(
    ("name", "k"), [pytest.param("planar", 2e5, marks=pytest.mark.slow), ("spatial", 1e5)]
)
def test_energy_of_a_fall_is_explained_the_better_the_smaller_the_step(name, k):
    left = []
    for h in (1e-3, 5e-4):
        bench = Bench(name, height=0.07, k=k)
        bench.throw(linear=(0.5, 0.0, 0.0), angular=(1.0, 0.5, 2.0))
        rows = bench.run(0.3, h)
        assert rows[:, 10].min() >= 0.0
        left.append(np.abs(rows[:, 11]).max())
    energy = 0.5 * MASS * 0.25 + MASS * G * 0.02
    assert left[0] < 5e-2 * energy
    assert np.log2(left[0] / left[-1]) > 1.5


def test_a_block_tips_over_an_edge_and_falls_past_the_table():
    bench = Bench("planar")
    bench.throw(linear=(6.0, 0.0, 0.0))  # 3.7 m: beyond the edge at 2 m
    rows = bench.run(0.8, 1e-3)
    assert rows[-1, 3] < rows[0, 3] - 0.3
    assert np.isfinite(rows).all()
    assert rows[-1, 10] == 0.0
    assert np.abs(rows[:, 8]).max() > 0.1  # it turned about the edge


def test_restored_bristles_go_on_with_the_same_bits():
    bench = Bench("spatial")
    bench.throw(linear=(0.3, 0.1, 0.0))
    bench.run(0.02, 1e-3)
    state, time = bench.plant.state(), bench.time
    once = bench.run(0.05, 1e-3)
    bench.plant.restore(state)
    bench.time = time
    assert_array_equal(bench.run(0.05, 1e-3), once)


# ------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("fields", "path"),
    [
        ({"mu": 0.0}, "mu"),
        ({"mu": -0.5}, "mu"),
        ({"radius": 0.0}, "radius"),
        ({"radius": None}, "radius"),
        ({"size": (0.01, 0.01)}, "radius"),
        ({"radius": 0.08}, "radius"),
        ({"radius": None, "size": (0.01, 0.3)}, "size"),
        ({"xyz": (-0.15, 0.0, 0.0)}, "xyz"),
        ({"rpy": (0.0, 0.0, 0.1)}, "xyz"),
        ({"press": "-x"}, "xyz"),
    ],
)
def test_patches_that_cannot_be_are_refused(fields, path):
    cell = cp.Scenario.load("two-pandas-box").cell
    box = {"kind": "box", "mass": 2.0, "size": (0.2, 0.2, 0.1)}
    patch = {"kind": "patch", "xyz": (-0.1, 0.0, 0.0), "press": "x", "mu": 0.5, "radius": 0.02}
    grasps = {"left": patch, "right": patch | {"xyz": (0.1, 0.0, 0.0), "press": "-x"}}
    held = cell.replace(payload=box, grasps=grasps)
    assert list(held.patches) == list(held.unclosed) == ["left", "right"]
    with pytest.raises(CoopPinError) as error:
        cell.replace(payload=box, grasps=grasps | {"left": patch | fields})
    assert path in str(error.value)


def test_faces_of_other_payloads_must_be_stated():
    cell = cp.Scenario.load("two-pandas-box").cell
    patch = {"kind": "patch", "xyz": (-0.1, 0.0, 0.0), "press": "x", "mu": 0.5, "radius": 0.02}
    grasps = {"left": patch, "right": patch | {"xyz": (0.1, 0.0, 0.0), "press": "-x"}}
    with pytest.raises(FieldError, match="face"):
        cell.replace(payload=DISC, grasps=grasps)
    cell.replace(
        payload=DISC, grasps={name: grasp | {"face": (0.05, 0.05)} for name, grasp in grasps.items()}
    )


def test_batches_and_rigid_methods_refuse_contacts_in_words():
    scenario = cp.Scenario.load("adept-anchored", {"plant.payload": "welded"})
    table = cp.Table(xyz=(0.0, 0.0, -2.0), size=(1.0, 1.0), mu=0.4)
    scenario = scenario.replace(cell=scenario.cell.replace(tables={"below": table}))
    assert "friction" in (support(scenario) or "")
    with pytest.raises(ArgumentError, match="tables"):
        scenario.cell.require_rigid("this")
    scenario.cell.rigid.require_rigid("this")
    with pytest.raises(FieldError, match="rk4"):
        scenario.override({"plant.integrator": "semi-implicit-euler"})
    with pytest.raises(CoopPinError, match="mu"):
        scenario.override({"cell.tables.below.mu": 0.0})
