"""Cell summary: arms, limits, payload, closure rank and degrees of freedom; maximum reach of an arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, typed
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.differential_base import DifferentialBase
from coop_pin.description.cell.payload import Payload
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.joint_limits import JointLimits
from coop_pin.model.pinocchio_model import frame_id, jacobian_matrix, load_arm_model

_SEEDS = 8


@typed
def maximum_reach(arm: Arm) -> float:
    """Return the maximum reach of an arm, from its first joint to its tip within the joint limits, m.

    Quasi-Newton ascent from eight configurations with a fixed seed: the largest distance found, which is
    attained.

    Raises:
        UrdfError, NameNotFoundError: the arm cannot be built.
    """
    from scipy.optimize import minimize  # slow to load

    model, limits = load_arm_model(arm), JointLimits(arm)
    data, tip = model.createData(), frame_id(model, arm.tip)
    origin = np.array(model.jointPlacements[1].translation)

    def objective(angles: Array) -> tuple[float, Array]:
        """Return minus the distance and its gradient."""
        q = limits.joints.configuration(angles)
        J = jacobian_matrix(pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED))
        p = pin.updateFramePlacement(model, data, tip).translation - origin
        distance = float(np.linalg.norm(p))
        return -distance, -(p @ J[:3]) / max(distance, 1e-12)

    lower, upper = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    rng, bounds = np.random.default_rng(0), list(zip(lower, upper, strict=True))
    optima = [
        minimize(objective, rng.uniform(lower, upper), jac=True, bounds=bounds, method="L-BFGS-B")
        for _ in range(_SEEDS)
    ]
    return -min(float(optimum.fun) for optimum in optima)


class JointSummary(NamedTuple):
    """Position and limits of one joint of an arm.

    Attributes:
        name: joint name.
        angle: joint position at the payload pose, rad or m.
        lower: position limit, -inf if there is none.
        upper: position limit, inf if there is none.
        velocity: limit, inf if there is none.
        torque: limit of the drive with the same index, inf if there is none.
        unit: "rad", or "m" of a prismatic joint.
    """

    name: str
    angle: float
    lower: float
    upper: float
    velocity: float
    torque: float
    unit: str = "rad"


class ArmSummary(NamedTuple):
    """One arm of a cell, closed at the payload pose.

    Attributes:
        name: arm name.
        urdf: file or name of the robot.
        tip: frame that holds the payload.
        base: position of its root link in the world, m.
        locked: fixed joints.
        joints: moving joints.
        mass: mass of all moving links, kg.
        armature: inertia of each joint's rotor as the joint feels it, kg m^2 or kg; all zero where none is
            stated.
        maximum_reach: largest distance between its first joint and its tip, m.
        smallest_singular_value: least singular value of the payload Jacobian in task rows and drive
            coordinates.
    """

    name: str
    urdf: str
    tip: str
    base: tuple[float, float, float]
    locked: tuple[str, ...]
    joints: tuple[JointSummary, ...]
    mass: float
    armature: tuple[float, ...]
    maximum_reach: float
    smallest_singular_value: float


class SharedSummary(NamedTuple):
    """Shared joint of a cell.

    Attributes:
        name: joint name.
        start: position at which its arms lock it, rad or m.
        effort: largest force or torque of its drive, inf if there is none.
        unit: "rad", or "m" of a prismatic joint.
        arms: names of the arms that it carries.
        follow: reference of its servo: "hold", "payload" or "stroke".
    """

    name: str
    start: float
    effort: float
    unit: str
    arms: tuple[str, ...]
    follow: str

    def __str__(self) -> str:
        """Return it as a line."""
        drive = {"hold": "holds", "payload": "follows the payload", "stroke": "makes a stated stroke"}
        force = "N" if self.unit == "m" else "N m"
        limit = f"{self.effort:.4g} {force}" if np.isfinite(self.effort) else "any force"
        return (
            f"shared joint {self.name} under {', '.join(self.arms)}: {self.start:.3f} {self.unit}, up to"
            f" {limit}; its drive {drive[self.follow]}"
        )


class WheelSummary(NamedTuple):
    """Base of an arm that rolls.

    Attributes:
        arm: name of the arm.
        mass: mass of the platform, kg.
        follow: reference of the base: "hold", "payload", "place" or "steering".
        friction: friction of its wheels on the ground.
    """

    arm: str
    mass: float
    follow: str
    friction: float

    def __str__(self) -> str:
        """Return it as a line."""
        law = {
            "hold": "holds",
            "payload": "follows the payload",
            "place": "follows the payload at a stated place",
            "steering": "makes a stated way",
        }
        return (
            f"base of {self.arm} on two wheels: {self.mass:g} kg, friction {self.friction:g}; it"
            f" {law[self.follow]}"
        )


class CellSummary(NamedTuple):
    """Summary of a cell at a payload pose.

    Attributes:
        arms: summaries in the order of the cell.
        shared: shared joints, from the root of the robot on.
        wheels: bases that roll.
        payload: the held object.
        gravity: m/s^2.
        task_rows: name of the cell's task rows.
        closure_rows: number of rows of all grasps, six for each arm, and one of each base that rolls.
        rank: number of independent closure rows.
        freedom: degrees of freedom: joints, shared ones too, plus six of the payload minus rank.
    """

    arms: tuple[ArmSummary, ...]
    shared: tuple[SharedSummary, ...]
    wheels: tuple[WheelSummary, ...]
    payload: Payload
    gravity: tuple[float, float, float]
    task_rows: str
    closure_rows: int
    rank: int
    freedom: int

    def summary(self) -> str:
        """Return the cell as a text tree."""
        joints = sum(len(arm.joints) for arm in self.arms)
        shape = f"{self.payload.shape} of {_numbers(self.payload.size)} m"
        redundant = self.closure_rows - self.rank
        shared = f" and {len(self.shared)} shared" if self.shared else ""
        lines = (
            f"cell: {len(self.arms)} arms, {joints} joints{shared}, gravity {_numbers(self.gravity)} m/s^2,"
            f" task rows {self.task_rows!r}",
            *(f"├─ {each}" for each in (*self.shared, *self.wheels)),
            *(line for arm in self.arms for line in _arm_lines(arm)),
            f"├─ payload: {self.payload.mass:g} kg, {shape}",
            f"└─ closures: {self.closure_rows} rows, rank {self.rank} ({redundant} redundant);"
            f" {self.freedom} degrees of freedom",
        )
        return "\n".join(lines)


def cell_summary(cell: Cell, X_WP: ArrayLike) -> CellSummary:
    """Return a summary of a cell at a payload pose.

    Args:
        cell: the description.
        X_WP: payload pose, shape (4, 4).

    Raises:
        UnreachablePoseError: an arm cannot hold the payload there.
        UrdfError, NameNotFoundError: an arm cannot be built.
    """
    chain = CellChain(cell, PlantOptions(payload="free"))
    q = chain.configuration(X_WP)
    rank = chain.mechanism.rank(q)
    arms = tuple(_arm_summary(CellArm(cell, slot.name), q[slot.q_slice]) for slot in chain.model.arms)
    return CellSummary(
        arms,
        _shared_summaries(cell, chain),
        tuple(
            WheelSummary(name, base.mass, _followed(base), base.friction)
            for name, base in cell.wheels.items()
        ),
        cell.payload,
        cell.gravity,
        cell.rows,
        closure_rows=chain.mechanism.closures.rows,
        rank=rank,
        freedom=int(chain.mechanism.model.nv) - rank,
    )


def _followed(base: DifferentialBase) -> str:
    """Return the kind of a base's reference."""
    if isinstance(base.follow, str):
        return base.follow
    return "place" if base.follows_payload else "steering"


