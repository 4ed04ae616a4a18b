"""Quantities of a run, declared in one table.

``QUANTITIES`` gives every quantity its name, dimensions, unit, meaning, source and group. By it the recorder
allocates its arrays and the dataset is labelled; snapshots, metrics and figures read what it computes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import internal_wrenches, log3, quaternions, rotate_vector6
from coop_pin.description.cell.miscalibration import Miscalibration
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import Sensors
from coop_pin.results.quantity import Quantity, Samples


def _pose_errors(X: Array, X_d: Array) -> Array:
    """Return ``[p - p_d, log(R R_d^T)]`` of poses, shape (..., 6)."""
    R = X[..., :3, :3] @ np.swapaxes(X_d[..., :3, :3], -1, -2)
    return np.concatenate((X[..., :3, 3] - X_d[..., :3, 3], log3(R)), axis=-1)


def _relative_errors(samples: Samples) -> Array:
    """Return the errors of X_PE = X_WP^-1 X_WE of each arm against the desired ones, shape (..., m, 6)."""
    inverse, inverse_d = (
        np.linalg.inv(samples[name])[..., None, :, :] for name in ("payload_pose", "desired_pose")
    )
    return _pose_errors(inverse @ samples["tip_pose"], inverse_d @ samples["desired_tip_pose"])


def _internal_wrenches(samples: Samples) -> Array:
    """Return f_i = F_i - c_i sum_j F_j, with joints R L_i R^T in place of c_i, shape (..., m, 6)."""
    F, L = samples["interaction_wrench"], samples.get("load_split")
    if L is None:
        return internal_wrenches(F, samples["load_share"])
    R = samples["payload_pose"][..., None, :3, :3]
    load = rotate_vector6(np.swapaxes(R, -1, -2), np.nan_to_num(F).sum(axis=-2, keepdims=True))
    return F - rotate_vector6(R, (L @ load[..., None])[..., 0])


def _axial_directions(tips: Array) -> Array:
    """Return unit vectors from each tip to the middle of the other tips, shape (..., m, 3); NaN for one."""
    if tips.shape[-2] == 1:
        return np.full(tips.shape, np.nan)
    line = (tips.sum(axis=-2, keepdims=True) - tips) / (tips.shape[-2] - 1) - tips
    length = np.linalg.norm(line, axis=-1, keepdims=True)
    return np.where(length > 0.0, line / np.where(length > 0.0, length, 1.0), np.nan)


def padded(arms: Sequence[Array]) -> Array:
    """Return values of the joints or drives of each arm, NaN beyond its own, shape (..., m, k)."""
    table = np.full((*arms[0].shape[:-1], len(arms), max(arm.shape[-1] for arm in arms)), np.nan)
    for index, arm in enumerate(arms):
        table[..., index, : arm.shape[-1]] = arm
    return table


def _at_drives(joints: Sequence[Array], drives: Sequence[Array]) -> Array:
    """Return T x of each arm for values of its joints, shape (..., m, k)."""
    return padded([values @ T.T for values, T in zip(joints, drives, strict=True)])


def condition_numbers(jacobians: Sequence[Array]) -> Array:
    """Return the condition number of each arm's Jacobian, shape (..., m); NaN after NaN."""
    conditions = np.full((*jacobians[0].shape[:-2], len(jacobians)), np.nan)
    for index, J in enumerate(jacobians):
        is_finite = np.isfinite(J).all(axis=(-2, -1))
        conditions[is_finite, index] = np.linalg.cond(J[is_finite])
    return conditions


def _internal_parts(
    name: str, text: str, wrench: Callable[[Samples], Array], group: str = ""
) -> tuple[Quantity, ...]:
    """Return axial force, shear force and moment of a wrench on each arm, such as ``internal_axial``.

    Rows that rigid bodies do not determine count as zero.

    Args:
        name: Name of the quantities, with {} for the part.
        text: Name of the wrench.
        wrench: wrench on each arm, shape (..., m, 6).
        group: Group of the quantities.
    """

    def axial(s: Samples) -> Array:
        return np.einsum("...i,...i->...", np.nan_to_num(wrench(s))[..., :3], s["axial_direction"])

    def shear(s: Samples) -> Array:
        across = np.nan_to_num(wrench(s))[..., :3] - axial(s)[..., None] * s["axial_direction"]
        return np.linalg.norm(across, axis=-1)

    def moment(s: Samples) -> Array:
        return np.linalg.norm(np.nan_to_num(wrench(s))[..., 3:], axis=-1)

    return tuple(
        Quantity(name.format(part), "arm", unit, f"{text}: {meaning}", source, group=group)
        for part, unit, meaning, source in (
            ("axial", "N", "force along axial_direction", axial),
            ("shear", "N", "force across axial_direction, norm", shear),
            ("moment", "N m", "moment about P, norm", moment),
        )
    )


