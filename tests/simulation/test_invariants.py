"""Laws of mechanics and symmetries that hold for every cell, on a planar and on a spatial one."""

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS, cell_and_start, random_velocity
from close import assert_close
from linkages import bar, joint, link, robot
from scipy.integrate import simpson, solve_ivp
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose, rotate_vector6, shift_wrench
from coop_pin.control import CellCommand, CellController, Saturation
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.events import PayloadChange, WrenchPulse
from coop_pin.description.plant import PlantOptions
from coop_pin.description.urdf import find_urdf
from coop_pin.grasps import CellChain
from coop_pin.model import CellArm

GRAVITY = (1.0, -2.0, -9.0)  # with a part in the plane of the planar cell
PUSH = np.array((12.0, -7.0, 5.0, 0.4, -0.3, 0.8))


@pytest.fixture(params=SCENARIOS)
def name(request):
    return request.param


@pytest.fixture(params=["welded", "free"])
def payload(request):
    return request.param


def moving(name, payload="welded", formulation="auto"):
    """A cell in motion on its closures, with torques: chain, q, v, tau."""
    cell, start = cell_and_start(name)
    chain = CellChain(cell.replace(gravity=GRAVITY), PlantOptions(payload=payload, formulation=formulation))
    q = chain.configuration(start)
    v = random_velocity(chain.mechanism, q, 3)
    tau = np.zeros(len(v))
    rng = np.random.default_rng(4)
    for arm in chain.model.arms:
        tau[arm.v_slice] = 10.0 * rng.normal(size=len(arm.drive))
    return chain, q, v, tau


# ---------------------------------------------------------------- dynamics


def test_a_motion_played_backwards_ends_where_it_began(name, payload):
    """Forces that depend on the configuration only: from (q, -v) the mechanism returns the way it came."""
    chain, q, v, _ = moving(name, payload)

    def spring(_t, at, _v):
        return -5.0 * pin.difference(chain.mechanism.model, q, at)

    run = {"duration": 0.1, "step": 2e-3, "torque": spring}
    there = chain.mechanism.integrate(q, v, **run)
    back = chain.mechanism.integrate(there.q[-1], -there.v[-1], **run)
    assert np.abs(pin.difference(chain.mechanism.model, q, there.q[-1])).max() > 0.05
    assert_close(pin.difference(chain.mechanism.model, q, back.q[-1]), np.zeros(len(v)), atol=1e-7)
    assert_close(back.v[-1], -v, atol=1e-6)


@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
def test_the_inverse_inertia_is_symmetric_and_of_the_rank_of_the_free_motions(name, payload, formulation):
    """The accelerations of unit forces: W = N (N^T M N)^-1 N^T for a basis N of the motions that J allows."""
    chain, q, _, _ = moving(name, payload, formulation)
    mechanism, still = chain.mechanism, np.zeros(chain.mechanism.model.nv)
    fall = mechanism.forward_dynamics(q, still, still)
    W = np.column_stack(
        [
            mechanism.forward_dynamics(q, still, unit).acceleration - fall.acceleration
            for unit in np.eye(len(still))
        ]
    )
    scale = np.abs(W).max()
    assert_close(W, W.T, atol=1e-9 * scale)
    eigenvalues = np.linalg.eigvalsh((W + W.T) / 2.0)
    free = len(still) - fall.rank
    assert free == chain.cell.task_rows.size or (name, payload) == ("planar", "free")
    assert_close(eigenvalues[: len(still) - free], np.zeros(fall.rank), atol=1e-9 * scale)
    assert eigenvalues[len(still) - free :].min() > 1e-4 * scale
    assert_close(
        mechanism.closures.state(q, still).jacobian @ W,
        np.zeros((mechanism.closures.rows, len(still))),
        atol=1e-8 * scale,
    )


def test_the_power_of_the_forces_is_the_rate_of_the_energy(name, payload):
    """Closures do no work: dE/dt = v^T tau at every instant; what a damper takes never comes back."""
    chain, q, v, tau = moving(name, payload)
    mechanism, h = chain.mechanism, 2e-5
    for force in (tau, -3.0 * v):
        a = mechanism.forward_dynamics(q, v, force).acceleration
        energies = [
            mechanism.energy(pin.integrate(mechanism.model, q, t * v + t * t / 2.0 * a), v + t * a).total
            for t in (-h, h)
        ]
        assert_close((energies[1] - energies[0]) / (2.0 * h), v @ force, atol=1e-4)
    assert v @ force < 0.0


