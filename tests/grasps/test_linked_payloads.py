"""Payloads of several links: accelerations by an own KKT and MuJoCo's matrices, energy, statics, laws."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from joint_cells import jointed
from linked_cells import (
    PAYLOADS,
    box_with_lid,
    door,
    hanging_rope,
    joint,
    lid_with_a_stop,
    link,
    linked,
    pulled_rope,
    random_state,
)
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError, InfeasibleMotionError
from coop_pin.base.spatial import FullRows
from coop_pin.compiled.kind import pinocchio_reason
from coop_pin.description.urdf import find_urdf
from coop_pin.grasps import CellChain
from coop_pin.running.payload_findings import payload_findings
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.simulation import Simulation

CELLS = ("adept-anchored", "two-pandas-box")
LWA = pin.LOCAL_WORLD_ALIGNED


class OwnTree:
    """Arms and payload joined by raw Pinocchio, and the closures between their frames by numpy.

    q and v are in the order of a cell's tree, by the names of joints.
    """

    def __init__(self, scenario: cp.Scenario, chain: CellChain) -> None:
        cell, links = scenario.cell, scenario.cell.payload.links
        whole = pin.Model()
        for name, arm in cell.arms.items():
            model = pin.buildModelFromUrdf(str(find_urdf(arm.urdf).path))
            locked = [k for k, joint in enumerate(model.names) if k and joint not in arm.moving_joints()]
            q = pin.neutral(model)
            for index in locked:  # fingers follow the first one
                q[model.idx_qs[index]] = next(iter(arm.locked.values()))
            model = pin.buildReducedModel(model, locked, q) if locked else model
            whole = self._appended(whole, model, f"{name}/", arm.base.matrix)
        part = (
            pin.buildModelFromXML(links.text)
            if links.base is not None
            else pin.buildModelFromXML(links.text, pin.JointModelFreeFlyer())
        )
        at_start = part.createData()
        q = pin.neutral(part)
        for name, angle in links.start.items():
            q[part.idx_qs[part.getJointId(name)]] = angle
        pin.framesForwardKinematics(part, at_start, q)
        whole = self._appended(whole, part, "own.", np.eye(4) if links.base is None else links.base.matrix)
        whole.gravity.linear = np.array(cell.gravity)
        self.model, self.data, self.pairs = whole, whole.createData(), []
        centre = links.bodies[links.link].centre
        X_P = at_start.oMf[part.getFrameId(f"own.{links.link}")] * pin.SE3(np.eye(3), centre)
        for name, grasp in cell.grasps.items():
            held = cell.held_links.get(name, links.link)
            X_LE = at_start.oMf[part.getFrameId(f"own.{held}")].actInv(X_P * pin.SE3(grasp.matrix))
            tip = whole.getFrameId(f"{name}/{cell.arms[name].tip}")
            self.pairs.append((tip, whole.getFrameId(f"own.{held}"), X_LE))
        self.order_v, self.order_q = self._orders(chain.mechanism.model)

    @staticmethod
    def _appended(whole: pin.Model, part: pin.Model, prefix: str, X: np.ndarray) -> pin.Model:
        for index in range(1, part.njoints):
            part.names[index] = prefix + part.names[index]
        for frame in part.frames:
            frame.name = prefix + frame.name
        joined = pin.appendModel(whole, part, 0, pin.SE3(X))
        joined.armature = np.concatenate((whole.armature, part.armature))
        return joined

    def _orders(self, tree: pin.Model) -> tuple[np.ndarray, np.ndarray]:
        """Entries of the cell's v and q for those of this tree."""
        rows_v, rows_q = [], []
        for index in range(1, self.model.njoints):
            name = str(self.model.names[index])
            name = {"own.root_joint": "payload"}.get(name, name.replace("own.", "payload."))
            other = tree.getJointId(name)
            rows_v += range(tree.idx_vs[other], tree.idx_vs[other] + tree.nvs[other])
            rows_q += range(tree.idx_qs[other], tree.idx_qs[other] + tree.nqs[other])
        return np.array(rows_v), np.array(rows_q)

    def closures(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J and its rate times v, of the relative motion of tip and grasp in world axes at the grasp."""
        model, data, J, rates = self.model, self.data, [], []
        pin.forwardKinematics(model, data, q, v, 0.0 * v)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        for tip, held, X_LE in self.pairs:
            r = data.oMf[held].rotation @ X_LE.translation
            J_L = pin.getFrameJacobian(model, data, held, LWA)
            J_L = np.vstack((J_L[:3] - pin.skew(r) @ J_L[3:], J_L[3:]))
            J.append(pin.getFrameJacobian(model, data, tip, LWA) - J_L)
            A = pin.getFrameClassicalAcceleration(model, data, tip, LWA).vector
            A_L = pin.getFrameClassicalAcceleration(model, data, held, LWA).vector
            w = pin.getFrameVelocity(model, data, held, LWA).angular
            A_L[:3] += np.cross(A_L[3:], r) + np.cross(w, np.cross(w, r))
            rates.append(A - A_L)
        return np.vstack(J), np.concatenate(rates)

    def acceleration(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """a of the KKT system, by least squares where closures are redundant."""
        J, rate = self.closures(q, v)
        M = pin.crba(self.model, self.data, q)
        M = np.triu(M) + np.triu(M, 1).T
        h = pin.rnea(self.model, self.data, q, v, 0.0 * v)
        return kkt(M, J, rate, tau - h)


def kkt(M: np.ndarray, J: np.ndarray, rate: np.ndarray, force: np.ndarray) -> np.ndarray:
    free, MJ = np.linalg.solve(M, force), np.linalg.solve(M, J.T)
    return free + MJ @ np.linalg.lstsq(J @ MJ, -rate - J @ free, rcond=1e-10)[0]


def unstabilised(name: str, kind: str, **changes) -> tuple[cp.Scenario, CellChain, np.ndarray]:
    scenario = linked(name, kind, **{"plant.stabilisation.frequency": 0.0, **changes})
    chain = CellChain(scenario.cell, scenario.plant)
    return scenario, chain, chain.configuration(scenario.start.matrix)


@pytest.mark.parametrize("kind", PAYLOADS)
@pytest.mark.parametrize("name", CELLS)
def test_accelerations_are_those_of_an_own_kkt_system(name, kind):
    scenario, chain, start = unstabilised(name, kind)
    own = OwnTree(scenario, chain)
    for seed, speed in ((0, 0.0), (1, 0.5)):
        q, v, tau = random_state(chain, start, seed, speed)
        a = chain.acceleration(q, v, tau)[0]
        expected = own.acceleration(q[own.order_q], v[own.order_v], tau[own.order_v])
        scale = np.abs(expected).max()
        assert np.abs(a[own.order_v] - expected).max() / scale < (1e-10 if speed == 0.0 else 1e-8)


def mjcf(model: pin.Model, pairs) -> str:
    """The tree of hinges and at most one free body in the same joint frames, with welds at the grasps."""

    def numbers(values) -> str:
        return " ".join(repr(float(each)) for each in np.ravel(list(values)))

    def turn(R) -> str:
        return numbers(np.roll(pin.Quaternion(R).coeffs(), 1))

    sites = {}
    for index, (tip, held, X_LE) in enumerate(pairs):
        for frame, X, name in ((tip, pin.SE3.Identity(), f"a{index}"), (held, X_LE, f"b{index}")):
            placed = model.frames[frame]
            sites.setdefault(int(placed.parentJoint), []).append((name, placed.placement * X))

    def body(index: int) -> str:
        X, inertia = model.jointPlacements[index], model.inertias[index]
        kind, about = model.joints[index].shortname(), inertia.inertia
        axis = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}.get(kind[-1])
        freedom = "<freejoint/>" if "Free" in kind else f'<joint axis="{axis}"/>'
        full = numbers(about[row] for row in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        inside = "".join(
            f'<site name="{name}" pos="{numbers(S.translation)}" quat="{turn(S.rotation)}"/>'
            for name, S in sites.get(index, [])
        )
        inside += "".join(body(k) for k in range(1, model.njoints) if model.parents[k] == index)
        return (
            f'<body name="j{index}" pos="{numbers(X.translation)}" quat="{turn(X.rotation)}">{freedom}'
            f'<inertial pos="{numbers(inertia.lever)}" mass="{inertia.mass!r}" fullinertia="{full}"/>'
            f"{inside}</body>"
        )

    bodies = "".join(body(k) for k in range(1, model.njoints) if model.parents[k] == 0)
    welds = "".join(f'<weld site1="a{k}" site2="b{k}"/>' for k in range(len(pairs)))
    return (
        f'<mujoco><compiler balanceinertia="false"/><option gravity="{numbers(model.gravity.linear)}"><flag'
        f' contact="disable"/></option><worldbody>{bodies}</worldbody><equality>{welds}</equality></mujoco>'
    )


def by_mujoco(own: OwnTree, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """a of the KKT system of MuJoCo's M, bias and weld Jacobian, whose rate is a difference along v."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(own.model, own.pairs))
    data, tree = mujoco.MjData(model), own.model
    free = next((j for j in tree.joints if j.nq == 7), None)

    def at(step: float):
        x, twist = pin.integrate(tree, q, step * v), v.copy()
        if free is not None:  # w, x, y, z; linear velocity in the world
            k, kv = free.idx_q, free.idx_v
            R = pin.XYZQUATToSE3(x[k : k + 7]).rotation
            x = np.concatenate((x[: k + 3], x[k + 6 : k + 7], x[k + 3 : k + 6], x[k + 7 :]))
            twist[kv : kv + 3] = R @ v[kv : kv + 3]
        data.qpos, data.qvel = x, twist
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, M)
        return M, data.efc_J.reshape(-1, model.nv).copy(), data.qfrc_bias.copy(), twist

    M, J, bias, twist = at(0.0)
    rate, force = (at(1e-4)[1] - at(-1e-4)[1]) @ twist / 2e-4, tau.copy()
    if free is None:
        return kkt(M, J, rate, force - bias)
    k, kv = free.idx_q, free.idx_v
    R = pin.XYZQUATToSE3(q[k : k + 7]).rotation
    force[kv : kv + 3] = R @ tau[kv : kv + 3]
    a = kkt(M, J, rate, force - bias)
    a[kv : kv + 3] = R.T @ a[kv : kv + 3] - np.cross(v[kv + 3 : kv + 6], v[kv : kv + 3])
    return a


