"""Effects: the internal force that every parameter of a log makes under the law that ran."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.identification.closure import ViewClosure, arm_parameters
from coop_pin.identification.estimate import Parameter
from coop_pin.identification.friction import WIDTH, DriveFriction
from coop_pin.identification.law_response import internal_wrenches
from coop_pin.identification.payload import HAND_AXES, hand_columns
from coop_pin.identification.views import FRAME_AXES, View, columns
from coop_pin.logs.record import Record
from coop_pin.model.cell_arm import CellArm

_TIMES = 160
"""Times at which forces are computed."""


class Effects(NamedTuple):
    """Internal forces by parameter.

    Attributes:
        times: s, shape (n,).
        parameters: the parameters, in the order of the columns.
        force: force on each arm by a unit of each parameter, N, shape (n, m, rows, p); rows of moments are
            left out.
        reading: internal force by it that the wrists would read, likewise, with their zeros.
        without: internal force on each arm without any cause, N, shape (n, m, rows); the desired one if None.
    """

    times: Array
    parameters: tuple[Parameter, ...]
    force: Array
    reading: Array
    without: Array | None = None


def effects(
    record: Record,
    closure: ViewClosure,
    scenario: Scenario,
    parameters: Sequence[Parameter],
    friction: Sequence[DriveFriction],
) -> Effects:
    """Return the forces of unit errors, linear about the record.

    Args:
        record: record of the arms.
        closure: views of the arms.
        scenario: cell, and the law that ran, of which ``uncovered`` knows nothing.
        parameters: parameters of kinematics, wrists and hands.
        friction: friction of drives; its columns follow those of the parameters, one each.
    """
    gravity, times = np.array(scenario.cell.gravity), np.linspace(*record.held_span, _TIMES)
    rows, arms = list(closure.rows.indices), closure.arms
    views = {name: closure.view(name, times) for name in arms}
    p, first = len(parameters) + len(friction), next(iter(views.values()))
    shape = (len(times), len(arms), len(rows), p)
    turns = np.asarray(np.kron(np.eye(2), first.pose[:, :3, :3]), dtype=np.float64)  # payload to world
    bias, wrist, torque = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for number, (name, arm) in enumerate(arms.items()):
        of_arm = _columns(views[name], arm, times)[:, rows]
        at_P = (turns @ pin.SE3(arm.X_PE).toDualActionMatrix())[:, rows]
        column = {one: k for k, one in enumerate(arm_parameters(arm))}
        by_hand = at_P @ hand_columns(views[name].pose[:, :3, :3] @ arm.X_PE[:3, :3], gravity)
        for k, one in enumerate(parameters):
            if one.arm == name and one.part == "wrist":
                wrist[:, number, :, k] = at_P[:, :, FRAME_AXES.index(one.axis)]
            elif one.arm == name and one.part == "hand":
                wrist[:, number, :, k] = by_hand[:, :, HAND_AXES.index(one.axis)]
            elif one.arm == name:
                bias[:, number, :, k] = of_arm[:, :, column.get(one, -1)]  # the clock is last
        for k, drive_friction in enumerate(friction, len(parameters)):
            if drive_friction.arm == name:
                torque[:, number, :, k] = _friction_wrench(closure, name, views[name], times, drive_friction)
    squeeze = [scenario.squeeze.at(time, scenario.cell.grasps) for time in times.tolist()]
    Q, f_d = turns[:, rows][:, :, rows], np.array(squeeze)[:, :, rows]
    turned = _turned_squeeze(bias, np.einsum("nij,naj->nai", Q, f_d), rows)
    phi = internal_wrenches(scenario, times, Q, bias, wrist - turned, torque + turned)
    c = np.array(scenario.cell.shares)[:, None, None]
    reading = phi + wrist - c * wrist.sum(axis=1, keepdims=True)
    linear = closure.rows.are_linear
    everything = (*parameters, *friction_parameters(friction))
    return Effects(times, everything, phi[:, :, linear], reading[:, :, linear])


def friction_parameters(friction: Sequence[DriveFriction]) -> tuple[Parameter, ...]:
    """Return the friction of drives as parameters, whose value is a factor of the estimate."""
    return tuple(Parameter(one.arm, "friction", f"drive {one.drive + 1}", "") for one in friction)


def _columns(view: View, arm: CellArm, times: Array) -> Array:
    """Return how errors of a model and of the arm's clock move its view against the desired motion."""
    speed = np.gradient(view.pose[:, :3, 3], times, axis=0)
    turn = np.gradient(view.pose[:, :3, :3], times, axis=0) @ np.swapaxes(view.pose[:, :3, :3], 1, 2)
    spin = np.stack((turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]), axis=1)
    late = -np.concatenate((speed, spin), axis=1)[:, :, None]
    return np.concatenate((columns(view, arm), late), axis=2)


def _turned_squeeze(bias: Array, f_d: Array, rows: Sequence[int]) -> Array:
    """Return what f_d gains as each arm turns it by its own view, shape (n, m, k_0, p)."""
    whole, force = np.zeros((*bias.shape[:2], 6, bias.shape[3])), np.zeros((*f_d.shape[:2], 6))
    whole[:, :, rows], force[:, :, rows] = bias, f_d
    turned = [
        np.cross(whole[:, :, 3:], part[..., None], axisa=2, axisb=2, axisc=2)
        for part in (force[..., :3], force[..., 3:])
    ]
    return np.concatenate(turned, axis=2)[:, :, rows]


def _friction_wrench(
    closure: ViewClosure, name: str, view: View, times: Array, friction: DriveFriction
) -> Array:
    """Return what the friction of a drive does to the wrench of its arm, by the dynamic inverse, (n, k_0)."""
    arm, rows = closure.arms[name], list(closure.rows.indices)
    q, v = closure.joints(name, times)
    wrench = np.empty((len(times), len(rows)))
    for k in range(len(times)):
        speed = float(arm.drive[friction.drive] @ v[k])
        torque = friction.viscous * speed + friction.coulomb * np.tanh(speed / WIDTH)
        J = view.jacobian[k][rows]
        weighted = np.linalg.solve(arm.mass_matrix(arm.configuration(q[k])), J.T)
        wrench[k] = np.linalg.solve(J @ weighted, weighted.T @ arm.drive[friction.drive]) * torque
    return wrench