def test_a_damped_chain_loses_energy_at_every_step(name):
    chain, q, v, _ = moving(name)
    motion = chain.mechanism.integrate(q, v, duration=0.2, step=4e-3, torque=lambda _t, _q, v: -0.5 * v)
    energy = [chain.mechanism.energy(*state).total for state in zip(motion.q, motion.v, strict=True)]
    assert np.diff(energy).max() < 0.0


def test_momentum_changes_by_base_reactions_weight_and_push(name, payload):
    """About the world's origin; base reactions are those of each arm alone under its interaction wrench."""
    chain, q, v, tau = moving(name, payload)
    model, cell = chain.mechanism.model, chain.cell
    push = cell.task_rows.expand(cell.task_rows.select(PUSH))
    total = tau + chain.payload_jacobian(q).T @ push
    a = chain.mechanism.forward_dynamics(q, v, total).acceleration
    F = chain.interaction_wrenches(q, v, total, push)
    wrench = shift_wrench(push, chain.payload_pose(q)[:3, 3]) + payload_weight(chain, q)
    for place, F_i in zip(chain.model.arms, F, strict=True):
        wrench = wrench + base_reaction_and_weight(cell, place, q, v, a, F_i)
    h = 2e-5
    momenta = [momentum(model, pin.integrate(model, q, t * v + t * t / 2.0 * a), v + t * a) for t in (-h, h)]
    rows = cell.task_rows.indices  # a planar cell's other rows are not determined, arm by arm
    assert_close(((momenta[1] - momenta[0]) / (2.0 * h))[list(rows)], wrench[list(rows)], atol=1e-5)


def momentum(model, q, v):
    """Of all bodies, about the origin of the world, shape (6,)."""
    data = model.createData()
    about_centre = pin.computeCentroidalMomentum(model, data, q, v).vector
    return shift_wrench(about_centre, data.com[0])


def payload_weight(chain, q):
    weight = chain.cell.payload.mass * np.array(chain.cell.gravity)
    return shift_wrench(np.concatenate((weight, np.zeros(3))), chain.payload_pose(q)[:3, 3])


def base_reaction_and_weight(cell, place, q, v, a, F_EP_W):
    """Base reaction and weight of an arm: the rate of momentum of its moving links minus F."""
    arm = CellArm(cell, place.name)
    model, data = arm.model, arm.model.createData()
    own_q, own_v, own_a = q[place.q_slice], v[place.v_slice], a[place.v_slice]
    pin.rnea(model, data, own_q, own_v, own_a)
    pin.forwardKinematics(model, data, own_q)
    reaction = data.oMi[1].act(data.f[1]).vector  # without the payload's wrench
    mass, p_WP = pin.computeTotalMass(model), arm.payload_pose(own_q)[:3, 3]
    weight = np.concatenate((mass * np.array(cell.gravity), np.zeros(3)))
    carried = reaction - shift_wrench(F_EP_W, p_WP)
    return carried + shift_wrench(weight, pin.centerOfMass(model, data, own_q))


# ---------------------------------------------------------------- similarity


LENGTH, MASS = 1.7, 2.9


def scaled_arm(arm, folder):
    """The arm with all lengths times LENGTH and all masses times MASS."""
    tree = ElementTree.parse(find_urdf(arm.urdf).path)
    for part in tree.getroot().iter():
        if part.tag == "link":
            for shape in (*part.findall("visual"), *part.findall("collision")):
                part.remove(shape)
        elif part.tag == "origin" and "xyz" in part.attrib:
            part.set("xyz", " ".join(repr(LENGTH * float(x)) for x in part.get("xyz").split()))
        elif part.tag == "mass":
            part.set("value", repr(MASS * float(part.get("value"))))
        elif part.tag == "inertia":
            for entry in part.attrib:
                part.set(entry, repr(MASS * LENGTH**2 * float(part.get(entry))))
    path = folder / f"{arm.urdf}.urdf"
    tree.write(path)
    return arm.replace(urdf=str(path), base=scaled_pose(arm.base))


def scaled_pose(pose):
    return pose.replace(xyz=tuple(LENGTH * x for x in pose.xyz))