@pytest.mark.parametrize("kind", PAYLOADS)
@pytest.mark.parametrize("name", CELLS)
def test_accelerations_are_those_of_mujocos_matrices(name, kind):
    """Its rate of the Jacobian is a difference: 1e-10 at rest, 1e-8 moving."""
    scenario, chain, start = unstabilised(name, kind)
    own = OwnTree(scenario, chain)
    for seed, speed in ((2, 0.0), (3, 0.3)):
        q, v, tau = random_state(chain, start, seed, speed)
        a = chain.acceleration(q, v, tau)[0][own.order_v]
        expected = by_mujoco(own, q[own.order_q], v[own.order_v], tau[own.order_v])
        assert np.abs(a - expected).max() / np.abs(expected).max() < (1e-10 if speed == 0.0 else 1e-8)


@pytest.mark.parametrize("kind", PAYLOADS)
@pytest.mark.parametrize("name", CELLS)
def test_energy_of_joints_is_in_the_balance_and_the_start_is_at_rest(name, kind):
    """Springs, dampers, friction and stops of the payload while it is shaken; the start does not move."""
    scenario, chain, q = unstabilised(name, kind)
    assert max(map(max, chain.closure_errors(q))) < 1e-9
    plant, arms = PinocchioPlant(chain, scenario.plant, q), zip(chain.model.arms, chain.arms, strict=True)
    loads, hold = chain.loads(q), []
    for (slot, arm), F in zip(arms, loads, strict=True):
        angles = q[slot.q_slice]
        J, weight = arm.payload_jacobian(angles), arm.nonlinear_effects(angles, np.zeros(arm.nv))
        hold.append(arm.from_drive.T @ (weight - J.T @ F))
    plant.drive(hold)
    a = chain.acceleration(q, plant.v, plant.generalised_force())[0]
    assert np.abs(a).max() < 1e-6
    energies = []
    for tick in range(60):
        plant.drive([torque * (1.0 + 0.05 * np.sin(0.3 * tick)) + 0.2 for torque in hold])
        plant.advance(1e-3 * tick, 1e-3)
        seen = plant.observe(plant.q[None], plant.v[None], plant.force[None], np.array([1e-3 * (tick + 1)]))
        stored = seen.kinetic_energy + seen.potential_energy + seen.payload_joint_energy
        energies.append(float(stored[0]) - plant.work.sum())
    assert np.ptp(energies) < 2e-8  # the beam's fastest mode at steps of 1 ms
    assert plant.work[-1] < 0.0  # what joints of the payload lose