def _sent(name: str) -> Callable[[Any, Any], Sequence[Any]]:
    """Return the function that reads what each arm has sent; nothing of a run commanded from outside."""
    return lambda arms, _: [None if arm.sent is None else getattr(arm.sent, name) for arm in arms]


# fmt: off
QUANTITIES = (
    Quantity("time", "", "s", "time of the tick; a coordinate of the dataset", stored=False),
    Quantity("payload_pose", "row column", "1, m", "X_WP", stored=False),
    Quantity("desired_pose", "row column", "1, m", "X_WP_d", stored=False),
    Quantity("desired_squeeze", "arm axis", "N, N m", "f_d_i in payload axes", stored=False),
    Quantity("configuration", "q", "rad or m", "configuration of the Pinocchio tree"),
    Quantity("velocity", "v", "rad/s or m/s", "velocity of the Pinocchio tree"),
    Quantity("payload_position", "position", "m", "position of P", lambda s: s["payload_pose"][..., :3, 3]),
    Quantity("payload_quaternion", "quaternion", "1", "orientation of P",
             lambda s: quaternions(s["payload_pose"][..., :3, :3])),
    Quantity("payload_twist", "axis", "m/s, rad/s", "V_WP"),
    Quantity("desired_position", "position", "m", "desired position of P",
             lambda s: s["desired_pose"][..., :3, 3]),
    Quantity("desired_quaternion", "quaternion", "1", "desired orientation of P",
             lambda s: quaternions(s["desired_pose"][..., :3, :3])),
    Quantity("desired_twist", "axis", "m/s, rad/s", "V_WP_d"),
    Quantity("pose_error", "axis", "m, rad", "actual minus desired pose",
             lambda s: _pose_errors(s["payload_pose"], s["desired_pose"])),
    Quantity("tip_position", "arm position", "m", "position of each tip"),
    Quantity("tip_pose", "arm row column", "1, m", "X_WE", stored=False, group="tools"),
    Quantity("desired_tip_pose", "arm row column", "1, m", "X_WE_d", stored=False, group="tools"),
    Quantity("absolute_error", "axis", "m, rad", "absolute pose: mean of the errors of all tips, world axes",
             lambda s: _pose_errors(s["tip_pose"], s["desired_tip_pose"]).mean(axis=-2), group="tools"),
    Quantity("relative_error", "arm axis", "m, rad", "relative pose: error of each tip in the payload's axes",
             lambda s: _relative_errors(s), group="tools"),
    Quantity("drive_velocity", "arm joint", "rad/s", "velocities of the drives",
             lambda s: _at_drives(s["rates"], s["drive"])),
    Quantity("joint_position", "arm joint", "rad or m", "joint positions; continuous ones count full turns",
             lambda s: padded(s["angles"])),
    Quantity("joint_velocity", "arm joint", "rad/s or m/s", "joint velocities",
             lambda s: padded(s["rates"])),
    Quantity("torque", "arm joint", "N m", "drive torques that act at the tick",
             read=lambda _, applied: applied.torques),
    Quantity("commanded_torque", "arm joint", "N m", "drive torques that the controller asked for",
             read=lambda _, applied: applied.commanded),
    Quantity("saturated", "arm joint", "1", "whether the torque was cut at its limit", fill=False,
             read=lambda _, applied: applied.saturated),
    Quantity("interaction_wrench", "arm axis", "N, N m", "F_i on the arm by the payload, about P"),
    Quantity("load_split", "arm load_row load_column", "", "L_i of the split beside joints, payload axes",
             stored=False, group="joints"),
    Quantity("internal_wrench", "arm axis", "N, N m", "f_i = F_i - c_i sum_j F_j, L_i for c_i beside joints",
             lambda s: _internal_wrenches(s)),
    Quantity("desired_internal_wrench", "arm axis", "N, N m", "f_d_i turned by the payload",
             lambda s: rotate_vector6(s["payload_pose"][..., None, :3, :3], s["desired_squeeze"])),
    Quantity("axial_direction", "arm position", "1", "unit vector from tip to middle of the other tips",
             lambda s: _axial_directions(s["tip_position"])),
    *_internal_parts("internal_{}", "internal wrench", lambda s: s["internal_wrench"]),
    *_internal_parts("desired_internal_{}", "desired internal wrench",
                     lambda s: s["desired_internal_wrench"]),
    *_internal_parts("internal_{}_error", "error of the internal wrench",
                     lambda s: s["internal_wrench"] - s["desired_internal_wrench"]),
    Quantity("external_wrench", "axis", "N, N m", "on the payload, about P"),
    Quantity("closure_distance", "arm", "m", "closure error: distance from tip to grasp"),
    Quantity("closure_angle", "arm", "rad", "closure error: angle from tip to grasp"),
    Quantity("jacobian_condition", "arm", "1", "condition number of the payload Jacobian",
             lambda s: condition_numbers(s["jacobian"])),
    Quantity("kinetic_energy", "", "J", "of arms and payload"),
    Quantity("potential_energy", "", "J", "of arms and payload"),
    Quantity("work_actuation", "", "J", "done by the drives since the start"),
    Quantity("work_friction", "", "J", "done by joint friction since the start"),
    Quantity("work_external", "", "J", "done by external wrenches since the start"),
    Quantity("work_payload_change", "", "J", "energy added by changes of payload and gravity"),
    Quantity("grasp_deflection", "arm axis", "m, rad", "of each compliant grasp: the tip in grasp axes",
             group="grasps"),
    Quantity("grasp_wrench", "arm axis", "N, N m", "of each compliant grasp on the arm, about the tip in"
             " grasp axes", group="grasps"),
    Quantity("patch_wrench", "patch axis", "N, N m", "of each patch on the arm, of each table on the payload,"
             " about the middle of its plane in axes of the plane", group="patches"),
    Quantity("patch_points", "patch", "1", "number of points that touch", group="patches"),
    Quantity("patch_slip", "patch", "m", "distance that its points have slid, mean", group="patches"),
    Quantity("load_share", "arm", "1", "c_i of the agreed plan, less what tables bear", group="plan"),
    Quantity("elastic_energy", "", "J", "in compliant grasps, patches and tables", group="elements"),
    Quantity("work_grasps", "", "J", "done by dampers of compliant grasps, friction of patches and tables,"
             " soft welds of MuJoCo",
             group="elements"),
    Quantity("stop_force", "arm joint", "N m or N", "of the end stops on the joints", group="stops"),
    Quantity("stop_energy", "", "J", "in the end stops", group="stopped"),
    Quantity("work_stops", "", "J", "done by dampers of the end stops since the start", group="stopped"),
    Quantity("payload_joint_position", "payload_joint", "rad or m", "of each joint between its links",
             group="links"),
    Quantity("payload_joint_velocity", "payload_joint", "rad/s or m/s", "rate of each", group="links"),
    Quantity("payload_joint_force", "payload_joint", "N m or N", "of spring, damper, friction and stops",
             group="links"),
    Quantity("payload_joint_energy", "", "J", "in springs of the payload's joints", group="links"),
    Quantity("work_payload_joints", "", "J", "done by their dampers and friction since the start",
             group="links"),
    Quantity("servo_command", "arm joint", "rad/s or rad", "velocities or positions that the controller asked"
             " servos for", read=lambda _, applied: applied.servo_commands, group="servo"),
    Quantity("partner_wrench", "axis", "N, N m", "of the partner on the payload, about P", group="partner"),
    Quantity("partner_deflection", "axis", "m, rad", "of the handle from the partner's point, in its axes",
             group="partner"),
    Quantity("partner_energy", "", "J", "in the partner's spring", group="partner"),
    Quantity("shared_position", "shared", "m or rad", "of each joint under arms", group="shared"),
    Quantity("shared_velocity", "shared", "m/s or rad/s", "rate of each", group="shared"),
    Quantity("shared_force", "shared", "N or N m", "of the drive of each, as it acts", group="shared"),
    Quantity("floor_wrench", "axis", "N, N m", "of the floor on that robot, about the world", group="floor"),
    Quantity("wheel_force", "base position", "N", "of the ground on each base that rolls: ahead, left, up",
             group="wheels"),
    Quantity("messages_sent", "arm", "1", "messages of each arm since the start, to all that hear it",
             read=_sent("messages"), fill=0.0, group="network"),
    Quantity("bytes_sent", "arm", "B", "bytes of them, 8 for each number",
             read=_sent("bytes"), fill=0.0, group="network"),
    Quantity("requested_torque", "arm joint", "N m", "drive torques before their limits: the commands that"
             " arrived, and gravity compensation",
             read=lambda _, applied: applied.requested, group="compensation"),
    Quantity("drive_position", "arm joint", "rad", "positions of the drives",
             lambda s: _at_drives(s["angles"], s["drive"]), group="encoder"),
    Quantity("measured_drive_position", "arm joint", "rad", "positions that the encoders read",
             read=lambda arms, _: [arm.q for arm in arms], group="encoder"),
    Quantity("measured_drive_velocity", "arm joint", "rad/s", "velocities that the controller gets",
             read=lambda arms, _: [arm.v for arm in arms], group="encoder"),
    Quantity("seen_pose", "arm row column", "1, m", "X_WP by each arm's own kinematics",
             read=lambda arms, _: [arm.payload_pose for arm in arms], stored=False, group="kinematics"),
    Quantity("seen_pose_error", "arm axis", "m, rad", "pose of P that each arm sees, minus the actual one",
             lambda s: _pose_errors(s["seen_pose"], s["payload_pose"][..., None, :, :]), group="kinematics"),
    Quantity("measured_wrench", "arm axis", "N, N m", "F_i that each arm's wrist sensor reports; task rows",
             read=lambda arms, _: [arm.interaction_wrench for arm in arms], group="wrist"),
    Quantity("measured_wrench_age", "arm", "ticks", "age of measured_wrench",
             read=lambda arms, _: [arm.interaction_wrench_age for arm in arms], group="wrist"),
    Quantity("measured_internal_wrench", "arm axis", "N, N m", "f_i that each controller gets; task rows",
             read=lambda arms, _: [arm.internal_wrench for arm in arms], group="force path"),
    Quantity("measured_internal_wrench_age", "", "ticks", "age of measured_internal_wrench",
             read=lambda arms, _: [arms[0].internal_wrench_age], group="force path"),
    *_internal_parts("measured_internal_{}", "measured internal wrench",
                     lambda s: s["measured_internal_wrench"], group="force path"),
)
# fmt: on