def test_a_cell_of_other_lengths_and_masses_is_similar(name, tmp_path):
    """Under the same gravity, times go with the root of the length, and forces with the weight."""
    small, q, v, tau = moving(name)
    cell, body = small.cell, small.cell.payload
    body = body.replace(
        mass=MASS * body.mass, inertia=tuple(MASS * LENGTH**2 * entry for entry in body.inertia)
    )
    large = CellChain(
        cell.replace(
            arms={key: scaled_arm(arm, tmp_path) for key, arm in cell.arms.items()},
            payload=body,
            grasps={key: scaled_pose(grasp) for key, grasp in cell.grasps.items()},
        )
    )
    slow, torque = v / np.sqrt(LENGTH), MASS * LENGTH * tau
    a = small.mechanism.forward_dynamics(q, v, tau).acceleration
    assert_close(large.mechanism.forward_dynamics(q, slow, torque).acceleration, a / LENGTH, atol=1e-8)
    scale = np.repeat((MASS, MASS * LENGTH), 3)
    F = small.interaction_wrenches(q, v, tau)
    assert_close(large.interaction_wrenches(q, slow, torque), F * scale, atol=1e-7)
    energy = small.mechanism.energy(q, v).kinetic
    assert_close(large.mechanism.energy(q, slow).kinetic, MASS * LENGTH * energy, atol=1e-10)


# ---------------------------------------------------------------- the same run seen otherwise


def eventful(name):
    """A short run with gravity, a push and a mass drop; smooth: a sign makes torques of rounding errors."""
    scenario = SCENARIOS[name]()
    # A planar law does not carry gravity across the plane; the spatial one sinks a little.
    gravity = {"planar": (0.5, -0.3, -9.81), "spatial": (0.4, 0.3, -1.0)}[name]
    rows = scenario.cell.task_rows
    push = tuple(rows.expand(rows.select(3.0 * PUSH)))
    return scenario.replace(
        cell=scenario.cell.replace(gravity=gravity),
        controller=scenario.controller.replace(switching=Saturation(width=0.05)),
        events=(
            WrenchPulse(time=0.0513, duration=0.05, wrench=push),
            PayloadChange(time=0.1211, mass=scenario.cell.payload.mass / 2),
        ),
        duration=0.2,
    )


def require_same_motion(first, second, arms=None, atol=1e-8):
    """Joints, wrenches on the arms and works are the same."""
    data = second.data if arms is None else second.data.sel(arm=arms)
    for quantity in ("joint_position", "joint_velocity", "torque", "internal_axial", "internal_shear",
                     "internal_moment", "jacobian_condition", "kinetic_energy", "work_actuation",
                     "work_friction", "work_external"):  # fmt: skip
        scale = max(1.0, float(np.nanmax(np.abs(first.data[quantity]))))
        assert_close(data[quantity], first.data[quantity], atol=atol * scale)


def moved_motion(motion, X):
    if motion.kind == "hold":
        return motion.replace(pose=moved_pose(motion.pose, X))
    R = X[:3, :3]
    return motion.replace(
        constant=tuple(R @ motion.constant + X[:3, 3]),
        amplitudes=tuple(tuple(R @ amplitude) for amplitude in motion.amplitudes),
        rpy=moved_pose(Pose(rpy=motion.rpy), X).rpy,
    )


def moved_pose(pose, X):
    return Pose.from_matrix(X @ pose.matrix)


def test_the_world_turned_and_moved_with_gravity_push_and_events_makes_no_difference(name):
    scenario, cell = eventful(name), eventful(name).cell
    X = (
        make_pose((3.0, -2.0, 0.0), (0, 0, 2.0))
        if name == "planar"
        else make_pose((3, -2, 1), (0.7, -0.5, 2.0))
    )
    R = X[:3, :3]
    turned = scenario.replace(
        cell=cell.replace(
            arms={key: arm.replace(base=moved_pose(arm.base, X)) for key, arm in cell.arms.items()},
            gravity=tuple(R @ cell.gravity),
        ),
        start=moved_pose(scenario.start, X),
        motion=moved_motion(scenario.motion, X),
        events=tuple(
            event.replace(wrench=tuple(rotate_vector6(R, np.array(event.wrench))))
            if isinstance(event, WrenchPulse)
            else event
            for event in scenario.events
        ),
    )
    first, second = cp.run(scenario, warn=False), cp.run(turned, warn=False)
    require_same_motion(first, second)
    for quantity in ("pose_error", "payload_twist", "interaction_wrench"):
        found, there = first.data[quantity].values, second.data[quantity].values
        assert_close(np.nan_to_num(there), rotate_vector6(R, np.nan_to_num(found)), atol=1e-6)
    assert_close(second.data.payload_position, first.data.payload_position.values @ R.T + X[:3, 3], atol=1e-9)