@pytest.mark.parametrize("name", CELLS)
def test_arms_carry_the_weight_of_all_links_with_its_moment(name):
    """Of a free payload c_i [m g, r x m g]; of a door on a vertical hinge nothing."""
    scenario, chain, q = unstabilised(name, "lid", **{"cell.gravity": (0.3, -1.0, -9.0)})
    own, g = OwnTree(scenario, chain), np.array(scenario.cell.gravity)
    model, data = own.model, own.data
    pin.forwardKinematics(model, data, q[own.order_q])
    P, W = chain.payload_pose(q)[:3, 3], np.zeros(6)
    for index, name_of in enumerate(model.names):
        if name_of.startswith("own."):
            r = data.oMi[index].act(model.inertias[index].lever) - P
            W += model.inertias[index].mass * np.concatenate((g, np.cross(r, g)))
    assert_allclose(
        chain.joints.loads(q, chain.payload_pose(q)), np.outer(scenario.cell.shares, W), atol=1e-9
    )
    _, chain, q = unstabilised(name, "door", **{"cell.gravity": (0.0, 0.0, -9.81)})
    assert_allclose(chain.loads(q), 0.0, atol=1e-12)


def test_bodies_of_a_beam_are_its_rods_and_a_link_without_mass_has_none(tmp_path):
    """The end rods have half the length; each is a homogeneous box."""
    bodies = cp.Payload.beam(mass=3.0, length=2.0, bending_stiffness=100.0, links=5).links.bodies
    assert_allclose([body.mass for body in bodies.values()], (0.375, 0.75, 0.75, 0.75, 0.375))
    for body, length in zip(bodies.values(), (0.25, 0.5, 0.5, 0.5, 0.25), strict=True):
        box = pin.Inertia.FromBox(body.mass, length, 0.1, 0.02)
        assert_allclose(body.inertia, box.inertia, rtol=1e-12)
        assert_allclose(body.centre, (length / 2.0, 0.0, 0.0), rtol=1e-12)
    (tmp_path / "door.urdf").write_text(door())
    frame = cp.Payload.of_links(tmp_path / "door.urdf", "leaf", base=cp.Pose()).links.bodies["frame"]
    assert frame.mass == 0.0
    assert (frame.inertia.shape, frame.centre.shape) == ((3, 3), (3,))
    assert not frame.inertia.any()
    assert not frame.centre.any()


