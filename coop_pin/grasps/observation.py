"""Observation of a cell: the quantities that a plant computes at a state, with floats or traced numbers.

A quantity of the payload that follows from its motion is declared and computed here alone, for all engines:
``QUANTITIES`` gives it dimensions and a unit, recorder and compiled code then have it by its name.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from coop_pin.base.arrays import Array
from coop_pin.description.events import Surroundings


class Observation(NamedTuple):
    """Quantities of a cell at states under given forces, by their names in QUANTITIES.

    Attributes:
        payload_pose: X_WP, shape (..., 4, 4).
        payload_twist: V_WP, shape (..., 6).
        tip_position: positions of the tips in the world, m, shape (..., m, 3).
        interaction_wrench: wrench on each arm by the payload, about P in world axes, N and N m, shape
            (..., m, 6).
        kinetic_energy: kinetic energy of arms and payload, J, shape (...).
        potential_energy: potential energy of arms and payload, J, shape (...).
        external_wrench: wrench on the payload besides gravity and grasps, about P in world axes, shape
            (..., 6).
        elastic_energy: energy in compliant grasps and contacts, J, shape (...); None without any.
        grasp_deflection: deflection of each compliant grasp, m and rad, shape (..., m, 6), NaN for others;
            None without any.
        grasp_wrench: wrench of each on its arm about the tip in grasp axes, N and N m, likewise.
        patch_wrench: wrench of each of p patches and tables on the arm or the payload about the origin of its
            plane in axes of the plane, N and N m, shape (..., p, 6); None without any.
        patch_points: number of points of each that touch, shape (..., p); likewise.
        patch_slip: distance that each has slid, m, shape (..., p); likewise.
        stop_force: force of the end stops on the joints of each arm, N m or N, NaN for arms without, shape
            (..., m, k); None where no arm has stops.
        stop_energy: energy in the end stops of arms and payload, J, shape (...); None without any.
        partner_wrench: wrench of the partner that took hold last on the payload, about P in world axes, N
            and N m, shape (..., 6); None without one.
        partner_deflection: deflection of its handle in axes of its point, m and rad, likewise.
        partner_energy: energy in its spring, J, shape (...); likewise.
        shared_position: positions of the shared joints, m or rad, shape (..., n); None without any.
        shared_velocity: their rates, m/s or rad/s, likewise.
        shared_force: force of their drives, N or N m, likewise.
        floor_wrench: wrench of the floor on the robot that they belong to, about the world's origin, N and
            N m, shape (..., 6); likewise.
        tip_pose: X_WE of each arm, shape (..., m, 4, 4); None without tools.
        payload_joint_position: angles and travels of the joints of a payload of several links, rad or m,
            shape (..., n); None of one body.
        payload_joint_velocity: their rates, rad/s or m/s, likewise.
        payload_joint_force: forces of their springs, dampers, friction and stops, N m or N, likewise.
        payload_joint_energy: energy in their springs, J, shape (...); likewise.
        wheel_force: force of the ground on each of b bases that roll: ahead, to the left, up, N, shape
            (..., b, 3); None without any.
    """

    payload_pose: Array
    payload_twist: Array
    tip_position: Array
    interaction_wrench: Array
    kinetic_energy: Array
    potential_energy: Array
    external_wrench: Array
    elastic_energy: Array | None = None
    grasp_deflection: Array | None = None
    grasp_wrench: Array | None = None
    patch_wrench: Array | None = None
    patch_points: Array | None = None
    patch_slip: Array | None = None
    stop_force: Array | None = None
    stop_energy: Array | None = None
    partner_wrench: Array | None = None
    partner_deflection: Array | None = None
    partner_energy: Array | None = None
    shared_position: Array | None = None
    shared_velocity: Array | None = None
    shared_force: Array | None = None
    floor_wrench: Array | None = None
    tip_pose: Array | None = None
    payload_joint_position: Array | None = None
    payload_joint_velocity: Array | None = None
    payload_joint_force: Array | None = None
    payload_joint_energy: Array | None = None
    wheel_force: Array | None = None


class PayloadState(NamedTuple):
    """Payload in motion, and what acts on it, by floats or traced numbers.

    Attributes:
        X_WP: pose, shape (4, 4), of traced numbers without its last row, shape (3, 4).
        V_WP: twist of P, m/s and rad/s, shape (6,).
        F_P: wrench besides gravity and grasps, about P in world axes, N and N m, shape (6,).
        surroundings: mass and inertia of it, and gravity.
    """

    X_WP: Array
    V_WP: Array
    F_P: Array
    surroundings: Surroundings


def payload_quantities(state: PayloadState) -> dict[str, Any]:
    """Return the quantities of the payload that follow from its state, by name."""
    return {"payload_pose": state.X_WP, "payload_twist": state.V_WP, "external_wrench": state.F_P}