def test_the_order_of_the_arms_makes_no_difference(name):
    """The payload is welded to the first arm: in the other order it is another tree."""
    scenario, cell = eventful(name), eventful(name).cell
    order = list(reversed(cell.arms))
    turned = scenario.replace(cell=cell.replace(arms={key: cell.arms[key] for key in order}))
    assert list(turned.cell.arms) == order
    first, second = cp.run(scenario, warn=False), cp.run(turned, warn=False)
    require_same_motion(first, second, list(cell.arms))
    assert_close(second.data.pose_error, first.data.pose_error, atol=1e-9)


MIRROR = np.array((1.0, -1.0, 1.0, -1.0, 1.0, -1.0))
"""Of forces and moments, in a mirror across y; of roll, pitch and yaw the last three."""


def test_the_papers_cell_in_a_mirror_moves_as_its_mirror_image():
    scenario, cell = eventful("planar"), eventful("planar").cell
    wrenches = {key: tuple(MIRROR * wrench) for key, wrench in scenario.squeeze.wrenches.items()}
    motion, push = scenario.motion, scenario.events[0]
    mirrored = scenario.replace(
        cell=cell.replace(
            arms={
                key: arm.replace(base=mirrored_pose(arm.base), posture=tuple(-np.array(arm.posture)))
                for key, arm in cell.arms.items()
            },
            grasps={key: mirrored_pose(grasp) for key, grasp in cell.grasps.items()},
            gravity=tuple(MIRROR[:3] * cell.gravity),
        ),
        start=mirrored_pose(scenario.start),
        motion=motion.replace(
            constant=tuple(MIRROR[:3] * motion.constant),
            amplitudes=tuple(tuple(MIRROR[:3] * amplitude) for amplitude in motion.amplitudes),
            rpy=tuple(MIRROR[3:] * motion.rpy),
        ),
        squeeze=wrenches,
        events=(push.replace(wrench=tuple(MIRROR * push.wrench)), scenario.events[1]),
    )
    first, second = cp.run(scenario, warn=False).data, cp.run(mirrored, warn=False).data
    for quantity in ("joint_position", "joint_velocity", "torque"):
        assert_close(second[quantity], -first[quantity], atol=1e-7)
    for quantity in ("pose_error", "interaction_wrench", "desired_internal_wrench"):
        assert_close(second[quantity], MIRROR * first[quantity], atol=1e-6)
    assert_close(second.kinetic_energy, first.kinetic_energy, atol=1e-9)


def mirrored_pose(pose):
    return Pose(xyz=tuple(MIRROR[:3] * pose.xyz), rpy=tuple(MIRROR[3:] * pose.rpy))


# ---------------------------------------------------------------- recorded runs


class ConstantTorques(CellController):
    """Holds the same torques throughout, so that the wrenches are smooth from tick to tick."""

    def init(self, measurements, references):
        return [np.linspace(2.0, -1.0, len(m.v)) * (-1.0) ** index for index, m in enumerate(measurements)]

    def step(self, measurements, references, state):
        return CellCommand(state, state)


@pytest.fixture(params=SCENARIOS, scope="module")
def pushed_run(request):
    scenario = SCENARIOS[request.param]()
    rows = scenario.cell.task_rows
    push = WrenchPulse(time=0.0, duration=0.1, wrench=tuple(rows.expand(rows.select(PUSH))))
    scenario = scenario.replace(
        cell=scenario.cell.replace(gravity=(0.5, -0.3, -2.0)),
        events=(push,),
        duration=0.1,
        clock={"rate_hz": 1000.0, "steps_per_tick": 1},
    )
    return cp.simulate(scenario, ConstantTorques())