@pytest.mark.parametrize("name", CELLS)
def test_a_load_beside_a_base_does_the_work_of_the_whole_one_at_least_cost(name):
    """Of all W' with s^T W' = s^T W that of least W'^T Q W', Q = diag(1, 1, 1, 1/l^2, 1/l^2, 1/l^2)."""
    cell, root_Q = linked(name, "door", **{"cell.split_length": 0.3}).cell, np.repeat((1.0, 1.0 / 0.3), 3)
    s, L = cell.payload.links.freedom, cell.loads_within([True, True])
    assert_allclose(s, (0.0, 0.2, 0.0, 0.0, 0.0, 1.0), atol=1e-9)
    W = np.random.default_rng(0).normal(size=6)
    least = np.linalg.lstsq((s / root_Q)[None], [s @ W])[0] / root_Q
    assert_allclose(L.sum(axis=0) @ W, least, atol=1e-9)


@pytest.mark.parametrize("name", CELLS)
def test_the_load_of_free_links_is_split_as_that_of_one_body(name):
    """Grasps and shares alone tell what each arm can bear."""
    body = jointed(name, {"left": "hinge", "right": "hinge"}).cell
    links = linked(name, "lid").cell
    joined = body.replace(payload=links.payload, pads={})
    assert_allclose(joined.loads_within([True, True]), body.loads_within([True, True]), rtol=1e-12)
    alone = jointed(name, {"right": "hinge"}).cell
    assert_allclose(alone.loads_within([True, False]), np.eye(6)[None], atol=1e-12)
    np.testing.assert_array_equal(alone.grasp_rows("left").X_PC, np.eye(4))


def test_what_a_linked_payload_does_not_go_with_is_refused_by_name():
    scenario = linked("two-pandas-box", "beam")
    cell = scenario.cell
    with pytest.raises(FieldError, match="rod9"):
        cell.replace(grasps={**cell.grasps, "left": {**cell.grasps["left"].model_dump(), "link": "rod9"}})
    soft = {**cell.grasps["left"].model_dump(exclude={"link"}), "kind": "compliant", "stiffness": "firm"}
    with pytest.raises(FieldError, match="several links"):
        cell.replace(grasps={**cell.grasps, "left": soft})
    with pytest.raises(FieldError, match="only one"):
        cp.Scenario.load("two-pandas-box").cell.replace(grasps=cell.grasps)
    with pytest.raises(FieldError, match="hinges"):
        cp.Payload.of_links(door(), "leaf", joints={"hinges": {"stiffness": 1.0}})
    with pytest.raises(FieldError, match="no mass"):
        cp.Payload.of_links(door(), "frame")
    with pytest.raises(FieldError, match="one joint moves"):
        cp.Payload.of_links(box_with_lid(), "box", base={"xyz": (0.0, 0.0, 0.0)})
    with pytest.raises(ArgumentError, match="several links"):
        cell.require_rigid("this")
    assert "hinge1" in str(pinocchio_reason(scenario))
    with pytest.raises(InfeasibleMotionError, match="freedoms"):
        cp.suggest(linked("adept-anchored", "door"), poses=5)
    taut = {"kind": "chain", "mass": 0.5, "length": 0.24, "links": 9, "axis": "z"}
    changes = {"cell.payload": taut, "cell.grasps.right.link": "rod8"}
    with pytest.raises(FieldError, match="straight"):
        cp.suggest(linked("adept-anchored", "beam", **changes), poses=5)
    hinged = cell.replace(
        grasps={**cell.grasps, "left": {**cell.grasps["left"].model_dump(), "kind": "hinge"}}
    )
    assert hinged.rigid.held_links == cell.held_links
    assert not hinged.rigid.jointed
    off = linked("two-pandas-box", "door").override({"start.xyz": (0.0, 0.0, 0.45)})
    chain = CellChain(off.cell, off.plant)
    with pytest.raises(FieldError, match="from where"):
        chain.configuration(off.start.matrix)


def test_links_that_nobody_holds_are_found():
    held = linked("two-pandas-box", "beam")
    kinds = {finding.kind for finding in payload_findings(Simulation(held))}
    assert kinds == {"payload mode"}
    for g, loose in ((-9.81, 0), (0.0, 8)):  # its weight returns all hinges of a rope
        rope = Simulation(hanging_rope(**{"cell.gravity": (0.0, 0.0, g)}))
        assert sum("nothing returns" in finding.sentence for finding in payload_findings(rope)) == loose
    box = cp.Payload.of_links(box_with_lid(), "box", joints={"hinge": {"damping": 1e-4}})
    loose = cp.Scenario.load("two-pandas-box")
    loose = loose.replace(cell=loose.cell.replace(payload=box))
    by_kind = {finding.kind: finding for finding in payload_findings(Simulation(loose))}
    assert by_kind["unheld link"].severity == "warning"
    inertia = 0.5 * 0.16**2 / 12.0 + 0.5 * 0.01**2 / 12.0 + 0.5 * 0.08**2
    frequency = np.sqrt(0.5 * 9.81 * 0.08 / inertia) / (2.0 * np.pi)
    assert by_kind["payload mode"].value == pytest.approx(frequency, rel=2e-3)