def _shared_summaries(cell: Cell, chain: CellChain) -> tuple[SharedSummary, ...]:
    if (carrier := cell.carrier) is None:
        return ()
    rows = []
    for name, slot, screw in zip(carrier.joints, chain.model.shared, carrier.screws, strict=True):
        joint, unit = cell.shared_joints[name], "rad" if screw[3:].any() else "m"
        limit = {"urdf": slot.effort or np.inf, "none": np.inf}.get(str(joint.limit), joint.limit)
        follow = joint.follow if isinstance(joint.follow, str) else "stroke"
        rows.append(SharedSummary(name, slot.start, float(limit), unit, carrier.arms, follow))
    return tuple(rows)


def _arm_summary(arm: CellArm, q: Array) -> ArmSummary:
    description, limits, model = arm.description, arm.limits, load_arm_model(arm.description)
    columns = arm.joint_angles(q), limits.lower, limits.upper, limits.velocity, limits.torque
    rows = zip(limits.joints.names, limits.joints.units, *columns, strict=True)
    return ArmSummary(
        name=arm.name,
        urdf=description.urdf,
        tip=description.tip,
        base=description.base.xyz,
        locked=tuple(description.locked),
        joints=tuple(_joint(name, unit, *map(float, numbers)) for name, unit, *numbers in rows),
        mass=float(sum(inertia.mass for inertia in list(model.inertias)[1:])),
        armature=tuple(model.armature.tolist()),
        maximum_reach=maximum_reach(description),
        smallest_singular_value=float(np.linalg.svd(arm.task_jacobian(q), compute_uv=False)[-1]),
    )


def _joint(name: str, unit: str, *numbers: float) -> JointSummary:
    angle, lower, upper, velocity, torque = numbers
    return JointSummary(name, angle, lower, upper, velocity, torque, unit)


def _arm_lines(arm: ArmSummary) -> tuple[str, ...]:
    locked = f", locked: {', '.join(arm.locked)}" if arm.locked else ""
    return (
        f"├─ {arm.name}: {arm.urdf}, base at {_numbers(arm.base)} m, tip {arm.tip!r}{locked}",
        f"│  ├─ {len(arm.joints)} joints, {arm.mass:.3g} kg moving, reach {arm.maximum_reach:.3g} m,"
        f" sigma_min {arm.smallest_singular_value:.3g}",
        f"│  ├─ rotors: {_rotors(arm.armature)}",
        *(_joint_line(joint, last=joint is arm.joints[-1]) for joint in arm.joints),
    )


def _rotors(armature: tuple[float, ...]) -> str:
    if not any(armature):
        return "none stated (armature): the wrist may feel lighter than it is"
    return f"{_numbers(armature)} kg m^2, as the joints feel them"


def _joint_line(joint: JointSummary, last: bool) -> str:
    effort = "N m" if joint.unit == "rad" else "N"
    span = (
        f"in {joint.lower:.3g} .. {joint.upper:.3g} {joint.unit}"
        if np.isfinite((joint.lower, joint.upper)).all()
        else "without limits"
    )
    speed = f"up to {joint.velocity:.3g} {joint.unit}/s" if np.isfinite(joint.velocity) else "any speed"
    torque = f"{joint.torque:.3g} {effort}" if np.isfinite(joint.torque) else "any torque"
    return f"│  {'└─' if last else '├─'} {joint.name}: {joint.angle:.3f} {span}, {speed}, {torque}"


def _numbers(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{round(value, 6) + 0.0:g}" for value in values) + ")"