def test_the_impulse_of_a_recorded_run_is_the_change_of_the_payloads_momentum(pushed_run):
    """From the recorded wrenches and twists alone: push + weight - sum_i F_i, about P."""
    data, cell = (
        pushed_run.data.isel(time=slice(0, -1)),
        pushed_run.scenario.cell,
    )  # the push ends at the last
    rows = list(cell.task_rows.indices)
    weight = np.concatenate((cell.payload.mass * np.array(cell.gravity), np.zeros(3)))
    resultant = data.external_wrench.values + weight - data.interaction_wrench.values.sum(axis=1)
    R = Rotation.from_quat(data.payload_quaternion.values).as_matrix()
    inertia = R @ cell.payload.inertia_matrix @ R.transpose(0, 2, 1)
    twist = data.payload_twist.values
    momenta = np.concatenate(
        (cell.payload.mass * twist[:, :3], np.einsum("nij,nj->ni", inertia, twist[:, 3:])), axis=1
    )
    impulse = simpson(resultant[:, rows], x=data.time.values, axis=0)
    assert np.abs(impulse).max() > 0.05
    assert_close(impulse, (momenta[-1] - momenta[0])[rows], atol=1e-7)


def test_friction_takes_energy_at_every_tick_and_all_work_is_accounted_for(pushed_run):
    data = pushed_run.data
    assert np.diff(data.work_friction).max() <= 0.0
    energy = data.kinetic_energy + data.potential_energy
    work = data.work_actuation + data.work_friction + data.work_external
    assert_close(np.diff(energy), np.diff(work), atol=1e-9)


# ---------------------------------------------------------------- a closed form


ROPE, ROPE_MASS, LOAD, WRIST = 0.8, 1.5, 4.0, 0.3


def swings(folder, tilt, rows):
    """A payload on two parallel ropes with a hinge at each end, in a turned world."""
    wrist = (
        link("wrist", length=0.0, mass=WRIST)
        .replace('izz="0.0"', 'izz="1e-3"')
        .replace('iyy="0.0"', 'iyy="1e-3"')
    )
    path = folder / "swing.urdf"
    path.write_text(
        robot(
            bar("rope", "ground", (0, 0, 0), length=ROPE, mass=ROPE_MASS),
            wrist,
            joint("wrist", "rope", (ROPE, 0, 0)),
        )
    )
    arms, grasps = {}, {}
    for name, x in (("left", -0.3), ("right", 0.3)):
        arms[name] = Arm(
            urdf=str(path),
            tip="wrist",
            base=Pose.from_matrix(tilt @ make_pose((x, 0, 0))),
            posture=(-1.0, 1.0),
        )
        grasps[name] = Pose(xyz=(x, 0.1, 0))
    gravity = tuple(tilt[:3, :3] @ (0.0, -9.81, 0.0))
    return Cell(
        arms=arms, payload=Payload.box(LOAD, (0.6, 0.2, 0.1)), grasps=grasps, rows=rows, gravity=gravity
    )


@pytest.mark.parametrize("payload", ["welded", "free"])
@pytest.mark.parametrize(("rows", "turn"), [("planar", (0, 0, 0)), ("full", (0.6, -0.4, 1.2))])
def test_a_payload_on_two_swings_is_one_pendulum(rows, turn, payload, tmp_path):
    """theta'' = -(g / l) (m_load + m_ropes / 2) / (m_load + m_ropes / 3) cos theta; no turn."""
    tilt = make_pose((0.5, 0.2, 0.0 if rows == "planar" else 0.7), turn)
    chain = CellChain(swings(tmp_path, tilt, rows), PlantOptions(payload=payload))
    angle = -1.0
    at = lambda theta: tilt @ make_pose((ROPE * np.cos(theta), ROPE * np.sin(theta) - 0.1, 0))  # noqa: E731
    q = chain.configuration(at(angle))
    load, ropes = LOAD + 2 * WRIST, 2 * ROPE_MASS
    rate = 9.81 / ROPE * (load + ropes / 2) / (load + ropes / 3)
    motion = chain.mechanism.integrate(q, np.zeros(chain.mechanism.model.nv), duration=0.5, step=2e-3)
    pendulum = solve_ivp(
        lambda _t, y: (y[1], -rate * np.cos(y[0])),
        (0, 0.5),
        (angle, 0.0),
        rtol=1e-11,
        atol=1e-11,
        t_eval=motion.time,
    )
    poses = [chain.payload_pose(q) for q in motion.q[::25]]
    assert abs(pendulum.y[0, -1] - angle) > 0.5
    assert_close(poses, [at(theta) for theta in pendulum.y[0, ::25]], atol=1e-8)