@pytest.mark.gate
@pytest.mark.parametrize("name", CELLS)
def test_engine_mujoco_moves_the_links_alike(name):
    """Its welds give: poses and angles to 1e-7, wrenches to 5 mN."""
    pytest.importorskip("mujoco")
    scenario = linked(name, "lid", duration=0.5)
    scenario = scenario if name == CELLS[0] else scenario.override({"motion.start_time": 0.0})
    ours, theirs = (cp.run(scenario, engine=engine, warn=False).data for engine in ("pinocchio", "mujoco"))
    assert np.ptp(ours["payload_joint_position"].values) > 1e-4
    for quantity, allowed in (
        ("payload_position", 1e-7),
        ("payload_joint_position", 1e-7),
        ("payload_joint_force", 1e-5),
        ("interaction_wrench", 5e-3),
    ):
        assert_allclose(theirs[quantity].values, ours[quantity].values, rtol=0.0, atol=allowed)


@pytest.mark.parametrize(
    ("part", "ratio", "severity"),
    [
        (0.245, 0.0, "note"),
        (0.255, 0.0, "warning"),
        (0.5, 0.049, "warning"),
        (0.5, 0.051, "note"),
        (1.96, 0.0, "warning"),
        (2.04, 0.0, "note"),
    ],
)
@pytest.mark.parametrize("name", CELLS)
def test_a_mode_between_a_quarter_and_twice_the_control_rate_that_is_not_damped_is_warned_of(
    name, part, ratio, severity
):
    """I w^2 = k + m g l of a flap that hangs straight from a still box, c = 2 zeta sqrt(I (k + m g l))."""
    is_planar = name.startswith("adept")
    rate = cp.Scenario.load(name).clock.rate_hz
    if is_planar:  # the hinge is upright, through the flap's centre
        inertia, pull = 0.5 * (0.4**2 + 0.01**2) / 12.0, 0.0
    else:
        inertia, pull = 0.5 * (0.01**2 + 0.16**2) / 12.0 + 0.5 * 0.08**2, 0.5 * 9.81 * 0.08
    w = 2.0 * np.pi * part * rate
    hinge = {"stiffness": inertia * w**2 - pull, "rest": 0.0, "damping": 2.0 * ratio * inertia * w}
    simulation = Simulation(lid_with_a_stop(name, 2.0, friction=0.0, **hinge))
    mode = next(finding for finding in payload_findings(simulation) if finding.kind == "payload mode")
    assert (mode.severity, mode.limit) == (severity, rate)
    assert_allclose(mode.value, part * rate, rtol=1e-6)
    assert f"damping ratio {ratio:.2g}" in mode.sentence or ratio == 0.0