GROUPS: dict[str, Callable[[Scenario], bool]] = {
    "compensation": lambda run: any(run.actuators_of(arm).gravity_compensation for arm in run.cell.arms),
    "servo": lambda scenario: scenario.has_servos,
    "grasps": lambda scenario: bool(scenario.cell.compliant),
    "plan": lambda scenario: bool(scenario.cell.compliant or scenario.has_grasp_plan),
    "joints": lambda scenario: scenario.cell.splits_load,
    "tools": lambda scenario: bool(scenario.cell.tools),
    "links": lambda scenario: scenario.cell.payload.links is not None,
    "partner": lambda scenario: bool(scenario.partners),
    "shared": lambda scenario: bool(scenario.cell.driven),
    "floor": lambda scenario: bool(scenario.cell.shared_joints),
    "wheels": lambda scenario: bool(scenario.cell.wheels),
    "patches": lambda scenario: scenario.cell.has_contacts,
    "elements": lambda scenario: scenario.cell.has_force_elements,
    "stops": lambda scenario: any(arm.stops is not None for arm in scenario.cell.arms.values()),
    "stopped": lambda scenario: GROUPS["stops"](scenario) or GROUPS["links"](scenario),
    "network": lambda scenario: scenario.network is not None,
    "encoder": lambda scenario: not all(s.joints_are_ideal for s in _sensors(scenario)),
    "kinematics": lambda scenario: (
        not all(s.joints_are_ideal for s in _sensors(scenario))
        or any(arm.calibration_error != Miscalibration() for arm in scenario.cell.arms.values())
        or bool(scenario.cell.unclosed or scenario.grasp_events or scenario.cell.driven)
    ),
    "wrist": lambda scenario: any(s.wrist is not None for s in _sensors(scenario)),
    "force path": lambda scenario: (
        (path := scenario.controller.force_path).by_sensors
        and (path.delay > 0 or any(s.wrist is not None for s in _sensors(scenario)))
    ),
}
"""Whether a run of a scenario has the quantities of a group: what is measured only where it is not ideal."""


def _sensors(scenario: Scenario) -> list[Sensors]:
    return [scenario.sensors_of(arm) for arm in scenario.cell.arms]


def quantities(scenario: Scenario, works: Collection[str] = ()) -> tuple[Quantity, ...]:
    """Return the quantities of a run of a scenario, in the order of the table.

    Args:
        scenario: Scenario.
        works: Names of works that its engine books besides.
    """
    groups = {"", *(name for name, is_recorded in GROUPS.items() if is_recorded(scenario))}
    return tuple(each for each in QUANTITIES if each.group in groups or each.name in works)