def mobility(M: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Speed of each coordinate after a unit impulse on it, with J v = 0."""
    _, sizes, rows = np.linalg.svd(J)
    N = rows[int((sizes > 1e-10 * sizes[0]).sum()) :].T
    return np.diag(N @ np.linalg.solve(N.T @ M @ N, N.T))


@pytest.mark.parametrize("kind", ["lid", "table", "door"])
@pytest.mark.parametrize("name", CELLS)
def test_a_joint_swings_at_30_per_second_on_its_default_stop_in_nobodys_hands_and_slower_in_grasps(
    name, kind
):
    scenario, chain, q = unstabilised(name, kind)
    own, links = OwnTree(scenario, chain), scenario.cell.payload.links
    ((_, stops),) = chain.stops
    text = links.text
    part = (
        pin.buildModelFromXML(text) if links.base else pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    )
    M = pin.crba(part, part.createData(), pin.neutral(part))
    W_free = np.linalg.inv(np.triu(M) + np.triu(M, 1).T)[-1, -1]
    assert_allclose(stops.stiffness * W_free, 30.0**2, rtol=1e-12)
    J, _ = own.closures(q[own.order_q], np.zeros(own.model.nv))
    M = pin.crba(own.model, own.data, q[own.order_q])
    W = mobility(np.triu(M) + np.triu(M, 1).T, J)[-1]
    rate = chain.stops.rates(chain.joint_mobility(q))[chain.model.linked.v_slice]
    assert_allclose(rate, np.sqrt(stops.stiffness * W), rtol=1e-8)
    assert rate < 30.0
    PinocchioPlant(chain, scenario.plant, q)
    ((_, damped),) = chain.stops
    assert_allclose(damped.damping * W, rate, rtol=1e-8)  # 2 zeta = 1


@pytest.mark.gate
@pytest.mark.parametrize(
    ("name", "upper", "events"),
    [
        ("adept-anchored", 0.1002, []),  # the motion swings it into its stop
        ("two-pandas-box", 0.15, [{"kind": "gravity-turn", "time": 0.05, "gravity": (0.0, 3.0, -9.0)}]),
    ],
)
def test_a_stop_too_stiff_for_the_steps_is_found_and_its_remedy_makes_the_run_sound(name, upper, events):
    short = {"duration": 0.4, "events": events}
    stiff, default = (
        lid_with_a_stop(name, upper, friction=0.0, **stop).override(short)
        for stop in ({"stop_stiffness": 2000.0}, {})
    )
    assert not cp.run(stiff, warn=False).simulation_sound
    (finding,) = cp.check(stiff, poses=3).of("error")
    assert (finding.kind, "payload/hinge" in finding.sentence) == ("plant steps", True)
    chain = CellChain(stiff.cell, stiff.plant)
    W = chain.joint_mobility(chain.configuration(stiff.start.matrix))[chain.model.linked.v_slice]
    h = stiff.clock.period / stiff.clock.steps_per_tick
    assert finding.value == pytest.approx(h * np.sqrt(2000.0 * W[0]), rel=1e-2)  # the worst pose
    for run in (cp.run(scenario, warn=False) for scenario in (stiff.override(finding.remedy), default)):
        assert run.simulation_sound, run.verdict()
        assert run.data["work_stops"].values[-1] < -1e-6
        force, depth = (run.data[f"payload_joint_{key}"].values[:, 0] for key in ("force", "position"))
        assert depth.max() > upper
        assert force[depth.argmax()] < -5e-3


@pytest.mark.gate
def test_a_sound_link_that_hangs_in_the_plane_is_no_error():
    """Nothing returns its joint, which falls back as the motion starts; the loop about rest is sound."""
    parts = link("box", 2.5, (0, 0, 0), (0.26, 0.2, 0.1)) + link(
        "bob", 0.5, (0, -0.08, 0), (0.01, 0.16, 0.01)
    )
    hinge = joint("hinge", "box", "bob", (0, 0, 0), (0, 0, 1))
    free = {"kind": "links", "path": f'<robot name="box">{parts}{hinge}</robot>', "link": "box"}
    scenario = linked("adept-anchored", "lid").override({"cell.payload": free})
    assert cp.stability.eigenvalues(scenario).structural == ("payload's joint hinge",) * 2  # angle and rate
    findings = cp.check(scenario, poses=11)
    assert {finding.kind for finding in findings if finding.severity == "warning"} == {"unheld link"}
    assert findings.ok


@pytest.mark.parametrize("name", CELLS)
def test_a_rope_between_two_arms_rests_at_its_polygon_and_pulls_as_a_catenary(name):
    errors = []
    for n in (9, 17, 33):
        scenario, pull, of_catenary = pulled_rope(name, n)
        errors.append(pull / of_catenary - 1.0)
        if n > 9:
            continue
        chain, links = CellChain(scenario.cell, scenario.plant), scenario.cell.payload.links
        q, X_WP = chain.configuration(scenario.start.matrix), scenario.start.matrix
        assert_allclose(chain.joints.positions(q), [*links.start.values()], rtol=0.0, atol=1e-9)
        loads = chain.loads(q)
        assert_allclose(loads[:, 0], (pull, -pull), rtol=1e-8)
        assert_allclose(loads[:, 1 if name == "adept-anchored" else 2], -0.3 * 9.81, rtol=1e-9)
        disturbed = q.copy()
        disturbed[chain.joints.linked.q_slice] *= 0.97  # and Newton's method comes back
        again = chain.joints.positions(chain.joints.at_rest(disturbed, X_WP))
        assert_allclose(again, [*links.start.values()], rtol=0.0, atol=1e-9)
    assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.1)


@pytest.mark.gate
@pytest.mark.parametrize("name", CELLS)
def test_a_rope_that_two_arms_pull_keeps_the_pull_of_its_closed_form(name):
    scenario, pull, _ = pulled_rope(name, 9)
    chain = CellChain(scenario.cell, scenario.plant)
    loads = chain.loads(chain.configuration(scenario.start.matrix))
    internal = (loads - loads.mean(axis=0)).round(12)
    squeeze = dict(zip(scenario.cell.arms, internal.tolist(), strict=True))
    pose = scenario.start.model_dump()
    goal = pose | {"xyz": tuple(np.add(pose["xyz"], (0.0, 0.02, 0.0)))}
    line = {"kind": "line", "start": pose, "goal": goal, "start_time": 0.2, "duration": 1.5}
    proposed = cp.suggest(scenario.override({"squeeze": squeeze, "motion": line, "duration": 3.0}), poses=5)
    result = cp.run(proposed.scenario, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    pulls, time = result.data["internal_wrench"].values[:, 0, 0], result.data["time"].values
    assert_allclose(pulls[time < 0.2], pull, rtol=1e-8)
    assert_allclose(pulls[-1], pull, rtol=1e-2)


def test_a_straight_rope_has_no_pull_that_bears_it():
    straight = {"kind": "chain", "mass": 0.5, "length": 0.4, "links": 5}
    scenario = linked("two-pandas-box", "beam", **{"cell.payload": straight})
    with pytest.raises(FieldError, match="straight"):
        CellChain(scenario.cell, scenario.plant).configuration(scenario.start.matrix)


def opened(arms: int, **changes) -> cp.RunResult:
    fields = cp.Scenario.load("two-pandas-door").model_dump()
    if arms == 1:
        for part in (fields["cell"]["arms"], fields["cell"]["grasps"]):
            part.pop("left")
        fields["squeeze"] = {"right": (0.0,) * 6}
    return cp.run(cp.Scenario(**fields).override(changes))


@pytest.mark.gate
def test_a_mode_of_a_joint_of_the_payload_is_its():
    loop = cp.stability.eigenvalues(linked("adept-anchored", "lid"))
    names = {mode.name for mode in loop.modes}
    assert "payload's joint hinge" in names
    assert not any(name.startswith("posture") for name in names)  # three joints hold the payload's three rows


@pytest.mark.slow
@pytest.mark.parametrize("arms", [1, 2])
def test_a_door_is_opened_by_sixty_degrees(arms):
    result = opened(arms)
    angle = result.data.payload_joint_position.sel(payload_joint="hinge").values
    assert np.degrees(angle[-1] - angle[0]) == pytest.approx(60.0, abs=0.01)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert result.energy_balance_max() < 1e-8
    data = result.data.isel(time=-1)  # with one arm nothing is internal but what presses the hinge
    assert_allclose(data.internal_wrench.values, data.desired_internal_wrench.values, rtol=1e-2, atol=1e-3)


@pytest.mark.slow
def test_a_bias_beside_a_base_leaves_the_internal_wrench_of_its_formula():
    """f_i = (k_I gamma / beta) c_i K (b_i + s x), with the x at which sum_i s^T c_i K (b_i + s x) = 0."""
    still = {"duration": 6.0, "motion.start_time": 5.9, "motion.duration": 1.0}
    result = opened(2, **still, **{"cell.arms.left.calibration_error.tip.xyz": (1e-3, 0.0, 0.0)})
    scenario, at = result.scenario, -80
    law, R = scenario.controller, scenario.start.matrix[:3, :3]
    gains = law.gains.sized(6, 0)
    rate = gains.sign_gain / law.switching.width * gains.pose_gain[0, 0]
    K = gains.sliding_gain @ rate * scenario.clock.period / gains.anchor_gain
    seen = result.data.seen_pose_error.values[at]
    s = np.kron(np.eye(2), R) @ scenario.cell.payload.links.freedom
    b = seen - result.data.pose_error.values[at]
    x = -sum(0.5 * s @ K @ each for each in b) / (s @ K @ s)
    expected = np.array([0.5 * K @ (each + s * x) for each in b])
    assert np.abs(expected).max() > 0.05
    error = result.data.internal_wrench.values[at] - result.data.desired_internal_wrench.values[at]
    assert_allclose(error, expected, rtol=1e-2, atol=1e-3)


@pytest.mark.slow
def test_a_box_with_a_swinging_lid_is_carried():
    scenario = cp.Scenario.load("two-pandas-box")
    box = cp.Payload.of_links(box_with_lid(), "box")
    result = cp.run(scenario.replace(cell=scenario.cell.replace(payload=box), events=()))
    swing = result.data.payload_joint_position.sel(payload_joint="hinge").values
    assert np.ptp(swing) > 2e-3
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert result.energy_balance_max() < 1e-8
    error = result.data.internal_wrench.values[-1] - result.data.desired_internal_wrench.values[-1]
    assert np.abs(error).max() < 1e-3


def test_links_are_drawn_where_they_are(tmp_path):
    from coop_pin.model.visuals import CellVisuals

    scenario = linked("two-pandas-box", "lid")
    chain = CellChain(scenario.cell, scenario.plant)
    visuals = CellVisuals(scenario.cell, scenario.plant.payload)
    q = chain.configuration(scenario.start.matrix)
    (index,) = [k for k, body in enumerate(visuals.bodies) if body.name == "payload/links.hinge"]
    angle = chain.joints.positions(q)[0]
    X_WP = pin.SE3(chain.payload_pose(q))
    hinge = pin.SE3(pin.rpy.rpyToMatrix(angle, 0, 0), np.array((0, 0.11, 0.05)))
    assert_allclose(visuals.poses(q[None])[0, index], pin.SE3ToXYZQUAT(X_WP * hinge), atol=1e-12)
    cp.viz.save_replay(cp.run(scenario.replace(duration=0.02)), tmp_path / "lid.html")
    assert "arms/payload/links.hinge" in (tmp_path / "lid.html").read_text(encoding="utf-8")


def beam_of_two_metres() -> cp.Scenario:
    """Two UR5 hold a beam of 4 kg by its ends; K of each arm is that of its tip, turned to P.

    An arm alone bears the law where the beam gives, so that K about its own tip must suit the wrist.
    """
    fields, turn = cp.Scenario.load("two-ur5-admittance").model_dump(), np.pi / 12.0
    start = {"xyz": (0.0, 0.0, 0.3), "rpy": (0.0, 0.0, -turn)}
    cell, arms = fields["cell"], fields["cell"]["arms"]
    arms["left"] |= {"calibration_error": {}, "base": {"xyz": (-1.6, 0.0, 0.0)}}
    arms["right"]["base"] = {"xyz": (1.6, 0.0, 0.0), "rpy": (0.0, 0.0, np.pi)}
    beam = {"kind": "beam", "mass": 4.0, "length": 2.0, "bending_stiffness": 1000.0, "links": 5}
    cell["payload"] = beam | {"section": (0.12, 0.025)}
    gains = {"pose_gain": 5.0, "sign_gain": 0.2, "anchor_gain": 0.01, "transient_rate": 5.0}
    of_arms = {}
    for name, x, rod in (("left", -1.0, "rod0"), ("right", 1.0, "rod4")):
        cell["grasps"][name] = {"xyz": (x, 0.0, 0.0), "rpy": cell["grasps"][name]["rpy"], "link": rod}
        A = FullRows().twist_shift(np.array((x, 0.0, 0.0)))
        of_arms[name] = gains | {"sliding_gain": (A.T @ np.diag([1e3] * 3 + [16.0] * 3) @ A).tolist()}
    law = {"kind": "payload-space", "force_path": {"kind": "late"}, "gain_axes": "payload"}
    law |= {"anchor_bias": "none", "zero_at_grasp": True, "gains": of_arms["left"], "arm_gains": of_arms}
    motion = {"kind": "turn", "axis": (0.0, 0.0, 1.0), "centre": (0.0, 0.0, 0.3), "angle": 2.0 * turn}
    fields |= {"start": start, "duration": 9.0, "controller": law, "name": "two-ur5-beam"}
    fields["motion"] = motion | {"start_time": 0.5, "duration": 7.0, "pose": start}
    fields["clock"] = {"rate_hz": 500.0, "steps_per_tick": 1}
    fields["task"] = {"moment": 2.0}  # that of the arms' inertia while they turn
    for part in ("actuators", "sensors", "arm_sensors"):
        fields[part] = {}
    return cp.Scenario(**fields)


@pytest.mark.slow
def test_a_beam_of_two_metres_is_turned_by_thirty_degrees():
    """Zeroed at its deflected start, the arms agree: the squeeze at rest is the desired one."""
    scenario = beam_of_two_metres()
    result = cp.run(scenario)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert result.energy_balance_max() < 1e-8
    turned = result.data.payload_quaternion.values[[0, -1]]
    assert 2.0 * np.degrees(np.arccos(abs(turned[0] @ turned[1]))) == pytest.approx(30.0, abs=0.01)
    F, f_d = (result.data[name].values[-1] for name in ("internal_wrench", "desired_internal_wrench"))
    assert_allclose(F, f_d, rtol=1e-2, atol=1e-3)
    assert np.abs(result.data.payload_joint_position.values[0]).min() > 1e-3  # it sags


@pytest.mark.gate
def test_law_23_tracks_with_a_box_with_a_lid():
    """The printed law in a plane: the flap swings against its spring, and the box follows."""
    scenario = linked("adept-paper", "lid", **{"duration": 6.0})
    assert scenario.controller.kind == "sliding-mode"
    result = cp.run(scenario)
    assert result.position_rms(window=(5.0, 6.0)) < 1e-3
    assert np.ptp(result.data.payload_joint_position.values) > 1e-3
    assert result.energy_balance_max() < 1e-6


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"controller.force_path": {"kind": "messages"}, "network": {}, "sensors.wrist": {}}, "force_path"),
        ({"controller.force_path": {"kind": "none"}, "controller.payload_mass": 4.0}, "payload_mass"),
    ],
)
def test_laws_that_share_the_weight_of_a_door_are_refused(changes, field):
    from coop_pin.simulation.build_controller import build_controller

    scenario = cp.Scenario.load("two-pandas-door", changes)
    with pytest.raises(FieldError, match=field):
        build_controller(scenario)


def bent(kind: str) -> cp.Scenario:
    """A payload of Pandas that the moment of the squeeze bends: until it has, this moment is missing.

    The forces of 10 N are 0.05 m off the line through P, which are 0.5 N m; the task allows them.
    """
    scenario = linked("two-pandas-box", kind)
    moment = float(np.linalg.norm(scenario.squeeze_wrenches[:, 3:], axis=1).max())
    return scenario.override({"task.moment": 1.01 * moment})


PROPOSED = {
    "Adepts, lid": lambda: linked("adept-anchored", "lid"),
    "Adepts, beam": lambda: linked("adept-anchored", "beam"),
    "Adepts, table": lambda: linked("adept-anchored", "table"),
    "Pandas, lid": lambda: linked("two-pandas-box", "lid"),
    "Pandas, beam": lambda: bent("beam"),
    "Pandas, table": lambda: bent("table"),
    "Pandas, door": lambda: cp.Scenario.load("two-pandas-door"),
    "UR5, beam of 2 m": beam_of_two_metres,
    "a Panda, rope": hanging_rope,
}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.slow if k else pytest.mark.gate)
        for k, case in enumerate(PROPOSED)
    ],
)
def test_a_proposal_for_a_payload_of_several_links_passes_its_own_check_and_keeps_the_task(case):
    """A squeeze bends links that give: the bias b of the views that this is leaves c k_I K gamma b / beta."""
    proposed = cp.suggest(PROPOSED[case](), poses=11)
    assert not proposed.findings().of("error")
    result = cp.run(proposed.scenario, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
